"""Steps of many logs, repeated side by side and shortened to end at times inside them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_uncounted
from xdynamics.kernels.program import T1, H, T
from xdynamics.march.calls import run_at, strode_by
from xdynamics.march.engine_entries import set_sides_at_time
from xdynamics.march.lane_memory import lend_to_lane
from xdynamics.march.run import Run

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]
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
    """Repeat steps of many logs, each shortened to end at a time inside it, as `entries.states_inside` does.

    Parameters
    ----------
    address : int
        Of a `Run` without contacts.
    forces_at, propose_at : int
        Addresses of a force evaluation and of a step, in all lanes.
    table, at, y, p, pieces, z
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
                    interior_states[i, time_indices[lane]] = (z[i, lane] + 0.0) * factors[1 + i]
            filled = 0


@jit_uncounted
def stand_at_row(run: Run, t: float, log: Floats, row: int, factors: Floats) -> None:
    """Set the run to a row of the log, between steps; no rounding is carried along."""
    for i in range(run.y.shape[0]):
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
