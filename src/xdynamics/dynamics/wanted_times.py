"""The times that somebody asks for, in any of the ways to say them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.units import SECONDS, Range, Unit, is_range, time_in

Floats = NDArray[np.float64]
MOST_TIMES = 100_000_000  # of a range


def wanted_times(times: Any, unit: Unit = SECONDS) -> Floats:
    """Read requested times: numbers in the model's unit of time, texts, or a range like ``0:20:201 s``.

    Raises
    ------
    InputError
        If they are not times, or none.
    """
    if isinstance(times, str) and ":" in times:
        if not is_range(times):
            raise InputError(
                f"times are {times[:60]!r}, need start:stop:count and a unit, count a whole number, like '0:20:201 s'"
            )
        span = Range.parse(times)
        if span.unit.text != "1" and span.unit.dimension != unit.dimension:
            raise InputError(f"times {times!r} are in '{span.unit.text}', need a time in '{unit.text}'")
        if not 0 < span.count <= MOST_TIMES:
            raise InputError(f"times {times!r} are {span.count}, need a count from 1 to {MOST_TIMES}")
        times = np.linspace(span.start, span.stop, span.count) * float(span.unit.factor)
    elif isinstance(times, str):
        times = [time_in(unit, time, "times") for time in times.split(",")]
    elif isinstance(times, list | tuple) and any(isinstance(time, str) for time in times):
        times = [time_in(unit, time, "times") for time in times]
    try:
        if np.asarray(times).dtype == bool:
            raise TypeError(times)  # noqa: TRY301 - answered right below
        requested_times = np.atleast_1d(np.asarray(times, dtype=float))
    except (TypeError, ValueError):
        raise InputError(f"times are {str(times)[:60]}, need numbers in '{unit.text}'") from None
    if requested_times.ndim != 1 or not requested_times.size:
        raise InputError(f"times have the shape {requested_times.shape}, need one row with at least one time")
    if np.isnan(requested_times).any():
        raise InputError(
            f"times[{int(np.flatnonzero(np.isnan(requested_times))[0])}] is nan, needs a time in '{unit.text}'"
        )
    return requested_times
