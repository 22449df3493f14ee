"""Events of one name in two runs: which of them correspond."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from xdynamics.record.named_elements import event_words

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

LOOKED_AT = 1000  # events that decide the offset: the cost must not grow with the square of their number


def event_rows_by_name(run: xr.Dataset) -> dict[str, Rows]:
    """Return the rows of the events of each name, in order; empty for a record without events or their columns."""
    if not {"event_detector", "event_time", "event_time_uncertainty"} <= set(run.variables):
        return {}
    names = np.array(event_words(run))
    return {str(name): np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())}


def match_times(first: Floats, second: Floats) -> tuple[Rows, Rows]:
    """Pair the times of two ascending sequences one by one; the longer is shifted so that both are closest.

    Returns
    -------
    tuple of ndarray of int
        Indices into the first and into the second sequence, ascending; times without a partner are left out.

    Examples
    --------
    >>> [places.tolist() for places in match_times(np.array([1.0, 2.0, 3.0]), np.array([2.1, 3.1]))]
    [[1, 2], [0, 1]]
    >>> [places.tolist() for places in match_times(np.array([1.0, 2.0, 2.5]), np.array([1.2, 2.4]))]
    [[0, 1], [0, 1]]
    """
    if len(first) < len(second):
        theirs, mine = match_times(second, first)
        return mine, theirs
    n, head = len(second), second[:LOOKED_AT]
    distances = [
        float(np.mean(np.abs(first[k : k + len(head)] - head))) if n else 0.0 for k in range(len(first) - n + 1)
    ]
    offset = int(np.argmin(distances))
    return np.arange(offset, offset + n), np.arange(n)
