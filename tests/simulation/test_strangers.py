"""What strangers to the package met first: a run that ends early, scipy's names, temperatures, angles of a section."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.interpolate import CubicSpline, interp1d

import xdynamics as xd


def fallen(**changes: object) -> xd.Model:
    """Return a mass that a drive pulls for two seconds."""
    parts = {
        "name": "pulled",
        "coordinates": {"x": "m"},
        "parameters": {"m": "1 kg"},
        "mass": {"x": "m"},
        "drives": {"pull": {"csv": "time [s],pull [N]\n0,0\n2,1\n", "argument": "t"}},
        "forces": {"pulling": {"x": "pull"}},
        "initial": {"x": "0 m", "v_x": "0 m s-1"},
    }
    return xd.Model(**{**parts, **changes})


@pytest.mark.parametrize("times", [None, [0.5, 1.0]])
def test_a_run_that_ends_early_warns(times: list[float] | None) -> None:
    """Assert a warning that names the model and why, also where states alone are asked for; none of a run that arrives."""
    with pytest.warns(
        xd.AccuracyWarning, match="^pulled did not reach the end that was asked for: outside drive table: at t"
    ):
        xd.simulate(fallen(), method="rk4", step="0.1 s", until="3 s", times=times)
    xd.simulate(fallen(), method="rk4", step="0.1 s", until="2 s", times=times)


def bouncing(_t: float, y: list[float]) -> list[float]:
    """Return the rates of a mass that is braked by the modulus of its speed."""
    return [y[1], -9.81 - 0.1 * y[1] * abs(y[1])]


def ground(_t: float, y: list[float]) -> float:
    """Return the height."""
    return y[0]


ground.direction = -1.0  # type: ignore[attr-defined]


def test_a_solution_has_what_scipys_has() -> None:
    """Assert times of the user's own events alone, counts, and values by name as of scipy's result."""
    span, start = (0.0, 3.0), [0.0, 10.0]
    theirs = solve_ivp(bouncing, span, start, "RK45", events=ground, rtol=1e-9, atol=1e-9)
    ours = xd.solve(bouncing, span, start, "RK45", events=ground, rtol=1e-9).dynamics.solution
    (times,) = ours.t_events
    assert times == pytest.approx(theirs.t_events[0], rel=1e-7)
    assert ours["t"] is ours.t
    assert ours.nfev > 50
    assert (ours.njev, ours.nlu) == (0, 0)
    assert {"t", "y", "sol", "t_events", "y_events", "nfev", "njev", "nlu", "status", "message"} <= {*ours.keys()}
    assert ours["success"] is True
    with pytest.raises(KeyError):
        ours["ts"]
    stiff = xd.solve(lambda t, y: [-1e4 * (y[0] - np.cos(t))], span, [0.0], "Radau", rtol=1e-6).dynamics.solution
    assert min(stiff.njev, stiff.nlu) > 0


def undefined(_t: float, y: list[float]) -> list[float]:
    """Return rates by a name that there is none of."""
    a = y[0]
    return [a * missing_rate]  # noqa: F821


def looping(_t: float, y: list[float]) -> list[float]:
    """Return a rate that a loop finds."""
    x = y[0]
    while x > 1:
        x = x - 1
    return [x]


@pytest.mark.parametrize(
    ("fun", "options", "said"),
    [
        (undefined, {}, r"NameError, line \d+, `return \[a \* missing_rate\].*`: name 'missing_rate'"),
        (looping, {}, "an event in the place of a loop that ends when a value is reached"),
        (lambda t, _y: [float(f"{t:.3f}")], {}, "prints or formats a value that is not known yet; leave that out"),
        (
            lambda t, _y: [[1, 2, 3][int(t)]],
            {},
            r"takes a number of a value that is not known yet, as float\(\), int\(\)",
        ),
        (lambda _t, y: [-y[0]], {"rtoll": 1e-6}, "solve has no 'rtoll'; did you mean 'rtol'"),
    ],
)
def test_what_a_function_may_not_do_is_told_with_its_line(fun: Any, options: dict[str, Any], said: str) -> None:
    """Assert the user's own line of an error, the remedy of a loop, and keywords under the verb's own name."""
    with pytest.raises(xd.InputError, match=said):
        xd.solve(fun, (0.0, 1.0), [2.0], **options)


@pytest.mark.parametrize(
    ("fill", "after"), [((0.0, 0.0), 0.0), ((1.0, 3.0), 3.0), ("extrapolate", None), ((7.0, 7.0), None)]
)
@pytest.mark.parametrize("kind", ["previous", "linear", "cubic"])
@pytest.mark.parametrize("start", [0.0, 0.5, 4.5])
def test_an_interpolator_keeps_what_it_is_beyond_its_table(
    kind: str, fill: Any, after: float | None, start: float
) -> None:
    """Assert scipy's integral where it is 0 or holds beyond the table, and an early end where a drive has no such rule.

    The start is at a point, between two, and beyond the last, where there is no table to begin in without a rule.
    """
    times, values = np.array([0.0, 1.0, 2.0, 3.0, 4.0]), np.array([1.0, 4.0, 2.0, 5.0, 3.0])
    table = interp1d(times, values, kind=kind, bounds_error=False, fill_value=fill)
    if after is None:
        if start < 4.0:
            with pytest.warns(xd.AccuracyWarning, match="outside drive table"):
                xd.solve(lambda t, _y: [table(t)], (start, 6.0), [0.0], rtol=1e-9)
        return
    run = xd.solve(lambda t, _y: [table(t)], (start, 6.0), [0.0], rtol=1e-9)
    assert (run.attrs["run_outcome"], float(run.time[-1])) == ("completed", 6.0)
    ends = np.unique([start, *times[times > start], 6.0])
    expected = sum(quad(table, *pair)[0] for pair in pairwise(ends))
    assert run.dynamics.solution.y[0, -1] == pytest.approx(expected, rel=1e-8)
    within = {"previous": 12.0, "linear": 13.0, "cubic": CubicSpline(times, values).integrate(0.0, 4.0)}[kind]
    assert start > 0.0 or expected == pytest.approx(float(within) + 2.0 * after, rel=1e-12)


@pytest.mark.parametrize("word", ["celsius", "degC", "centigrade"])
def test_a_temperature_in_an_expression_is_written_in_kelvin(word: str) -> None:
    """Assert the line to write."""
    with pytest.raises(
        xd.ModelError, match=rf"name '{word}' .*; a temperature is written in kelvin: 20 °C is 293\.15\*kelvin"
    ):
        fallen(events={"warm": {"function": f"x/metre*kelvin - 20*{word}"}})


def test_angles_of_a_bifurcation_diagram_are_wrapped() -> None:
    """Assert that a diagram of an angle that its model wraps lies within half a turn."""
    model = xd.Model(
        name="turning",
        coordinates={"theta": "rad"},
        parameters={"I": "1 kg m2", "w": "7 rad s-1"},
        mass={"theta": "I"},
        forces={},
        events={"section": {"every": "1 s"}},
        initial={"theta": "0 rad", "v_theta": "7 rad s-1"},
        figure={"wrap": ["theta"]},
    )
    keep = {"keep": ["after_section_theta"], "occurrences": 5}
    grid = xd.sweep(model, {"v_theta": "5:9:5 rad s-1"}, method="rk4", step="0.1 s", until="6 s", **keep)
    assert float(grid.after_section_theta.max()) > 20.0
    (axes,) = [axes for axes in xd.plot(grid).axes if "bifurcation" in axes.get_title(loc="left")]
    drawn = np.concatenate([line.get_ydata() for line in axes.lines])
    assert np.nanmax(np.abs(drawn)) <= np.pi * (1 + 1e-12)
