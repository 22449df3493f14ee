"""Numbers of a sweep over random draws, and over words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from xdynamics.evidence.grid_axes import AXIS
from xdynamics.figures.marks import COLOURS, escaped_text, label_time
from xdynamics.figures.sweep_labels import number_label
from xdynamics.schema import AT, AT_TIME
from xdynamics.sweeping.kept_quantities import OUTCOME

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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
