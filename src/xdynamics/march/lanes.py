"""Many runs side by side: each in a lane of vector code, which takes the next run when its own ends.

`kernels.lane_step` makes ordinary steps in all lanes at once. Any other step, and the start, is made by the run's
own `Run` in the single march, from the same state, and the lane goes on after it: so each run is the same, to the bit, as alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_uncounted
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.lane_numbers import PLACES as L
from xdynamics.march.calls import march_by, run_at, strode_by
from xdynamics.march.engine_entries import begin_run, keep_last, keep_smooth_passages
from xdynamics.march.force_evaluation import evaluate_forces, finite_state
from xdynamics.march.implicit.lanes import forget_step_memory
from xdynamics.march.lane_memory import aim_behind, needs_single_march, put_in_lane, rebase, take_out_of_lane
from xdynamics.march.lane_rows import EVENTS, FOLLOWING, LIVING, NONE, ROWS, hand_out, keep_single_rows, keep_step_rows
from xdynamics.march.log import has_room
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.run import Run

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]
Flags = NDArray[np.int8]
Blocks = NDArray[np.float64]  # of three dimensions
FlagBlocks = NDArray[np.int8]
Records = NDArray[Any]


def march_lanes(
    addresses: IntArray,
    march_at: Any,
    stride_at: Any,
    table: IntArray,
    step_numbers: Floats,
    y: Floats,
    states_before: Floats,
    p: Floats,
    pieces: IntArray,
    z: Floats,
    w: Floats,
    members: IntArray,
    lane_counters: IntArray,
    plans: Records,
    starts: Floats,
    parameters: Floats,
    atols: Floats,
    ends: Records,
    lasts: Floats,
    largest: Floats,
    passed: Floats,
    met: Records,
    rates: Floats,
    impulses: Floats,
    owners: IntArray,
    logged_numbers: Floats,
    columns: IntArray,
    rows: Blocks,
    flags: FlagBlocks,
    row_owners: IntArray,
    reached: Floats,
    marks: Flags,
) -> bool:
    """March runs from their starts and parameters to their ends.

    Parameters
    ----------
    addresses : ndarray of int, shape (lanes,)
        Of a `Run` for each lane.
    march_at, stride_at : int
        Addresses of the compiled `loop.march`, and of a step in all lanes.
    table : ndarray of int
        Addresses of the following arrays, for the step.
    step_numbers, y, states_before, p, z, w : ndarray, shape (…, lanes)
        `states_before` is the state before the last node.
    pieces : ndarray of int, shape (…, lanes)
    members : ndarray of int, shape (lanes,)
        The run in each lane.
    lane_counters : ndarray of int, shape (4,)
        `LIVING`, `FOLLOWING`, `EVENTS`, `ROWS`.
    plans, starts, parameters, atols, ends, lasts, largest, passed
        Of the runs, as for `engine_entries.march_in_turn`.
    met, rates, impulses, owners
        Events in the order of their location, and the run of each.
    logged_numbers : ndarray, shape (…, lanes)
        What a step logs besides the state.
    columns : ndarray of int, shape (c, 3)
        Of each column of the log that is kept: its number, where a lane holds it, and its place there.
    rows, flags, row_owners : ndarray, shape (n, c, lanes), (n, …, lanes), (n, lanes)
        Rows in the order of acceptance, and the run of each or `NONE`; without columns, none are kept.
    reached, marks : ndarray, shape (lanes,), (…, lanes)
        Time of the row last kept of each lane, and its flags.

    Returns
    -------
    bool
        Whether all are over; if not, events or rows are full and have to be taken out.
    """
    blocks, inputs = (step_numbers, y, states_before, p, pieces, w), (plans, starts, parameters, atols)
    results, events = (ends, lasts, largest, passed), (met, rates, impulses, owners)
    keeping = (columns, rows, flags, row_owners)
    while lane_counters[LIVING] > 0:
        if not serve_all(
            addresses, march_at, members, lane_counters, blocks, inputs, results, events, keeping, reached, marks
        ):
            return False
        if columns.shape[0] > 0 and lane_counters[ROWS] == rows.shape[0]:
            return False
        if lane_counters[LIVING] > 0:
            strode_by(stride_at, table.ctypes.data, y.ctypes.data, z.ctypes.data, logged_numbers.ctypes.data)
            follow_stride(addresses, lane_counters, members, reached, marks, blocks, logged_numbers, keeping)
    return True


@jit_uncounted
def follow_stride(
    addresses: IntArray,
    lane_counters: IntArray,
    members: IntArray,
    reached: Floats,
    marks: Flags,
    blocks: Any,
    logged_numbers: Floats,
    keeping: Any,
) -> None:
    """Keep the rows after a step in all lanes, and cross the nodes that it landed on."""
    (_, y, states_before, _, pieces, w), keeps = blocks, keeping[0].shape[0] > 0
    if keeps:
        keep_step_rows(lane_counters, members, reached, marks, y, w, logged_numbers, keeping)
    if keeps or run_at(addresses[0]).nodes.shape[0] > 0:
        for lane in range(addresses.shape[0]):
            has_moved, reached[lane] = w[L.t, lane] != reached[lane], w[L.t, lane]
            if has_moved and w[L.landed, lane] != 0.0:
                cross_lane_node(run_at(addresses[lane]), y, states_before, pieces, w, lane)


@jit_uncounted
def serve_all(
    addresses: IntArray,
    march_at: Any,
    members: IntArray,
    lane_counters: IntArray,
    blocks: Any,
    inputs: Any,
    results: Any,
    events: Any,
    keeping: Any,
    reached: Floats,
    marks: Flags,
) -> bool:
    """Serve each lane whose step was not ordinary; False if there is no room. Note its last row, time and flags."""
    w = blocks[5]
    for lane in range(addresses.shape[0]):
        if w[L.ordinary, lane] == 0.0:
            if not serve(
                addresses[lane], march_at, lane, members, lane_counters, blocks, inputs, results, events, keeping
            ):
                return False
            run, reached[lane] = run_at(addresses[lane]), w[L.t, lane]
            for k in range(marks.shape[0]):
                marks[k, lane] = run.log_flags[k, max(0, run.now[0].rows - 1 - run.base[0].rows)]
    return True


@jit_uncounted
def serve(
    address: Any,
    march_at: Any,
    lane: int,
    members: IntArray,
    lane_counters: IntArray,
    blocks: Any,
    inputs: Any,
    results: Any,
    events: Any,
    keeping: Any,
) -> bool:
    """Make a lane's step by the single march, and start the next run where one is over; False if there is no room."""
    run, (_, y, states_before, _, _, w) = run_at(address), blocks
    if lacks_room(run, len(members), lane_counters, events, keeping):
        return False
    if members[lane] != NONE:
        take_out_of_lane(run, y, states_before, w, lane)
        if run.now[0].status == RUNNING:
            march_singly(run, march_at, address, members[lane], lane_counters, keeping, 1)
        hand_out(run, members[lane], lane_counters, events)
    while members[lane] == NONE or run.now[0].status != RUNNING:
        if members[lane] != NONE:
            store_run_results(run, members[lane], results)
        members[lane] = NONE
        if lacks_room(run, 1, lane_counters, events, keeping):
            return False
        if lane_counters[FOLLOWING] == inputs[1].shape[0]:
            lane_counters[LIVING] -= 1
            w[L.lives, lane], w[L.ordinary, lane] = 0.0, 1.0
            return True
        members[lane] = lane_counters[FOLLOWING]
        begin_run(run, inputs[0], inputs[1], inputs[2], inputs[3], members[lane])
        base = run.base[0]
        base.rows, base.trials, base.events, base.samples = 0, 0, 0, 0
        # a first step that was given is not the one that series foresee
        given_step = run.plan[0].series > 0 and run.plan[0].first_step > 0.0
        march_singly(run, march_at, address, members[lane], lane_counters, keeping, 1 if given_step else 0)
        hand_out(run, members[lane], lane_counters, events)
        lane_counters[FOLLOWING] += 1
    put_in_lane(run, blocks, lane)
    return True


