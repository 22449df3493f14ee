# ruff: noqa: ARG001
"""Right-hand sides with arrays of two axes become one expression along a dimension, with scipy's numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import xdynamics as xd
from xdynamics.expressions import text_of
from xdynamics.simulation.scipy_interface import model_of_function


def bump(n: int) -> Any:
    """Return a smooth row of numbers."""
    return np.exp(-(np.linspace(-2, 2, n) ** 2))


ROWS, COLUMNS = 16, 20  # more numbers than are written out one by one
ACROSS, DOWN = np.meshgrid(np.linspace(0, 1, COLUMNS), np.linspace(0, 1, ROWS))


def plate(t: Any, y: Any) -> Any:
    """A window of two axes, edges by themselves."""
    u = y.reshape(ROWS, COLUMNS)
    d = np.zeros_like(u)
    d[1:-1, 1:-1] = u[2:, 1:-1] + u[:-2, 1:-1] + u[1:-1, 2:] + u[1:-1, :-2] - 4 * u[1:-1, 1:-1]
    d[0, :] = u[1, :] - u[0, :]
    d[:, -1] = u[:, -2] - u[:, -1]
    return d.ravel()


def torus(t: Any, y: Any) -> Any:
    """Two fields that react on a torus."""
    u, v = y.reshape(2, ROWS, COLUMNS)

    def around(a: Any) -> Any:
        return np.roll(a, 1, 0) + np.roll(a, -1, axis=0) + np.roll(a, 1, axis=1) + np.roll(a, -1, axis=-1) - 4 * a

    reaction = u * v**2
    both = np.array([0.16 * around(u) - reaction + 0.06 * (1 - u), 0.08 * around(v) + reaction - 0.1 * v])
    return both.ravel()


def driven_plate(t: Any, y: Any) -> Any:
    """Broadcast numbers, sources in time and space, differences, a window, single elements, one roll of all."""
    u, d = y.reshape(ROWS, -1), np.zeros((ROWS, COLUMNS))
    d[:, 1:] = -np.diff(u, axis=1)
    d[5:8, 3:9] += np.cos(t)
    d[2, 3] = u[4, 5] - u[-1, -2]
    slope = 0.1 * np.linspace(0, 1, COLUMNS) * np.linspace(0, 1, ROWS)[:, None]
    source = np.linspace(0, 1, ROWS)[:, None] * np.sin(t) + np.exp(-((ACROSS - 0.5) ** 2) - DOWN**2)
    return (d + slope + source + 0.01 * np.roll(u, (1, 2), axis=(0, 1)) + 0.01 * np.roll(u, 3)).reshape(-1)


def plate_in_place(t: Any, y: Any) -> Any:
    """Fluxes that are added in place, to both sides of every face."""
    u, d = y.reshape(ROWS, COLUMNS), np.zeros((ROWS, COLUMNS))
    for _ in range(3):
        d[1:] += (u[:-1] - u[1:]) / 3
        d[:-1] -= (u[:-1] - u[1:]) / 3
    d[:, 1:] += u[:, :-1] - u[:, 1:]
    d[:, :-1] += u[:, 1:] - u[:, :-1]
    d[3:5, 2:4] *= 2.0
    d[4] /= 3.0
    return d.flatten()


def padded_plates(t: Any, y: Any) -> Any:
    """Padded arrays, gradients, biharmonic terms, halves joined by `numpy.r_`."""
    k = y.size // 2
    u, v = y[:k].reshape(ROWS, COLUMNS), y[k:].reshape((ROWS, COLUMNS))

    def laplacian(a: Any, **how: Any) -> Any:
        p = np.pad(a, 1, **how)
        return p[2:, 1:-1] + p[:-2, 1:-1] + p[1:-1, 2:] + p[1:-1, :-2] - 4 * a

    down, across = np.gradient(v, 0.5, 0.25)
    bent = 0.1 * laplacian(laplacian(u, mode="wrap"), mode="wrap")
    return np.r_[(laplacian(u, mode="edge") - bent).ravel(), (laplacian(v) - 0.1 * down * across).ravel()]


def columns(t: Any, y: Any) -> Any:
    """Particles whose columns are taken by `.T`, and put together again in two ways."""
    x, v, a, b = y.reshape(-1, 4).T
    rates = np.empty((y.size // 4, 4))
    rates[:, 0], rates[:, 1] = v, -x
    rates[:, 2:] = 0.1 * y.reshape(-1, 4)[:, :2]
    rates += np.column_stack([v, -x, b, -np.sin(a)])
    return (rates + np.hstack([0.1 * rates[:, 2:], rates[:, :2]])).ravel()


def turned_plate(t: Any, y: Any) -> Any:
    """Axes exchanged, by `.T` and in Fortran's order."""
    u, f = y.reshape(ROWS, COLUMNS), y.reshape(ROWS, COLUMNS, order="F")
    back = np.roll(f, 1, 0) - 2 * f + np.roll(f, -1, axis=1)
    return (np.roll(u.T, 1, 0).T - u).ravel() + 0.1 * back.ravel(order="F")


FIELD = bump(ROWS * COLUMNS)
CASES: dict[str, tuple[Any, Any]] = {
    "plate": (plate, FIELD),
    "torus": (torus, np.r_[FIELD, 1 - FIELD]),
    "driven plate": (driven_plate, FIELD),
    "plate in place": (plate_in_place, FIELD),
    "padded plates": (padded_plates, np.r_[FIELD, FIELD]),
    "columns": (columns, FIELD),
    "turned plate": (turned_plate, FIELD),
}


@pytest.mark.every(3)
@pytest.mark.parametrize("name", CASES)
def test_planes_have_scipys_numbers(name: str) -> None:
    """Assert one variable along y_index, which elements with an expression each are not, and the state at the end."""
    fun, y0 = CASES[name]
    run = xd.solve(fun, (0, 1), y0, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.1)
    assert run.y.dims == ("step", "y_index")
    right = solve_ivp(fun, (0, 1), y0, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.1)
    assert run.y.values[-1] == pytest.approx(right.y[:, -1], rel=1e-10, abs=1e-10)


def test_a_plate_is_as_long_for_any_number() -> None:
    """Assert that of ten times as many rows the expression is as long, and the numbers are numpy's."""
    texts = []
    for rows in (30, 300):

        def spread(t: Any, y: Any, rows: int = rows) -> Any:
            u = y.reshape(rows, 20)
            d = np.zeros((rows, 20))
            d[1:-1, 1:-1] = u[2:, 1:-1] + u[:-2, 1:-1] - 2 * u[1:-1, 1:-1]
            d[3:9, 2:5] *= 2.0
            return d.ravel()

        model = model_of_function(spread, (0, 1), bump(20 * rows), (), None, None, None)
        texts.append(text_of(model.statement.states["y"].rate))
    assert len(texts[1]) < len(texts[0]) + 30
    assert len(texts[0]) < 1000


@pytest.mark.dear
def test_sums_of_windows() -> None:
    """Assert that sums and extremes of an array and of a window are those of numpy, with which a model is compared."""

    def summed(t: Any, y: Any) -> Any:
        u = y.reshape(20, 16)
        return (0.1 * u[2:5, 1:4].sum() + np.mean(u) - u.max() + np.min(u[3:9, 2:]) - 0 * u).ravel()

    model = model_of_function(summed, (0, 1), np.sin(np.arange(320.0)), (), None, None, None)
    assert text_of(model.statement.states["y"].rate).count("sum(") == 2
