"""The parts of refinements, forecasts and comparisons by themselves, on numbers made for them."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.evidence.companion import Companion, companion, companion_lines, tighter_of
from xdynamics.evidence.comparing.bits import compare_bits, compare_reproduction
from xdynamics.evidence.comparing.causes import _flatten_table, _shortened_text, cause_of, independent_settings
from xdynamics.evidence.comparing.comparison_summary import comparison_lines as comparison_in_words
from xdynamics.evidence.comparing.differences import (
    common_times,
    difference_of,
    event_count_differences,
    parting_text,
    times_between,
)
from xdynamics.evidence.evidence_dataset import event_rows_by_name, evidence_dataset, match_times
from xdynamics.evidence.observables import comparable, modes_behind, observe
from xdynamics.evidence.refining import readings
from xdynamics.evidence.refining.convergence import EVENT_LIMITED, judge, observed_orders
from xdynamics.evidence.refining.levels import ALL, CHOICES, RTOLS, STEPS, TIME_TOLERANCES, Levels, Varied
from xdynamics.evidence.refining.readings import step_defects
from xdynamics.evidence.refining.refinement import (
    Bounds,
    _change_tolerances,
    _changing,
    _known_observables,
    _level_limits,
    _stopped,
    level_obstacle,
)
from xdynamics.evidence.refining.refinement import refinement_lines as refinement_in_words
from xdynamics.evidence.refining.study import Study
from xdynamics.evidence.refining.subjects import StudyQuantities, TrackedValue, family
from xdynamics.evidence.runs import march_model
from xdynamics.evidence.stage_tasks import results_of

OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")  # cos 2t
BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")

# --------------------------------------------------------------------------------------------------------------- family


def planted(case: int) -> tuple[TrackedValue, int]:
    """Return numbers of four levels at three places, with errors, rounding and switches drawn at random."""
    rng = np.random.default_rng(case)
    order = rng.choice([1.0, 2.0, 2.3], 3)
    values = 1.0 + rng.normal(0.0, 1.0, 3)[:, None] * (0.5 ** np.arange(4)) ** order[:, None]
    sizes = np.abs(np.diff(values)).min(axis=1)
    errors = sizes[:, None] * 10.0 ** rng.uniform(-4, 0.5, (3, 4))
    rounding, moved = sizes * 10.0 ** rng.uniform(-6, 0.3, 3), sizes * 10.0 ** rng.uniform(-6, 0.0, 3)
    kinks = rng.choice([1.0, np.inf], 3)
    return TrackedValue("x", "m", "place", ("at",), values, errors, rounding, moved, 2.5, kinks), int(
        rng.integers(10, 900)
    )


@pytest.mark.cases(80)
@pytest.mark.parametrize("varied", [STEPS, RTOLS, TIME_TOLERANCES], ids=lambda one: one.name)
def test_a_family_judges_every_place_by_its_own_numbers(case: int, varied: Varied) -> None:
    """Assert verdict, limit, uncertainty and rule of each place by its own finest errors, rounding, events and switches."""
    one, accepted = planted(case)
    levels = Levels(OSCILLATOR, varied, 0.1 / 2.0 ** np.arange(4), 2.0)
    found = family(one, levels, accepted)
    assert one.kinks is not None
    expected = [
        judge(
            one.values[k],
            levels.values,
            2.0,
            float(one.rounding[k]),
            max(one.errors[k, 2:].tolist()),
            float(one.event_errors[k]),
            smooth=varied is not RTOLS,
            kink=math.inf if varied is TIME_TOLERANCES else float(one.kinks[k]),
            accepted=accepted,
        )
        for k in range(3)
    ]
    assert found["verdict_x"][1].tolist() == [each.verdict for each in expected]
    assert found["limit_x"][1] == pytest.approx([each.limit for each in expected], nan_ok=True)
    assert found["uncertainty_x"][1] == pytest.approx([each.uncertainty for each in expected])
    words = found["uncertainty_rule_x"][2]["flag_meanings"].split()
    assert words == sorted(words)
    assert [words[k] for k in found["uncertainty_rule_x"][1].tolist()] == [
        each.rule.replace(" ", "_").replace(":", "") for each in expected
    ]
    assert pytest.approx(observed_orders(one.values, levels.values), nan_ok=True) == found["order_x"][1].T
    changes = np.full((4, 3), np.nan)
    changes[:3] = one.values[:, 1:].T - one.values[:, :3].T
    assert found["difference_x"][1] == pytest.approx(changes, nan_ok=True)
    assert found["scaled_difference_x"][1] == pytest.approx(changes / 2.5, nan_ok=True)
    assert found["x"][1].tolist() == one.values.T.tolist()
    gates = np.abs(changes[[0, 1, 2, 2]]) < one.errors.T
    assert found["gate_x"][1].tolist() == gates.astype(int).tolist()


def test_a_number_of_a_whole_run_has_levels_alone() -> None:
    """Assert that without places there is one verdict, and that an error as large as the difference still passes."""
    values, errors = np.array([[1.0, 1.25, 1.3125]]), np.array([[0.25, 0.0625, 0.0625]])
    one = TrackedValue("energy_range", "J", "range", (), values, errors, np.zeros(1), np.zeros(1), 1.0)
    levels = Levels(OSCILLATOR, STEPS, np.array([0.4, 0.2, 0.1]), 2.0)
    found = family(one, levels, 100)
    assert found["energy_range"][0] == ("level",)
    assert found["gate_energy_range"][1].tolist() == [0, 0, 0]
    assert found["order_energy_range"][1].tolist()[1] == pytest.approx(2.0)
    exact = family(
        TrackedValue("e", "J", "range", (), values, 0.0 * errors, np.zeros(1), np.zeros(1), 1.0), levels, 100
    )
    assert (exact["limit_e"][0], float(exact["limit_e"][1])) == ((), pytest.approx(4.0 / 3.0))
    rules = Levels(OSCILLATOR, CHOICES, np.array(["interpolant", "reintegrate"]), math.nan)
    assert not {"order_energy_range", "verdict_energy_range"} & {*family(one, rules, 100)}


# --------------------------------------------------------------------------------------------------------------- levels


NOTHING_VARIED: dict[str, Any] = dict.fromkeys(varied.keyword for varied in ALL)


def levels_of(**given: Any) -> Levels:
    """Levels of the oscillator, from what `refine` is given."""
    return Levels.of(
        OSCILLATOR,
        NOTHING_VARIED | given,
        {"method": "dop853"},
        fewest=2,
    )


def test_levels_know_what_is_varied_and_its_order() -> None:
    """Assert values in seconds, the method's order in steps, 1 in tolerances, none of rules, and settings of each level."""
    steps, rtols = levels_of(steps=["20 ms", "5 ms"]), levels_of(rtols=[1e-4, 1e-6])
    times, rules = levels_of(time_tolerances=["1 ms", "1 us"]), levels_of(rules=["interpolant", "reintegrate"])
    assert (steps.values.tolist(), steps.formal, steps.varied) == ([0.02, 0.005], 8.0, STEPS)
    assert (rtols.formal, times.formal, math.isnan(rules.formal)) == (1.0, 1.0, True)
    assert [one.ordered for one in (steps, rtols, times, rules)] == [True, True, True, False]
    assert [rules.rule(0), rules.rule(1), steps.rule(0)] == ["interpolant", "reintegrate", "reintegrate"]
    assert steps.settings_of_level(0.005) == {"force_samples": "none", "method": "dop853", "step": 0.005}
    assert rtols.settings_of_level(1e-6) == {"force_samples": "none", "method": "dop853", "rtol": 1e-6}
    assert times.settings_of_level(1e-6)["time_tolerance"] == 1e-6
    assert "rtol" not in rules.settings_of_level("interpolant")


def test_a_finer_level_goes_on_as_the_last_one_went() -> None:
    """Assert the ratio of the last two, a half or a tenth behind a single one, and 24 levels at most."""
    assert levels_of(steps=[0.4, 0.1]).finer().values.tolist() == pytest.approx([0.4, 0.1, 0.025])
    asked = NOTHING_VARIED
    for given, ratio in (({"steps": [0.4]}, 2.0), ({"rtols": [1e-3]}, 10.0), ({"time_tolerances": [1e-3]}, 10.0)):
        one = Levels.of(OSCILLATOR, asked | given, {"method": "dop853"}, fewest=1).finer()
        assert one.values[0] / one.values[1] == pytest.approx(ratio)
    many = levels_of(steps=(0.4 / 1.1 ** np.arange(23)).tolist()).finer()
    assert many.values.size == 24
    with pytest.raises(xd.InputError, match="24 at most"):
        many.finer()


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"steps": [0.1, 0.1]}, "need 2 or more that get smaller"),
        ({"steps": [0.1]}, "need 2 or more"),
        ({"steps": [0.1, 0.0]}, "all positive"),
        ({"steps": [0.1, 0.2]}, "get smaller"),
        ({"steps": 0.1}, "needs a row of them"),
        ({"rules": ["interpolant"]}, "need both"),
        ({"rules": ["interpolant", "interpolant"]}, "need both"),
        ({"rules": ["interpolant", "other"]}, "need both"),
        ({}, "one of them"),
        ({"steps": [0.1, 0.05], "rtols": [1e-3, 1e-4]}, "one of them"),
        ({"rtols": [1e-3, "x"]}, "needs numbers"),
    ],
)
def test_levels_that_do_not_get_finer_are_refused(given: dict[str, Any], said: str) -> None:
    """Assert one clear error for each."""
    with pytest.raises(xd.InputError, match=said):
        levels_of(**given)


