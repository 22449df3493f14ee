"""Many runs side by side: each in a lane of vector code, which takes the next run when its own ends.

`kernels.lane_step` makes ordinary steps in all lanes at once. Any other step is made by the run's own `Run` in the
single march, from the same state, and the lane goes on after it: so each run is the same, to the bit, as alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import borrowing
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.lane_step import LANE
from xdynamics.kernels.program import REGIME, T1, H, T
from xdynamics.march.contacts.projection import choose
from xdynamics.march.entries import begin, keep_last, keep_passed, stand
from xdynamics.march.force_evaluation import evaluate, finite_state
from xdynamics.march.handle import march_by, run_at, strode_by
from xdynamics.march.implicit.lanes import begin_anew, enter_kept, leave_kept
from xdynamics.march.log import has_room, note
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.run import MOVED, Run
from xdynamics.model.detectors import GAP
from xdynamics.schema import NODE, STEP

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Flags = NDArray[np.int8]
Blocks = NDArray[np.float64]  # of three dimensions
FlagBlocks = NDArray[np.int8]
Records = NDArray[Any]

(
    L_T,
    L_H,
    L_NORM,
    L_TRIED,
    L_STEP,
    L_STEP_LOG,
    L_REJECTED,
    L_GRID,
    L_ON_GRID,
    L_DONE,
    L_ACCEPTED,
    L_MOST,
    L_LIVES,
    L_NODE,
    L_SNAP,
    L_INNER,
    L_LANDED,
    L_START,
    L_STEP_SIZE,
    L_RTOL,
    L_FLOOR,
    L_REST,
    L_ORDER,
    L_SAFETY,
    L_LEAST,
    L_GREATEST,
    L_MIN_STEP,
    L_MAX_STEP,
    L_ORDINARY,
) = range(len(LANE))
NONE = -1  # no run is in the lane
LIVING, FOLLOWING, EVENTS, ROWS = range(4)  # of `standing`: lanes with a run, next run, events and rows handed out
OF_LANE, OF_STATE, OF_NOTED = range(3)  # where a lane holds a number of a row: in `w`, in `y`, in `noted`


def march_lanes(
    addresses: Whole,
    march_at: Any,
    stride_at: Any,
    table: Whole,
    at: Floats,
    y: Floats,
    before: Floats,
    p: Floats,
    pieces: Whole,
    z: Floats,
    w: Floats,
    members: Whole,
    standing: Whole,
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
    owners: Whole,
    noted: Floats,
    columns: Whole,
    rows: Blocks,
    flags: FlagBlocks,
    row_owners: Whole,
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
    at, y, before, p, z, w : ndarray, shape (…, lanes)
        `before` is the state before the last node.
    pieces : ndarray of int, shape (…, lanes)
    members : ndarray of int, shape (lanes,)
        The run in each lane.
    standing : ndarray of int, shape (4,)
        `LIVING`, `FOLLOWING`, `EVENTS`, `ROWS`.
    plans, starts, parameters, atols, ends, lasts, largest, passed
        Of the runs, as for `entries.march_many`.
    met, rates, impulses, owners
        Events in the order of their location, and the run of each.
    noted : ndarray, shape (…, lanes)
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
    lanes, lands, keeps = addresses.shape[0], run_at(addresses[0]).nodes.shape[0] > 0, columns.shape[0] > 0
    blocks, inputs, results = (
        (at, y, before, p, pieces, w),
        (plans, starts, parameters, atols),
        (ends, lasts, largest, passed),
    )
    events, keeping = (met, rates, impulses, owners), (columns, rows, flags, row_owners)
    while standing[LIVING] > 0:
        for lane in range(lanes):
            if w[L_ORDINARY, lane] == 0.0:
                if not serve(
                    addresses[lane], march_at, lane, members, standing, blocks, inputs, results, events, keeping
                ):
                    return False
                reached[lane] = w[L_T, lane]
                run = run_at(addresses[lane])
                for k in range(marks.shape[0]):
                    marks[k, lane] = run.log_flags[k, max(0, run.now[0].rows - 1 - run.base[0].rows)]
        if keeps and standing[ROWS] == rows.shape[0]:
            return False
        if standing[LIVING] > 0:
            strode_by(stride_at, table.ctypes.data, y.ctypes.data, z.ctypes.data, noted.ctypes.data)
            if keeps:
                take(standing, members, reached, marks, y, w, noted, keeping)
            if lands or keeps:
                for lane in range(lanes):
                    moved, reached[lane] = w[L_T, lane] != reached[lane], w[L_T, lane]
                    if moved and w[L_LANDED, lane] != 0.0:
                        cross(run_at(addresses[lane]), y, before, pieces, w, lane)
    return True


@borrowing
def serve(
    address: Any,
    march_at: Any,
    lane: int,
    members: Whole,
    standing: Whole,
    blocks: Any,
    given: Any,
    results: Any,
    events: Any,
    keeping: Any,
) -> bool:
    """Make a lane's step by the single march, and start the next run where one is over; False if there is no room."""
    run, (_, y, before, _, _, w) = run_at(address), blocks
    if lacks_room(run, len(members), standing, events, keeping):
        return False
    if members[lane] != NONE:
        leave(run, y, before, w, lane)
        go_on(run, march_at, address, members[lane], standing, keeping)
        hand_out(run, members[lane], standing, events)
    while members[lane] == NONE or run.now[0].status != RUNNING:
        if members[lane] != NONE:
            close(run, members[lane], results)
        members[lane] = NONE
        if lacks_room(run, 1, standing, events, keeping):
            return False
        if standing[FOLLOWING] == given[1].shape[0]:
            standing[LIVING] -= 1
            w[L_LIVES, lane], w[L_ORDINARY, lane] = 0.0, 1.0
            return True
        members[lane] = standing[FOLLOWING]
        begin(run, given[0], given[1], given[2], given[3], members[lane])
        base = run.base[0]
        base.rows, base.trials, base.events, base.samples = 0, 0, 0, 0
        go_on(run, march_at, address, members[lane], standing, keeping)
        hand_out(run, members[lane], standing, events)
        standing[FOLLOWING] += 1
    enter(run, blocks, lane)
    return True


