"""Elements beside each other: many variables as colours over time, one row for each or for a few neighbours.

Quantities along a dimension, or over two as maps, at some times with one scale of colours; and the shapes of modes.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.faults import InputError
from xdynamics.figures.curves import plotted_lines
from xdynamics.figures.framing import Frame, frame_of, leaving_note, whole_frame
from xdynamics.figures.marks import (
    COLOURS,
    Label,
    at_time,
    axis_title,
    draw_line,
    element_dims_text,
    escaped_text,
    label_panel,
    label_time,
    shared_axis,
    shortened_names,
    straight_lines_note,
    subpanels,
    typeset,
)
from xdynamics.figures.sheet import Page, Panel
from xdynamics.record.long_times import long_unit
from xdynamics.record.unfolding import shapes_of
from xdynamics.shapes import Extent, Shapes, display_text, split_element_name
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

COLUMNS = 800  # of a map
MOST_ROWS = 500  # of a map, which has no more lines of pixels
MOST_TICKS = 10  # of a map, at equal distances
STEADY = 0.25  # of the largest value: a map whose rows change less shows how they change


def draw_map(run: xr.Dataset, names: list[str], subject: str, axes: Axes) -> None:
    """Draw many variables as colours.

    Of very many, each row has the value of some neighbours that is farthest from zero, or from the median of all where they
    have one sign: what is narrower than a row is seen. Where bodies fly off, colours are those of the bodies that stay.
    """
    time, count = run.variables["time"].values, len(names)
    groups = [group.tolist() for group in np.array_split(np.arange(count), min(count, MOST_ROWS))]
    grid = np.linspace(time[0], time[-1], min(COLUMNS, 4 * len(time)))
    rows, changes, centre = _map_rows(run, [[names[k] for k in group] for group in groups], grid)
    label, note = axis_title(names), ""
    if 0.0 < np.abs(changes).max() < STEADY * np.ptp(rows):
        rows, label, note, centre = changes, f"{label} - {label}(0)", " less its start", 0.0
    row_names, row_unit = _row_names(run, [names[group[0]] for group in groups])
    frame = _colour_frame(rows, grid, is_of_bodies=bool(shared_axis(names)))
    # a mesh needs one edge more than it has cells: the last cell has no width
    edges = np.append(grid, grid[-1]), np.arange(len(groups) + 1) + 0.5
    mesh = axes.pcolormesh(*edges, rows, rasterized=True, **colours(frame.limits if frame.leaving else rows))
    bar_label = (label, str(run.variables[names[0]].attrs["units"]))
    colour_bar(mesh, bar_label, axes, has_outliers=bool(frame.leaving))
    ticks, short_names = (
        range(0, len(groups), max(1, -(-len(groups) // MOST_TICKS))),
        shortened_names([*map(escaped_text, row_names)]),
    )
    axes.set_yticks([k + 1 for k in ticks], [short_names[k] for k in ticks])
    axes.grid(visible=False)
    label_time(axes, run["time"])
    axis = shared_axis(names)
    rows_note = f"{count} rows, one per {row_unit}"
    if len(groups) < count:
        middle = f"{centre:.3g}" if centre else "0"
        rows_note = f"{count} drawn as {len(groups)} rows: of up to {len(groups[0])} neighbours the value farthest from {middle}"
    bodies = [f"{row_unit} {name}" if axis else name for name in row_names]
    leaving = leaving_note(frame, bodies, run["time"], frame_name="the scale of colours")
    straight = straight_lines_note(run, *(names[group[0]] for group in groups))
    label_panel(axes, f"{f'{subject} {display_text(axis)}' if axis else subject}{note}, {rows_note}{leaving}{straight}")


def _map_rows(run: xr.Dataset, groups: list[list[str]], grid: Floats) -> tuple[Floats, Floats, float]:
    """Return values and their changes since the start, each of shape (groups, times), and from where values are farthest.

    Of a group that value is kept, at each time, that is farthest from there, and the change that is largest.
    """

    def interpolated_lines(names: list[str]) -> Floats:
        return np.stack(
            [np.interp(grid, times, line) for name in names for times, (line,) in [plotted_lines(run, name)]]
        )

    if all(len(group) == 1 for group in groups):
        rows = interpolated_lines([name for (name,) in groups])
        return rows, rows - rows[:, :1], 0.0
    first = np.stack([run.variables[name].values for group in groups for name in group[:1]])
    centre = 0.0 if first.min() < 0.0 < first.max() else float(np.median(first))
    rows, changes = np.empty((2, len(groups), grid.size))
    for k, group in enumerate(groups):
        block = interpolated_lines(group)
        rows[k] = _farthest(block, centre)
        changes[k] = _farthest(block - block[:, :1], 0.0)
    return rows, changes, centre


def _farthest(block: Floats, centre: float) -> Floats:
    """Return for each column of a block the value that is farthest from a centre."""
    farthest: Floats = np.take_along_axis(block, np.abs(block - centre).argmax(axis=0)[None], axis=0)[0]
    return farthest


def _row_names(run: xr.Dataset, names: list[str]) -> tuple[list[str], str]:
    """Return what rows are called, without an axis that all have in common, and what there is one for each of."""
    rows_of = [", ".join(split_element_name(name)[1][:-1]) for name in names] if shared_axis(names) else names
    return rows_of, element_dims_text(run, names)


def _colour_frame(rows: Floats, grid: Floats, *, is_of_bodies: bool) -> Frame:
    """Return the range of all values, or of bodies that stay where some fly off for good."""
    paths = [row[None] for row in rows]
    return frame_of(paths, [grid] * len(rows)) if is_of_bodies and np.isfinite(rows).all() else whole_frame(paths)


def colour_bar(mesh: Any, label: Label, axes: Axes, *, has_outliers: bool = False) -> None:
    """Explain colours by a bar at the right edge of their axes, wherever the other panels of the sheet end.

    The bar ends in points where values may lie beyond it.
    """
    inset = axes.inset_axes((1.02, 0.0, 0.035, 1.0))
    axes.figure.colorbar(mesh, cax=inset, extend="both" if has_outliers else "neither")
    label_panel(inset, y=label)


def colours(values: Floats) -> dict[str, Any]:
    """Return two colours that part at zero for values of both signs, one scale of colours for those of one sign."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low >= 0.0 or high <= 0.0:
        return {"cmap": "viridis", "vmin": low, "vmax": high}
    largest = max(-low, high)
    return {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}


