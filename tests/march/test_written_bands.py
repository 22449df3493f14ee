"""Bands of models that are written element by element: fewer operations, the same bits."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.kernels.newton_matrix import Band, band_as_written
from xdynamics.march import equation_solvers

CELLS = 40


def brusselator(cells: int, *, side_by_side: bool) -> xd.Model:
    """The Brusselator of Hairer and Wanner II, section IV.10, one state after the other, u and v of a cell side by side or not."""
    rates = {"u": "k*(1 + u{i}**2*v{i} - 4*u{i})", "v": "k*(3*u{i} - u{i}**2*v{i})"}
    ends = {"u": "1", "v": "3"}
    order = (
        [(i, name) for i in range(cells) for name in "uv"]
        if side_by_side
        else [(i, n) for n in "uv" for i in range(cells)]
    )
    states = {}
    for i, name in order:
        left = f"{name}{i - 1}" if i else ends[name]
        right = f"{name}{i + 1}" if i < cells - 1 else ends[name]
        flow = f"a*{(cells + 1) ** 2}*({left} - 2*{name}{i} + {right})"
        states[f"{name}{i}"] = {"unit": "1", "rate": f"{rates[name].format(i=i)} + {flow}"}
    places = (np.arange(cells) + 1) / (cells + 1)
    start = {f"u{i}": repr(float(1.0 + np.sin(2.0 * np.pi * place))) for i, place in enumerate(places)}
    return xd.Model(
        name="Brusselator",
        parameters={"a": "0.02 s-1", "k": "1 s-1"},
        states=states,
        initial={"t": "0 s"} | start | {f"v{i}": "3" for i in range(cells)},
    )


@pytest.mark.parametrize("coordinates", [0, 100])
def test_a_tridiagonal_matrix_is_a_band_and_a_full_one_is_none(coordinates: int) -> None:
    """Assert one entry below and above, of coordinates by the velocities that stand for them."""
    n = 100
    row, column = np.nonzero(np.abs(np.subtract.outer(np.arange(n), np.arange(n))) <= 1)
    entries = np.stack([np.tile(row, 2), np.concatenate([column, column + coordinates])], axis=1)
    found = band_as_written(entries, coordinates, n)
    assert found is not None
    assert (found.lower, found.upper, found.height) == (1, 1, 4)
    assert band_as_written(np.argwhere(np.ones((n, n))), 0, n) is None
    few = entries[(entries < 10).all(axis=1)]
    assert band_as_written(few, 0, 10) is None


def test_a_band_has_the_bits_of_the_whole_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the same record of 80 states by Radau in a band of 7 numbers a column, and without one."""
    given: dict[str, Any] = {"method": "radau_iia", "rtol": 1e-6, "atol": 1e-8, "until": "5 s", "log": "states"}
    model, found = brusselator(CELLS, side_by_side=True), list[Band | None]()

    def kept(*asked: Any) -> Band | None:
        found.append(band_as_written(*asked))
        return found[-1]

    monkeypatch.setattr(equation_solvers, "band_as_written", kept)
    banded = xd.simulate(model, **given)
    assert found[-1] is not None
    assert found[-1].height == 7
    monkeypatch.setattr(equation_solvers, "band_as_written", lambda *_asked: None)
    assert xd.content_digest(xd.simulate(model, **given)) == xd.content_digest(banded)
    apart = xd.simulate(brusselator(CELLS, side_by_side=False), **given)
    for name in model.elements.statement.states:
        assert float(apart[name][-1]) == pytest.approx(float(banded[name][-1]), rel=1e-11)