@borrowing
def lacks_room(run: Run, lanes: int, standing: Whole, events: Any, keeping: Any) -> bool:
    """Whether there is too little room for the events of some lanes, or for rows that the single march may write."""
    if standing[EVENTS] + lanes * run.log_events.shape[0] > events[0].shape[0]:
        return True
    return keeping[0].shape[0] > 0 and standing[ROWS] + run.log_rows.shape[1] + 2 > keeping[1].shape[0]


@borrowing
def cross(run: Run, y: Floats, before: Floats, pieces: Whole, w: Floats, lane: int) -> None:
    """After a node, put the far side's forces into a lane, as in `loop.cross_node`; `before` keeps the near side."""
    now, t = run.now[0], w[L_T, lane]
    for i in range(run.y.shape[0]):
        before[i, lane] = run.z[i] = y[i, lane]
    enter_pieces(t, run.tables, run.places, run.of_time)
    evaluate(run, t, run.z)
    now.node += 1
    if not finite_state(run):  # the single march is to find out
        now.evaluations -= 1
        w[L_MOST, lane] = -1.0
        return
    now.crossed = now.node
    begin_anew(run, w, lane)
    for i in range(run.y.shape[0]):
        y[i, lane] = run.z[i]
    for k in range(run.of_time.shape[0]):
        place = 3 * run.of_time[k] + 2
        pieces[place, lane] = run.places[place]
    aim_behind(run, w, lane)


@borrowing
def aim_behind(run: Run, w: Floats, lane: int) -> None:
    """Give a lane its next node."""
    now = run.now[0]
    inner = now.node < run.nodes.shape[0]
    w[L_NODE, lane], w[L_SNAP, lane] = run.nodes[now.node] if inner else run.plan[0].end, run.snaps[now.node]
    w[L_INNER, lane] = 1.0 if inner else 0.0


