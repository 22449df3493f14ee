"""Figures of work against precision: the error of a number over its cost, a line for each method."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.figures.marks import COLOURS, words
from xdynamics.figures.sheet import Page, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "os^Dv<>P"
EVALUATIONS, OFF = "run_force_evaluations", "off_"


def panels_of(precision: xr.Dataset) -> list[Panel]:
    """Return the panel of each number."""
    names = [
        str(name) for name in precision.data_vars if str(name).startswith(OFF) and bool((precision[name] > 0).any())
    ]
    return [partial(_work, precision, name) for name in names]


def foot_of(precision: xr.Dataset) -> str:
    """Describe what is drawn."""
    varied = str(precision.attrs["varied"])
    sizes = ", ".join(f"{float(value):.6g}" for value in precision[varied].values)
    return f"each point a run; along a line {varied} = {sizes} {precision[varied].attrs['units']}"


def _work(precision: xr.Dataset, name: str, axes: Axes) -> None:
    varied = str(precision.attrs["varied"])
    errors = precision[name]
    while set(errors.dims) - set(precision[EVALUATIONS].dims):
        errors = errors.isel({next(dim for dim in errors.dims if dim not in precision[EVALUATIONS].dims): -1})
    others = [str(dim) for dim in errors.dims if dim != varied]
    for k, indices in enumerate(product(*(range(precision.sizes[dim]) for dim in others))):
        selection = dict(zip(others, indices, strict=True))
        work, off = precision[EVALUATIONS].isel(selection).values, errors.isel(selection).values
        order = np.argsort(work)
        shown = order[off[order] > 0.0]
        label = " ".join(str(precision[dim].values[i]) for dim, i in selection.items() if dim in precision.coords)
        axes.plot(
            work[shown],
            off[shown],
            f"{MARKERS[k % len(MARKERS)]}-",
            color=COLOURS[k % len(COLOURS)],
            markersize=4,
            linewidth=1.0,
            label=words(label),
        )
    axes.set(xscale="log", yscale="log", xlabel="force evaluations", ylabel=words(f"|error| ({errors.attrs['units']})"))
    axes.set_title(words(name.removeprefix(OFF)), loc="left", fontsize=10)
    if others:
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


PAGE = Page(("precision",), panels_of, foot_of, most_panels=6, height=3.8)
