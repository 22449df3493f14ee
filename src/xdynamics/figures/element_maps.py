"""Many variables as colours: time across, one row for each or for a few neighbours."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.curves import drawn
from xdynamics.figures.framing import Frame, frame_of, leaving_note, whole_frame
from xdynamics.figures.marks import label_time, long_unit, shortened, words
from xdynamics.figures.panel_words import counted_by, joined, shared_axis, straight
from xdynamics.shapes import parted, spoken
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Floats = NDArray[np.float64]

COLUMNS = 800  # of a map
MOST_ROWS = 500  # of a map, which has no more lines of pixels
MOST_TICKS = 10  # of a map, at equal distances
STEADY = 0.25  # of the largest value: a map whose rows change less shows how they change


def draw_map(run: xr.Dataset, names: list[str], what: str, axes: Axes) -> None:
    """Draw many variables as colours.

    Of very many, each row has the value of some neighbours that is farthest from zero, or from the median of all where they
    have one sign: what is narrower than a row is seen. Where bodies fly off, colours are those of the bodies that stay.
    """
    time, count = run.variables["time"].values, len(names)
    groups = [group.tolist() for group in np.array_split(np.arange(count), min(count, MOST_ROWS))]
    grid = np.linspace(time[0], time[-1], min(COLUMNS, 4 * len(time)))
    rows, changes, centre = _rows(run, [[names[k] for k in group] for group in groups], grid)
    label, note = joined(names), ""
    if 0.0 < np.abs(changes).max() < STEADY * np.ptp(rows):
        rows, label, note, centre = changes, f"{label} - {label}(0)", " less its start", 0.0
    called, by = _called(run, [names[group[0]] for group in groups])
    frame = _frame(rows, grid, is_of_bodies=bool(shared_axis(names)))
    edges = np.append(grid, grid[-1])
    mesh = axes.pcolormesh(
        edges,
        np.arange(len(groups) + 1) + 0.5,
        rows,
        rasterized=True,
        **colours(frame.limits if frame.leaving else rows),
    )
    colour_bar(mesh, words(f"{label} ({run.variables[names[0]].attrs['units']})"), axes, beyond=bool(frame.leaving))
    ticks = np.arange(1, len(groups) + 1, max(1, -(-len(groups) // MOST_TICKS)))
    brief = shortened(called)
    axes.set_yticks(ticks, [brief[k - 1] for k in ticks])
    axes.grid(visible=False)
    label_time(axes, run["time"])
    axis = shared_axis(names)
    each = f"{count} rows, one per {words(by)}"
    if len(groups) < count:
        middle = f"{centre:.3g}" if centre else "0"
        each = f"{count} drawn as {len(groups)} rows: of up to {len(groups[0])} neighbours the value farthest from {middle}"
    gone = _leaving(frame, [f"{by} {name}" if axis else name for name in called], run["time"])
    title = f"{what} {words(spoken(axis))}" if axis else what
    axes.set_title(
        f"{title}{note}, {each}{gone}{straight(run, *(names[group[0]] for group in groups))}", loc="left", fontsize=10
    )


def _rows(run: xr.Dataset, groups: list[list[str]], grid: Floats) -> tuple[Floats, Floats, float]:
    """Return values and their changes since the start, each of shape (groups, times), and from where values are farthest.

    Of a group that value is kept, at each time, that is farthest from there, and the change that is largest.
    """

    def lines(names: list[str]) -> Floats:
        return np.stack([np.interp(grid, times, line) for name in names for times, (line,) in [drawn(run, name)]])

    if all(len(group) == 1 for group in groups):
        rows = lines([name for (name,) in groups])
        return rows, rows - rows[:, :1], 0.0
    first = np.stack([run.variables[name].values for group in groups for name in group[:1]])
    centre = 0.0 if first.min() < 0.0 < first.max() else float(np.median(first))
    rows, changes = np.empty((2, len(groups), grid.size))
    for k, group in enumerate(groups):
        block = lines(group)
        rows[k] = _farthest(block, centre)
        changes[k] = _farthest(block - block[:, :1], 0.0)
    return rows, changes, centre


def _farthest(block: Floats, centre: float) -> Floats:
    """Return for each column of a block the value that is farthest from a centre."""
    found: Floats = np.take_along_axis(block, np.abs(block - centre).argmax(axis=0)[None], axis=0)[0]
    return found


def _called(run: xr.Dataset, names: list[str]) -> tuple[list[str], str]:
    """Return what rows are called, without an axis that all have in common, and what there is one for each of."""
    rows_of = [", ".join(parted(name)[1][:-1]) for name in names] if shared_axis(names) else names
    return [words(name) for name in rows_of], counted_by(run, names)


def _frame(rows: Floats, grid: Floats, *, is_of_bodies: bool) -> Frame:
    """Return the range of all values, or of bodies that stay where some fly off for good."""
    paths = [row[None] for row in rows]
    return frame_of(paths, [grid] * len(rows)) if is_of_bodies and np.isfinite(rows).all() else whole_frame(paths)


def _leaving(frame: Frame, names: list[str], time: xr.DataArray) -> str:
    """Say which bodies leave the colours of a map at what times."""
    unit, size = long_unit(time)
    note = leaving_note(frame, names, unit_suffix(unit), size, of="the scale of colours")
    return note and f"; {note}"


def colour_bar(mesh: Any, label: str, axes: Axes, *, beyond: bool = False) -> None:
    """Explain colours by a bar at the right edge of their axes, wherever the other panels of the sheet end.

    The bar ends in points where values may lie beyond it.
    """
    style: dict[str, Any] = {"extend": "both"} if beyond else {}
    bar = axes.figure.colorbar(mesh, cax=axes.inset_axes((1.02, 0.0, 0.035, 1.0)), **style)
    bar.set_label(label)


def colours(values: Floats) -> dict[str, Any]:
    """Return two colours that part at zero for values of both signs, one scale of colours for those of one sign."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if low >= 0.0 or high <= 0.0:
        return {"cmap": "viridis", "vmin": low, "vmax": high}
    largest = max(-low, high)
    return {"cmap": "RdBu_r", "vmin": -largest, "vmax": largest}
