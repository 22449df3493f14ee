"""What a record says of how it was made, and the way back from it.

What a record remembers of itself, and what of that goes with it elsewhere.
Whether two marches are the same: every word that their bits hang on, and which of them differ.
Records that are no whole run: how one is known, and what is said of it.
Records of the former schema in the words of today, and back.
"""

from __future__ import annotations

import copy
import pickle
import re
from importlib.metadata import version
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.driven_swing import swing
from cases.former_records import former
from cases.problems import MODELS, oscillator, particle
from xdynamics.archive import integrity
from xdynamics.archive.content import content_digest
from xdynamics.archive.integrity import Origin, OriginalVariable, marched, remember_archive, variable_digest
from xdynamics.faults import InputError
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.march.control import FIRST_STEP
from xdynamics.march.implicit.newton import MOST_ITERATIONS, NEWTON_TOLERANCE
from xdynamics.march.implicit.radau import MOST_SETTLING, MOST_TURNS, SETTLED
from xdynamics.methods.implicit import SHARE
from xdynamics.record import identity, is_of, same_settings, word_differences
from xdynamics.record.arguments import recorded_arguments, recorded_scales
from xdynamics.record.provenance import _versions_and_processor, xdynamics_version
from xdynamics.record.schemas import (
    as_written,
    is_derived,
    is_selection,
    is_whole,
    kind_description,
    left_out_atols,
    modern,
)
from xdynamics.schema import NAMES_ROWS

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


def record() -> xr.Dataset:
    """A small record."""
    return xr.Dataset(
        {"x": ("step", np.arange(3.0), {"units": "m"}), "text": ((), "abc")}, attrs={"title": "t", "order": 2}
    )


def test_what_was_marched_is_remembered_as_it_is() -> None:
    """Assert that nothing is copied or hashed, that arrays are closed to writing, and which digests there will be."""
    run = record()
    values, digest = run.x.values, content_digest(run)
    made = marched(run)
    assert made is run
    assert not values.flags.writeable
    kept: Origin = made.attrs["origin"]
    assert kept.parts["x"].variable is not None
    assert kept.parts["x"].variable.data is values
    assert "digest" not in vars(kept.parts["x"])
    assert (kept.parts["x"].dims, kept.parts["x"].shape, kept.parts["x"].attributes) == (
        ("step",),
        (3,),
        {"units": "m"},
    )
    assert kept.parts["x"].digest == variable_digest("x", record().variables["x"])
    assert (kept.content_digest, kept.attributes) == (digest, record().attrs)
    whole = kept.original_record()
    assert whole is not None
    assert content_digest(whole.assign_attrs(record().attrs)) == digest


def test_parts_are_made_when_they_are_asked_for_and_once() -> None:
    """Assert that a run which nobody saves costs nothing."""
    made: list[str] = []
    part = OriginalVariable("x", (), (), {}, known_digest="1" * 64)
    kept = Origin.from_parts(lambda: made.append("made") or {"x": part}, {}, None)
    assert made == []
    assert (kept.parts["x"], kept.parts["x"].digest, made) == (part, "1" * 64, ["made"])


def test_a_run_of_which_a_part_is_gone_is_none() -> None:
    """Assert that values are only at hand where all of them are."""
    kept: Origin = marched(record()).attrs["origin"]
    some = {"x": kept.parts["x"], "text": kept.parts["text"].sent}
    assert Origin.from_parts(lambda: some, {}, None).original_record() is None


def test_a_copy_is_the_same_past_and_a_sent_one_its_digests() -> None:
    """Assert that copies share what is remembered, and that another process is sent digests and the way to the values."""
    kept: Origin = marched(record()).attrs["origin"]
    assert copy.copy(kept) is copy.deepcopy(kept) is kept
    sent = pickle.loads(pickle.dumps(kept))
    assert (sent, sent.attributes, sent.content_digest) == ([integrity.TEXT], record().attrs, kept.content_digest)
    assert sent.parts == {
        name: OriginalVariable(name, part.dims, part.shape, part.attributes, None, part.digest)
        for name, part in kept.parts.items()
    }
    assert (sent.source, sent.original_record()) == (None, None)
    elsewhere = Origin.from_parts(lambda: kept.parts, {}, place)
    assert pickle.loads(pickle.dumps(elsewhere)).original_record() == "the run again"


