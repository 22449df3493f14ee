"""The time loop: aim, propose, judge, reject or locate and accept, note.

Plain Python that numba compiles together with the functions of one model and one method; see `march.interface`.
"""

from __future__ import annotations

from math import nan

import numpy as np

from xdynamics.march.control import STRETCH, accepts, first_step, grown, reduced, shortest
from xdynamics.march.events import crosses, crosses_any, locate
from xdynamics.march.finite import all_finite
from xdynamics.march.interface import (
    DOMAIN_LIMITED,
    ESTIMATES,
    EVENTFUL,
    NO_ERROR,
    Effort,
    State,
    begin,
    detect,
    error_norm,
    note,
    pieces_at,
    propose,
    slopes,
)
from xdynamics.march.log import MOST_SUBSTEPS, Log, Memory, Pace, Plan, Tally, Trial, note_trial
from xdynamics.march.outcomes import (
    COMPLETED,
    ERROR_AT_MINIMUM,
    NONFINITE,
    NONFINITE_EVENT,
    NONFINITE_OBSERVABLE,
    RUNNING,
    STEP_LIMIT,
    STEP_TOO_SMALL,
    STOPPED,
    UNSOLVED,
)
from xdynamics.schema import (
    CROSSING,
    EVENT_AFTER,
    EVENT_BEFORE,
    INITIAL,
    NODE,
    REASON_DOMAIN,
    REASON_ERROR,
    REASON_EVENT,
    REASON_NEWTON,
    REASON_NONFINITE,
    STEP,
)

AT_GRID, AT_NODE, AT_BOTH = 1, 2, 3


def march(plan: Plan, memory: Memory, log: Log, base: Tally, pause: int) -> Memory:
    """March until the log is full, `pause` rows are written, or the run ends.

    Parameters
    ----------
    plan : Plan
    memory : Memory
        Where the march stands; with no rows yet, it begins.
    log : Log
        Blocks that are filled from the start.
    base : Tally
        The tally at the log's first row.
    pause : int
        Rows after which to return.

    Returns
    -------
    Memory
        With status RUNNING where the march can go on.
    """
    if memory.tally.rows == 0:
        memory = _start(plan, memory, log)
    paused = memory.tally.rows + pause
    while memory.status == RUNNING and memory.tally.rows < paused and _has_room(plan, log, base, memory.tally):
        target, h, landing = _aim(plan, memory)
        if not (memory.t + h > memory.t and target > memory.t):
            return _ended(memory, STEP_TOO_SMALL, h, memory.state, memory.values)
        if memory.tally.rows + memory.tally.trials > plan.control.most_steps:
            return _ended(memory, STEP_LIMIT, h, memory.state, memory.values)
        node = memory.node
        trial = _attempt(plan, memory, log, base, target, h, landing)
        verdict, norm = _judge(plan, memory, trial)
        memory = _worked(memory, norm, trial.effort)
        if verdict != RUNNING:
            memory = _reject(plan, memory, log, base, trial, verdict)
        elif EVENTFUL and crosses_any(plan.directions, memory.values, trial.values):
            if EVENTFUL:  # a branch on a constant alone is not even compiled
                memory = _land_on_event(plan, memory, log, base, trial)
        else:
            memory = _accept(plan, memory, log, base, trial)
        if memory.status == RUNNING and memory.node != node:
            memory = _cross_node(plan, memory, log, base)
    return memory


def _start(plan: Plan, memory: Memory, log: Log) -> Memory:
    """Evaluate and note the initial state; choose the first step."""
    t, p, tables = memory.t, plan.parameters, plan.tables
    pieces = pieces_at(t, tables)
    state, samples = begin(t, memory.state, p, tables, pieces, log, 0, 0)
    values = detect(t, state, p, tables, pieces)
    noted = note(log, 0, t, 0.0, INITIAL, state, 0.0, NO_ERROR, 0, p, tables, pieces)
    status = NONFINITE if not all_finite(state) else RUNNING if all_finite(values) else NONFINITE_EVENT
    if status == RUNNING and not noted:
        status = NONFINITE_OBSERVABLE
    pace, evaluations = memory.pace, 1
    memory = Memory(
        status, t, 0.0, 0, 0, True, state, state, values, pieces, 0.0, pace, evaluations, Tally(1, 0, 0, samples)
    )
    if not (ESTIMATES and plan.control.adaptive and status == RUNNING):
        return memory
    first = plan.control.first
    if first == 0.0:
        first = first_step(plan, memory, state, log)
        evaluations += 1
        samples += samples
    pace = Pace(first, 1.0, False, first)
    return Memory(
        status, t, 0.0, 0, 0, True, state, state, values, pieces, 0.0, pace, evaluations, Tally(1, 0, 0, samples)
    )


