"""Numbers over the axes of a grid of members: rows of members, lines over one axis, maps over two, more as small multiples.

Sweeps, sweeps compared with each other or methods within one, and error budgets of every member.

Whole runs of a sweep together: lines, and bands where they are many.
"""

from __future__ import annotations

import warnings
from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.budgeting.budget import KIND, TOTALS
from xdynamics.evidence.comparing.grids import DIFFERS, UNKNOWN, WITHIN
from xdynamics.evidence.grid_axes import AXIS, END_TIME, member_number_names, sweep_axis_names, vanishing
from xdynamics.faults import first_names
from xdynamics.figures.curves import thinned_rows
from xdynamics.figures.line_panels import wrapped_angles, wrapped_names
from xdynamics.figures.marks import (
    COLOURS,
    at_time,
    draw_line,
    escaped_text,
    evenly_spaced,
    label_panel,
    label_time,
    label_with_unit,
    subpanels,
    typeset,
)
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.transients import Transient, without_transient
from xdynamics.march.outcomes import GOOD
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import AT, AT_TIME, OCCURRENCE
from xdynamics.shapes import split_element_name
from xdynamics.sweeping.collection import NUMBER, settings_text
from xdynamics.sweeping.kept_quantities import EVENT_TIME, OUTCOME, UNCONTROLLED
from xdynamics.sweeping.members import end_descriptions
from xdynamics.sweeping.sweep_summary import significant_number
from xdynamics.units import unit_suffix
from xdynamics.units.digits import known_to, short_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = NDArray[Any]
Indices = Mapping[Hashable, int]

MOST_LINES = 8
MOST_MAPS = 4  # of elements in one panel
MANY_POINTS = 40  # of a line, from where on it has no dots
SHADES, SIGNED_SHADES = "cividis", "RdBu_r"
BAD = "#c8452f"
DASHES = ("-", "--", ":", "-.")
KEY: Any = {"fontsize": 7, "framealpha": 0.85, "edgecolor": "none"}  # a legend over lines or a map


def number_axes(grid: xr.Dataset) -> tuple[list[str], list[str]]:
    """Name the axes of several numbers that are drawn, two at most, and those along which draws vary together."""
    dims = [dim for dim in sweep_axis_names(grid) if grid.sizes.get(dim, 1) > 1 and dim != grid.attrs.get("varied")]
    of_numbers = [dim for dim in dims if dim in grid.coords and grid[dim].dtype.kind in "fi"]
    return of_numbers[:2], [dim for dim in dims if dim not in grid.coords]


def parts_along(grid: xr.Dataset, dims: Iterable[Hashable]) -> list[Indices]:
    """Return each combination of places along some axes."""
    names = [*dims]
    return [dict(zip(names, indices, strict=True)) for indices in product(*(range(grid.sizes[dim]) for dim in names))]


def number_label(grid: xr.Dataset, name: str) -> tuple[str, str]:
    """Return a number with its unit, for the label of an axis."""
    return name, str(grid[name].attrs["units"])


def value_suffix(sweep: xr.Dataset, name: str) -> str:
    """Return what stands behind a value: its unit, typeset."""
    return unit_suffix(typeset(str(sweep[name].attrs["units"])))


def settings_note(part: xr.Dataset, shown_axes: Sequence[str] = ()) -> str:
    """Name the values that a part of a grid has of axes that are not shown."""
    settings: list[str] = []
    for name, coordinate in part.coords.items():
        if AXIS in coordinate.attrs and not coordinate.dims and str(name) not in shown_axes:
            value, units = coordinate.values, str(coordinate.attrs["units"])
            is_number = coordinate.dtype.kind in "fi"
            unit = "" if units == "1" else f" {units}"
            settings.append(f"{name} = {short_number(float(value))}{unit}" if is_number else str(value))
    return ", ".join(settings)


def _with_settings(name: str, part: xr.Dataset, shown_axes: Sequence[str]) -> str:
    """Return a title with the values of axes that are not shown."""
    return ", ".join(filter(None, (name, settings_note(part, shown_axes))))


def _draw_rows(axes: Axes, labels: Sequence[str], values: Values, doubts: Values | None, x: tuple[str, str]) -> None:
    """Draw a number of each member as a row, with the bar of its uncertainty."""
    rows = np.arange(len(labels))
    axes.errorbar(values, rows, xerr=doubts, fmt="o", color=COLOURS[0], markersize=4, capsize=2.0)
    axes.set_yticks(rows, [escaped_text(label) for label in labels], fontsize=7)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    label_panel(axes, x=x)


