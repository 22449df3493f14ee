"""The number of a budget within proven bounds: what the march errs by at most, whatever its terms estimate."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from math import nan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from xdynamics.budgeting.measurand import TIME, Measurand, Target
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.enclosing.enclosure import COMPLETED, bounded_names, enclosure_request
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.stage_tasks import Task
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.record import unfold
from xdynamics.record.flag_words import words_of_flag
from xdynamics.schema import AT, BOUNDS, PROVEN, bounds_of
from xdynamics.tubes import interval_problem_of

if TYPE_CHECKING:
    import xarray as xr

BEYOND = 1e-3  # of the time to an event, by which a proof goes further, so that all motions are past it


class ProvenBounds(NamedTuple):
    """Proven bounds of a number, in its unit.

    Attributes
    ----------
    low, high : float
        Nan where nothing is proven.
    text : str
        What is proven, or why nothing is.
    """

    low: float
    high: float
    text: str

    def error(self, value: float) -> float:
        """Return the largest possible error of a number within the bounds."""
        # a difference is rounded once, so that the next float is a bound of the exact one
        return float(np.nextafter(max(value - self.low, self.high - value), np.inf))

    def distance(self, value: float) -> float:
        """Return how far a number is from the interval; 0 within."""
        return max(self.low - value, value - self.high, 0.0)


NOT_PROVEN = ProvenBounds(nan, nan, "")  # before anything is


def proven_task(measurand: Measurand, run: Task) -> Task:
    """Return the task that proves bounds of a number.

    Raises
    ------
    InputError
        If no bounds are proven of the number, or of the model.
    """
    model, target = certain(measurand.model), measurand.target
    if target.extreme is not None:
        raise InputError(
            f"no bounds are proven of the {target.description}; give a time or an event, or leave proven out"
        )
    if target.event and target.event not in model.elements.events:
        raise InputError(
            f"no bounds are proven of what happens at '{target.event}', which is no event; leave proven out"
        )
    interval_problem_of(model)
    return Task.of(PROVEN, partial(_prove_bounds, model, target), (run,), *measurand.inputs)


def certain(model: Model) -> Model:
    """Return a model without uncertainties and without events that end a run: until such an event it is unchanged."""
    statement = model.statement
    parameters, starts = (
        {name: replace(part, spread=None) for name, part in parts.items()}
        for parts in (statement.parameters, statement.starts)
    )
    arrays, starting = (
        {name: replace(values, spreads=()) for name, values in parts.items()}
        for parts in (statement.arrays, statement.starting)
    )
    events = {
        name: replace(event, action="record", count=1) if event.action == "stop" else event
        for name, event in statement.events.items()
    }
    changes: dict[str, Any] = {"parameters": parameters, "starts": starts, "arrays": arrays, "starting": starting}
    return model.with_statement(replace(statement, **changes, events=events, correlations={}))


def _prove_bounds(model: Model, target: Target, run: xr.Dataset) -> ProvenBounds:
    """Prove bounds of a number, up to where a run has it."""
    if target.at is not None:
        tube = unfold(enclosure_request(model, at=[target.at]).computed())
        names, row = bounded_names(tube, AT), {AT: 0}
    else:
        start, met = float(run["time"][0]), target.time_in(run)
        tube = unfold(enclosure_request(model, until=met + BEYOND * (met - start) + EPS * abs(met)).computed())
        places = [k for k, word in enumerate(words_of_flag(tube["event_detector"])) if word == target.event]
        if len(places) < target.occurrence:
            ended = tube.attrs["outcome"] != COMPLETED
            return ProvenBounds(nan, nan, str(tube.attrs["outcome_text" if ended else "events_text"]))
        names, row = (
            ["event_time", *(f"event_{name}" for name in model.elements.units)],
            {"event": places[target.occurrence - 1]},
        )
    name = (
        target.quantity if target.at is not None else f"event_{'time' if target.quantity == TIME else target.quantity}"
    )
    if name not in names or bounds_of(name)[0] not in tube:
        return ProvenBounds(nan, nan, f"no bounds are proven of '{target.quantity}' at an event, of states alone")
    low, high = (float(tube[bound].isel(row)) for bound in bounds_of(name))
    return ProvenBounds(low, high, str(tube.attrs["summary" if low <= high else "outcome_text"]))


def proven_variables(proven: ProvenBounds, value: float, unit: str) -> Mapping[str, Any]:
    """Return the proven bounds of a number as variables."""
    interval = np.array([proven.low, proven.high])
    error = proven.error(value)
    return {
        "proven_interval": (
            (BOUNDS,),
            interval,
            attrs_of(unit, "proven bounds of the number, of values as written", "budget"),
        ),
        "proven_error": (
            (),
            np.float64(error),
            attrs_of(unit, "what the run's own number is proven to be off by at most", "budget"),
        ),
        "proven_text": ((), np.array(proven.text), attrs_of("1", "what is proven, or why nothing is", "rule")),
    }