@borrowing
def take(
    standing: Whole, members: Whole, reached: Floats, marks: Flags, y: Floats, w: Floats, noted: Floats, keeping: Any
) -> None:
    """Keep the rows after a step in all lanes; the row of a lane that did not move belongs to no run."""
    to, lanes, (columns, rows, flags, owners) = standing[ROWS], members.shape[0], keeping
    for k in range(columns.shape[0]):
        place = columns[k, 2]
        if columns[k, 1] == OF_STATE:
            for lane in range(lanes):
                rows[to, k, lane] = y[place, lane]
        elif columns[k, 1] == OF_LANE:
            for lane in range(lanes):
                rows[to, k, lane] = w[place, lane]
        else:
            for lane in range(lanes):
                rows[to, k, lane] = noted[place, lane]
    for lane in range(lanes):
        flags[to, 0, lane] = NODE if w[L_LANDED, lane] != 0.0 else STEP
        owners[to, lane] = members[lane] if w[L_T, lane] != reached[lane] else NONE
    for k in range(1, flags.shape[1]):
        for lane in range(lanes):
            flags[to, k, lane] = marks[k, lane]
    standing[ROWS] += 1


@borrowing
def take_noted(run: Run, first: int, member: int, standing: Whole, keeping: Any) -> None:
    """Keep the rows that the single march wrote, from row `first` on."""
    columns, rows, flags, owners = keeping
    if columns.shape[0] == 0:
        return
    for row in range(first - run.base[0].rows, run.now[0].rows - run.base[0].rows):
        to = standing[ROWS]
        for k in range(columns.shape[0]):
            rows[to, k, 0] = run.log_rows[columns[k, 0], row]
        for k in range(flags.shape[1]):
            flags[to, k, 0] = run.log_flags[k, row]
        for lane in range(owners.shape[1]):
            owners[to, lane] = NONE
        owners[to, 0] = member
        standing[ROWS] += 1


@borrowing
def hand_out(run: Run, member: int, standing: Whole, events: Any) -> None:
    """Move the events out of a run's log, and record the run that they belong to."""
    now, base, (met, rates, impulses, owners) = run.now[0], run.base[0], events
    for k in range(now.events - base.events):
        to = standing[EVENTS]
        met[to] = run.log_events[k]
        for i in range(rates.shape[0]):
            rates[i, to] = run.log_rates[i, k]
        for i in range(impulses.shape[0]):
            impulses[i, to] = run.log_impulses[i, k]
        owners[to] = member
        standing[EVENTS] += 1
    base.events = now.events


@borrowing
def go_on(run: Run, march_at: Any, address: Any, member: int, standing: Whole, keeping: Any) -> None:
    """Make a step by the single march, and further ones while forces change at a node, or contacts hold.

    Also after a step with an event: another is often near, and entering and leaving a lane costs five steps.
    """
    now, first, room = run.now[0], run.now[0].rows, keeping[1].shape[0] - run.log_rows.shape[1]
    met = now.events
    march_by(march_at, address, 1)
    while now.status == RUNNING and (now.events > met or waits(run)) and has_room(run):
        take_noted(run, first, member, standing, keeping)
        first, met = now.rows, now.events
        if keeping[0].shape[0] > 0 and standing[ROWS] > room:
            return
        rebase(run)
        march_by(march_at, address, 1)
    take_noted(run, first, member, standing, keeping)


@borrowing
def waits(run: Run) -> bool:
    """Whether forces are to be evaluated after a node, or a contact or friction holds the state after every step."""
    return run.now[0].crossed != run.now[0].node or (run.touches.shape[0] > 0 and choose(run, True) > 0)


@borrowing
def rebase(run: Run) -> None:
    """Let the log begin with the row last written."""
    now, base = run.now[0], run.base[0]
    last = now.rows - 1 - base.rows
    for i in range(run.log_rows.shape[0]):
        run.log_rows[i, 0] = run.log_rows[i, last]
    for i in range(run.log_flags.shape[0]):
        run.log_flags[i, 0] = run.log_flags[i, last]
    base.rows, base.trials, base.samples = now.rows - 1, now.trials, now.samples


