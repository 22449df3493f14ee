# ruff: noqa: ARG001, ARG005 - functions of t and y, as scipy takes them
"""Functions of scipy inside those that `solve` takes: refused by name, with remedies that give scipy's numbers."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import (
    Akima1DInterpolator,
    CubicSpline,
    PchipInterpolator,
    interp1d,
    make_interp_spline,
)
from scipy.optimize import brentq, fsolve, root, root_scalar
from scipy.signal import sawtooth, square
from scipy.special import erf

import xdynamics as xd

STRAIGHT, SMOOTH = interp1d([0.0, 1.0, 2.0], [0.0, 1.0, 4.0]), CubicSpline([0.0, 1.0, 2.0], [0.0, 1.0, 4.0])
STATE = "a state of its own"
CASES = {
    "scipy.integrate.quad": (lambda y: quad(lambda x: np.exp(-x * y), 0.0, 1.0)[0], STATE),
    "scipy.integrate.quad,": (lambda y: quad(np.sin, 0.0, y)[0], STATE),
    "scipy.optimize.fsolve": (lambda y: fsolve(lambda z: z**2 - y, 1.0)[0], STATE),
    "scipy.optimize.root,": (lambda y: root(lambda z: z**2 - y, 1.0).x[0], STATE),
    "scipy.optimize.root_scalar": (lambda y: root_scalar(lambda z: z**3 - y, bracket=(0.0, 2.0)).root, STATE),
    "scipy.optimize.brentq": (lambda y: brentq(lambda z: z**3 - y, 0.0, 2.0), STATE),
    "scipy.interpolate": (Akima1DInterpolator(np.arange(9.0), np.sin(np.arange(9.0))), "numpy.interp"),
    "scipy.special.erf": (erf, "np.interp"),
}


@pytest.mark.filterwarnings("ignore")  # scipy's own, about what it was given
@pytest.mark.parametrize("called", CASES)
def test_functions_of_scipy_are_refused_by_name(called: str) -> None:
    """Assert that the message names what was called and what to write in its place."""
    function, remedy = CASES[called]
    with pytest.raises(xd.InputError, match=f"the function calls {called.rstrip(',')}, which .*{remedy}"):
        xd.solve(lambda t, y: [-function(y[0])], (0.0, 1.0), [1.0])


KNOTS = np.linspace(0.0, 10.0, 21)
VALUES = np.sin(KNOTS) + 0.1 * KNOTS
SPLINE = CubicSpline(KNOTS, VALUES)
OF_TIME = {  # and the interpolation of the drive that is made of each, if any is
    "straight": (interp1d(KNOTS, VALUES), "linear"),
    "cubic": (interp1d(KNOTS, VALUES, kind="cubic"), "cubic"),
    "spline": (SPLINE, "cubic"),
    "B-spline": (make_interp_spline(KNOTS, VALUES, k=3), "cubic"),
    "B-spline of lines": (make_interp_spline(KNOTS, VALUES, k=1), "linear"),
    "monotone": (PchipInterpolator(KNOTS, VALUES), "pchip"),
    "backwards": (lambda t, read=SPLINE: read(10.0 - t), "cubic"),
    "square": (lambda t: square(2.0 * t), ""),
    "square of a duty": (lambda t: square(2.0 * t, duty=0.3), ""),
    "sawtooth": (sawtooth, ""),
    "triangle": (lambda t: sawtooth(t, 0.25), ""),
}


@pytest.mark.parametrize("name", OF_TIME)
def test_interpolators_and_waveforms_of_time_give_scipys_numbers(name: str) -> None:
    """Assert the end of y' = f(t) - y as solve_ivp has it by short steps; interpolators become drives of the model."""
    function, interpolation = OF_TIME[name]

    def rates(t: float, y: Any) -> Any:
        return [function(t) - y[0]]

    run = xd.solve(rates, (0.0, 10.0), [0.3], rtol=1e-10, atol=1e-12)
    theirs = solve_ivp(rates, (0.0, 10.0), [0.3], rtol=1e-9, atol=1e-11, max_step=0.01).y[0, -1]
    assert float(run.y0[-1]) == pytest.approx(theirs, abs=2e-6 if "square" in name else 1e-7)
    assert [drive.interpolation for drive in xd.Model.from_record(run).drives.values()] == [interpolation] * bool(
        interpolation
    )