FEWEST_ELEMENTS = 7  # of a dimension, which fewer are drawn as lines in time
PROFILE_MOMENTS, MAP_MOMENTS = 5, 3  # of a run, at which a quantity is drawn along a dimension, or over two
ROLES = {1: ("coordinate", "state"), 2: ("coordinate", "velocity", "state")}  # by the number of dimensions
MOST_LABELS = 8  # of a dimension, beside a map


@dataclass(frozen=True)
class ElementField:
    """A quantity along a dimension of many elements, or over two.

    Attributes
    ----------
    name : str
    units : str
    extents : tuple of Extent
        Of its dimensions.
    elements : list of str
        The variables of its elements.
    """

    name: str
    units: str
    extents: tuple[Extent, ...]
    elements: list[str]

    @property
    def dims(self) -> tuple[str, ...]:
        """The names of its dimensions."""
        return tuple(extent.name for extent in self.extents)

    def values_at(self, run: xr.Dataset, rows: Any = slice(None)) -> Floats:
        """Return its values at some rows of a run, shape (rows, elements) or (rows, across, up)."""
        values = np.stack([run.variables[element].values[rows] for element in self.elements], axis=-1)
        return values.reshape(len(values), *(extent.size for extent in self.extents))


def model_shapes(run: xr.Dataset) -> Shapes:
    """Return the dimensions of a run's model; none if it has none."""
    return model_of_record(run, None).shapes if "model_toml" in run else Shapes()


def is_field(shapes: Shapes, dims: Sequence[str], rank: int = 2) -> bool:
    """Whether dimensions are so many, each of many elements."""
    return len(dims) == rank and min(shapes.shape(tuple(dims))) >= FEWEST_ELEMENTS


