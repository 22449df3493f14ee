"""The least and the greatest of some numbers, as functions of any kind of number."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from xdynamics.elementary.bounds import maximum, minimum


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8])
def test_least_and_greatest_of_any_number(count: int) -> None:
    """Assert those of Python, of one number and of three too, in any order and number by number in arrays."""
    numbers = [3.0, -1.5, 2.0**-1074, -np.inf, 7.25, 0.5, np.inf, -2.0][:count]
    for given in itertools.islice(itertools.permutations(numbers), 200):
        assert (minimum(*given), maximum(*given)) == (min(given), max(given))
    arrays = [np.array([number, -number]) for number in numbers]
    assert np.array_equal(minimum(*arrays), np.min(arrays, axis=0))
    assert np.array_equal(maximum(*arrays), np.max(arrays, axis=0))
