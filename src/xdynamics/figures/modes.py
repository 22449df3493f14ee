"""Figures of modes: the shape of each, coordinate beside coordinate, with its frequency."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.figures.element_maps import colour_bar, is_field, name_axis
from xdynamics.figures.marks import COLOURS, escaped_text, typeset
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.unfolding import shapes_of
from xdynamics.shapes import Shapes, split_element_name
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SHAPE = "shape_"
MOST_NAMED = 10  # coordinates with their names below them
TILTED = 5  # names, from where on they are tilted


def panels_of(modes: xr.Dataset) -> list[Panel]:
    """Return the panel of each mode, the slowest first.

    Raises
    ------
    InputError
        If nothing oscillates.
    """
    order = np.argsort(modes["frequency"].values, kind="stable")
    if not order.size:
        raise InputError("there is nothing to draw: the model has no modes")
    return [partial(_draw_mode, modes, int(number)) for number in order]


def foot_of(modes: xr.Dataset) -> str:
    """Describe where the modes are of."""
    summary = str(modes.attrs.get("summary", "")).replace("Linearisation", "linearised", 1)
    return f"{summary}; the largest displacement of each mode is 1, in SI units"


def _draw_mode(modes: xr.Dataset, number: int, axes: Axes) -> None:
    """Draw the displacement of every coordinate in a mode; of a lattice, as a map."""
    shapes = {str(name): variable for name, variable in modes.items() if variable.attrs.get("role") == "mode_shape"}
    values = np.array([float(variable[number]) for variable in shapes.values()])
    scales = [
        f"{float(modes[name][number]):.4g}{unit_suffix(typeset(str(modes[name].attrs['units'])))}"
        for name in ("frequency", "period")
        if name in modes
    ]
    axes.set_title(escaped_text(f"mode {number + 1}: {', period '.join(scales)}"), loc="left", fontsize=10)
    units = ", ".join(map(typeset, dict.fromkeys(str(variable.attrs["units"]) for variable in shapes.values())))
    shape = shapes_of(modes)
    first, *other_quantities = dict.fromkeys(split_element_name(name)[0] for name in shapes)
    if not other_quantities and is_field(shape, dims := shape.dims.get(first, ())):
        _draw_lattice_mode(
            values.reshape(shape.shape(dims)), dims, shape, f"{first.removeprefix(SHAPE)} ({units})", axes
        )
    else:
        _draw_mode_lines(values, [*shapes], f"displacement ({units})", axes)


def _draw_lattice_mode(
    values: NDArray[np.float64], dims: Sequence[str], shapes: Shapes, label: str, axes: Axes
) -> None:
    """Draw the displacements of a lattice, in colours that part at zero and are the same for all modes."""
    edges = [np.arange(size + 1) - 0.5 for size in values.shape]
    mesh = axes.pcolormesh(*edges, values.T, rasterized=True, cmap="RdBu_r", vmin=-1.0, vmax=1.0)
    axes.set_aspect("equal", adjustable="box")
    axes.grid(visible=False)
    for axis, dim in zip((axes.xaxis, axes.yaxis), dims, strict=True):
        name_axis(axis, shapes.extent(dim), dim, is_named=True)
    colour_bar(mesh, escaped_text(label), axes)


def _draw_mode_lines(values: NDArray[np.float64], shapes: Sequence[str], label: str, axes: Axes) -> None:
    """Draw displacements side by side."""
    from matplotlib.ticker import MaxNLocator

    places = np.arange(values.size)
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.vlines(places, 0.0, values, color=COLOURS[0], linewidth=1.0, alpha=0.5)
    # components of a body are no neighbours, which a line would join
    style = "o" if any(len(split_element_name(name)[1]) > 1 for name in shapes) else "o-"
    axes.plot(places, values, style, color=COLOURS[0], markersize=4, linewidth=1.0)
    names = [escaped_text(name.removeprefix(SHAPE)) for name in shapes]
    quantities, elements = zip(*(split_element_name(name.removeprefix(SHAPE)) for name in shapes), strict=True)
    if values.size <= MOST_NAMED:
        if len({*quantities}) == 1 and all(elements):  # of one quantity, which the axis names
            names = [escaped_text(", ".join(labels)) for labels in elements]
            axes.set_xlabel(escaped_text(quantities[0]))
        tilted: dict[str, Any] = (
            {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if values.size >= TILTED else {}
        )
        axes.set_xticks(places, names, **tilted)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel(f"{names[0]} to {names[-1]}")
    axes.set(ylim=(-1.15, 1.15), ylabel=escaped_text(label))


PAGE = Page(("modes",), panels_of, foot_of, most_panels=6)
