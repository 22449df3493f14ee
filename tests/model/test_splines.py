"""Cubics through measured tables: SciPy's to the bit or nearly so, exact where the data are cubic."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator

import xdynamics as xd
from xdynamics.model.drives import hermite_pieces, monotone_slopes, spline_slopes


def table(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Uneven points, with plateaus and turns."""
    random = np.random.default_rng(seed)
    x = np.cumsum(10.0 ** random.uniform(-2, 1, n))
    return x, np.where(random.random(n) < 0.2, 1.0, random.standard_normal(n))


@pytest.mark.parametrize("n", [2, 3, 4, 5, 17, 400])
@pytest.mark.parametrize("seed", range(5))
def test_monotone_pieces_are_scipy_s(n: int, seed: int) -> None:
    """Assert equal bits, so that archives made with SciPy's cubics are reproduced."""
    x, y = table(n, seed)
    assert (
        hermite_pieces(x, y, monotone_slopes(x, y)).tobytes()
        == np.ascontiguousarray(PchipInterpolator(x, y).c).tobytes()
    )


@pytest.mark.parametrize("n", [2, 3, 4, 5, 17, 400])
@pytest.mark.parametrize("seed", range(5))
def test_spline_pieces_are_scipy_s_but_for_rounding(n: int, seed: int) -> None:
    """Assert SciPy's values, whose own last bits hang on the linear algebra that it was built with."""
    x, y = table(n, seed)
    h, known = np.diff(x), CubicSpline(x, y)
    cubic, square, slope, value = hermite_pieces(x, y, spline_slopes(x, y))
    for part in (0.25, 0.5, 0.75):
        u = part * h
        found, true = ((cubic * u + square) * u + slope) * u + value, known(x[:-1] + u)
        assert np.all(np.abs(found - true) <= 1e-11 * np.abs(true).max())


def test_splines_of_cubics_are_those_cubics() -> None:
    """Assert that not-a-knot ends lose nothing of a cubic polynomial."""
    x = np.array([0.0, 0.5, 0.75, 2.0, 2.5, 4.0])
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25])
    assert spline_slopes(x, cubic(x)) == pytest.approx(cubic.deriv()(x), rel=1e-13, abs=1e-13)


def test_monotone_data_stay_monotone() -> None:
    """Assert no overshoot between rising points, and level pieces between equal ones."""
    x, y = np.array([0.0, 1.0, 1.1, 3.0, 4.0]), np.array([0.0, 0.0, 5.0, 5.1, 5.1])
    cubic, square, slope, value = hermite_pieces(x, y, monotone_slopes(x, y))
    for k in range(4):
        u = np.linspace(0.0, x[k + 1] - x[k], 50)
        along = ((cubic[k] * u + square[k]) * u + slope[k]) * u + value[k]
        assert np.all(np.diff(along) >= -1e-15)


@pytest.mark.parametrize("rule", ["linear", "pchip", "cubic"])
@pytest.mark.parametrize(
    ("rows", "where"),
    [
        ("0,0\n1,-1e308\n1.5,1e308\n2,0\n3,0\n", "goes from -1e+308 at 1 to 1e+308 at 1.5"),
        ("0,0\n1e-320,1\n1,2\n2,3\n", "goes from 0 at 0 to 1 at 9.99988867182683e-321"),
    ],
)
def test_a_slope_that_overflows_is_named(rule: str, rows: str, where: str) -> None:
    """Assert that the points between which no number holds the slope are told, before anything is marched."""
    pull = {"table": "f.csv", "csv": "time [s],pull [N]\n" + rows, "interpolation": rule}
    model = xd.Model(
        name="pulled",
        coordinates={"x": {"unit": "m"}},
        parameters={"m": "1 kg"},
        mass={"x": "m"},
        forces={"pull": {"x": "pull"}},
        drives={"pull": pull},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    with pytest.raises(xd.ModelError, match=re.escape(f"drive 'pull': table 'f.csv' {where}")) as caught:
        xd.simulate(model, method="velocity_verlet", step=0.25, until=2.0)
    assert f"the slopes of interpolation '{rule}' overflow" in str(caught.value)
