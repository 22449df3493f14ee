"""What a record says of how it was made, and the way back from it."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.driven_swing import swing
from cases.problems import oscillator
from xdynamics.march.control import FIRST_STEP
from xdynamics.march.implicit.newton import MOST_ITERATIONS, NEWTON_TOLERANCE
from xdynamics.march.implicit.radau import MOST_SETTLING, MOST_TURNS, SETTLED
from xdynamics.methods.implicit import SHARE
from xdynamics.record.arguments import recorded_arguments, recorded_scales
from xdynamics.record.provenance import _versions_and_processor, xdynamics_version

FIXED = {"rtol": None, "atol": None, "step": 0.1}
SCALED = {"length": "3.0 m", "time": "0.5 s", "mass": "2.0 kg"}
GIVEN = {"step": 1e-3, "safety": 0.8, "min_step": 1e-9, "max_step": 0.5, "max_steps": 500, "growth_limits": (0.3, 4.0)}


@pytest.mark.parametrize(
    ("asked", "kept", "lost"),
    [
        ({}, {"safety": 0.9, "min_step": 0.0, "max_steps": 1_000_000, "rtol": 1e-7}, {"step", "max_step"}),
        (GIVEN, GIVEN | {"rtol": 1e-7}, set()),
        (FIXED, {"step": 0.1, "scales": None, "nodes": None}, {"rtol", "atol", "safety", "max_step"}),
        (FIXED | {"scales": SCALED, "force_samples": "none"}, {"scales": SCALED, "force_samples": "none"}, {"rtol"}),
        (FIXED | {"nodes": [0.55]}, {"nodes": [0.55], "force_samples": "all"}, {"rtol"}),
        (FIXED | {"step": [0.25] * 12 + [0.03]}, {"step": [0.25] * 12 + [0.03]}, {"rtol", "safety"}),
        (FIXED | {"summation": "compensated"}, {"summation": "compensated", "jacobian": None}, {"rtol"}),
        (
            {"method": "radau_iia", "jacobian": "differences"},
            {"method": "radau_iia", "jacobian": "differences"},
            {"step"},
        ),
    ],
)
def test_a_record_tells_what_was_asked(asked: dict[str, Any], kept: dict[str, Any], lost: set[str]) -> None:
    """Assert that the arguments of a run can be read from its record, and nothing that was not asked for."""
    found = recorded_arguments(swing("m", until=3.03, **asked))
    assert found["until"] == 3.03
    for name, value in kept.items():
        same = np.asarray(found[name]).tolist() if name == "step" else found.get(name)
        assert same == value, name
    assert not lost & set(found)
    if "atol" in found:
        assert {name: value.si for name, value in found["atol"].items()} == pytest.approx(
            dict.fromkeys(("x", "v_x", "work"), 1e-8)
        )


def test_what_chose_the_steps_is_told() -> None:
    """Assert the settings of step control, those by default and those that were given."""
    run = swing("m", until=3.0, scales=SCALED)
    chosen, given = run.attrs, swing("m", until=3.0, **GIVEN).attrs
    assert chosen["solver_first_step"] == pytest.approx(float(run.step_size[1]))
    assert given["solver_first_step"] == 1e-3
    assert (chosen["solver_step_control"], given["solver_step_control"]) == ("adaptive", "adaptive")
    assert (chosen["solver_first_step_choice"], given["solver_first_step_choice"]) == (FIRST_STEP, "given")
    assert (chosen["solver_max_step"], given["solver_max_step"]) == (3.0, 0.5)
    assert (chosen["solver_max_step_choice"], given["solver_max_step_choice"]) == ("the span", "given")
    assert given["solver_growth_limits"].tolist() == [0.3, 4.0]
    late = oscillator().model.replace(initial={"t": "2 s"})
    settings = {"method": "dormand_prince", "rtol": 1e-6, "atol": 1e-6, "until": 3.0}
    run = xd.simulate(late, **settings)
    assert run.attrs["solver_max_step"] == 1.0
    assert "max_step" not in recorded_arguments(run)


def test_version_01_did_not_say_who_chose_the_longest_step() -> None:
    """Assert that a longest step other than the span was given, and that without a start none can be the span."""
    late = oscillator().model.replace(initial={"t": "2 s"})
    for asked, found in ({}, None), ({"max_step": 0.5}, 0.5), ({"max_step": 1.0}, None):
        run = xd.simulate(late, method="dormand_prince", rtol=1e-6, until=3.0, **asked)
        del run.attrs["solver_max_step_choice"]
        assert recorded_arguments(run).get("max_step") == found
    assert recorded_arguments(run.drop_vars("time"))["max_step"] == 1.0


def test_the_processor_is_told_by_sorted_features(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what it has is listed, not what it lacks, and in one order on every machine."""
    from llvmlite import binding

    monkeypatch.setattr(binding, "get_host_cpu_features", lambda: {"sse": True, "avx": True, "amx": False})
    assert _versions_and_processor.__wrapped__()["cpu_features"] == "avx sse"