def test_levels_of_location_change_every_event() -> None:
    """Assert that tolerances of a level stand in its model, in the place of its own, and rules of location too."""
    asked = NOTHING_VARIED
    bouncing = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    for model, kind, name in ((BALL, "events", "ground"), (bouncing, "contacts", "floor")):
        levels = Levels.of(model, asked | {"time_tolerances": ["1 ms", "2 us"]}, {}, fewest=2)
        located = levels.model_of(levels.values[1])
        assert getattr(located, kind)[name].time_tolerance.si == 2e-6
    rules = Levels.of(BALL, asked | {"rules": ["interpolant", "reintegrate"]}, {}, fewest=2)
    assert rules.model_of("interpolant").events["ground"].root_state == "interpolant"
    assert Levels.of(BALL, asked | {"steps": [0.1, 0.05]}, {}, fewest=2).model_of(0.1) is BALL


# ------------------------------------------------------------------------------------------------------------- forecast


def forecast(values: list[float], rows: list[int], varied: Varied = STEPS, **more: Any) -> Any:
    """A study of one number, of which nothing was marched: levels of 0.4, 0.2, … and runs of so many rows of 16 bytes."""
    outlines = [SimpleNamespace(rows=n, row_bytes=16.0) for n in rows]
    one = TrackedValue(
        "x",
        "m",
        "x",
        (),
        np.array([values]),
        np.zeros((1, len(values))),
        np.full(1, more.pop("rounding", 0.0)),
        np.zeros(1),
        1.0,
    )
    levels = SimpleNamespace(
        keep=more.pop("keep", None),
        varied=varied,
        values=0.4 / more.pop("ratio", 2.0) ** np.arange(len(rows)),
        formal=2.0,
        model=OSCILLATOR,
    )
    subjects = SimpleNamespace(shapes=OSCILLATOR.shapes)
    return SimpleNamespace(outlines=outlines, levels=levels, subjects=subjects, numbers=lambda: [one])


def test_the_next_level_is_held_against_rows_and_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert rows of the next level, those of the last times the ratio, and their bytes: 0.4 of what is free by default."""
    study = forecast([0.0, 0.75, 0.9375], [101, 201, 401])
    assert level_obstacle(study, {"x": 1e-2}, Bounds(rows=7000.0)) == ""
    said = level_obstacle(study, {"x": 1e-2}, Bounds(rows=801.0))
    assert said.startswith("the next one would have 8e+02 rows (13 kB), more than most_rows = 801; ")
    assert level_obstacle(study, {"x": 1e-2}, Bounds(rows=1e9, memory=802 * 16.0 * 8)) == ""
    assert "of memory were allowed" in level_obstacle(study, {"x": 1e-2}, Bounds(rows=1e9, memory=802 * 16.0 - 1.0))
    for free, room in ((802 * 16.0 / 0.8 * 2.0 * 1.01, True), (802 * 16.0 / 0.8 * 2.0 * 0.99, False)):
        monkeypatch.setattr("xdynamics.evidence.refining.refinement.free_memory", lambda free=free: free)
        assert ("of memory can be had" in level_obstacle(study, {"x": 0.1}, Bounds(rows=1e9))) is not room


@pytest.mark.parametrize(("tolerance", "levels"), [(0.047, 1), (1e-3, 4), (1e-6, 9)])
def test_the_level_that_is_needed_follows_from_the_order(tolerance: float, levels: int) -> None:
    """Assert step and rows of the level whose change is small enough: changes fall by four from level to level."""
    study = forecast([0.0, 0.75, 0.9375], [101, 201, 401])
    assert 0.1875 / 4.0**levels <= tolerance < 0.1875 / 4.0 ** (levels - 1)
    rows = 401 * 2.0**levels
    assert level_obstacle(study, {"x": tolerance}, Bounds(rows=rows * 1.001)) == ""
    said = level_obstacle(study, {"x": tolerance}, Bounds(rows=max(rows * 0.999, 803.0)))
    if levels > 1:
        assert said.startswith(f"x would need a step_size of about {0.1 / 2.0**levels:.2g} s: {rows:.2g} rows (")
        assert "more than most_rows" in said
    assert level_obstacle(study, {"x": 0.2}, Bounds(rows=803.0)) == ""  # changes are small enough
    assert level_obstacle(study, {"y": 1e-9}, Bounds(rows=803.0)) == ""


def test_what_no_level_can_come_to_is_said() -> None:
    """Assert that rounding ends it where changes are at it, that changes which do not fall and a single one prove nothing."""
    noisy = forecast([0.0, 0.75, 0.9375], [101, 201, 401], rounding=0.5)
    assert level_obstacle(noisy, {"x": 0.1}, Bounds()) == "rounding alone moves x by 0.5 m: no step_size would do"
    quiet = forecast([0.0, 0.75, 0.9375], [101, 201, 401], rounding=0.15)
    assert level_obstacle(quiet, {"x": 0.1}, Bounds()) == ""  # the last change is above it
    growing = forecast([0.0, 0.1, 0.3], [101, 201, 401])
    assert level_obstacle(growing, {"x": 1e-9}, Bounds(rows=1000.0)) == ""
    assert "changes of x do not fall" in level_obstacle(growing, {"x": 1e-9}, Bounds(rows=800.0))
    slow = forecast(
        [0.0, 1.0, 1.0 + 2.0**-0.15], [101, 201, 401]
    )  # of order 0.15: they fall, and far from the method's
    assert "x would need a step_size" in level_obstacle(slow, {"x": 0.5}, Bounds(rows=800.0))
    late = forecast([0.0, 0.0, 0.1875], [101, 201, 401])  # the first change tells no order
    assert "x would need a step_size of about 0.05 s" in level_obstacle(late, {"x": 0.1}, Bounds(rows=800.0))
    single = forecast([0.0], [101])
    assert level_obstacle(single, {"x": 1e-9}, Bounds(rows=203.0)) == ""
    two = forecast([0.0, 0.75], [101, 201])
    assert level_obstacle(two, {"x": 1e-9}, Bounds(rows=500.0)) == ""
    said = level_obstacle(two, {"x": 1e-9}, Bounds(rows=400.0))
    assert f"x would need a step_size of about {0.2 / 2.0**15:.2g} s" in said  # by the method's own order
    unsteady = forecast([0.0, 0.75, 0.75 + 0.75 / 2**2.3], [101, 201, 401])
    assert level_obstacle(unsteady, {"x": 1e-9}, Bounds(rows=1000.0)) == ""


def test_rows_of_tolerances_grow_as_they_did(tmp_path: Path) -> None:
    """Assert the ratio of the last two runs in relative tolerances, none in those of location, and a folder's free disk."""
    study = forecast([0.0, 0.5, 0.75], [100, 110, 143], RTOLS)
    assert "would have 1.9e+02 rows" in level_obstacle(study, {"x": 1e-3}, Bounds(rows=150.0))
    fewer = forecast([0.0, 0.5, 0.75], [100, 110, 90], RTOLS)
    assert level_obstacle(fewer, {"x": 1e-3}, Bounds(rows=91.0)) == ""
    assert "would have 90 rows" in level_obstacle(fewer, {"x": 1e-3}, Bounds(rows=89.0))
    located = forecast([0.0, 0.5, 0.75], [100, 110, 143], TIME_TOLERANCES)
    assert level_obstacle(located, {"x": 1e-3}, Bounds(rows=144.0)) == ""
    thirds = forecast([0.0, 0.9, 1.0], [101, 301, 901], ratio=3.0)  # order two in thirds
    assert "would have 2.7e+03 rows" in level_obstacle(thirds, {"x": 1e-3}, Bounds(rows=2000.0))
    said = f"x would need a step_size of about {0.4 / 9.0 / 27.0:.2g} s: {901 * 27.0:.2g} rows"
    assert level_obstacle(thirds, {"x": 2e-4}, Bounds(rows=3000.0)).startswith(said)
    kept = forecast([0.0, 0.75, 0.9375], [101, 201, 401], keep=tmp_path)
    assert level_obstacle(kept, {"x": 1e-3}, Bounds(rows=1e9, memory=1.0)) == ""  # nothing stays in memory
    assert f"and the disk of '{tmp_path}' has" in level_obstacle(kept, {"x": 1e-60}, Bounds(rows=math.inf))


