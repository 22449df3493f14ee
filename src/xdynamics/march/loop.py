"""The time loop: aim, propose, judge, reject or locate, accept, hand over.

Each phase is a procedure on a run and says only what changes. Compiled once for all models: what a model and a method
compute stands behind the addresses of `run.law`.
"""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np

from xdynamics.kernels.compiling import apart, compiled, shared
from xdynamics.kernels.law import DETECT, RESETS, SLOPES
from xdynamics.kernels.program import REGIME, UNSOUND, T
from xdynamics.kernels.tables import enter_pieces
from xdynamics.march.control import STRETCH, accepts, error_norm, first_step, grow, reduce, shortest
from xdynamics.march.enclosures import EPS, enclose
from xdynamics.march.evaluating import evaluate, finite_state
from xdynamics.march.events import kind_of, locate
from xdynamics.march.handle import called, run_at
from xdynamics.march.isolation import NONE, arm, arrives, isolate, quiet, sign, uncertainty
from xdynamics.march.log import MOST_SUBSTEPS, has_room, note, note_sample, note_samples, note_trial
from xdynamics.march.outcomes import (
    COMPLETED,
    EVENT_AT_ZERO,
    NONFINITE_OBSERVABLE,
    RUNNING,
    SOUND,
    STEP_LIMIT,
    STEP_TOO_SMALL,
    STOPPED,
)
from xdynamics.march.proposing import copy, keep, look, propose, propose_apart, substep, take
from xdynamics.march.run import BEGUN, MOVED, Run
from xdynamics.model.parts import ACTIONS
from xdynamics.schema import (
    EVENT_AFTER,
    EVENT_BEFORE,
    INITIAL,
    NODE,
    REASON_DOMAIN,
    REASON_ERROR,
    REASON_EVENT,
    REASON_EVENT_FUNCTION,
    REASON_NEWTON,
    REASON_NONFINITE,
    REGIME_SWITCH,
    RESET_KIND,
    STEP,
)

AT_GRID, AT_NODE, AT_BOTH, AT_BORDER = 1, 2, 3, 4  # the last: of what the model is defined for

# no literals: of a function that is given one, numba makes a copy for each
_INITIAL, _BEFORE, _AFTER = np.int64(INITIAL), np.int64(EVENT_BEFORE), np.int64(EVENT_AFTER)
_SWITCHED, _RESET = np.int64(REGIME_SWITCH), np.int64(RESET_KIND)
_, STOP, SWITCH, RESET = range(len(ACTIONS))
note_apart, note_samples_apart, grow_apart = apart(note), apart(note_samples), apart(grow)


def march(address: Any, rows: int) -> None:
    """March until the log is full, `rows` more rows are written, or the run ends; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`. With no rows yet, the march begins; with status RUNNING afterwards it can go on.
    rows : int
        Rows after which to return.
    """
    run = run_at(address)
    now = run.now[0]
    if run.detectors.shape[0] > 0:  # numbers and parameters of the event functions
        enclose(run, run.y, run.y, 0, run.parts[0])
    if now.rows == 0 and now.status == RUNNING and has_room(run):
        start(run)
    pause = now.rows + rows
    while now.status == RUNNING and 0 < now.rows < pause and has_room(run):
        if now.crossed != now.node:
            cross_node(run)
        if now.status == RUNNING:
            aim(run)
        if now.status != RUNNING:
            break
        propose(run, run.trial[0].t, run.trial[0].h)
        reason = judge(run)
        if run.detectors.shape[0] > 0:
            if reason == SOUND and not quiet(run):
                reason = meet(run)
            if reason in (REASON_DOMAIN, REASON_EVENT_FUNCTION):
                reason = shrink(run, reason)
        if reason == SOUND:
            accept(run)
        elif reason == REASON_EVENT:
            hand_over(run)
        else:
            reject(run, reason)


