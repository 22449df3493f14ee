"""LU of band matrices, real and complex, against scipy's solve_banded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import solve_banded

from cases.plain import plain
from xdynamics.kernels import linear

BANDS = [(0, 0), (1, 1), (2, 2), (0, 3), (3, 0), (1, 4), (4, 1), (7, 5)]


def stored(wide: np.ndarray, lower: int, upper: int) -> np.ndarray:
    """Return a matrix as `band` keeps it: column by column, with room for row exchanges."""
    n, height = len(wide), 2 * lower + upper + 1
    found = np.zeros((n, height))
    for j in range(n):
        for i in range(max(0, j - upper), min(n, j + lower + 1)):
            found[j, lower + upper + i - j] = wide[i, j]
    return found.ravel()


def in_band(n: int, lower: int, upper: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a random band matrix with a small diagonal, so that rows are exchanged, and a right-hand side."""
    random = np.random.default_rng(seed)
    wide = random.normal(size=(n, n)) * (np.arange(n)[:, None] - np.arange(n) <= lower)
    wide *= np.arange(n) - np.arange(n)[:, None] <= upper
    if lower and upper:
        wide[np.diag_indices(n)] *= 1e-3
    return wide, random.normal(size=n)


def rows_of(wide: np.ndarray, lower: int, upper: int) -> np.ndarray:
    """Return a matrix as scipy takes it: diagonal by diagonal."""
    n = len(wide)
    found = np.zeros((lower + upper + 1, n), wide.dtype)
    for i, j in np.argwhere(wide):
        found[upper + i - j, j] = wide[i, j]
    return found


@pytest.mark.parametrize(("lower", "upper"), BANDS)
@pytest.mark.parametrize("n", [1, 2, 9, 40])
def test_real(n: int, lower: int, upper: int) -> None:
    """Assert that a solution is scipy's, rows exchanged or not."""
    lower, upper = min(lower, n - 1), min(upper, n - 1)
    wide, right = in_band(n, lower, upper, 10 * n + lower)
    expected = solve_banded((lower, upper), rows_of(wide, lower, upper), right)
    matrix, pivots = stored(wide, lower, upper), np.zeros(n, np.int64)
    assert plain(linear.factorise_band)(matrix, pivots, n, lower, upper)
    plain(linear.substitute_band)(matrix, pivots, right, n, lower, upper)
    scale = np.abs(expected).max() * np.linalg.cond(wide)
    np.testing.assert_allclose(right, expected, rtol=0, atol=1e-15 * scale + 1e-15)
    assert (pivots != np.arange(n)).any() or n <= 2 or not (lower and upper)


@pytest.mark.parametrize(("lower", "upper"), BANDS)
@pytest.mark.parametrize("n", [1, 2, 9, 40])
def test_complex(n: int, lower: int, upper: int) -> None:
    """Assert that a complex solution is scipy's, rows exchanged or not."""
    lower, upper = min(lower, n - 1), min(upper, n - 1)
    (re, right), (im, other) = (in_band(n, lower, upper, 20 * n + lower + seed) for seed in (0, 1000))
    wide, height = re + 1j * im, 2 * lower + upper + 1
    expected = solve_banded((lower, upper), rows_of(wide, lower, upper), right + 1j * other)
    matrix = np.concatenate([np.zeros(n * height), stored(re, lower, upper), stored(im, lower, upper)])
    pivots, found = np.zeros(6 * n, np.int64), np.concatenate([right, other])
    assert plain(linear.factorise_complex_band)(matrix, pivots, n, lower, upper)
    plain(linear.substitute_complex_band)(matrix, pivots, found, n, lower, upper)
    scale = np.abs(expected).max() * np.linalg.cond(wide)
    np.testing.assert_allclose(found[:n] + 1j * found[n:], expected, rtol=0, atol=1e-15 * scale + 1e-15)


@pytest.mark.parametrize("wrong", [0.0, np.inf, np.nan])
def test_singular(wrong: float) -> None:
    """Assert that a column without a pivot is said to have none."""
    wide = np.diag([1.0, wrong, 1.0])
    matrix = np.tile(stored(wide, 0, 0), 3)
    assert not plain(linear.factorise_band)(matrix, np.zeros(3, np.int64), 3, 0, 0)
    assert not plain(linear.factorise_complex_band)(matrix, np.zeros(18, np.int64), 3, 0, 0)
