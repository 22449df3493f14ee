"""What a Dataset needs to be a run record: each departure is one fault, told by name, value and place."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.record import faults_of
from xdynamics.record.conformity import unkeepable

Change = Callable[[xr.Dataset], Any]
DERIVED = {"derived": "by hand", "derived_from": "a run"}
SELECTION = {"selection_of": "a run", "selection": "a part"}


@lru_cache
def marched(control: str = "fixed") -> xr.Dataset:
    """A short run with an event, its steps chosen in one of three ways."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    steps = {
        "fixed": {"step": "50 ms"},
        "given": {"step": [0.05] * 60},
        "adaptive": {"method": "dormand_prince", "rtol": 1e-6},
    }
    return xd.simulate(model, until="3 s", **steps[control])


def changed(change: Change, control: str = "fixed") -> xr.Dataset:
    """A run that may be written to, with a change."""
    run = marched(control).copy(deep=True)
    return change(run) or run


def put(name: str, place: Any, value: Any) -> Change:
    """Return a change of one value."""

    def change(run: xr.Dataset) -> None:
        run[name].values[place] = value

    return change


def said(name: str = "", /, **attributes: Any) -> Change:
    """Return a change of attributes, of a variable or of the run; None takes one away."""

    def change(run: xr.Dataset) -> None:
        about = run[name].attrs if name else run.attrs
        about.update(attributes)
        for one in [key for key, value in attributes.items() if value is None]:
            del about[one]

    return change


def without(*names: str) -> Change:
    """Return a change that leaves variables out."""
    return lambda run: run.drop_vars(list(names))


def of_type(name: str, dtype: Any) -> Change:
    """Return a change of a variable's type."""
    return lambda run: run.assign({name: run[name].variable.astype(dtype)})


def added(name: str, *value: Any, **about: Any) -> Change:
    """Return a change that adds a variable."""
    about = {"units": "1", "long_name": "something", "role": "other"} | about
    return lambda run: run.assign({name: (*(value or ((), 1.0)), about)})


