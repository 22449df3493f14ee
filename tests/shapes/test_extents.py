"""Relations of dimensions: which are of every two elements."""

from __future__ import annotations

import numpy as np
import pytest

from xdynamics.shapes.extents import Relation, every_two


def relation(first: list[int], second: list[int], target: str = "body", *, made_so: bool = False) -> Relation:
    """Return a relation from bodies to a dimension."""
    ends = (np.array(numbers, np.int64) for numbers in (first, second))
    return Relation("pair", "body", target, *ends, of_every_two=made_so)


@pytest.mark.parametrize("n", [3, 4, 7, 100])
@pytest.mark.parametrize("made_so", [False, True])
def test_every_two_are_counted(n: int, made_so: bool) -> None:
    """Assert that n(n - 1)/2 links, in their order, are of every two, and that one fewer or one more are not."""
    first, second = (numbers.tolist() for numbers in every_two(n))
    assert len(first) == n * (n - 1) // 2
    assert relation(first, second, made_so=made_so).is_of_every_two
    assert not relation(first[:-1], second[:-1], made_so=made_so).is_of_every_two
    assert not relation([*first, 0], [*second, n - 1], made_so=made_so).is_of_every_two
    assert not relation(first, second, "wall", made_so=made_so).is_of_every_two


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ([0], [1]),  # two elements, written out
        ([0, 1, 2], [1, 2, 0]),  # a ring
        ([0, 1, 0], [1, 2, 2]),  # in another order
        ([0, 0, 1], [1, 2, 3]),  # of four
    ],
)
def test_other_links_are_not_of_every_two(first: list[int], second: list[int]) -> None:
    """Assert that links of the number of pairs are compared with these, one by one."""
    assert not relation(first, second).is_of_every_two