def place() -> Any:
    """Where a run is read again."""
    return "the run again"


@pytest.mark.parametrize("source", [None, place])
def test_what_was_read_is_known_by_the_digests_of_its_file(source: Any) -> None:
    """Assert that digests are taken off the variables, what is said of storage is no part, and values come from the file."""
    run = record()
    run["x"].attrs |= {"sha256": "1" * 64, "coordinates": "time"}
    kept: Origin = remember_archive(run, source).attrs["origin"]
    assert "sha256" not in run.x.attrs
    assert kept.parts["x"] == OriginalVariable("x", ("step",), (3,), {"units": "m"}, None, "1" * 64)
    assert kept.parts["text"].known_digest == ""
    assert kept.original_record() == (source and "the run again")


CHOSEN = {"method": "dormand_prince", "rtol": 1e-6}


def march(model: xd.Model | None = None, **asked: Any) -> March:
    """A march of the oscillator that is not begun."""
    model = model or oscillator().model
    return March(model, settings_for(model, **{"method": "velocity_verlet", "until": 1.0, "step": 0.1} | asked))


def test_every_word_of_a_march_has_its_name() -> None:
    """Assert that settings stand under their own names, what is in groups behind the group's, and nothing that was not given."""
    found = identity(march(step=None, atol={"x": "1 mm", "v_x": "2 mm s-1"}, scales={"length": "3 m"}, **CHOSEN))
    expected = {
        "method": "dormand_prince",
        "until": "1.0",
        "rtol": "1e-06",
        "atol.x": "0.001",
        "atol.v_x": "0.002",
        "safety": "0.9",
        "scales.length": "3.0",
        "estimator": "'embedded'",
        "nodes": "()",
        "model.parameters.k": "'4.0 N m-1'",
        "math_functions": "xdynamics 2",
    }
    assert {name: found.get(name) for name in expected} == expected
    assert {"version", "law"} <= set(found)
    assert not [name for name in found if name.startswith(("units", "tolerances", "pacing", "step", "."))]


@pytest.mark.parametrize("length", [58, 59])
def test_a_long_word_is_its_beginning_and_its_digest(length: int) -> None:
    """Assert that of more than 60 characters, quotes counted, no more than the start is kept, and that any change is seen."""
    words = [identity(march(particle(description="x" * length + end))) for end in ("", "y")]
    if length == 58:
        assert words[0]["model.description"] == f"'{'x' * 58}'"
    else:
        digest = "2e72cb43f466d585"
        assert words[0]["model.description"] == f"'{'x' * 19}… (61 characters, sha256 {digest})"
    assert [one.split()[0] for one in word_differences(*words)] == ["model.description"]


@pytest.mark.parametrize(
    ("kept", "here", "said"),
    [
        ({"until": "1"}, {"until": "1"}, []),
        ({"until": "1", "step": "2"}, {"until": "3", "step": "2"}, ["until was 1 and is 3"]),
        ({"step": "2"}, {"nodes": "4"}, ["step was 2 and is not given", "nodes was not given and is 4"]),
        ({"law": "a", "step": "2"}, {"law": "b", "step": "3"}, ["step was 2 and is 3"]),
        ({"law": "a", "step": "2"}, {"law": "b", "step": "2"}, ["law was a and is b"]),
    ],
)
def test_what_differs_is_said(kept: dict[str, str], here: dict[str, str], said: list[str]) -> None:
    """Assert both values of each word that differs; the law's digest only where nothing else explains it."""
    assert word_differences(kept, here) == said


def test_a_finished_record_is_of_its_march() -> None:
    """Assert that the settings are another matter, and that model, law, version and end are not."""
    run, one = xd.simulate(oscillator().model, step=0.1, until=1.0), march(step=0.05)
    assert is_of(run, one)

    def other(**attributes: str) -> xr.Dataset:
        return run.assign_attrs(attributes)

    for name in ("model_digest", "force_digest", "xdynamics_version"):
        assert not is_of(other(**{name: "another"}), one), name
    assert not is_of(other(run_outcome="interrupted"), one)
    assert is_of(other(run_outcome="step_limit"), one)


