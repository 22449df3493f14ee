"""Switches that are infinite at the start, and first steps that pass over all that forces do there."""

from __future__ import annotations

import math

import pytest

import xdynamics as xd

LAWS = ("min(F, P/v_x)", "min(P/v_x, F)", "where(P/v_x < F, P/v_x, F)", "min(F, P/abs(v_x))", "min(F, P*(v_x/V)**-1/V)")


def car(law: str, speed: float = 0.0) -> xd.Model:
    """A car of 1 t whose motor gives 50 kW, and no more than 5 kN."""
    return xd.Model(
        name="car",
        parameters={"m": "1000 kg", "F": "5 kN", "P": "50 kW", "V": "1 m s-1"},
        coordinates={"x": "m"},
        mass={"x": "m"},
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
