"""Jacobians of models with dimensions, found group by group, are those of their elements, entry by entry."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray

import xdynamics as xd
from cases.array_programs import compiled, in_python
from cases.shaped_laws import MODELS
from xdynamics.kernels import Layout, layout_of, model_programs
from xdynamics.kernels.drive_tables import concatenated_tables
from xdynamics.kernels.newton_matrix import is_compressed, pattern_of
from xdynamics.kernels.program import AT
from xdynamics.model import Model
from xdynamics.model.linearisation import linearise
from xdynamics.model.motion import constants, drive_pieces

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
