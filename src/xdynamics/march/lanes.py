"""Many runs side by side: each in a lane of vector code, which takes the next run when its own ends.

`kernels.lane_step` makes ordinary steps in all lanes at once. Any other step, and the start, is made by the run's
own `Run` in the single march, from the same state, and the lane goes on after it: so each run is the same, to the bit,
as alone.

Rows and events of runs side by side are stored in turn, then sorted into one run after the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_uncounted
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.lane_step import PLACES as L
from xdynamics.kernels.program import REGIME
from xdynamics.march.calls import march_by, run_at, strode_by
from xdynamics.march.contacts.delassus import list_holding
from xdynamics.march.control import pass_node
from xdynamics.march.engine_entries import begin_run, keep_last, keep_passages
from xdynamics.march.force_evaluation import evaluate_forces, finite_state
from xdynamics.march.implicit.radau import enter_step_memory, forget_step_memory, leave_step_memory
from xdynamics.march.log import append_row, has_room
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP
from xdynamics.schema import NODE, STEP

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


@jit_uncounted
def put_in_lane(run: Run, blocks: Any, lane: int) -> None:
    """Load a run into a lane, from its current state."""
    now, plan, used, (step_numbers, y, _, p, pieces, w) = run.now[0], run.plan[0], run.plan[0].used, blocks
    w[L.t, lane], w[L.h, lane], w[L.norm, lane], w[L.tried, lane] = now.t, now.h, now.norm, now.norm
    w[L.step, lane], w[L.step_log, lane], w[L.rejected, lane] = now.step, now.step_log, float(now.rejected)
    w[L.grid, lane], w[L.on_grid, lane] = float(now.grid), float(now.on_grid)
    w[L.done, lane], w[L.accepted, lane], w[L.most, lane] = float(now.rows + now.trials), 0.0, plan.most_steps
    aim_behind(run, w, lane)
    w[L.landed, lane] = 0.0
    w[L.start, lane], w[L.step_size, lane], w[L.rtol, lane] = plan.start, plan.step_size, plan.rtol
    w[L.floor, lane], w[L.rest, lane] = plan.floor, plan.rest
    w[L.rounding, lane], w[L.weighs, lane] = plan.rounding, float(run.kept[0].weighs)
    w[L.k, lane], w[L.safety, lane] = plan.order, plan.safety
    w[L.least, lane], w[L.greatest, lane] = plan.least, plan.greatest
    w[L.min_step, lane], w[L.max_step, lane], w[L.end, lane] = plan.min_step, plan.max_step, plan.end
    w[L.first_step, lane] = now.first_step
    w[L.lives, lane], w[L.ordinary, lane] = 1.0, 1.0
    if needs_single_march(run):
        w[L.most, lane] = -1.0  # not a step for a lane
    lend_to_lane(run, step_numbers, y, p, pieces, lane)
    first = L.ordinary + 1
    for i in range(used):
        w[first + i, lane], w[first + used + i, lane] = run.atol[i], run.largest[i]
        w[first + 2 * used + i, lane] = run.e[i]
    watch_sides(run, w, first + 3 * used, lane)
    first = enter_step_memory(run, w, lane)
    for i in range(w.shape[0] - first):  # of switches declared smooth
        w[first + i, lane] = run.w[run.w.shape[0] - (w.shape[0] - first) + i]


@jit_uncounted
def watch_sides(run: Run, w: Floats, first: int, lane: int) -> None:
    """Give a lane the side of zero on which each event function has to stay, and the largest gaps."""
    events = run.detectors.shape[0]
    for i in range(events):
        watch = run.watches[i]
        side = watch.armed if watch.guard == 0 or watch.armed == watch.guard else 0
        w[first + i, lane] = 2.0 if watch.asleep else float(side)
        if run.detectors[i].role == GAP:
            w[first + events + i, lane] = run.touches[run.detectors[i].reaction].largest


@jit_uncounted
def aim_behind(run: Run, w: Floats, lane: int) -> None:
    """Give a lane its next node."""
    now = run.now[0]
    inner = now.node < run.nodes.shape[0]
    w[L.node, lane], w[L.snap, lane] = run.nodes[now.node] if inner else run.plan[0].end, run.snaps[now.node]
    w[L.inner, lane] = 1.0 if inner else 0.0


@jit_uncounted
def lend_to_lane(run: Run, step_numbers: Floats, y: Floats, p: Floats, pieces: IntArray, lane: int) -> None:
    """Load state, parameters and tables of a run into a lane."""
    step_numbers[REGIME, lane] = run.at[REGIME]
    for i in range(run.y.shape[0]):
        y[i, lane] = run.y[i]
    for i in range(run.p.shape[0]):
        p[i, lane] = run.p[i]
    for i in range(run.places.shape[0]):
        pieces[i, lane] = run.places[i]


@jit_uncounted
def needs_single_march(run: Run) -> bool:
    """Whether forces are to be evaluated after a node, or a contact or friction holds the state after every step."""
    return run.now[0].crossed != run.now[0].node or (run.touches.shape[0] > 0 and list_holding(run, True) > 0)


@jit_uncounted
def take_out_of_lane(run: Run, y: Floats, states_before: Floats, w: Floats, lane: int) -> None:
    """Unload a run from its lane, finished or for the single march to continue; its last row is written."""
    now, used = run.now[0], run.plan[0].used
    accepted = np.int64(w[L.accepted, lane])
    rejected = np.int64(w[L.done, lane]) - now.rows - now.trials - accepted
    now.t, now.h, now.norm = w[L.t, lane], w[L.h, lane], w[L.norm, lane]
    now.step, now.step_log, now.rejected = w[L.step, lane], w[L.step_log, lane], np.int64(w[L.rejected, lane])
    run.kept[0].weighs = np.int64(w[L.weighs, lane])
    now.first_step = w[L.first_step, lane]
    now.grid, now.on_grid = np.int64(w[L.grid, lane]), np.int64(w[L.on_grid, lane])
    now.rows += accepted
    now.trials += rejected
    first = L.ordinary + 1
    for i in range(run.y.shape[0]):
        run.y[i] = y[i, lane]
    for i in range(used):
        run.largest[i], run.e[i] = w[first + used + i, lane], w[first + 2 * used + i, lane]
    first += 3 * used + run.detectors.shape[0]
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].role == GAP:
            run.touches[run.detectors[i].reaction].largest = w[first + i, lane]
    first = leave_step_memory(run, w, lane, accepted, rejected)
    for i in range(w.shape[0] - first):
        run.w[run.w.shape[0] - (w.shape[0] - first) + i] = w[first + i, lane]
    if accepted == 0:
        rebase(run)
        return
    base = run.base[0]
    base.rows, base.trials, base.samples = now.rows - 1, now.trials, now.samples
    now.rows -= 1  # the last row is logged, and counted, now
    if w[L.landed, lane] != 0.0:  # with the forces before the node
        for i in range(run.y.shape[0]):
            run.z[i] = states_before[i, lane]
        append_row(run, NODE, now.t, now.h, run.z)
    else:
        append_row(run, STEP, now.t, now.h, run.y)
    now.norm = w[L.tried, lane]
    if w[L.inner, lane] == 0.0 and now.t == w[L.node, lane]:
        pass_node(run)


@jit_uncounted
def rebase(run: Run) -> None:
    """Let the log begin with the row last written."""
    now, base = run.now[0], run.base[0]
    last = now.rows - 1 - base.rows
    for i in range(run.log_rows.shape[0]):
        run.log_rows[i, 0] = run.log_rows[i, last]
    for i in range(run.log_flags.shape[0]):
        run.log_flags[i, 0] = run.log_flags[i, last]
    base.rows, base.trials, base.samples = now.rows - 1, now.trials, now.samples


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
    """Sort the interleaved rows of many runs into one run after the other.

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
    """After a node, load the far side's forces into a lane, as `loop.cross_node` does; near side in `states_before`."""
    now, t = run.now[0], w[L.t, lane]
    for i in range(run.y.shape[0]):
        states_before[i, lane] = run.z[i] = y[i, lane]
    enter_pieces(t, run.tables, run.places, run.of_time)
    evaluate_forces(run, t, run.z)
    now.node += 1
    if not finite_state(run):  # the single march is to find out
        # which evaluates these forces again, and counts them
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
    keep_passages(run, passed, member)