# ----------------------------------------------------------------------------------------------------------- refinement


def test_tolerances_of_changes_are_in_the_numbers_unit() -> None:
    """Assert quantities, bare numbers, and what is refused; and that rules have no finer level."""
    study = forecast([0.0, 0.75, 0.9375], [101, 201, 401])
    study.levels.ordered = True
    assert _change_tolerances({"x": "3 mm"}, study) == pytest.approx({"x": 3e-3})
    assert _change_tolerances({"x": 3.0}, study) == {"x": 3.0}
    assert _change_tolerances({}, study) == {}
    for given, said in (
        ({"y": 1.0}, "names 'y'; there are x"),
        ({"x": "3 s"}, "needs the unit 'm'"),
        ({"x": 0.0}, "needs a positive one"),
        ({"x": "-1 m"}, "needs a positive one"),
        ({"x": "3"}, "needs the unit 'm'"),
    ):
        with pytest.raises(xd.InputError, match=said):
            _change_tolerances(given, study)
    study.levels.ordered, study.levels.varied = False, CHOICES
    assert _change_tolerances({}, study) == {}
    with pytest.raises(xd.InputError, match="rules have none"):
        _change_tolerances({"x": 1.0}, study)


def test_changes_are_those_to_the_last_level_at_every_place() -> None:
    """Assert who still changes by more than its tolerance: by the last change alone, the border is reached, nan is not."""
    study = forecast([0.0, 0.75, 1.0], [101, 201, 401])
    assert _changing(study, {"x": 0.25}) == []
    assert _changing(study, {"x": 0.2499}) == ["x"]
    assert _changing(study, {"x": 0.25, "y": 1.0}) == ["y"]
    assert _changing(forecast([0.0], [101]), {"x": 9.0}) == ["x"]
    two = TrackedValue(
        "x",
        "m",
        "x",
        ("at",),
        np.array([[1.0, 1.1], [1.0, 0.5], [np.nan, 1.0]]),
        np.zeros((3, 2)),
        np.zeros(3),
        np.zeros(3),
        1.0,
    )
    for rows, tolerance, changing in ((slice(2), 0.5, False), (slice(2), 0.49, True), (slice(3), 9.0, True)):
        some = TrackedValue(
            "x", "m", "x", ("at",), two.values[rows], two.errors[rows], two.rounding[rows], two.event_errors[rows], 1.0
        )
        study = SimpleNamespace(outlines=[None, None], numbers=lambda one=some: [one])
        assert _changing(study, {"x": tolerance}) == ["x"] * changing


def test_bounds_of_levels_and_why_none_was_added() -> None:
    """Assert rows and bytes that are asked for, and both endings in words."""
    assert (_level_limits(None, None).rows, _level_limits(2, "3 kB").rows, _level_limits(2.5, "3 kB").memory) == (
        10_000_000,
        2.0,
        3000.0,
    )
    for rows in (1, "many"):
        with pytest.raises(xd.InputError, match="most_rows is .*, needs a number of rows"):
            _level_limits(rows, None)  # type: ignore[arg-type]
    assert _stopped([], 4, "") == "every change under its tolerance from level 2 to level 3"
    assert (
        _stopped(["x", "y"], 3, "room")
        == "after 3 levels, with x, y still changing by more than its tolerance: no finer level, room"
    )
    assert _known_observables(OSCILLATOR, "x") == ("x",)
    assert _known_observables(OSCILLATOR, ["energy_range", "period_x", "phase_x"]) == (
        "energy_range",
        "period_x",
        "phase_x",
    )
    with pytest.raises(xd.InputError, match="'speed' is none of the model's; there are x, v_x"):
        _known_observables(OSCILLATOR, ["speed"])


def refined_by_hand(**more: Any) -> xr.Dataset:
    """A study of x at two times, four landings and a range, by hand: three levels."""
    flag = {"flag_values": np.arange(2), "flag_meanings": "asymptotic not_converging"}
    found = xr.Dataset(
        {
            "step_size": ("level", [0.4, 0.2, 0.1], {"units": "s"}),
            "run_outcome": ("level", np.array(["completed", "completed", "event"])),
        }
    )
    found["at_time"] = ("at", [1.0, 2.5], {"units": "s"})
    numbers = {
        "x": ("at", np.array([[1.0, 2.0], [1.5, np.nan], [1.75, np.nan]]), "m"),
        "event_time_low": ("occurrence", np.arange(12.0).reshape(3, 4), "s"),
    }
    for name, (place, values, units) in numbers.items():
        count = values.shape[1]
        changes = np.vstack([np.diff(values, axis=0), np.full((1, count), np.nan)])
        found[name], found[f"difference_{name}"] = (
            (("level", place), values, {"units": units}),
            (("level", place), changes),
        )
        found[f"order_{name}"] = (("level", place), np.array([[np.nan] * count, [1.0] * count, [np.nan] * count]))
        found[f"verdict_{name}"] = (place, np.zeros(count, np.int8), flag)
        found[f"uncertainty_{name}"] = (place, np.full(count, 0.25))
    found["n"], found["difference_n"] = ("level", [3.0, 3.5, 3.625], {"units": "1"}), ("level", [0.5, 0.125, np.nan])
    return found.assign_attrs({"varied": "step_size", **more})


def test_levels_that_met_other_events_leave_no_order_in_words() -> None:
    """Assert that states of unknown uncertainty are told so, without an order, and which events only one level met."""
    study = refined_by_hand()
    study["uncertainty_x"] = ("at", np.full(2, np.inf))
    study["event_count_low"], study["event_count_high"] = ("level", [3, 4, 6]), ("level", [1, 2, 2])
    lines = refinement_in_words(study)
    assert "x at t = 1 s = 1.75 m, of unknown uncertainty, asymptotic" in lines
    (said,) = (line for line in lines if line.startswith("attention"))
    assert "did not meet the same events (low 4 and 6 times)" in said
    assert not any(
        line.startswith("attention") for line in refinement_in_words(study.assign(event_count_low=("level", [6, 6, 6])))
    )
    judged = judge(np.array([1.0, 1.0, 1.0]), np.array([0.4, 0.2, 0.1]), 2.0, 1e-15, 0.0, np.inf, smooth=True)
    assert (judged.verdict, judged.uncertainty) == (EVENT_LIMITED, np.inf)


def test_a_refinement_in_words() -> None:
    """Assert every line of a study by hand: levels, outcomes, the finest values with uncertainty, order and verdict."""
    assert refinement_in_words(refined_by_hand(stopped="done")) == [
        "levels    step_size 0.4, 0.2, 0.1 s",
        "outcomes  completed, event",
        "±         numerical, at about 95 %; what parameters and the start are uncertain by is not in it",
        "x at t = 1 s = 1.75 ± 0.25 m, order 1, asymptotic",
        "x at t = 2.5 s is not there in the finest level",
        "event_time_low [1] = 8.00 ± 0.25 s, order 1, asymptotic",
        "event_time_low [2] = 9.00 ± 0.25 s, order 1, asymptotic",
        "event_time_low [3] = 10.00 ± 0.25 s, order 1, asymptotic",
        "event_time_low: 1 further occurrence is in the record",
        "n = 3.625, changed by 0.125",
        "stopped   done",
    ]
    two = refined_by_hand().isel(level=[1, 2], occurrence=[0, 1, 2])
    lines = refinement_in_words(two.assign(step_size=("level", np.array(["a", "b"]), {"units": "1"})))
    assert lines[0] == "levels    step_size a, b"
    assert lines[3] == "x at t = 1 s = 1.75 ± 0.25 m, asymptotic"
    assert lines[-2:] == ["event_time_low [3] = 10.00 ± 0.25 s, asymptotic", "n = 3.625, changed by 0.125"]


# ------------------------------------------------------------------------------------------------------------ comparing


def test_differences_are_in_the_first_runs_unit() -> None:
    """Assert second less first, errors of both, and the scale of the first, of metres beside millimetres; none of what is not known."""
    one, other = (xr.DataArray(0.0, attrs={"units": units}) for units in ("m", "mm"))
    here, there = (
        (np.array([2.0, -4.0]), np.array([0.5, 0.25]), np.zeros(2)),
        (np.array([2500.0, -3000.0]), np.array([100.0, 200.0]), np.zeros(2)),
    )
    found = difference_of("x", one, other, here, there)
    assert found["difference_x"][1].tolist() == [0.5, 1.0]
    assert found["interpolation_error_x"][1].tolist() == pytest.approx([0.6, 0.45])
    assert float(found["difference_scale_x"][1]) == 4.0
    assert found["scaled_difference_x"][1].tolist() == [0.125, 0.25]
    assert found["difference_x"][2]["units"] == found["interpolation_error_x"][2]["units"] == "m"
    back = difference_of("x", other, one, there, here)
    assert back["difference_x"][1].tolist() == [-500.0, -1000.0]
    assert float(back["difference_scale_x"][1]) == 3000.0
    zero = difference_of("x", one, other, (0.0 * here[0], *here[1:]), there)
    assert float(zero["difference_scale_x"][1]) == 3.0
    assert difference_of("x", one, other, None, there) == difference_of("x", one, other, here, None) == {}