def _has_room(plan: Plan, log: Log, base: Tally, tally: Tally) -> bool:
    """Whether one more step, with every event and node it may hold, fits the blocks."""
    events = log.lows.shape[0]
    return (
        tally.rows - base.rows + 2 <= log.rows.shape[1]
        and tally.trials - base.trials + events * MOST_SUBSTEPS + 1 <= log.trials.shape[1]
        and tally.events - base.events + events <= log.events.shape[1]
        and tally.samples - base.samples + plan.sampled + 1 <= log.samples.shape[1]
    )


def _aim(plan: Plan, memory: Memory) -> tuple[float, float, int]:
    """Choose where the next step ends: a grid time or an earlier node; the step; what is landed on."""
    node_time = plan.nodes[memory.node]
    if ESTIMATES and plan.control.adaptive:
        return _aim_freely(plan, memory, node_time)
    if plan.step_size > 0.0:
        grid_time, step = plan.start + (memory.grid + 1) * plan.step_size, plan.step_size
    elif memory.grid < plan.grid.shape[0]:
        grid_time, step = plan.grid[memory.grid], plan.steps[memory.grid]
    else:
        return node_time, node_time - memory.t, AT_NODE
    if node_time > grid_time + plan.snap:
        return grid_time, step if memory.on_grid else grid_time - memory.t, AT_GRID
    if node_time >= grid_time - plan.snap:
        return node_time, step if memory.on_grid else node_time - memory.t, AT_BOTH
    return node_time, node_time - memory.t, AT_NODE


def _aim_freely(plan: Plan, memory: Memory, node_time: float) -> tuple[float, float, int]:
    """Take the step that control proposes, or what is left to the next node."""
    h, rest = memory.pace.step, node_time - memory.t
    target = memory.t + h
    if target >= node_time - plan.snap or (rest <= STRETCH * h and rest <= plan.control.max_step):
        return node_time, rest, AT_NODE
    return target, target - memory.t, AT_GRID  # so that t + h is the target to the bit


def _attempt(plan: Plan, memory: Memory, log: Log, base: Tally, target: float, h: float, landing: int) -> Trial:
    """Make one step from the state where the march stands, which stays as it is."""
    p, tables, pieces, at = plan.parameters, plan.tables, memory.pieces, memory.tally.samples - base.samples
    state, error, at, effort = propose(memory.t, target, h, memory.state, p, tables, pieces, log, at, memory.tally.rows)
    return Trial(target, h, landing, state, error, detect(target, state, p, tables, pieces), effort, at + base.samples)


def _judge(plan: Plan, memory: Memory, trial: Trial) -> tuple[int, float]:
    """Return RUNNING for a trial that may be accepted, else how the run ends if it cannot be repeated; and its norm."""
    if trial.effort[1] < 0:
        return UNSOLVED, nan
    if not all_finite(trial.state):
        return NONFINITE, nan
    if not all_finite(trial.values):
        return NONFINITE_EVENT, nan
    if not ESTIMATES:
        return RUNNING, 0.0
    norm = error_norm(memory.state, trial.state, trial.error, plan.control.rtol, plan.control.atol)
    return ERROR_AT_MINIMUM if plan.control.adaptive and not accepts(norm) else RUNNING, norm


