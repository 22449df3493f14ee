"""Figures of sweeps: which numbers have panels, and how members ended.

What is written on figures of sweeps: numbers with their units, and the settings of a part.

Numbers of a sweep over random draws, and over words.

Numbers of a sweep over one axis: lines, and occurrences as points.

A number of a sweep over two axes: a map with lines of equal value and the regions of outcomes.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.evidence.grid_axes import AXIS, END_TIME, member_number_names, sweep_axis_names, vanishing
from xdynamics.faults import first_names
from xdynamics.figures.curves import thinned_rows
from xdynamics.figures.marks import COLOURS, at_time, escaped_text, label_time, label_with_unit, typeset
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.transients import Transient, without_transient
from xdynamics.march.outcomes import GOOD
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


def number_label(sweep: xr.Dataset, name: str) -> str:
    """Name a number with its unit."""
    units = str(sweep[name].attrs["units"])
    return escaped_text(label_with_unit(name, units))


def value_suffix(sweep: xr.Dataset, name: str) -> str:
    """Return what stands behind a value: its unit, typeset."""
    return unit_suffix(typeset(str(sweep[name].attrs["units"])))


def other_settings_note(part: xr.Dataset, shown_axes: list[str]) -> str:
    """Name the values of the other axes for a part of a sweep."""
    settings: list[str] = []
    for name, coordinate in part.coords.items():
        if AXIS in coordinate.attrs and not coordinate.dims and str(name) not in shown_axes:
            value, units = coordinate.values, str(coordinate.attrs["units"])
            text = short_number(float(value)) if coordinate.dtype.kind in "fi" else str(value)
            settings.append(
                text if coordinate.dtype.kind not in "fi" else f"{name} = {text}{'' if units == '1' else f' {units}'}"
            )
    return f", {', '.join(settings)}" if settings else ""


QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
BANDS = ("#dbe6f3", "#a9c4e2")


def draw_random_members(sweep: xr.Dataset, name: str, dim: str, axes: Axes) -> None:
    """Draw random members: bands of quantiles over times, otherwise a histogram."""
    number = sweep[name].stack(members=[str(axis) for axis in sweep[OUTCOME].dims])
    if AT in number.dims and sweep.sizes[AT] > 1:
        times, values = sweep[AT_TIME].values, number.transpose(AT, "members").values
        low, lower, middle, upper, high = np.nanquantile(values, QUANTILES, axis=1)
        axes.fill_between(times, low, high, color=BANDS[0], label="95 %")
        axes.fill_between(times, lower, upper, color=BANDS[1], label="50 %")
        axes.plot(times, middle, color=COLOURS[0], linewidth=1.2, label="median")
        label_time(axes, sweep[AT_TIME])
        axes.set(ylabel=number_label(sweep, name))
        axes.legend(fontsize=7, frameon=False)
    else:
        values = number.values.astype(float).ravel()
        finite = values[np.isfinite(values)]
        axes.hist(
            finite, bins=min(60, max(5, int(np.sqrt(finite.size)))), color=BANDS[1], edgecolor="white", linewidth=0.4
        )
        low, _, middle, _, high = np.quantile(finite, QUANTILES).tolist() if finite.size else [np.nan] * 5
        axes.axvline(middle, color=COLOURS[0], linewidth=1.0, label="median")
        axes.axvline(low, color=COLOURS[0], linewidth=1.0, linestyle="--", label="95 % between")
        axes.axvline(high, color=COLOURS[0], linewidth=1.0, linestyle="--")
        axes.set_axisbelow(True)
        if finite.size:
            axes.legend(fontsize=7, frameon=False)
        axes.set(xlabel=number_label(sweep, name), ylabel="members")
    drawn_names = ", ".join(str(key) for key, variable in sweep.variables.items() if variable.attrs.get(AXIS) == dim)
    axes.set_title(escaped_text(f"{name}, {sweep.sizes[dim]} draws of {drawn_names}"), loc="left", fontsize=10)


def draw_word_members(sweep: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw a number of each word."""
    number = sweep[name].stack(members=[str(axis) for axis in sweep[OUTCOME].dims])
    while number.ndim > 1:
        number = number.isel({next(dim for dim in number.dims if dim != "members"): 0})
    labels = [
        " ".join(map(str, member_key if isinstance(member_key, tuple) else (member_key,)))
        for member_key in number["members"].values.tolist()
    ]
    axes.plot(number.values.astype(float), np.arange(len(labels)), "o", color=COLOURS[0], markersize=4)
    axes.set_yticks(np.arange(len(labels)), [escaped_text(label) for label in labels], fontsize=7)
    axes.invert_yaxis()
    axes.set(xlabel=number_label(sweep, name))
    axes.set_title(escaped_text(name), loc="left", fontsize=10)