def _member_labels(stacked: xr.Dataset | xr.DataArray) -> list[str]:
    """Name members by their words."""
    keys = stacked["members"].values.tolist()
    return [" ".join(map(str, key if isinstance(key, tuple) else (key,))) for key in keys]


def _draw_mesh(grid: xr.Dataset, values: Values, shown_axes: Sequence[str], axes: Axes, **shades: Any) -> Any:
    """Draw values, shape (up, across), as colours over two axes; both have one scale if they are alike."""
    x, y = shown_axes
    across, up = (grid[dim].values.astype(float) for dim in shown_axes)
    mesh = axes.pcolormesh(
        across, up, np.ma.masked_invalid(values.astype(float)), shading="nearest", rasterized=True, **shades
    )
    label_panel(axes, x=number_label(grid, x), y=number_label(grid, y))
    if grid[x].attrs["units"] == grid[y].attrs["units"] != "1" and 0.5 < np.ptp(across) / np.ptp(up) < 2.0:
        axes.set_aspect("equal", anchor="W")
    axes.grid(visible=False)
    return mesh


def _draw_outline(grid: xr.Dataset, is_inside: Values, shown_axes: Sequence[str], axes: Axes, **style: Any) -> bool:
    """Draw the border of a region of a map, shape (up, across); return whether there is one."""
    is_part = min(is_inside.shape) > 1 and 0.0 < is_inside.mean() < 1.0
    if is_part:
        axes.contour(*(grid[dim].values.astype(float) for dim in shown_axes), is_inside.astype(float), [0.5], **style)
    return bool(is_part)


def _draw_map_bar(mesh: Any, label: str, axes: Axes, **bar_options: Any) -> None:
    """Draw a bar of a map's colours at the right edge of its axes; `bar_options` as matplotlib's `colorbar` has it."""
    figure: Any = axes.figure
    bar = figure.colorbar(mesh, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), **bar_options)
    bar.set_label(escaped_text(label), fontsize=8)
    bar.ax.tick_params(labelsize=7)


QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
BANDS = ("#dbe6f3", "#a9c4e2")
LARGE = 20_000  # members from which on points are small
FEW_POINTS = 3000  # up to which points of a diagram are large


def panels_of(sweep: xr.Dataset, transient: Transient | None = None) -> list[Panel]:
    """Return the panels of a sweep: one for each recorded quantity, and for maps one for each value of a setting in words."""
    if transient is not None:
        sweep = without_transient(sweep, transient)
    shown_axes, draws = number_axes(sweep)
    noise = vanishing(sweep)
    names = _panel_numbers(sweep, noise)
    # where there is nothing else, noise is drawn as the zero that it is
    sweep = sweep.assign({name: sweep[name].where(sweep[name].isnull(), 0.0) for name in names if name in noise})
    if len(shown_axes) == 2:
        groups = _quantity_groups(sweep, names, sweep[OUTCOME].dims)
        parts = parts_along(sweep, [dim for dim in sweep[OUTCOME].dims if dim not in shown_axes])
        return [partial(_draw_maps, sweep, group, part, shown_axes) for part in parts for group in groups]
    if draws:
        return [partial(_draw_random_members, sweep, name, draws[0]) for name in names]
    if shown_axes:
        return [
            partial(_draw_over_axis, sweep, group, shown_axes[0])
            for group in _quantity_groups(sweep, names, shown_axes)
        ]
    return [partial(_draw_word_members, sweep, name) for name in names]


def foot_of(sweep: xr.Dataset) -> str:
    """Report how members ended."""
    outcomes, counts = np.unique(end_descriptions(sweep).values.astype(str), return_counts=True)
    summary = ", ".join(f"{count} {word}" for word, count in zip(outcomes, counts, strict=True))
    uncontrolled = int(np.count_nonzero(sweep[UNCONTROLLED].values))
    noise = first_names(vanishing(sweep))
    zero = f"; zero to rounding: {noise}" if noise else ""
    note = f"; of {uncontrolled} absolute tolerances may have let pass 3 % of a variable" if uncontrolled else ""
    return f"{sweep[OUTCOME].size} runs: {summary}{note}; {settings_text(sweep)}{zero}"


def _panel_numbers(sweep: xr.Dataset, noise: Sequence[str]) -> list[str]:
    """Name the numbers worth a panel, those that vary by more than rounding; final values come last."""
    names = [name for name in member_number_names(sweep) if not name.endswith("_time")] or [END_TIME]
    varying_names = [name for name in names if name not in noise and _varies(np.asarray(sweep[name]))]
    return sorted(varying_names, key=lambda name: name.startswith("end_")) or names