def _reject(plan: Plan, memory: Memory, log: Log, base: Tally, trial: Trial, verdict: int) -> Memory:
    """Note a trial that failed; repeat it shorter from the unchanged state, or end the run."""
    reason = _reason(verdict, trial.state)
    note_trial(log, memory.tally.trials - base.trials, memory, trial.h, memory.norm, reason)
    memory = _counted(memory, 1)
    if not (ESTIMATES and plan.control.adaptive):
        return _ended(memory, verdict, trial.h, trial.state, trial.values)
    least = shortest(plan, memory.t)
    if min(trial.h, memory.pace.step) <= least:  # h has the rounding of t + h, the proposal has not
        if verdict == ERROR_AT_MINIMUM and plan.control.min_step < least:
            verdict = STEP_TOO_SMALL
        return _ended(memory, verdict, trial.h, trial.state, trial.values)
    pace = reduced(plan, memory.pace, memory.t, trial.h, memory.norm, verdict == ERROR_AT_MINIMUM)
    return Memory(
        RUNNING, memory.t, memory.h, memory.grid, memory.node, memory.on_grid, memory.state, trial.state,
        memory.values, memory.pieces, memory.norm, pace, memory.evaluations, memory.tally,
    )  # fmt: skip


def _reason(verdict: int, trial: State) -> int:
    """Name the reason of a rejection; a number that is none comes from outside the domain of a function or table."""
    if verdict == ERROR_AT_MINIMUM:
        return REASON_ERROR
    if verdict == UNSOLVED:
        return REASON_NEWTON
    undefined = False
    for value in trial:
        undefined = undefined or value != value
    return REASON_DOMAIN if undefined and DOMAIN_LIMITED else REASON_NONFINITE


def _accept(plan: Plan, memory: Memory, log: Log, base: Tally, trial: Trial) -> Memory:
    """Note an accepted state and go on from it."""
    kind = STEP if trial.landing == AT_GRID else NODE
    if trial.landing != AT_GRID and memory.node == plan.nodes.shape[0] - 1:
        kind = STEP  # the end of the run is no breakpoint
    p, tables, was = plan.parameters, plan.tables, memory.tally
    if not note(log, was.rows - base.rows, trial.t, trial.h, kind, trial.state, memory.norm, trial.error,
                trial.effort[1], p, tables, memory.pieces):  # fmt: skip
        return _ended(memory, NONFINITE_OBSERVABLE, trial.h, trial.state, trial.values)
    memory = _paced(plan, memory, trial.h, trial.landing != AT_GRID)
    return _landed(plan, memory, RUNNING, trial, Tally(was.rows + 1, was.trials, was.events, trial.samples))


def _paced(plan: Plan, memory: Memory, h: float, cut: bool) -> Memory:
    """Choose the step after an accepted one."""
    if not (ESTIMATES and plan.control.adaptive):
        return memory
    pace = grown(plan.control, memory.pace, h, memory.norm, cut)
    return Memory(
        memory.status, memory.t, memory.h, memory.grid, memory.node, memory.on_grid, memory.state, memory.trial,
        memory.values, memory.pieces, memory.norm, pace, memory.evaluations, memory.tally,
    )  # fmt: skip


def _landed(plan: Plan, memory: Memory, status: int, trial: Trial, tally: Tally) -> Memory:
    """Go on from a state at a grid time or a node."""
    grid = memory.grid + (1 if trial.landing != AT_NODE else 0)
    node = memory.node + (1 if trial.landing != AT_GRID else 0)
    if status == RUNNING and node == plan.nodes.shape[0]:
        status = COMPLETED
    return Memory(
        status, trial.t, trial.h, grid, node, trial.landing != AT_NODE, trial.state, trial.state, trial.values,
        memory.pieces, memory.norm, memory.pace, memory.evaluations, tally,
    )  # fmt: skip


