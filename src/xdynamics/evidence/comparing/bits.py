"""Two runs compared bit for bit: every variable, every setting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import prod
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.arrays import flattened_rows
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.faults import InputError, escaped
from xdynamics.record import own_attributes, plain
from xdynamics.record.folding import model_dimensions
from xdynamics.record.unfolding import element_labels
from xdynamics.shapes.naming import join_element_name
from xdynamics.units import parse_unit

SLAB = 1_000_000  # numbers, or one row that has more
# the text of the law, which another version may write differently, the set of elementary functions, the words of
# records and the sentence of the outcome, in which later versions report more doubts about a run
LAW = (
    *("force_source", "force_digest", "math_functions"),
    *("Conventions", "schema_version", schema.SCHEMA_OF_LAW, "run_outcome_text"),
)
# what later versions define differently: in 0.1, the uncertainty of an event's location had no lower bound
REDEFINED = ("event_time_uncertainty",)
OFFSETS = "event_offset_"  # of 0.2, always 0
# what follows from a march and is not a setting of it: how `sample` interpolates, by the writing version, and rates
FOLLOWING = (
    "solver_interpolation",
    "solver_interpolation_order",
    "run_fastest_rate",
    "run_h_omega_start",
    "run_h_omega_largest",
    "run_h_omega_rule",
    schema.ATOL_EFFECT,
    schema.CONTACT_ARITHMETIC,
)
# arithmetic that records name: what it is of, and the words of one that was not named yet
NAMED_ARITHMETIC = {
    schema.SERIES_ARITHMETIC: ("Taylor series", "products and sums rounded one by one"),
    schema.CONTACT_ARITHMETIC: ("forces of contacts", "one after the other, in the order of their declaration"),
}


def compare_bits(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Compare every variable and attribute of two runs bit for bit.

    Returns
    -------
    xarray.Dataset
        Along `variable`: `name`, `same` (1 or 0), `first_row` (the first row that differs, -1 where none does).
        Attributes: `identical`, `first_difference` (a sentence, the earliest row of `step` first), `settings`
        (attributes that differ, a line each).
    """
    return _bitwise_table(first, second, worded=True)


def compare_reproduction(archived_run: xr.Dataset, repeated_run: xr.Dataset) -> xr.Dataset:
    """Compare an archive with a new run of its own model.

    Returns
    -------
    xarray.Dataset
        As returned by `compare_bits`. If the archive was made by another version, with another set of elementary
        functions or another schema of the record, words do not count (the text of the law, the name of the set, the
        vocabulary of flags), nor do variables and settings that the archive's version did not have: `identical` is 1
        if every number has the same bits and every setting is the same. `arithmetic` describes what differs in one
        sentence; it is empty if nothing does.
    """
    versions = [str(run.attrs.get("xdynamics_version", "of unknown name")) for run in (archived_run, repeated_run)]
    sets = [str(run.attrs.get("math_functions", "of unknown name")) for run in (archived_run, repeated_run)]
    schemas = [
        str(run.attrs.get(schema.SCHEMA_OF_LAW, run.attrs.get("schema_version", "of unknown name")))
        for run in (archived_run, repeated_run)
    ]
    same = versions[0] == versions[1] and sets[0] == sets[1] and schemas[0] == schemas[1]
    table = _bitwise_table(archived_run, repeated_run, worded=same)
    reasons = []
    if versions[0] != versions[1] and archived_run.attrs.get("force_digest") != repeated_run.attrs.get("force_digest"):
        reasons.append(f"version {versions[0]} wrote the law in other words than {versions[1]}")
    elif schemas[0] != schemas[1] and archived_run.attrs.get("force_digest") != repeated_run.attrs.get("force_digest"):
        reasons.append(f"records of schema {schemas[0]} had the law in other words than those of schema {schemas[1]}")
    if sets[0] != sets[1]:
        reasons.append(f"the archive was made with the elementary functions '{sets[0]}', here they are '{sets[1]}'")
    for name, (what, unnamed) in NAMED_ARITHMETIC.items():
        archived, repeated = (str(run.attrs.get(name, unnamed)) for run in (archived_run, repeated_run))
        if name in repeated_run.attrs and archived != repeated:
            reasons.append(f"the archive has {what} by '{archived}', here they are by '{repeated}'")
    if not table.attrs["identical"]:
        return table.assign_attrs(arithmetic="; ".join([*reasons, _largest_difference(archived_run, repeated_run)]))
    return table.assign_attrs(arithmetic="; ".join([*reasons, "every number has the same bits"]) if reasons else "")


