"""Figures of a sweep's whole runs together: how its members move, as lines, as bands where they are many."""

from __future__ import annotations

import warnings
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.marks import COLOURS, escaped_text, label_time, label_with_unit
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT, AT_TIME

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_LINES = 24  # of members, spread over all
FEWEST = 20  # members of whom a band tells more than their lines
QUANTILES = (0.025, 0.5, 0.975)
BAND = "#dbe6f3"


def panels_of(logs: xr.Dataset) -> list[Panel]:
    """Return the panel of each coordinate, velocity and state."""
    return [partial(_draw_members, logs, name) for name in _series_names(logs)]


def foot_of(logs: xr.Dataset) -> str:
    """Count the members and say what is drawn of them."""
    names = _series_names(logs)
    size = _member_rows(logs, names[0]).shape[0] if names else 0
    lines = f"{size} members, a line each" if size <= MOST_LINES else f"{size} members, {MOST_LINES} of them as lines"
    band = "; shaded: 95 % of those that are not over at a time; dark: their median" if size >= FEWEST else ""
    return f"{lines}{band}"


def _series_names(logs: xr.Dataset) -> list[str]:
    return [str(name) for name, variable in logs.data_vars.items() if AT in variable.dims and len(variable.dims) > 1]


def _member_rows(logs: xr.Dataset, name: str) -> NDArray[np.float64]:
    """Return a row of values at all times for each member that was marched."""
    rows = logs[name].transpose(..., AT).values.reshape(-1, logs.sizes[AT])
    return np.asarray(rows[np.isfinite(rows).any(axis=1)], dtype=float)


def _draw_members(logs: xr.Dataset, name: str, axes: Axes) -> None:
    times, rows = logs[AT_TIME].values, _member_rows(logs, name)
    drawn_members = np.unique(np.linspace(0, max(len(rows) - 1, 0), min(len(rows), MOST_LINES)).astype(int))
    if len(rows) >= FEWEST:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # times at which every member is over
            low, middle, high = np.nanquantile(rows, QUANTILES, axis=0)
        axes.fill_between(times, low, high, color=BAND, linewidth=0.0)
        axes.plot(times, middle, color=COLOURS[0], linewidth=1.6, zorder=3)
    for row in rows[drawn_members]:
        axes.plot(times, row, color=COLOURS[0], linewidth=0.5, alpha=0.35 if len(rows) >= FEWEST else 0.9)
    units = str(logs[name].attrs["units"])
    label_time(axes, logs[AT_TIME])
    axes.set(ylabel=escaped_text(label_with_unit(name, units)))
    axes.set_title(escaped_text(name), loc="left", fontsize=10)


PAGE = Page(("logs of a sweep",), panels_of, foot_of, most_panels=6)
