"""LU of band matrices, real and complex, against scipy's solve_banded.

Jacobians of models with dimensions, found group by group, are those of their elements, entry by entry.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.linalg import solve_banded

import xdynamics as xd
from cases.array_programs import compiled, in_python
from cases.plain import plain
from cases.shaped_laws import MODELS
from xdynamics.kernels import Layout, layout_of, linear, model_programs
from xdynamics.kernels.drive_tables import concatenated_tables
from xdynamics.kernels.newton_matrix import is_compressed, pattern_of
from xdynamics.kernels.program import AT
from xdynamics.model import Model
from xdynamics.model.linearisation import linearise
from xdynamics.model.motion import constants, drive_pieces

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


Floats = NDArray[np.float64]


def state_of(layout: Layout) -> Floats:
    """Return a state at which all functions have a derivative."""
    return np.random.default_rng(5).uniform(0.5, 1.5, layout.record.size)


def by_groups(model: Model, *, machine: bool) -> Floats:
    """Return the derivatives of accelerations and rates by coordinates, velocities and states, group by group."""
    layout = layout_of(model)
    n, used = layout.coordinates.size, layout.used.size
    run = compiled if machine else in_python
    tables, pieces = concatenated_tables(drive_pieces(model))
    at, p, y = np.zeros(len(AT)), np.array([*constants(model).values()]), state_of(layout)
    given = {"at": at, "p": p, "y": y, "tables": tables, "pieces": pieces}
    at[0] = 0.25
    run(model_programs.forces(layout))(**given, z=y)
    found, w, z = np.zeros((used - n, used)), np.zeros(3 + used), np.zeros(layout.record.size)
    entries, groups, _ = pattern_of(layout)
    rows, columns = entries.T
    product = run(model_programs.changes(layout, 3))
    for begin, end in pairwise(groups.tolist()):
        w[:] = 0.0
        w[3 + columns[begin:end]] = 1.0
        product(**given, z=z, w=w)
        found[rows[begin:end], columns[begin:end]] = z[used + rows[begin:end]]
    return found


def of_elements(model: Model) -> Floats:
    """Return the same from the expressions of single elements."""
    layout = layout_of(model)
    names = [*layout.used]
    state = dict(zip(names, state_of(layout).tolist(), strict=False)) | {"t": 0.25}
    return linearise(model, state).jacobian[layout.coordinates.size :]


@pytest.mark.every(17)
@pytest.mark.parametrize("machine", [True, False])
@pytest.mark.parametrize("name", MODELS)
def test_entries(name: str, machine: bool) -> None:
    """Assert that derivatives found group by group are those of the elements, and that the pattern misses none."""
    model = xd.Model.from_text(MODELS[name])
    assert is_compressed(layout_of(model))
    found, expected = by_groups(model, machine=machine), of_elements(model)
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-14 * np.abs(expected).max())
    assert np.count_nonzero(expected) > 20


@pytest.mark.every(3)
@pytest.mark.parametrize("name", MODELS)
def test_no_more_entries_than_elements_have(name: str) -> None:
    """Assert that the pattern has few entries where the elements' expressions have none."""
    model = xd.Model.from_text(MODELS[name])
    layout = layout_of(model)
    assert len({*layout.couplings}) <= len(pattern_of(layout).entries) <= 1.1 * len(layout.couplings)
