"""Figures of comparisons: how far two runs are apart, or a run beside measurements."""

from __future__ import annotations

from functools import partial
from itertools import zip_longest
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics import schema
from xdynamics.evidence.comparing.comparison_summary import OF_SEVERAL
from xdynamics.faults import InputError
from xdynamics.figures.curves import thinned_rows
from xdynamics.figures.marks import COLOURS, escaped_text, label_time, label_with_unit, typeset
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT, AT_TIME, EVIDENCE
from xdynamics.shapes import split_element_name

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_LINES = 6  # in the panel of distances
MOST_APART = 3  # differences with a panel of their own, beside that of distances
FEW = 100  # points up to which each is a dot


def panels_of(comparison: xr.Dataset) -> list[Panel]:
    """Return the panels of the differences; for measured data each follows the panel of its measurements.

    Of quantities with dimensions the elements that part farthest come first, those of each quantity in turn.

    Raises
    ------
    InputError
        If no quantity was compared.
    """
    if comparison.attrs.get(EVIDENCE) == OF_SEVERAL:
        series_names = [str(name) for name, variable in comparison.data_vars.items() if variable.dims == ("run", AT)]
        heads = [name.removeprefix("difference_") for name in series_names if name.startswith("difference_")]
        return [partial(_draw_distances_of_runs, comparison, name) for name in heads]
    names = [
        str(name).removeprefix("difference_")
        for name, item in comparison.data_vars.items()
        if str(name).startswith("difference_") and item.dims == (AT,)
    ]
    if not names:
        raise InputError("there is nothing to draw: the comparison has no difference along 'at'")
    measured_panels = [partial(_draw_measured, comparison, name) for name in names if f"measured_{name}" in comparison]
    difference_panels: list[Panel] = [partial(_draw_difference, comparison, name) for name in names]
    if measured_panels:  # measurements are drawn left of their residuals
        return [item for pair in zip(measured_panels, difference_panels, strict=True) for item in pair]
    farthest = _farthest_first(comparison, names)
    distance_names = [name for name in farthest[0] if len(farthest[0]) > 1] or names
    if len(farthest) < len(names):
        difference_panels = [
            partial(_draw_difference, comparison, name)
            for turn in zip_longest(*farthest)
            for name in turn
            if name is not None
        ]
    if not any((np.abs(comparison[f"difference_{name}"]) > 0.0).any() for name in names):
        return difference_panels[: MOST_APART + 1]
    return [partial(_draw_distances, comparison, distance_names), *difference_panels[:MOST_APART]]


