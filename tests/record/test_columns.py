"""Columns of the record: the same quantities, whatever units and scales they were marched and are reported in."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.driven_swing import swing
from cases.problems import linear_drag, particle
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.record import columns, factors
from xdynamics.units import Scales, parse_unit


def test_every_column_is_the_same_in_other_units_and_scales() -> None:
    """Assert that each number of the record, in SI, hangs neither on the unit that it is reported in nor on scales."""
    one, other = swing("m"), swing("mm", scales={"length": "3 m", "time": "0.7 s", "mass": "5 kg"})
    assert list(one.variables) == list(other.variables)
    assert (one.sizes["event"], one.x.attrs["units"], other.x.attrs["units"]) == (5, "m", "mm")
    for name in one.variables:
        if one[name].dtype.kind == "U" or name == "end_memory":  # in the march's own numbers
            continue
        units = [run[name].attrs.get("units", run["event_time"].attrs["units"]) for run in (one, other)]
        first, second = (
            run[name].values * float(parse_unit(unit).factor) for run, unit in zip((one, other), units, strict=True)
        )
        assert first.shape == second.shape, name
        size = np.max(np.abs(first[np.isfinite(first)]), initial=0.0)
        close = 1e-4 if "error" in name or "uncertainty" in name else 1e-7
        assert np.allclose(first, second, rtol=0.0, atol=close * size, equal_nan=True), name
        if "atol" in one[name].attrs:
            assert one[name].attrs["atol_si"] == pytest.approx(1e-8)
            assert other[name].attrs["atol_si"] == pytest.approx(1e-8)
            assert other[name].attrs["atol"] == pytest.approx(
                1e-8 / float(parse_unit(other[name].attrs["units"]).factor)
            )


def test_columns_are_what_they_say() -> None:
    """Assert relations between columns that no unit makes true by itself: forces, works, brackets, rows, steps."""
    run = swing("m")
    m, k, c = 2.0, 3.0, 0.1
    assert run.force_spring_x.values == pytest.approx(-k * run.x.values)
    assert run.force_drag_x.values == pytest.approx(-c * run.v_x.values)
    assert m * run.a_x.values == pytest.approx((run.force_spring_x + run.force_drag_x + run.force_pull_x).values)
    assert run.rate_work.values == pytest.approx((run.force_pull_x * run.v_x).values)
    assert run.power.values == pytest.approx(c * run.v_x.values**2)
    assert run.potential_energy.values == pytest.approx(k * run.x.values**2 / 2)
    moved = run.row_kind.values != 3
    assert np.diff(run.time.values)[moved[1:]] == pytest.approx(run.step_size.values[1:][moved[1:]])
    before, after = run.event_row_before.values, run.event_row_after.values
    assert (after == before + 1).all()
    assert (run.time.values[before] == run.event_time.values).all()
    assert (run.time.values[after] == run.event_time.values).all()
    functions = np.where(run.event_detector.values == 0, run.x.values[before], run.v_x.values[before] - 0.2)
    assert run.event_residual.values == pytest.approx(functions, abs=1e-15)
    bounds = run.event_time_bounds.values
    assert (bounds[:, 1] == run.event_time.values).all()
    assert ((np.diff(bounds, axis=1)[:, 0] > 0) | (run.event_residual.values == 0)).all()
    assert (np.diff(bounds, axis=1) <= 1e-3).all()
    assert not run.event_impulse_x.values.any()
    assert not run.event_offset_x.values.any()


def test_a_run_keeps_what_it_goes_on_from() -> None:
    """Assert that the last state stands first in the numbers at the end, and that they have names."""
    run = swing("m")
    assert run.end_memory.attrs["names"].startswith("y[9] now.t ")
    assert run.end_memory.values[:2].tolist() == [run.x.values[-1], run.v_x.values[-1]]


def test_only_what_a_run_has_is_in_its_record() -> None:
    """Assert that given steps, tolerances and samples are kept where there are any."""
    steps = [0.1, 0.2, 0.3, 0.4]
    run = swing("m", rtol=None, atol=None, step=steps, until=1.0)
    assert run.given_step_size.values.tolist() == steps
    assert "given_step_size" not in swing("m", rtol=None, atol=None, step=0.1, until=1.0)
    assert "atol" not in run.x.attrs
    assert {"sample_x", "sample_pull", "sample_force_drag_x"} <= set(run.variables)
    assert not {"sample_x", "sample_time"} & set(swing("m", force_samples="none").variables)


def test_variables_say_what_they_are() -> None:
    """Assert the words of each kind of variable, the model's own where it has some."""
    run = swing("m")
    expected = {
        "m": "parameter m",
        "x": "coordinate x",
        "v_x": "velocity of x",
        "a_x": "acceleration of x",
        "work": "state work",
        "rate_work": "rate of work",
        "force_drag_x": "component of force drag along x",
        "power": "observable power",
        "error_x": "estimated local error of x in the step to this state",
        "sample_x": "x used in the force evaluation",
        "sample_pull": "pull looked up in the force evaluation",
        "sample_force_drag_x": "force_drag_x given by the force evaluation",
        "total_energy": "kinetic and potential energy",
        "event_impulse_x": "contact impulse along x",
    }
    assert {name: run[name].attrs["long_name"] for name in expected} == expected
    roles = {
        "m": "parameter",
        "x": "coordinate",
        "v_x": "velocity",
        "a_x": "acceleration",
        "work": "state",
        "rate_work": "rate",
        "force_drag_x": "force",
        "power": "observable",
        "error_x": "error",
        "sample_x": "sample",
        "total_energy": "energy",
    }
    assert {name: run[name].attrs["role"] for name in roles} == roles
    told = xd.Model(
        name="told",
        coordinates={"x": {"unit": "m", "description": "way"}},
        mass={"x": "m"},
        parameters={
            "m": {"value": 2, "unit": "kg", "uncertainty": "5 g", "description": "load"},
            "k": {"value": 1, "unit": "s-1", "uncertainty": 0.5},
        },
        states={"q": {"unit": "C", "rate": "-k*q", "description": "charge"}},
        forces={"drag": {"x": "-m*k*v_x", "description": "air"}},
        observables={"inertia": "m*a_x"},
        initial={"x": "0 m", "v_x": "1 m s-1", "q": "1 C"},
    )
    run = xd.simulate(told, method="rk4", step=0.1, until=1.0)
    words = {"x": "way", "m": "load", "q": "charge", "force_drag_x": "component of force air along x"}
    assert {name: run[name].attrs["long_name"] for name in words} == words
    assert (run.m.attrs["uncertainty"], run.k.attrs["uncertainty"]) == (0.005, 0.5)
    assert run.inertia.attrs["units"] == "N"
    assert run.inertia.values == pytest.approx(run.force_drag_x.values)