Values = NDArray[Any]

MOST_LINES = 8
BAD = "#c8452f"
DASHES = ("-", "--", ":", "-.")
LINE: Any = {"linewidth": 1.2, "markersize": 4}
LARGE = 20_000  # members from which on points are small
FEW_POINTS = 3000  # up to which points of a diagram are large


def draw_elements_over_axis(sweep: xr.Dataset, names: list[str], dim: str, axes: Axes) -> None:
    """Draw the elements of a quantity over one axis, all on one scale."""
    drawn_names = [names[k] for k in np.unique(np.linspace(0, len(names) - 1, min(len(names), MOST_LINES)).astype(int))]
    x, quantity = sweep[dim].values.astype(float), split_element_name(names[0])[0]
    for k, name in enumerate(drawn_names):
        axes.plot(
            x,
            sweep[name].values.astype(float),
            marker="" if len(x) > 40 else ".",
            linestyle=DASHES[k // len(COLOURS) % len(DASHES)],
            color=COLOURS[k % len(COLOURS)],
            label=escaped_text(name),
            **LINE,
        )
        _mark_bad(axes, sweep, name, x)
    axes.set(
        xlabel=number_label(sweep, dim),
        ylabel=escaped_text(label_with_unit(quantity, str(sweep[names[0]].attrs["units"]))),
    )
    axes.ticklabel_format(axis="y", useOffset=False)
    left_out = f", {len(drawn_names)} of {len(names)} elements" if len(drawn_names) < len(names) else ""
    axes.set_title(escaped_text(f"{quantity}{left_out}"), loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def draw_over_axis(sweep: xr.Dataset, name: str, dim: str, axes: Axes) -> None:
    """Draw a number over one axis, a line for each word; of occurrences points, one below the other."""
    other_dims = [other_dim for other_dim in sweep[OUTCOME].dims if other_dim != dim]
    x = sweep[dim].values.astype(float)
    combinations = list(product(*(range(sweep.sizes[other_dim]) for other_dim in other_dims)))
    choices, times = combinations[:MOST_LINES], sweep[name].sizes.get(AT, 1)
    omitted = f", {MOST_LINES} of {len(combinations)} lines" if len(combinations) > MOST_LINES else ""
    omitted += f", {MOST_LINES} of {times} times" if times > MOST_LINES else ""
    for k, indices in enumerate(choices):
        part = sweep.isel(dict(zip(other_dims, indices, strict=True)))
        number, label = part[name], other_settings_note(part, [dim]).removeprefix(", ")
        colour, dashes = COLOURS[k % len(COLOURS)], DASHES[k % len(DASHES)]
        if OCCURRENCE in number.dims:
            _draw_occurrences(axes, x, number.transpose(dim, OCCURRENCE).values, colour, label)
        elif AT in number.dims:
            _draw_lines_at_times(axes, x, number, sweep[AT_TIME], dashes, label)
        else:
            values = number.values.astype(float)
            rows = thinned_rows(values)
            axes.plot(
                x[rows],
                values[rows],
                marker="" if len(x) > 40 else ".",
                linestyle=dashes,
                color=colour,
                label=label,
                **LINE,
            )
        _mark_bad(axes, part, name, x)
    axes.set(xlabel=number_label(sweep, dim), ylabel=number_label(sweep, name))
    if OCCURRENCE in sweep[name].dims and not name.startswith(EVENT_TIME):
        first = int(sweep[NUMBER][0])
        title = f"bifurcation diagram: {name}{f' after the first {first - 1}' if first > 1 else ''}"
    else:
        title = name
    axes.set_title(escaped_text(f"{title}{omitted}"), loc="left", fontsize=10)
    if axes.get_legend_handles_labels()[1] and (len(choices) > 1 or AT in sweep[name].dims):
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _draw_occurrences(axes: Axes, x: Values, values: Values, colour: str, label: str) -> None:
    """Draw every occurrence of an event as a point, those of a member one above the other."""
    axes.plot(
        np.repeat(x, values.shape[1]),
        values.ravel(),
        ".",
        color=colour,
        markersize=0.9 if values.size > LARGE else 2.0 if values.size > FEW_POINTS else 3.5,
        markeredgewidth=0,
        alpha=0.8,
        label=label,
        rasterized=True,
    )


def _draw_lines_at_times(
    axes: Axes, x: Values, number: xr.DataArray, times: xr.DataArray, dashes: Any, label: str
) -> None:
    """Draw a number at several times, a line for each."""
    time_indices = np.unique(np.linspace(0, number.sizes[AT] - 1, min(MOST_LINES, number.sizes[AT])).astype(int))
    for j, i in enumerate(time_indices.tolist()):
        axes.plot(
            x,
            number.isel({AT: i}).values,
            color=COLOURS[j % len(COLOURS)],
            linestyle=dashes,
            linewidth=1.1,
            label=f"{at_time(times, float(times[i]), 4)} {label}".strip(),
        )


def _mark_bad(axes: Axes, part: xr.Dataset, name: str, x: Values) -> None:
    """Mark members that ended badly, below the lines."""
    bad = ~np.isin(part[OUTCOME].values.astype(str), [*GOOD])
    if bad.any():
        low = float(np.nanmin(np.asarray(part[name], dtype=float)))
        axes.plot(x[bad], np.full(int(bad.sum()), low), "x", color=BAD, markersize=4, label="ended badly")


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


def panels_of(sweep: xr.Dataset, transient: Transient | None = None) -> list[Panel]:
    """Return the panels of a sweep: one for each recorded quantity, and for maps one for each value of a setting in words."""
    if transient is not None:
        sweep = without_transient(sweep, transient)
    wide = _number_axes(sweep)
    noise = vanishing(sweep)
    names = _panel_numbers(sweep, noise)
    # where there is nothing else, noise is drawn as the zero that it is
    sweep = sweep.assign({name: sweep[name].where(sweep[name].isnull(), 0.0) for name in names if name in noise})
    if len(wide) >= 2 and all(dim in sweep.coords for dim in wide[:2]):
        groups = _quantity_groups(sweep, names, sweep[OUTCOME].dims)
        return [
            partial(draw_over_two_axes, sweep, group[0], part, wide[:2])
            if len(group) == 1
            else partial(draw_elements_over_axes, sweep, group, part, wide[:2])
            for part in _parts_by_other_axes(sweep, wide[:2])
            for group in groups
        ]
    if len(wide) == 1 and wide[0] in sweep.coords:
        return [
            partial(draw_over_axis, sweep, group[0], wide[0])
            if len(group) == 1
            else partial(draw_elements_over_axis, sweep, group, wide[0])
            for group in _quantity_groups(sweep, names, (wide[0],))
        ]
    if wide:
        return [partial(draw_random_members, sweep, name, wide[0]) for name in names]
    return [partial(draw_word_members, sweep, name) for name in names]


def foot_of(sweep: xr.Dataset) -> str:
    """Report how members ended."""
    outcomes, counts = np.unique(end_descriptions(sweep).values.astype(str), return_counts=True)
    summary = ", ".join(f"{count} {word}" for word, count in zip(outcomes, counts, strict=True))
    uncontrolled = int(np.count_nonzero(sweep[UNCONTROLLED].values))
    noise = first_names(vanishing(sweep))
    zero = f"; zero to rounding: {noise}" if noise else ""
    note = f"; of {uncontrolled} absolute tolerances may have let pass 3 % of a variable" if uncontrolled else ""
    return f"{sweep[OUTCOME].size} runs: {summary}{note}; {settings_text(sweep)}{zero}"


def _number_axes(sweep: xr.Dataset) -> list[str]:
    """Name the axes of numbers, those that are drawn or vary together last."""
    axes = [dim for dim in sweep_axis_names(sweep) if dim in sweep.dims]
    of_words = [dim for dim in axes if dim in sweep.coords and sweep[dim].dtype.kind not in "fi"]
    wide = [dim for dim in axes if dim not in of_words and sweep.sizes[dim] > 1]
    return sorted(wide, key=lambda dim: (dim not in sweep.coords, axes.index(dim)))


def _panel_numbers(sweep: xr.Dataset, noise: Sequence[str]) -> list[str]:
    """Name the numbers worth a panel, those that vary by more than rounding; final values come last."""
    names = [name for name in member_number_names(sweep) if not name.endswith("_time")] or [END_TIME]
    varying_names = [name for name in names if name not in noise and _varies(np.asarray(sweep[name]))]
    leading_names = [name for name in varying_names if not name.startswith("end_")]
    return [*leading_names, *(name for name in varying_names if name not in leading_names)] or names


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


def _varies(values: Values) -> bool:
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    return bool(finite.size and finite.max() > finite.min())


def _parts_by_other_axes(sweep: xr.Dataset, shown_axes: list[str]) -> Iterator[dict[str, int]]:
    """Yield the part of the sweep for each combination of the axes that are not shown."""
    other_dims = [dim for dim in sweep[OUTCOME].dims if dim not in shown_axes]
    for indices in product(*(range(sweep.sizes[dim]) for dim in other_dims)):
        yield {str(dim): k for dim, k in zip(other_dims, indices, strict=True)}


PAGE = Page(("sweep",), panels_of, foot_of, most_panels=8, height=3.6, single_height=7.0)