@shared
def start(run: Run) -> None:
    """Evaluate and note the initial state; choose the first step."""
    now, plan = run.now[0], run.plan[0]
    run.at[REGIME] = now.regime  # until an event changes it
    run.kept[0].since = BEGUN
    enter_pieces(now.t, run.tables, run.places, run.of_time)
    evaluate(run, now.t, run.y)
    note_sample(run, now.t, run.y, 0)
    run.at[T] = now.t
    called(run.law[DETECT], run, run.y, run.g, 0)
    sound_events = run.at[UNSOUND] == 0.0
    copy(run.y, run.z)
    for i in range(run.detectors.shape[0]):
        run.watches[i].ever = 0
        arm(run, i, run.g[i])
    for i in range(run.largest.shape[0]):
        run.largest[i] = abs(run.y[i])
    noted = note_apart(run, _INITIAL, now.t, 0.0, run.y)
    if not finite_state(run):
        now.status = nonfinite(run)
    elif not sound_events:
        now.status = REASON_EVENT_FUNCTION
    elif not noted:
        now.status = NONFINITE_OBSERVABLE
    now.rows = 1  # there is no run without an initial row, be it as it may
    if plan.adaptive and now.status == RUNNING:
        now.step = plan.first_step if plan.first_step > 0.0 else first_step(run)
        now.first_step = now.step


@compiled
def aim(run: Run) -> None:
    """Choose where the next step ends, and its size; end the run where it cannot advance, or may not."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    node = run.nodes[now.node] if now.node < run.nodes.shape[0] else plan.end
    if plan.adaptive:
        aim_freely(run, node)
    else:
        aim_at_grid(run, node)
    if not (now.t + trial.h > now.t and trial.t > now.t):
        end(run, STEP_TOO_SMALL)
    elif now.rows + now.trials > plan.most_steps:
        end(run, STEP_LIMIT)


@compiled
def aim_at_grid(run: Run, node: float) -> None:
    """Aim at the next grid time or an earlier node; from a grid time the step is the grid's, to the bit."""
    now, plan, trial, snap = run.now[0], run.plan[0], run.trial[0], run.snaps[run.now[0].node]
    if plan.step_size > 0.0:
        time, step = plan.start + (now.grid + 1) * plan.step_size, plan.step_size
    elif now.grid < run.grid.shape[0]:
        time, step = run.grid[now.grid], run.steps[now.grid]
    else:
        time, step = np.inf, np.inf
    if node > time + snap:
        trial.t, trial.landing = time, AT_GRID
    elif node >= time - snap:
        trial.t, trial.landing = node, AT_BOTH
    else:
        trial.t, trial.landing = node, AT_NODE
    trial.h = step if now.on_grid and trial.landing != AT_NODE else trial.t - now.t


