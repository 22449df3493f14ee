"""States of a run at wanted times, in the place of its record."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.dynamics.wanted_times import wanted_times
from xdynamics.evidence.sampling import sample
from xdynamics.faults import InputError
from xdynamics.keywords import FULL, STATES
from xdynamics.march import March, Settings
from xdynamics.model import Model
from xdynamics.record.named_rows import rows_named
from xdynamics.record.variable_attributes import without_bounds
from xdynamics.schema import EVENTS, OF_MOTION, STEP_NUMBER, STEPS
from xdynamics.simulation.records import warn_of_accuracy
from xdynamics.units import Unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress

Floats = NDArray[np.float64]


def times_within(times: Any, unit: Unit, start: float, until: float) -> Floats:
    """Read the times to return states at, before anything is marched.

    Raises
    ------
    InputError
        If one is no time of the run.
    """
    sample_times = wanted_times(times, unit)
    times_outside = sample_times[(sample_times < start) | (sample_times > until)]
    if times_outside.size:
        raise InputError(
            f"times have {float(times_outside[0])!r}{unit_suffix(unit)}, and the run goes from {start!r}{unit_suffix(unit)} to"
            f" {until!r}{unit_suffix(unit)}"
        )
    return sample_times


def check_sampled(settings: Settings) -> None:
    """Check that settings keep in a file what states at wanted times are computed from.

    Raises
    ------
    InputError
        Naming them.
    """
    if settings.keep_every > 1 or settings.log not in (FULL, STATES):
        word = "keep_every" if settings.keep_every > 1 else "log"
        raise InputError(
            f"times are sampled from the rows of the file, and {word} leaves some of what they need out of it: leave"
            f" out times or {word}"
        )


def sampled_march(model: Model, settings: Settings, sample_times: Floats, progress: Progress | None) -> xr.Dataset:
    """March, and keep the part of the log from which states at wanted times are computed, a step for each."""
    kept_times = None if model.delays else sample_times  # delayed values are of all rows
    march = March(model, replace(settings, keep_every=1, log=STATES), progress, kept_times)
    partial_run = record.dataset(march)
    warn_of_accuracy(march)
    states = sampled_states(partial_run, sample_times, model)
    if model.delays:
        return states
    rows = states["row"]
    return states.assign(row=rows.copy(data=partial_run[STEP_NUMBER.name].values[rows.values]))


def add_events(states: xr.Dataset, run: xr.Dataset) -> xr.Dataset:
    """Add the events of a run to its states at wanted times: when each was, and the state after it."""
    import xarray as xr

    rows_after = rows_named(run, "event_row_after")
    variables = {name: run.variables[name].copy(deep=False) for name in ("event_time", "event_detector")}
    variables["event_time"].attrs = without_bounds(run.variables["event_time"].attrs)
    for name, variable in run.variables.items():
        if variable.dims[:1] == (STEPS,) and variable.attrs.get("role") in OF_MOTION:
            attributes = {"units": variable.attrs["units"], "long_name": f"{name} after the event", "role": "event"}
            variables[f"after_{name}"] = xr.Variable(
                (EVENTS, *variable.dims[1:]), variable.values[rows_after], attributes
            )
    return states.assign(variables)


def sampled_states(run: xr.Dataset, sample_times: Floats | None, model: Model) -> xr.Dataset:
    """Return the states at wanted times, as far as the run came; the record where none are wanted."""
    if sample_times is None:
        return run
    reached_times = sample_times[sample_times <= float(run["time"][-1])]
    states = (
        sample(run, reached_times, functions=model.functions)
        if reached_times.size
        else sample(run, float(run["time"][-1])).isel(at=slice(0))
    )
    return states.assign_attrs({key: run.attrs[key] for key in ("run_outcome", "run_outcome_text")})
