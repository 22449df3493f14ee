"""Schemas of records: the former schema and today's, converted both ways, and the kinds of partial records.

An archive stays as it was written. In `xdynamics-1` the variables that name rows of ``step`` hold positions among the
recorded rows, texts have no dimension, and rows have no numbers.

A record that is not a complete run is a selection of a run, or data derived from a run.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from xdynamics import schema
from xdynamics.faults import InputError
from xdynamics.march.outcomes import GOOD
from xdynamics.record.named_rows import rows_named
from xdynamics.shapes.naming import internal_text

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import xarray as xr
    from numpy.typing import NDArray

    from xdynamics.schema import Variable

COMPLETED = (
    "`xdynamics complete RUN.nc -o WHOLE.nc`, or xdynamics.complete(run) in Python, computes it again to its whole log"
)
RARE = f"one in {{0}} (keep_every = {{0}}): {COMPLETED}"


def is_derived(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is marked as made from a run by anything but a march."""
    return schema.DERIVED in attributes


def is_selection(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is marked as an unchanged part of a run."""
    return schema.SELECTION_OF in attributes and not is_derived(attributes)


def is_evidence(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is marked as evidence, made to judge runs."""
    return schema.EVIDENCE in attributes and not is_derived(attributes)


def is_run(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record is a run or a part of one, as it was marched."""
    return schema.EVIDENCE not in attributes and not is_derived(attributes)


def is_whole(attributes: Mapping[Any, Any]) -> bool:
    """Whether a record should have all that a run has."""
    return is_run(attributes) and not is_selection(attributes)


def has_its_rows(run: xr.Dataset) -> bool:
    """Whether a run has the rows that its events name; `isel` and the like keep the complete run's attributes."""
    parts = {
        "time": schema.STEPS,
        "event_time": schema.EVENTS,
        "event_detector": schema.EVENTS,
        "event_row_before": schema.EVENTS,
    }
    if "run_outcome" not in run.attrs or any(
        name not in run or run[name].dims != (dim,) for name, dim in parts.items()
    ):
        return False
    times, rows = run["time"].values, rows_named(run, "event_row_before")
    return bool((rows >= 0).all()) and times.size > 0 and np.array_equal(times[rows], run["event_time"].values)


def rows_apart(attributes: Mapping[Any, Any]) -> int:
    """Return the spacing of recorded rows in a run's grid: 1 where all rows are recorded."""
    return int(attributes.get(schema.KEEP_EVERY, 1))


def check_every_row(attributes: Mapping[Any, Any], subject: str) -> None:
    """Check that a record has every row, for evidence that needs them all.

    Raises
    ------
    InputError
        Naming what needs them, and the remedy.
    """
    if (every := rows_apart(attributes)) > 1:
        raise InputError(f"{subject} needs every row of the run, and this record has {RARE.format(every)}")


def log_description(attributes: Mapping[Any, Any]) -> str:
    """Describe the logged columns of a record, and the call that adds the others; empty if it has all."""
    if schema.LOG not in attributes:
        return ""
    which = (
        f"'{attributes[schema.LOG]}'"
        if attributes[schema.LOG] != schema.CHOSEN
        else f"[{', '.join(map(repr, str(attributes.get(schema.LOGGED, '')).split()))}]"
    )
    return f"it was computed with log = {which}: {COMPLETED}"


def check_every_column(attributes: Mapping[Any, Any], subject: str) -> None:
    """Check that a record has every column, for evidence that needs them all.

    Raises
    ------
    InputError
        Naming what needs them, and the remedy.
    """
    if missing_columns := log_description(attributes):
        raise InputError(f"{subject} needs all columns of a run's log, and this record has not: {missing_columns}")


def with_article(kind: str) -> str:
    """Return a kind of evidence as a sentence names it: a budget, an extension, events.

    Examples
    --------
    >>> with_article("diagnosis"), with_article("events"), with_article("envelope")
    ('a diagnosis', 'events', 'an envelope')
    """
    several = kind.endswith("s") and not kind.endswith(("ss", "is"))
    return kind if several else f"{'an' if kind[:1] in 'aeio' else 'a'} {kind}"


def kind_description(attributes: Mapping[Any, Any]) -> str:
    """Describe a record that is not a complete run; empty for a complete one."""
    if is_derived(attributes):
        return f"derived data, no run: {attributes[schema.DERIVED]}; from run {attributes.get(schema.DERIVED_FROM, 'unknown')}"
    if is_evidence(attributes):
        runs = len(str(attributes.get(schema.RUNS, "")).split())
        run_count = "1 run" if runs == 1 else f"{runs} runs"
        return f"evidence, no run: {f'{with_article(attributes[schema.EVIDENCE])} from {run_count}' if runs else attributes[schema.EVIDENCE]}"
    if is_selection(attributes):
        return f"a selection of run {attributes[schema.SELECTION_OF]}: {attributes.get(schema.SELECTION, 'a part')}"
    return ""


def left_out_atols(attributes: Mapping[Any, Any]) -> dict[str, tuple[float, str]]:
    """Return the absolute tolerances, in SI units, and the units of variables that a selection left out.

    Raises
    ------
    InputError
        If the attribute cannot be read.
    """
    text = str(attributes.get(schema.LEFT_OUT_ATOL, "{}"))
    try:
        return {internal_text(str(name)): (float(size), str(units)) for name, (size, units) in json.loads(text).items()}
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise InputError(
            f"attribute '{schema.LEFT_OUT_ATOL}' is {text[:40]!r}, needs tolerances and units by name"
        ) from None


def ending_words(attributes: Mapping[Any, Any]) -> tuple[str, str]:
    """Return how a run ended, as one sentence, and the remarks that follow it; without a word of either an empty text.

    An end that was not asked for has its word before the sentence.

    Examples
    --------
    >>> ending_words({"run_outcome": "completed", "run_outcome_text": "reached t = 2 s; stiff: radau_iia takes fewer steps"})
    ('reached t = 2 s', 'stiff: radau_iia takes fewer steps')
    >>> ending_words({"run_outcome": "nonfinite_force", "run_outcome_text": "at t = 2 s, h = 0.1 s: y is nan"})[0]
    'nonfinite force: at t = 2 s, h = 0.1 s: y is nan'
    """
    sentence, _, remarks = str(attributes.get("run_outcome_text", "")).partition("; ")
    word = str(attributes.get("run_outcome", ""))
    if not sentence or not word or word in GOOD:
        return sentence or word, remarks
    return f"{word.replace('_', ' ')}: {sentence}", remarks


MADE = "made"  # in the encoding of the numbers of rows that what names rows has: whether the file has none


def modern(run: xr.Dataset) -> xr.Dataset:
    """Return an opened record under today's schema, in which variables that describe the run are coordinates.

    Whether it is of the former schema is said by its attributes, as before.
    """
    of_run = schema.EVIDENCE not in run.attrs
    if schema.is_former(run.attrs):
        if run.attrs.get(schema.EVIDENCE) != schema.SWEEP and not has_document(run):
            run = _with_texts(run, along_document)
        if schema.STEPS in run.dims and of_run:
            run = _numbered(run)
    names = {name for name in schema.TEXT_NAMES if name in run.variables}
    if of_run:
        roles = {str(name): variable.attrs.get("role") for name, variable in run.variables.items()}
        names |= {name for name, role in roles.items() if schema.is_coordinate(name, role)}
    modern_run = run.set_coords(names - {*run.coords})
    for (
        variable
    ) in modern_run.variables.values():  # xarray would write the names of coordinates that were dropped since
        variable.encoding.pop("coordinates", None)
    if schema.EVENT_BOUNDS in modern_run.variables:
        # None: xarray would write nan as _FillValue of floats, and bounds of times have no missing values
        modern_run.variables[schema.EVENT_BOUNDS].encoding["_FillValue"] = None
    modern_run.set_close(run._close)  # noqa: SLF001 - a Dataset that xarray derives does not close its file
    return modern_run


def as_written(run: xr.Dataset, numbers: NDArray[np.int64] | None = None) -> xr.Dataset:
    """Return a record in the words of its schema; the reverse of `modern`.

    Parameters
    ----------
    run : xarray.Dataset
    numbers : ndarray of int, optional
        The numbers of all rows of the record that this is a part of, among which what names rows has its places; by
        default its own.
    """
    if not schema.is_former(run.attrs) or are_rows_places(run):
        return run
    run = _with_texts(run, lambda text: text.isel({schema.DOCUMENT: 0}) if text.dims == (schema.DOCUMENT,) else text)
    if is_selection(run.attrs):  # whose names of rows were never converted
        return run
    if (row_numbers := run.variables.get(schema.STEP_NUMBER.name)) is not None:
        if row_numbers.encoding.get(MADE):
            return run.drop_vars(schema.STEP_NUMBER.name)
        numbers = np.asarray(row_numbers.values) if numbers is None else numbers
        run = with_variables(run, {schema.STEP_NUMBER.name: _marked(row_numbers, None)})
    return run if numbers is None else by_places(run, numbers)


def by_places(run: xr.Dataset, numbers: NDArray[np.int64]) -> xr.Dataset:
    """Return a record whose row names are positions among rows of given numbers."""
    return _with_changed_rows(run, lambda named_numbers: np.searchsorted(numbers, named_numbers))


def in_own_words(run: xr.Dataset) -> xr.Dataset:
    """Return a record of the former schema, opened here once and written by another program, in the words of its file."""
    if (
        schema.is_former(run.attrs)
        and not are_rows_places(run)
        and rows_apart(run.attrs) == 1
        and (numbers := run.variables.get(schema.STEP_NUMBER.name)) is not None
        and np.array_equal(numbers.values, np.arange(numbers.size))
    ):
        numbers.encoding[MADE] = True
    return as_written(run)


def are_rows_places(run: xr.Dataset) -> bool:
    """Whether row names of a record are positions among its rows, as in files of the former schema."""
    numbers = run.variables.get(schema.STEP_NUMBER.name)
    return (
        schema.is_former(run.attrs)
        and not (numbers is not None and MADE in numbers.encoding)
        and not any(run.variables[name].dims for name in schema.TEXT_NAMES if name in run.variables)
    )


def _marked(numbers: xr.Variable, made: bool | None) -> xr.Variable:  # noqa: FBT001
    """Return numbers of rows with a mark that what names rows has them, and whether a file has not; None for no mark."""
    marked = numbers.copy(deep=False)
    marked.encoding = {key: entry for key, entry in numbers.encoding.items() if key != MADE}
    marked.encoding |= {} if made is None else {MADE: made}
    return marked


def has_document(run: xr.Dataset) -> bool:
    """Whether something of an old model has the name of the dimension of texts, which have none then."""
    return schema.DOCUMENT in run.variables or run.sizes.get(schema.DOCUMENT, 1) > 1


def along_document(text: xr.Variable) -> xr.Variable:
    """Return a text along the dimension that texts have."""
    return text if text.dims else cast("xr.Variable", text.expand_dims(schema.DOCUMENT))


def _with_texts(run: xr.Dataset, change: Callable[[xr.Variable], xr.Variable]) -> xr.Dataset:
    texts = {name: change(run.variables[name]) for name in schema.TEXT_NAMES if name in run.variables}
    return with_variables(run, texts)


def _with_changed_rows(run: xr.Dataset, change: Callable[[NDArray[np.int64]], NDArray[Any]]) -> xr.Dataset:
    changed = {}
    for name in schema.NAMES_ROWS:
        if name in run.variables:
            row_variable = run.variables[name]
            changed[name] = row_variable.copy(data=change(np.asarray(row_variable.values)).astype(row_variable.dtype))
    return with_variables(run, changed)


def with_variables(run: xr.Dataset, variables: dict[str, xr.Variable]) -> xr.Dataset:
    """Return a record with some variables replaced; coordinates stay coordinates."""
    import xarray as xr

    if not variables:
        return run
    all_variables: dict[Any, xr.Variable] = {**run.variables, **variables}
    return xr.Dataset._construct_direct(  # noqa: SLF001 - `assign` would align what cannot be apart
        all_variables,
        {*run.coords},
        attrs=dict(run.attrs),
        indexes=dict(run.xindexes),
        close=run._close,  # noqa: SLF001
        encoding=run.encoding,
    )


def _numbered(run: xr.Dataset) -> xr.Dataset:
    """Give rows their numbers, and name rows by them."""
    import xarray as xr

    if schema.STEP_NUMBER.name not in run.variables:
        if is_selection(run.attrs):
            return run  # its rows have no numbers any more
        made = xr.Variable(
            (schema.STEPS,), np.arange(run.sizes[schema.STEPS]), schema.STEP_NUMBER.attributes, fastpath=True
        )
        return with_variables(run, {schema.STEP_NUMBER.name: _marked(made, True)})  # noqa: FBT003
    if rows_apart(run.attrs) == 1 or is_selection(run.attrs):
        return run
    row_numbers = run.variables[schema.STEP_NUMBER.name]
    numbers = np.asarray(row_numbers.values)
    run = with_variables(run, {schema.STEP_NUMBER.name: _marked(row_numbers, False)})  # noqa: FBT003
    return _with_changed_rows(run, lambda places: numbers[places])


def in_words_of(variables: Sequence[Variable], run: xr.Dataset) -> list[Variable]:
    """Return the required variables and texts of a schema in the form that a record has, in its file or opened."""
    expected_variables, texts = [*variables], dict[str, tuple[str, ...]]()
    if schema.is_former(run.attrs) or has_document(run):
        texts = {
            name: (schema.DOCUMENT,) if run.variables[name].dims else ()
            for name in schema.TEXT_NAMES
            if name in run.variables
        }
    if schema.is_former(run.attrs):
        expected_variables = [
            expected
            for expected in expected_variables
            if expected.name != schema.STEP_NUMBER.name or expected.name in run.variables
        ]
    return [replace(variable, dims=texts.get(variable.name, variable.dims)) for variable in expected_variables]


def in_words_of_today(attributes: dict[str, Any]) -> dict[str, Any]:
    """Return attributes of a part of a run under today's schema, with the schema of its law."""
    return attributes | {
        "Conventions": schema.CONVENTIONS,
        "schema_version": schema.SCHEMA_VERSION,
        schema.SCHEMA_OF_LAW: attributes["schema_version"],
    }
