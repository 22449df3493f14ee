"""Numbers of a sweep over one axis: lines, and occurrences as points."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.curves import thinned_rows
from xdynamics.figures.marks import COLOURS, at_time, escaped_text, label_with_unit
from xdynamics.figures.sweep_labels import number_label, other_settings_note
from xdynamics.march.outcomes import GOOD
from xdynamics.schema import AT, AT_TIME, OCCURRENCE
from xdynamics.shapes import split_element_name
from xdynamics.sweeping.collection import NUMBER
from xdynamics.sweeping.kept_quantities import EVENT_TIME, OUTCOME

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
