"""Some rows of the whole run, independent of its blocks: those by which a march is judged when it is over."""

from __future__ import annotations

from collections.abc import Iterator

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
    estimated : range
        Columns of a log with errors of the step that led to a row.
    """

    def __init__(self, used: int, estimated: range) -> None:
        self.used, self.estimated = used, estimated
        self.elsewhere = False  # whether the record has their states, which are then not copied
        self._record: list[Floats] = []  # the columns of it that have them
        self._record_errors: list[Floats] = []
        self._most = max(FEWEST, min(MOST, NUMBERS // used))
        self._count = 0
        # each row in one piece; what is not filled takes no memory
        self._rows, self._errors = np.empty((self._most, 3 + used)), np.empty((self._most, len(estimated)))

    @property
    def rows(self) -> Floats:
        """Number of the row, time, step, state: one column for each."""
        for k in range(self._count if self._record else 0):
            self._state(k, self._rows[k, 3:])
        return self._rows[: self._count].T

    @property
    def steps(self) -> Floats:
        """Number of the row, time, step: one column for each."""
        return self._rows[: self._count, :3].T

    def states(self, row_indices: list[int], room: Floats | None = None) -> Floats:
        """Return time and state of some of them, one column for each; of a single one in the room that is given."""
        states = (
            np.empty((1 + self.used, len(row_indices)))
            if room is None or len(row_indices) > 1
            else room[: 1 + self.used, None]
        )
        for k, row in enumerate(row_indices):
            states[0, k] = self._rows[row, 1]
            self._state(row, states[1:, k])
        return states

    def put_in(self, state: Floats, k: int) -> Floats:
        """Put one of them in the state of a march, and return its time, as the entries of the engine take it."""
        self._state(k, state)
        return self._rows[k, 1:2, None]

    def end_with(self, state: Floats) -> bool:
        """Whether the record to which states were left ends with a state."""
        return bool(self._record) and all(
            np.array_equal(part, state_part) for part, state_part in self._parts(-1, state)
        )

    def put_end_in(self, state: Floats) -> None:
        """Put the last state of the record in that of a march."""
        for part, state_part in self._parts(-1, state):
            state_part[:] = part

    def _parts(self, row: int, state: Floats) -> Iterator[tuple[Floats, Floats]]:
        """Yield the columns of a row of the record, and their places in a state."""
        first = 0
        for column in self._record:
            part = column[row].reshape(-1)
            yield part, state[first : first + part.size]
            first += part.size

    def read_in(self, columns: list[Floats], errors: list[Floats]) -> None:
        """Read states, which were left to the record, in its columns of coordinates, velocities and states."""
        self._record, self._record_errors = columns, errors

    def _state(self, k: int, state: Floats) -> None:
        """Copy the state of one of them."""
        if not self._record:
            state[: self.used] = self._rows[k, 3:]
        for part, state_part in self._parts(int(self._rows[k, 0]), state):
            state_part[:] = part

    @property
    def errors(self) -> Floats:
        """Errors of the steps that led to them."""
        if self._record_errors:
            row_numbers = self._rows[: self._count, 0].astype(int)
            return np.concatenate(
                [column[row_numbers].reshape(row_numbers.size, -1) for column in self._record_errors], axis=1
            ).T
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
            for table in (self._rows[:, :3],) if self.elsewhere else (self._rows, self._errors):
                for target_row, row in enumerate(retained.tolist()):  # one by one: together they would be copied
                    table[target_row] = table[row]
        begin = -first % stride
        new_rows = block.log.rows[:, begin : block.rows : stride]
        new = slice(len(retained), len(retained) + new_rows.shape[1])
        self._rows[new, 0] = range(first + begin, rows, stride)
        column_count = 2 if self.elsewhere else 2 + self.used
        self._rows[new, 1 : 1 + column_count] = new_rows[:column_count].T
        if not self.elsewhere:
            self._errors[new] = new_rows[self.estimated.start : self.estimated.stop].T
        self._count = new.stop
