"""Many variables as colours: time across, one row for each or for a few neighbours.

Quantities along a dimension: what they are at some times, element beside element.

Quantities over two dimensions: maps at the start, halfway, and at the end, with one scale of colours.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.recorded_steps import model_of_record
from xdynamics.figures.curves import plotted_lines
from xdynamics.figures.framing import Frame, frame_of, leaving_note, whole_frame
from xdynamics.figures.marks import at_time, escaped_text, label_time, label_with_unit, long_unit, shortened_names
from xdynamics.figures.panel_words import axis_title, element_dims_text, shared_axis, straight_lines_note
from xdynamics.figures.sheet import Panel
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
    edges = np.append(grid, grid[-1])
    mesh = axes.pcolormesh(
        edges,
        np.arange(len(groups) + 1) + 0.5,
        rows,
        rasterized=True,
        **colours(frame.limits if frame.leaving else rows),
    )
    colour_bar(
        mesh,
        escaped_text(f"{label} ({run.variables[names[0]].attrs['units']})"),
        axes,
        has_outliers=bool(frame.leaving),
    )
    ticks = np.arange(1, len(groups) + 1, max(1, -(-len(groups) // MOST_TICKS)))
    short_names = shortened_names(row_names)
    axes.set_yticks(ticks, [short_names[k - 1] for k in ticks])
    axes.grid(visible=False)
    label_time(axes, run["time"])
    axis = shared_axis(names)
    rows_note = f"{count} rows, one per {escaped_text(row_unit)}"
    if len(groups) < count:
        middle = f"{centre:.3g}" if centre else "0"
        rows_note = f"{count} drawn as {len(groups)} rows: of up to {len(groups[0])} neighbours the value farthest from {middle}"
    leaving_note_text = _leaving_colours_note(
        frame, [f"{row_unit} {name}" if axis else name for name in row_names], run["time"]
    )
    title = f"{subject} {escaped_text(display_text(axis))}" if axis else subject
    axes.set_title(
        f"{title}{note}, {rows_note}{leaving_note_text}{straight_lines_note(run, *(names[group[0]] for group in groups))}",
        loc="left",
        fontsize=10,
    )


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
    return [escaped_text(name) for name in rows_of], element_dims_text(run, names)


def _colour_frame(rows: Floats, grid: Floats, *, is_of_bodies: bool) -> Frame:
    """Return the range of all values, or of bodies that stay where some fly off for good."""
    paths = [row[None] for row in rows]
    return frame_of(paths, [grid] * len(rows)) if is_of_bodies and np.isfinite(rows).all() else whole_frame(paths)


def _leaving_colours_note(frame: Frame, names: list[str], time: xr.DataArray) -> str:
    """Say which bodies leave the colours of a map at what times."""
    unit, size = long_unit(time)
    note = leaving_note(frame, names, unit_suffix(unit), size, frame_name="the scale of colours")
    return note and f"; {note}"


def colour_bar(mesh: Any, label: str, axes: Axes, *, has_outliers: bool = False) -> None:
    """Explain colours by a bar at the right edge of their axes, wherever the other panels of the sheet end.

    The bar ends in points where values may lie beyond it.
    """
    style: dict[str, Any] = {"extend": "both"} if has_outliers else {}
    bar = axes.figure.colorbar(mesh, cax=axes.inset_axes((1.02, 0.0, 0.035, 1.0)), **style)
    bar.set_label(label)


def colours(values: Floats) -> dict[str, Any]:
    """Return two colours that part at zero for values of both signs, one scale of colours for those of one sign."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low >= 0.0 or high <= 0.0:
        return {"cmap": "viridis", "vmin": low, "vmax": high}
    largest = max(-low, high)
    return {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}


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