def test_tolerances_may_be_named_or_not() -> None:
    """Assert that marches are the same where every variable has the same tolerance, however it was told."""
    names = ("x", "v_x")
    bare, named, wider, none = (
        march(**{"step": None} | CHOSEN | more).settings
        for more in (
            {"atol": 1e-6},
            {"atol": {"x": "1 um", "v_x": "1 um s-1"}},
            {"atol": {"x": "2 um"}},
            {"rtol": None, "step": 0.1, "method": "rk4"},
        )
    )
    assert same_settings(bare, named, names)
    assert same_settings(none, none, names)
    assert not same_settings(bare, march(step=None, **CHOSEN).settings, names)  # those follow their variables
    assert not same_settings(bare, wider, names)
    assert not same_settings(bare, none, names)
    assert not same_settings(bare, march(step=None, until=2.0, **CHOSEN).settings, names)


DERIVED = {"derived": "halved", "derived_from": "0a"}
SELECTION = {"selection_of": "0b", "selection": "3 of 9 rows of 'step'"}


@pytest.mark.parametrize(
    ("attributes", "kinds", "said"),
    [
        ({"title": "a run"}, (False, False, True), ""),
        (DERIVED, (True, False, False), "derived data, no run: halved; from run 0a"),
        ({"derived": "halved"}, (True, False, False), "derived data, no run: halved; from run unknown"),
        (SELECTION, (False, True, False), "a selection of run 0b: 3 of 9 rows of 'step'"),
        ({"selection_of": "0b"}, (False, True, False), "a selection of run 0b: a part"),
        (SELECTION | DERIVED, (True, False, False), "derived data, no run: halved; from run 0a"),
    ],
)
def test_a_record_is_of_one_kind_and_says_so(attributes: Any, kinds: tuple[bool, ...], said: str) -> None:
    """Assert that derived data, selections and runs are told apart; what is both is derived."""
    assert (is_derived(attributes), is_selection(attributes), is_whole(attributes)) == kinds
    assert kind_description(attributes) == said


def test_tolerances_of_what_was_left_out_come_back() -> None:
    """Assert numbers and units by name, and none where nothing was left out."""
    assert left_out_atols({"selection_atol_si": '{"x": [1e-9, "m"], "w": [2, "rad s-1"]}'}) == {
        "x": (1e-9, "m"),
        "w": (2.0, "rad s-1"),
    }
    assert left_out_atols({}) == {}


@pytest.mark.parametrize("text", ["", "{", "[]", '{"x": 1}', '{"x": [1]}', '{"x": ["much", "m"]}', 5, "[" * 100_000])
def test_tolerances_that_were_not_written_so_are_named(text: object) -> None:
    """Assert one error with the first 40 characters of the attribute."""
    said = f"attribute 'selection_atol_si' is {str(text)[:40]!r}, needs tolerances and units by name"
    with pytest.raises(InputError, match=f"^{re.escape(said)}$"):
        left_out_atols({"selection_atol_si": text})


def test_pointers_of_a_thinned_record_become_numbers_and_places_again() -> None:
    """Assert that places among every seventh row are read as numbers of the march, and written as places."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    run = xd.simulate(model, until="1.4 s", method="rk4", step="1 ms", keep_every=7)
    old = former(run)
    assert old.event_row_before.values.tolist() != run.event_row_before.values.tolist()
    read = modern(old)
    for name in NAMES_ROWS:
        if name in run:
            assert read[name].values.tolist() == run[name].values.tolist(), name
    assert read.model_toml.item() == run.model_toml.item()
    assert {"m", "event_time", "model_toml", "step_number"} <= {*read.coords}
    assert (
        read.dynamics.events("floor").before_v_y.values.tolist()
        == run.dynamics.events("floor").before_v_y.values.tolist()
    )
    written = as_written(read)
    for name, variable in old.variables.items():
        assert written.variables[name].identical(variable), name