def _land_on_event(plan: Plan, memory: Memory, log: Log, base: Tally, trial: Trial) -> Memory:
    """Locate the first event of a step, advance to it, and note the state on either side."""
    p, tables, pieces = plan.parameters, plan.tables, memory.pieces
    norm = memory.norm if ESTIMATES else nan
    note_trial(log, memory.tally.trials - base.trials, memory, trial.h, norm, REASON_EVENT)
    memory = _paced(plan, memory, trial.h, trial.landing != AT_GRID)
    s, trials, evaluations = locate(plan, memory, log, base, trial.h, trial.state, trial.values)
    # two events closer than the spacing of t are two rows all the same
    time = max(memory.t + s, np.nextafter(memory.t, np.inf))
    reached = s == trial.h or time >= trial.t
    cut = _attempt(plan, memory, log, base, trial.t if reached else time, s, trial.landing)
    verdict, norm = _judge(plan, memory, cut)
    memory = _counted(_worked(memory, norm, (evaluations + cut.effort[0], 0)), trials - memory.tally.trials)
    if verdict != RUNNING:
        return _reject(plan, memory, log, base, cut, verdict)
    was, status = memory.tally, RUNNING
    row, events = was.rows - base.rows, was.events
    if not note(log, row, cut.t, s, EVENT_BEFORE, cut.state, norm, cut.error, cut.effort[1], p, tables, pieces):
        return _ended(memory, NONFINITE_OBSERVABLE, s, cut.state, cut.values)
    note(log, row + 1, cut.t, 0.0, EVENT_AFTER, cut.state, 0.0, NO_ERROR, 0, p, tables, pieces)
    rates = slopes(cut.t, cut.state, p, tables, pieces)
    for i in range(len(cut.values)):
        if crosses(plan.directions[i], memory.values[i], cut.values[i]):
            left, rising = memory.t + log.lows[i], memory.values[i] < 0.0
            _note_event(log, events - base.events, i, cut.t, left, cut.values[i], rates[i], was.rows, rising)
            events += 1
            if plan.stops[i]:
                status = STOPPED
    tally = Tally(was.rows + 2, was.trials, events, cut.samples)
    if reached:
        return _landed(plan, memory, status, cut, tally)
    return Memory(
        status, cut.t, s, memory.grid, memory.node, False, cut.state, cut.state, cut.values, pieces, norm, memory.pace,
        memory.evaluations, tally,
    )  # fmt: skip


def _note_event(
    log: Log, at: int, detector: int, time: float, left: float, residual: float, slope: float, row: int, rising: bool
) -> None:
    log.events[0, at] = time
    log.events[1, at] = left
    log.events[2, at] = time
    log.events[3, at] = residual
    log.events[4, at] = slope
    log.events[5, at] = row
    log.events[6, at] = row + 1
    log.events[7, at] = detector
    log.events[8, at] = CROSSING
    log.events[9, at] = 1 if rising else -1


def _cross_node(plan: Plan, memory: Memory, log: Log, base: Tally) -> Memory:
    """Behind a node, evaluate the forces on its far side; the next step starts with those."""
    pieces = pieces_at(memory.t, plan.tables)
    at = memory.tally.samples - base.samples
    p, row = plan.parameters, memory.tally.rows - 1
    state, at = begin(memory.t, memory.state, p, plan.tables, pieces, log, at, row)
    if not all_finite(state):
        return _ended(memory, NONFINITE, memory.h, state, memory.values)
    was = memory.tally
    tally = Tally(was.rows, was.trials, was.events, at + base.samples)
    return Memory(
        RUNNING, memory.t, memory.h, memory.grid, memory.node, memory.on_grid, state, state, memory.values, pieces,
        memory.norm, memory.pace, memory.evaluations + 1, tally,
    )  # fmt: skip


def _ended(memory: Memory, status: int, h: float, trial: State, values: State) -> Memory:
    """Stop where the march stands."""
    return Memory(
        status, memory.t, h, memory.grid, memory.node, memory.on_grid, memory.state, trial, values, memory.pieces,
        memory.norm, memory.pace, memory.evaluations, memory.tally,
    )  # fmt: skip


def _counted(memory: Memory, trials: int) -> Memory:
    """Count rejected trials."""
    was = memory.tally
    tally = Tally(was.rows, was.trials + trials, was.events, was.samples)
    return Memory(
        memory.status, memory.t, memory.h, memory.grid, memory.node, memory.on_grid, memory.state, memory.trial,
        memory.values, memory.pieces, memory.norm, memory.pace, memory.evaluations, tally,
    )  # fmt: skip


def _worked(memory: Memory, norm: float, effort: Effort) -> Memory:
    """Count force evaluations and keep the norm of the error."""
    return Memory(
        memory.status, memory.t, memory.h, memory.grid, memory.node, memory.on_grid, memory.state, memory.trial,
        memory.values, memory.pieces, norm, memory.pace, memory.evaluations + effort[0], memory.tally,
    )  # fmt: skip
