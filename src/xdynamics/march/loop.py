"""The time loop: aim, propose, judge, locate, accept, note.

Plain Python that numba compiles together with the functions of one model and one method; see `march.interface`.
"""

from __future__ import annotations

import numpy as np

from xdynamics.march.events import crosses, crosses_any, locate
from xdynamics.march.finite import all_finite
from xdynamics.march.interface import State, begin, detect, note, pieces_at, propose, slopes
from xdynamics.march.log import MOST_SUBSTEPS, Log, Memory, Plan, Tally, note_trial
from xdynamics.march.outcomes import (
    COMPLETED,
    NONFINITE,
    NONFINITE_EVENT,
    NONFINITE_OBSERVABLE,
    RUNNING,
    STEP_TOO_SMALL,
    STOPPED,
)
from xdynamics.schema import CROSSING, EVENT_AFTER, EVENT_BEFORE, INITIAL, NODE, REASON_EVENT, REASON_NONFINITE, STEP

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
        p, tables, pieces, tally, node = plan.parameters, plan.tables, memory.pieces, memory.tally, memory.node
        at = tally.samples - base.samples
        trial, at = propose(memory.t, target, h, memory.state, p, tables, pieces, log, at, tally.rows)
        values = detect(target, trial, p, tables, pieces)
        verdict = _judge(trial, values)
        if verdict != RUNNING:
            note_trial(log, tally.trials - base.trials, memory, h, REASON_NONFINITE)
            return _ended(_counted(memory, 1), verdict, h, trial, values)
        if crosses_any(plan.directions, memory.values, values):
            memory = _land_on_event(plan, memory, log, base, target, h, landing, trial, values)
        else:
            kind = STEP if landing == AT_GRID else NODE
            if landing != AT_GRID and memory.node == plan.nodes.shape[0] - 1:
                kind = STEP  # the end of the run is no breakpoint
            if not note(log, tally.rows - base.rows, target, h, kind, trial, p, tables, pieces):
                return _ended(memory, NONFINITE_OBSERVABLE, h, trial, values)
            tally = Tally(tally.rows + 1, tally.trials, tally.events, at + base.samples)
            memory = _landed(plan, memory, RUNNING, target, h, landing, trial, values, tally)
        if memory.status == RUNNING and memory.node != node:
            memory = _cross_node(plan, memory, log, base)
    return memory


def _start(plan: Plan, memory: Memory, log: Log) -> Memory:
    """Evaluate and note the initial state."""
    t, p, tables = memory.t, plan.parameters, plan.tables
    pieces = pieces_at(t, tables)
    state, samples = begin(t, memory.state, p, tables, pieces, log, 0, 0)
    values = detect(t, state, p, tables, pieces)
    noted = note(log, 0, t, 0.0, INITIAL, state, p, tables, pieces)
    status = _judge(state, values)
    if status == RUNNING and not noted:
        status = NONFINITE_OBSERVABLE
    tally = Tally(1, 0, 0, samples)
    return Memory(status, t, 0.0, 0, 0, True, state, state, values, pieces, tally)


def _has_room(plan: Plan, log: Log, base: Tally, tally: Tally) -> bool:
    """Whether one more step, with every event and node it may hold, fits the blocks."""
    events = log.lows.shape[0]
    return (
        tally.rows - base.rows + 2 <= log.rows.shape[1]
        and tally.trials - base.trials + events * MOST_SUBSTEPS <= log.trials.shape[1]
        and tally.events - base.events + events <= log.events.shape[1]
        and tally.samples - base.samples + plan.sampled + 1 <= log.samples.shape[1]
    )


def _aim(plan: Plan, memory: Memory) -> tuple[float, float, int]:
    """Choose where the next step ends: the next grid time or an earlier node; the step; what is landed on."""
    grid_time = plan.start + (memory.grid + 1) * plan.step_size
    node_time = plan.nodes[memory.node]
    if node_time > grid_time + plan.snap:
        return grid_time, plan.step_size if memory.on_grid else grid_time - memory.t, AT_GRID
    if node_time >= grid_time - plan.snap:
        return node_time, plan.step_size if memory.on_grid else node_time - memory.t, AT_BOTH
    return node_time, node_time - memory.t, AT_NODE


