"""Forces with a root or a broken power behind a switch: finite for every state, and marched through every switch."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.cases.rooted_laws import random_case

import xdynamics as xd
from xdynamics.expressions import parse, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.kinks import kinks, on_sides

HERTZ = {
    "max": {"x": "k*(max(-x, 0*metre)/L)**1.5"},
    "where": {"x": "where(x < 0*metre, k*(-x/L)**1.5, 0*newton)"},
    "abs": {"x": "k*((abs(x) - x)/2/L)**1.5"},
    "potential": {"potential": "k*L/2.5*(max(-x, 0*metre)/L)**2.5"},
}
CHOSEN = ("dormand_prince", "dop853", "radau_iia", "taylor")
GIVEN = {"rk4": 1e-3, "velocity_verlet": 1e-3, "implicit_midpoint": 1e-3}


def ball(contact: dict[str, str]) -> xd.Model:
    """A ball of 1 kg that falls from 1 m."""
    return xd.Model(
        name="ball",
        parameters={"m": "1 kg", "g": "9.81 m s-2", "k": "1e6 N", "L": "1 m"},
        coordinates={"x": "m"},
        mass={"x": "m"},
        forces={"gravity": {"x": "-m*g"}, "contact": contact},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )


def slide(law: str, speed: str = "1 m s-1") -> xd.Model:
    """A body of 1 kg that a drag slows down."""
    return xd.Model(
        name="slide",
        parameters={"m": "1 kg", "V": "1 m s-1", "D": "1 N"},
        coordinates={"x": "m"},
        mass={"x": "m"},
        forces={"drag": {"x": law}},
        initial={"x": "0 m", "v_x": speed},
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("law", HERTZ)
@pytest.mark.parametrize("method", CHOSEN)
def test_a_ball_bounces_on_the_contact_of_hertz(method: str, law: str) -> None:
    """Assert the place and speed at 3 s, after three bounces, however the law is written."""
    run = xd.simulate(ball(HERTZ[law]), method=method, rtol=1e-11, until="3 s")
    assert run.attrs["run_outcome"] == "completed"
    assert float(run["x"][-1]) == pytest.approx(0.66267798, abs=3e-8)
    assert float(run["v_x"][-1]) == pytest.approx(-2.57259751, abs=7e-8)


@pytest.mark.parametrize("method", GIVEN)
def test_given_steps_pass_the_contact_too(method: str) -> None:
    """Assert the end within the error of the step."""
    run = xd.simulate(ball(HERTZ["max"]), method=method, step="0.1 ms", until="3 s")
    assert run.attrs["run_outcome"] == "completed"
    assert float(run["x"][-1]) == pytest.approx(0.66267798, abs=GIVEN[method])


@pytest.mark.parametrize("law", ["-D*sign(v_x)*sqrt(abs(v_x)/V)", "where(v_x > 0*V, -D*sqrt(v_x/V), D*sqrt(-v_x/V))"])
@pytest.mark.parametrize("method", [*CHOSEN, "rk4", "forward_euler", "implicit_midpoint"])
def test_a_drag_by_the_root_brings_to_rest(method: str, law: str) -> None:
    """Assert rest from 2 s on at 2/3 m: of a force that is zero there, and no motion along a switch."""
    steps = {"rtol": 1e-9} if method in CHOSEN else {"step": "1 ms"}
    run = xd.simulate(slide(law), method=method, until="3 s", **steps)
    assert run.attrs["run_outcome"] == "completed"
    assert float(run["x"][-1]) == pytest.approx(2 / 3, abs=1e-3 if method == "forward_euler" else 1e-6)
    assert abs(float(run["v_x"][-1])) < 1e-8


@pytest.mark.parametrize("method", CHOSEN)
def test_a_tank_runs_empty(method: str) -> None:
    """Assert Torricelli's law: the level is a parabola of time, and zero from then on."""
    tank = xd.Model(
        name="tank",
        parameters={"a": "0.1", "g": "9.81 m s-2"},
        states={"h": {"unit": "m", "rate": "-a*sqrt(2*g*max(h, 0*metre))"}},
        initial={"h": "1 m"},
    )
    run = xd.simulate(tank, method=method, rtol=1e-10, until="6 s")
    assert run.attrs["run_outcome"] == "completed"
    full = np.maximum(1 - 0.1 * np.sqrt(9.81 / 2) * run["time"].to_numpy(), 0.0) ** 2
    assert np.allclose(run["h"], full, atol=1e-8)


def test_a_force_without_a_value_is_named_with_its_value_and_a_remedy() -> None:
    """Assert that a base which is negative beyond doubt still ends a run, in words."""
    run = xd.simulate(slide("-D*((1 - min(x, 9*metre)/metre))**1.5", "3 m s-1"), method="rk4", step="1 ms", until="3 s")
    assert run.attrs["run_outcome"] == "nonfinite_force"
    text = run.attrs["run_outcome_text"]
    assert "(1 - min(x, 9*metre)/metre)**1.5 has no value where 1 - min(x, 9*metre)/metre = -" in text
    assert "bound its argument with max" in text


@pytest.mark.parametrize(
    ("text", "held", "x", "value"),
    [
        ("max(-x, 0)**1.5", 1.0, 1e-9, 0.0),
        ("max(-x, 0)**1.5", 1.0, -4.0, 8.0),
        ("sqrt(abs(x))", 1.0, -1e-9, 0.0),
        ("where(x < 0, sqrt(-x), 0)", -1.0, 1e-9, 0.0),
        ("where(x < 0, acos(1 + x), 0)", -1.0, 1e-9, 0.0),
        ("where(x > 0, x*log(x), 0)", 1.0, 0.0, 0.0),
    ],
)
def test_a_held_side_keeps_the_value_at_its_end(text: str, held: float, x: float, value: float) -> None:
    """Assert values on the side that is held and beyond it."""
    tree = parse(text)
    sides = {function: "s" for _, function, *_ in kinks(tree)}
    assert evaluate(on_sides(tree, sides), {"x": x, "s": held}) == pytest.approx(value)


def test_a_base_that_is_negative_on_its_own_side_stays_without_a_value() -> None:
    """Assert nan where the side holds and the base is negative all the same."""
    tree = parse("where(x < 1, (-x)**1.5, 0)")
    held = on_sides(tree, {function: "s" for _, function, *_ in kinks(tree)})
    assert np.isnan(evaluate(held, {"x": 0.5, "s": -1.0}))
    assert evaluate(held, {"x": 1.5, "s": -1.0}) == 0.0, text_of(held)


@pytest.mark.cases(500)
def test_random_laws_are_marched_as_if_they_were_smooth(case: int) -> None:
    """Assert the end of a run with located switches against one whose steps pass over them, at 1e-11; some by scipy."""
    law = random_case(case)
    run = xd.simulate(law.model(), method=law.method, rtol=1e-10, until="3 s", max_steps=200_000)
    assert run.attrs["run_outcome"] == "completed", law
    smooth = xd.simulate(law.model(smooth=True), method="dop853", rtol=1e-11, until="3 s", max_steps=400_000)
    assert np.allclose(run["x"][-1], smooth["x"][-1], atol=1e-6), law
    if law.kind == "states":
        other = solve_ivp(law.slopes(), (0.0, 3.0), law.start, method="DOP853", rtol=1e-9, atol=1e-10)
        assert float(run["x"][-1]) == pytest.approx(other.y[0, -1], abs=1e-6), law
