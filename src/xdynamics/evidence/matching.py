"""Events of one name in two runs: which of them are the same."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.words import words_of

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

LOOKED_AT = 1000  # events that tell how many come before: the cost is not to grow with the square of them


def met(run: xr.Dataset) -> dict[str, Rows]:
    """Return the events of each name, in order: of a record without events, or without what is known of them, none."""
    if not {"event_detector", "event_time", "event_time_uncertainty"} <= set(run.variables):
        return {}
    names = np.array(words_of(run["event_detector"]))
    return {str(name): np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}


def matched(first: Floats, second: Floats) -> tuple[Rows, Rows]:
    """Pair the times of two ascending rows one by one; where one has more, behind as many of it as bring both closest.

    Returns
    -------
    tuple of ndarray of int
        Places in the first and in the second row, ascending; what has no partner is left out.

    Examples
    --------
    >>> [one.tolist() for one in matched(np.array([1.0, 2.0, 3.0]), np.array([2.1, 3.1]))]
    [[1, 2], [0, 1]]
    >>> [one.tolist() for one in matched(np.array([1.0, 2.0, 2.5]), np.array([1.2, 2.4]))]
    [[0, 1], [0, 1]]
    """
    if len(first) < len(second):
        theirs, mine = matched(second, first)
        return mine, theirs
    n, some = len(second), second[:LOOKED_AT]
    away = [float(np.mean(np.abs(first[k : k + len(some)] - some))) if n else 0.0 for k in range(len(first) - n + 1)]
    begin = int(np.argmin(away))
    return np.arange(begin, begin + n), np.arange(n)
