"""The record: names, dims, units, flags, digests in the Dataset's own words."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, free, oscillator
from xdynamics.march import LogBlock, March
from xdynamics.march.configuration import settings_for
from xdynamics.record import check_kind, dataset
from xdynamics.schema import REQUIRED_ATTRIBUTES, ROW_KINDS


@lru_cache
def rocket() -> object:
    """A short flight, with drives, a state and events."""
    return xd.simulate(xd.Model.from_toml(MODELS / "rocket_c6.toml"), step="5 ms", until="2 s")


def test_names_of_the_contract_are_there() -> None:
    """Assert the variables that the design names, on their dims."""
    run = rocket()
    expected = {
        ("step",): [
            "time",
            "y",
            "v_y",
            "a_y",
            "force_gravity_y",
            "force_thrust_y",
            "force_drag_y",
            "force_pad_y",
            "fuel",
            "rate_fuel",
            "step_size",
            "row_kind",
            "regime",
            "kinetic_energy",
            "thrust_to_weight",
        ],
        ("trial",): ["trial_time", "trial_step", "trial_step_size", "trial_error_norm", "trial_reason"],
        ("event",): [
            "event_time",
            "event_residual",
            "event_detector",
            "event_kind",
            "event_direction",
            "event_row_before",
            "event_row_after",
            "event_time_uncertainty",
            "event_impulse_y",
            "event_offset_y",
        ],
        ("event", "bound"): ["event_time_bounds"],
        ("sample",): [
            "sample_time",
            "sample_step",
            "sample_stage",
            "sample_y",
            "sample_v_y",
            "sample_fuel",
            "sample_force_drag_y",
            "sample_thrust",
        ],
        (): ["airframe", "g", "impulse"],
        ("document",): ["model_toml", "force_source"],
    }
    for dims, names in expected.items():
        for name in names:
            assert run[name].dims == dims, name


def test_every_variable_says_what_it_is() -> None:
    """Assert units, long_name and role everywhere, and no coordinate variable on any dimension."""
    run = rocket()
    for name, variable in run.variables.items():
        assert name == "event_time_bounds" or {"units", "long_name", "role"} <= set(variable.attrs), name
    assert run.event_time_bounds.attrs == {}
    texts, times = (
        {"model_toml", "force_source"},
        {"end_memory", "time", "event_time", "trial_time", "sample_time", "step_number"},
    )
    assert {*run.coords} == texts | times | {
        name for name in run.variables if run[name].attrs.get("role") == "parameter"
    }
    assert {run[name].dims for name in texts} == {("document",)}
    assert run.sizes["document"] == 1
    assert not run.indexes
    assert set(REQUIRED_ATTRIBUTES) <= set(run.attrs)


@pytest.mark.parametrize(
    ("name", "units"),
    [
        ("time", "s"),
        ("y", "m"),
        ("v_y", "m s-1"),
        ("a_y", "m s-2"),
        ("force_drag_y", "N"),
        ("fuel", "g"),
        ("rate_fuel", "g s-1"),
        ("kinetic_energy", "J"),
        ("airframe", "g"),
        ("event_impulse_y", "kg m s-1"),
        ("thrust_to_weight", "1"),
        ("sample_thrust", "N"),
    ],
)
def test_units_are_udunits(name: str, units: str) -> None:
    """Assert the spelling of units."""
    assert rocket()[name].attrs["units"] == units


def test_angle_and_torque_units() -> None:
    """Assert that a generalised force on an angle is a torque."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "pendulum.toml"), until="0.1 s")
    assert run.v_theta.attrs["units"] == "rad s-1"
    assert run.force_gravity_theta.attrs["units"] == "N m"


def test_forces_make_the_acceleration() -> None:
    """Assert that the logged force terms are those of the logged acceleration, row by row."""
    run = rocket()
    total = run.force_gravity_y + run.force_thrust_y + run.force_drag_y + run.force_pad_y
    mass = (run.airframe + run.casing + run.fuel) / 1000
    assert np.allclose(total / mass, run.a_y, rtol=1e-13, atol=1e-13)