def _judge(trial: State, values: State) -> int:
    """Return RUNNING for a trial that may be accepted, else how the run ends."""
    if not all_finite(trial):
        return NONFINITE
    return RUNNING if all_finite(values) else NONFINITE_EVENT


def _landed(
    plan: Plan, memory: Memory, status: int, t: float, h: float, landing: int, state: State, values: State, tally: Tally
) -> Memory:
    """Accept a state at a grid time or a node."""
    grid = memory.grid + (1 if landing != AT_NODE else 0)
    node = memory.node + (1 if landing != AT_GRID else 0)
    if status == RUNNING and node == plan.nodes.shape[0]:
        status = COMPLETED
    return Memory(status, t, h, grid, node, landing != AT_NODE, state, state, values, memory.pieces, tally)


def _land_on_event(
    plan: Plan,
    memory: Memory,
    log: Log,
    base: Tally,
    target: float,
    h: float,
    landing: int,
    trial: State,
    values: State,
) -> Memory:
    """Locate the first event of a step, advance to it, and note the state on either side."""
    p, tables, pieces = plan.parameters, plan.tables, memory.pieces
    note_trial(log, memory.tally.trials - base.trials, memory, h, REASON_EVENT)
    s, trials = locate(plan, memory, log, base, h, trial, values)
    # two events closer than the spacing of t are two rows all the same
    time = max(memory.t + s, np.nextafter(memory.t, np.inf))
    reached = s == h or time >= target
    time = target if reached else time
    at = memory.tally.samples - base.samples
    state, at = propose(memory.t, time, s, memory.state, p, tables, pieces, log, at, memory.tally.rows)
    values = detect(time, state, p, tables, pieces)
    row, events, status = memory.tally.rows, memory.tally.events, RUNNING
    if not note(log, row - base.rows, time, s, EVENT_BEFORE, state, p, tables, pieces):
        return _ended(_counted(memory, trials - memory.tally.trials), NONFINITE_OBSERVABLE, s, state, values)
    note(log, row + 1 - base.rows, time, 0.0, EVENT_AFTER, state, p, tables, pieces)
    rates = slopes(time, state, p, tables, pieces)
    for i in range(len(values)):
        if crosses(plan.directions[i], memory.values[i], values[i]):
            rising = memory.values[i] < 0.0
            _note_event(log, events - base.events, i, time, memory.t + log.lows[i], values[i], rates[i], row, rising)
            events += 1
            if plan.stops[i]:
                status = STOPPED
    tally = Tally(row + 2, trials, events, at + base.samples)
    if reached:
        return _landed(plan, memory, status, time, s, landing, state, values, tally)
    return Memory(status, time, s, memory.grid, memory.node, False, state, state, values, pieces, tally)


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
        RUNNING,
        memory.t,
        memory.h,
        memory.grid,
        memory.node,
        memory.on_grid,
        state,
        state,
        memory.values,
        pieces,
        tally,
    )


def _ended(memory: Memory, status: int, h: float, trial: State, values: State) -> Memory:
    """Stop where the march stands."""
    return Memory(
        status, memory.t, h, memory.grid, memory.node, memory.on_grid,
        memory.state, trial, values, memory.pieces, memory.tally,
    )  # fmt: skip


def _counted(memory: Memory, trials: int) -> Memory:
    """Count rejected trials."""
    was = memory.tally
    tally = Tally(was.rows, was.trials + trials, was.events, was.samples)
    return Memory(
        memory.status, memory.t, memory.h, memory.grid, memory.node, memory.on_grid,
        memory.state, memory.trial, memory.values, memory.pieces, tally,
    )  # fmt: skip
