"""Comparisons, in lines of text."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import xarray as xr

from xdynamics import schema
from xdynamics.evidence.comparing import grids
from xdynamics.evidence.comparing.causes import independent_settings
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.record import whole_of
from xdynamics.record.flag_words import time_unit_of
from xdynamics.schema import AT, AT_TIME, OCCURRENCE
from xdynamics.units import unit_suffix
from xdynamics.units.digits import aligned_table, short_number, with_uncertainty

ROLE = "difference"
OF_SEVERAL = "comparison of runs"  # a kind of evidence
TOLD = (
    "identical",
    "first_difference",
    "model",
    "parameters",
    "initial",
    "events",
    "settings",
    "cause",
    "parted",
    "rounding",
)


def comparison_lines(table: xr.Dataset) -> list[str]:
    """Describe the result of `compare`, line by line."""
    statements = {name: stated_value(table, name) for name in TOLD}
    if statements["identical"] is None:
        left_out = str(table.attrs.get("data_left_out", ""))
        return [
            *_largest_difference_lines(table),
            *([f"left out  {left_out}: nothing that the run has"] if left_out else []),
        ]
    if statements["identical"]:
        return [f"the same: {table.sizes['variable']} variables and every setting, bit for bit"]
    differing = int((table["same"] == 0).sum())
    lines = [f"{differing} of {table.sizes['variable']} variables differ; first: {statements['first_difference']}"]
    for section, word in {
        "model": "model",
        "parameters": "parameter",
        "initial": "initial",
        "events": "events",
    }.items():
        lines += [f"{word:<10}{line}" for line in str(statements[section] or "").splitlines()]
    lines += [f"setting   {line}" for line in independent_settings(str(statements["settings"] or "").splitlines())]
    lines += [f"cause     {statements['cause']}", f"times     {int(table[AT_TIME].count())} at which both are known"]
    lines.append(f"parted    {statements['parted'] or 'nowhere by more than interpolation can be off'}")
    lines += [f"rounding  {statements['rounding']}"] if statements["rounding"] else []
    return [*lines, *_largest_difference_lines(table)]


def _largest_difference_lines(table: xr.Dataset) -> Iterator[str]:
    """Yield the largest difference of each quantity, of one with dimensions that of the element where it is largest."""
    table = whole_of(table)
    differences, norm_lines = [], []
    for name, variable in table.data_vars.items():
        if variable.attrs.get("role") == ROLE and variable.dims and np.isfinite(variable.values).any():
            differences.append(_difference_row(table, str(name)))
        elif variable.attrs.get("role") == "residual" and not variable.dims:
            scale = (
                f", scaled {float(table[schema.scaled_name(str(name))]):.3g}"
                if schema.scaled_name(str(name)) in table
                else ""
            )
            norm_lines.append(f"{name} = {float(variable):.6g}{unit_suffix(variable.attrs['units'])}{scale}")
    yield from aligned_table(("difference of", "largest", "where", "over its scale"), differences)
    yield from norm_lines


def _difference_row(table: xr.Dataset, name: str) -> tuple[str, ...]:
    """Return the largest difference of a quantity in words: time or occurrence, uncertainty, ratio to its scale."""
    variable = table[name]
    worst = np.unravel_index(int(np.nanargmax(np.abs(variable.values))), variable.shape)
    index = {str(dim): int(i) for dim, i in zip(variable.dims, worst, strict=True)}
    where = (
        f"t = {float(table[AT_TIME][index[AT]]):.9g}{unit_suffix(time_unit_of(table))}"
        if AT in index
        else f"occurrence {index.get(OCCURRENCE, 0) + 1}"
    )
    kind, _, quantity = name.partition("_")
    return (
        f"{quantity}{_element_labels(table, index)}",
        f"{_difference_text(table, name, index)}{unit_suffix(variable.attrs['units'])}",
        where,
        _over_scale(table, kind, quantity, index),
    )


def _difference_text(table: xr.Dataset, name: str, index: Mapping[str, int]) -> str:
    """Write a difference with its uncertainty: interpolation, location of events, measurement."""
    quantity, value = name.partition("_")[2], float(table[name][index])
    doubts = [
        float(table[doubt][{dim: i for dim, i in index.items() if dim in table[doubt].dims}])
        for doubt in (f"interpolation_error_{quantity}", f"measured_uncertainty_{quantity}")
        if doubt in table
    ]
    doubt = float(np.hypot.reduce(np.nan_to_num(doubts))) if doubts else 0.0
    return with_uncertainty(value, doubt) if doubt > 0.0 else short_number(value)


def _element_labels(table: xr.Dataset, index: Mapping[str, int]) -> str:
    """Return the labels of an element as people write them."""
    labels = [
        str(table[dim].values[i]) if dim in table.coords else str(i)
        for dim, i in index.items()
        if dim not in (AT, OCCURRENCE)
    ]
    return f"[{', '.join(labels)}]" if labels else ""


def _over_scale(table: xr.Dataset, kind: str, name: str, index: Mapping[str, int]) -> str:
    """Describe a difference relative to its scale."""
    scale = table[schema.scale_name(kind, name)]
    scale = scale[{dim: i for dim, i in index.items() if dim in scale.dims}]
    value = float(table[schema.scaled_name(f"{kind}_{name}")][index])
    return f"{value:.3g} of {float(scale):.3g}{unit_suffix(scale.attrs['units'])}"


def several_runs_lines(comparison: xr.Dataset) -> Iterator[str]:
    """Describe for each of several runs why, and since when, it differs from the reference."""
    yield f"times     {comparison.sizes[AT]} at which all are known"
    for i, run in enumerate(comparison["run_name"].values.tolist()):
        if int(comparison["identical"][i]):
            yield f"{run}: the same, bit for bit"
        else:
            yield f"{run}: {comparison['cause'].values[i]}; apart since {comparison['parted'].values[i] or 'nowhere'}"


SUMMARIES = {"comparison": comparison_lines, OF_SEVERAL: several_runs_lines} | grids.SUMMARIES
