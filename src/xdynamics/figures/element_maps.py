"""Many variables as colours: time across, one row for each or for a few neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.curves import plotted_lines
from xdynamics.figures.framing import Frame, frame_of, leaving_note, whole_frame
from xdynamics.figures.marks import escaped_text, label_time, long_unit, shortened_names
from xdynamics.figures.panel_words import axis_title, element_dims_text, shared_axis, straight_lines_note
from xdynamics.shapes import display_text, split_element_name
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
