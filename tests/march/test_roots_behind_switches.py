"""Forces with a root or a broken power behind a switch: finite for every state, and marched through every switch.

Switches that are infinite at the start, and first steps that pass over all that forces do there.
Adaptive marches along a switch, of which there are too many to be located, end soon and say so.
Which last passages of a switch are a motion that rests on it.
Square waves and other laws whose switch jumps over zero: passages, and no motion along a switch.
"""

from __future__ import annotations

import math
from itertools import accumulate
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from tests.cases.rooted_laws import random_case

import xdynamics as xd
from cases.problems import particle
from xdynamics.expressions import parse, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import AccuracyWarning
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.unlocated_switches import CLOSE, NOWHERE, PASSAGES, SMALL, STEPS, chattering
from xdynamics.model.detectors import SWITCH
from xdynamics.model.kinks import kinks, on_sides, original_call

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
    return particle(
        name="ball",
        parameters={"m": "1 kg", "g": "9.81 m s-2", "k": "1e6 N", "L": "1 m"},
        forces={"gravity": {"x": "-m*g"}, "contact": contact},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )


def slide(law: str, speed: str = "1 m s-1") -> xd.Model:
    """A body of 1 kg that a drag slows down."""
    return particle(
        name="slide",
        parameters={"m": "1 kg", "V": "1 m s-1", "D": "1 N"},
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


LAWS = ("min(F, P/v_x)", "min(P/v_x, F)", "where(P/v_x < F, P/v_x, F)", "min(F, P/abs(v_x))", "min(F, P*(v_x/V)**-1/V)")


def car(law: str, speed: float = 0.0) -> xd.Model:
    """A car of 1 t whose motor gives 50 kW, and no more than 5 kN."""
    return particle(
        name="car",
        parameters={"m": "1000 kg", "F": "5 kN", "P": "50 kW", "V": "1 m s-1"},
        forces={"drive": {"x": law}},
        initial={"x": "0 m", "v_x": f"{speed} m s-1"},
    )


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("method", ["dormand_prince", "taylor", "radau_iia", "rk4"])
def test_a_car_starts_from_rest_by_its_power(method: str, law: str) -> None:
    """Assert 10 m/s after 2 s by the force, and the speed by the power from there on, where the power is infinite at rest."""
    steps = {"step": "10 ms"} if method == "rk4" else {"rtol": 1e-9}
    run = xd.simulate(car(law), method=method, until="20 s", **steps)
    assert run.attrs["run_outcome"] == "completed"
    assert float(run["event_time"][0]) == pytest.approx(2.0, abs=1e-8)
    assert float(run["v_x"][-1]) == pytest.approx(math.sqrt(100 + 2 * 50 * 18), abs=1e-6)
    assert float(run["x"][-1]) == pytest.approx(10 + (1900**1.5 - 1000) / 150, abs=1e-4)


def test_a_switch_without_a_value_at_the_start_is_named() -> None:
    """Assert the name of the switch and its value, where 0/0 decides on which side it is."""
    run = xd.simulate(car("where(v_x/(x/second) > 1, F, 2*F)"), method="rk4", step="10 ms", until="1 s")
    assert run.attrs["run_outcome"] == "nonfinite_event"
    assert "the function of the switch 'drive.where' is nan" in run.attrs["run_outcome_text"]


def test_a_first_step_over_all_that_forces_do_is_doubted() -> None:
    """Assert that a speed of 166,667 m/s from a pole beside the start is no success in silence, and that others are."""
    with (
        pytest.warns(xd.AccuracyWarning, match="5e\\+11 times as long"),
        pytest.warns(xd.StabilityWarning, match="0.01 s"),
    ):
        run = xd.simulate(car("P/v_x", 1e-6), method="rk4", step="10 ms", until="1 s")
    assert "the first step is 5e+11 times" in run.attrs["run_outcome_text"]
    resolved = xd.simulate(car("P/v_x", 1.0), method="rk4", step="10 ms", until="1 s")
    assert resolved.attrs["run_outcome_text"] == "reached t = 1 s"


RELAYS = """
name = "relays"
[dimensions]
relay = 41
[states.y]
unit = "1"
dims = ["relay"]
rate = "{rate}"
[initial]
y = "0.1 + index(relay)"
"""


def relays(rate: str) -> xd.Model:
    """Forty-one states, one more switch than is located."""
    return xd.Model.from_text(RELAYS.format(rate=rate))


def test_sliding_ends_soon() -> None:
    """Assert that a state driven to its switch from both sides ends the run there within a few hundred rows."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(relays("where(y > 0, -1, 1)/second"), method="dormand_prince", rtol=1e-6, until="2 s")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert "the last 64 steps went to and fro across it" in run.attrs["run_outcome_text"]
    assert "- 0 = 0" not in run.attrs["run_outcome_text"]
    assert run.sizes["step"] < 2000
    assert 0.1 <= run.time.values[-1] < 0.12
    assert abs(run.y.values[-1, 0]) < 1e-4


def test_motion_through_switches_goes_on() -> None:
    """Assert that states which oscillate across their switches reach the end."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(
            relays("where(y > 0, 2, 1)*cos(40*t/second)/second"), method="dormand_prince", rtol=1e-6, until="2 s"
        )
    assert run.attrs["run_outcome"] == "completed"