@compiled
def aim_freely(run: Run, node: float) -> None:
    """Take the step that control proposes, or what is left to the next node."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    rest = node - now.t
    trial.t = now.t + now.step
    if trial.t >= node - run.snaps[now.node] or (rest <= STRETCH * now.step and rest <= plan.max_step):
        trial.t, trial.h, trial.landing = node, rest, AT_NODE
    else:
        trial.h, trial.landing = trial.t - now.t, AT_GRID  # so that t + h is the target to the bit


@compiled
def judge(run: Run) -> int:
    """Return SOUND for a trial that may be accepted, else the reason why not; keep the norm of its error."""
    now, trial = run.now[0], run.trial[0]
    now.norm = nan
    if trial.iterations < 0:
        return REASON_NEWTON
    if trial.unsound != 0.0:
        return nonfinite(run)
    if trial.unsound_events != 0.0:
        return REASON_EVENT_FUNCTION
    now.norm = error_norm(run) if run.plan[0].estimates else 0.0
    return REASON_ERROR if run.plan[0].adaptive and not accepts(now.norm) else SOUND


@shared
def nonfinite(run: Run) -> int:
    """Tell why a state is not finite: a number that is none comes from outside the domain of a function or table."""
    undefined = False
    for i in range(run.plan[0].state):
        undefined = undefined or np.isnan(run.z[i])
    return REASON_DOMAIN if undefined and run.plan[0].limited else REASON_NONFINITE


@shared
def reject(run: Run, reason: int) -> None:
    """Note a trial that failed; repeat it shorter from the unchanged state, or end the run."""
    now, plan, h = run.now[0], run.plan[0], run.trial[0].h
    note_trial(run, h, now.norm, reason)
    if not plan.adaptive:
        end(run, reason)
        return
    least = shortest(run)
    if min(h, now.step) > least:  # h has the rounding of t + h, the proposal has not
        reduce(run, h, reason == REASON_ERROR)
    elif reason == REASON_ERROR and plan.min_step < least:
        end(run, STEP_TOO_SMALL)
    else:
        end(run, reason)


@compiled
def accept(run: Run) -> None:
    """Note an accepted state and go on from it."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    inner = now.node < run.nodes.shape[0]  # the end of the run is no breakpoint
    kind = NODE if trial.landing in (AT_NODE, AT_BOTH) and inner else STEP
    if not note(run, kind, trial.t, trial.h, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return
    note_samples(run, now.rows - 1)
    if plan.adaptive:
        grow(run, trial.h, trial.landing != AT_GRID)
    land(run)
    move(run)


@compiled
def land(run: Run) -> None:
    """Count the grid time or node that the trial ends at; behind the last one the run is complete."""
    now, trial = run.now[0], run.trial[0]
    if trial.landing in (AT_GRID, AT_BOTH):
        now.grid += 1
    if trial.landing in (AT_NODE, AT_BOTH):
        now.node += 1
        if now.node > run.nodes.shape[0]:
            now.status = COMPLETED
            for i in range(run.detectors.shape[0]):
                if run.watches[i].ever == 0:
                    now.status = EVENT_AT_ZERO
    now.on_grid = trial.landing in (AT_GRID, AT_BOTH)


@compiled
def move(run: Run) -> None:
    """Take the trial's end for the place where the march stands."""
    now, trial = run.now[0], run.trial[0]
    now.t, now.h = trial.t, trial.h
    run.kept[0].since = BEGUN if run.piece[0].cut else MOVED  # what substeps left behind is not the step's
    run.piece[0].cut = 0
    if run.plan[0].adaptive:
        for i in range(run.largest.shape[0]):
            run.largest[i] = max(run.largest[i], abs(run.z[i]))
    for i in range(run.y.shape[0]):  # a loop: a slice assignment takes numba seconds to compile
        run.y[i] = run.z[i]


judge_apart = apart(judge)


@shared
def meet(run: Run) -> int:
    """Look for events in the trial: REASON_EVENT where one is in it, SOUND where none is, and it stays as it is."""
    now, trial = run.now[0], run.trial[0]
    growth, trials, final = run.kept[0].growth, now.trials, trial.landing != AT_GRID and now.node >= run.nodes.shape[0]
    run.at[T] = now.t
    called(run.law[DETECT], run, run.y, run.g, 0)
    look(run)
    keep(run)
    if trial.unsound_events != 0.0:
        return REASON_EVENT_FUNCTION
    if isolate(run, final):
        return REASON_EVENT
    take(run)
    run.kept[0].growth, run.piece[0].cut = growth, int(now.trials > trials)
    return SOUND


@shared
def shrink(run: Run, reason: int) -> int:
    """Shorten a trial that leaves where the model is defined to what is left of it; an event may be on the border."""
    now, trial = run.now[0], run.trial[0]
    whole, target, landing, low, high = trial.h, trial.t, trial.landing, 0.0, trial.h
    tolerance = 2.0 * EPS * max(abs(now.t), abs(now.t + high))
    for _ in range(MOST_SUBSTEPS // 2):
        s = (low + high) / 2.0
        if high - low <= tolerance or not low < s < high:
            break
        substep(run, s)
        sound = trial.iterations >= 0 and trial.unsound == 0.0 and trial.unsound_events == 0.0
        low, high = (s, high) if sound else (low, s)
    if low > 0.0:
        substep(run, low)
        run.at[T] = now.t
        called(run.law[DETECT], run, run.y, run.g, 0)
        trial.landing = AT_BORDER
        keep(run)
        quiet(run)
        if isolate(run, True) or arrives(run):
            return REASON_EVENT
        if not run.plan[0].adaptive and low > tolerance:
            take(run)
            return SOUND
    propose_apart(run, target, whole)
    trial.landing = landing
    return reason


@shared
def hand_over(run: Run) -> None:
    """Locate the first event of the trial, land on it, and note the state on either side."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    whole, target, landing, trials = run.located[0].h, run.located[0].t, run.located[0].landing, now.trials
    note_trial(run, whole, now.norm if plan.estimates else nan, REASON_EVENT)
    if plan.adaptive:
        grow_apart(run, whole, landing != AT_GRID)
    locate(run)
    # two events closer than the spacing of t are two rows all the same
    trial.t = max(trial.t, np.nextafter(now.t, np.inf))
    reached = landing != AT_BORDER and (trial.h == whole or trial.t >= target)
    trial.t = target if reached else trial.t
    reason = judge_apart(run)
    if reason != SOUND:
        reject(run, reason)
        return
    before = now.rows
    if not note_apart(run, _BEFORE, trial.t, trial.h, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return
    note_samples_apart(run, before)
    note_events(run, before, now.trials - trials)
    if act(run, before):
        evaluate(run, trial.t, run.z)
        note_sample(run, trial.t, run.z, before + 1)
    if not finite_state(run):
        end(run, nonfinite(run))
        return
    if not note_apart(run, _AFTER, trial.t, 0.0, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return
    if reached:
        completed = now.status
        land(run)
        now.status = completed if completed == STOPPED else now.status
    else:
        now.on_grid = 0
    move(run)
    run.kept[0].since = BEGUN
    rearm(run)


@shared
def note_events(run: Run, row: int, substeps: int) -> None:
    """Write a row for each event that the trial ends at, between the rows `row` and the next."""
    now, trial = run.now[0], run.trial[0]
    run.at[T] = trial.t
    called(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.hit == NONE:
            continue
        one = run.log_events[now.events - run.base[0].events]
        one.time, one.left, one.residual, one.slope = trial.t, now.t + watch.left, run.g1[i], run.slopes[i]
        one.uncertainty, one.murk, one.substeps = (
            uncertainty(run, i, run.z),
            max(0.0, watch.clear - watch.zone),
            substeps,
        )
        one.row_before, one.row_after, one.detector, one.kind = row, row + 1, i, kind_of(run, i)
        one.direction = -watch.armed
        watch.seen += 1
        for k in range(run.log_rates.shape[0]):
            run.log_rates[k, now.events - run.base[0].events] = run.slopes[run.detectors.shape[0] + k]
        now.events += 1


@shared
def act(run: Run, row: int) -> bool:
    """Do what the events of a group say, in their declared order; whether forces have to be evaluated anew."""
    now, changed = run.now[0], False
    first = now.events - run.base[0].events
    while first > 0 and run.log_events[first - 1].row_before == row:
        first -= 1
    for k in range(first, now.events - run.base[0].events):
        one = run.log_events[k]
        detector = run.detectors[one.detector]
        if run.watches[one.detector].seen < detector.count:
            continue
        if detector.action == STOP:
            now.status = STOPPED
        elif detector.action == SWITCH:
            now.regime, run.at[REGIME], one.kind, changed = detector.to, detector.to, _SWITCHED, True
        elif detector.action == RESET:
            reset(run, one.detector)
            one.kind, changed = _RESET, True
    return changed


@shared
def reset(run: Run, i: int) -> None:
    """Set the state to what an event says, all of it from the state before."""
    called(run.law[RESETS], run, run.z, run.resets, 0)
    carried = run.plan[0].used + run.plan[0].evaluated
    for k in range(run.targets.shape[0]):
        if run.targets[k, 0] == i:
            run.z[run.targets[k, 1]] = run.resets[k]
            if carried < run.z.shape[0]:  # what rounding took from the value before is not the new one's
                run.z[carried + run.targets[k, 1]] = 0.0


@shared
def rearm(run: Run) -> None:
    """Look on which side of zero every event function is behind an event; one within its uncertainty has yet to leave."""
    run.at[T] = run.now[0].t
    called(run.law[DETECT], run, run.y, run.g, 0)
    for i in range(run.detectors.shape[0]):
        if run.watches[i].hit != NONE or sign(run.g[i]) != run.watches[i].armed:
            arm(run, i, run.g[i])


@shared
def cross_node(run: Run) -> None:
    """Behind a node, evaluate the forces on its far side; the next step starts with those."""
    now = run.now[0]
    now.crossed = now.node
    run.kept[0].since = BEGUN
    enter_pieces(now.t, run.tables, run.places, run.of_time)
    copy(run.y, run.z)
    evaluate(run, now.t, run.z)
    note_sample(run, now.t, run.z, now.rows - 1)
    if finite_state(run):
        copy(run.z, run.y)
    else:
        now.status = nonfinite(run)


@compiled
def end(run: Run, why: int) -> None:
    """Stop where the march stands; `h` is the step that failed."""
    run.now[0].status, run.now[0].h = why, run.trial[0].h