@borrowing
def enter(run: Run, blocks: Any, lane: int) -> None:
    """Put a run into a lane, from its current state."""
    now, plan, used, (at, y, _, p, pieces, w) = run.now[0], run.plan[0], run.plan[0].used, blocks
    w[L_T, lane], w[L_H, lane], w[L_NORM, lane], w[L_TRIED, lane] = now.t, now.h, now.norm, now.norm
    w[L_STEP, lane], w[L_STEP_LOG, lane], w[L_REJECTED, lane] = now.step, now.step_log, float(now.rejected)
    w[L_GRID, lane], w[L_ON_GRID, lane] = float(now.grid), float(now.on_grid)
    w[L_DONE, lane], w[L_ACCEPTED, lane], w[L_MOST, lane] = float(now.rows + now.trials), 0.0, plan.most_steps
    aim_behind(run, w, lane)
    w[L_LANDED, lane] = 0.0
    w[L_START, lane], w[L_STEP_SIZE, lane], w[L_RTOL, lane] = plan.start, plan.step_size, plan.rtol
    w[L_FLOOR, lane], w[L_REST, lane] = plan.floor, plan.rest
    w[L_ORDER, lane], w[L_SAFETY, lane] = plan.order, plan.safety
    w[L_LEAST, lane], w[L_GREATEST, lane] = plan.least, plan.greatest
    w[L_MIN_STEP, lane], w[L_MAX_STEP, lane] = plan.min_step, plan.max_step
    w[L_LIVES, lane], w[L_ORDINARY, lane] = 1.0, 1.0
    if waits(run):
        w[L_MOST, lane] = -1.0  # not a step for a lane
    lend(run, at, y, p, pieces, lane)
    first = L_ORDINARY + 1
    for i in range(used):
        w[first + i, lane], w[first + used + i, lane] = run.atol[i], run.largest[i]
        w[first + 2 * used + i, lane] = run.e[i]
    watch_sides(run, w, first + 3 * used, lane)
    first = enter_kept(run, w, lane)
    for i in range(w.shape[0] - first):  # of switches declared smooth
        w[first + i, lane] = run.w[run.w.shape[0] - (w.shape[0] - first) + i]


@borrowing
def watch_sides(run: Run, w: Floats, first: int, lane: int) -> None:
    """Give a lane the side of zero on which each event function has to stay, and the largest gaps."""
    events = run.detectors.shape[0]
    for i in range(events):
        watch = run.watches[i]
        side = watch.armed if watch.guard == 0 or watch.armed == watch.guard else 0
        w[first + i, lane] = 2.0 if watch.asleep else float(side)
        if run.detectors[i].role == GAP:
            w[first + events + i, lane] = run.touches[run.detectors[i].reaction].largest


