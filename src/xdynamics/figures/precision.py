"""Figures of work against precision: the error of a number over its cost, a line for each method."""

from __future__ import annotations

from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.grid_axes import WHAT
from xdynamics.figures.marks import COLOURS, escaped_text
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.sweep import other_settings_note, value_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MARKERS = "os^Dv<>P"
EVALUATIONS, OFF, FRONT = "run_force_evaluations", "off_", "front_"


def panels_of(precision: xr.Dataset) -> list[Panel]:
    """Return the panel of each number."""
    names = [
        str(name) for name in precision.data_vars if str(name).startswith(OFF) and bool((precision[name] > 0).any())
    ]
    return [partial(_draw_work_precision, precision, name) for name in names]


def foot_of(precision: xr.Dataset) -> str:
    """Describe what is drawn."""
    varied = str(precision.attrs["varied"])
    sizes = ", ".join(f"{float(value):.6g}" for value in precision[varied].values)
    return f"each point a run; along a line {varied} = {sizes}{value_suffix(precision, varied)}"


def _draw_work_precision(precision: xr.Dataset, name: str, axes: Axes) -> None:
    varied = str(precision.attrs["varied"])
    runs = precision[[name, f"{FRONT}{name.removeprefix(OFF)}", EVALUATIONS]]
    for dim in [dim for dim in runs[name].dims if dim not in runs[EVALUATIONS].dims]:
        runs = runs.isel({dim: -1})
    other_dims = [str(dim) for dim in runs[name].dims if dim != varied]
    _draw_fronts(runs, [dim for dim in other_dims if precision[dim].attrs.get(WHAT) != "method"], name, axes)
    for k, indices in enumerate(product(*(range(runs.sizes[dim]) for dim in other_dims))):
        line = runs.isel(dict(zip(other_dims, indices, strict=True)))
        work, error = _work_and_error(line, name, line[name].values > 0.0)
        axes.plot(
            work,
            error,
            f"{MARKERS[k % len(MARKERS)]}-",
            color=COLOURS[k % len(COLOURS)],
            markersize=4,
            linewidth=1.0,
            label=escaped_text(other_settings_note(line, [varied]).removeprefix(", ")),
        )
    units = precision[name].attrs["units"]
    axes.set(xscale="log", yscale="log", xlabel="force evaluations", ylabel=escaped_text(f"|error| ({units})"))
    if np.ptp(np.log10(runs[EVALUATIONS].values)) > 1.0:
        axes.xaxis.set_minor_formatter("")  # powers of ten are enough
    axes.set_title(escaped_text(name.removeprefix(OFF)), loc="left", fontsize=10)
    if other_dims:
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _draw_fronts(runs: xr.Dataset, dims: list[str], name: str, axes: Axes) -> None:
    """Draw broad lines below those of methods, through the runs that no other one betters: one for each problem."""
    for k, indices in enumerate(product(*(range(runs.sizes[dim]) for dim in dims))):
        problem = runs.isel(dict(zip(dims, indices, strict=True)))
        is_best = problem[f"{FRONT}{name.removeprefix(OFF)}"].transpose(*problem[name].dims).values > 0
        work, error = _work_and_error(problem, name, is_best & (problem[name].values > 0.0))
        axes.plot(work, error, color="0.8", linewidth=6, solid_capstyle="round", label="" if k else "Pareto front")


def _work_and_error(runs: xr.Dataset, name: str, mask: NDArray[np.bool_]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return work and error of some runs, by work."""
    work = runs[EVALUATIONS].broadcast_like(runs[name]).transpose(*runs[name].dims).values[mask]
    order = np.argsort(work)
    return work[order], runs[name].values[mask][order]


PAGE = Page(("precision",), panels_of, foot_of, most_panels=6, height=3.8)
