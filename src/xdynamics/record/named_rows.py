"""Rows of `step` by their numbers in the complete march, which are looked up, since a selection moves rows."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.schema import STEP_NUMBER, STEPS
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr


def row_places(run: xr.Dataset, numbers: Any) -> NDArray[np.int64]:
    """Return the places, among a record's rows, of the rows of given numbers; -1 of those that it has not."""
    row_numbers = np.asarray(numbers, np.int64)
    if STEP_NUMBER.name not in run.variables or not row_numbers.size:
        return np.full(row_numbers.shape, -1, np.int64)
    step_numbers = run.variables[STEP_NUMBER.name]
    if step_numbers.ndim and step_numbers.size and ((row_numbers >= 0) & (row_numbers < step_numbers.size)).all():
        first, last = int(row_numbers.min()), int(row_numbers.max())
        # as in a whole run, of which no other numbers are read
        if np.array_equal(step_numbers[first : last + 1].values[row_numbers - first], row_numbers):
            return row_numbers
    return places_among(step_numbers.values, row_numbers)


def places_among(available_numbers: Any, numbers: Any) -> NDArray[np.int64]:
    """Return the places of numbers among others, -1 of those that are not there."""
    available_numbers, requested_numbers = np.atleast_1d(np.asarray(available_numbers)), np.asarray(numbers, np.int64)
    if not available_numbers.size:
        return np.full(requested_numbers.shape, -1, np.int64)
    # the rows of a selection may stand in any order
    order = np.argsort(available_numbers, kind="stable")
    places: NDArray[np.int64] = order[
        # one beyond the last is found behind the end; the comparison below refuses it
        np.minimum(np.searchsorted(available_numbers, requested_numbers, sorter=order), available_numbers.size - 1)
    ]
    return np.where(available_numbers[places] == requested_numbers, places, -1)


def rows_named(run: xr.Dataset, name: str) -> NDArray[np.int64]:
    """Return the places of the rows that a variable names, like ``event_row_before``; -1 of those that were left out."""
    return row_places(run, run.variables[name].values)


def rows_of_events(run: xr.Dataset, side: str, events: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the places of the rows ``before`` or ``after`` some events.

    Raises
    ------
    InputError
        Naming the first event whose row was left out, or is not at its time.
    """
    places: NDArray[np.int64] = rows_named(run, f"event_row_{side}")[events]
    if (missing := np.flatnonzero(places < 0)).size:
        raise InputError(
            f"the row {side} {_event_in_words(run, int(events[missing[0]]))} is not in this selection; take the event's states"
            " from the whole run"
        )
    if "time" in run.variables:
        differs = np.asarray(run.variables["time"].isel({STEPS: places})) != _event_times(run)[events]
        if differs.any():
            raise InputError(
                f"the row {side} {_event_in_words(run, int(events[differs][0]))} is at another time: step_number or a time was"
                " edited; take the event's states from the run as it was computed"
            )
    return places


def _event_times(run: xr.Dataset) -> NDArray[np.float64]:
    return np.atleast_1d(run.variables["event_time"].values)


def _event_in_words(run: xr.Dataset, which: int) -> str:
    """Name an event by its detector and its time."""
    time = float(_event_times(run)[which])
    words = str(run.variables["event_detector"].attrs.get("flag_meanings", "")).split()
    number = int(np.atleast_1d(run.variables["event_detector"].values)[which])
    detector = words[number] if number < len(words) else str(number)
    return f"event '{detector}' at t = {time:.6g}{unit_suffix(str(run.variables['event_time'].attrs['units']))}"
