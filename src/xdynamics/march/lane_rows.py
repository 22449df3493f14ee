"""Rows and events of runs side by side: kept in turn, then sorted into one run after the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_uncounted
from xdynamics.kernels.lane_numbers import PLACES as L
from xdynamics.march.run import Run
from xdynamics.schema import NODE, STEP

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.int8]
Blocks = NDArray[np.float64]  # of three dimensions
FlagBlocks = NDArray[np.int8]

NONE = -1  # no run is in the lane
LIVING, FOLLOWING, EVENTS, ROWS = range(4)  # of `lane_counters`: lanes with a run, next run, events and rows handed out
OF_LANE, OF_STATE, OF_NOTED = range(3)  # where a lane holds a number of a row: in `w`, in `y`, in `logged_numbers`


@jit_uncounted
def keep_step_rows(
    lane_counters: IntArray,
    members: IntArray,
    reached: Floats,
    marks: Flags,
    y: Floats,
    w: Floats,
    logged_numbers: Floats,
    keeping: Any,
) -> None:
    """Keep the rows after a step in all lanes; the row of a lane that did not move belongs to no run."""
    to, lanes, (columns, rows, flags, owners) = lane_counters[ROWS], members.shape[0], keeping
    for k in range(columns.shape[0]):
        source = y if columns[k, 1] == OF_STATE else w if columns[k, 1] == OF_LANE else logged_numbers
        for lane in range(lanes):
            rows[to, k, lane] = source[columns[k, 2], lane]
    for lane in range(lanes):
        flags[to, 0, lane] = NODE if w[L.landed, lane] != 0.0 else STEP
        owners[to, lane] = members[lane] if w[L.t, lane] != reached[lane] else NONE
    for k in range(1, flags.shape[1]):
        for lane in range(lanes):
            flags[to, k, lane] = marks[k, lane]
    lane_counters[ROWS] += 1


@jit_uncounted
def keep_single_rows(run: Run, first: int, member: int, lane_counters: IntArray, keeping: Any) -> None:
    """Keep the rows that the single march wrote, from row `first` on."""
    columns, rows, flags, owners = keeping
    if columns.shape[0] == 0:
        return
    for row in range(first - run.base[0].rows, run.now[0].rows - run.base[0].rows):
        to = lane_counters[ROWS]
        for k in range(columns.shape[0]):
            rows[to, k, 0] = run.log_rows[columns[k, 0], row]
        for k in range(flags.shape[1]):
            flags[to, k, 0] = run.log_flags[k, row]
        for lane in range(owners.shape[1]):
            owners[to, lane] = NONE
        owners[to, 0] = member
        lane_counters[ROWS] += 1


@jit_uncounted
def hand_out(run: Run, member: int, lane_counters: IntArray, events: Any) -> None:
    """Move the events out of a run's log, and record the run that they belong to."""
    now, base, (met, rates, impulses, owners) = run.now[0], run.base[0], events
    for k in range(now.events - base.events):
        to = lane_counters[EVENTS]
        met[to] = run.log_events[k]
        for i in range(rates.shape[0]):
            rates[i, to] = run.log_rates[i, k]
        for i in range(impulses.shape[0]):
            impulses[i, to] = run.log_impulses[i, k]
        owners[to] = member
        lane_counters[EVENTS] += 1
    base.events = now.events


def gather_rows(
    rows: Blocks,
    flags: FlagBlocks,
    owners: IntArray,
    columns: IntArray,
    places: IntArray,
    to_rows: Floats,
    to_flags: Flags,
) -> None:
    """Sort rows of many runs, kept in turn, into one run after the other.

    Parameters
    ----------
    rows, flags, owners
        As `march_lanes` keeps them.
    columns : ndarray of int, shape (c, 3)
    places : ndarray of int
        Where the next row of each run goes; advanced.
    to_rows, to_flags : ndarray, shape (…, n)
        Filled, columns as in the log of a single march.
    """
    for row in range(owners.shape[0]):
        for lane in range(owners.shape[1]):
            owner = owners[row, lane]
            if owner == NONE:
                continue
            to = places[owner]
            places[owner] = to + 1
            for k in range(columns.shape[0]):
                to_rows[columns[k, 0], to] = rows[row, k, lane]
            for k in range(flags.shape[1]):
                to_flags[k, to] = flags[row, k, lane]
