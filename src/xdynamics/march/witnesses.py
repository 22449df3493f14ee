"""Some rows of the whole run, independent of its blocks: those by which a march is judged when it is over."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.march.log import LogBlock

Floats = NDArray[np.float64]

MOST, FEWEST = 50, 2
NUMBERS = 1 << 21  # of them, where a state has many numbers


class Witnesses:
    """The rows of a march whose number a power of two divides.

    Parameters
    ----------
    used : int
        Numbers of a state.
    estimated : list of int
        Columns of a log with errors of the step that led to a row.
    """

    def __init__(self, used: int, estimated: list[int]) -> None:
        self.used, self.estimated = used, estimated
        self._most = max(FEWEST, min(MOST, NUMBERS // used))
        self._count = 0
        # each row in one piece; what is not filled takes no memory
        self._rows, self._errors = np.empty((self._most, 3 + used)), np.empty((self._most, len(estimated)))

    @property
    def rows(self) -> Floats:
        """Number of the row, time, step, state: one column for each."""
        return self._rows[: self._count].T

    @property
    def errors(self) -> Floats:
        """Errors of the steps that led to them."""
        return self._errors[: self._count].T

    def stride(self, rows: int) -> int:
        """Return their spacing in a number of rows; of wide ones there are fewer."""
        return 1 << max(0, (rows // self._most).bit_length())

    def put(self, rows: Floats, errors: Floats) -> None:
        """Take those of another march, a column for each."""
        self._count = rows.shape[1]
        self._rows[: self._count], self._errors[: self._count] = rows.T, errors.T

    def take(self, block: LogBlock, rows: int) -> None:
        """Take some rows of the newest block; with it there are so many."""
        first, stride = rows - block.rows, self.stride(rows)
        retained = np.flatnonzero(self._rows[: self._count, 0] % stride == 0)
        if len(retained) < self._count:
            for kept in (self._rows, self._errors):
                kept[: len(retained)] = kept[retained]
        begin = -first % stride
        taken = block.log.rows[:, begin : block.rows : stride]
        new = slice(len(retained), len(retained) + taken.shape[1])
        self._rows[new, 0] = range(first + begin, rows, stride)
        self._rows[new, 1:], self._errors[new] = taken[: 2 + self.used].T, taken[self.estimated].T
        self._count = new.stop