def test_other_interpolators_and_arguments_are_refused() -> None:
    """Assert that an end condition that no drive has, and a state as the argument, are not taken for another thing."""
    natural = CubicSpline(KNOTS, VALUES, bc_type="natural")
    with pytest.raises(xd.InputError, match=r"the function calls scipy.interpolate, which looks up a table"):
        xd.solve(lambda t, y: [natural(t)], (0.0, 1.0), [1.0])
    for fun in (lambda t, y: [SPLINE.derivative()(t)], lambda t, y: [SPLINE(t, 1)]):
        with pytest.raises(xd.InputError, match=r"the function calls scipy.interpolate, which looks up a table"):
            xd.solve(fun, (0.0, 1.0), [1.0])
    kept = xd.solve(lambda t, y: [SPLINE(t) - SPLINE(2.0) + SPLINE.x[1]], (0.0, 1.0), [0.0], rtol=1e-9)
    assert float(kept.y0[-1]) == pytest.approx(SPLINE.integrate(0.0, 1.0) - SPLINE(2.0) + 0.5, abs=1e-8)
    for function in (STRAIGHT, SMOOTH):
        with pytest.raises(
            xd.InputError, match="at something else than t, or a straight line of it; write numpy.interp"
        ):
            xd.solve(lambda t, y, read=function: [-read(y[0])], (0.0, 1.0), [1.0])
    run = xd.solve(lambda t, y: [SMOOTH(t)], (0.0, 3.0), [0.0])
    assert run.attrs["run_outcome"] == "outside_drive_table"


def test_functions_of_scipy_may_be_given_numbers() -> None:
    """Assert that an integral of constants is a number like any other."""
    run = xd.solve(lambda t, y: [-quad(np.cos, 0.0, 1.0)[0] * y[0]], (0.0, 1.0), [1.0], rtol=1e-10)
    assert run.dynamics.solution.y[0, -1] == pytest.approx(np.exp(-np.sin(1.0)), rel=1e-8)