def _largest_difference(archived_run: xr.Dataset, repeated_run: xr.Dataset) -> str:
    """Describe the largest difference of a state relative to its largest value; of another variable if states agree."""
    states = [
        name for name, variable in archived_run.variables.items() if variable.attrs.get("role") in schema.INTEGRATED
    ]
    worst, sentence = 0.0, "no number of a row that both runs have differs"
    for name in [*states, *(name for name in archived_run.variables if name not in states)]:
        if worst and name not in states:
            break
        variable = archived_run.variables[name]
        remade = repeated_run.variables.get(name)
        if remade is None or variable.dtype.kind != "f" or not variable.dims:
            continue
        shared = min(variable.shape[0], remade.shape[0])
        if not shared:
            continue
        left, right = np.asarray(variable[:shared].values), np.asarray(remade[:shared].values)
        with np.errstate(invalid="ignore"):  # infinities are compared as words
            differences = np.where(_as_words(left) == _as_words(right), 0.0, np.abs(left - right))
        differences = np.where(np.isnan(differences), np.inf, differences).reshape(shared, -1)  # in one run only
        size = float(np.nanmax(np.abs(left), initial=0.0))
        largest = float(differences.max(initial=0.0))
        relative = largest / size if size > 0.0 and largest < np.inf else np.inf if largest else 0.0
        if relative > worst:
            worst, row = relative, int(np.argmax(differences.max(axis=1)))
            sentence = escaped(
                f"the largest difference is {largest:.3g} {variable.attrs.get('units', '')} in '{name}', row {row}:"
                f" {worst:.2g} of its largest value"
            )
    rows = [int(run.sizes.get(schema.STEPS, 0)) for run in (archived_run, repeated_run)]
    return sentence if rows[0] == rows[1] else f"{sentence}; {rows[0]} rows became {rows[1]}"


def _bitwise_table(first: xr.Dataset, second: xr.Dataset, *, worded: bool) -> xr.Dataset:
    names = [
        name
        for name in _variable_names(first, second if worded else None)
        if worded or not (name in (*LAW, *REDEFINED) or name.startswith(OFFSETS))
    ]
    rows = [_first_row(first, second, name, worded=worded) for name in names]
    settings = differing_settings(first, second)
    if not worded:
        settings = [line for line in settings if (name := line.partition(":")[0]) not in LAW and name in first.attrs]
    table = _rows_table(names, rows)
    identical = all(row is None for row in rows) and not settings
    return table.assign_attrs(
        identical=int(identical),
        first_difference="" if identical else _earliest_difference(first, second, names, rows, settings),
        settings="\n".join(settings),
        selection=str(first.attrs.get(schema.SELECTION_OF, "")),
    )