FAULTS: list[tuple[Change, str]] = [
    (said(title=None), "attribute 'title' is missing"),
    (said(title=5), "attribute 'title' is '5', needs a text"),
    (said(derived_from=1.0), "attribute 'derived_from' is '1.0', needs a text"),
    (said(selection_atol_si=1), "attribute 'selection_atol_si' is '1', needs a text"),
    (said(solver_order=None), "attribute 'solver_order' is missing"),
    (said(solver_order="2"), "attribute 'solver_order' is '2', needs a number"),
    (said(solver_order=np.array([1, 2])), "attribute 'solver_order' is '[1 2]', needs a number"),
    (said(solver_order=float("inf")), "attribute 'solver_order' is 'inf', needs a number"),
    (
        said(solver_order=10**400),
        f"attribute 'solver_order' is '1{'0' * 39}', needs a text, a number or an array of numbers",
    ),
    (said(solver_order=True), "attribute 'solver_order' is 'True', needs a text, a number or an array of numbers"),
    (said(solver_step_control=None, solver_step=None), "attribute 'solver_step_control' is missing"),
    (
        said(solver_step_control="x" * 50),
        f"attribute 'solver_step_control' is '{'x' * 40}'; there are fixed, given, adaptive",
    ),
    (said(solver_step=None), "attribute 'solver_step' is missing"),
    (said(solver_growth_limits=np.arange(3)), "attribute 'solver_growth_limits' is '[0 1 2]', needs two numbers"),
    (said(note="a\0b"), "attribute 'note' is 'a\\x00b', needs a text without null characters"),
    (said(note="\ud800"), "attribute 'note' is '\\ud800', needs a text without null characters"),
    (said(**{"a/b": 1}), "attribute 'a/b' has a name that no file can keep"),
    (said(note=True), "attribute 'note' is 'True', needs a text, a number or an array of numbers"),
    (said(note=2**63), f"attribute 'note' is '{2**63}', needs a text, a number or an array of numbers"),
    (without("trial_step"), "variable 'trial_step' is missing"),
    (without("sample_stage"), "variable 'sample_stage' is missing"),
    (without("model_toml"), "variable 'model_toml' is missing"),
    (without("event_detector"), "variable 'event_detector' is missing"),
    (lambda run: run.isel(bound=[0]), "dimension 'bound' has 1 entries, needs 2, the left end and the right one"),
    (lambda run: run.isel(step=slice(0), event=slice(0)), "dimension 'step' has no row, needs one at least"),
    (added("a/b"), "variable 'a/b' has a name that no file can keep"),
    (
        lambda run: run.assign(trial_step=run.trial_step.variable.expand_dims("n")),
        "variable 'trial_step' has dims ('n', 'trial'), needs ('trial',)",
    ),
    (of_type("trial_step", "i4"), "variable 'trial_step' has the type int32, needs int64"),
    (
        added("words", "n", ["one", "two"]),
        "variable 'words' has the type <U3, needs numbers, or one text without a dimension",
    ),
    (
        added("half", (), np.float16(1)),
        "variable 'half' has the type float16, needs numbers, or one text without a dimension",
    ),
    (said("theta", units=None), "variable 'theta' has no attribute 'units'"),
    (said("theta", long_name=None), "variable 'theta' has no attribute 'long_name'"),
    (said("theta", role=None), "variable 'theta' has no attribute 'role'"),
    (said("theta", units=5), "variable 'theta' has the attribute units = '5', needs a text"),
    (said("theta", role=5), "variable 'theta' has the attribute role = '5', needs a text"),
    (said("theta", flag_meanings=5), "variable 'theta' has the attribute flag_meanings = '5', needs a text"),
    (said("g", uncertainty="much"), "variable 'g' has the attribute uncertainty = 'much', needs a number"),
    (said("theta", atol=float("nan")), "variable 'theta' has the attribute atol = 'nan', needs a number"),
    (said("theta", atol_si="1"), "variable 'theta' has the attribute atol_si = '1', needs a number"),
    (
        said("theta", note=[]),
        "variable 'theta' : attribute 'note' is '[]', needs a text, a number or an array of numbers",
    ),
    (
        of_type("theta", "i4"),
        "variable 'theta' is a coordinate along ('step',) of type int32, needs ('step',) and float64",
    ),
    (of_type("g", "i4"), "variable 'g' is a parameter along () of type int32, needs () and float64"),
    (said("g", role="state"), "variable 'g' is a state along () of type float64, needs ('step',) and float64"),
    (
        said("theta", role="parameter"),
        "variable 'theta' is a parameter along ('step',) of type float64, needs () and float64",
    ),
    (said("time", units="ms"), "variable 'time' has units 'ms', needs 's'"),
    (
        said("regime", flag_meanings="one two"),
        "variable 'regime' has 2 words in flag_meanings and 1 numbers in flag_values, needs one for each",
    ),
    (
        said("regime", flag_meanings=None, flag_values=None),
        "variable 'regime' has 0 words in flag_meanings and 0 numbers in flag_values, needs one for each",
    ),
    (put("event_row_before", 0, -1), "variable 'event_row_before' names row -1 at event 0, and there are 63"),
    (put("event_row_after", 0, 63), "variable 'event_row_after' names row 63 at event 0, and there are 63"),
    (
        put("row_kind", slice(4, 6), 9),
        "variable 'row_kind' has the value 9 at 4, which no word in flag_meanings stands for",
    ),
    (
        put("event_kind", 0, 99),
        "variable 'event_kind' has the value 99 at 0, which no word in flag_meanings stands for",
    ),
    (
        put("time", slice(3, 5), 0.25),
        "variable 'time' goes from 0.25 to 0.25 at row 4: it must increase, but at the pairs of events",
    ),
    (
        put("time", 5, 0.1),
        "variable 'time' goes from 0.2 to 0.1 at row 5: it must increase, but at the pairs of events",
    ),
    (
        put("time", 5, np.nan),
        "variable 'time' goes from 0.2 to nan at row 5: it must increase, but at the pairs of events",
    ),
]


@pytest.mark.parametrize(("change", "fault"), FAULTS, ids=[fault[:60] for _, fault in FAULTS])
def test_a_departure_is_one_fault(change: Change, fault: str) -> None:
    """Assert that a record with one departure has that fault and no other."""
    assert faults_of(changed(change)) == [fault]


def test_what_each_step_control_needs() -> None:
    """Assert that whole runs have no fault, and that what a record needs hangs on who chose its steps."""
    assert faults_of(marched()) == faults_of(marched("given")) == faults_of(marched("adaptive")) == []
    assert faults_of(changed(without("given_step_size"), "given")) == ["variable 'given_step_size' is missing"]
    assert faults_of(changed(said(solver_rtol=None), "adaptive")) == ["attribute 'solver_rtol' is missing"]
    assert faults_of(changed(lambda run: run.drop_dims("sample"))) == []