def _farthest_first(comparison: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group elements by their quantity, those whose differences are largest first; quantities that do not differ come last."""
    largest = {name: float(np.nanmax(np.abs(comparison[f"difference_{name}"].values), initial=0.0)) for name in names}
    groups = dict[str, list[str]]()
    for name in sorted(names, key=lambda name: -largest[name]):
        groups.setdefault(split_element_name(name)[0], []).append(name)
    order = [*dict.fromkeys(split_element_name(name)[0] for name in names)]
    return [groups[quantity] for quantity in sorted(order, key=lambda quantity: largest[groups[quantity][0]] == 0.0)]


def foot_of(comparison: xr.Dataset) -> str:
    """Describe what differs, and since when."""
    if comparison.attrs.get(EVIDENCE) == OF_SEVERAL:
        runs = zip(comparison["run_name"].values.tolist(), comparison["cause"].values.tolist(), strict=True)
        return "; ".join(f"{run}: {cause or 'the same'}" for run, cause in runs)
    parting_event, cause = (str(comparison.attrs.get(key, "")) for key in ("parted", "cause"))
    return "; ".join(
        filter(
            None,
            (
                "shaded: standard uncertainty as measured, else what interpolation may be off",
                parting_event and f"parted at {parting_event}",
                cause,
            ),
        )
    )


def _draw_measured(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw the measured values with their uncertainty, and the computed values at the same times."""
    time, units = comparison[AT_TIME].values, comparison[name].attrs["units"]
    doubt = comparison[f"measured_uncertainty_{name}"].values if f"measured_uncertainty_{name}" in comparison else None
    axes.errorbar(
        time,
        comparison[f"measured_{name}"].values,
        yerr=doubt,
        fmt=".",
        color=COLOURS[1],
        markersize=3,
        elinewidth=1.0,
        capsize=3,
        zorder=3,
        label="measured",
    )
    order = np.argsort(time)
    axes.plot(
        time[order],
        comparison[name].values[order],
        "-",
        color=COLOURS[0],
        linewidth=0.9,
        label="computed, at the same times",
    )
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel=escaped_text(f"{name} ({units})"))
    axes.set_title(escaped_text(f"{name}, measured and computed"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _draw_distances(comparison: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw how far two runs are apart on a logarithmic scale, where exponential growth is a straight line."""
    order = np.argsort(comparison[AT_TIME].values, kind="stable")
    time = comparison[AT_TIME].values[order]
    drawn_names = names[:MOST_LINES]
    quantities = {split_element_name(name)[0] for name in names}
    units = str(comparison[f"difference_{names[0]}"].attrs["units"])
    is_one = len(quantities) == 1 < len(names)  # the elements of one quantity, in its unit
    for k, name in enumerate(drawn_names):
        distance = np.abs(comparison[f"difference_{name}"].values[order])
        distance[distance == 0.0] = np.nan
        rows = thinned_rows(distance)
        label = name if is_one else label_with_unit(name, str(comparison[f"difference_{name}"].attrs["units"]))
        axes.plot(time[rows], distance[rows], color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=escaped_text(label))
    axes.set_yscale("log")
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel=escaped_text(f"|difference of {quantities.pop()}| ({units})") if is_one else "|difference|")
    superlative = "the farthest " if is_one else ""
    left_out = f", {superlative}{len(drawn_names)} of {len(names)}" if len(drawn_names) < len(names) else ""
    axes.set_title(f"distance of the runs{left_out}", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _draw_difference(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw a difference and its uncertainty."""
    order = np.argsort(comparison[AT_TIME].values, kind="stable")
    time, values = comparison[AT_TIME].values[order], comparison[f"difference_{name}"].values[order]
    measured = f"measured_uncertainty_{name}"
    doubt = comparison[measured if measured in comparison else f"interpolation_error_{name}"].values[order]
    rows = thinned_rows(values)
    axes.fill_between(time[rows], -doubt[rows], doubt[rows], color=COLOURS[0], alpha=0.25, linewidth=0)
    style = "." if f"measured_{name}" in comparison else ".-" if len(time) <= FEW else "-"
    axes.plot(time[rows], values[rows], style, color=COLOURS[0], linewidth=1.0, markersize=4)
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel=escaped_text(f"difference ({comparison[f'difference_{name}'].attrs['units']})"))
    scale = comparison.get(schema.scale_name("difference", name))
    suffix = (
        "" if scale is None else f"; scale {float(scale):.3g} {typeset(str(scale.attrs['units']))}".removesuffix(" 1")
    )
    quantity, labels = split_element_name(name)
    title = str(comparison[f"difference_{name}"].attrs["long_name"])
    if labels and title.startswith(f"{quantity},"):
        title = f"{name}{title.removeprefix(quantity)}"
    axes.set_title(escaped_text(f"{title}{suffix}"), loc="left", fontsize=10)


def _draw_distances_of_runs(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw how far each of several runs is from the reference, on a logarithmic scale, and what interpolation may be off."""
    time, units = comparison[AT_TIME].values, str(comparison[f"difference_{name}"].attrs["units"])
    for k, run in enumerate(comparison["run_name"].values[:MOST_LINES].tolist()):
        distance = np.abs(comparison[f"difference_{name}"].isel(run=k).values)
        distance[distance == 0.0] = np.nan
        rows = thinned_rows(distance)
        axes.plot(time[rows], distance[rows], color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=escaped_text(run))
    if any(np.isfinite(line.get_ydata()).any() for line in axes.lines):
        axes.set_yscale("log")
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel=escaped_text(f"|difference| ({units})"))
    left_out = f", {MOST_LINES} of {comparison.sizes['run']} runs" if comparison.sizes["run"] > MOST_LINES else ""
    axes.set_title(escaped_text(f"{name}{left_out}"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


PAGE = Page(("comparison", OF_SEVERAL), panels_of, foot_of, most_panels=12)
