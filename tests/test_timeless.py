"""Models whose time is a pure number: `[time] unit = "1"`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call

LORENZ: dict[str, Any] = {
    "name": "Lorenz",
    "time": {"unit": "1"},
    "parameters": {"s": "10", "r": "28", "b": "2.6666666666666665"},
    "states": {
        "x": {"unit": "1", "rate": "s*(y - x)"},
        "y": {"unit": "1", "rate": "x*(r - z) - y"},
        "z": {"unit": "1", "rate": "x*y - b*z"},
    },
    "initial": {"x": 1, "y": 1, "z": 1},
    "events": {"up": {"function": "x", "direction": "rising", "time_tolerance": "1e-9"}},
    "run": {"method": "dop853", "rtol": 1e-10, "until": "15"},
}
BOUNCING: dict[str, Any] = {
    "name": "bouncing",
    "time": {"unit": "1"},
    "coordinates": {"y": "1"},
    "mass": {"y": "1"},
    "forces": {"weight": {"potential": "y"}},
    "contacts": {"floor": {"gap": "y", "restitution": 0.5}},
    "initial": {"y": "0.5"},
    "run": {"method": "dop853", "rtol": 1e-9, "until": "2.5"},
}


@pytest.mark.dear
def test_no_number_has_a_second(tmp_path: Path) -> None:
    """Assert units without s, bits from the file alone, and the states of the same equations in seconds."""
    model = xd.Model(**LORENZ)
    assert xd.Model.from_text(model.to_toml()) == model
    run = xd.simulate(model)
    assert not [name for name, variable in run.variables.items() if "s" in str(variable.attrs.get("units", "")).split()]
    assert run.attrs["run_outcome_text"] == "reached t = 15"
    assert {attr for key, attr in run.attrs.items() if key.startswith("solver_") and key.endswith("_units")} == {"1"}
    assert xd.reproduce(xd.save(run, tmp_path / "lorenz.nc")).attrs["identical"] == 1

    def right(_: Any, y: Any) -> Any:
        return [10 * (y[1] - y[0]), y[0] * (28 - y[2]) - y[1], y[0] * y[1] - 2.6666666666666665 * y[2]]

    other = xd.solve(right, (0, 15), [1, 1, 1], "dop853", rtol=1e-10)
    assert float(run.x[-1]) == pytest.approx(float(other.y0[-1]), rel=1e-4)
    assert xd.sample(run, "0:15:4").at_time.attrs["units"] == "1"
    assert "at t = " in call("show", tmp_path / "lorenz.nc").output
    assert " s:" not in call("show", tmp_path / "lorenz.nc").output


def test_motion_contacts_and_evidence() -> None:
    """Assert a bounce by its closed form, energies without a unit, and stages on it."""
    model = xd.Model(**BOUNCING)
    run = xd.simulate(model)
    assert float(run.event_time[0]) == pytest.approx(1.0, rel=1e-12)
    assert (run.v_y.attrs["units"], run.a_y.attrs["units"], run.total_energy.attrs["units"]) == ("1", "1", "1")
    assert float(run.event_energy_lost[0]) == pytest.approx(0.375, rel=1e-9)
    start = next(line for line in repr(run.dynamics).splitlines() if line.startswith("energy"))
    change = float(run.total_energy[-1] - run.total_energy[0])
    assert start == f"energy    0.5 at the start, band {-change:.3g}, end minus start {change:.3g}"
    study = xd.refine(model, rtols=[1e-4, 1e-6, 1e-8], at=[0.5])
    assert float(study.y[-1, 0]) == pytest.approx(0.375, rel=1e-9)
    budget = xd.error_budget(model.replace(initial={"y": "0.5 ± 0.001"}), "t", event="floor")
    assert float(budget.sensitivity[4]) == pytest.approx(1.0, rel=1e-9)
    rounding = float(budget.standard_uncertainty[budget.term_name.values.tolist().index("roundoff")])
    assert 0.0 < rounding < 1e-14
    found = xd.sweep(model, {"y": [0.3, 0.5]}, keep=["event_time_floor"]).compute()
    assert found.event_time_floor.values.ravel() == pytest.approx(np.sqrt(2 * np.array([0.3, 0.5])), rel=1e-9)
    assert xd.plot(run).axes[0].get_xlabel() == "time"


@pytest.mark.parametrize(
    ("change", "asked", "said"),
    [
        ({}, {"until": "20 s"}, "until '20 s' has units 's', and the model's time is a pure number"),
        (
            {},
            {"scales": {"time": "1.3 s"}},
            "the scale of time is 1.3 s, and the model's time is a pure number: leave it out",
        ),
        ({}, {"step": "1 ms", "method": "rk4"}, "step '1 ms' has units 's'"),
        ({"time": {"unit": "mm"}}, {}, "unit is 'mm'; time is in 's', shown in another unit"),
        ({"time": {"units": "1"}}, {}, "key 'units' is not known"),
        ({"states": {"x": {"unit": "1", "rate": "1/second"}}}, {}, "rate of state 'x' has units 's-1"),
        (
            {"events": {"up": {"function": "x", "time_tolerance": "1 ns"}}},
            {},
            "event 'up': time_tolerance is '1.0 ns', needs a positive time in '1'",
        ),
        ({"time": {"unit": "s"}}, {}, "event 'up': time_tolerance is '1e-09 1', needs a positive time in 's'"),
    ],
)
def test_units_that_do_not_fit(change: dict[str, Any], asked: dict[str, Any], said: str) -> None:
    """Assert that seconds in a model without them are named, and numbers in one with."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(xd.Model(**LORENZ | change), **asked)
