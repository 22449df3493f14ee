"""Rows of `step` by their numbers in the whole march: what names rows is looked up, since a selection moves them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import STEP_NUMBER, STEPS
from xdynamics.units import unit_suffix

if TYPE_CHECKING:
    import xarray as xr


def places_of(run: xr.Dataset, numbers: Any) -> NDArray[np.int64]:
    """Return the places, among a record's rows, of the rows of given numbers; -1 of those that it has not."""
    wanted = np.asarray(numbers, np.int64)
    if STEP_NUMBER.name not in run.variables:
        return np.full(wanted.shape, -1, np.int64)
    own = run.variables[STEP_NUMBER.name]
    if own.ndim and own.size and ((wanted >= 0) & (wanted < own.size)).all():
        flat = wanted.ravel()
        there = own.isel({own.dims[0]: flat}).values if is_chunked(own) else own.values[flat]
        if np.array_equal(there, flat):  # as in a whole run, of which no other number is read
            return wanted
    return places_among(own.values, wanted)


def places_among(own: Any, numbers: Any) -> NDArray[np.int64]:
    """Return the places of numbers among others, -1 of those that are not there."""
    own, wanted = np.atleast_1d(np.asarray(own)), np.asarray(numbers, np.int64)
    if not own.size:
        return np.full(wanted.shape, -1, np.int64)
    order = np.argsort(own, kind="stable")
    places: NDArray[np.int64] = order[np.minimum(np.searchsorted(own, wanted, sorter=order), own.size - 1)]
    return np.where(own[places] == wanted, places, -1)


def rows_named(run: xr.Dataset, name: str) -> NDArray[np.int64]:
    """Return the places of the rows that a variable names, like ``event_row_before``; -1 of those that were left out."""
    return places_of(run, run.variables[name].values)


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
        apart = np.asarray(run.variables["time"].isel({STEPS: places})) != _event_times(run)[events]
        if apart.any():
            raise InputError(
                f"the row {side} {_event_in_words(run, int(events[apart][0]))} is at another time: step_number or a time was"
                " edited; take the event's states from the run as it was marched"
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
