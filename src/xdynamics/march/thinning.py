"""Rows of a march that are recorded: every n-th of its grid, those of events and requested nodes, both ends.

The march fills every row of its blocks, and rows are left out before they become a record: the recorded rows have the
bits of the complete march.

Witnesses are rows of the complete run, independent of its blocks, by which a march is judged when it is over.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.march.log import Log, LogBlock
from xdynamics.march.run import BASE, Run
from xdynamics.schema import EVENT_BEFORE

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
        """Write a witness row into the state of a march, and return its time in the shape of engine entries."""
        self._state(k, state)
        return self._rows[k, 1:2, None]

    def end_with(self, state: Floats) -> bool:
        """Whether the record to which states were left ends with a state."""
        return bool(self._record) and all(
            np.array_equal(part, state_part) for part, state_part in self._parts(-1, state)
        )

    def put_end_in(self, state: Floats) -> None:
        """Write the last state of the record into the state of a march."""
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
        """Replace the witnesses by those of another march, a column for each."""
        self._count = rows.shape[1]
        self._rows[: self._count], self._errors[: self._count] = rows.T, errors.T

    def take(self, block: LogBlock, rows: int) -> None:
        """Add rows of the newest block, which brings the march to `rows` rows."""
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


Array = NDArray[Any]

NOWHERE = -1  # the place of a row that is left out


@dataclass(frozen=True)
class LogRows:
    """Rows of a log with their closed links, the force evaluations that led to them, the trials that started from them."""

    rows: Array
    flags: Array
    samples: Array
    trials: Array
    closed: Array

    def selection(self, rows: Array, samples: Array, trials: Array, closed: Array) -> LogRows:
        """Copy a selection, since the log's memory is filled again."""
        steps = self.rows[:, rows], self.flags[:, rows]
        return LogRows(*steps, self.samples[:, samples], self.trials[trials], self.closed[:, closed])

    def of_rows(self, is_kept: Array, places: Array, begin: int) -> LogRows:
        """Return wanted rows, their samples and trials, numbered by `places`, which starts before row `begin`."""
        sample_rows = places[self.samples[1].astype(np.int64) - begin + 1]
        trial_rows, closed_rows = places[self.trials["step"] - begin + 1], places[self._rows_of_closed() - begin + 1]
        part = self.selection(
            np.flatnonzero(is_kept),
            *(np.flatnonzero(row_numbers >= 0) for row_numbers in (sample_rows, trial_rows, closed_rows)),
        )
        part.samples[1], part.trials["step"] = sample_rows[sample_rows >= 0], trial_rows[trial_rows >= 0]
        part.closed[:1] = closed_rows[closed_rows >= 0]
        return part

    def _rows_of_closed(self) -> Array:
        return self.closed[0].astype(np.int64) if len(self.closed) else np.zeros(0, np.int64)

    def of_row(self, number: int) -> LogRows:
        """Return closed links, samples and trials of a row of given number, without the row."""
        owners = self.samples[1], self.trials["step"], self._rows_of_closed()
        return self.selection(np.zeros(0, np.int64), *(np.flatnonzero(owner == number) for owner in owners))

    def last(self, number: int, *, copied: bool) -> LogRows:
        """Return the last row, whose number is given, with its closed links, samples and trials."""
        rows, flags = self.rows[:, -1:], self.flags[:, -1:]
        if copied:
            rows, flags = rows.copy(), flags.copy()
        return replace(self.of_row(number), rows=rows, flags=flags)


