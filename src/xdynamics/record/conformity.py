"""Departures of a Dataset from the schema: attributes, variables, and values that index other variables."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite, prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.reaction_names import JOINT
from xdynamics.record.flag_words import plain
from xdynamics.record.folding import model_dimensions
from xdynamics.record.named_rows import rows_named
from xdynamics.record.schemas import are_rows_places, in_words_of, is_run, is_whole
from xdynamics.units import SECONDS, UNKNOWN_UNIT

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

NEEDED = ("units", "long_name", "role")  # of every variable
ALONG_STEPS = (
    "time",
    "coordinate",
    "velocity",
    "acceleration",
    "state",
    "rate",
    "rate_term",
    "force",
    "reaction",
    "multiplier",
    JOINT,
    "residual",
    "gap",
    "energy",
    "observable",
    "error",
)
STORED = ("f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")  # what a file keeps


def faults_of(run: xr.Dataset, *, values: bool = True, is_full_run: bool = True) -> list[str]:
    """List how a Dataset departs from the schema; an empty list is a valid record.

    Parameters
    ----------
    run : xarray.Dataset
    values : bool
        Whether to read times and flags too; else only the values of events.
    is_full_run : bool
        Whether a record not marked as a selection or derived data must have all that a run has.
    """
    is_full_run = is_full_run and is_whole(run.attrs)
    expected = {fixed.name: fixed for fixed in in_words_of(schema.FIXED, run)}
    placed, shaped = is_run(run.attrs), {*model_dimensions(run)}
    variable_faults = {
        name: [
            *_variable_departures(
                str(name), variable, expected.get(str(name)) if placed else None, shaped, placed=placed
            )
        ]
        for name, variable in run.variables.items()
    }
    faults = [*_attribute_departures(run.attrs), *(_missing_variables(run) if is_full_run else ())]
    if schema.STEPS in run.dims and not run.sizes[schema.STEPS]:
        faults.append(f"dimension '{schema.STEPS}' has no row, needs one at least")
    faults += [
        f"variable {str(name)!r} {fault}" for name, departures in variable_faults.items() for fault in departures
    ]
    # values are checked only of variables without faults
    sound = {str(name): run.variables[name] for name, departures in variable_faults.items() if not departures}
    faults += (
        _event_row_departures(run, sound) if is_full_run else ()
    )  # a selection's events name rows of the whole run
    return [*faults, *_flags(sound, everywhere=values), *(_time_departures(sound) if values else ())]


def _attribute_departures(attributes: Mapping[Any, Any]) -> Iterator[str]:
    for name in schema.REQUIRED_ATTRIBUTES:
        if name not in attributes:
            if not is_run(attributes):
                continue
            yield f"attribute '{name}' is missing"
        elif name not in schema.NUMBERS and not isinstance(attributes[name], str):
            yield f"attribute '{name}' is {_short_text(attributes[name])}, needs a text"
    control = attributes.get("solver_step_control", "given")
    if control not in schema.BY_STEP_CONTROL:
        yield f"attribute 'solver_step_control' is {_short_text(control)}; there are {', '.join(schema.BY_STEP_CONTROL)}"
    else:
        yield from (
            f"attribute '{name}' is missing" for name in schema.BY_STEP_CONTROL[control] if name not in attributes
        )
    yield from (
        f"attribute '{name}' is {_short_text(attributes[name])}, needs a number"
        for name in schema.NUMBERS
        if name in attributes and not _is_finite_number(attributes[name])
    )
    yield from (
        f"attribute '{name}' is {_short_text(attributes[name])}, needs two numbers"
        for name in schema.PAIRS
        if name in attributes and np.shape(attributes[name]) != (2,)
    )
    yield from (
        f"attribute '{name}' is {_short_text(attributes[name])}, needs a text"
        for name in (
            schema.EVIDENCE,
            schema.RUNS,
            schema.DERIVED,
            schema.DERIVED_FROM,
            schema.SELECTION,
            schema.SELECTION_OF,
            schema.LEFT_OUT_ATOL,
            schema.ATOL_EFFECT,
        )
        if not isinstance(attributes.get(name, ""), str)
    )
    yield from unkeepable(attributes)


def _missing_variables(run: xr.Dataset) -> Iterator[str]:
    for variable in in_words_of(schema.FIXED, run):
        if variable.name not in run.variables and (variable.dims != (schema.SAMPLES,) or schema.SAMPLES in run.dims):
            yield f"variable '{variable.name}' is missing"
    if "event_detector" not in run.variables:
        yield "variable 'event_detector' is missing"
    if run.sizes.get(schema.BOUNDS, 2) != 2:
        yield f"dimension '{schema.BOUNDS}' has {run.sizes[schema.BOUNDS]} entries, needs 2, the left end and the right one"
    if run.attrs.get("solver_step_control") == "given" and schema.GIVEN_STEP.name not in run.variables:
        yield f"variable '{schema.GIVEN_STEP.name}' is missing"


def _variable_departures(
    name: str, variable: xr.Variable, expected: schema.Variable | None, shaped: set[str], *, placed: bool
) -> Iterator[str]:
    """List the faults of a variable, with its dims in a run record; `shaped` are dimensions of the model."""
    attributes = variable.attrs
    inner = [size for dim, size in zip(variable.dims, variable.shape, strict=True) if dim in shaped]
    outer_dims = tuple(dim for dim in variable.dims if dim not in shaped)
    is_plain_text = variable.dtype.kind in "UO" and (
        variable.dims in ((), (schema.DOCUMENT,)) or attributes.get("role") == schema.LABEL
    )
    if not _is_name(name):
        yield "has a name that no file can keep"
    if expected and tuple(variable.dims) != expected.dims:
        yield f"has dims {tuple(variable.dims)}, needs {expected.dims}"
    elif expected and expected.dtype != "U" and variable.dtype != np.dtype(expected.dtype):
        yield f"has the type {variable.dtype}, needs {np.dtype(expected.dtype)}"
    elif (variable.dtype.kind in "UO" and placed and not is_plain_text) or (
        variable.dtype.kind not in "UO" and variable.dtype.str[1:] not in STORED
    ):
        yield f"has the type {variable.dtype}, needs numbers, or one text without a dimension"
    needed_words = () if name == schema.EVENT_BOUNDS else NEEDED
    yield from (f"has no attribute '{word}'" for word in needed_words if word not in attributes)
    texts = (*NEEDED, "flag_meanings")
    yield from (
        f"has the attribute {word} = {_short_text(attributes[word])}, needs a text"
        for word in texts
        if word in attributes and not isinstance(attributes[word], str)
    )
    yield from (
        f"has the attribute {word} = {_short_text(attributes[word])}, needs a number"
        for word in schema.OF_ELEMENTS
        if word in attributes
        and not _is_finite_number(attributes[word])
        and np.shape(attributes[word]) != (prod(inner),)
    )
    yield from (f": {fault}" for fault in unkeepable(attributes))
    role = attributes.get("role")
    needed = (schema.STEPS,) if role in ALONG_STEPS else () if role == "parameter" else None
    if placed and needed is not None and isinstance(role, str) and (outer_dims != needed or variable.dtype.kind != "f"):
        yield f"is a {role} along {tuple(variable.dims)} of type {variable.dtype}, needs {needed} and float64"
    timeless = (
        expected is not None and expected.units == SECONDS.text and attributes.get("units") == "1"
    )  # a model with dimensionless time
    if attributes.get("units") == UNKNOWN_UNIT:
        if expected:
            yield "was edited since the run was computed, so that its unit is not known"
    elif expected and "units" in attributes and attributes["units"] != expected.units and not timeless:
        yield f"has units {_short_text(attributes['units'])}, needs '{expected.units}'"
    if role == "flag":
        yield from _flag_word_departures(attributes)


def _flag_word_departures(about: Mapping[Any, Any]) -> Iterator[str]:
    """Compare the words of a flag with its numbers."""
    words, numbers = str(about.get("flag_meanings", "")).split(), np.atleast_1d(about.get("flag_values", ()))
    if not words or len(words) != numbers.size:
        yield f"has {len(words)} words in flag_meanings and {numbers.size} numbers in flag_values, needs one for each"


def unkeepable(attributes: Mapping[Any, Any]) -> Iterator[str]:
    """List the attributes that a file cannot keep as they are."""
    for name, value in attributes.items():
        kind = getattr(value, "dtype", None)
        if not isinstance(name, str) or not _is_name(name):
            yield f"attribute {name!r} has a name that no file can keep"
        elif name == schema.ORIGIN:  # which is kept in memory alone
            continue
        elif isinstance(value, str):
            if not _is_text(value):
                yield f"attribute '{name}' is {_short_text(value)}, needs a text without null characters"
        elif not (
            (isinstance(value, float) and kind is None)
            # Python's whole numbers have any size, those of a file 64 bits
            or (isinstance(value, int) and not isinstance(value, bool) and abs(value) < 2**63)
            or (kind is not None and kind.str[1:] in STORED and np.ndim(value) < 2 and np.size(value))
        ):
            yield f"attribute '{name}' is {_short_text(value)}, needs a text, a number or an array of numbers"


def _event_row_departures(run: xr.Dataset, sound: Mapping[str, xr.Variable]) -> Iterator[str]:
    rows, by_place = run.sizes.get(schema.STEPS, 0), are_rows_places(run)
    for name in ("event_row_before", "event_row_after"):
        if {name, *([] if by_place else [schema.STEP_NUMBER.name])} <= {*sound}:
            row_places = np.asarray(sound[name].values) if by_place else rows_named(run, name)
            wrong = np.flatnonzero((row_places < 0) | (row_places >= rows))
            if wrong.size:
                row = sound[name].values[wrong[0]]
                yield f"variable '{name}' names row {row} at event {wrong[0]}, and there are {rows}"


def _flags(sound: Mapping[str, xr.Variable], *, everywhere: bool) -> Iterator[str]:
    for name, variable in sound.items():
        if variable.attrs.get("role") == "flag" and (everywhere or schema.EVENTS in variable.dims):
            values = np.asarray(variable.values)
            wrong = np.flatnonzero(~np.isin(values, np.atleast_1d(variable.attrs["flag_values"])))
            if wrong.size:
                yield (
                    f"variable '{name}' has the value {values.flat[wrong[0]]} at {wrong[0]}, which no word in"
                    " flag_meanings stands for"
                )


def _time_departures(sound: Mapping[str, xr.Variable]) -> Iterator[str]:
    """Check that time never decreases, and repeats only at the pairs of events; of concatenated runs in each of them."""
    if "time" not in sound or "row_kind" not in sound:
        return
    time, kind = np.asarray(sound["time"].values), np.asarray(sound["row_kind"].values)
    gaps = np.diff(time)
    met_at_once = (kind[1:] == schema.EVENT_BEFORE) & np.isin(
        kind[:-1], (schema.INITIAL, schema.EVENT_AFTER)
    )  # at the start, or by another
    # isnan: comparisons with nan are false, so a time that is none would pass them
    wrong = (gaps < 0) | ((gaps == 0) & (kind[1:] != schema.EVENT_AFTER) & ~met_at_once) | np.isnan(gaps)
    sizes = _rows_by_run(sound, sound["time"].dims)
    if sizes is not None:
        if sizes.min(initial=1) < 1 or sizes.sum() != time.size:
            yield (
                f"variable '{schema.ROW_SIZE}' counts {sizes.sum()} rows of {sizes.size} runs, and there are {time.size}: it needs"
                " at least one for each run, and as many as there are in all"
            )
            return
        wrong[np.cumsum(sizes)[:-1] - 1] = False  # where a run ends, the next begins at a time of its own
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0]) + 1
        yield (
            f"variable 'time' goes from {float(time[row - 1])!r} to {float(time[row])!r} at row {row}: it must"
            " increase, but at the pairs of events"
        )


def _rows_by_run(sound: Mapping[str, xr.Variable], dims: tuple[Any, ...]) -> Array | None:
    """Return how many rows each run has where rows of several runs follow one another; None where they do not."""
    sizes = sound.get(schema.ROW_SIZE)
    if sizes is None or dims != (sizes.attrs.get(schema.SAMPLE_DIMENSION),) or sizes.dtype.kind not in "iu":
        return None
    return np.asarray(sizes.values)


def _is_finite_number(value: Any) -> bool:
    number = plain({"": value})[""]
    return isinstance(number, int) or (isinstance(number, float) and isfinite(number))


def _is_name(name: str) -> bool:
    # the rules of netCDF for names: also no slash, and no blank at the end
    first = name[:1].isalnum() or name[:1] == "_" or not name[:1].isascii()
    return first and name.isprintable() and "/" not in name and not name.endswith(" ")


def _is_text(text: str) -> bool:
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return "\0" not in text


def _short_text(value: Any) -> str:
    return repr(str(value)[:40])