@jit_uncounted
def lacks_room(run: Run, lanes: int, lane_counters: IntArray, events: Any, keeping: Any) -> bool:
    """Whether there is too little room for the events of some lanes, or for rows that the single march may write."""
    if lane_counters[EVENTS] + lanes * run.log_events.shape[0] > events[0].shape[0]:
        return True
    return keeping[0].shape[0] > 0 and lane_counters[ROWS] + run.log_flags.shape[1] + 2 > keeping[1].shape[0]


@jit_uncounted
def cross_lane_node(run: Run, y: Floats, states_before: Floats, pieces: IntArray, w: Floats, lane: int) -> None:
    """After a node, put the far side's forces into a lane, as in `loop.cross_node`; `states_before` keeps the near side."""
    now, t = run.now[0], w[L.t, lane]
    for i in range(run.y.shape[0]):
        states_before[i, lane] = run.z[i] = y[i, lane]
    enter_pieces(t, run.tables, run.places, run.of_time)
    evaluate_forces(run, t, run.z)
    now.node += 1
    if not finite_state(run):  # the single march is to find out
        now.evaluations -= 1
        w[L.most, lane] = -1.0
        return
    now.crossed = now.node
    forget_step_memory(run, w, lane)
    w[L.weighs, lane] = 1.0
    for i in range(run.y.shape[0]):
        y[i, lane] = run.z[i]
    for k in range(run.of_time.shape[0]):
        piece_index = 3 * run.of_time[k] + 2
        pieces[piece_index, lane] = run.places[piece_index]
    aim_behind(run, w, lane)


@jit_uncounted
def march_singly(
    run: Run, march_at: Any, address: Any, member: int, lane_counters: IntArray, keeping: Any, steps: int
) -> None:
    """Make steps by the single march, and further ones while forces change at a node, or contacts hold.

    Also after a step with an event: another is often near, and entering and leaving a lane costs five steps.
    """
    now, first, room = run.now[0], run.now[0].rows, keeping[1].shape[0] - run.log_flags.shape[1]
    met = now.events
    march_by(march_at, address, steps)
    while now.status == RUNNING and (now.events > met or needs_single_march(run)) and has_room(run):
        keep_single_rows(run, first, member, lane_counters, keeping)
        first, met = now.rows, now.events
        if keeping[0].shape[0] > 0 and lane_counters[ROWS] > room:
            return
        rebase(run)
        march_by(march_at, address, 1)
    keep_single_rows(run, first, member, lane_counters, keeping)


@jit_uncounted
def store_run_results(run: Run, member: int, results: Any) -> None:
    """Store the results of a finished run."""
    ends, lasts, largest, passed = results
    keep_last(run, lasts, member)
    ends[member] = run.now[0]
    for i in range(largest.shape[1]):
        largest[member, i] = run.largest[i]
    keep_smooth_passages(run, passed, member)