class Thinning:
    """The rows of a march recorded so far; the newest row waits until it is known whether it is the last.

    Parameters
    ----------
    every : int
        Rows of the grid from one that is kept to the next.
    nodes : ndarray, in the march's own time
        Times at which a row was requested.
    """

    def __init__(self, every: int, nodes: NDArray[np.float64]) -> None:
        self.every, self.nodes = every, nodes
        self.kept_row_count = 0  # rows that were handed over
        self.waiting: LogRows | None = None

    def memory(self) -> dict[str, Array]:
        """Return everything needed to go on from here, by name."""
        waiting = {} if self.waiting is None else vars(self.waiting)
        return {"kept_rows": np.array([self.kept_row_count])} | {
            f"waiting_{name}": array for name, array in waiting.items()
        }

    def go_on_from(self, memory: Mapping[str, Array]) -> None:
        """Continue from the memory of this march's thinning."""
        self.kept_row_count = int(memory["kept_rows"][0])
        names = ("rows", "flags", "samples", "trials", "closed")
        is_waiting = "waiting_rows" in memory
        remembered_arrays = {"waiting_closed": np.zeros((0, 0)), **memory}  # empty arrays are not kept
        self.waiting = LogRows(*(remembered_arrays[f"waiting_{name}"].copy() for name in names)) if is_waiting else None

    def stand_behind(self, row_count: int) -> None:
        """Go on after a record of `row_count` rows, of which the last one is an end."""
        self.kept_row_count, self.waiting = row_count, None

    def thinned(self, run: Run, block: LogBlock, *, last: bool) -> LogBlock:
        """Return a copy of the recorded part of a block; with `last` the march is over, and its last row an end."""
        log, first = block.log, int(block.log.base[0]["rows"])
        new = LogRows(
            log.rows[:, : block.rows],
            log.flags[:, : block.rows],
            log.samples[:, : block.samples],
            log.trials[: block.trials],
            log.closed_rows,
        )
        parts = [new] if self.waiting is None else [self.waiting, new]
        begin = first - (len(parts) - 1)
        events = log.events[: block.events].copy()
        ends = {name: events[name] - begin for name in ("row_before", "row_after")}
        is_kept = np.zeros(first + block.rows - begin, bool)
        self._want(is_kept, run, parts, begin)
        for rows in ends.values():
            is_kept[rows[rows >= 0]] = True
        is_kept[-1:] |= last
        # of every row, from the one before on, which is kept if it does not wait
        places = np.concatenate(
            [[self.kept_row_count - 1], np.where(is_kept, self.kept_row_count + np.cumsum(is_kept) - 1, NOWHERE)]
        )
        for name, rows in ends.items():
            events[name] = places[rows + 1]
        halves = np.split(is_kept, [first - begin])[-len(parts) :]
        kept_rows = _join_rows([part.of_rows(half, places, begin) for part, half in zip(parts, halves, strict=True)])
        base = np.zeros(1, BASE)
        base["rows"], base["events"] = self.kept_row_count, log.base["events"]
        numbers = begin + np.flatnonzero(is_kept)
        self.kept_row_count += numbers.size
        self.waiting = None if not is_kept.size or is_kept[-1] else _newest(parts, begin + is_kept.size - 1)
        kept_log = Log(
            base,
            kept_rows.rows,
            kept_rows.flags,
            kept_rows.samples,
            kept_rows.trials,
            events,
            log.rates[:, : block.events].copy(),
            log.impulses[:, : block.events].copy(),
            kept_rows.closed,
            np.array([kept_rows.closed.shape[1]]),
        )
        return LogBlock(
            kept_log, numbers.size, len(kept_rows.trials), block.events, kept_rows.samples.shape[1], numbers, begin
        )

    def waiting_block(self, run: Run) -> LogBlock | None:
        """Return the row that still waits when a march is interrupted after it."""
        if (waiting := self.waiting) is None:
            return None
        base = np.zeros(1, BASE)
        base["rows"], base["events"] = run.now["rows"], run.now["events"]
        empty = Log(
            base,
            waiting.rows[:, :0],
            waiting.flags[:, :0],
            waiting.samples[:, :0],
            waiting.trials[:0],
            run.log_events[:0],
            run.log_rates[:, :0],
            run.log_impulses[:, :0],
            waiting.closed[:, :0],
        )
        return self.thinned(run, LogBlock(empty, 0, 0, 0, 0), last=True)

    def _want(self, marks: Array, run: Run, parts: list[LogRows], begin: int) -> None:
        """Mark the first row and those of the thinned grid, events and requested nodes; not the waiting row."""
        part, first = parts[-1], begin + len(parts) - 1
        is_kept = marks[len(parts) - 1 :]
        plan, now, t = run.plan[0], run.now[0], part.rows[0]
        if plan.step_size > 0.0 and now.grid < now.rows - 1:  # there are rows besides those of the grid
            numbers = np.rint((t - plan.start) / (self.every * plan.step_size)) * self.every
            size = np.maximum(abs(plan.start), np.abs(t))
            is_kept |= np.abs(plan.start + numbers * plan.step_size - t) <= plan.snap * size
        else:
            is_kept[-first % self.every :: self.every] = True
        if first == 0:
            is_kept[:1] = True
        if now.events:
            is_kept |= part.flags[0] >= EVENT_BEFORE
        if self.nodes.size:
            is_kept |= np.isin(t, self.nodes)


class RowsAroundTimes(Thinning):
    """Rows on both sides of wanted times, from which the states there are made; the newest waits for the next one.

    Parameters
    ----------
    times : ndarray, s
    scale : float
        Seconds per unit of the march's own time.
    """

    def __init__(self, times: NDArray[np.float64], scale: float) -> None:
        super().__init__(1, np.zeros(0))
        self.times, self.scale = np.unique(times), scale

    def _want(self, marks: Array, _run: Run, parts: list[LogRows], _begin: int) -> None:
        """Mark the last row up to each time, and the one after it; times that were passed are dropped."""
        t = np.concatenate([part.rows[0] for part in parts])
        t = t if self.scale == 1.0 else t * self.scale  # as the record has it
        if not t.size:
            return
        passed = np.searchsorted(self.times, t[-1])
        behind = np.searchsorted(t, self.times[:passed], side="right")
        self.times = self.times[passed:]
        marks[behind[behind > 0] - 1] = True
        marks[behind] = True  # there is one: all of these times are before the last row


def _newest(parts: list[LogRows], number: int) -> LogRows:
    """Return the newest row, whose number is given, with its closed links, samples and trials.

    The row of the last part stays in its log: that is not filled again before the block after the next one.
    """
    *earlier, latest = parts
    if latest.rows.shape[1]:
        return _join_rows([*(part.of_row(number) for part in earlier), latest.last(number, copied=False)])
    return _join_rows([*(part.last(number, copied=True) for part in earlier), latest.of_row(number)])


def _join_rows(parts: list[LogRows]) -> LogRows:
    """Concatenate parts."""
    names = ("rows", "flags", "samples", "closed")
    wide = {name: _stack_columns([getattr(part, name) for part in parts]) for name in names}
    return LogRows(**wide, trials=np.concatenate([part.trials for part in parts]))


def _stack_columns(tables: list[Array]) -> Array:
    """Concatenate columns; those of one table alone are not copied."""
    filled = [table for table in tables if table.shape[1]]
    return np.hstack(filled) if len(filled) > 1 else (filled or tables[-1:])[0]
