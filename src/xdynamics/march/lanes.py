"""Many runs side by side: each in a lane of vector code, which takes the next run when its own is over.

`kernels.striding` makes ordinary steps in all lanes at once. Whatever else a step is, a run's own `Run` makes by the
single march, from the same state, and the lane goes on behind it: so each run has the bits that it has alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import shared
from xdynamics.kernels.program import REGIME
from xdynamics.kernels.striding import LANE
from xdynamics.march.contacts.holding import choose
from xdynamics.march.entries import begin, keep_last, keep_passed
from xdynamics.march.handle import march_by, run_at, strode_by
from xdynamics.march.log import has_room, note
from xdynamics.march.outcomes import RUNNING
from xdynamics.march.run import MOVED, Run
from xdynamics.model.detectors import GAP
from xdynamics.schema import STEP

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]
Records = NDArray[Any]

(
    L_T, L_H, L_NORM, L_TRIED, L_STEP, L_STEP_LOG, L_REJECTED, L_GRID, L_ON_GRID, L_DONE, L_ACCEPTED, L_MOST, L_LIVES,
    L_NODE, L_SNAP, L_START, L_STEP_SIZE, L_RTOL, L_FLOOR, L_REST, L_ORDER, L_SAFETY, L_LEAST, L_GREATEST, L_MIN_STEP, L_MAX_STEP, L_ORDINARY,
) = range(len(LANE))  # fmt: skip
NONE = -1  # no run is in the lane
LIVING, FOLLOWING, EVENTS = range(3)  # of `standing`: lanes with a run, the next run, events that were handed out


def march_lanes(addresses: Whole, march_at: Any, stride_at: Any, table: Whole, at: Floats, y: Floats, p: Floats, pieces: Whole, z: Floats, w: Floats, members: Whole, standing: Whole, plans: Records, starts: Floats, parameters: Floats, atols: Floats, ends: Records, lasts: Floats, largest: Floats, passed: Floats, met: Records, rates: Floats, impulses: Floats, owners: Whole) -> bool:  # fmt: skip
    """March runs from their starts and parameters to their ends.

    Parameters
    ----------
    addresses : ndarray of int, shape (lanes,)
        Of a `Run` for each lane.
    march_at, stride_at : int
        Addresses of the compiled `loop.march`, and of a step in all lanes.
    table : ndarray of int
        Where the step finds the arrays that follow.
    at, y, p, z, w : ndarray, shape (…, lanes)
    pieces : ndarray of int, shape (…, lanes)
    members : ndarray of int, shape (lanes,)
        Which run is in which lane.
    standing : ndarray of int, shape (3,)
        `LIVING`, `FOLLOWING`, `EVENTS`.
    plans, starts, parameters, atols, ends, lasts, largest, passed
        Of the runs, as for `entries.march_many`.
    met, rates, impulses, owners
        Events as they come, and which run each is of.

    Returns
    -------
    bool
        Whether all are over; else there is no room for events, which are to be taken out.
    """
    lanes = addresses.shape[0]
    while standing[LIVING] > 0:
        for lane in range(lanes):
            if w[L_ORDINARY, lane] != 0.0:
                continue
            run = run_at(addresses[lane])
            if standing[EVENTS] + lanes * run.log_events.shape[0] > met.shape[0]:
                return False
            if members[lane] != NONE:
                leave(run, y, w, lane)
                go_on(run, march_at, addresses[lane])
                hand_out(run, members[lane], standing, met, rates, impulses, owners)
            while members[lane] == NONE or run.now[0].status != RUNNING:
                if members[lane] != NONE:
                    close(run, members[lane], ends, lasts, largest, passed)
                members[lane] = NONE
                if standing[EVENTS] + run.log_events.shape[0] > met.shape[0]:
                    return False
                if standing[FOLLOWING] == starts.shape[0]:
                    break
                members[lane] = standing[FOLLOWING]
                begin(run, plans, starts, parameters, atols, members[lane])
                base = run.base[0]
                base.rows, base.trials, base.events, base.samples = 0, 0, 0, 0
                go_on(run, march_at, addresses[lane])
                hand_out(run, members[lane], standing, met, rates, impulses, owners)
                standing[FOLLOWING] += 1
            if members[lane] != NONE:
                enter(run, at, y, p, pieces, w, lane)
            else:
                standing[LIVING] -= 1
                w[L_LIVES, lane], w[L_ORDINARY, lane] = 0.0, 1.0
        if standing[LIVING] > 0:
            strode_by(stride_at, table.ctypes.data, y.ctypes.data, z.ctypes.data, z.ctypes.data)
    return True


@shared
def hand_out(run: Run, member: int, standing: Whole, met: Records, rates: Floats, impulses: Floats, owners: Whole) -> None:  # fmt: skip
    """Take the events out of a run's log, and note whose they are."""
    now, base = run.now[0], run.base[0]
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


@shared
def go_on(run: Run, march_at: Any, address: Any) -> None:
    """Make a step by the single march, and further ones where forces are other ones behind a node, or contacts hold."""
    march_by(march_at, address, 1)
    while run.now[0].status == RUNNING and waits(run) and has_room(run):
        rebase(run)
        march_by(march_at, address, 1)


@shared
def waits(run: Run) -> bool:
    """Whether forces are to be evaluated behind a node, or a contact or friction holds the state, behind every step."""
    return run.now[0].crossed != run.now[0].node or (run.touches.shape[0] > 0 and choose(run, True) > 0)