DRIVEN_BACK = "where(y > 0, -k, 1)/second"  # from above k times as fast as from below


def driven_back(k: float) -> xd.Model:
    """Forty-one states that are driven to their switches from both sides."""
    return xd.Model.from_text(RELAYS.format(rate=DRIVEN_BACK) + f'[parameters]\nk = "{k}"\n')


@pytest.mark.parametrize("k", [0.01, 5.0, 1000.0])
def test_sliding_is_seen_from_one_side(k: float) -> None:
    """Assert that motion ends also where steps land on one side alone, as it is driven back with other speed there."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(driven_back(k), method="dormand_prince", rtol=1e-6, until="20 s", max_steps=5000)
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert run.sizes["step"] == 128
    assert abs(run.y.values[-1, 0]) < 1e-4


ALTERNATING = 1e-6 * (-0.9) ** np.arange(2 * STEPS)
SAWTOOTH = 1e-6 * (np.arange(2 * STEPS) % 5 - 5.0)  # as where an event sets it back


@pytest.mark.parametrize(
    ("rate", "values", "slides"),
    [
        ("-1000*y/second", ALTERNATING, False),
        ("-1000*y/second - sign(y)/second", ALTERNATING, True),
        ("1/second", SAWTOOTH, False),
        ("where(y > 0, -1, -1000*y)/second", SAWTOOTH, False),
        ("where(y > 0, -1, 1)/second", SAWTOOTH, True),
    ],
)
def test_speeds_tell_sliding(rate: str, values: np.ndarray, slides: bool) -> None:
    """Assert that states which return to a switch slide only where they meet it with a speed and are driven back."""
    model = xd.Model.from_text(RELAYS.format(rate=f"{rate} + 0*sign(y)/second"))
    march = March(model, settings_for(model, method="dormand_prince", rtol=1e-6, until="1 s"))
    rows = np.empty((2 + 41, 2 * STEPS))
    rows[0], rows[1], rows[2:] = np.arange(2 * STEPS) * 1e-3, 1e-3, values
    assert (march.passages.sliding(march.run, rows, 0) is not None) == slides


@pytest.mark.filterwarnings("ignore:41 switches")
def test_sliding_members_end() -> None:
    """Assert that members of a sweep end as each does alone, to the bit, and the one that does not slide completes."""
    axes = {"k": [-1.0, 2.0, 30.0]}
    sweep = xd.sweep(driven_back(1.0), axes=axes, method="dormand_prince", rtol=1e-6, until="0.3 s", check=1.0)
    computed = sweep.compute()
    assert computed.run_outcome.values.tolist() == ["completed", "sliding_mode", "sliding_mode"]
    assert computed.run_accepted_steps.values[1:].tolist() == [127, 127]


def test_a_march_that_goes_on_ends_where_the_whole_does() -> None:
    """Assert that a march put down among its last rows, and taken up again, ends with the same number of rows."""
    model = driven_back(30.0)
    settings = settings_for(model, method="dormand_prince", rtol=1e-6, until="2 s")
    first, rest = March(model, settings), March(model, settings)
    before = next(rows for rows in accumulate(block.rows for block in first.blocks(40)) if rows > 64)
    rest.go_on_from(first.memory())
    assert before + sum(block.rows for block in rest.blocks(40)) == 128
    assert rest.outcome.word == "sliding_mode"


DETECTORS = np.array([(SWITCH + 1, 1.0), (SWITCH, 1.0)], dtype=[("role", int), ("tolerance", float)])


def passages(count: int = PASSAGES, pause: float = CLOSE, slope: float = 1.0) -> Any:
    """Passages of the switch, with a pause between two of them, and an uncertainty of 1 of its function."""
    events = np.zeros(count, dtype=[(name, float) for name in ("time", "slope", "uncertainty")] + [("detector", int)])
    events["time"], events["slope"], events["uncertainty"] = pause * np.arange(count), slope, 1.0
    events["detector"] = 1
    return events


@pytest.mark.parametrize(("pause", "slope"), [(CLOSE, 1e9), (1e6, -4.0 * SMALL / 1e6), (0.0, 1e9)])
def test_passages_within_what_is_resolved_rest_on_the_switch(pause: float, slope: float) -> None:
    """Assert the borders: pauses of so many tolerances, and values of so many uncertainties."""
    assert chattering(DETECTORS, passages(pause=pause, slope=slope)) == 1


def test_other_passages_do_not() -> None:
    """Assert that few, those with one long pause, those of two switches, and those of no switch are none."""
    long, mixed, other = passages(slope=1e9), passages(), passages()
    long["time"][-1] += 1.0
    mixed["detector"][3] = other["detector"] = 0
    for events in (passages(PASSAGES - 1), long, mixed, other, passages(0)):
        assert chattering(DETECTORS, events) == NOWHERE


PERIOD, TAU, HIGH = 2e-3, 1e-2, 12.0
WAVES = {
    "mod": "where(mod(t, T) < T/2, U, 0*volt)",
    "floor": "where(t/T - floor(t/T) < 0.5, U, 0*volt)",
    "ceil": "where(ceil(t/T) - t/T > 0.5, U, 0*volt)",
    "round": "where(t/T - round(t/T) < 0, 0*volt, U)",
    "parity": "U*mod(floor(2*t/T) + 1, 2)",
    "sine": "where(sin(2*pi*t/T) > 0, U, 0*volt)",
}
CHOSEN_STEPS = ("dormand_prince", "dop853", "taylor", "radau_iia", "bogacki_shampine")
GIVEN_STEPS = ("rk4", "taylor", "radau_iia")


def circuit(wave: str) -> xd.Model:
    """A capacitor that is charged through a resistor by a square wave."""
    return xd.Model(
        name="circuit",
        parameters={"U": "12 V", "T": "2 ms", "tau": "10 ms"},
        states={"u": {"unit": "V", "rate": f"({wave} - u)/tau"}},
        initial={"u": "0 V"},
    )


def charge(halves: int) -> float:
    """Return the voltage after some half periods, V, in closed form."""
    u = 0.0
    for k in range(halves):
        level = HIGH * (k % 2 == 0)
        u = level + (u - level) * float(np.exp(-PERIOD / 2 / TAU))
    return u


@pytest.mark.every(4)
@pytest.mark.parametrize("wave", WAVES)
@pytest.mark.parametrize("method", CHOSEN_STEPS)
def test_a_square_wave_charges_a_capacitor(method: str, wave: str) -> None:
    """Assert the closed form at the end of the tenth period, where the last step is as long as a period."""
    run = xd.simulate(circuit(WAVES[wave]), method=method, rtol=1e-11, until="20 ms")
    assert run.attrs["run_outcome"] == "completed"
    assert float(run["u"][-1]) == pytest.approx(charge(20), abs=1e-9)


@pytest.mark.parametrize("method", GIVEN_STEPS)
def test_given_steps_end_at_the_edges(method: str) -> None:
    """Assert the closed form where no grid time is an edge."""
    run = xd.simulate(circuit(WAVES["mod"]), method=method, step="0.03 ms", until="21 ms")
    assert float(run["u"][-1]) == pytest.approx(charge(21), abs=1e-9)


@pytest.mark.parametrize("method", ["dop853", "taylor"])
def test_a_switch_that_is_zero_at_both_ends_of_a_step_and_between_is_passed(method: str) -> None:
    """Assert every edge of a sine in time, also those in the middle of the last step."""
    for until in range(2, 14):
        run = xd.simulate(circuit(WAVES["sine"]), method=method, rtol=1e-11, until=f"{until} ms")
        edges = np.arange(1, until + (run["event_time"].size == until)) * 1e-3
        assert np.allclose(run["event_time"], edges, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", ["dormand_prince", "taylor", "radau_iia", "rk4"])
def test_an_angle_turns_through_whole_turns(method: str) -> None:
    """Assert that a torque by the side of a turn speeds a wheel up and slows it down, by energies at whole turns."""
    wheel = xd.Model(
        name="wheel",
        parameters={"J": "1 kg m2", "M": "1 N m"},
        coordinates={"q": "rad"},
        mass={"q": "J"},
        forces={"motor": {"q": "where(mod(q, 2*pi) < pi, M, -M)"}},
        initial={"q": "0.1 rad", "v_q": "5 rad s-1"},
    )
    steps = {"step": "1 ms"} if method == "rk4" else {"rtol": 1e-9}
    run = xd.simulate(wheel, method=method, until="10 s", **steps)
    assert run.attrs["run_outcome"] == "completed"
    turn = np.mod(run["q"].to_numpy(), 2 * np.pi)
    risen = np.minimum(turn, 2 * np.pi - turn)  # of the potential, a triangle of the angle
    energy = run["v_q"].to_numpy() ** 2 / 2 - risen
    assert np.allclose(energy, energy[0], atol=1e-6)


@pytest.mark.parametrize("method", ["dormand_prince", "radau_iia", "taylor"])
def test_motion_driven_back_to_a_jump_slides_and_shows_what_was_written(method: str) -> None:
    """Assert that a state which both sides drive to a whole number ends there, and that no sine is named."""
    stair = xd.Model(
        name="stair",
        parameters={"L": "1 m"},
        states={"x": {"unit": "m", "rate": "where(mod(x, L) < L/2, -1, 1)*metre/second"}},
        initial={"x": "0.3 m"},
    )
    run = xd.simulate(stair, method=method, rtol=1e-9, until="1 s")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert float(run["time"][-1]) == pytest.approx(0.3, abs=1e-9)
    assert "where mod(x, L) does" in run.attrs["run_outcome_text"]
    assert "sin(" not in run.attrs["run_outcome_text"]


@pytest.mark.parametrize(
    "text", ["floor(t/T)", "ceil(2*t - 1)", "ceil(-t)", "round(x)", "mod(t, T)", "mod(a + b, 3*c)"]
)
def test_the_call_is_known_from_its_sine(text: str) -> None:
    """Assert the call as it was written, from the function that passes through zero where it jumps."""
    *_, (name, function, *_) = kinks(parse(text))
    assert original_call(name, function) == parse(text)