@borrowing
def leave(run: Run, y: Floats, before: Floats, w: Floats, lane: int) -> None:
    """Take a run out of its lane, so that the single march goes on from its state; its last row is written."""
    now, plan, used = run.now[0], run.plan[0], run.plan[0].used
    accepted = np.int64(w[L_ACCEPTED, lane])
    rejected = np.int64(w[L_DONE, lane]) - now.rows - now.trials - accepted
    now.t, now.h, now.norm = w[L_T, lane], w[L_H, lane], w[L_NORM, lane]
    now.step, now.step_log, now.rejected = w[L_STEP, lane], w[L_STEP_LOG, lane], np.int64(w[L_REJECTED, lane])
    now.grid, now.on_grid = np.int64(w[L_GRID, lane]), np.int64(w[L_ON_GRID, lane])
    now.rows += accepted
    now.trials += rejected
    if not plan.simplified:
        now.evaluations += plan.stages * (accepted + rejected)
    first = L_ORDINARY + 1
    for i in range(run.y.shape[0]):
        run.y[i] = y[i, lane]
    for i in range(used):
        run.largest[i], run.e[i] = w[first + used + i, lane], w[first + 2 * used + i, lane]
    first += 3 * used + run.detectors.shape[0]
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].role == GAP:
            run.touches[run.detectors[i].reaction].largest = w[first + i, lane]
    first = leave_kept(run, w, lane)
    for i in range(w.shape[0] - first):
        run.w[run.w.shape[0] - (w.shape[0] - first) + i] = w[first + i, lane]
    if accepted == 0:
        rebase(run)
        return
    base = run.base[0]
    base.rows, base.trials, base.samples = now.rows - 1, now.trials, now.samples
    if not plan.simplified:
        run.kept[0].since, run.trial[0].iterations = MOVED, 0
    now.rows -= 1  # the last row is logged, and counted, now
    if w[L_LANDED, lane] != 0.0:  # with the forces before the node
        for i in range(run.y.shape[0]):
            run.z[i] = before[i, lane]
        note(run, NODE, now.t, now.h, run.z)
    else:
        note(run, STEP, now.t, now.h, run.y)
    now.norm = w[L_TRIED, lane]


@borrowing
def close(run: Run, member: int, results: Any) -> None:
    """Store the results of a finished run."""
    ends, lasts, largest, passed = results
    keep_last(run, lasts, member)
    ends[member] = run.now[0]
    for i in range(largest.shape[1]):
        largest[member, i] = run.largest[i]
    keep_passed(run, passed, member)


def gather_rows(
    rows: Blocks, flags: FlagBlocks, owners: Whole, columns: Whole, places: Whole, to_rows: Floats, to_flags: Flags
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


def parts_of_steps(
    address: Any,
    forces_at: Any,
    propose_at: Any,
    table: Whole,
    at: Floats,
    y: Floats,
    p: Floats,
    pieces: Whole,
    z: Floats,
    log: Floats,
    flags: Flags,
    parameters: Floats,
    factors: Floats,
    jobs: Whole,
    times: Floats,
    found: Floats,
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
    found : ndarray, shape (n, k)
        Filled, in units of the record.
    """
    run, lanes, n, scale = run_at(address), y.shape[1], found.shape[0], factors[0]
    ends, whose = np.zeros((3, lanes)), np.zeros(lanes, np.int64)
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
            for i in range(run.y.shape[0]):
                run.y[i] = log[2 + i, row] * factors[1 + i] / factors[1 + i] if i < n else 0.0
            stand(run, t)
            lend(run, at, y, p, pieces, filled)
            ends[0, filled], ends[1, filled], ends[2, filled] = t, time, (time - t) / (t1 - t) * h
            whose[filled] = k
            filled += 1
        else:
            for i in range(n):
                found[i, k] = log[2 + i, row] * factors[1 + i]
        if filled == lanes or (filled > 0 and k == times.shape[0] - 1):
            for lane in range(filled):
                at[T, lane] = ends[0, lane]
            strode_by(forces_at, table.ctypes.data, y.ctypes.data, y.ctypes.data, z.ctypes.data)
            for lane in range(filled):
                at[T, lane], at[T1, lane], at[H, lane] = ends[0, lane], ends[1, lane], ends[2, lane]
            strode_by(propose_at, table.ctypes.data, y.ctypes.data, z.ctypes.data, z.ctypes.data)
            for lane in range(filled):
                for i in range(n):
                    found[i, whose[lane]] = (z[i, lane] + 0.0) * factors[1 + i]
            filled = 0


@borrowing
def lend(run: Run, at: Floats, y: Floats, p: Floats, pieces: Whole, lane: int) -> None:
    """Put state, parameters and tables of a run into a lane."""
    at[REGIME, lane] = run.at[REGIME]
    for i in range(run.y.shape[0]):
        y[i, lane] = run.y[i]
    for i in range(run.p.shape[0]):
        p[i, lane] = run.p[i]
    for i in range(run.places.shape[0]):
        pieces[i, lane] = run.places[i]