@shared
def rebase(run: Run) -> None:
    """Let the log begin with the last row that was written."""
    now, base = run.now[0], run.base[0]
    last = now.rows - 1 - base.rows
    for i in range(run.log_rows.shape[0]):
        run.log_rows[i, 0] = run.log_rows[i, last]
    for i in range(run.log_flags.shape[0]):
        run.log_flags[i, 0] = run.log_flags[i, last]
    base.rows, base.trials, base.samples = now.rows - 1, now.trials, now.samples


@shared
def enter(run: Run, at: Floats, y: Floats, p: Floats, pieces: Whole, w: Floats, lane: int) -> None:
    """Put a run into a lane, from where it stands."""
    now, plan, used = run.now[0], run.plan[0], run.plan[0].used
    inner = now.node < run.nodes.shape[0]
    w[L_T, lane], w[L_H, lane], w[L_NORM, lane], w[L_TRIED, lane] = now.t, now.h, now.norm, now.norm
    w[L_STEP, lane], w[L_STEP_LOG, lane], w[L_REJECTED, lane] = now.step, now.step_log, float(now.rejected)
    w[L_GRID, lane], w[L_ON_GRID, lane] = float(now.grid), float(now.on_grid)
    w[L_DONE, lane], w[L_ACCEPTED, lane], w[L_MOST, lane] = float(now.rows + now.trials), 0.0, plan.most_steps
    w[L_NODE, lane], w[L_SNAP, lane] = run.nodes[now.node] if inner else plan.end, run.snaps[now.node]
    w[L_START, lane], w[L_STEP_SIZE, lane], w[L_RTOL, lane] = plan.start, plan.step_size, plan.rtol
    w[L_FLOOR, lane], w[L_REST, lane] = plan.floor, plan.rest
    w[L_ORDER, lane], w[L_SAFETY, lane] = plan.order, plan.safety
    w[L_LEAST, lane], w[L_GREATEST, lane] = plan.least, plan.greatest
    w[L_MIN_STEP, lane], w[L_MAX_STEP, lane] = plan.min_step, plan.max_step
    w[L_LIVES, lane], w[L_ORDINARY, lane] = 1.0, 1.0
    if waits(run):
        w[L_MOST, lane] = -1.0  # no step of a lane
    at[REGIME, lane] = run.at[REGIME]
    for i in range(run.y.shape[0]):
        y[i, lane] = run.y[i]
    for i in range(run.p.shape[0]):
        p[i, lane] = run.p[i]
    for i in range(run.places.shape[0]):
        pieces[i, lane] = run.places[i]
    first = L_ORDINARY + 1
    for i in range(used):
        w[first + i, lane], w[first + used + i, lane] = run.atol[i], run.largest[i]
        w[first + 2 * used + i, lane] = run.e[i]
    watch_sides(run, w, first + 3 * used, lane)
    first += 3 * used + 2 * run.detectors.shape[0]
    for i in range(w.shape[0] - first):  # of switches that were declared smooth
        w[first + i, lane] = run.w[run.w.shape[0] - (w.shape[0] - first) + i]


@shared
def watch_sides(run: Run, w: Floats, first: int, lane: int) -> None:
    """Tell a lane on which side of zero each event function is to stay, and how large gaps were."""
    events = run.detectors.shape[0]
    for i in range(events):
        watch = run.watches[i]
        side = watch.armed if watch.guard == 0 or watch.armed == watch.guard else 0
        w[first + i, lane] = 2.0 if watch.asleep else float(side)
        if run.detectors[i].role == GAP:
            w[first + events + i, lane] = run.touches[run.detectors[i].reaction].largest


@shared
def leave(run: Run, y: Floats, w: Floats, lane: int) -> None:
    """Take a run out of its lane, so that the single march goes on from where it stands; its last row is written."""
    now, plan, used = run.now[0], run.plan[0], run.plan[0].used
    accepted = np.int64(w[L_ACCEPTED, lane])
    rejected = np.int64(w[L_DONE, lane]) - now.rows - now.trials - accepted
    now.t, now.h, now.norm = w[L_T, lane], w[L_H, lane], w[L_NORM, lane]
    now.step, now.step_log, now.rejected = w[L_STEP, lane], w[L_STEP_LOG, lane], np.int64(w[L_REJECTED, lane])
    now.grid = np.int64(w[L_GRID, lane])
    now.rows += accepted
    now.trials += rejected
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
    first += run.detectors.shape[0]
    for i in range(w.shape[0] - first):
        run.w[run.w.shape[0] - (w.shape[0] - first) + i] = w[first + i, lane]
    if accepted == 0:
        rebase(run)
        return
    base = run.base[0]
    base.rows, base.trials, base.samples = now.rows - 1, now.trials, now.samples
    run.kept[0].since, run.trial[0].iterations = MOVED, 0
    now.rows -= 1  # the last row is noted, and counted, now
    note(run, STEP, now.t, now.h, run.y)
    now.norm = w[L_TRIED, lane]


@shared
def close(run: Run, member: int, ends: Records, lasts: Floats, largest: Floats, passed: Floats) -> None:
    """Keep what became of a run that is over."""
    keep_last(run, lasts, member)
    ends[member] = run.now[0]
    for i in range(largest.shape[1]):
        largest[member, i] = run.largest[i]
    keep_passed(run, passed, member)