def met_by_hand(times: list[float], doubt: float, detectors: list[int] | None = None) -> xr.Dataset:
    """A run with events."""
    flags = {"flag_values": np.arange(2), "flag_meanings": "low high"}
    kinds = {"flag_values": np.arange(1), "flag_meanings": "crossing"}
    found = xr.Dataset({"time": ("step", np.linspace(0.0, 5.0, 11), {"units": "s"}), "event_time": ("event", times)})
    found["event_time_uncertainty"] = ("event", np.full(len(times), doubt))
    found["event_kind"] = ("event", np.zeros(len(times), int), kinds)
    found["event_detector"] = ("event", np.array(detectors or [0] * len(times)), flags)
    return found


def test_times_between_two_locations_of_one_event_are_left_out() -> None:
    """Assert times between both as wide as both are uncertain, ends included, and none where they are farther apart."""
    first, second = met_by_hand([1.0, 3.0], 0.125), met_by_hand([1.25, 3.5], 0.25)
    at = np.array([0.62, 0.625, 1.0, 1.25, 1.625, 1.63, 3.0, 3.25])
    assert times_between(first, second, at).tolist() == [False, True, True, True, True, False, False, False]
    assert times_between(second, first, at).tolist() == times_between(first, second, at).tolist()
    assert not times_between(first, met_by_hand([1.25, 3.5], 0.25, [1, 1]), at).any()
    assert list(event_count_differences(first, second)) == []
    assert list(event_count_differences(first, met_by_hand([1.0, 2.0, 3.0], 0.1, [0, 1, 1]))) == [
        "low: 2 | 1",
        "high: 0 | 2",
    ]


def test_runs_part_where_interpolation_cannot_be_off_so_far() -> None:
    """Assert the earliest time of all quantities, beyond their errors and rounding, that is not beside an event."""
    times = np.array([1.0, 2.0, 3.0, 4.0])
    first = met_by_hand([], 0.0).assign(x=("step", np.full(11, 2.0)), y=("step", np.full(11, -1.0)))

    def said(x: list[float], y: list[float], passed: tuple[int, ...] = ()) -> str:
        variables = {
            "at_time": ((), times),
            "difference_x": ((), np.array(x), {"units": "m"}),
            "interpolation_error_x": ((), np.full(4, 0.25)),
        }
        variables |= {"difference_y": ((), np.array(y), {"units": "s"}), "interpolation_error_y": ((), np.zeros(4))}
        return parting_text(variables, first, ["x", "y", "z"], np.isin(np.arange(4), passed))

    assert said([0.0, 0.25, -0.5, 9.0], [0.0] * 4) == "t = 3 s: x by -0.5 m, beyond an interpolation error of 0.25 m"
    assert said([0.0, 0.25, -0.5, 9.0], [0.0] * 4, (2,)).startswith("t = 4 s: x by 9 m")
    assert said([0.0, 0.0, 1.0, 0.0], [0.0, 1e-3, 0.0, 0.0]).startswith(
        "t = 2 s: y by 0.001 s, beyond an interpolation error of 0 s"
    )
    assert said([0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 1e-3, 0.0]).startswith("t = 3 s: x")
    assert said([0.25] * 4, [1e-17, -1e-17, 0.0, 0.0]) == ""


def test_a_cause_is_the_first_of_what_differs() -> None:
    """Assert the order from the model to settings, how many more there are, and settings that follow from others left out."""
    nothing: dict[str, Any] = dict.fromkeys(("model", "parameters", "initial", "settings"), "") | {"identical": False}
    assert cause_of(nothing) == "nothing that is recorded differs but the numbers"
    assert cause_of(nothing | {"identical": True, "model": "x"}) == ""
    assert cause_of(nothing | {"initial": "y: 1 | 2", "settings": "a: 1 | 2"}) == "initial: y: 1 | 2"
    assert cause_of(nothing | {"parameters": "k: 1 | 2\nm: 1 | 3\nc: 0 | 1"}) == "parameters: k: 1 | 2, and 2 more"
    assert independent_settings(["a: 1 | 'absent'", "b: 1 | 2"]) == ["b: 1 | 2"]
    assert independent_settings(["a: 1 | 'absent'"]) == ["a: 1 | 'absent'"]
    assert (_shortened_text("a" * 60), _shortened_text("a" * 61)) == ("a" * 60, "a" * 57 + "…")
    assert list(_flatten_table("", {"m": {"value": 2, "unit": "kg", "u": 1}, "n": {"a": 1}})) == [
        ("m.value", "2 kg"),
        ("m.u", "1"),
        ("n.a", "1"),
    ]


def test_times_of_comparison_are_those_that_both_reach() -> None:
    """Assert accepted times of either, those that were kept alone, and what is said where there are none or they go back."""

    def run(times: list[float], apart: int = 1) -> xr.Dataset:
        return xr.Dataset({"time": ("step", times, {"units": "s"})}, attrs={"keep_every": apart} if apart > 1 else {})

    assert common_times(run([0.0, 1.0, 2.0]), run([0.5, 1.5, 2.5])).tolist() == [0.5, 1.0, 1.5, 2.0]
    assert common_times(run([0.0, 1.0]), run([1.0, 2.0])).tolist() == [1.0]
    with pytest.raises(
        xd.InputError, match="no time in common: one goes from 0.0 s to 1.0 s, the other from 1.5 s to 2.0 s"
    ):
        common_times(run([0.0, 1.0]), run([1.5, 2.0]))
    with pytest.raises(xd.InputError, match="the times of the second run do not increase after t = 2.0 s"):
        common_times(run([0.0, 1.0]), run([0.0, 2.0, 1.0]))


def test_a_comparison_in_words() -> None:
    """Assert how many variables differ, what differs, and the largest difference of each quantity with its place and scale."""
    role = {"role": "difference", "units": "m"}
    found = xr.Dataset(
        {
            "same": ("variable", [0, 1, 0]),
            "at_time": ("at", [1.0, 2.0, 3.0], {"units": "s"}),
            "difference_x": ("at", [1.0, -3.0, 2.0], role),
        }
    )
    found["difference_event_time_low"] = ("occurrence", [0.25, 0.5], role | {"units": "s"})
    for name, size, units in (("x", 6.0, "m"), ("event_time_low", 2.0, "s")):
        found[f"scaled_difference_{name}"] = (
            found[f"difference_{name}"].dims,
            found[f"difference_{name}"].values / size,
        )
        found[f"difference_scale_{name}"] = ((), size, {"units": units, "role": "scale"})
    found.attrs = {
        "identical": False,
        "first_difference": "x",
        "model": "",
        "parameters": "k: 1 | 2\nm: 1 | 2",
        "initial": "",
        "events": "low: 1 | 2",
        "settings": "s: 1 | 2",
        "cause": "why",
        "parted": "",
    }
    lines = comparison_in_words(found)
    assert lines == [
        "2 of 3 variables differ; first: x",
        "parameter k: 1 | 2",
        "parameter m: 1 | 2",
        "events    low: 1 | 2",
        "setting   s: 1 | 2",
        "cause     why",
        "times     3 at which both are known",
        "parted    nowhere by more than interpolation can be off",
        "difference of   largest  where         over its scale",
        "x               -3 m     t = 2 s       -0.5 of 6 m",
        "event_time_low  0.5 s    occurrence 2  0.25 of 2 s",
    ]
    found.attrs["identical"] = True
    assert comparison_in_words(found) == ["the same: 3 variables and every setting, bit for bit"]


@pytest.mark.cases(400)
def test_events_are_matched_where_both_are_closest(case: int) -> None:
    """Assert the window of the longer row with the least mean distance, in either order, by trying all."""
    rng = np.random.default_rng(case)
    long = np.sort(rng.uniform(0.0, 10.0, int(rng.integers(1, 9))))
    n = int(rng.integers(1, long.size + 1))
    short = np.sort(long[int(rng.integers(0, long.size - n + 1)) :][:n] + rng.normal(0.0, 0.2, n))
    away = [float(np.abs(long[k : k + n] - short).sum()) for k in range(long.size - n + 1)]
    rows = (np.arange(n) + int(np.argmin(away))).tolist()
    assert [one.tolist() for one in match_times(long, short)] == [rows, list(range(n))]
    if n < long.size:
        assert [one.tolist() for one in match_times(short, long)] == [list(range(n)), rows]
    assert [one.tolist() for one in match_times(long, np.zeros(0))] == [[], []]