@pytest.mark.parametrize("row", [0, 62])
def test_the_first_row_and_the_last_one_are_there(row: int) -> None:
    """Assert that an event may name either."""
    assert faults_of(changed(put("event_row_after", 0, row))) == []


def test_faults_are_gathered() -> None:
    """Assert that those of attributes stand before those of variables, and those of values last."""
    run = changed(said(title=None), "adaptive")
    run = (
        put("time", 5, np.nan)(run) or said("theta", units=None, atol="1")(run) or put("event_kind", 0, 99)(run) or run
    )
    found = faults_of(without("trial_time")(run))
    assert [one.split("'")[1] for one in found] == ["title", "trial_time", "theta", "theta", "event_kind", "time"]


@pytest.mark.parametrize("kind", [{}, SELECTION, DERIVED])
def test_what_is_no_whole_run_need_not_have_all(kind: dict[str, str]) -> None:
    """Assert that parts are asked neither for the rest nor for the rows of their events; a part of no kind by word only."""
    part = changed(lambda run: run.isel(step=slice(3)).drop_vars("trial_step").assign_attrs(kind))
    assert faults_of(part, is_full_run=False) == []
    missing = ["variable 'trial_step' is missing"]
    rows = [
        f"variable 'event_row_{one}' names row {row} at event 0, and there are 3"
        for one, row in (("before", 41), ("after", 42))
    ]
    assert faults_of(part) == ([] if kind else missing + rows)


def test_derived_data_have_attributes_and_variables_of_their_own() -> None:
    """Assert that what a run must have, derived data may lack or have otherwise, and a selection may not."""
    for kind in (SELECTION, DERIVED):
        free = [] if kind is DERIVED else None
        for change, fault in (
            (said(title=None), "attribute 'title' is missing"),
            (of_type("time", "f4"), "variable 'time' has the type float32, needs float64"),
            (
                of_type("theta", "i4"),
                "variable 'theta' is a coordinate along ('step',) of type int32, needs ('step',) and float64",
            ),
        ):
            assert faults_of(changed(change).assign_attrs(kind)) == ([fault] if free is None else free)
        wrong = changed(said("theta", units=None)).assign_attrs(kind)
        assert faults_of(wrong) == ["variable 'theta' has no attribute 'units'"]


def test_values_are_read_where_they_are_asked_for() -> None:
    """Assert that without them only those of events are looked at."""
    run = changed(put("time", 5, np.nan))
    put("row_kind", 5, 9)(run)
    assert faults_of(run, values=False) == []
    assert len(faults_of(run)) == 2
    put("event_kind", 0, 99)(run)
    assert len(faults_of(run, values=False)) == 1


@pytest.mark.parametrize(
    "value", ["", "text", 1, 2**63 - 1, -(2**63) + 1, 1.5, float("nan"), np.float32(1), np.array([1.0]), np.arange(3)]
)
def test_attributes_that_a_file_keeps(value: Any) -> None:
    """Assert that texts, numbers and rows of numbers are kept."""
    assert list(unkeepable({"note": value})) == []


@pytest.mark.parametrize(
    "value",
    [
        None,
        False,
        -(2**63),
        1j,
        [1.0],
        b"text",
        np.bool_(0),
        np.zeros((1, 2)),
        np.zeros(0),
        np.array(["a"]),
        np.float16(1),
    ],
)
def test_attributes_that_no_file_keeps(value: Any) -> None:
    """Assert that everything else is named with its value."""
    fault = f"attribute 'note' is {str(value)[:40]!r}, needs a text, a number or an array of numbers"
    assert list(unkeepable({"note": value})) == [fault]


def test_names_that_a_file_keeps() -> None:
    """Assert that names begin with a letter, a digit or an underline, and hold neither a slash nor what is not seen."""
    assert list(unkeepable(dict.fromkeys(("a", "Z9", "_x", "é", "µ m", "9", "x-y"), 1))) == []
    for name in ("", "-x", " x", "x ", "x/y", "x\ny", "x\0", 5):
        assert list(unkeepable({name: 1})) == [f"attribute {name!r} has a name that no file can keep"], name