def fields_of(run: xr.Dataset, rank: int) -> Iterator[ElementField]:
    """Yield what is drawn along one dimension or over two: coordinates, states and, over two, velocities."""
    shapes = model_shapes(run)
    for name, dims in shapes.dims.items():
        if is_field(shapes, dims, rank):
            elements = shapes.elements(name)
            if all(entry in run and run.variables[entry].attrs.get("role") in ROLES[rank] for entry in elements):
                units = str(run.variables[elements[0]].attrs["units"])
                yield ElementField(name, units, tuple(map(shapes.extent, dims)), elements)


def field_panels(run: xr.Dataset, rank: int) -> Iterator[tuple[list[str], Panel]]:
    """Yield a panel for each quantity along one dimension or over two, and the variables that it draws."""
    for field in fields_of(run, rank):
        yield field.elements, partial(draw_profile if rank == 1 else draw_field, run, field)


def profile_times(start: float, end: float) -> NDArray[np.float64]:
    """Return the times that profiles are drawn at."""
    return np.linspace(start, end, PROFILE_MOMENTS)


def _nearest_rows(run: xr.Dataset, moments: Floats) -> NDArray[np.int64]:
    """Return the rows of a run that are nearest to some times."""
    return np.unique([np.abs(run.variables["time"].values - moment).argmin() for moment in moments])


def name_elements(axes: Axes, extent: Extent) -> None:
    """Say what stands along a dimension: labels, or numbers from 0."""
    label_panel(axes, x=extent.name if extent.labels else f"{extent.name}, counted from 0")
    if extent.labels:
        axes.set_xticks(range(extent.size), [*map(escaped_text, extent.labels)], rotation=30, ha="right")


def draw_profile(run: xr.Dataset, field: ElementField, axes: Axes) -> None:
    """Draw the elements of a quantity side by side at the recorded states nearest to some times."""
    from matplotlib import colormaps

    time = run.variables["time"].values
    rows = _nearest_rows(run, profile_times(time[0], time[-1]))
    shades = colormaps["viridis"](np.linspace(0.0, 0.85, len(rows)))
    unit, size = long_unit(run["time"])
    for row, values, shade in zip(rows, field.values_at(run, rows), shades, strict=True):
        label = f"{float(f'{time[row] / size:.4g}'):g}{unit_suffix(unit)}"
        axes.plot(range(len(values)), values, ".-", color=shade, markersize=3, linewidth=1, label=label)
    name_elements(axes, field.extents[0])
    label_panel(axes, f"{field.name} along {field.dims[0]}, at recorded states", y=(field.name, field.units))
    axes.legend(fontsize=8, frameon=False)


def draw_cells(values: Floats, extents: Sequence[Extent], axes: Axes, named: str = "xy", **style: Any) -> Any:
    """Draw values over two dimensions as square cells, shape (across, up), and name some of the axes."""
    mesh = axes.pcolormesh(*(np.arange(size + 1) - 0.5 for size in values.shape), values.T, **style)
    axes.set_aspect("equal", adjustable="box")
    axes.grid(visible=False)
    for letter, axis, extent in zip("xy", (axes.xaxis, axes.yaxis), extents, strict=True):
        _name_axis(axis, extent, is_named=letter in named)
    return mesh


def _name_axis(axis: Any, extent: Extent, *, is_named: bool) -> None:
    """Put labels along a map, or numbers from 0 where there are none or too many."""
    from matplotlib.ticker import MaxNLocator

    labels = [*map(escaped_text, extent.labels)] if extent.labels and extent.size <= MOST_LABELS else []
    if labels:
        axis.set_ticks(range(extent.size), labels if is_named else [""] * extent.size)
    else:
        axis.set_major_locator(MaxNLocator(4, integer=True))
    if is_named:
        axis.set_label_text(escaped_text(extent.name if labels else f"{extent.name}, counted from 0"), fontsize=8)


