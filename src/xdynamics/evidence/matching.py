"""Events of one name in two runs: which of them are the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


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
    n = len(second)
    away = [float(np.mean(np.abs(first[k : k + n] - second))) if n else 0.0 for k in range(len(first) - n + 1)]
    begin = int(np.argmin(away))
    return np.arange(begin, begin + n), np.arange(n)
