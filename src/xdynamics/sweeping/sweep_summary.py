"""A summary of a sweep in lines of text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from xdynamics.evidence.grid_axes import AXIS, sweep_axis_names
from xdynamics.evidence.stages import compute_datasets, is_lazy
from xdynamics.march.accuracy_warnings import STRAYED_REMEDY
from xdynamics.march.outcomes import GOOD
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import PASSED
from xdynamics.sweeping.collection import COMMENT, KEEP, settings_text
from xdynamics.sweeping.kept_quantities import OUTCOME, STRAYED, UNCONTROLLED
from xdynamics.sweeping.members import end_descriptions
from xdynamics.units.digits import known_part, short_number

if TYPE_CHECKING:
    import xarray as xr

MAX_LISTED = 12  # values of an axis, and variables, that are listed
LAZY = (
    "lazy      nothing is computed yet, and each use computes all of it anew: sweep.compute() keeps the numbers, a path"
    " keeps them in files, sweep.persist() on a cluster"
)
_FIRST = ("run_", "end_time")  # what every sweep has


def sweep_lines(sweep: xr.Dataset) -> list[str]:
    """Summarise the axes, the outcomes of members, and the ranges of recorded numbers."""
    lines = [line for dim in sweep_axis_names(sweep) for line in _axis_lines(sweep, dim)]
    if is_lazy(sweep) and "source" not in sweep.encoding:
        members = f"members   {sweep[OUTCOME].size}, with {settings_text(sweep)}; to keep of each: {sweep.attrs[KEEP]}"
        return [*lines, members, LAZY]
    sweep = compute_datasets(sweep)[0]  # at once: of what is lazy each variable would be read anew
    lines.append(f"members   {sweep[OUTCOME].size}, with {settings_text(sweep)}; kept of each: {sweep.attrs[KEEP]}")
    outcomes = Counter(map(str, end_descriptions(sweep).values.ravel().tolist()))
    text = ", ".join(
        f"{count} {word}{'' if word.split()[0] in GOOD else ' (ended badly)'}" for word, count in outcomes.most_common()
    )
    lines.append(f"outcomes  {text}")
    if failed := sum(count for word, count in outcomes.items() if word.split()[0] not in GOOD):
        lines.append(
            f"nan       what would be told of the whole run is nan of {failed} members, which failed before its end"
        )
    if COMMENT in sweep.attrs:
        lines.append(f"remark    {sweep.attrs[COMMENT]}")
    uncontrolled_count = int(np.count_nonzero(sweep[UNCONTROLLED].values))
    if uncontrolled_count:
        lines.append(
            f"doubt     of {uncontrolled_count} members absolute tolerances may have let pass 3 % of a variable, if every step erred"
            " by as much as they allow (run_uncontrolled); one computed by itself is judged by the errors that it had."
            " Give smaller ones by atol"
        )
    if STRAYED in sweep and (count := int(np.count_nonzero(sweep[STRAYED].values))):
        lines.append(
            f"doubt     in {count} members events set the motion back when errors of steps had carried it through zero,"
            f" and it need not come back from there ({STRAYED}); {STRAYED_REMEDY}"
        )
    if PASSED.name in sweep and (count := int(np.count_nonzero(sweep[PASSED.name].values))):
        lines.append(
            f"doubt     {count} members passed switches in forces that are declared smooth; leave smooth out to have"
            " them located"
        )
    return [*lines, *_variable_lines(sweep)]


def _axis_lines(sweep: xr.Dataset, dim: str) -> Iterator[str]:
    for name in sweep.variables:
        variable = sweep[name]
        if variable.attrs.get(AXIS) != dim:
            continue
        values, units = np.atleast_1d(variable.values), variable.attrs["units"]
        numbers = values.dtype.kind in "fi"
        unit = "" if units == "1" else f" {units}"
        if len(values) <= MAX_LISTED:
            values_text = ", ".join(f"{float(value):.9g}" if numbers else str(value) for value in values)
        else:
            values_text = f"{values.min():.9g} to {values.max():.9g}" if numbers else f"{values[0]} … {values[-1]}"
        dim_text = "" if name == dim else f" (along {dim})"
        yield f"axis      {name}{dim_text}: {len(values)} values, {values_text}{unit}"


def _variable_lines(sweep: xr.Dataset) -> Iterator[str]:
    names = [
        str(name)
        for name, variable in sweep.data_vars.items()
        if variable.dtype.kind in "fi"
        and variable.attrs.get("role") not in ("parameter", "axis")
        and not str(name).startswith(_FIRST)
    ]
    for name in names[:MAX_LISTED]:
        if (variable := sweep[name]).attrs.get("role") == "flag":
            counts = Counter(words_of_flag(variable.stack(each=variable.dims) if variable.ndim > 1 else variable))
            yield f"{name} is {', '.join(f'{word} in {count}' for word, count in counts.most_common())}"
            continue
        values, units = np.asarray(sweep[name]), sweep[name].attrs["units"]
        unit = "" if units == "1" else f" {units}"
        finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values
        if not finite.size:
            yield f"{name} is not there in any member"
            continue
        missing = "" if finite.size == values.size else f", not there in {values.size - finite.size} of {values.size}"
        smallest, largest = (
            significant_number(sweep, name, float(finite.min())),
            significant_number(sweep, name, float(finite.max())),
        )
        yield f"{name} {f'from {smallest} to {largest}' if smallest != largest else f'is {smallest}'}{unit}{missing}"
    if len(names) > MAX_LISTED:
        yield f"… and {len(names) - MAX_LISTED} more variables"


def significant_number(sweep: xr.Dataset, name: str, value: float) -> str:
    """Write a member's number with six digits, fewer where tolerances and uncertain parameters leave fewer."""
    parameters = [
        (float(variable), float(variable.attrs.get("uncertainty", 0.0)))
        for variable in sweep.data_vars.values()
        if variable.attrs.get("role") == "parameter" and not variable.dims
    ]
    doubt = known_part(float(sweep.attrs["solver_rtol"]) if "solver_rtol" in sweep.attrs else None, parameters)
    if sweep[name].dtype.kind in "iu":
        return f"{value:.9g}"
    return short_number(value, doubt)


SUMMARIES = {"sweep": sweep_lines}