def _varies(values: Values) -> bool:
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    return bool(finite.size and finite.max() > finite.min())


def _quantity_groups(sweep: xr.Dataset, names: list[str], dims: Sequence[Hashable]) -> list[list[str]]:
    """Group all elements of a quantity that has one value for each member along some axes; all else stands alone."""
    groups: dict[str, list[str]] = {}
    for name in names:
        quantity, labels = split_element_name(name)
        groups.setdefault(quantity if labels and {*sweep[name].dims} == {*dims} else name, []).append(name)
    # beside elements that vary, those that do not show by how little
    all_numbers = [name for name in member_number_names(sweep) if not name.endswith("_time")]
    return [
        [element_name for element_name in all_numbers if split_element_name(element_name)[0] == quantity]
        if quantity not in group
        else group
        for quantity, group in groups.items()
    ]


def _draw_word_members(sweep: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw a number of each word: the first of several."""
    number = sweep[name].stack(members=[str(axis) for axis in sweep[OUTCOME].dims])
    number = number.isel({dim: 0 for dim in number.dims if dim != "members"})
    _draw_rows(axes, _member_labels(number), number.values.astype(float), None, number_label(sweep, name))
    label_panel(axes, name)


def _draw_random_members(sweep: xr.Dataset, name: str, dim: str, axes: Axes) -> None:
    """Draw random members: bands of quantiles over times, otherwise a histogram."""
    number = sweep[name].stack(members=[str(axis) for axis in sweep[OUTCOME].dims])
    drawn_names = ", ".join(str(key) for key, variable in sweep.variables.items() if variable.attrs.get(AXIS) == dim)
    label_panel(axes, f"{name}, {sweep.sizes[dim]} draws of {drawn_names}")
    if AT in number.dims and sweep.sizes[AT] > 1:
        times, values = sweep[AT_TIME].values, number.transpose(AT, "members").values
        low, lower, middle, upper, high = np.nanquantile(values, QUANTILES, axis=1)
        axes.fill_between(times, low, high, color=BANDS[0], label="95 %")
        axes.fill_between(times, lower, upper, color=BANDS[1], label="50 %")
        draw_line(axes, times, middle, label="median", width=1.2)
        label_time(axes, sweep[AT_TIME])
        label_panel(axes, y=number_label(sweep, name))
        axes.legend(fontsize=7, frameon=False)
        return
    values = number.values.astype(float).ravel()
    finite = values[np.isfinite(values)]
    bins = min(60, max(5, int(np.sqrt(finite.size))))
    axes.hist(finite, bins=bins, color=BANDS[1], edgecolor="white", linewidth=0.4)
    low, _, middle, _, high = np.quantile(finite, QUANTILES).tolist() if finite.size else [np.nan] * 5
    axes.axvline(middle, color=COLOURS[0], linewidth=1.0, label="median")
    axes.axvline(low, color=COLOURS[0], linewidth=1.0, linestyle="--", label="95 % between")
    axes.axvline(high, color=COLOURS[0], linewidth=1.0, linestyle="--")
    axes.set_axisbelow(True)
    if finite.size:
        axes.legend(fontsize=7, frameon=False)
    label_panel(axes, x=number_label(sweep, name), y="members")


def _draw_over_axis(sweep: xr.Dataset, names: list[str], dim: str, axes: Axes) -> None:
    """Draw a number over one axis, a line for each element, or word and time; of occurrences points, one below the other."""
    x, name, are_elements = sweep[dim].values.astype(float), names[0], len(names) > 1
    if are_elements:
        title, lines = split_element_name(name)[0], [(element, sweep, element) for element in names]
        lines = [lines[k] for k in evenly_spaced(len(names), MOST_LINES)]
        omitted = f", {len(lines)} of {len(names)} elements" if len(lines) < len(names) else ""
        axes.ticklabel_format(axis="y", useOffset=False)
    else:
        combinations = parts_along(sweep, [other for other in sweep[OUTCOME].dims if other != dim])
        parts, times = [sweep.isel(indices) for indices in combinations[:MOST_LINES]], sweep[name].sizes.get(AT, 1)
        title, lines = _diagram_title(sweep, name), [(settings_note(part, [dim]), part, name) for part in parts]
        omitted = f", {MOST_LINES} of {len(combinations)} lines" if len(combinations) > MOST_LINES else ""
        omitted += f", {MOST_LINES} of {times} times" if times > MOST_LINES else ""
    for k, (label, part, line_name) in enumerate(lines):
        _draw_member_line(part, line_name, x, axes, k, DASHES[(k // len(COLOURS) if are_elements else k) % 4], label)
        _mark_bad(axes, part, line_name, x)
    label_panel(
        axes,
        f"{title}{omitted}",
        x=number_label(sweep, dim),
        y=(title if are_elements else name, number_label(sweep, name)[1]),
    )
    if axes.get_legend_handles_labels()[1] and (len(lines) > 1 or AT in sweep[name].dims):
        axes.legend(**KEY)


def _diagram_title(sweep: xr.Dataset, name: str) -> str:
    """Return the title of a number over one axis."""
    if OCCURRENCE not in sweep[name].dims or name.startswith(EVENT_TIME):
        return name
    first = int(sweep[NUMBER][0])
    return f"bifurcation diagram: {name}{f' after the first {first - 1}' if first > 1 else ''}"


def _draw_member_line(part: xr.Dataset, name: str, x: Values, axes: Axes, k: int, dashes: str, label: str) -> None:
    """Draw the k-th line of a number, which at several times is a line for each, and of occurrences points."""
    number = part[name]
    if OCCURRENCE in number.dims:
        values = number.transpose(..., OCCURRENCE).values
        if any(name.endswith(f"_{angle}") for angle in wrapped_names(part)):
            values = wrapped_angles(values, str(number.attrs["units"]))
        size = 0.9 if values.size > LARGE else 2.0 if values.size > FEW_POINTS else 3.5
        style = {"markeredgewidth": 0, "alpha": 0.8, "rasterized": True}
        draw_line(axes, np.repeat(x, values.shape[1]), values.ravel(), ".", k, label, size=size, **style)
    elif AT in number.dims:
        times = part[AT_TIME]
        for j, i in enumerate(evenly_spaced(number.sizes[AT], MOST_LINES)):
            time_label = f"{at_time(times, float(times[i]), 4)} {label}".strip()
            draw_line(axes, x, number.isel({AT: i}).values, dashes, j, time_label, 1.1)
    else:
        rows = thinned_rows(values := number.values.astype(float))
        marker = "" if len(x) > MANY_POINTS else "."
        draw_line(axes, x[rows], values[rows], dashes, k, label, 1.2, marker=marker)


def _mark_bad(axes: Axes, part: xr.Dataset, name: str, x: Values) -> None:
    """Mark members that ended badly, below the lines."""
    bad = ~np.isin(part[OUTCOME].values.astype(str), [*GOOD])
    if bad.any():
        low = float(np.nanmin(np.asarray(part[name], dtype=float)))
        draw_line(axes, x[bad], np.full(int(bad.sum()), low), "x", BAD, "ended badly")


CONTOURS = 7  # lines of equal value on a smooth map
ROUGH = 0.05  # of the spread, that a smooth map bends by from one member to the next on the mean
FEWEST_SIDE = 6  # members along each side of such a map
FAR = 3.0  # times the span of nearly all values, from which on a few do not set the colours
FEW = 12  # whole numbers up to which each has a colour of its own


def _draw_maps(full_sweep: xr.Dataset, names: list[str], part: Indices, shown_axes: Sequence[str], axes: Axes) -> None:
    """Draw a number over two axes, with what is greatest and least; elements of a quantity side by side, on one scale.

    The runs that ended otherwise than most are framed.
    """
    sweep = full_sweep.isel(part)
    drawn_names = [names[k] for k in evenly_spaced(len(names), MOST_MAPS)]
    values = np.stack([_map_values(sweep, name, shown_axes) for name in drawn_names])
    shades, ticks = _colour_scale(values)
    columns = -(-len(drawn_names) // 2) if len(drawn_names) > 2 else len(drawn_names)
    maps = subpanels(axes, len(drawn_names), columns) if len(names) > 1 else [axes]
    for k, (name, map_axes) in enumerate(zip(drawn_names, maps, strict=True)):
        mesh = _draw_mesh(sweep, values[k], shown_axes, map_axes, **shades)
        _frame_regions(sweep, shown_axes, map_axes)
        if len(names) > 1:
            map_axes.set_title(escaped_text(name), fontsize=8)
            map_axes.tick_params(labelsize=7)
            map_axes.set_xlabel("" if k + columns < len(drawn_names) else map_axes.get_xlabel())
            map_axes.set_ylabel("" if k % columns else map_axes.get_ylabel())
    quantity, unit = names[0] if len(names) == 1 else split_element_name(names[0])[0], number_label(sweep, names[0])[1]
    bar_ends = _exceeded_ends(values[-1 if len(names) == 1 else slice(None)], mesh.norm)
    _draw_map_bar(mesh, label_with_unit(quantity, unit), maps[-1], ticks=ticks, extend=bar_ends)
    title = _with_settings(quantity, sweep, shown_axes)
    if len(names) == 1:
        label_panel(axes, title, *_draw_relief(sweep, names[0], values[0], shown_axes, axes))
    else:
        left_out = f", {len(drawn_names)} of {len(names)} elements" if len(drawn_names) < len(names) else ""
        label_panel(maps[0], f"{title}{left_out}", "")


def _map_values(sweep: xr.Dataset, name: str, shown_axes: Sequence[str]) -> Values:
    """Return a number over two axes, shape (up, across): at the last time, or of the first occurrence."""
    number, (x, y) = sweep[name], shown_axes
    number = number.isel({dim: place for dim, place in ((AT, -1), (OCCURRENCE, 0)) if dim in number.dims})
    map_values: Values = number.transpose(y, x).values
    return map_values


def _draw_relief(sweep: xr.Dataset, name: str, values: Values, shown_axes: Sequence[str], axes: Axes) -> list[str]:
    """Draw lines of equal value on a smooth map, and mark the greatest and the least value that are inside of it.

    Returns
    -------
    list of str
        What the title says of each mark: its value, and where it is, with the half of a spacing that the grid leaves open.
    """
    if values.dtype.kind != "f" or min(values.shape) < FEWEST_SIDE or not np.isfinite(values).all():
        return []
    spread, of_most = float(np.ptp(values)), float(np.ptp(np.quantile(values, (0.05, 0.95))))
    bend = max(np.abs(np.diff(values, 2, axis=axis)).mean() for axis in (0, 1))
    # beside a few members that are far off any noise looks smooth
    if not spread > 0.0 or bend > min(ROUGH * spread, of_most) or len(np.unique(values)) <= FEW:
        return []
    across, up = (sweep[dim].values.astype(float) for dim in shown_axes)
    lines = axes.contour(across, up, values, levels=CONTOURS, colors="white", linewidths=0.6, alpha=0.8)
    axes.clabel(lines, fontsize=6, fmt="%.4g")
    notes = []
    for words, marker, flat_index in (
        ("greatest \u25b2", "^", values.argmax()),
        ("least \u25bc", "v", values.argmin()),
    ):
        row, column = np.unravel_index(int(flat_index), values.shape)
        if 0 < row < values.shape[0] - 1 and 0 < column < values.shape[1] - 1:
            axes.plot(across[column], up[row], marker, color="white", markeredgecolor="black", markersize=7)
            places = [
                f"{dim} {known_to(float(axis[k]), float(np.ptp(axis[k - 1 : k + 2])) / 4.0)}{value_suffix(sweep, dim)}"
                for dim, axis, k in zip(shown_axes, (across, up), (column, row), strict=True)
            ]
            value = significant_number(sweep, name, float(values[row, column]))
            notes.append(f"{words} {value}{value_suffix(sweep, name)} at {', '.join(places)}")
    return notes


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
    return (("neither", "max"), ("min", "both"))[bool(minimum < norm.vmin)][bool(maximum > norm.vmax)]


def _frame_regions(sweep: xr.Dataset, shown_axes: Sequence[str], axes: Axes) -> None:
    """Frame the regions where runs ended badly, or otherwise than most."""
    outcomes = end_descriptions(sweep).transpose(*reversed(shown_axes)).values.astype(str)
    endings, counts = np.unique(outcomes, return_counts=True)
    order = sorted(
        zip(endings.tolist(), counts.tolist(), strict=True),
        key=lambda entry: (entry[0].split()[0] not in GOOD, -entry[1]),
    )
    handles = []
    for (word, _), colour in zip(order[1:4], COLOURS[1:], strict=False):
        if _draw_outline(sweep, outcomes == word, shown_axes, axes, colors=[colour], linewidths=1.4):
            handles.append(draw_line(axes, [], [], "-", colour, word.replace("_", " "), 1.5))
    if handles:
        axes.legend(handles=handles, loc="upper right", **KEY)


MOST_MEMBERS = 24  # whose lines are drawn, spread over all
FEWEST = 20  # members of whom a band tells more than their lines


def log_panels(logs: xr.Dataset) -> list[Panel]:
    """Return the panel of each coordinate, velocity and state of whole runs: how the members of a sweep move."""
    return [partial(_draw_member_runs, logs, name) for name in _series_names(logs)]


def log_foot(logs: xr.Dataset) -> str:
    """Count the members and say what is drawn of them."""
    names = _series_names(logs)
    size = _member_rows(logs, names[0]).shape[0] if names else 0
    lines = (
        f"{size} members, a line each" if size <= MOST_MEMBERS else f"{size} members, {MOST_MEMBERS} of them as lines"
    )
    band = "; shaded: 95 % of those that are not over at a time; dark: their median" if size >= FEWEST else ""
    return f"{lines}{band}"


def _series_names(logs: xr.Dataset) -> list[str]:
    return [str(name) for name, variable in logs.data_vars.items() if AT in variable.dims and len(variable.dims) > 1]


def _member_rows(logs: xr.Dataset, name: str) -> NDArray[np.float64]:
    """Return a row of values at all times for each member that was marched."""
    rows = logs[name].transpose(..., AT).values.reshape(-1, logs.sizes[AT])
    return np.asarray(rows[np.isfinite(rows).any(axis=1)], dtype=float)


def _draw_member_runs(logs: xr.Dataset, name: str, axes: Axes) -> None:
    times, rows = logs[AT_TIME].values, _member_rows(logs, name)
    if len(rows) >= FEWEST:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # times at which every member is over
            low, middle, high = np.nanquantile(rows, QUANTILES[::2], axis=0)
        axes.fill_between(times, low, high, color=BANDS[0], linewidth=0.0)
        draw_line(axes, times, middle, width=1.6, zorder=3)
    for row in evenly_spaced(len(rows), MOST_MEMBERS):
        draw_line(axes, times, rows[row], width=0.5, alpha=0.35 if len(rows) >= FEWEST else 0.9)
    label_time(axes, logs[AT_TIME])
    label_panel(axes, name, y=number_label(logs, name))


HEAD = "difference_"
MOST_RATIO = 30.0  # times their uncertainty, from which on differences have one colour


def difference_panels(differences: xr.Dataset) -> list[Panel]:
    """Return a panel for each number that differs anywhere, and each value of further axes; see `_differing_names`."""
    names = [str(name).removeprefix(HEAD) for name in differences.data_vars if str(name).startswith(HEAD)]
    shown_axes = number_axes(differences)[0]
    draw = (_draw_member_differences, _draw_difference_lines, _draw_difference_map)[len(shown_axes)]
    return [
        partial(draw, _number_at_place(differences, name, indices), name, shown_axes)
        for name in _differing_names(differences, names)
        for indices in (_compared_parts(differences, name, shown_axes) if len(shown_axes) == 2 else [{}])
    ]


def difference_foot(differences: xr.Dataset) -> str:
    """Say what is drawn, and how many members differ."""
    verdicts = [differences[name].values for name in differences.data_vars if str(name).startswith("verdict_")]
    differing_count, unknown_count = (
        int(sum((values == word).sum() for values in verdicts)) for word in (DIFFERS, UNKNOWN)
    )
    cause = f"; {cause}" if (cause := str(differences.attrs.get("cause", ""))) else ""
    reference = (
        f"minus {differences.attrs['reference']}" if "reference" in differences.attrs else "second sweep minus first"
    )
    untold = f", of {unknown_count} nothing tells their uncertainty" if unknown_count else ""
    return f"{reference}: {differing_count} numbers differ by more than their uncertainty{untold}{cause}"


def _differing_names(differences: xr.Dataset, names: list[str]) -> list[str]:
    """Name the numbers that differ in a member or may; where there is none, those that are not equal; else all."""
    differing = [name for name in names if bool((differences[f"verdict_{name}"] != WITHIN).any())]
    return differing or [name for name in names if np.nan_to_num(differences[f"{HEAD}{name}"].values).any()] or names


def _compared_parts(differences: xr.Dataset, name: str, shown_axes: Sequence[str]) -> list[Indices]:
    """Return the places along all other axes, but those where a member is compared with itself."""
    dims = [dim for dim in differences[f"{HEAD}{name}"].dims if dim not in (*shown_axes, AT, OCCURRENCE)]
    varied, reference = str(differences.attrs.get("varied", "")), differences.attrs.get("reference")
    return [
        part
        for part in parts_along(differences, dims)
        if varied not in part or str(differences[varied].values[part[varied]]) != reference
    ]


def _number_at_place(differences: xr.Dataset, name: str, indices: Indices) -> xr.Dataset:
    """Return a number at the last of some times, or of the first occurrence, and at places of further axes."""
    part = differences[[f"{HEAD}{name}", f"uncertainty_{name}", f"verdict_{name}"]].isel(indices)
    return part.isel({dim: index for dim, index in ((AT, -1), (OCCURRENCE, 0)) if dim in part.dims})


def _draw_difference_map(part: xr.Dataset, name: str, shown_axes: list[str], axes: Axes) -> None:
    """Draw differences over two axes: in units of their uncertainty, with a line where they are as large; else as they are."""
    part = part.transpose(*shown_axes)
    difference, doubt = (part[f"{kind}{name}"].values.astype(float) for kind in (HEAD, "uncertainty_"))
    is_known = bool(np.isfinite(doubt).any() and (doubt > 0.0).any())
    with np.errstate(divide="ignore", invalid="ignore"):
        values = np.where(difference == 0.0, 0.0, difference / doubt) if is_known else difference
    sizes = np.abs(values[np.isfinite(values)])
    top = min(MOST_RATIO, max(2.0, float(sizes.max(initial=0.0)))) if is_known else float(sizes.max(initial=0.0)) or 1.0
    x_and_y, differs = shown_axes[::-1], part[f"verdict_{name}"].values == DIFFERS
    mesh = _draw_mesh(part, np.clip(values, -top, top), x_and_y, axes, cmap=SIGNED_SHADES, vmin=-top, vmax=top)
    _draw_outline(part, differs, x_and_y, axes, colors="black", linewidths=1.0)
    label = "difference / uncertainty" if is_known else label_with_unit(*_difference_label(part, name))
    _draw_map_bar(mesh, label, axes, extend="both" if sizes.max(initial=0.0) > top else "neither")
    share = f"{int(differs.sum())} of {differs.size} differ" if is_known else "uncertainty unknown"
    label_panel(axes, _with_settings(name, part, shown_axes), share)


def _draw_difference_lines(part: xr.Dataset, name: str, shown_axes: list[str], axes: Axes) -> None:
    """Draw differences over one axis, a line for each place along the others, with what they are uncertain by as bars."""
    x, is_few = part[shown_axes[0]].values.astype(float), part.sizes[shown_axes[0]] <= 1.5 * MANY_POINTS
    places = _compared_parts(part, name, shown_axes)
    for k, indices in enumerate(places[:MOST_LINES]):
        line = part.isel(indices)
        values = line[f"{HEAD}{name}"].values.astype(float)
        axes.errorbar(
            x,
            values,
            np.nan_to_num(line[f"uncertainty_{name}"].values.astype(float)),
            marker="." if is_few else "",
            color=COLOURS[k % len(COLOURS)],
            linewidth=1.0,
            elinewidth=0.7,
            capsize=2.0 * is_few,
            label=escaped_text(settings_note(line, shown_axes)),
        )
        differs = line[f"verdict_{name}"].values == DIFFERS
        draw_line(axes, x[differs], values[differs], "o", BAD, size=7, markerfacecolor="none")
    axes.axhline(0.0, color="0.5", linewidth=0.8)
    omitted_note = f", {MOST_LINES} of {len(places)} lines" if len(places) > MOST_LINES else ""
    label_panel(
        axes,
        f"{name}{omitted_note}{_verdict_counts(part, name)}",
        x=number_label(part, shown_axes[0]),
        y=_difference_label(part, name),
    )
    if len(places) > 1:
        axes.legend(**KEY)


def _draw_member_differences(part: xr.Dataset, name: str, shown_axes: list[str], axes: Axes) -> None:
    """Draw the difference of each member, along axes of words alone, with its bar."""
    members = [part.isel(indices) for indices in _compared_parts(part, name, shown_axes)]
    values, doubts = (
        np.array([float(member[f"{kind}{name}"]) for member in members]) for kind in (HEAD, "uncertainty_")
    )
    _draw_rows(axes, [*map(settings_note, members)], values, np.nan_to_num(doubts), _difference_label(part, name))
    axes.axvline(0.0, color="0.5", linewidth=0.8)
    label_panel(axes, f"{name}{_verdict_counts(part, name)}")


def _difference_label(part: xr.Dataset, name: str) -> tuple[str, str]:
    return "difference", str(part[f"{HEAD}{name}"].attrs["units"])


def _verdict_counts(part: xr.Dataset, name: str) -> str:
    """Say how many differ by more than their uncertainty."""
    verdicts = part[f"verdict_{name}"].values
    return f": {int((verdicts == DIFFERS).sum())} of {verdicts.size} differ"


MOST_TERMS = 8
COVERED = 2.0  # standard uncertainties, of the band


def budget_panels(budgets: xr.Dataset) -> list[Panel]:
    """Return over one axis the number in its band and all terms; over two, maps of the number and its uncertainties.

    Further axes are drawn at their first value.
    """
    shown_axes = number_axes(budgets)[0]
    if not shown_axes:
        return [partial(_draw_member_budgets, budgets)]
    dims = [dim for dim in sweep_axis_names(budgets) if dim in budgets.dims and dim not in shown_axes]
    part = budgets.isel(dict.fromkeys(dims, 0))
    if len(shown_axes) == 2:
        return [partial(_draw_budget_map, part, name, shown_axes) for name in ("value", *TOTALS)]
    return [partial(_draw_value_band, part, shown_axes[0]), partial(_draw_terms_over_axis, part, shown_axes[0])]


def budget_foot(budgets: xr.Dataset) -> str:
    """Describe what is drawn."""
    is_band = len(number_axes(budgets)[0]) == 1
    band = f"; band: {COVERED:g} standard uncertainties, dark: the numerical part" if is_band else ""
    return f"{budgets['value'].size} budgets{band}"


def _draw_value_band(budgets: xr.Dataset, dim: str, axes: Axes) -> None:
    """Draw the number over an axis, within its total and its numerical uncertainty."""
    x, value = budgets[dim].values.astype(float), budgets["value"].values
    for name, shade, label in (("total_rss", 0.2, "total"), ("numerical_rss", 0.6, "numerical")):
        size = COVERED * budgets[name].values
        axes.fill_between(x, value - size, value + size, color=COLOURS[0], alpha=shade, linewidth=0, label=label)
    draw_line(axes, x, value, ".-" if len(x) <= 1.5 * MANY_POINTS else "-")
    title = _with_settings(str(budgets.attrs["of"]), budgets, [dim])
    label_panel(axes, title, x=number_label(budgets, dim), y=number_label(budgets, "value"))
    axes.legend(fontsize=8, frameon=False)


def _draw_terms_over_axis(budgets: xr.Dataset, dim: str, axes: Axes) -> None:
    """Draw the standard uncertainty of every term over an axis, on a logarithmic scale; the largest have names."""
    x, sizes = budgets[dim].values.astype(float), budgets["standard_uncertainty"].transpose("term", dim).values
    order = np.argsort(-np.nanmax(np.where(np.isfinite(sizes), sizes, 0.0), axis=1), kind="stable")
    names, kinds = budgets["term_name"].values.astype(str), words_of_flag(budgets["term_kind"])
    for rank, term in enumerate(order.tolist()):
        is_positive = (sizes[term] > 0.0) & np.isfinite(sizes[term])
        if is_positive.any():
            colour, label = (rank, names[term]) if rank < MOST_TERMS else ("0.8", "")
            dashes = "--" if kinds[term] == "numerical" else "-"
            draw_line(axes, x[is_positive], sizes[term][is_positive], dashes, colour, label, 1.1)
    if axes.lines:
        axes.set_yscale("log")
        axes.legend(fontsize=8, frameon=False)
    y = ("standard uncertainty", number_label(budgets, "value")[1])
    label_panel(axes, "terms; dashed: numerical", x=number_label(budgets, dim), y=y)


def _draw_budget_map(budgets: xr.Dataset, name: str, shown_axes: list[str], axes: Axes) -> None:
    """Draw the number, or one of its uncertainties, over two axes."""
    mesh = _draw_mesh(budgets, budgets[name].transpose(*shown_axes).values, shown_axes[::-1], axes, cmap=SHADES)
    _draw_map_bar(mesh, label_with_unit("", number_label(budgets, "value")[1]).strip(), axes)
    title = str(budgets.attrs["of"]) if name == "value" else f"{name.removesuffix('_rss')} standard uncertainty"
    label_panel(axes, _with_settings(title, budgets, shown_axes))


def _draw_member_budgets(budgets: xr.Dataset, axes: Axes) -> None:
    """Draw the number of each member, along axes of words alone."""
    member_dims = [dim for dim in sweep_axis_names(budgets) if dim in budgets.dims]
    stacked = budgets[["value", *TOTALS]].stack(members=member_dims) if member_dims else budgets.expand_dims("members")
    doubts = COVERED * stacked["total_rss"].values
    _draw_rows(axes, _member_labels(stacked), stacked["value"].values, doubts, number_label(budgets, "value"))
    label_panel(axes, str(budgets.attrs["of"]))


PAGE = Page(("sweep",), panels_of, foot_of, most_panels=8, height=3.6, single_height=7.0)
PAGES = (
    PAGE,
    Page(("logs of a sweep",), log_panels, log_foot, most_panels=6),
    Page(("sweep comparison", "contrast"), difference_panels, difference_foot, 8, height=3.6, single_height=7.0),
    Page((KIND,), budget_panels, budget_foot, most_panels=4, height=3.6),
)
