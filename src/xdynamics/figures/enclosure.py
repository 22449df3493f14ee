"""Figures of proven bounds: the tube of every quantity, and runs inside it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr

from xdynamics.archive import open_run
from xdynamics.evidence.enclosing.enclosure import bounded_names
from xdynamics.evidence.evidence_dataset import stated_value
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError
from xdynamics.figures.marks import COLOURS, escaped_text, label_time, label_with_unit, typeset
from xdynamics.figures.sheet import Page, Panel
from xdynamics.schema import AT, AT_TIME, ENCLOSURE, EVIDENCE, STEPS, bounds_of
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    from matplotlib.axes import Axes

NARROW = 1e-2  # of what a quantity goes through: a tube that is narrower is drawn about its middle


def panels_of(tube: xr.Dataset, beside: Sequence[Any] = ()) -> list[Panel]:
    """Return the panel of each quantity with bounds.

    Raises
    ------
    InputError
        If what is to be drawn inside the tube is no run, or no time has bounds.
    """
    runs = [source if isinstance(source, xr.Dataset) else open_run(source) for source in beside]
    for run in runs:
        if run.attrs.get(EVIDENCE) or "time" not in run:
            raise InputError("what is drawn inside proven bounds is a run; leave out what is none")
    time_dim, time = (AT, AT_TIME) if AT_TIME in tube.variables else (STEPS, "time")
    proven_part = tube.isel({time_dim: np.flatnonzero(tube[time].values <= float(stated_value(tube, "proven_until")))})
    if not proven_part.sizes[time_dim]:
        raise InputError(f"there is nothing to draw: {stated_value(tube, 'outcome_text')}")
    sorted_tube = proven_part.sortby(time)
    names = [name for name in bounded_names(tube, time_dim) if sorted_tube[bounds_of(name)[0]].ndim == 1]
    sampled_runs = [_sampled_run(run, sorted_tube[time].values) for run in runs]
    return [partial(_draw_tube, sorted_tube, name, time, sampled_runs) for name in names]


def foot_of(tube: xr.Dataset) -> str:
    """Say what is proven."""
    return f"{stated_value(tube, 'summary')} Bounds hold at the dots of a run, and wherever lines have corners."


def _sampled_run(run: xr.Dataset, times: np.ndarray[Any, Any]) -> xr.Dataset:
    """Return the states of a run at those times of a tube that it has."""
    ends = run.variables["time"].values[[0, -1]]
    return sample(run, times[(times >= ends[0]) & (times <= ends[1])])


def _draw_tube(tube: xr.Dataset, name: str, time: str, sampled_runs: list[xr.Dataset], axes: Axes) -> None:
    """Draw one tube; of a narrow one how far its bounds and the runs are from its middle."""
    times, (low, high) = tube[time].values, (tube[bound].values for bound in bounds_of(name))
    width, unit = float((high - low).max()), str(tube[bounds_of(name)[0]].attrs["units"])
    middle = low + 0.5 * (high - low)
    is_narrow = width < NARROW * float(np.ptp(middle))
    reference = middle if is_narrow else np.zeros_like(middle)
    axes.fill_between(times, low - reference, high - reference, color=COLOURS[0], alpha=0.3, linewidth=0.0)
    for bound in (low, high):
        axes.plot(times, bound - reference, color=COLOURS[0], linewidth=0.8)
    for k, run in enumerate(sampled_runs):
        if name in run:
            run_times = run.variables[AT_TIME].values
            deviation = run.variables[name].values - np.interp(run_times, times, reference)
            label = escaped_text(f"run by {run.attrs['solver_method']}")
            axes.plot(run_times, deviation, ".-", color=COLOURS[1 + k], linewidth=1.0, markersize=3, label=label)
            axes.legend(fontsize=8, loc="upper left", framealpha=0.6)
    label_time(axes, tube[time])
    axes.set(ylabel=escaped_text(label_with_unit(f"{name} less the middle" if is_narrow else name, unit)))
    last = f"{high[-1] - low[-1]:.2g}{unit_suffix(typeset(unit))} wide at the end"
    axes.set_title(escaped_text(f"{name}, {last}"), loc="left", fontsize=10, pad=14)


PAGE = Page((ENCLOSURE,), panels_of, foot_of, 6)
