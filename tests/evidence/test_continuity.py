"""Whether each step of a record, recomputed, leads to the row that follows."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.chunked import chunked
from cases.problems import MODELS, free
from xdynamics.evidence.diagnosing import continuity
from xdynamics.evidence.diagnosing.diagnosis import diagnosis_lines

PASSED, FAILED, NOT_CHECKED = range(3)
WALL = """
[events.wall]
function = "x - 2.5*metre"
direction = "rising"
action = "record"
root_state = "interpolant"
"""


def diagnosed(run: xr.Dataset) -> xr.Dataset:
    """Diagnose a run without another."""
    return xd.diagnose(run, companion=False)


def changed(run: xr.Dataset, name: str, place: Any, factor: float) -> xr.Dataset:
    """Return a record with one number multiplied."""
    numbers = run[name].values.copy()
    numbers[place] *= factor
    return run.assign({name: run[name].copy(data=numbers)})


@pytest.mark.every(3)
@pytest.mark.parametrize("method", xd.METHODS)
def test_steps_of_every_method_lead_to_their_next_rows(method: str) -> None:
    """Assert that the largest defect is of rounding; and that a velocity a billionth off is seen, where it is."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    asked = {"rtol": 1e-9} if method in ("radau_iia", "taylor") else {"step": "10 ms"}
    try:
        run = xd.simulate(model, method=method, until="2 s", **asked)
    except xd.InputError:
        pytest.skip("the method is not for this model")
    found = diagnosed(run)
    assert found.continuity_verdict == PASSED
    assert found.continuity_steps == np.count_nonzero(np.diff(run.time) > 0)
    assert found.continuity_defect_theta <= found.continuity_bound_theta < 1e-8
    other = diagnosed(changed(run, "v_theta", 9, 1 + 1e-6))
    assert other.continuity_verdict == FAILED
    assert float(other.continuity_time) in run.time.values[8:10]


def test_a_changed_velocity_is_off_by_its_change_and_moves_the_position_by_it() -> None:
    """Assert the closed form of a free particle: of the step to the row its change, of that from it h times as much."""
    run = xd.simulate(free().model, method="velocity_verlet", step="125 ms", until="2 s")
    found = diagnosed(run)
    assert (found.continuity_verdict, found.continuity_defect_x, found.continuity_defect_v_x) == (PASSED, 0.0, 0.0)
    found = diagnosed(changed(run, "v_x", 6, 1 + 2.0**-40))
    assert found.continuity_verdict == FAILED
    assert found.continuity_defect_v_x == 3 * 2.0**-40
    assert found.continuity_defect_x == pytest.approx(3 * 2.0**-40 / 8, rel=1e-3, abs=0)
    assert found.continuity_bound_v_x < 1e-13
    assert float(found.continuity_time) in (0.625, 0.75)
    (line,) = (line for line in diagnosis_lines(found) if "continuity" in line)
    assert "attention: continuity failed: each of 16 steps was recomputed; that from t = 0." in line
    assert "2.73e-12 m s-1 away from the next row in v_x" in line


@pytest.mark.parametrize(
    "name", ["stack of contacts", "toda_chain", "bouncing_ball", "stick_slip_belt", "rocket_c6", "cart_pid"]
)
def test_contacts_frictions_regimes_and_controllers(name: str) -> None:
    """Assert that rows on both sides of events are led to and gone on from, and that a changed one is seen and named."""
    more = {"log": "full", "until": "0.3 s"} if name == "stack of contacts" else {}
    name = "granular_box" if more else name
    run = xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), **more)
    assert diagnosed(run).continuity_verdict == PASSED
    kind = [str(v) for v in run.data_vars if run[v].attrs.get("role") == "velocity"][-1]
    row = int(run.event_row_after[0]) if run.sizes["event"] else 50
    place = (row, *(0,) * (run[kind].ndim - 1))
    run = run.assign({kind: run[kind].copy(data=run[kind].values.copy())})
    run[kind].values[place] += 1e-8
    assert diagnosed(run).continuity_verdict == FAILED


def test_steps_to_events_on_interpolants_are_left_out() -> None:
    """Assert that the state there, which no step of the method reaches, does not speak against the record."""
    model = xd.Model.from_text(free().model.to_toml() + WALL)
    run = xd.simulate(model, method="rk4", step="70 ms", until="1 s")
    found = diagnosed(run)
    assert (found.continuity_verdict, found.continuity_steps) == (PASSED, np.count_nonzero(np.diff(run.time) > 0) - 1)
    assert found.attrs["continuity_rule"].endswith("was recomputed, but those to events on interpolants")


def test_of_long_runs_some_steps_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that they are spread over the run, ends included, and counted."""
    run = xd.simulate(free().model, method="rk4", step="10 ms", until="10 s")
    monkeypatch.setattr(continuity, "MOST_NUMBERS", 200)
    found = diagnosed(run)
    assert found.continuity_steps == 100
    assert found.attrs["continuity_rule"] == "100 of 1000 steps, evenly spread, were recomputed"
    for row in (0, 1000):
        assert diagnosed(changed(run, "x", row, 1 + 1e-9)).continuity_verdict == FAILED


def test_chunks_and_a_run_without_a_step() -> None:
    """Assert that chunks change nothing, and that where there is no step nothing is judged."""
    run = xd.simulate(free().model, method="rk4", step="10 ms", until="1 s")
    found = diagnosed(run.isel(step=slice(1)))
    assert (found.continuity_verdict, found.continuity_steps) == (NOT_CHECKED, 0)
    assert found.attrs["continuity_rule"] == "there is no step to recompute"
    assert np.isnan(found.continuity_defect_x)
    other = changed(run, "x", 40, 1 + 1e-12)
    whole, parts = (diagnosed(own) for own in (other, chunked(other, [30, 30, 41])[0]))
    assert whole.continuity_verdict == FAILED
    for name in ("continuity_defect_x", "continuity_bound_v_x", "continuity_time", "continuity_steps"):
        assert whole[name].values.tobytes() == parts[name].values.tobytes()


def test_sums_of_two_floats() -> None:
    """Assert that a rest that is off by less than a float tells is seen."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    run = xd.simulate(model, method="rk4", step="10 ms", until="0.5 s", precision="double_double")
    found = diagnosed(run)
    assert found.continuity_verdict == PASSED
    assert found.continuity_bound_x < 1e-28
    assert diagnosed(changed(run, "rest_x", 20, 1 + 1e-9)).continuity_verdict == FAILED
