"""Figures of sweeps: maps over two parameters with the regions of outcomes, lines over one, bands of random draws."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.curves import thinned
from xdynamics.figures.marks import COLOURS, at_time, in_unit, label_time, typeset, words
from xdynamics.figures.sheet import Page, Panel
from xdynamics.figures.transients import Transient, without
from xdynamics.figures.vanishing import END_TIME, vanishing
from xdynamics.march.outcomes import GOOD
from xdynamics.schema import AT, AT_TIME, OCCURRENCE
from xdynamics.shapes import parted
from xdynamics.sweeping.collection import AXIS, NUMBER, axes_said, settings_said
from xdynamics.sweeping.ensemble_analysis import numbers
from xdynamics.sweeping.kept_quantities import EVENT_TIME
from xdynamics.sweeping.members import OUTCOME, UNCONTROLLED, ended
from xdynamics.sweeping.sweep_summary import known_number
from xdynamics.units import unit_suffix
from xdynamics.units.digits import known_to, short_number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Values = NDArray[Any]

MOST_LINES = 8
SHADES = "cividis"
CONTOURS = 7  # lines of equal value on a smooth map
ROUGH = 0.05  # of the spread, that a smooth map bends by from one member to the next on the mean
FEWEST_SIDE = 6  # members along each side of such a map
FAR = 3.0  # times the span of nearly all values, from which on a few do not set the colours
FEW = 12  # whole numbers up to which each has a colour of its own
QUANTILES = (0.025, 0.25, 0.5, 0.75, 0.975)
BANDS = ("#dbe6f3", "#a9c4e2")
BAD = "#c8452f"
DASHES = ("-", "--", ":", "-.")
LINE: Any = {"linewidth": 1.2, "markersize": 4}
LARGE = 20_000  # members from which on points are small
FEW_POINTS = 3000  # up to which points of a diagram are large


def panels_of(sweep: xr.Dataset, transient: Transient | None = None) -> list[Panel]:
    """Return the panels of a sweep: one for each recorded number, and for maps one for each value of a setting in words."""
    if transient is not None:
        sweep = without(sweep, transient)
    wide = _axes(sweep)
    noise = vanishing(sweep)
    names = _names(sweep, noise)
    # where there is nothing else, noise is drawn as the zero that it is
    sweep = sweep.assign({name: sweep[name].where(sweep[name].isnull(), 0.0) for name in names if name in noise})
    if len(wide) >= 2 and all(dim in sweep.coords for dim in wide[:2]):
        return [partial(_map, sweep, name, part, wide[:2]) for name, part in _parts(sweep, names, wide[:2])]
    if len(wide) == 1 and wide[0] in sweep.coords:
        return [
            partial(_line, sweep, group[0], wide[0]) if len(group) == 1 else partial(_elements, sweep, group, wide[0])
            for group in _groups(sweep, names, wide[0])
        ]
    if wide:
        return [partial(_drawn, sweep, name, wide[0]) for name in names]
    return [partial(_words, sweep, name) for name in names]


def foot_of(sweep: xr.Dataset) -> str:
    """Report how members ended."""
    outcomes, counts = np.unique(ended(sweep).values.astype(str), return_counts=True)
    summary = ", ".join(f"{count} {word}" for word, count in zip(outcomes, counts, strict=True))
    uncontrolled = int(np.count_nonzero(sweep[UNCONTROLLED].values))
    noise = ", ".join(vanishing(sweep))
    zero = f"; zero to rounding: {noise}" if noise else ""
    note = f"; of {uncontrolled} absolute tolerances may have let pass 3 % of a variable" if uncontrolled else ""
    return f"{sweep[OUTCOME].size} runs: {summary}{note}; {settings_said(sweep)}{zero}"


def _axes(sweep: xr.Dataset) -> list[str]:
    """Name the axes of numbers, those that are drawn or vary together last."""
    axes = [dim for dim in axes_said(sweep) if dim in sweep.dims]
    of_words = [dim for dim in axes if dim in sweep.coords and sweep[dim].dtype.kind not in "fi"]
    wide = [dim for dim in axes if dim not in of_words and sweep.sizes[dim] > 1]
    return sorted(wide, key=lambda dim: (dim not in sweep.coords, axes.index(dim)))


def _names(sweep: xr.Dataset, noise: Sequence[str]) -> list[str]:
    """Name the numbers worth a panel, those that vary by more than rounding; final values come last."""
    names = [name for name in numbers(sweep) if not name.endswith("_time")] or [END_TIME]
    telling = [name for name in names if name not in noise and _varies(np.asarray(sweep[name]))]
    leading = [name for name in telling if not name.startswith("end_")]
    return [*leading, *(name for name in telling if name not in leading)] or names


def _groups(sweep: xr.Dataset, names: list[str], dim: str) -> list[list[str]]:
    """Group all elements of a quantity that has one value for each member along one axis; all else stands alone."""
    groups: dict[str, list[str]] = {}
    for name in names:
        whole, labels = parted(name)
        groups.setdefault(whole if labels and sweep[name].dims == (dim,) else name, []).append(name)
    # beside elements that vary, those that do not show by how little
    every = [name for name in numbers(sweep) if not name.endswith("_time")]
    return [
        [each for each in every if parted(each)[0] == whole] if whole not in group else group
        for whole, group in groups.items()
    ]


def _elements(sweep: xr.Dataset, names: list[str], dim: str, axes: Axes) -> None:
    """Draw the elements of a quantity over one axis, all on one scale."""
    shown = [names[k] for k in np.unique(np.linspace(0, len(names) - 1, min(len(names), MOST_LINES)).astype(int))]
    x, whole = sweep[dim].values.astype(float), parted(names[0])[0]
    for k, name in enumerate(shown):
        axes.plot(
            x,
            sweep[name].values.astype(float),
            marker="" if len(x) > 40 else ".",
            linestyle=DASHES[k // len(COLOURS) % len(DASHES)],
            color=COLOURS[k % len(COLOURS)],
            label=words(name),
            **LINE,
        )
        _mark_bad(axes, sweep, name, x)
    axes.set(xlabel=_labelled(sweep, dim), ylabel=words(in_unit(whole, str(sweep[names[0]].attrs["units"]))))
    axes.ticklabel_format(axis="y", useOffset=False)
    left_out = f", {len(shown)} of {len(names)} elements" if len(shown) < len(names) else ""
    axes.set_title(words(f"{whole}{left_out}"), loc="left", fontsize=10)
    axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _varies(values: Values) -> bool:
    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    return bool(finite.size and finite.max() > finite.min())


def _parts(sweep: xr.Dataset, names: list[str], shown: list[str]) -> Iterator[tuple[str, dict[str, int]]]:
    """Yield the number and the part of the sweep for each panel: every number for every combination of the other axes."""
    others = [dim for dim in sweep[OUTCOME].dims if dim not in shown]
    for indices in product(*(range(sweep.sizes[dim]) for dim in others)):
        for name in names:
            yield name, {str(dim): k for dim, k in zip(others, indices, strict=True)}


def _map(whole: xr.Dataset, name: str, part: Mapping[str, int], shown: list[str], axes: Axes) -> None:
    """Draw a number over two axes, and frame the runs that ended otherwise than most."""
    sweep = whole.isel(part)
    number = sweep[name]
    for dim in (AT, OCCURRENCE):
        number = number.isel({dim: -1 if dim == AT else 0}) if dim in number.dims else number
    x, y = shown
    values = number.transpose(y, x).values
    across, up = sweep[x].values.astype(float), sweep[y].values.astype(float)
    shades, ticks = _shades(values)
    mesh = axes.pcolormesh(
        across, up, np.ma.masked_invalid(values.astype(float)), shading="nearest", rasterized=True, **shades
    )
    bar = axes.figure.colorbar(
        mesh, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), ticks=ticks, extend=_beyond(values, mesh.norm)
    )
    bar.set_label(_labelled(sweep, name), fontsize=8)
    bar.ax.tick_params(labelsize=7)
    _regions(axes, ended(sweep).transpose(y, x).values.astype(str), across, up)
    best = _relief(axes, across, up, values)
    axes.set(xlabel=_labelled(sweep, x), ylabel=_labelled(sweep, y))
    if sweep[x].attrs["units"] == sweep[y].attrs["units"] != "1" and 0.5 < np.ptp(across) / np.ptp(up) < 2.0:
        axes.set_aspect("equal", anchor="W")
    marked = [
        f"{word} {mark} {known_number(sweep, name, value)}{_unit(sweep, name)} at {x} {known_to(*at[0])}{_unit(sweep, x)},"
        f" {y} {known_to(*at[1])}{_unit(sweep, y)}"
        for word, mark, value, at in best
    ]
    axes.set_title("\n".join(map(words, (f"{name}{_other_axes(sweep, shown)}", *marked))), loc="left", fontsize=10)
    axes.grid(visible=False)


def _relief(
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
    found = []
    for word, mark, marker, place in (
        ("greatest", "\u25b2", "^", values.argmax()),
        ("least", "\u25bc", "v", values.argmin()),
    ):
        row, column = np.unravel_index(int(place), values.shape)
        if 0 < row < values.shape[0] - 1 and 0 < column < values.shape[1] - 1:
            axes.plot(across[column], up[row], marker, color="white", markeredgecolor="black", markersize=7)
            at = tuple(
                (float(axis[k]), float(np.ptp(axis[k - 1 : k + 2])) / 4.0) for axis, k in ((across, column), (up, row))
            )
            found.append((word, mark, float(values[row, column]), at))
    return found


def _shades(values: Values) -> tuple[dict[str, Any], Any]:
    """Return a colour scale: one colour for each of a few whole numbers, else from dark to light, outliers disregarded."""
    from matplotlib import colormaps
    from matplotlib.colors import BoundaryNorm

    finite = values[np.isfinite(values)] if values.dtype.kind == "f" else values.ravel()
    levels = np.unique(finite)
    if finite.size and len(levels) <= FEW and (levels == np.round(levels)).all():
        edges = np.arange(levels.min() - 0.5, levels.max() + 1.0)
        scale = colormaps[SHADES].resampled(max(2, len(edges) - 1))
        return {"cmap": scale, "norm": BoundaryNorm(edges, scale.N)}, levels
    low, inner, outer, high = np.quantile(finite, (0.0, 0.005, 0.995, 1.0)) if finite.size else (0.0, 0.0, 1.0, 1.0)
    if high - low > FAR * (outer - inner) > 0.0:
        low, high = inner, outer
    return {"cmap": SHADES, "vmin": low, "vmax": high}, None


def _beyond(values: Values, norm: Any) -> str:
    """Return at which ends of a scale values lie outside of it."""
    sizes = values.astype(float)  # whole numbers know no infinity
    least, most = np.nanmin(sizes, initial=np.inf), np.nanmax(sizes, initial=-np.inf)
    return {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[
        bool(least < norm.vmin), bool(most > norm.vmax)
    ]


def _regions(axes: Axes, outcomes: Values, across: Values, up: Values) -> None:
    """Frame the regions where runs ended badly, or otherwise than most."""
    endings, counts = np.unique(outcomes, return_counts=True)
    order = sorted(
        zip(endings.tolist(), counts.tolist(), strict=True),
        key=lambda entry: (entry[0].split()[0] not in GOOD, -entry[1]),
    )
    colours = [COLOURS[1], COLOURS[2], COLOURS[3]]
    handles = []
    for (word, _), colour in zip(order[1:4], colours, strict=False):
        inside = (outcomes == word).astype(float)
        if min(inside.shape) > 1 and 0.0 < inside.mean() < 1.0:
            axes.contour(across, up, inside, levels=[0.5], colors=[colour], linewidths=1.4)
            handles.append(axes.plot([], [], color=colour, label=words(word.replace("_", " ")))[0])
    if handles:
        axes.legend(handles=handles, fontsize=7, framealpha=0.85, edgecolor="none", loc="upper right")


def _line(sweep: xr.Dataset, name: str, dim: str, axes: Axes) -> None:
    """Draw a number over one axis, a line for each word; of occurrences points, one below the other."""
    others = [other for other in sweep[OUTCOME].dims if other != dim]
    x = sweep[dim].values.astype(float)
    combinations = list(product(*(range(sweep.sizes[other]) for other in others)))
    choices, times = combinations[:MOST_LINES], sweep[name].sizes.get(AT, 1)
    omitted = f", {MOST_LINES} of {len(combinations)} lines" if len(combinations) > MOST_LINES else ""
    omitted += f", {MOST_LINES} of {times} times" if times > MOST_LINES else ""
    for k, indices in enumerate(choices):
        part = sweep.isel(dict(zip(others, indices, strict=True)))
        number, label = part[name], _other_axes(part, [dim]).removeprefix(", ")
        colour, dashes = COLOURS[k % len(COLOURS)], DASHES[k % len(DASHES)]
        if OCCURRENCE in number.dims:
            _occurrences(axes, x, number.transpose(dim, OCCURRENCE).values, colour, label)
        elif AT in number.dims:
            _times(axes, x, number, sweep[AT_TIME], dashes, label)
        else:
            values = number.values.astype(float)
            rows = thinned(values)
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
    axes.set(xlabel=_labelled(sweep, dim), ylabel=_labelled(sweep, name))
    if OCCURRENCE in sweep[name].dims and not name.startswith(EVENT_TIME):
        first = int(sweep[NUMBER][0])
        title = f"bifurcation diagram: {name}{f' after the first {first - 1}' if first > 1 else ''}"
    else:
        title = name
    axes.set_title(words(f"{title}{omitted}"), loc="left", fontsize=10)
    if axes.get_legend_handles_labels()[1] and (len(choices) > 1 or AT in sweep[name].dims):
        axes.legend(fontsize=7, framealpha=0.85, edgecolor="none")


def _occurrences(axes: Axes, x: Values, values: Values, colour: str, label: str) -> None:
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


def _times(axes: Axes, x: Values, number: xr.DataArray, times: xr.DataArray, dashes: Any, label: str) -> None:
    """Draw a number at several times, a line for each."""
    chosen = np.unique(np.linspace(0, number.sizes[AT] - 1, min(MOST_LINES, number.sizes[AT])).astype(int))
    for j, i in enumerate(chosen.tolist()):
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


def _drawn(sweep: xr.Dataset, name: str, dim: str, axes: Axes) -> None:
    """Draw random members: bands of quantiles over times, otherwise a histogram."""
    number = sweep[name].stack(members=[str(each) for each in sweep[OUTCOME].dims])
    if AT in number.dims and sweep.sizes[AT] > 1:
        times, values = sweep[AT_TIME].values, number.transpose(AT, "members").values
        low, lower, middle, upper, high = np.nanquantile(values, QUANTILES, axis=1)
        axes.fill_between(times, low, high, color=BANDS[0], label="95 %")
        axes.fill_between(times, lower, upper, color=BANDS[1], label="50 %")
        axes.plot(times, middle, color=COLOURS[0], linewidth=1.2, label="median")
        label_time(axes, sweep[AT_TIME])
        axes.set(ylabel=_labelled(sweep, name))
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
        axes.set(xlabel=_labelled(sweep, name), ylabel="members")
    drawn = ", ".join(str(key) for key, each in sweep.variables.items() if each.attrs.get(AXIS) == dim)
    axes.set_title(words(f"{name}, {sweep.sizes[dim]} draws of {drawn}"), loc="left", fontsize=10)


def _words(sweep: xr.Dataset, name: str, axes: Axes) -> None:
    """Draw a number of each word."""
    number = sweep[name].stack(members=[str(axis) for axis in sweep[OUTCOME].dims])
    while number.ndim > 1:
        number = number.isel({next(dim for dim in number.dims if dim != "members"): 0})
    labels = [" ".join(map(str, at if isinstance(at, tuple) else (at,))) for at in number["members"].values.tolist()]
    axes.plot(number.values.astype(float), np.arange(len(labels)), "o", color=COLOURS[0], markersize=4)
    axes.set_yticks(np.arange(len(labels)), [words(label) for label in labels], fontsize=7)
    axes.invert_yaxis()
    axes.set(xlabel=_labelled(sweep, name))
    axes.set_title(words(name), loc="left", fontsize=10)


def _labelled(sweep: xr.Dataset, name: str) -> str:
    units = str(sweep[name].attrs["units"])
    return words(in_unit(name, units))


def _unit(sweep: xr.Dataset, name: str) -> str:
    return unit_suffix(typeset(str(sweep[name].attrs["units"])))


def _other_axes(part: xr.Dataset, shown: list[str]) -> str:
    """Name the values of the other axes for a part of a sweep."""
    settings: list[str] = []
    for name, coordinate in part.coords.items():
        if AXIS in coordinate.attrs and not coordinate.dims and str(name) not in shown:
            value, units = coordinate.values, str(coordinate.attrs["units"])
            text = short_number(float(value)) if coordinate.dtype.kind in "fi" else str(value)
            settings.append(
                text if coordinate.dtype.kind not in "fi" else f"{name} = {text}{'' if units == '1' else f' {units}'}"
            )
    return f", {', '.join(settings)}" if settings else ""


PAGE = Page(("sweep",), panels_of, foot_of, most_panels=8, height=3.6, alone=7.0)
