"""Quantities along a dimension: what they are at some times, element beside element."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.figures.marks import escaped_text, long_unit
from xdynamics.figures.sheet import Panel
from xdynamics.shapes import Extent, Shapes
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FEWEST_ELEMENTS = 7  # of a dimension, which fewer are drawn as lines in time
PROFILE_MOMENTS = 5  # of a run


def model_shapes(run: xr.Dataset) -> Shapes:
    """Return the dimensions of a run's model; none if it has none."""
    return model_of_record(run, None).shapes if "model_toml" in run else Shapes()


def profile_panels(run: xr.Dataset) -> list[tuple[list[str], Panel]]:
    """Return a panel for each coordinate and state with one dimension of many elements, and what it draws."""
    return [
        (elements, partial(draw_profile, run, name, dim, elements))
        for name, dim, elements in profiled_quantities(run, model_shapes(run))
    ]


def profiled_quantities(run: xr.Dataset, shapes: Shapes) -> Iterator[tuple[str, str, list[str]]]:
    """Yield coordinates and states with one dimension of many elements, with it and the names of the elements."""
    for name, dims in shapes.dims.items():
        if len(dims) != 1 or shapes.extent(dims[0]).size < FEWEST_ELEMENTS:
            continue
        elements = shapes.elements(name)
        if all(
            element in run and run.variables[element].attrs.get("role") in ("coordinate", "state")
            for element in elements
        ):
            yield name, dims[0], elements


def profile_times(start: float, end: float) -> NDArray[np.float64]:
    """Return the times that profiles are drawn at."""
    return np.linspace(start, end, PROFILE_MOMENTS)


def name_elements(axes: Axes, dim: str, extent: Extent) -> None:
    """Say what stands along a dimension: labels, or numbers from 0."""
    axes.set_xlabel(escaped_text(dim if extent.labels else f"{dim}, counted from 0"))
    if extent.labels:
        axes.set_xticks(range(extent.size), [escaped_text(label) for label in extent.labels], rotation=30, ha="right")


def draw_profile(run: xr.Dataset, name: str, dim: str, elements: list[str], axes: Axes) -> None:
    """Draw the elements of a quantity side by side at the recorded states nearest to some times."""
    from matplotlib import colormaps

    time = run.variables["time"].values
    rows = np.unique([int(np.abs(time - moment).argmin()) for moment in profile_times(time[0], time[-1])])
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(rows)))
    unit, size = long_unit(run["time"])
    for row, shade in zip(rows, shades, strict=True):
        values = [float(run.variables[element].values[row]) for element in elements]
        axes.plot(
            range(len(values)),
            values,
            ".-",
            color=shade,
            markersize=3,
            linewidth=1,
            label=f"{float(f'{time[row] / size:.4g}'):g}{unit_suffix(unit)}",
        )
    name_elements(axes, dim, model_shapes(run).extent(dim))
    axes.set(ylabel=escaped_text(f"{name} ({run.variables[elements[0]].attrs['units']})"))
    axes.set_title(escaped_text(f"{name} along {dim}, at recorded states"), loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