def test_events_that_are_not_known_are_none() -> None:
    """Assert that a record without event times has no events to match, and one of these alone has them by name."""
    detector = ("event", np.array([1, 0, 1]), {"flag_values": np.array([0, 1]), "flag_meanings": "ground apex"})
    times = ("event", np.array([0.1, 0.2, 0.3]))
    whole = xr.Dataset({"event_detector": detector, "event_time": times, "event_time_uncertainty": times})
    assert {name: rows.tolist() for name, rows in event_rows_by_name(whole).items()} == {"apex": [0, 2], "ground": [1]}
    assert event_rows_by_name(whole.drop_vars("event_time")) == {}
    assert event_rows_by_name(xr.Dataset()) == {}


def test_an_exhibit_says_what_it_is_and_of_which_runs() -> None:
    """Assert digests of runs, title, kind and further attributes, coordinates, and every variable as it was given."""
    variables = {"at_time": (("at",), np.array([1.0]), {"units": "s"}), "x": (("at",), np.array([2.0]), {"units": "m"})}
    found = evidence_dataset("study", "a title", ["abc", "def"], variables, {"more": 3})
    assert [found.attrs[name] for name in ("title", "source", "evidence", "runs", "more")] == [
        "a title",
        "study by xdynamics",
        "study",
        "abc def",
        3,
    ]
    assert list(found.coords) == ["at_time"]
    assert found.x.attrs["units"] == "m"


# ------------------------------------------------------------------------------------------------------------ observing


