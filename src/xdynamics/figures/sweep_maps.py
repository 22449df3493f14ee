"""A number of a sweep over two axes: a map with lines of equal value and the regions of outcomes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.marks import COLOURS, in_unit, words
from xdynamics.figures.sweep_labels import labelled, other_axes, unit_of
from xdynamics.march.outcomes import GOOD
from xdynamics.schema import AT, OCCURRENCE
from xdynamics.shapes import parted
from xdynamics.sweeping.members import ended
from xdynamics.sweeping.sweep_summary import known_number
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


def over_two(whole: xr.Dataset, name: str, part: Mapping[str, int], shown: list[str], axes: Axes) -> None:
    """Draw a number over two axes, and frame the runs that ended otherwise than most."""
    sweep = whole.isel(part)
    values = _values(sweep, name, shown)
    x, y = shown
    across, up = sweep[x].values.astype(float), sweep[y].values.astype(float)
    shades, ticks = _shades(values)
    mesh = _mesh(sweep, values, shown, shades, axes)
    _explain(mesh, values, ticks, labelled(sweep, name), axes)
    best = _relief(axes, across, up, values)
    marked = [
        f"{word} {mark} {known_number(sweep, name, value)}{unit_of(sweep, name)} at {x} {known_to(*at[0])}{unit_of(sweep, x)},"
        f" {y} {known_to(*at[1])}{unit_of(sweep, y)}"
        for word, mark, value, at in best
    ]
    axes.set_title("\n".join(map(words, (f"{name}{other_axes(sweep, shown)}", *marked))), loc="left", fontsize=10)


def elements_over_two(
    whole: xr.Dataset, names: list[str], part: Mapping[str, int], shown: list[str], axes: Axes
) -> None:
    """Draw the elements of a quantity over two axes in the place of some axes: side by side, on one scale of colours."""
    sweep, picked = whole.isel(part), np.linspace(0, len(names) - 1, min(len(names), MOST_MAPS)).round().astype(int)
    chosen, quantity = [names[k] for k in picked], parted(names[0])[0]
    values = np.stack([_values(sweep, name, shown) for name in chosen])
    shades, ticks = _shades(values)
    place: Any = axes.get_subplotspec()
    figure: Any = axes.figure
    axes.remove()
    columns = -(-len(chosen) // 2) if len(chosen) > 2 else len(chosen)
    grid = place.subgridspec(-(-len(chosen) // columns), columns)
    parts: list[Any] = [figure.add_subplot(grid[k // columns, k % columns]) for k in range(len(chosen))]
    for k, (name, each) in enumerate(zip(chosen, parts, strict=True)):
        mesh = _mesh(sweep, values[k], shown, shades, each)
        each.set_title(words(name), fontsize=8)
        each.tick_params(labelsize=7)
        each.set(
            xlabel="" if k + columns < len(chosen) else each.get_xlabel(),
            ylabel="" if k % columns else each.get_ylabel(),
        )
    unit = str(sweep[names[0]].attrs["units"])
    _explain(mesh, values, ticks, words(in_unit(quantity, unit)), parts[-1])
    left_out = f", {len(chosen)} of {len(names)} elements" if len(chosen) < len(names) else ""
    parts[0].set_title(words(f"{quantity}{other_axes(sweep, shown)}{left_out}") + "\n", loc="left", fontsize=10)


def _values(sweep: xr.Dataset, name: str, shown: list[str]) -> Values:
    """Return a number over two axes, shape (up, across): at the last time, or of the first occurrence."""
    number, (x, y) = sweep[name], shown
    for dim in (AT, OCCURRENCE):
        number = number.isel({dim: -1 if dim == AT else 0}) if dim in number.dims else number
    found: Values = number.transpose(y, x).values
    return found


def _mesh(sweep: xr.Dataset, values: Values, shown: list[str], shades: dict[str, Any], axes: Axes) -> Any:
    """Draw values as colours over two axes, and the regions of outcomes."""
    x, y = shown
    across, up = sweep[x].values.astype(float), sweep[y].values.astype(float)
    masked = np.ma.masked_invalid(values.astype(float))
    mesh = axes.pcolormesh(across, up, masked, shading="nearest", rasterized=True, **shades)
    _regions(axes, ended(sweep).transpose(y, x).values.astype(str), across, up)
    axes.set(xlabel=labelled(sweep, x), ylabel=labelled(sweep, y))
    if sweep[x].attrs["units"] == sweep[y].attrs["units"] != "1" and 0.5 < np.ptp(across) / np.ptp(up) < 2.0:
        axes.set_aspect("equal", anchor="W")
    axes.grid(visible=False)
    return mesh


def _explain(mesh: Any, values: Values, ticks: Any, label: str, axes: Axes) -> None:
    """Explain colours by a bar at the right edge of their axes."""
    colour_bar(mesh, label, axes, ticks=ticks, extend=_beyond(values, mesh.norm))


def colour_bar(mesh: Any, label: str, axes: Axes, **how: Any) -> None:
    """Draw a bar of a map's colours at the right edge of its axes; `how` as matplotlib's `colorbar` has it."""
    figure: Any = axes.figure
    bar = figure.colorbar(mesh, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)), **how)
    bar.set_label(label, fontsize=8)
    bar.ax.tick_params(labelsize=7)


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
