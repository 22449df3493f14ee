"""Two runs side by side, bit for bit: every variable, every setting."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.faults import escaped
from xdynamics.record import own_attributes, plain
from xdynamics.schema import ATOL_EFFECT, COUNTS, END_MEMORY, ORIGIN, ROOT_DIGEST, SELECTION_OF, STEPS, VOLATILE

SLAB = 1_000_000
STATES = ("coordinate", "velocity", "state")  # roles
# the text of the law, which another version may write in other words, the set of elementary functions, the words of records
# and the sentence of the outcome, in which later versions say more against a run
LAW = ("force_source", "force_digest", "math_functions", "schema_version", "run_outcome_text")
# what later versions define otherwise: of 0.1, the uncertainty of an event's location had no least value
REDEFINED = ("event_time_uncertainty",)
OFFSETS = "event_offset_"  # of 0.2, always 0
# what follows of a march and is no setting of it: how `sample` interpolates, in the version that wrote it, and its rates
FOLLOWING = (
    "solver_interpolation", "solver_interpolation_order", "run_fastest_rate", "run_h_omega_start", "run_h_omega_largest",
    "run_h_omega_rule", ATOL_EFFECT,
)  # fmt: skip


def bitwise(first: xr.Dataset, second: xr.Dataset) -> xr.Dataset:
    """Compare every variable and attribute of two runs bit for bit.

    Returns
    -------
    xarray.Dataset
        Along `variable`: `name`, `same` (1 or 0), `first_row` (the first row that differs, -1 where none does).
        Attributes: `identical`, `first_difference` (a sentence, the earliest row of `step` first), `settings`
        (attributes that differ, a line each).
    """
    return _table(first, second, worded=True)


def reproduced(kept: xr.Dataset, again: xr.Dataset) -> xr.Dataset:
    """Compare an archive with a march of its own model.

    Returns
    -------
    xarray.Dataset
        What `bitwise` gives. Where the archive was made by another version, with another set of elementary
        functions or another schema of the record, words do not count: the text of the law, the name of the set and the vocabulary of flags, nor
        variables and settings that the archive's version did not have; `identical` is then 1 where every number has the same bits and every setting is the same. `arithmetic` says in one sentence
        what differs; it is empty where nothing does.
    """
    versions = [str(one.attrs.get("xdynamics_version", "of unknown name")) for one in (kept, again)]
    sets = [str(one.attrs.get("math_functions", "of unknown name")) for one in (kept, again)]
    schemas = [str(one.attrs.get("schema_version", "of unknown name")) for one in (kept, again)]
    same = versions[0] == versions[1] and sets[0] == sets[1] and schemas[0] == schemas[1]
    table = _table(kept, again, worded=same)
    why = []
    if versions[0] != versions[1] and kept.attrs.get("force_digest") != again.attrs.get("force_digest"):
        why.append(f"version {versions[0]} wrote the law in other words than {versions[1]}")
    elif schemas[0] != schemas[1] and kept.attrs.get("force_digest") != again.attrs.get("force_digest"):
        why.append(f"records of schema {schemas[0]} had the law in other words than those of schema {schemas[1]}")
    if sets[0] != sets[1]:
        why.append(f"the archive was made with the elementary functions '{sets[0]}', here they are '{sets[1]}'")
    if not table.attrs["identical"]:
        return table.assign_attrs(arithmetic="; ".join([*why, _largest(kept, again)]))
    return table.assign_attrs(arithmetic="; ".join([*why, "every number has the same bits"]) if why else "")


def _largest(kept: xr.Dataset, again: xr.Dataset) -> str:
    """Say how large the largest difference of a state is, against the range of its variable; of another, where none is."""
    states = [name for name, one in kept.variables.items() if one.attrs.get("role") in STATES]
    worst, said = 0.0, "no number of a row that both runs have differs"
    for name in [*states, *(name for name in kept.variables if name not in states)]:
        if worst and name not in states:
            break
        one = kept.variables[name]
        other = again.variables.get(name)
        if other is None or one.dtype.kind != "f" or not one.dims:
            continue
        shared = min(one.shape[0], other.shape[0])
        if not shared:
            continue
        left, right = np.asarray(one[:shared].values), np.asarray(other[:shared].values)
        apart = np.where(_as_words(left) == _as_words(right), 0.0, np.abs(left - right))
        apart = np.where(np.isnan(apart), np.inf, apart).reshape(shared, -1)  # a number against none
        size = float(np.nanmax(np.abs(left), initial=0.0))
        largest = float(apart.max(initial=0.0))
        relative = largest / size if size > 0.0 and largest < np.inf else np.inf if largest else 0.0
        if relative > worst:
            worst, row = relative, int(np.argmax(apart.max(axis=1)))
            said = escaped(
                f"the largest difference is {largest:.3g} {one.attrs.get('units', '')} in '{name}', row {row}: {worst:.2g} of its largest value"
            )
    rows = [int(run.sizes.get(STEPS, 0)) for run in (kept, again)]
    return said if rows[0] == rows[1] else f"{said}; {rows[0]} rows became {rows[1]}"


def _table(first: xr.Dataset, second: xr.Dataset, *, worded: bool) -> xr.Dataset:
    names = [str(name) for name in first.variables]
    if worded:
        names += [str(name) for name in second.variables if name not in first.variables]
    names = [name for name in names if worded or not (name in (*LAW, *REDEFINED) or name.startswith(OFFSETS))]
    names.sort(key=lambda name: name != "time")  # of the variables of one row, time is named first
    rows = [_first_row(first, second, name, worded=worded) for name in names]
    settings = settings_apart(first, second)
    if not worded:
        settings = [line for line in settings if (name := line.partition(":")[0]) not in LAW and name in first.attrs]
    table = xr.Dataset(
        {
            "name": ("variable", np.array(names), {"long_name": "variable of the runs", "units": "1", "role": "index"}),
            "same": ("variable", np.array([row is None for row in rows], np.int8), {"long_name": "1 where every bit agrees", "units": "1", "role": "index"}),
            "first_row": ("variable", np.array([-1 if row is None else row for row in rows]), {"long_name": "first row that differs, -1 for none", "units": "1", "role": "index"}),
        }
    )  # fmt: skip
    identical = all(row is None for row in rows) and not settings
    return table.assign_attrs(
        identical=int(identical),
        first_difference="" if identical else _earliest(first, second, names, rows, settings),
        settings="\n".join(settings),
        selection=str(first.attrs.get(SELECTION_OF, "")),
    )


def settings_apart(first: xr.Dataset, second: xr.Dataset) -> list[str]:
    """List the attributes that two runs do not share; dates, versions, machine, counts of what came out and what follows from others do not count."""
    outside = {*VOLATILE, *COUNTS, *FOLLOWING, ROOT_DIGEST, ORIGIN}
    names = [name for name in {**first.attrs, **second.attrs} if name not in outside]
    found = []
    for name in names:
        one, other = (plain(run.attrs).get(name, "absent") for run in (first, second))
        if one != other:
            found.append(escaped(f"{name}: {_short(one)} | {_short(other)}"))
    return found


def _first_row(first: xr.Dataset, second: xr.Dataset, name: str, *, worded: bool) -> int | None:
    """Return the first row in which a variable differs; None where every bit, and if words count every attribute, agrees."""
    if name not in first.variables or name not in second.variables:
        return 0
    one, other = first.variables[name], second.variables[name]
    own = [plain(own_attributes(attributes)) for attributes in (one.attrs, other.attrs)]
    if (
        one.dims != other.dims
        or _kind(one) != _kind(other)
        or own[0].get("units") != own[1].get("units")
        or (worded and own[0] != own[1])
    ):
        return 0
    if not one.dims:
        return None if _bits(one.values) == _bits(other.values) else 0
    shared = min(one.shape[0], other.shape[0])
    for start in range(0, shared, SLAB):
        part = slice(start, min(start + SLAB, shared))
        left, right = np.asarray(one[part].values), np.asarray(other[part].values)
        if _bits(left) != _bits(right):
            differs = _as_words(left) != _as_words(right)
            return start + int(np.flatnonzero(differs.reshape(len(differs), -1).any(axis=1))[0])
    if not worded and name == END_MEMORY.name and str(other.attrs["names"]).startswith(str(one.attrs["names"]) + " "):
        return None  # what later versions know besides stands behind
    return None if one.shape == other.shape else shared


def _kind(variable: xr.Variable) -> str:
    """Return the type of a variable; texts are one type, however they are kept."""
    return "text" if variable.dtype.kind in "UOT" else variable.dtype.str


def _earliest(
    first: xr.Dataset, second: xr.Dataset, names: list[str], rows: list[int | None], settings: list[str]
) -> str:
    """Name the first difference: along the march where there is one, else any, else a setting."""
    apart = [(row, name) for row, name in zip(rows, names, strict=True) if row is not None]
    along = [(row, name) for row, name in apart if name in first and STEPS in first[name].dims]
    if not apart:
        return f"attribute {settings[0]}"
    row, name = min(along or apart, key=lambda pair: pair[0])
    values = [_value(run, name, row) for run in (first, second)]
    where = f", row {row}" if first.variables.get(name, second.variables.get(name)).dims else ""  # type: ignore[union-attr]
    return escaped(f"variable '{name}'{where}: {values[0]} | {values[1]}")


def _value(run: xr.Dataset, name: str, row: int) -> str:
    if name not in run.variables:
        return "absent"
    variable = run.variables[name]
    if not variable.dims:
        return _short(variable.values)
    if row >= variable.shape[0]:
        return f"no such row ({variable.shape[0]} rows)"
    return _short(variable[row].values.tolist())


def _bits(values: NDArray[Any]) -> bytes:
    return str(values[()]).encode() if values.dtype.kind in "UOT" else np.ascontiguousarray(values).tobytes()


def _as_words(values: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")


def _short(value: Any) -> str:
    text = repr(value.tolist() if hasattr(value, "tolist") else value)
    return text if len(text) <= 80 else text[:77] + "…"