def observed() -> xd.Model:
    """A mass on a spring, in kilojoule and centimetre, with an observable that is a product."""
    return xd.Model(
        name="observed",
        coordinates={"x": "cm"},
        parameters={"m": "2 kg", "k": "8 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "100 cm", "v_x": "0 cm s-1", "q": "0 m"},
        observables={"power": "k*x*v_x", "pull": "m*a_x"},
        states={"q": {"unit": "m", "rate": "v_x"}},
    )


def test_derived_quantities_have_the_errors_of_all_they_read() -> None:
    """Assert energies and observables by their formulas on sampled states, and the sum of what each state's error moves."""
    model = observed()
    run, times = xd.simulate(model, method="rk4", step=0.2, until=2.0), np.array([0.13, 0.77, 1.5])
    at = xd.sample(run, times)
    x, v, dx, dv = (one.values / 100.0 for one in (at.x, at.v_x, at.error_x, at.error_v_x))
    assert (dx > 0.0).all()
    assert (dv > 0.0).all()
    found = observe(run, model, ["x", "kinetic_energy", "power"], times)
    assert found["x"][0].tolist() == at.x.values.tolist()
    assert found["x"][1].tolist() == at.error_x.values.tolist()
    assert found["kinetic_energy"][0] == pytest.approx(v**2)
    assert found["kinetic_energy"][1] == pytest.approx(np.abs((v + dv) ** 2 - v**2), rel=1e-6)
    assert run.power.attrs["units"] == "W"
    assert found["power"][0] == pytest.approx(8.0 * x * v)
    assert found["power"][1] == pytest.approx(np.abs(8.0 * dx * v) + np.abs(8.0 * x * dv), rel=1e-6)
    with pytest.raises(xd.InputError, match="observable 'heat' is none of the model's; there are x, v_x"):
        observe(run, model, ["heat"], times)
    assert "pull" in comparable(model)
    held = xd.Model.from_text(model.to_toml() + '\n[contacts.wall]\ngap = "x + 2*metre"\nrestitution = 0.5\n')
    assert "pull" not in comparable(held)
    assert {"x", "v_x", "q", "kinetic_energy", "power"} <= {*comparable(held)}


def test_what_contacts_do_behind_a_row_is_that_of_the_step_from_it() -> None:
    """Assert that an open contact holds nothing, a closed one does, and of a corner's two the one without force does not."""
    model = xd.Model(
        name="block",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        forces={"weight": {"y": "-10*newton"}},
        initial={"y": "0 m", "v_y": "0 m s-1"},
        contacts={"floor": {"gap": "y", "restitution": 0.0}},
    )
    run = xd.simulate(model, method="rk4", step=0.5, until=1.0)
    columns = {name: run[name].values.copy() for name in ("contact_state_floor", "contact_force_floor")}
    rows = np.array([0, 1])
    (holds, turned) = modes_behind(model, columns, rows, rows + 1).values()
    assert (holds.tolist(), turned.tolist()) == ([1.0, 1.0], [0.0, 0.0])
    columns["contact_force_floor"][:] = [0.0, 10.0, 0.0]
    assert next(iter(modes_behind(model, columns, rows, rows + 1).values())).tolist() == [1.0, 1.0]
    columns["contact_force_floor"][:] = [0.0, 0.0, 10.0]
    assert next(iter(modes_behind(model, columns, rows, rows + 1).values())).tolist() == [0.0, 1.0]
    columns["contact_state_floor"][0] = 0
    columns["contact_force_floor"][:] = 10.0
    assert next(iter(modes_behind(model, columns, rows, rows + 1).values())).tolist() == [0.0, 1.0]


# ---------------------------------------------------------------------------------------------------------------- study


def studied(model: xd.Model, steps: list[float], until: float, names: tuple[str, ...], at: Any = None) -> Study:
    """A study by rk4 over steps."""
    levels = Levels(model, STEPS, np.array(steps), 4.0, {"method": "rk4", "until": until})
    return study_of(levels, runs_of(levels), names, at)


def study_of(levels: Levels, runs: list[xr.Dataset], names: tuple[str, ...], at: Any = None, kind: Any = Study) -> Any:
    """A study of runs."""
    return kind.of_runs(StudyQuantities(levels, names, at), runs)


def runs_of(levels: Levels) -> list[xr.Dataset]:
    """The runs of all levels."""
    return [levels.marched(k) for k in range(len(levels.values))]


def test_a_study_has_the_energy_range_and_the_mean_period_of_each_level() -> None:
    """Assert largest less least energy, mean periods between located crossings and their errors, and phases in turns."""
    study = studied(OSCILLATOR, [0.2, 0.1], 12.0, ("energy_range", "period_x", "phase_x"), [4.0, 7.0])
    energy, period, phase = study.numbers()
    for k, run in enumerate(runs_of(study.levels)):
        total = run.total_energy.values
        assert float(energy.values[0, k]) == float(total.max() - total.min()) > 0.0
        counted = xd.diagnose(run, companion=False)
        assert float(period.values[0, k]) == pytest.approx(float(counted.period.mean()))
        ends = np.array([float(counted.cycle_time[0] - counted.period[0]), *counted.cycle_time.values.tolist()])
        assert phase.values[:, k] == pytest.approx(np.interp([4.0, 7.0], ends, 2 * np.pi * np.arange(ends.size)))
        assert (
            0.0 < float(period.errors[0, k]) <= 2.0 * float(counted.period_uncertainty.max()) / counted.sizes["cycle"]
        )
        speed = 2 * np.pi / float(counted.period.mean())
        assert phase.errors[:, k] == pytest.approx(float(period.errors[0, k]) / 2 * counted.sizes["cycle"] * speed)
    assert (energy.errors == 0.0).all()
    assert energy.scale == float(runs_of(study.levels)[-1].total_energy.max())
    assert (energy.dims, period.dims, phase.dims, period.units, phase.units) == ((), (), ("at",), "s", "rad")


def test_a_study_compares_at_the_earliest_end_unless_it_is_asked() -> None:
    """Assert the end of the run that is the shortest, times in the order given, and what is outside."""
    study = studied(OSCILLATOR, [0.3, 0.1], 1.0, ("x",))
    assert study.times.tolist() == [min(float(run.time[-1]) for run in runs_of(study.levels))]
    assert studied(OSCILLATOR, [0.3, 0.1], 1.0, ("x",), "200 ms").times.tolist() == [0.2]
    assert studied(OSCILLATOR, [0.3, 0.1], 1.0, ("x",), [0.0, 1.0]).times.tolist() == [0.0, 1.0]
    for at in (-0.1, 1.1):
        with pytest.raises(xd.InputError, match=f"at has {at} s, needs times in every run, from 0.0 s to 1.0 s"):
            _ = studied(OSCILLATOR, [0.3, 0.1], 1.0, ("x",), at).times


def test_events_before_a_time_move_what_is_compared_there() -> None:
    """Assert the rates before each event times the uncertainty of its time; without bound where events differ in number."""
    text = BALL.to_toml().replace("1e-12 s", "1e-5 s")
    study = studied(xd.Model.from_text(text), [0.1, 0.05], 5.0, ("v_y",), [1.0, 3.0])
    (speed, *_) = study.numbers()
    run = runs_of(study.levels)[-1]
    row = int(run.event_row_before[0])
    rate = abs(float(run.v_y[row] - run.v_y[row - 1]) / float(run.time[row] - run.time[row - 1]))
    assert float(run.event_time[0]) < 3.0
    assert speed.event_errors.tolist() == pytest.approx([0.0, rate * float(run.event_time_uncertainty[0])])
    assert (speed.event_errors[1] > 0.0, speed.scale) == (True, float(np.abs(run.v_y).max()))
    eps = float(np.finfo(float).eps)
    largest = np.abs(speed.values).max(axis=1)
    assert speed.rounding == pytest.approx(4.0 * eps * largest * math.sqrt(run.sizes["step"]), rel=1e-12, abs=0.0)
    first, last = (float(run.event_time[0]) for run in runs_of(study.levels))
    between = studied(xd.Model.from_text(text), [0.1, 0.05], 5.0, ("v_y",), [(first + last) / 2, last])
    assert np.isinf(next(between.numbers()).event_errors).all()


def test_a_study_of_events_scales_by_the_span_of_the_run() -> None:
    """Assert times, location, rounding and scale of the two events of a thrown ball, in each level."""
    study = studied(BALL, [0.1, 0.05], 5.0, (), [1.0])
    for number in study.numbers():
        name = number.name.removeprefix("event_time_")
        for k, run in enumerate(runs_of(study.levels)):
            row = study.event_rows()[name][k]
            assert number.values[0, k] == float(run.event_time[row][0])
            assert number.errors[0, k] == float(run.event_time_uncertainty[row][0])
        assert number.rounding == pytest.approx(
            4.0 * float(np.finfo(float).eps) * number.values[:, -1], rel=1e-12, abs=0.0
        )
        assert number.scale == float(runs_of(study.levels)[-1].time[-1] - runs_of(study.levels)[-1].time[0])
        assert (number.dims, number.units) == (("occurrence",), "s")


# ------------------------------------------------------------------------------------------------------------ bit by bit


def recorded(rng: np.random.Generator) -> xr.Dataset:
    """A record made by hand: numbers along two dimensions, a pair of them, a text and a parameter."""
    found = xr.Dataset(
        {
            "x": ("step", rng.normal(size=6), {"units": "m", "role": "coordinate"}),
            "both": (("event", "bound"), rng.normal(size=(3, 2)), {"units": "s"}),
            "m": ((), float(rng.normal()), {"units": "kg", "role": "parameter"}),
            "word": ("step", np.array(list("abcdef")), {"units": "1"}),
        }
    )
    return found.assign_coords(time=("step", np.arange(6.0), {"units": "s"})).assign_attrs(solver_step=0.1)


@pytest.mark.cases(200)
def test_the_first_row_that_differs_is_named(case: int) -> None:
    """Assert rows of all that differ, one bit at a time, and the earliest row of the march in words, first run first."""
    rng = np.random.default_rng(case)
    first = recorded(rng)
    second, rows = first.copy(deep=True), {}
    for name in rng.permutation(["x", "both", "m", "time"])[: int(rng.integers(0, 4))]:
        values = second[name].values if name != "time" else second["time"].values.copy()
        row = int(rng.integers(len(values))) if values.ndim else 0
        rows[str(name)] = row
        where = (row, *[int(rng.integers(2))] * (values.ndim - 1)) if values.ndim else ()
        values[where] = np.nextafter(values[where], np.inf)
        if name == "time":
            second = second.assign_coords(time=("step", values, {"units": "s"}))
    table = compare_bits(first, second)
    assert {str(name): int(row) for name, row in zip(table.name.values, table.first_row.values, strict=True)} == {
        name: rows.get(name, -1) for name in ("time", "x", "both", "m", "word")
    }
    assert table.same.values.tolist() == [int(name not in rows) for name in table.name.values]
    assert table.attrs["identical"] == int(not rows)
    along = {name: row for name, row in rows.items() if name in ("time", "x")} or rows
    if rows:
        earliest = min(along.values())
        names = [name for name in table.name.values if along.get(str(name)) == earliest]
        where = "" if names[0] == "m" else f", row {earliest}"
        before, after = (
            (one[names[0]] if names[0] == "m" else one[names[0]][earliest]).values.tolist() for one in (first, second)
        )
        assert table.attrs["first_difference"] == f"variable '{names[0]}'{where}: {before!r} | {after!r}"
    else:
        assert table.attrs["first_difference"] == ""


def test_lengths_kinds_units_and_settings_differ_too() -> None:
    """Assert the row behind the shorter, row 0 of another kind, unit or name, and settings in the order of both runs."""
    first = recorded(np.random.default_rng(1))
    shorter = compare_bits(first, first.isel(step=slice(4)))
    assert dict(zip(shorter.name.values.tolist(), shorter.first_row.values.tolist(), strict=True)) == {
        "time": 4,
        "x": 4,
        "both": -1,
        "m": -1,
        "word": 4,
    }
    assert shorter.attrs["first_difference"] == "variable 'time', row 4: 4.0 | no such row (4 rows)"
    others = {
        "row 0: ": first.x.astype("f4", keep_attrs=True),
        "attribute 'units': 'm' | 'cm'": first.x.assign_attrs(units="cm"),
        "attribute 'long_name': ": first.x.assign_attrs(long_name="other"),
    }
    for said, other in others.items():
        assert compare_bits(first, first.assign(x=other)).attrs["first_difference"].startswith(f"variable 'x', {said}")
    for pair, said in (((first, first.drop_vars("m")), " | absent"), ((first.drop_vars("m"), first), "absent | ")):
        assert compare_bits(*pair).attrs["first_difference"].startswith("variable 'm': ")
        assert said in compare_bits(*pair).attrs["first_difference"]
        assert sorted(compare_bits(*pair).first_row.values.tolist()) == [-1, -1, -1, -1, 0]
    other = compare_bits(first, first.assign_attrs(solver_step=0.2, solver_rtol="x" * 90))
    assert (other.attrs["identical"], other.attrs["first_difference"]) == (0, "attribute solver_step: 0.1 | 0.2")
    assert other.attrs["settings"].split("\n") == ["solver_step: 0.1 | 0.2", f"solver_rtol: 'absent' | '{'x' * 76}…"]


@pytest.mark.parametrize(("row", "size", "relative"), [(2, 5.0, 2.5), (5, 0.5, 0.25)])
def test_the_largest_difference_is_against_the_largest_value(row: int, size: float, relative: float) -> None:
    """Assert that of an archive that comes out otherwise the worst state is told, its row and its share of the range."""
    kept = recorded(np.random.default_rng(2)).assign(
        x=("step", np.array([0.0, 1.0, -2.0, 0.5, 0.0, 1.0]), {"units": "m", "role": "coordinate"})
    )
    again = kept.copy(deep=True)
    again["x"].values[row] += size
    again["both"].values[0, 1] *= 100.0  # no state
    said = compare_reproduction(kept, again).attrs["arithmetic"]
    assert said == f"the largest difference is {size:.3g} m in 'x', row {row}: {relative:.2g} of its largest value"
    longer = again.isel(step=slice(5)) if row == 2 else again.isel(step=slice(0))
    rest = f"; 6 rows became {longer.sizes['step']}"
    assert compare_reproduction(kept, longer).attrs["arithmetic"].endswith(rest)
    only = kept.copy(deep=True)
    only["both"].values[2, 0] += 1.0
    assert "in 'both', row 2: " in compare_reproduction(kept, only).attrs["arithmetic"]
    other = compare_reproduction(kept.assign_attrs(math_functions="old"), kept.assign_attrs(math_functions="new"))
    assert (
        other.attrs["arithmetic"]
        == "the archive was made with the elementary functions 'old', here they are 'new'; every number has the same bits"
    )
    assert other.attrs["identical"] == 1
    for key, said in (
        ("xdynamics_version", "version 1 wrote the law in other words than 2"),
        ("schema_version", "records of schema 1 had the law in other words than those of schema 2"),
    ):
        pair = [kept.assign_attrs({key: letter, "force_digest": letter}) for letter in "12"]
        assert compare_reproduction(*pair).attrs["arithmetic"] == f"{said}; every number has the same bits"
        assert compare_reproduction(*pair).attrs["identical"] == 1
        assert compare_reproduction(pair[0], pair[1].assign_attrs({key: "1"})).attrs["identical"] == 0
        assert compare_reproduction(pair[0], pair[1].assign_attrs(force_digest="1")).attrs["arithmetic"] == ""


# ----------------------------------------------------------------------------------------------------------- companions


def falling(*events: str, **more: Any) -> xr.Dataset:
    """Euler's fall, too high by g h t/2, past 5 m."""
    known = {"level": {"function": "y + 5*metre"}, "early": {"function": "v_y + 0.5*metre/second"}}
    model = xd.Model(
        name="fall",
        coordinates={"y": "m"},
        parameters={"g": "10 m s-2"},
        mass={"y": "1*kilogram"},
        forces={"gravity": {"y": "-g*1*kilogram"}},
        initial={"y": "0 m", "v_y": "0 m s-1"},
        events={name: known[name] for name in events},
    )
    return xd.simulate(model, until=2.0, **({"method": "forward_euler", "step": 0.1} | more))


def test_a_tighter_run_tells_the_error_since_the_start() -> None:
    """Assert g h t/2 of Euler, by runs of half the steps, given one by one too; words, digests and lines."""
    for asked in ({}, {"step": [0.1] * 20}):
        found = companion(falling(**asked), [0.5, 2.0])
        assert found.global_error_y.values == pytest.approx([0.25, 1.0], rel=1e-9)
        assert found.attrs["companion"] == "half the steps"
        assert len(set(found.attrs["runs"].split())) == 2
    assert "difference from the run with half the steps, times 2" in found.global_error_y.attrs["long_name"]
    assert list(companion_lines(companion(falling()))) == [
        "beside a run with half the steps",
        "y = -19 m at t = 2 s, off by 1",
        "v_y = -20 m s-1 at t = 2 s, off by 0",
    ]


def test_every_event_has_its_own_error() -> None:
    """Assert times later than in half the steps, doubled, of events by their names, and their lines."""
    run, half = falling("level", "early"), falling("level", "early", step=0.05)
    found = companion(run)
    assert found.event_time.values.tolist() == run.event_time.values.tolist()
    late = 2.0 * (run.event_time.values - half.event_time.values)
    assert found.event_time_global_error.values == pytest.approx(late, rel=1e-9, abs=1e-14)
    assert late[-1] == pytest.approx(float(run.event_time[-1]) - 1.0, rel=0.3)
    lines = list(companion_lines(found))
    assert len(lines) == 1 + 2 + run.sizes["event"]
    assert lines[-1].startswith(f"event at t = {float(run.event_time[-1]):.2f}")
    assert lines[-1].endswith(f" s, off by {late[-1]:.2g} s")


def test_events_that_only_one_run_has_met_have_no_error() -> None:
    """Assert the difference times the factor of each event that both have, in its own row, and none of one that is missing."""
    model = xd.Model(
        name="passing",
        coordinates={"x": "m"},
        parameters={"v": "1 m s-1"},
        mass={"x": "1*kilogram"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={"late": {"function": "x - 0.8*metre"}, "early": {"function": "x - 0.2*metre"}},
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    faster = xd.simulate(model.replace(initial={"v_x": "1.25 m s-1"}), method="rk4", step=0.1, until=0.5)
    for one, other, errors in ((run, faster, [3.0 * (0.2 - 0.16), math.nan]), (faster, run, [3.0 * (0.16 - 0.2)])):
        found = Companion(one, other, 3.0, "another speed", None).event_errors()
        assert found == pytest.approx(errors, rel=1e-9, nan_ok=True)
    none = xd.simulate(model, method="rk4", step=0.1, until=0.1)
    assert Companion(none, run, 3.0, "more", None).event_errors().shape == (0,)
    assert np.isnan(Companion(run, none, 3.0, "less", None).event_errors()).tolist() == [True, True]


@pytest.mark.parametrize(("method", "factor"), [("rk4", 16 / 15), ("heun", 4 / 3), ("forward_euler", 2.0)])
def test_half_the_steps_tell_by_the_order(method: str, factor: float) -> None:
    """Assert the difference from the run with half the steps, times 2**p/(2**p - 1), with its sign."""
    run, half = (xd.simulate(OSCILLATOR, method=method, step=h, until=1.0) for h in (0.1, 0.05))
    found = companion(run)
    assert float(found.global_error_x[0]) == pytest.approx(factor * float(run.x[-1] - half.x[-1]), rel=1e-12)


@pytest.mark.parametrize(("side", "sign"), [("before", -1.0), ("after", 1.0)])
def test_states_at_an_event_are_those_of_the_side_asked_for(side: str, sign: float) -> None:
    """Assert the speed on either side of a reset at its very time; a companion's is the one behind. No error unless asked for."""
    run = runs_of(bounced([0.1, 0.05], 1.0).levels)[0]
    time = float(run.event_time[0])
    found = xd.sample(run, time, side=side)
    assert found.v_y.values == pytest.approx([sign * math.sqrt(20.0)])
    assert "global_error_v_y" not in found
    assert companion(run, time).v_y.values == pytest.approx([math.sqrt(20.0)])


def test_defects_of_steps_have_their_sign_and_are_spread() -> None:
    """Assert what one step of Euler is short of sixteen under gravity, of all steps that have a length, or of some spread over them."""
    study = bounced([0.1], 1.0)
    model = study.levels.model_of(0.1)
    euler = xd.simulate(model, method="forward_euler", step=0.1, until=1.0)
    steps = np.diff(euler.time.values)
    steps = steps[steps > 0.0]
    assert euler.sizes["event"] >= 1
    assert len(steps) == euler.sizes["step"] - 1 - euler.sizes["event"]
    found = step_defects(euler)
    assert found["y"] == pytest.approx(10.0 * steps**2 / 2 * 15 / 16, rel=1e-9)
    assert found["v_y"] == pytest.approx(0.0, abs=1e-12)
    few = step_defects(euler, max_steps=4)
    assert few["y"].tolist() == found["y"][np.linspace(0, len(steps) - 1, 4).astype(int)].tolist()
    many = xd.simulate(model, method="forward_euler", step=0.001, until=0.3)
    assert step_defects(many)["y"].shape == (256,)
    with pytest.raises(
        xd.InputError, match="steps of 'radau_iia' depend on those before: none of them is repeated alone"
    ):
        step_defects(xd.simulate(OSCILLATOR, method="radau_iia", step=0.1, until=0.5))


def test_a_tenth_of_the_tolerances_tells_ten_ninths() -> None:
    """Assert tolerances of the tighter run, absolute ones too, and its factor."""
    model = OSCILLATOR
    run = xd.simulate(model, method="dormand_prince", rtol=1e-5, atol={"x": "1e-6 m", "v_x": "1e-6 m s-1"}, until=5.0)
    beside = tighter_of(run, None)
    assert beside.factor == pytest.approx(10.0 / 9.0)
    assert beside.tightening == "a 10th of the tolerances"
    marched = results_of(beside.task)[0]
    assert marched.attrs["solver_rtol"] == pytest.approx(1e-6)
    assert float(marched.x.attrs["atol"]) == pytest.approx(1e-7)
    off = float(run.x[-1]) - math.cos(10.0)
    assert float(companion(run).global_error_x[0]) == pytest.approx(off, rel=0.3)
    part = xr.Dataset.isel(run, step=slice(0, 5))
    with pytest.raises(xd.InputError):
        tighter_of(part, None)


def bounced(steps: list[float], until: float) -> Study:
    """A ball that a reset turns back at the ground, in levels of velocity Verlet, which is exact between."""
    model = xd.Model(
        name="bounced",
        coordinates={"y": "m"},
        parameters={"g": "10 m s-2"},
        mass={"y": "1*kilogram"},
        forces={"gravity": {"y": "-g*1*kilogram"}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
        events={"back": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-v_y"}}},
    )
    levels = Levels(model, STEPS, np.array(steps), 2.0, {"method": "velocity_verlet", "until": until})
    return study_of(levels, runs_of(levels), ("y", "v_y"))


def test_occurrences_are_those_of_the_finest_level() -> None:
    """Assert times and states behind of each occurrence, their location's part, and that what one level misses is nan."""
    study = bounced([0.1, 0.05], 2.0)
    times, place, speed = (number for number in study.numbers() if "back" in number.name)
    true = math.sqrt(0.2) * np.array([1.0, 3.0])
    assert times.values == pytest.approx(np.stack([true, true], axis=1))
    assert speed.values == pytest.approx(math.sqrt(20.0))
    assert place.values == pytest.approx(0.0, abs=1e-9)
    for k, run in enumerate(runs_of(study.levels)):
        doubts = run.event_time_uncertainty.values
        assert times.errors[:, k].tolist() == doubts.tolist()
        assert speed.errors[:, k] == pytest.approx(10.0 * doubts)
        assert place.errors[:, k] == pytest.approx(math.sqrt(20.0) * doubts)
    assert speed.scale == float(np.abs(runs_of(study.levels)[-1].v_y).max())
    fewer = study_of(
        study.levels, [runs_of(study.levels)[0], runs_of(bounced([0.1, 0.05], 1.0).levels)[1]], ("y", "v_y"), [0.2]
    )
    (once, *_) = [number for number in fewer.numbers() if number.name == "event_time_back"]
    assert once.values.shape == (1, 2)
    none = study_of(
        study.levels, [runs_of(study.levels)[0], runs_of(bounced([0.1, 0.05], 0.3).levels)[1]], ("y", "v_y"), [0.2]
    )
    (missed, *_) = [number for number in none.numbers() if number.name == "event_time_back"]
    assert missed.values[:, 0] == pytest.approx(true)
    assert np.isnan(missed.values[:, 1]).all()


def test_a_level_that_ended_before_the_times_is_named() -> None:
    """Assert that a run which ended badly is refused for times behind its end, not for those before, and not one that is whole."""
    study = studied(OSCILLATOR, [0.3, 0.1], 1.0, ("x",))
    bad = runs_of(study.levels)[0].assign_attrs(run_outcome="step_limit", run_outcome_text="too many steps")
    ended = study_of(study.levels, [bad.isel(step=slice(0, 3)), runs_of(study.levels)[1]], ("x",), None)
    ended.check_reached(np.array([0.1, 0.6]))
    study.check_reached(np.array([0.1, 2.0]))
    with pytest.raises(
        xd.InputError,
        match="the level with step_size = 0.3 s ended before t = 0.7 s, as 'step_limit': too many steps; leave",
    ):
        ended.check_reached(np.array([0.1, 0.7]))


def test_switches_that_were_stepped_over_are_known_from_their_step_on() -> None:
    """Assert the order that a jump leaves behind the row before it, none before, and the order of a table of levels."""
    study = studied(OSCILLATOR, [0.2, 0.1], 1.0, ("x",))
    assert study.kink_before(1.0) == math.inf
    model = xd.Model(
        name="drag",
        coordinates={"y": "m"},
        parameters={"c": "1 kg m-1"},
        mass={"y": "1*kilogram"},
        forces={"weight": {"y": "-10*newton"}, "drag": {"y": "-c*v_y*abs(v_y)", "smooth": True}},
        initial={"y": "0 m", "v_y": "3 m s-1"},
    )
    past = studied(model, [0.1, 0.05], 1.0, ("y",))
    first = (
        min(float(run.switch_first_passed.min()) for run in runs_of(past.levels))
        if "switch_first_passed" in runs_of(past.levels)[0]
        else 0.0
    )
    assert past.kink_before(1.0) < math.inf
    assert past.kink_before(0.0) == math.inf
    assert past.kink_before(max(first - 0.2, 0.0)) == math.inf


class Timed(Study):
    """A study without located switches, in which the order that switches leave before a time is that time."""

    def _with_switches_located(self, numbers: list[TrackedValue]) -> None:  # noqa: ARG002
        return None

    def kink_before(self, time: float) -> float:
        """Return the time."""
        return time


def test_switches_count_from_when_a_number_is_of() -> None:
    """Assert the times of comparison, those of occurrences in the finest level, and the end for what a whole run has one of."""
    study = bounced([0.1, 0.05], 2.0)
    last = runs_of(study.levels)[-1]
    timed = study_of(study.levels, runs_of(study.levels), ("y", "v_y", "period_y"), [0.4, 1.1], kind=Timed)
    found = {one.name: one.kinks for one in timed.tracked_values()}
    assert all(kinks is not None for kinks in found.values())
    times = last.event_time.values.tolist()
    assert {name: kinks.tolist() for name, kinks in found.items() if kinks is not None} == {
        "y": [0.4, 1.1],
        "v_y": [0.4, 1.1],
        "period_y": [float(last.time[-1])],
        "event_time_back": times,
        "after_back_y": times,
        "after_back_v_y": times,
    }
    fewer = study_of(
        study.levels,
        [runs_of(study.levels)[0], runs_of(bounced([0.1, 0.05], 0.3).levels)[1]],
        ("y",),
        [0.2],
        kind=Timed,
    )
    (missed, _) = [one.kinks for one in fewer.tracked_values() if "back" in one.name]
    assert missed is not None
    assert missed.tolist() == [math.inf, math.inf]


def test_what_located_switches_change_is_added_once_and_a_quarter() -> None:
    """Assert 1.25 times the larger change of the two finest levels, not of the coarsest."""
    model = xd.Model(
        name="drag",
        coordinates={"y": "m"},
        parameters={"c": "1 kg m-1"},
        mass={"y": "1*kilogram"},
        forces={"weight": {"y": "-10*newton"}, "drag": {"y": "-c*v_y*abs(v_y)", "smooth": True}},
        initial={"y": "0 m", "v_y": "3 m s-1"},
    )
    study = studied(model, [0.16, 0.08, 0.05], 0.8, ("y",))
    located = study.levels.located()
    assert located is not None
    (plain,), (watched,) = study.numbers(), study.tracked_values()
    exact = [
        float(observe(located.marched(k), located.model, ["y"], study.times, located.rule(k))["y"][0][0])
        for k in range(3)
    ]
    off = np.abs(exact - plain.values[0])
    assert off[0] > off[1:].max() > 0.0
    assert watched.event_errors == pytest.approx(plain.event_errors + 1.25 * off[1:].max(), rel=1e-12)


def test_a_smooth_table_leaves_the_second_order() -> None:
    """Assert it from the start on, of a force that reads a table which bends."""
    model = xd.Model(
        name="bent",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        drives={"f": {"table": "f.csv", "argument": "x", "csv": "x [m],f [N]\n0,0\n1,1\n2,0\n"}},
        forces={"table": {"x": "f", "smooth": True}},
    )
    assert studied(model, [0.2, 0.1], 0.4, ("x",)).kink_before(0.0) == 2.0


def test_sizes_are_of_all_parts_and_never_0(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert scales from values that come a part at a time, rounding of values below 1, and 1 for what is 0 throughout."""
    study = studied(OSCILLATOR, [0.2, 0.1], 9.0, ("x", "v_x", "energy_range", "period_x"), [0.6, 2.6])
    whole = list(study.numbers())
    eps, rows = float(np.finfo(float).eps), runs_of(study.levels)[-1].sizes["step"]
    for one in whole[:2]:
        assert one.rounding == pytest.approx(
            4.0 * eps * np.abs(one.values).max(axis=1) * math.sqrt(rows), rel=1e-12, abs=0.0
        )
    assert (np.abs(whole[0].values) < 1.0).all()
    assert whole[-1].scale == float(whole[-1].values.max()) > 2.0
    monkeypatch.setattr(
        readings,
        "slabs",
        lambda variable: (variable.values[k : k + 7] for k in range(0, variable.shape[0], 7)),
    )
    assert [number.scale for number in replace(study).numbers()] == [one.scale for one in whole]
    still = OSCILLATOR.replace(initial={"x": "0 m"})
    assert [number.scale for number in studied(still, [0.2, 0.1], 1.0, ("x", "energy_range"), [0.5]).numbers()] == [
        1.0,
        1.0,
    ]


def test_an_event_in_the_first_step_moves_what_follows() -> None:
    """Assert the mean rates of the finest level from the start to the event, times its uncertainty, of a place and a speed."""
    model = xd.Model(
        name="thrown",
        coordinates={"y": "m"},
        mass={"y": "1*kilogram"},
        forces={"gravity": {"y": "-10*newton"}},
        initial={"y": "1 m", "v_y": "1 m s-1"},
        events={"low": {"function": "y - 1.04*metre", "direction": "rising", "time_tolerance": "1e-6 s"}},
    )
    study = studied(model, [0.1, 0.06], 0.3, ("y", "v_y"), [0.2])
    run = runs_of(study.levels)[-1]
    assert run.event_row_before.values.tolist() == [1]
    time, doubt = float(run.event_time[0]), float(run.event_time_uncertainty[0])
    place, speed = [number for number in study.numbers() if number.dims == ("at",)]
    assert place.event_errors == pytest.approx(abs(1.0 - 5.0 * time) * doubt, rel=1e-9)
    assert speed.event_errors == pytest.approx(10.0 * doubt, rel=1e-9)


def test_a_run_that_was_just_written_is_not_examined_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a level in a file is opened without its digest being taken anew, which reads all of it."""
    from xdynamics import archive

    opened: list[dict[str, Any]] = []

    def opening(path: Path, **more: Any) -> xr.Dataset:
        opened.append(more)
        return archive.open_run(path, **more)

    monkeypatch.setitem(
        march_model.__globals__,
        "archive",
        SimpleNamespace(open_run=opening, stream=archive.stream, has_segments=archive.has_segments),
    )
    with march_model(OSCILLATOR, tmp_path / "run.nc", method="rk4", step=0.1, until=1.0) as run:
        assert run.sizes["step"] == 11
    assert opened == [{"check": False}]


def test_an_interrupted_run_is_no_evidence(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what was interrupted ends the evidence that it was to be a part of."""
    asked = {"method": "rk4", "step": 0.1, "until": 1.0}
    assert march_model(OSCILLATOR, **asked).attrs["run_outcome"] == "completed"
    half = SimpleNamespace(marched=lambda run: run.assign_attrs(run_outcome="interrupted"))
    monkeypatch.setitem(march_model.__globals__, "archive", half)
    with pytest.raises(KeyboardInterrupt):
        march_model(OSCILLATOR, **asked)
