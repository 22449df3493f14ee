"""Steps of many logs, repeated side by side and shortened to end at times inside them.

The rows at which steps to wanted times begin are looked up by an entry of the engine. For a march with delays, its past
is made again from the rows of its log.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate, jit_uncounted
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.program import REGIME, T1, H, T
from xdynamics.march.calls import run_at, strode_by
from xdynamics.march.contacts.phases import inform_forces, settle_contacts
from xdynamics.march.engine_entries import set_sides_at_time
from xdynamics.march.events.switch_sides import take_sides
from xdynamics.march.force_evaluation import evaluate_forces
from xdynamics.march.lanes import lend_to_lane
from xdynamics.march.past import begin_past, enter_past, note_past
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE, NODE, STEP

Floats = NDArray[np.float64]


def retrace(address: Any, steps: Floats, states: Floats) -> None:
    """Make the polynomials of all steps of a log again, in their order, as the march made them; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run` with room for as many pieces as there are rows.
    steps : ndarray, shape (4 + m, rows)
        Time, size of the step to it, regime, kind of the row, the state of each of m reactions.
    states : ndarray, shape (n, rows)
    """
    run = run_at(address)
    begin_past(run)
    for k in range(steps.shape[1] - 1):
        if np.int64(steps[3, k]) in (NODE, EVENT_BEFORE):
            run.book[0].stretch += 1
        if steps[0, k + 1] > steps[0, k]:
            stand_between(run, steps, states, k)
            note_past(run)


@jit_separate
def stand_between(run: Run, steps: Floats, states: Floats, k: int) -> None:
    """Set a run to the step from row k to the next, with the forces at both of its ends."""
    now, trial = run.now[0], run.trial[0]
    t, t1, regime = steps[0, k], steps[0, k + 1], np.int64(steps[2, k])
    for i in range(run.touches.shape[0]):
        run.touches[i].state = np.int64(steps[4 + i, k])
    copy_numbers(run.z, run.whole)
    for i in range(run.y.shape[0]):
        run.y[i] = states[i, k] if i < states.shape[0] else 0.0
    now.t, now.regime, run.at[REGIME], trial.t, trial.h = t, regime, regime, t1, steps[1, k + 1]
    enter_pieces(t, run.tables, run.places, run.of_time)
    enter_past(run, t1)
    if run.plan[0].switches > 0:
        take_sides(run)
    if run.plan[0].reactions > 0:
        inform_forces(run, t)
    if np.int64(steps[3, k]) == STEP and k > 0:  # forces are evaluated anew at nodes and events alone
        copy_numbers(run.whole, run.y)
    else:
        evaluate_forces(run, t, run.y)
    if np.int64(steps[3, k]) == EVENT_AFTER and run.plan[0].reactions > 0:
        settle_contacts(run, t)
    for i in range(run.z.shape[0]):  # contacts have used it
        run.z[i] = states[i, k + 1] if i < states.shape[0] else 0.0
    evaluate_forces(run, t1, run.z)


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


Flags = NDArray[np.int8]


def parts_of_steps(
    address: Any,
    forces_at: Any,
    propose_at: Any,
    table: IntArray,
    step_numbers: Floats,
    y: Floats,
    p: Floats,
    pieces: IntArray,
    z: Floats,
    log: Floats,
    flags: Flags,
    parameters: Floats,
    factors: Floats,
    jobs: IntArray,
    times: Floats,
    ends: Floats,
    time_indices: IntArray,
    interior_states: Floats,
) -> None:
    """Repeat steps of many logs, each shortened to end at a time inside it, as `engine_entries.states_inside` does.

    Parameters
    ----------
    address : int
        Of a `Run` without contacts.
    forces_at, propose_at : int
        Addresses of a force evaluation and of a step, in all lanes.
    table, step_numbers, y, p, pieces, z
        As for `march_lanes`.
    log, flags : ndarray, shape (…, rows)
    parameters : ndarray, shape (runs, …)
    factors : ndarray, shape (1 + n,)
        From internal units to those of the record: of time, then of the state.
    jobs : ndarray of int, shape (3, k)
        Row at the start of each step, row at its end, and the run.
    times : ndarray, shape (k,)
        In the unit of the record.
    ends, time_indices : ndarray, shape (3, W) and ndarray of int, shape (W,)
        Room for the steps that wait in the lanes: ends and size of each, and which of the times it leads to.
    interior_states : ndarray, shape (n, k)
        Filled, in units of the record.
    """
    run, lanes, n, scale = run_at(address), y.shape[1], interior_states.shape[0], factors[0]
    filled, current = 0, -1
    for k in range(times.shape[0]):
        row, led_to, member = jobs[0, k], jobs[1, k], jobs[2, k]
        # to units of the record and back, for the same bits
        t, t1, h = log[0, row] * scale / scale, log[0, led_to] * scale / scale, log[1, led_to] * scale / scale
        time = times[k] / scale
        if time > t:
            if member != current:
                current = member
                for i in range(parameters.shape[1]):
                    run.p[i] = parameters[member, i]
            run.now[0].regime = flags[1, row]
            stand_at_row(run, t, log, row, factors)
            lend_to_lane(run, step_numbers, y, p, pieces, filled)
            ends[0, filled], ends[1, filled], ends[2, filled] = t, time, (time - t) / (t1 - t) * h
            time_indices[filled] = k
            filled += 1
        else:
            for i in range(n):
                interior_states[i, k] = log[2 + i, row] * factors[1 + i]
        if filled == lanes or (filled > 0 and k == times.shape[0] - 1):
            set_lane_steps(step_numbers, ends, filled)
            strode_by(forces_at, table.ctypes.data, y.ctypes.data, y.ctypes.data, z.ctypes.data)
            strode_by(propose_at, table.ctypes.data, y.ctypes.data, z.ctypes.data, z.ctypes.data)
            for lane in range(filled):
                for i in range(n):
                    # `engine_entries.judge_inside` adds 0.0 where there is no mismatch, by which -0.0 becomes 0.0
                    interior_states[i, time_indices[lane]] = (z[i, lane] + 0.0) * factors[1 + i]
            filled = 0


@jit_uncounted
def stand_at_row(run: Run, t: float, log: Floats, row: int, factors: Floats) -> None:
    """Set the run to a row of the log, between steps; no rounding is carried along."""
    for i in range(run.y.shape[0]):
        # to units of the record and back, for the same bits
        run.y[i] = log[2 + i, row] * factors[1 + i] / factors[1 + i] if 1 + i < factors.shape[0] else 0.0
    set_sides_at_time(run, t)


@jit_uncounted
def set_lane_steps(step_numbers: Floats, ends: Floats, lanes: int) -> None:
    """Set the ends and the size of the step in each lane."""
    for lane in range(lanes):
        step_numbers[T, lane], step_numbers[T1, lane], step_numbers[H, lane] = (
            ends[0, lane],
            ends[1, lane],
            ends[2, lane],
        )