def test_the_version_is_that_of_the_record() -> None:
    """Assert that the program and its records say one version."""
    assert xdynamics_version() == version("xdynamics") == swing("m", **FIXED).attrs["xdynamics_version"]


@pytest.mark.parametrize(
    ("until", "step", "said"),
    [
        (3.0, 0.1, "whole"),
        (3.03, 0.1, "partial, 0.03 s: the span is no multiple of the step"),
        (0.3, 0.1, "whole"),
        (3.08, 0.1, "partial, 0.08 s: the span is no multiple of the step"),
        (1e-3, 0.1, "partial, 0.001 s: the span is no multiple of the step"),
    ],
)
@pytest.mark.parametrize("scales", [None, {"time": "7 s"}])
def test_the_last_step_of_a_grid_is_told(until: float, step: float, said: str, scales: Any) -> None:
    """Assert that it is said, in seconds, where the end is not on the grid."""
    run = xd.simulate(oscillator().model, step=step, until=until, scales=scales)
    assert run.attrs["solver_last_step"] == said


def test_a_run_that_ended_before_has_no_last_step() -> None:
    """Assert that nothing is said of a step that was not made."""
    states = {"y": {"unit": "1", "rate": "k*y**2"}}
    model = xd.Model(name="blow", parameters={"k": "1 s-1"}, states=states, initial={"y": "1"})
    assert xd.simulate(model, method="midpoint", step=0.01, until=9.0).attrs["solver_last_step"].startswith("none: ")


def test_scales_are_those_that_were_given() -> None:
    """Assert that scales come back from a record, and that one without them has none."""
    scaled, plain = swing("m", **FIXED, scales=SCALED), swing("m", **FIXED)
    found = recorded_scales(scaled)
    assert (found.length, found.time, found.mass) == (3.0, 0.5, 2.0)
    assert (recorded_scales(plain).length, recorded_scales(plain).time) == (1.0, 1.0)
    assert "solver_length_scale" not in plain.attrs


def test_work_is_counted() -> None:
    """Assert that accepted steps, rejected trials and solutions are those of the run."""
    run = swing("m", method="radau_iia")
    rows_of_events = 2 * len(np.unique(run.event_row_before))
    steps = run.sizes["step"] - 1 - rows_of_events // 2
    assert run.attrs["run_accepted_steps"] == steps
    assert run.attrs["run_rejected_trials"] == run.sizes["trial"]
    assert 0 < run.attrs["run_jacobian_evaluations"] < run.attrs["run_factorisations"]
    assert "run_factorisations" not in swing("m", **FIXED).attrs


@pytest.mark.parametrize(
    ("asked", "tolerance", "most"),
    [
        ({"method": "radau_iia"}, SHARE, MOST_TURNS),
        (FIXED | {"method": "radau_iia"}, SETTLED, MOST_SETTLING),
        (FIXED | {"method": "implicit_midpoint"}, NEWTON_TOLERANCE, MOST_ITERATIONS),
    ],
)
def test_how_equations_were_solved_is_told(asked: dict[str, Any], tolerance: float, most: int) -> None:
    """Assert tolerance and bound of the iterations, which hang on who chose the steps."""
    about = swing("m", until=1.0, **asked).attrs
    assert (about["solver_newton_tolerance"], about["solver_newton_most_iterations"]) == (tolerance, most)
    assert ("solver_jacobian" in about) == (asked["method"] == "radau_iia")
    assert "solver_newton_tolerance" not in swing("m", until=1.0, **FIXED).attrs