def test_row_kinds_in_words() -> None:
    """Assert that the flag table gives the rows their words."""
    run = rocket()
    words = run.row_kind.attrs["flag_meanings"].split()
    assert tuple(words) == ROW_KINDS
    counts = {word: int((run.row_kind == n).sum()) for n, word in enumerate(words)}
    # 24 breakpoints after the start, of which burnout's is an event's pair
    assert counts["initial"] == 1
    assert counts["node"] == 23
    assert counts["event_before"] == counts["event_after"] == run.sizes["event"] == 2


def test_parameters_carry_their_uncertainty() -> None:
    """Assert that a parameter is a variable with its uncertainty in its own unit."""
    assert rocket().airframe.attrs["uncertainty"] == 0.5
    assert float(rocket().airframe) == 45.0


def test_samples_are_off_when_asked() -> None:
    """Assert that no sample dimension remains, and that nothing else changes."""
    run = xd.simulate(free().model, method="midpoint", step=0.5, until=1.0, force_samples="none")
    assert "sample" not in run.sizes
    xd.check(run)


def test_check_gathers_all_faults() -> None:
    """Assert that a broken record is refused with every fault at once."""
    run = xd.simulate(free().model, method="midpoint", step=0.5, until=1.0)
    broken = run.drop_vars("trial_step").assign(extra=("step", [1.0, 2.0, 3.0]))
    broken.attrs.pop("solver_method")
    time = run.time.values.copy()
    time[1] = -1.0
    broken["time"] = ("step", time, run.time.attrs)
    with pytest.raises(xd.InputError, match="this is no run record") as caught:
        xd.check(broken)
    text = str(caught.value)
    for part in (
        "'solver_method' is missing",
        "'trial_step' is missing",
        "'extra' has no attribute 'units'",
        "'time' goes from 0.0 to -1.0 at row 1",
    ):
        assert part.replace("0.0", "np.float64(0.0)").replace("-1.0", "np.float64(-1.0)") in text or part in text


def test_same_model_same_digest() -> None:
    """Assert that two runs of one input have one content digest, and another step another."""
    runs = [xd.simulate(free().model, method="midpoint", step=step, until=1.0) for step in (0.5, 0.5, 0.25)]
    digests = [xd.content_digest(run) for run in runs]
    assert digests[0] == digests[1] != digests[2]


def test_a_run_in_one_block_is_not_copied(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the record of a run in memory stands where the march wrote it."""
    model = oscillator().model
    march = March(model, settings_for(model, step=0.1, until=1.0))
    blocks: list[LogBlock] = []
    monkeypatch.setattr(march.witnesses, "take", lambda block, _rows: blocks.append(block))
    run = dataset(march)
    assert len(blocks) == 1
    assert np.shares_memory(run.x.values, blocks[0].log.rows)


@pytest.mark.parametrize("made", [rocket, lambda: xd.simulate(oscillator().model, step=0.1, until=1.0)])
def test_a_record_is_what_xarray_would_build(made: Callable[[], xr.Dataset]) -> None:
    """Assert that variables put together without alignment are the Dataset that xarray makes of them, in every part."""
    run = made()
    parts = {
        name: xr.Variable(variable.dims, variable.values, variable.attrs) for name, variable in run.variables.items()
    }
    built = xr.Dataset(parts, attrs=run.attrs).set_coords([*run.coords])
    assert built.identical(run)
    assert (built.sizes, set(built.coords), dict(built.indexes)) == (run.sizes, set(run.coords), dict(run.indexes))
    assert built.isel(step=slice(2)).identical(run.isel(step=slice(2)))
    assert run.encoding == {} == run.time.encoding
    assert all(type(variable.dims) is tuple for variable in run.variables.values())
    assert {name for name, variable in run.variables.items() if variable.encoding} == {"event_time_bounds"}
    assert run.copy(deep=True).identical(run)


def test_what_is_plainly_no_run_is_named() -> None:
    """Assert that a missing attribute, rows along another dimension and none at all are each told."""
    run = xd.simulate(oscillator().model, step=0.1, until=1.0)
    for other, message in (
        (run.assign_attrs(), None),
        (run.drop_attrs(deep=False), "it has no solver_method, solver_estimator, solver_interpolation"),
        (run.rename(step="row"), r"time along \('row',\) of size 11"),
        (run.isel(step=slice(0, 0)), r"time along \('step',\) of size 0, needs rows"),
    ):
        if message is None:
            check_kind(other)
            continue
        with pytest.raises(xd.InputError, match=message):
            check_kind(other)
