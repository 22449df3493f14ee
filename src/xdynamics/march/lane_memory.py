"""What a run is put into a lane with, and taken out of it with."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_uncounted
from xdynamics.kernels.lane_numbers import PLACES as L
from xdynamics.kernels.program import REGIME
from xdynamics.march.acceptance import pass_node
from xdynamics.march.contacts.projection import list_holding
from xdynamics.march.implicit.lanes import enter_step_memory, leave_step_memory
from xdynamics.march.log import append_row
from xdynamics.march.run import Run
from xdynamics.model.detectors import GAP
from xdynamics.schema import NODE, STEP

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


@jit_uncounted
def put_in_lane(run: Run, blocks: Any, lane: int) -> None:
    """Put a run into a lane, from its current state."""
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
    """Put state, parameters and tables of a run into a lane."""
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
    """Take a run out of its lane, complete, or so that the single march goes on from its state; its last row is written."""
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