def blank_bitwise_table(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Return the table of `compare_bits` before the values of two runs are known."""
    names = _variable_names(first, second)
    return _rows_table(names, [None] * len(names))


def _variable_names(first: xr.Dataset, second: xr.Dataset | None) -> list[str]:
    """Name the variables of a run, and those that only the other has; time, of the variables of one row, first."""
    second_names = [] if second is None else [str(name) for name in second.variables if name not in first.variables]
    return sorted([*map(str, first.variables), *second_names], key=lambda name: name != "time")


def _rows_table(names: list[str], rows: Sequence[int | None]) -> xr.Dataset:
    """Return a row for each variable: its name, whether all bits agree, and the first row that differs."""
    columns = {
        "name": (np.array(names), "variable of the runs"),
        "same": (np.array([row is None for row in rows], np.int8), "1 where every bit agrees"),
        "first_row": (np.array([-1 if row is None else row for row in rows]), "first row that differs, -1 for none"),
    }
    # fastpath: xarray would import dask to find out that the columns are not one of its arrays
    return xr.Dataset(
        {
            name: xr.Variable(("variable",), column, attrs_of("1", long_name, "index"), fastpath=True)
            for name, (column, long_name) in columns.items()
        }
    )


def differing_settings(first: xr.Dataset, second: xr.Dataset) -> list[str]:
    """List the attributes in which two runs differ.

    Dates, versions, the machine, notes, counts of results and attributes that follow from others do not count.
    """
    content = schema.content_of(first.attrs) | schema.content_of(second.attrs)
    names = [name for name in content if name not in (*schema.COUNTS, *FOLLOWING)]
    lines = []
    for name in names:
        value, other_value = (plain(run.attrs).get(name, "absent") for run in (first, second))
        if value != other_value:
            lines.append(escaped(f"{name}: {_shortened_value(value)} | {_shortened_value(other_value)}"))
    return lines


def _first_row(first: xr.Dataset, second: xr.Dataset, name: str, *, worded: bool) -> int | None:
    """Return the first row in which a variable differs.

    None if every bit agrees, and every attribute too where words count.
    """
    if name not in first.variables or name not in second.variables:
        return 0
    variable, counterpart = first.variables[name], second.variables[name]
    attributes = [plain(own_attributes(raw)) for raw in (variable.attrs, counterpart.attrs)]
    if (
        variable.dims != counterpart.dims
        or _type_word(variable) != _type_word(counterpart)
        or (name != schema.EVENT_BOUNDS and _measure(attributes[0]) != _measure(attributes[1]))
        or (worded and not _same_attributes(*attributes))
    ):
        return 0
    if not _has_rows(first, name):
        return None if _have_same_bits(variable.values, counterpart.values) else 0
    shared = min(variable.shape[0], counterpart.shape[0])
    height = max(1, SLAB // max(1, prod(variable.shape[1:])))
    for start in range(0, shared, height):
        slab = slice(start, min(start + height, shared))
        left, right = np.asarray(variable[slab].values), np.asarray(counterpart[slab].values)
        if not _have_same_bits(left, right):
            return start + int(np.flatnonzero(flattened_rows(_differing_bits(left, right)).any(axis=1))[0])
    if (
        not worded
        and name == schema.END_MEMORY.name
        and str(counterpart.attrs["names"]).startswith(str(variable.attrs["names"]) + " ")
    ):
        return None  # later versions append what they store in addition
    return None if variable.shape == counterpart.shape else shared


def _has_rows(run: xr.Dataset, name: str) -> bool:
    """Whether a variable goes along more than elements: a parameter of each has no rows."""
    dims = run.variables[name].dims
    return bool(dims) and dims[0] not in model_dimensions(run)


def _same_attributes(first: dict[str, Any], second: dict[str, Any]) -> bool:
    """Whether attributes are equal; an unknown tolerance of elements, nan, equals itself."""
    return first.keys() == second.keys() and all(
        value == second[key] or repr(value) == repr(second[key]) for key, value in first.items()
    )


def _measure(attributes: Mapping[str, Any]) -> Any:
    """Return dimension and factor of a unit, however it is spelled: a torque in J is one in N m."""
    text = attributes.get("units")
    try:
        unit = parse_unit(text) if isinstance(text, str) else None
    except InputError:  # of time since a date, say
        return text
    return None if unit is None else (unit.dimension, unit.factor)


def _type_word(variable: xr.Variable) -> str:
    """Return the type of a variable; all texts count as one type, however they are stored."""
    return "text" if variable.dtype.kind in "UOT" else variable.dtype.str


def _earliest_difference(
    first: xr.Dataset, second: xr.Dataset, names: list[str], rows: list[int | None], settings: list[str]
) -> str:
    """Describe the first difference: along `step` if there is one, else in any variable, else in a setting."""
    differing_rows = [(row, name) for row, name in zip(rows, names, strict=True) if row is not None]
    differing_step_rows = [
        (row, name)
        for row, name in differing_rows
        if name in first.variables and schema.STEPS in first.variables[name].dims
    ]
    if not differing_rows:
        return f"attribute {settings[0]}"
    row, name = min(differing_step_rows or differing_rows, key=lambda pair: pair[0])
    element_name, element_index = _first_differing_element(first, second, name, row)
    values = [_value_text(run, name, row, element_index) for run in (first, second)]
    if values[0] == values[1] and (words := _differing_attribute(first, second, name)):
        return escaped(f"variable '{name}', {words}")
    where = f", row {row}" if _has_rows(first if name in first.variables else second, name) else ""
    return escaped(f"variable '{element_name}'{where}: {values[0]} | {values[1]}")


def _first_differing_element(first: xr.Dataset, second: xr.Dataset, name: str, row: int) -> tuple[str, dict[str, int]]:
    """Return name and indices of the first element that differs in a row; of other variables the name alone."""
    if any(name not in run.variables for run in (first, second)):
        return name, {}
    variables = [run.variables[name] for run in (first, second)]
    inner = [str(dim) for dim in variables[0].dims if dim in model_dimensions(first)]
    rows = {variables[0].dims[0]: row} if _has_rows(first, name) else {}
    if not inner or variables[0].dims != variables[1].dims or (rows and row >= min(map(len, variables))):
        return name, {}
    left, right = (np.asarray(variable.isel(rows).transpose(*inner, ...).values) for variable in variables)
    if left.shape != right.shape:
        return name, {}
    differing_elements = np.flatnonzero(
        _differing_bits(left, right).reshape(*left.shape[: len(inner)], -1).any(axis=-1)
    )
    if not differing_elements.size:
        return name, {}
    element_index = dict(
        zip(inner, map(int, np.unravel_index(differing_elements[0], left.shape[: len(inner)])), strict=True)
    )
    return join_element_name(
        name, (element_labels(first, dim)[number] for dim, number in element_index.items())
    ), element_index


def _differing_attribute(first: xr.Dataset, second: xr.Dataset, name: str) -> str:
    """Describe the first attribute in which a variable of two runs differs; empty where none does."""
    attributes = [
        plain(own_attributes(run.variables[name].attrs)) if name in run.variables else {} for run in (first, second)
    ]
    for key in {**attributes[0], **attributes[1]}:
        pair = [_shortened_value(attrs[key]) if key in attrs else "absent" for attrs in attributes]
        if pair[0] != pair[1]:
            return f"attribute '{key}': {pair[0]} | {pair[1]}"
    return ""


def _value_text(run: xr.Dataset, name: str, row: int, element_index: dict[str, int]) -> str:
    if name not in run.variables:
        return "absent"
    variable = run.variables[name].isel(element_index)
    if not variable.dims or not _has_rows(run, name):
        return _shortened_value(variable.values)
    if row >= variable.shape[0]:
        return f"no such row ({variable.shape[0]} rows)"
    return _shortened_value(variable[row].values.tolist())


def _have_same_bits(left: NDArray[Any], right: NDArray[Any]) -> bool:
    if left.dtype.kind in "UOT":
        return repr(left.tolist()) == repr(right.tolist())
    return left.shape == right.shape and np.array_equal(_as_words(left), _as_words(right))


def _differing_bits(left: NDArray[Any], right: NDArray[Any]) -> NDArray[np.bool_]:
    """Mark the numbers, or texts, whose bits differ."""
    texts = left.dtype.kind in "UOT"
    differing: NDArray[np.bool_] = (
        left.astype(str) != right.astype(str) if texts else _as_words(left) != _as_words(right)
    )
    return differing


def _as_words(values: NDArray[Any]) -> NDArray[Any]:
    # as whole numbers nan is equal to itself, and 0.0 is not -0.0
    return np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")


def _shortened_value(value: Any) -> str:
    text = repr(value.tolist() if hasattr(value, "tolist") else value)
    return text if len(text) <= 80 else text[:77] + "…"
