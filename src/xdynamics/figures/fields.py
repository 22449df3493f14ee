"""Quantities over two dimensions: maps at the start, halfway, and at the end, with one scale of colours."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.figures.element_maps import colour_bar, colours
from xdynamics.figures.lattice import FEWEST_ELEMENTS, model_shapes
from xdynamics.figures.marks import at_time, escaped_text, label_with_unit
from xdynamics.figures.sheet import Panel
from xdynamics.shapes import Extent, Shapes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MAP_MOMENTS = 3  # of a run, at which a field is drawn
DRAWN = ("coordinate", "velocity", "state")  # roles
MOST_LABELS = 8  # of a dimension, beside a map


def field_panels(run: xr.Dataset) -> Iterator[tuple[list[str], Panel]]:
    """Yield a panel for each coordinate, velocity and state over two dimensions of many elements, and what it draws."""
    for name, dims, names in recorded_fields(run):
        yield names, partial(draw_field, run, name, names, dims, model_shapes(run))


def recorded_fields(run: xr.Dataset) -> Iterator[tuple[str, tuple[str, str], list[str]]]:
    """Yield each coordinate, velocity and state over two dimensions of many elements, with these and their names."""
    shapes = model_shapes(run)
    for name, dims in shapes.dims.items():
        if not is_field(shapes, dims):
            continue
        names = shapes.elements(name)
        if all(
            element_name in run and run.variables[element_name].attrs.get("role") in DRAWN for element_name in names
        ):
            yield name, (dims[0], dims[1]), names


def is_field(shapes: Shapes, dims: tuple[str, ...]) -> bool:
    """Whether dimensions are two of many elements, over which a map is drawn."""
    return len(dims) == 2 and min(shapes.shape(dims)) >= FEWEST_ELEMENTS


def draw_field(run: xr.Dataset, name: str, names: list[str], dims: tuple[str, str], shapes: Shapes, axes: Axes) -> None:
    """Draw a quantity over two dimensions at recorded states, in the place of some axes.

    Colours have one scale at all times, which parts at zero where the quantity has both signs.
    """
    time = run.variables["time"].values
    rows = np.unique([np.abs(time - moment).argmin() for moment in np.linspace(time[0], time[-1], MAP_MOMENTS)])
    values = np.stack([run.variables[element_name].values[rows] for element_name in names], axis=-1)
    maps = values.reshape(len(rows), *shapes.shape(dims))
    scale = colours(maps)
    subplot_spec: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    axes.remove()
    grid = subplot_spec.subgridspec(1, len(rows))
    parts: list[Any] = [figure.add_subplot(grid[0, k]) for k in range(len(rows))]
    edges = [np.arange(size + 1) - 0.5 for size in shapes.shape(dims)]
    for k, (part, row) in enumerate(zip(parts, rows.tolist(), strict=True)):
        mesh = part.pcolormesh(*edges, maps[k].T, rasterized=True, **scale)
        part.set_aspect("equal", adjustable="box")
        part.set_anchor("N")  # below the title
        # below two blank lines, which are room for what all have as their title
        part.set_title(f" \n \n{at_time(run['time'], float(time[row]), 4)}", fontsize=8)
        part.tick_params(labelsize=7, labelleft=k == 0)
        name_axis(part.xaxis, shapes.extent(dims[0]), dims[0], is_named=k == len(rows) // 2)
        name_axis(part.yaxis, shapes.extent(dims[1]), dims[1], is_named=k == 0)
    colour_bar(mesh, label_with_unit(escaped_text(name), str(run.variables[names[0]].attrs["units"])), parts[-1])
    # no title of the first map: one wider than a map would part it from the others
    parts[0].annotate(
        escaped_text(f"{name} over {dims[0]} and {dims[1]}, at recorded states"),
        (0.0, 1.0),
        (0.0, 22.0),
        xycoords="axes fraction",
        textcoords="offset points",
        fontsize=10,
        annotation_clip=False,
    ).set_in_layout(False)


def name_axis(axis: Any, extent: Extent, dim: str, *, is_named: bool) -> None:
    """Put labels along a map, or numbers from 0 where there are none or too many."""
    from matplotlib.ticker import MaxNLocator

    labels = [*map(escaped_text, extent.labels)] if extent.labels and extent.size <= MOST_LABELS else []
    if labels:
        axis.set_ticks(range(extent.size), labels if is_named else [""] * extent.size)
    else:
        axis.set_major_locator(MaxNLocator(4, integer=True))
    if is_named:
        axis.set_label_text(escaped_text(dim if labels else f"{dim}, counted from 0"), fontsize=8)
