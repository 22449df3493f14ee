"""Figures of work against precision: the error of a number over its cost, a line for each method."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.grid_axes import WHAT
from xdynamics.figures.marks import COLOURS, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep_labels import other_axes, unit_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "os^Dv<>P"
EVALUATIONS, OFF, FRONT = "run_force_evaluations", "off_", "front_"


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
    return f"each point a run; along a line {varied} = {sizes}{unit_of(precision, varied)}"


def _work(precision: xr.Dataset, name: str, axes: Axes) -> None:
    varied = str(precision.attrs["varied"])
    runs = precision[[name, f"{FRONT}{name.removeprefix(OFF)}", EVALUATIONS]]
    for dim in [dim for dim in runs[name].dims if dim not in runs[EVALUATIONS].dims]:
        runs = runs.isel({dim: -1})
    others = [str(dim) for dim in runs[name].dims if dim != varied]
    _fronts(runs, [dim for dim in others if precision[dim].attrs.get(WHAT) != "method"], name, axes)
    for k, indices in enumerate(product(*(range(runs.sizes[dim]) for dim in others))):
        line = runs.isel(dict(zip(others, indices, strict=True)))
        work, off = _drawn(line, name, line[name].values > 0.0)
        axes.plot(
            work,
            off,
            f"{MARKERS[k % len(MARKERS)]}-",
            color=COLOURS[k % len(COLOURS)],
            markersize=4,
            linewidth=1.0,
            label=words(other_axes(line, [varied]).removeprefix(", ")),
        )
    units = precision[name].attrs["units"]
    axes.set(xscale="log", yscale="log", xlabel="force evaluations", ylabel=words(f"|error| ({units})"))
    if np.ptp(np.log10(runs[EVALUATIONS].values)) > 1.0:
        axes.xaxis.set_minor_formatter("")  # powers of ten are enough
    axes.set_title(words(name.removeprefix(OFF)), loc="left", fontsize=10)
    if others:
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _fronts(runs: xr.Dataset, dims: list[str], name: str, axes: Axes) -> None:
    """Draw broad lines below those of methods, through the runs that no other one betters: one for each problem."""
    for k, indices in enumerate(product(*(range(runs.sizes[dim]) for dim in dims))):
        problem = runs.isel(dict(zip(dims, indices, strict=True)))
        is_best = problem[f"{FRONT}{name.removeprefix(OFF)}"].transpose(*problem[name].dims).values > 0
        work, off = _drawn(problem, name, is_best & (problem[name].values > 0.0))
        axes.plot(work, off, color="0.8", linewidth=6, solid_capstyle="round", label="" if k else "Pareto front")


def _drawn(runs: xr.Dataset, name: str, which: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return work and error of some runs, by work."""
    work = runs[EVALUATIONS].broadcast_like(runs[name]).transpose(*runs[name].dims).values[which]
    order = np.argsort(work)
    return work[order], runs[name].values[which][order]


PAGE = Page(("precision",), panels_of, foot_of, most_panels=6, height=3.8)