def test_events_say_what_found_them() -> None:
    """Assert names, functions, directions, actions and tolerances of events, and units by event where they differ."""
    about = swing("m").event_detector.attrs
    assert (about["flag_meanings"], about["flag_values"].tolist()) == ("low fast", [0, 1])
    assert about["functions"] == "low: x; fast: v_x - 0.2*metre/second"
    assert about["directions"] == "low: falling; fast: either"
    assert about["actions"] == "low: record; fast: record"
    assert about["time_tolerances"] == "low: 1.0 ms; fast: 1.0 ms"
    residual = swing("m").event_residual.attrs
    assert (residual["units"], residual["comment"]) == ("1", "SI unit by event: low m, fast m s-1")


def test_a_model_without_events_or_with_one_unit() -> None:
    """Assert that without an event the flag has one word, and that one unit is said as one."""
    past = {"function": "x - 2*metre", "direction": "rising", "time_tolerance": "1 ms"}
    none, one = (
        xd.simulate(particle(events=events), method="rk4", step=0.1, until=1.0) for events in ({}, {"past": past})
    )
    about = none.event_detector.attrs
    assert (about["flag_meanings"], about["flag_values"].tolist()) == ("none", [0])
    assert "functions" not in about
    assert (none.event_residual.attrs["units"], one.event_residual.attrs["units"]) == ("1", "m")
    assert "comment" not in one.event_residual.attrs


def test_a_norm_is_kept_where_it_judged() -> None:
    """Assert that a method that estimates its errors keeps them, and their norm with tolerances alone."""
    judged, fixed = swing("m"), swing("m", rtol=None, atol=None, step=0.1)
    plain = swing("m", rtol=None, atol=None, step=0.1, method="rk4")
    for run, there in ((judged, {"error_x", "error_norm"}), (fixed, {"error_x"}), (plain, set())):
        assert {"error_x", "error_norm"} & set(run.variables) == there
    iterated = swing("m", rtol=None, atol=None, step=0.1, method="implicit_midpoint").newton_iterations
    assert iterated.dtype == np.int32
    assert (iterated.values[1:] > 0).any()
    assert "newton_iterations" not in plain


def test_uncertainty_of_an_event_is_the_sum_of_its_parts() -> None:
    """Assert each part, and that half a spacing of t is the least."""
    run = swing("m")
    bracket, residual, interpolation = (
        run[f"event_time_uncertainty_{name}"].values for name in ("bracket", "residual", "interpolation")
    )
    assert bracket == pytest.approx(np.diff(run.event_time_bounds.values, axis=1)[:, 0])
    rows = run.event_row_before.values
    slopes = np.where(run.event_detector.values == 0, run.v_x.values[rows], run.a_x.values[rows])
    assert residual == pytest.approx(np.abs(run.event_residual.values / slopes))
    assert not interpolation.any()
    assert run.event_time_uncertainty.values == pytest.approx(bracket + residual)


def test_an_event_is_located_no_nearer_than_half_a_spacing_of_time() -> None:
    """Assert the least uncertainty where nothing else is unsure, and an infinite one where the function does not move."""
    past = {"function": "x - 3*metre", "direction": "rising", "time_tolerance": "1 ms"}
    model = particle(events={"past": past})
    march = March(model, settings_for(model, method="rk4", step=0.5, until=1.0))
    (block,) = march.blocks()
    take = {column.variable.name: column.take for column in columns(march)}["event_time_uncertainty"]
    event = block.log.events[:1]
    event["left"], event["residual"], event["slope"] = event["time"], 0.0, 0.0
    assert take(block).tolist() == [np.spacing(event["time"][0]) / 2]
    event["residual"] = 1e-9
    assert take(block).tolist() == [np.inf]


def test_rejected_trials_name_where_they_began() -> None:
    """Assert that row, time, size, norm and reason of a trial belong together."""
    run = swing("m", scales={"time": "7 s"}, step=0.5)
    rows = run.trial_step.values
    assert rows[0] == 0 < rows[-1]
    assert (run.trial_time.values == run.time.values[rows]).all()
    assert (run.trial_step_size.values[0], run.trial_error_norm.dims) == (pytest.approx(0.5), ("trial",))
    assert (run.trial_error_norm.values[run.trial_reason.values == 0] > 1).all()


def test_factors_lead_from_the_numbers_of_a_march_to_those_of_its_record() -> None:
    """Assert that scales are in them, and the units that the model declares."""
    scales = Scales.parse({"length": "3 m", "time": "0.5 s"})
    layout = settings_for(linear_drag().model, method="rk4", step=0.1, until=1.0).layout(linear_drag().model)
    assert [*layout.used] == ["y", "v_y"]
    assert factors(layout, scales) == pytest.approx([3000.0, 6000.0])
