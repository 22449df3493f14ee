"""Whether recorded steps reach from one row to the next, or rows were left out between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.rounding_margins import EPS
from xdynamics.faults import InputError
from xdynamics.record.partial_records import RARE

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]


def slack(run: xr.Dataset) -> float:
    """Return the part of t by which a recorded step may miss the next row: the sum of given steps is rounded."""
    return EPS * max(8, 4 * run.sizes.get(schema.GIVEN, 0))


def check_steps_meet(where: Floats, steps: Floats, near: float, unit: str, every: int) -> None:
    """Refuse a record with rows left out: its steps would not reach from one row to the next.

    Raises
    ------
    InputError
        Naming the first such times.
    """
    times, starts, ends = where
    gaps = np.abs(ends - starts - steps)
    torn = np.flatnonzero((times > starts) & (gaps > near * np.maximum(np.abs(starts), np.abs(ends))))
    if torn.size:
        i = int(torn[0])
        if every > 1:
            raise InputError(
                f"t = {times[i]:.15g}{unit} is between rows of the march that were left out, from"
                f" {starts[i]:.15g}{unit} to {ends[i]:.15g}{unit}: of those this record has {RARE.format(every)}, or"
                " ask for times of kept rows"
            )
        raise InputError(
            f"rows are missing between t = {starts[i]:.15g}{unit} and {ends[i]:.15g}{unit}: the step to the later one"
            f" is {steps[i]:.15g}{unit}; sample the whole record, and choose among its rows afterwards"
        )


def check_rows_follow(where: Floats, numbers: xr.Variable, unit: str) -> None:
    """Refuse steps between whose ends a row of the march was left out, like the one behind an event.

    Parameters
    ----------
    where : ndarray
        Wanted times, the starts and ends of their steps, and the rows where these start.
    numbers : xarray.Variable
        `step_number`, of which those rows are read.

    Raises
    ------
    InputError
        Naming the first such times.
    """
    times, starts, ends, places = map(np.atleast_1d, where)
    rows = places.astype(np.int64)
    row_numbers, following = (
        np.asarray(numbers.isel({schema.STEPS: step_rows}).values)
        for step_rows in (rows, np.minimum(rows + 1, numbers.size - 1))
    )
    broken_steps = np.flatnonzero((following - row_numbers > 1) & (times > starts))
    if broken_steps.size:
        i = int(broken_steps[0])
        count = int(following[i] - row_numbers[i]) - 1
        missing = "a row is" if count == 1 else f"{count} rows are"
        raise InputError(
            f"{missing} missing between t = {starts[i]:.13g}{unit} and {ends[i]:.13g}{unit}; sample the whole record, and"
            " choose among its rows afterwards"
        )
