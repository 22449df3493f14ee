"""A number of a sweep over two axes: a map with lines of equal value and the regions of outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.marks import COLOURS, escaped_text, label_with_unit
from xdynamics.figures.sweep_labels import number_label, other_settings_note, value_suffix
from xdynamics.march.outcomes import GOOD
from xdynamics.schema import AT, OCCURRENCE
from xdynamics.shapes import split_element_name
from xdynamics.sweeping.members import end_descriptions
from xdynamics.sweeping.sweep_summary import significant_number
from xdynamics.units.digits import known_to

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = NDArray[Any]

SHADES = "cividis"
CONTOURS = 7  # lines of equal value on a smooth map
ROUGH = 0.05  # of the spread, that a smooth map bends by from one member to the next on the mean
FEWEST_SIDE = 6  # members along each side of such a map
FAR = 3.0  # times the span of nearly all values, from which on a few do not set the colours
MOST_MAPS = 4  # of elements in one panel
FEW = 12  # whole numbers up to which each has a colour of its own


def draw_over_two_axes(
    full_sweep: xr.Dataset, name: str, part: Mapping[str, int], shown_axes: list[str], axes: Axes
) -> None:
    """Draw a number over two axes, and frame the runs that ended otherwise than most."""
    sweep = full_sweep.isel(part)
    values = _map_values(sweep, name, shown_axes)
    x, y = shown_axes
    across, up = sweep[x].values.astype(float), sweep[y].values.astype(float)
    shades, ticks = _colour_scale(values)
    mesh = _mesh(sweep, values, shown_axes, shades, axes)
    _explain(mesh, values, ticks, number_label(sweep, name), axes)
    best = _draw_relief(axes, across, up, values)
    extreme_notes = [
        f"{word} {mark} {significant_number(sweep, name, value)}{value_suffix(sweep, name)} at {x} {known_to(*location[0])}{value_suffix(sweep, x)},"
        f" {y} {known_to(*location[1])}{value_suffix(sweep, y)}"
        for word, mark, value, location in best
    ]
    axes.set_title(
        "\n".join(map(escaped_text, (f"{name}{other_settings_note(sweep, shown_axes)}", *extreme_notes))),
        loc="left",
        fontsize=10,
    )


def draw_elements_over_axes(
    full_sweep: xr.Dataset, names: list[str], part: Mapping[str, int], shown_axes: list[str], axes: Axes
) -> None:
    """Draw the elements of a quantity over two axes in the place of some axes: side by side, on one scale of colours."""
    sweep, element_indices = (
        full_sweep.isel(part),
        np.linspace(0, len(names) - 1, min(len(names), MOST_MAPS)).round().astype(int),
    )
    drawn_names, quantity = [names[k] for k in element_indices], split_element_name(names[0])[0]
    values = np.stack([_map_values(sweep, name, shown_axes) for name in drawn_names])
    shades, ticks = _colour_scale(values)
    subplot_spec: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    axes.remove()
    columns = -(-len(drawn_names) // 2) if len(drawn_names) > 2 else len(drawn_names)
    grid = subplot_spec.subgridspec(-(-len(drawn_names) // columns), columns)
    parts: list[Any] = [figure.add_subplot(grid[k // columns, k % columns]) for k in range(len(drawn_names))]
    for k, (name, map_axes) in enumerate(zip(drawn_names, parts, strict=True)):
        mesh = _mesh(sweep, values[k], shown_axes, shades, map_axes)
        map_axes.set_title(escaped_text(name), fontsize=8)
        map_axes.tick_params(labelsize=7)
        map_axes.set(
            xlabel="" if k + columns < len(drawn_names) else map_axes.get_xlabel(),
            ylabel="" if k % columns else map_axes.get_ylabel(),
        )
    unit = str(sweep[names[0]].attrs["units"])
    _explain(mesh, values, ticks, escaped_text(label_with_unit(quantity, unit)), parts[-1])
    left_out = f", {len(drawn_names)} of {len(names)} elements" if len(drawn_names) < len(names) else ""
    parts[0].set_title(
        escaped_text(f"{quantity}{other_settings_note(sweep, shown_axes)}{left_out}") + "\n", loc="left", fontsize=10
    )


def _map_values(sweep: xr.Dataset, name: str, shown_axes: list[str]) -> Values:
    """Return a number over two axes, shape (up, across): at the last time, or of the first occurrence."""
    number, (x, y) = sweep[name], shown_axes
    for dim in (AT, OCCURRENCE):
        number = number.isel({dim: -1 if dim == AT else 0}) if dim in number.dims else number
    map_values: Values = number.transpose(y, x).values
    return map_values


def _mesh(sweep: xr.Dataset, values: Values, shown_axes: list[str], shades: dict[str, Any], axes: Axes) -> Any:
    """Draw values as colours over two axes, and the regions of outcomes."""
    x, y = shown_axes
    across, up = sweep[x].values.astype(float), sweep[y].values.astype(float)
    masked = np.ma.masked_invalid(values.astype(float))
    mesh = axes.pcolormesh(across, up, masked, shading="nearest", rasterized=True, **shades)
    _frame_regions(axes, end_descriptions(sweep).transpose(y, x).values.astype(str), across, up)
    axes.set(xlabel=number_label(sweep, x), ylabel=number_label(sweep, y))
    if sweep[x].attrs["units"] == sweep[y].attrs["units"] != "1" and 0.5 < np.ptp(across) / np.ptp(up) < 2.0:
        axes.set_aspect("equal", anchor="W")
    axes.grid(visible=False)
    return mesh


def _explain(mesh: Any, values: Values, ticks: Any, label: str, axes: Axes) -> None:
    """Explain colours by a bar at the right edge of their axes."""
    map_colour_bar(mesh, label, axes, ticks=ticks, extend=_exceeded_ends(values, mesh.norm))


def map_colour_bar(mesh: Any, label: str, axes: Axes, **bar_options: Any) -> None:
    """Draw a bar of a map's colours at the right edge of its axes; `bar_options` as matplotlib's `colorbar` has it."""
    figure: Any = axes.figure
    bar = figure.colorbar(mesh, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), **bar_options)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=7)


def _draw_relief(
    axes: Axes, across: Values, up: Values, values: Values
) -> list[tuple[str, str, float, tuple[tuple[float, float], ...]]]:
    """Draw lines of equal value on a smooth map, and mark the greatest and the least value that are inside of it.

    Returns
    -------
    list of tuple
        Of each mark its word, its sign, the value, and where it is, with the half of a spacing that the grid leaves open.
    """
    if values.dtype.kind != "f" or min(values.shape) < FEWEST_SIDE or not np.isfinite(values).all():
        return []
    spread, of_most = float(np.ptp(values)), float(np.ptp(np.quantile(values, (0.05, 0.95))))
    bend = max(np.abs(np.diff(values, 2, axis=axis)).mean() for axis in (0, 1))
    # beside a few members that are far off any noise looks smooth
    if not spread > 0.0 or bend > min(ROUGH * spread, of_most) or len(np.unique(values)) <= FEW:
        return []
    lines = axes.contour(across, up, values, levels=CONTOURS, colors="white", linewidths=0.6, alpha=0.8)
    axes.clabel(lines, fontsize=6, fmt="%.4g")
    extremes = []
    for word, mark, marker, flat_index in (
        ("greatest", "\u25b2", "^", values.argmax()),
        ("least", "\u25bc", "v", values.argmin()),
    ):
        row, column = np.unravel_index(int(flat_index), values.shape)
        if 0 < row < values.shape[0] - 1 and 0 < column < values.shape[1] - 1:
            axes.plot(across[column], up[row], marker, color="white", markeredgecolor="black", markersize=7)
            location = tuple(
                (float(axis[k]), float(np.ptp(axis[k - 1 : k + 2])) / 4.0) for axis, k in ((across, column), (up, row))
            )
            extremes.append((word, mark, float(values[row, column]), location))
    return extremes


def _colour_scale(values: Values) -> tuple[dict[str, Any], Any]:
    """Return a colour scale: one colour for each of a few whole numbers, else from dark to light, outliers disregarded."""
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm

    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    levels = np.unique(finite)
    if finite.size and len(levels) <= FEW and (levels == np.round(levels)).all():
        edges = np.arange(levels.min() - 0.5, levels.max() + 1.0)
        scale = colormaps[SHADES].resampled(max(2, len(edges) - 1))
        return {"cmap": scale, "norm": BoundaryNorm(edges, scale.N)}, levels
    low, low_quantile, high_quantile, high = (
        np.quantile(finite, (0.0, 0.005, 0.995, 1.0)) if finite.size else (0.0, 0.0, 1.0, 1.0)
    )
    if high - low > FAR * (high_quantile - low_quantile) > 0.0:
        low, high = low_quantile, high_quantile
    return {"cmap": SHADES, "vmin": low, "vmax": high}, None


def _exceeded_ends(values: Values, norm: Any) -> str:
    """Return at which ends of a scale values lie outside of it."""
    sizes = values.astype(float)  # whole numbers know no infinity
    minimum, maximum = np.nanmin(sizes, initial=np.inf), np.nanmax(sizes, initial=-np.inf)
    return {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[
        bool(minimum < norm.vmin), bool(maximum > norm.vmax)
    ]


def _frame_regions(axes: Axes, outcomes: Values, across: Values, up: Values) -> None:
    """Frame the regions where runs ended badly, or otherwise than most."""
    endings, counts = np.unique(outcomes, return_counts=True)
    order = sorted(
        zip(endings.tolist(), counts.tolist(), strict=True),
        key=lambda entry: (entry[0].split()[0] not in GOOD, -entry[1]),
    )
    colours = [COLOURS[1], COLOURS[2], COLOURS[3]]
    handles = []
    for (word, _), colour in zip(order[1:4], colours, strict=False):
        has_outcome = (outcomes == word).astype(float)
        if min(has_outcome.shape) > 1 and 0.0 < has_outcome.mean() < 1.0:
            axes.contour(across, up, has_outcome, levels=[0.5], colors=[colour], linewidths=1.4)
            handles.append(axes.plot([], [], color=colour, label=escaped_text(word.replace("_", " ")))[0])
    if handles:
        axes.legend(handles=handles, fontsize=7, framealpha=0.85, edgecolor="none", loc="upper right")
