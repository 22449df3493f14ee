"""Figures of comparisons: how far two runs are apart, or a run beside measurements."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics import schema
from xdynamics.faults import InputError
from xdynamics.figures.curves import thinned
from xdynamics.figures.marks import COLOURS, in_unit, label_time, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT, AT_TIME

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_LINES = 6  # in the panel of distances
MOST_APART = 3  # differences with a panel of their own, beside that of distances
FEW = 100  # points up to which each is a dot


def panels_of(comparison: xr.Dataset) -> list[Panel]:
    """Return the panels of the differences; for measured data each follows the panel of its measurements.

    Raises
    ------
    InputError
        If no quantity was compared.
    """
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
    if not any((np.abs(comparison[f"difference_{name}"]) > 0.0).any() for name in names):
        return apart[: MOST_APART + 1]
    return [partial(_distance, comparison, names), *apart[:MOST_APART]]


def foot_of(comparison: xr.Dataset) -> str:
    """Describe what differs, and since when."""
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
    chosen, most = names[:MOST_LINES], 0.0
    for k, name in enumerate(chosen):
        apart = np.abs(comparison[f"difference_{name}"].values[order])
        apart[apart == 0.0] = np.nan
        most = max(most, float(np.nanmax(apart, initial=0.0)))
        rows = thinned(apart)
        units = comparison[f"difference_{name}"].attrs["units"]
        axes.plot(
            time[rows], apart[rows], color=COLOURS[k % len(COLOURS)], linewidth=1.0, label=words(in_unit(name, units))
        )
    axes.set_yscale("log")
    label_time(axes, comparison[AT_TIME])
    axes.set(ylabel="|difference|")
    left_out = f", {len(chosen)} of {len(names)}" if len(chosen) < len(names) else ""
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
    suffix = "" if scale is None else f"; scale {float(scale):.3g} {scale.attrs['units']}".removesuffix(" 1")
    axes.set_title(words(f"{comparison[f'difference_{name}'].attrs['long_name']}{suffix}"), loc="left", fontsize=10)


PAGE = Page(("comparison",), panels_of, foot_of, most_panels=12)
