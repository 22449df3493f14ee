"""The time loop: aim, propose, judge, look for events, accept or reject.

The loop is compiled once for all models: the code of a model and a method is called by the addresses in `run.law`, what
few models need by those in `run.phases`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from xdynamics import schema
from xdynamics.kernels import formulas
from xdynamics.kernels.compiling import jit_inline, jit_separate, noinline
from xdynamics.kernels.drive_tables import enter_pieces
from xdynamics.kernels.formulas import compiled_function_of
from xdynamics.kernels.law import DETECT
from xdynamics.kernels.program import REGIME, UNSOUND, T
from xdynamics.march.assembly.phases import begin_links, find_meeting, land_on_meeting
from xdynamics.march.calls import call_law, run_at
from xdynamics.march.contacts.phases import begin_contacts
from xdynamics.march.control import (
    AT_BOTH,
    AT_BREAK,
    AT_BREAK_AND_GRID,
    AT_GRID,
    AT_NODE,
    count_landing,
    end_march,
    first_step,
    grow_step,
    judge_trial,
    move_to_trial_end,
    nonfinite_reason,
    reduce_step,
    shortest_step,
)
from xdynamics.march.event_search import begin_events, find_event
from xdynamics.march.events.enclosures import end_region
from xdynamics.march.events.isolation import is_event_free
from xdynamics.march.events.switch_sides import rings_at_end, take_sides, tick_at_end, tick_at_start
from xdynamics.march.events.zero_tests import enclose_constants
from xdynamics.march.force_evaluation import (
    evaluate_forces,
    finite_state,
    grid_rest,
    hold_attitudes,
    set_time,
    settle_constraints,
)
from xdynamics.march.landing import meet_here, resume, ring_alone
from xdynamics.march.log import append_row, has_room, note_sample, note_samples, note_trial
from xdynamics.march.outcomes import (
    CONSTRAINT_VIOLATED,
    NONFINITE_OBSERVABLE,
    RUNNING,
    SOUND,
    STEP_LIMIT,
    STEP_TOO_SMALL,
)
from xdynamics.march.past import begin_past, enter_past, note_past, soonest
from xdynamics.march.run import BEGINS, BEGUN, Run
from xdynamics.march.series import choose_series_step
from xdynamics.march.tolerance_sizes import begin_sizes, settle_tolerances
from xdynamics.march.trial_step import copy_numbers, propose_step
from xdynamics.model.constraint_consistency import CONSISTENT

ROUNDS = 4  # of attitudes and constraints at a start that is moved: what is left falls as the square
_INITIAL = np.int64(schema.INITIAL)  # no literal: numba compiles a copy of a function for every literal argument
append_row_apart = noinline(append_row)
# the lines as functions of numbers
_aim_freely = compiled_function_of(
    formulas.AIM_FREELY, "t step node snap max_step", "lands reach width", formulas.CONSTANTS
)
_grid_time = compiled_function_of(formulas.GRID_TIME, "start grid step_size", "proposed")
_aim_at_grid = compiled_function_of(
    formulas.AIM_AT_GRID, "t node snap proposed step_size on_grid", "lands counts reach width"
)


def march(address: Any, rows: int) -> None:
    """March until the log is full, `rows` more rows are written, or the run ends; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`. If it has no rows, the march begins; if its status is RUNNING afterwards, it can go on.
    rows : int
        Rows after which to return.
    """
    run = run_at(address)
    now = run.now[0]
    if run.detectors.shape[0] > 0:
        enclose_constants(run)
    begin_or_go_on(run)
    pause = now.rows + rows
    while now.status == RUNNING and 0 < now.rows < pause and has_room(run):
        if run.instant.shape[0] > 0 and run.instant[0].meets > 0:
            meet_here(run)
            continue
        if now.crossed != now.node or has_crossed(run):
            cross_node(run)
        if now.status == RUNNING:
            aim_step(run)
        if now.status != RUNNING:
            break
        propose_step(run, run.trial[0].t, run.trial[0].h)
        reason = judge_trial(run)
        # before events, which are then looked for in the trial as shortened to where links meet
        links_met = reason == SOUND and run.plan[0].assemblies > 0 and find_meeting(run)
        if run.detectors.shape[0] > 0 and (
            reason == schema.REASON_DOMAIN or (reason == SOUND and not is_event_free(run))
        ):
            reason = find_event(run, reason)
        if reason == SOUND and links_met:
            reason = land_on_meeting(run)
        if reason == SOUND and rings_at_end(run):
            reason = ring_alone(run)
        if reason == SOUND:
            accept(run)
        elif reason != schema.REASON_EVENT:
            reject(run, reason)


@jit_separate
def begin_or_go_on(run: Run) -> None:
    """Begin a march, or go on with one, by other forces where it has come to a switch that it may slide along."""
    now, plan = run.now[0], run.plan[0]
    if now.rows == 0 and now.status == RUNNING and has_room(run):
        begin_march(run)
        plan.resumes = BEGINS if plan.slides > 0 else 0
    elif plan.follows:
        settle_tolerances(run)  # of a march that goes on
    if now.status == RUNNING and plan.resumes > 0:
        resume(run)


@jit_inline
def has_crossed(run: Run) -> bool:
    """Whether the march stands right after a breaking point of delayed values."""
    return bool(run.delays.shape[0] > 0 and run.book[0].crossing > 0)


@jit_separate
def begin_march(run: Run) -> None:
    """Evaluate and log the initial state; choose the first step."""
    now, plan = run.now[0], run.plan[0]
    run.at[REGIME] = now.regime  # until an event changes it
    run.kept[0].since, run.kept[0].weighs = BEGUN, 1
    enter_pieces(now.t, run.tables, run.places, run.of_time)
    begin_past(run)
    tick_at_start(run)
    if plan.switches > 0:
        take_sides(run)
    if plan.reactions > 0:  # closing and sticking depend on forces with their sides set
        begin_contacts(run, now.t)
    if plan.reactions > 0 and plan.switches > 0:  # sides at a zero depend on what closed, and what sticks on these
        take_sides(run)
        begin_contacts(run, now.t)
    if plan.assemblies > 0:
        begin_links(run)
    if plan.held > 0:
        begin_constraints(run)
    evaluate_forces(run, now.t, run.y)
    note_sample(run, now.t, run.y, 0)
    set_time(run, T, now.t)
    call_law(run.law[DETECT], run, run.y, run.g, 0)
    sound_events = run.at[UNSOUND] == 0.0
    copy_numbers(run.y, run.z)
    if run.detectors.shape[0] > 0:
        begin_events(run)
    for i in range(run.largest.shape[0]):
        run.largest[i] = abs(run.y[i])
    row_is_finite = append_row_apart(run, _INITIAL, now.t, 0.0, run.y)
    if not finite_state(run):
        now.status = nonfinite_reason(run)
    elif not sound_events:
        now.status = schema.REASON_EVENT_FUNCTION
    elif not row_is_finite:
        now.status = NONFINITE_OBSERVABLE
    now.rows = 1  # every run has an initial row, whatever it holds
    longest = begin_sizes(run) if plan.follows and now.status == RUNNING else np.inf
    if plan.adaptive and now.status == RUNNING and not (plan.series > 0 and plan.first_step == 0.0):
        now.step = plan.first_step if plan.first_step > 0.0 else min(longest, first_step(run))
        now.first_step = now.step
    if plan.follows:
        settle_tolerances(run)


@jit_separate
def begin_constraints(run: Run) -> None:
    """Project the start onto constraints if that was requested; else end a run whose start violates them."""
    now, plan = run.now[0], run.plan[0]
    copy_numbers(run.y, run.z)
    settle_constraints(run, now.t, run.z, 0.0)
    holds = run.z[plan.moved] <= CONSISTENT
    if plan.consistent > 0:
        for _ in range(ROUNDS):
            hold_attitudes(run, now.t)
    if plan.consistent > 0 and finite_state(run):
        copy_numbers(run.z, run.y)
    elif not holds:
        now.status = CONSTRAINT_VIOLATED


@jit_inline
def aim_step(run: Run) -> None:
    """Choose the end and size of the next step; end the run where it cannot or may not advance."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    node = run.nodes[now.node] if now.node < run.nodes.shape[0] else plan.end
    if run.delays.shape[0] > 0:
        node = soonest(run, node)
    if plan.adaptive:
        aim_freely(run, node)
    else:
        aim_at_grid(run, node)
    if run.delays.shape[0] > 0 and run.book[0].aimed > 0 and trial.landing != AT_GRID:
        trial.landing = AT_BREAK if trial.landing == AT_NODE else AT_BREAK_AND_GRID
    if plan.doubled > 0:
        trial.rest = landing_rest(run)
    if not (now.t + trial.h > now.t and trial.t > now.t):
        end_march(run, STEP_TOO_SMALL)
    elif now.rows + now.trials > plan.most_steps:
        end_march(run, STEP_LIMIT)


@jit_inline
def aim_at_grid(run: Run, node: float) -> None:
    """Aim at the next grid time or an earlier node; from a grid time the step is that of the grid, to the bit."""
    now, plan, trial, snap = run.now[0], run.plan[0], run.trial[0], run.snaps[run.now[0].node]
    time, step = np.inf, np.inf
    if plan.step_size > 0.0:
        time, step = _grid_time(plan.start, now.grid, plan.step_size), plan.step_size
    elif now.grid < run.grid.shape[0]:
        time, step = run.grid[now.grid], run.steps[now.grid]
    lands, counts, trial.t, trial.h = _aim_at_grid(now.t, node, snap, time, step, now.on_grid)
    trial.landing = AT_GRID if lands == 0 else AT_BOTH if counts > 0 else AT_NODE


@jit_inline
def aim_freely(run: Run, node: float) -> None:
    """Aim at the end of the step that control proposes, or at the next node."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    if plan.series > 0:
        choose_series_step(run)
    lands, trial.t, trial.h = _aim_freely(now.t, now.step, node, run.snaps[now.node], plan.max_step)
    trial.landing = AT_NODE if lands > 0 else AT_GRID


@jit_separate
def landing_rest(run: Run) -> float:
    """Return the rest of the time that the trial aims at."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    if trial.landing in (AT_NODE, AT_BOTH):
        return float(run.node_rests[now.node])
    if plan.adaptive or plan.step_size <= 0.0:
        return 0.0
    return grid_rest(plan.start, plan.start_rest, plan.step_size, plan.step_rest, now.grid + 1)


@jit_separate
def reject(run: Run, reason: int) -> None:
    """Log a rejected trial; repeat it with a shorter step from the unchanged state, or end the run."""
    now, plan, h = run.now[0], run.plan[0], run.trial[0].h
    note_trial(run, h, now.norm, reason)
    if not plan.adaptive:
        end_march(run, reason)
        return
    shortest = shortest_step(run)
    if min(h, now.step) > shortest:  # h includes the rounding of t + h, the proposal does not
        reduce_step(run, h, reason == schema.REASON_ERROR)
    elif reason == schema.REASON_ERROR and plan.min_step < shortest:
        end_march(run, STEP_TOO_SMALL)
    else:
        end_march(run, reason)


@jit_inline
def accept(run: Run) -> None:
    """Log an accepted state and go on from it."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    kind = schema.STEP
    if run.delays.shape[0] > 0:
        note_past(run)
    if trial.landing != AT_GRID:
        kind = kind_at_node(run)
        if tick_at_end(run) and not finite_state(run):
            end_march(run, nonfinite_reason(run))
            return
    if not append_row(run, kind, trial.t, trial.h, run.z):
        end_march(run, NONFINITE_OBSERVABLE)
        return
    if plan.samples > 0:
        note_samples(run, now.rows - 1)
    if plan.adaptive:
        grow_step(run, trial.h, trial.landing != AT_GRID)
    count_landing(run)
    move_to_trial_end(run)


@jit_inline
def kind_at_node(run: Run) -> int:
    """Return the kind of row at the end of a trial that lands on more than a time of the grid."""
    landing, inner = run.trial[0].landing, run.now[0].node < run.nodes.shape[0]  # the end of the run is no breakpoint
    at_break = landing in (AT_BREAK, AT_BREAK_AND_GRID)
    return schema.NODE if at_break or (landing in (AT_NODE, AT_BOTH) and inner) else schema.STEP


@jit_separate
def cross_node(run: Run) -> None:
    """After a node, evaluate the forces on its far side, with which the next step starts."""
    now = run.now[0]
    now.crossed = now.node
    end_region(run)
    run.kept[0].since, run.kept[0].weighs = BEGUN, 1
    enter_pieces(now.t, run.tables, run.places, run.of_time)
    if run.delays.shape[0] > 0:
        run.book[0].crossing = 0
        enter_past(run, now.t)
    copy_numbers(run.y, run.z)
    evaluate_forces(run, now.t, run.z)
    note_sample(run, now.t, run.z, now.rows - 1)
    if finite_state(run):
        copy_numbers(run.z, run.y)
    else:
        now.status = nonfinite_reason(run)
