"""Figures of refinements: differences of neighbouring levels beside the slope that the method promises."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.marks import COLOURS, words
from xdynamics.figures.sheet import Panel
from xdynamics.record.words import words_of
from xdynamics.schema import AT, AT_TIME, LEVEL

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_PLACES = 4  # of one number, in one panel
MOST_PANELS = 12


def panels_of(study: xr.Dataset) -> list[Panel]:
    """Return what draws each number of a refinement."""
    names = [str(name) for name in study.data_vars if f"difference_{name}" in study]
    return [partial(_differences, study, name) for name in names[:MOST_PANELS]]


def foot_of(study: xr.Dataset) -> str:
    """Say what is drawn, and what is left out."""
    count = sum(f"difference_{name}" in study for name in study.data_vars)
    left = f"; {count - MOST_PANELS} further numbers are in the record" if count > MOST_PANELS else ""
    return (
        "dots: difference of each level to the next finer one; crosses: how far interpolation or location may have it off;"
        f" dashed: order {study.attrs['formal_order']:g}{left}"
    )


def _differences(study: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw the differences of one number over its levels."""
    varied, one = study[str(study.attrs["varied"])], study[name]
    number = varied.dtype.kind == "f"
    steps = varied.values if number else np.arange(varied.size, dtype=float)
    place = next((dim for dim in one.dims if dim != LEVEL), None)
    for k in range(min(MOST_PLACES, study.sizes[place]) if place else 1):
        here = {place: k} if place else {}
        change, doubt = (
            np.abs(study[f"{kind}_{name}"].isel(here).values) for kind in ("difference", "interpolation_error")
        )
        where = "" if not place else f"t = {float(study[AT_TIME][k]):.6g} s" if place == AT else f"occurrence {k + 1}"
        verdict = words_of(study[f"verdict_{name}"].isel(here))[0].replace("_", " ") if number else ""
        shown, known = change > 0.0, doubt > 0.0
        colour, label = COLOURS[k % len(COLOURS)], ", ".join(filter(None, (where, verdict)))
        axes.plot(steps[shown], change[shown], "o-", color=colour, markersize=4, linewidth=1.0, label=words(label))
        axes.plot(steps[known], doubt[known], "x", color=colour, markersize=4)
        if k == 0 and number and shown.any():
            first = np.flatnonzero(shown)[0]
            slope = change[first] * (steps[shown] / steps[first]) ** float(study.attrs["formal_order"])
            axes.plot(steps[shown], slope, "--", color="#999999", linewidth=0.9, zorder=0)
    if any(np.size(line.get_xdata()) for line in axes.lines):
        axes.set_yscale("log")
    units = one.attrs["units"]
    if number:
        axes.set_xscale("log")
        axes.set_xticks(steps, [f"{one:.3g}" for one in steps], fontsize=8)
        axes.minorticks_off()
        axes.set(xlabel=words(f"{study.attrs['varied']} ({varied.attrs['units']})"))
    else:
        axes.set_xticks(steps, [words(str(each)) for each in varied.values])
    axes.set(ylabel=words(f"|difference| ({units})"))
    axes.set_title(
        words(f"{name} = {float(one.values.reshape(varied.size, -1)[-1, 0]):.9g} {units}"), loc="left", fontsize=10
    )
    axes.legend(fontsize=8, frameon=False)
