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
from xdynamics.figures.curves import thinned
from xdynamics.figures.marks import COLOURS, in_unit, label_time, typeset, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT, AT_TIME, EVIDENCE
from xdynamics.shapes import parted

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
        along = [str(name) for name, one in comparison.data_vars.items() if one.dims == ("run", AT)]
        heads = [name.removeprefix("difference_") for name in along if name.startswith("difference_")]
        return [partial(_of_several, comparison, name) for name in heads]
    names = [
        str(name).removeprefix("difference_")
        for name, item in comparison.data_vars.items()
        if str(name).startswith("difference_") and item.dims == (AT,)
    ]
    if not names:
        raise InputError("there is nothing to draw: the comparison has no difference along 'at'")
    beside = [partial(_beside, comparison, name) for name in names if f"measured_{name}" in comparison]
    apart: list[Panel] = [partial(_apart, comparison, name) for name in names]
    if beside:  # measurements are drawn left of their residuals
        return [item for pair in zip(beside, apart, strict=True) for item in pair]
    farthest = _farthest_first(comparison, names)
    leading = [name for name in farthest[0] if len(farthest[0]) > 1] or names
    if len(farthest) < len(names):
        apart = [
            partial(_apart, comparison, name) for turn in zip_longest(*farthest) for name in turn if name is not None
        ]
    if not any((np.abs(comparison[f"difference_{name}"]) > 0.0).any() for name in names):
        return apart[: MOST_APART + 1]
    return [partial(_distance, comparison, leading), *apart[:MOST_APART]]


def _farthest_first(comparison: xr.Dataset, names: list[str]) -> list[list[str]]:
    """Group elements by their quantity, those whose differences are largest first; quantities that do not differ come last."""
    largest = {name: float(np.nanmax(np.abs(comparison[f"difference_{name}"].values), initial=0.0)) for name in names}
    groups = dict[str, list[str]]()
    for name in sorted(names, key=lambda name: -largest[name]):
        groups.setdefault(parted(name)[0], []).append(name)
    order = [*dict.fromkeys(parted(name)[0] for name in names)]
    return [groups[whole] for whole in sorted(order, key=lambda whole: largest[groups[whole][0]] == 0.0)]


def foot_of(comparison: xr.Dataset) -> str:
    """Describe what differs, and since when."""
    if comparison.attrs.get(EVIDENCE) == OF_SEVERAL:
        runs = zip(comparison["run_name"].values.tolist(), comparison["cause"].values.tolist(), strict=True)
        return "; ".join(f"{run}: {cause or 'the same'}" for run, cause in runs)
    parted, cause = (str(comparison.attrs.get(key, "")) for key in ("parted", "cause"))
    return "; ".join(
        filter(
            None,
            (
                "shaded: standard uncertainty as measured, else what interpolation may be off",
                parted and f"parted at {parted}",
                cause,
            ),
        )
    )


def _beside(comparison: xr.Dataset, name: str, axes: Axes) -> None:
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
    axes.set(ylabel=words(f"{name} ({units})"))
    axes.set_title(words(f"{name}, measured and computed"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _distance(comparison: xr.Dataset, names: list[str], axes: Axes) -> None:
    """Draw how far two runs are apart on a logarithmic scale, where exponential growth is a straight line."""
    order = np.argsort(comparison[AT_TIME].values, kind="stable")
    time = comparison[AT_TIME].values[order]
    chosen = names[:MOST_LINES]
    wholes = {parted(name)[0] for name in names}
    units = str(comparison[f"difference_{names[0]}"].attrs["units"])
    is_one = len(wholes) == 1 < len(names)  # the elements of one quantity, in its unit
    for k, name in enumerate(chosen):
        apart = np.abs(comparison[f"difference_{name}"].values[order])
        apart[apart == 0.0] = np.nan
        rows = thinned(apart)
        label = name if is_one else in_unit(name, str(comparison[f"difference_{name}"].attrs["units"]))
        axes.plot(time[rows], apart[rows], color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=words(label))
    axes.set_yscale("log")
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel=words(f"|difference of {wholes.pop()}| ({units})") if is_one else "|difference|")
    the = "the farthest " if is_one else ""
    left_out = f", {the}{len(chosen)} of {len(names)}" if len(chosen) < len(names) else ""
    axes.set_title(f"distance of the runs{left_out}", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


def _apart(comparison: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw a difference and its uncertainty."""
    order = np.argsort(comparison[AT_TIME].values, kind="stable")
    time, values = comparison[AT_TIME].values[order], comparison[f"difference_{name}"].values[order]
    measured = f"measured_uncertainty_{name}"
    doubt = comparison[measured if measured in comparison else f"interpolation_error_{name}"].values[order]
    rows = thinned(values)
    axes.fill_between(time[rows], -doubt[rows], doubt[rows], color=COLOURS[0], alpha=0.25, linewidth=0)
    style = "." if f"measured_{name}" in comparison else ".-" if len(time) <= FEW else "-"
    axes.plot(time[rows], values[rows], style, color=COLOURS[0], linewidth=1.0, markersize=4)
    axes.axhline(0.0, color="#777777", linewidth=0.8)
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel=words(f"difference ({comparison[f'difference_{name}'].attrs['units']})"))
    scale = comparison.get(schema.scale("difference", name))
    suffix = (
        "" if scale is None else f"; scale {float(scale):.3g} {typeset(str(scale.attrs['units']))}".removesuffix(" 1")
    )
    whole, labels = parted(name)
    title = str(comparison[f"difference_{name}"].attrs["long_name"])
    if labels and title.startswith(f"{whole},"):
        title = f"{name}{title.removeprefix(whole)}"
    axes.set_title(words(f"{title}{suffix}"), loc="left", fontsize=10)


def _of_several(found: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw how far each of several runs is from the reference, on a logarithmic scale, and what interpolation may be off."""
    time, units = found[AT_TIME].values, str(found[f"difference_{name}"].attrs["units"])
    for k, run in enumerate(found["run_name"].values[:MOST_LINES].tolist()):
        apart = np.abs(found[f"difference_{name}"].isel(run=k).values)
        apart[apart == 0.0] = np.nan
        rows = thinned(apart)
        axes.plot(time[rows], apart[rows], color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=words(run))
    if any(np.isfinite(line.get_ydata()).any() for line in axes.lines):
        axes.set_yscale("log")
    label_time(axes, found[AT_TIME])
    axes.set(ylabel=words(f"|difference| ({units})"))
    left_out = f", {MOST_LINES} of {found.sizes['run']} runs" if found.sizes["run"] > MOST_LINES else ""
    axes.set_title(words(f"{name}{left_out}"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)


PAGE = Page(("comparison", OF_SEVERAL), panels_of, foot_of, most_panels=12)