def test_an_integral_that_is_a_state_of_its_own_gives_scipys_numbers() -> None:
    """Assert the remedy: y' = -I(y), I the integral of exp(-x^2) up to y, with I' = exp(-y^2) y'."""

    def scipys(t: float, y: Any) -> Any:
        return [-quad(lambda x: np.exp(-(x**2)), 0.0, y[0])[0]]

    start = quad(lambda x: np.exp(-(x**2)), 0.0, 1.0)[0]
    run = xd.solve(lambda t, y: [-y[1], -np.exp(-(y[0] ** 2)) * y[1]], (0.0, 2.0), [1.0, start], rtol=1e-10, atol=1e-12)
    theirs = solve_ivp(scipys, (0.0, 2.0), [1.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert run.dynamics.solution.y[0, -1] == pytest.approx(theirs, rel=1e-8)


def test_an_unknown_that_is_a_state_of_its_own_gives_scipys_numbers() -> None:
    """Assert the remedy: y' = -z with z^3 + z = y, and z' = y'/(3 z^2 + 1)."""

    def scipys(t: float, y: Any) -> Any:
        return [-brentq(lambda z: z**3 + z - y[0], 0.0, 2.0)]

    run = xd.solve(
        lambda t, y: [-y[1], -y[1] / (3.0 * y[1] ** 2 + 1.0)], (0.0, 1.0), [2.0, 1.0], rtol=1e-10, atol=1e-12
    )
    theirs = solve_ivp(scipys, (0.0, 1.0), [2.0], rtol=1e-10, atol=1e-12).y[0, -1]
    assert run.dynamics.solution.y[0, -1] == pytest.approx(theirs, rel=1e-8)


def test_times_that_are_an_end_but_for_rounding_are_that_end() -> None:
    """Assert the states of both ends some spacings beyond them, and a refusal where a time is really outside."""
    solution = xd.solve(lambda t, y: [-y[0]], (0.0, 0.3), [1.0]).dynamics.solution
    grid = 0.1 * np.arange(4)
    assert grid[-1] > 0.3
    assert (solution.sol(grid)[:, -1] == solution.y[:, -1]).all()
    assert (solution.sol(-1e-17) == solution.y[:, 0]).all()
    with pytest.raises(xd.InputError, match="0.3000000001 s is outside the run"):
        solution.sol(0.3000000001)


def clipped(t: float, y: Any) -> Any:
    y[y < 0.0] = 0.0
    return -y


def doubled(t: float, y: Any) -> Any:
    y *= 2.0
    return -y


def held(t: float, y: Any) -> Any:
    y[0] = y[-1] = 0.0
    return np.concatenate(([0.0], y[2:] - 2.0 * y[1:-1] + y[:-2], [0.0]))


def cut(t: float, y: Any) -> Any:
    np.clip(y, 0.0, None, out=y)
    return -y


@pytest.mark.parametrize("size", [2, 12, 400])
@pytest.mark.parametrize("function", [clipped, doubled, held, cut])
def test_functions_that_write_into_their_argument_are_refused(function: Any, size: int) -> None:
    """Assert it of numbers with names, of a row, and of more than are written out, with the remedy, which works."""
    start = np.linspace(-1.0, 1.0, size)
    with pytest.raises(
        xd.InputError, match=rf"^{function.__name__} writes into its argument, y.*with y = np.array.y.,"
    ):
        xd.solve(function, (0.0, 1.0), start)
    if size == 2:
        run = xd.solve(lambda t, y: function(t, np.array(y)), (0.0, 0.5), start, rtol=1e-9)
        right = solve_ivp(lambda t, y: function(t, np.array(y)), (0.0, 0.5), start, "DOP853", rtol=1e-10, atol=1e-12)
        assert run.dynamics.solution.y[:, -1] == pytest.approx(right.y[:, -1], abs=1e-7)


def test_events_that_write_into_their_argument_are_refused() -> None:
    """Assert it, though the function of the rates leaves its own alone."""

    def through(t: float, y: Any) -> Any:
        y[0] = 0.0
        return y[1]

    with pytest.raises(xd.InputError, match=r"^through writes into its argument, y\[0\]"):
        xd.solve(lambda t, y: -y, (0.0, 1.0), [1.0, -1.0], events=through)


@pytest.mark.parametrize(
    ("function", "start", "end"),
    [
        (lambda t, y: [np.where(y[0] > 0, -1, 1)], [0.2], 0.0),
        (lambda t, y: [-np.sign(2 * y[0] - t)], [0.2], 0.5),
    ],
)
def test_motions_slide_along_their_switch(function: Any, start: Any, end: float) -> None:
    """Assert that a motion stays where either side drives it back to."""
    run = xd.solve(function, (0.0, 1.0), start, rtol=1e-8)
    assert run.attrs["run_outcome"] == "completed"
    assert float(run.y0[-1]) == pytest.approx(end, abs=1e-9)


@pytest.mark.parametrize(
    ("function", "start", "said"),
    [
        (lambda t, y: np.where(y > 0.5, -1, 1) * np.ones(12), np.arange(12) / 6 + 0.02, r"where y\[3\] = 0.5, "),
    ],
)
def test_motions_that_slide_name_their_switch(function: Any, start: Any, said: str) -> None:
    """Assert the two sides that are equal there, and elements as functions have them."""
    run = xd.solve(function, (0.0, 1.0), start, rtol=1e-8)
    assert re.search(said, run.attrs["run_outcome_text"])
