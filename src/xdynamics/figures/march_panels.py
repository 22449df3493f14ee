"""Panels about the march itself: steps, errors, how well events were located."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.figures.companions import Overlay
from xdynamics.figures.curves import thinned_rows
from xdynamics.figures.line_panels import set_run_time_axis
from xdynamics.figures.marks import COLOURS, escaped_text, label_time, time_axis_label

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PARTS = {"event_time_uncertainty_bracket": "width of the bracket", "event_time_uncertainty": "uncertainty"}


def draw_steps(run: xr.Dataset, overlay: Overlay, axes: Axes) -> None:
    """Draw the steps on a logarithmic scale; an event's second row has none."""
    size, time = run.variables["step_size"].values, run.variables["time"].values
    rows = _positive_rows(size)
    axes.plot(
        time[rows],
        size[rows],
        ".",
        color=COLOURS[5],
        markersize=2.5,
        label=escaped_text(overlay.run_label or "accepted"),
    )
    _draw_companion_points(overlay, "step_size", axes)
    attributes = run.variables["trial_reason"].attrs
    reasons = np.array(attributes["flag_meanings"].split()) if attributes["role"] == "flag" else np.zeros(0, "U")
    error_test_codes = np.atleast_1d(attributes["flag_values"])[reasons == "error_test"] if reasons.size else reasons
    rejected = np.flatnonzero(np.isin(run.variables["trial_reason"].values, error_test_codes))
    if len(rejected):
        rejected = rejected[thinned_rows(run.variables["trial_step_size"].values[rejected])]
        axes.plot(
            run.variables["trial_time"].values[rejected],
            run.variables["trial_step_size"].values[rejected],
            "x",
            color=COLOURS[1],
            markersize=3.5,
            markeredgewidth=0.8,
            label="rejected by the error test",
        )
    if len(rejected) or overlay.run_label:
        axes.legend(fontsize=8, frameon=False)
    if len(rows):
        axes.set_yscale("log")
    label_time(axes, run["time"])
    axes.set(ylabel=time_axis_label(run["step_size"], "step size"))
    set_run_time_axis(run, axes)
    axes.set_title("step used to reach each state", loc="left", fontsize=10)


def draw_errors(run: xr.Dataset, overlay: Overlay, axes: Axes) -> None:
    """Draw the error norm of every accepted step; 1 is what the tolerances allow."""
    norm, time = run.variables["error_norm"].values, run.variables["time"].values
    rows = _positive_rows(norm)
    axes.plot(time[rows], norm[rows], ".", color=COLOURS[2], markersize=2.5, label=escaped_text(overlay.run_label))
    if _draw_companion_points(overlay, "error_norm", axes):
        axes.legend(fontsize=8, frameon=False)
    axes.axhline(1.0, color="#777777", linewidth=0.8, linestyle="--")
    if len(rows):
        axes.set_yscale("log")
    label_time(axes, run["time"])
    axes.set(ylabel="scaled local error (1)")
    set_run_time_axis(run, axes)
    axes.set_title("local error over what the tolerances allow", loc="left", fontsize=10)


def _draw_companion_points(overlay: Overlay, name: str, axes: Axes) -> bool:
    """Draw the positive values of other runs; return whether there are any."""
    companion_records = [(label, record) for label, record in overlay.records if name in record]
    for k, (label, record) in enumerate(companion_records):
        values = record[name].values
        rows = _positive_rows(values)
        colour = COLOURS[(k + 3) % len(COLOURS)]
        axes.plot(
            record["time"].values[rows], values[rows], ".", color=colour, markersize=2.5, label=escaped_text(label)
        )
    return bool(companion_records)


def _positive_rows(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the rows to draw on a logarithmic axis: those of positive values, thinned."""
    positive = np.flatnonzero(values > 0)
    return positive[thinned_rows(values[positive])] if len(positive) else positive


def draw_event_locations(run: xr.Dataset, axes: Axes) -> None:
    """Draw the width of each event's bracket and the uncertainty of its time."""
    time = run.variables["event_time"].values
    for name, marker, colour in zip(PARTS, "_.", (COLOURS[0], COLOURS[1]), strict=True):
        values = run.variables[name].values
        is_drawable = (values > 0) & np.isfinite(values)
        axes.plot(
            time[is_drawable], values[is_drawable], marker, color=colour, markersize=5, label=escaped_text(PARTS[name])
        )
    axes.set_yscale("log")
    label_time(axes, run["time"])
    axes.set(ylabel=time_axis_label(run["time"], "located within"))
    set_run_time_axis(run, axes)
    axes.set_title("events: bracket, and uncertainty of the time", loc="left", fontsize=10)
    axes.legend(fontsize=8, frameon=False)