def draw_field(run: xr.Dataset, field: ElementField, axes: Axes) -> None:
    """Draw a quantity over two dimensions at recorded states, in the place of some axes.

    Colours have one scale at all times, which parts at zero where the quantity has both signs.
    """
    time = run.variables["time"].values
    rows = _nearest_rows(run, np.linspace(time[0], time[-1], MAP_MOMENTS))
    maps = field.values_at(run, rows)
    parts = subpanels(axes, len(rows))
    for k, (part, row) in enumerate(zip(parts, rows.tolist(), strict=True)):
        named = "x" * (k == len(rows) // 2) + "y" * (k == 0)  # one map names both
        mesh = draw_cells(maps[k], field.extents, part, named, rasterized=True, **colours(maps))
        part.set_anchor("N")  # below the title
        # below two blank lines, which are room for what all have as their title
        part.set_title(f" \n \n{at_time(run['time'], float(time[row]), 4)}", fontsize=8)
        part.tick_params(labelsize=7, labelleft=k == 0)
    colour_bar(mesh, (field.name, field.units), parts[-1])
    # no title of the first map: one wider than a map would part it from the others
    parts[0].annotate(
        escaped_text(f"{field.name} over {field.dims[0]} and {field.dims[1]}, at recorded states"),
        (0.0, 1.0),
        (0.0, 22.0),
        xycoords="axes fraction",
        textcoords="offset points",
        fontsize=10,
        annotation_clip=False,
    ).set_in_layout(False)


SHAPE = "shape_"
MOST_NAMED = 10  # coordinates with their names below them
TILTED = 5  # names, from where on they are tilted


def mode_panels(modes: xr.Dataset) -> list[Panel]:
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


def mode_foot(modes: xr.Dataset) -> str:
    """Describe where the modes are of."""
    summary = str(modes.attrs.get("summary", "")).replace("Linearisation", "linearised", 1)
    return f"{summary}; the largest displacement of each mode is 1, in SI units"


def _draw_mode(modes: xr.Dataset, number: int, axes: Axes) -> None:
    """Draw the displacement of every coordinate in a mode; of a lattice as a map, in colours that are the same for all modes."""
    variables = {str(name): variable for name, variable in modes.items() if variable.attrs.get("role") == "mode_shape"}
    values = np.array([float(variable[number]) for variable in variables.values()])
    scales = [
        f"{float(modes[name][number]):.4g}{unit_suffix(typeset(str(modes[name].attrs['units'])))}"
        for name in ("frequency", "period")
        if name in modes
    ]
    label_panel(axes, f"mode {number + 1}: {', period '.join(scales)}")
    units = ", ".join(map(typeset, dict.fromkeys(str(variable.attrs["units"]) for variable in variables.values())))
    shapes, names = shapes_of(modes), [name.removeprefix(SHAPE) for name in variables]
    quantity, *other_quantities = dict.fromkeys(split_element_name(name)[0] for name in variables)
    if not other_quantities and is_field(shapes, dims := shapes.dims.get(quantity, ())):
        style: dict[str, Any] = {"rasterized": True, "cmap": "RdBu_r", "vmin": -1.0, "vmax": 1.0}
        mesh = draw_cells(values.reshape(shapes.shape(dims)), [*map(shapes.extent, dims)], axes, **style)
        colour_bar(mesh, f"{quantity.removeprefix(SHAPE)} ({units})", axes)
    else:
        _draw_displacements(values, names, f"displacement ({units})", axes)


def _draw_displacements(values: Floats, names: Sequence[str], label: str, axes: Axes) -> None:
    """Draw displacements side by side."""
    from matplotlib.ticker import MaxNLocator

    places = np.arange(values.size)
    axes.axhline(0.0, color="#888888", linewidth=0.8)
    axes.vlines(places, 0.0, values, color=COLOURS[0], linewidth=1.0, alpha=0.5)
    quantities, elements = zip(*map(split_element_name, names), strict=True)
    # components of a body are no neighbours, which a line would join
    draw_line(axes, places, values, "o" if any(len(labels) > 1 for labels in elements) else "o-")
    if values.size <= MOST_NAMED:
        if len({*quantities}) == 1 and all(elements):  # of one quantity, which the axis names
            names = [", ".join(labels) for labels in elements]
            label_panel(axes, x=quantities[0])
        tilted: dict[str, Any] = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"}
        axes.set_xticks(places, [*map(escaped_text, names)], **(tilted if values.size >= TILTED else {}))
    else:
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        label_panel(axes, x=f"{names[0]} to {names[-1]}")
    axes.set_ylim(-1.15, 1.15)
    label_panel(axes, y=label)


PAGES = (Page(("modes",), mode_panels, mode_foot, most_panels=6),)
