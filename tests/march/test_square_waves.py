"""Square waves and other laws whose switch jumps over zero: passages, and no motion along a switch."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.expressions import parse
from xdynamics.model.kinks import kinks, original_call

PERIOD, TAU, HIGH = 2e-3, 1e-2, 12.0
WAVES = {
    "mod": "where(mod(t, T) < T/2, U, 0*volt)",
    "floor": "where(t/T - floor(t/T) < 0.5, U, 0*volt)",
    "ceil": "where(ceil(t/T) - t/T > 0.5, U, 0*volt)",
    "round": "where(t/T - round(t/T) < 0, 0*volt, U)",
    "parity": "U*mod(floor(2*t/T) + 1, 2)",
    "sine": "where(sin(2*pi*t/T) > 0, U, 0*volt)",
}
CHOSEN = ("dormand_prince", "dop853", "taylor", "radau_iia", "bogacki_shampine")
GIVEN = ("rk4", "taylor", "radau_iia")


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
@pytest.mark.parametrize("method", CHOSEN)
def test_a_square_wave_charges_a_capacitor(method: str, wave: str) -> None:
    """Assert the closed form at the end of the tenth period, where the last step is as long as a period."""
    run = xd.simulate(circuit(WAVES[wave]), method=method, rtol=1e-11, until="20 ms")
    assert run.attrs["run_outcome"] == "completed"
    assert float(run["u"][-1]) == pytest.approx(charge(20), abs=1e-9)


@pytest.mark.parametrize("method", GIVEN)
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
