"""The rows of runs at which steps to wanted times begin; an entry of the engine."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


def rows_of_times(
    time: Floats, low: IntArray, high: IntArray, times: Floats, last_at_time: bool, rows: IntArray
) -> None:
    """Find the row at the start of the step to each time.

    Parameters
    ----------
    time : ndarray, shape (rows,)
        Of many runs, one after the other.
    low, high : ndarray of int, shape (k,)
        First and last row of the run of each time.
    times : ndarray, shape (k,)
    last_at_time : bool
        Whether to return the last row not later than the time, or the first where several rows are at the time.
    rows : ndarray of int, shape (k,)
        Filled.
    """
    for k in range(times.shape[0]):
        first, last = low[k], high[k]
        while first < last:
            middle = (first + last + 1) // 2
            if time[middle] > times[k]:
                last = middle - 1
            else:
                first = middle
        while not last_at_time and first > low[k] and time[first - 1] >= times[k]:
            first -= 1
        rows[k] = first
