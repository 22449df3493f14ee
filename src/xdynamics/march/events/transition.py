"""From a trial with events to the state after them: found, located, landed on, noted on both sides, acted upon.

All of it is compiled apart from the loop, which calls it by address where an event function may be near zero.
"""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import apart, shared
from xdynamics.kernels.law import DETECT, RESETS, SLOPES
from xdynamics.kernels.program import REGIME, T
from xdynamics.march.acceptance import AT_BORDER, AT_GRID, end, judge_apart, land_apart, move_apart, nonfinite
from xdynamics.march.control import grow
from xdynamics.march.events.event_free_region import end_region
from xdynamics.march.events.isolation import arm, arrives, forget, isolate, quiet
from xdynamics.march.events.root_finding import kind_of, locate
from xdynamics.march.events.switch_sides import keep_sides, slides, take_sides
from xdynamics.march.events.zero_tests import NONE, murk, resolution, sign, uncertainty
from xdynamics.march.events.zero_tests import TOUCHED as TANGENT
from xdynamics.march.force_evaluation import evaluate, finite_state
from xdynamics.march.handle import called, entered_by, run_at
from xdynamics.march.log import MOST_SUBSTEPS, first_of_group, note, note_sample, note_samples, note_trial
from xdynamics.march.outcomes import (
    BEGIN,
    CONTACT_INCONSISTENT,
    CONTACT_PENETRATED,
    NONFINITE_OBSERVABLE,
    RUNNING,
    SLIDING_MODE,
    SOUND,
    STOPPED,
)
from xdynamics.march.run import (
    BEFORE,
    BEGUN,
    BEHIND,
    GUARD,
    HOLD,
    KEPT_ALL,
    RESOLVE,
    SETTLE,
    SIDES,
    TOUCHED,
    WEIGH,
    Run,
)
from xdynamics.march.trial_step import copy, keep, look, substep, take
from xdynamics.model.detectors import GRIP, KINK, OCCASION, PULL, SLIP
from xdynamics.model.detectors import SWITCH as SWITCH_ROLE
from xdynamics.model.parts import ACTIONS
from xdynamics.schema import (
    CROSSING,
    EVENT_AFTER,
    EVENT_BEFORE,
    JUMP,
    REASON_CONTACT,
    REASON_DOMAIN,
    REASON_EVENT,
    REASON_EVENT_FUNCTION,
    REGIME_SWITCH,
    RESET_KIND,
)

# no literals: numba compiles a copy of a function for each literal that it is given
_BEFORE, _AFTER = np.int64(EVENT_BEFORE), np.int64(EVENT_AFTER)
_SWITCHED, _RESET = np.int64(REGIME_SWITCH), np.int64(RESET_KIND)
_CROSSED, _JUMPED = np.int64(CROSSING), np.int64(JUMP)
_, STOP, SWITCH, RESET = range(len(ACTIONS))
_STATE = 2  # of a row of the log, after time and step
State = NDArray[Any]
note_apart, note_samples_apart, grow_apart = apart(note), apart(note_samples), apart(grow)


def happen(address: Any, _number: float, reason: int) -> None:
    """Find the first event of a trial and go on after it; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`. Afterwards its `piece` has the verdict on the trial: it is SOUND, to be accepted as it is; an event
        was landed on; or why it is to be rejected.
    reason : int
        SOUND for a trial that may be accepted, else why not.
    """
    run = run_at(address)
    if reason == SIDES:
        take_sides(run)
        return
    if reason == BEGIN:
        begin(run)
        return
    run.piece[0].substeps = 0
    if reason == SOUND:
        reason = meet(run)
    if reason in (REASON_DOMAIN, REASON_EVENT_FUNCTION):
        reason = shrink(run, reason)
    if reason == REASON_EVENT:
        reason = hand_over(run)
    run.piece[0].verdict = reason
    end_region(run)
    if run.plan[0].apart == 0:
        for i in range(run.detectors.shape[0]):
            run.watches[i].alive = 0


@shared
def begin(run: Run) -> None:
    """Determine on which side of zero every event function is at the start."""
    end_region(run)  # the region of an earlier run
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        watch.seen, watch.greatest = 0, 0.0  # left by an earlier run in the same memory
        watch.ever = int(run.detectors[i].role != OCCASION)
        arm(run, i, run.g[i])


@shared
def meet(run: Run) -> int:
    """Look for events in the trial: REASON_EVENT if it holds one, SOUND if it holds none and stays as it is."""
    now, trial = run.now[0], run.trial[0]
    growth, final = run.kept[0].growth, trial.landing != AT_GRID and now.node >= run.nodes.shape[0]
    run.at[T] = now.t
    called(run.law[DETECT], run, run.y, run.g, 0)
    look(run)
    keep(run)
    if trial.unsound_events != 0.0:
        return REASON_EVENT_FUNCTION
    if isolate(run, final):
        return REASON_EVENT
    take(run)
    run.kept[0].growth, run.piece[0].cut = growth, int(run.piece[0].substeps > 0)
    return SOUND


@shared
def shrink(run: Run, reason: int) -> int:
    """Shorten a trial that leaves the domain of the model to the part inside; an event may be on the border."""
    now, trial = run.now[0], run.trial[0]
    whole_step, target, landing, low, high = trial.h, trial.t, trial.landing, 0.0, trial.h
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
        if not run.plan[0].adaptive and low > max(tolerance, resolution(run, 0, low)):
            take(run)
            run.piece[0].cut = 1
            return SOUND
        forget(run)
    substep(run, whole_step)
    trial.t, trial.landing = target, landing
    return reason


@shared
def hand_over(run: Run) -> int:
    """Locate the first event of the trial, land on it, and note the state on either side; return the verdict."""
    now, plan, whole_step = run.now[0], run.plan[0], run.located[0].h
    if plan.apart:  # note the whole trial too, and count only substeps of its bracket
        note_trial(run, whole_step, now.norm if plan.estimates else nan, REASON_EVENT)
        run.piece[0].substeps = 1
    if plan.adaptive:
        grow_apart(run, whole_step, run.located[0].landing != AT_GRID)
    reached = shorten(run)
    reason = judge_apart(run)
    if reason != SOUND:
        forget(run)
        return reason
    row_before = now.rows
    if not note_apart(run, _BEFORE, run.trial[0].t, run.trial[0].h, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return REASON_EVENT
    note_samples_apart(run, row_before)
    note_events(run, row_before, run.piece[0].substeps)
    if not cross(run, row_before):
        return REASON_EVENT
    if not note_apart(run, _AFTER, run.trial[0].t, 0.0, run.z):
        end(run, NONFINITE_OBSERVABLE)
        return REASON_EVENT
    go_on(run, reached)
    return REASON_EVENT


@shared
def shorten(run: Run) -> bool:
    """Shorten the trial to end just after its first event; whether it is as long as it was."""
    trial, whole_step, target, landing = run.trial[0], run.located[0].h, run.located[0].t, run.located[0].landing
    locate(run)
    leave_out(run)
    # two events closer than the spacing of t still have two rows
    trial.t = max(trial.t, np.nextafter(run.now[0].t, np.inf))
    reached = landing != AT_BORDER and (trial.h == whole_step or trial.t >= target)
    trial.t = target if reached else trial.t
    return bool(reached)


@shared
def cross(run: Run, before: int) -> bool:
    """Change the trial's state by what happens at its end; whether there is a state after it."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    changed = act(run, before)
    if plan.reactions > 0:
        row = -1 if changed or plan.kinetic < 0 else before - run.base[0].rows
        changed = True
        if plan.contacts == HOLD and not touch(run, row):
            break_off(run, before)
            return False
    note_offsets(run, before)
    if plan.switches > 0:
        changed = keep_sides(run, changed) or changed
    if changed:
        evaluate(run, trial.t, run.z)
        note_sample(run, trial.t, run.z, before + 1)
    if plan.switches > 0 and slides(run):
        now.status = SLIDING_MODE
    if not finite_state(run):
        status = nonfinite(run)
        break_off(run, before)
        end(run, status)
        now.h = 0.0  # no step failed, but the state after the event
        return False
    return True


@shared
def touch(run: Run, row: int) -> bool:
    """Change the trial's state by what contacts do; whether there is a solution, and it agrees with the record.

    Row `row` of the log has the state before; it is -1 where an action has changed the state.
    """
    run.balance[BEFORE] = run.log_rows[run.plan[0].kinetic, row] if row >= 0 else kinetic_energy(run, run.z)
    entered_by(run.functions[TOUCHED], run, run.trial[0].t, RESOLVE)
    if run.now[0].status in (CONTACT_PENETRATED, REASON_CONTACT, CONTACT_INCONSISTENT):
        return False
    copy(run.z, run.whole)
    for i in range(run.plan[0].coordinates):  # the energy of velocities alone: masses depend on positions
        run.whole[i] = run.entry[i]
    run.balance[BEHIND] = kinetic_energy(run, run.whole)
    entered_by(run.functions[TOUCHED], run, run.trial[0].t, WEIGH)
    return bool(run.now[0].status != CONTACT_INCONSISTENT)


@shared
def kinetic_energy(run: Run, state: State) -> float:
    """The kinetic energy of a state, by a row of the log that is overwritten later."""
    now, plan = run.now[0], run.plan[0]
    if plan.kinetic < 0:
        return 0.0
    row = now.rows - run.base[0].rows
    if note_apart(run, _AFTER, run.trial[0].t, 0.0, state):
        now.rows -= 1
    return run.log_rows[plan.kinetic, row]


@shared
def note_offsets(run: Run, before: int) -> None:
    """Note how far positions were moved by contacts that came to rest, beyond what events set them to."""
    n, rows, first = run.plan[0].coordinates, run.log_impulses.shape[0], first_of_group(run, before)
    if rows == 0:
        return
    owner, last = first, run.now[0].events - run.base[0].events
    for e in range(first, last):
        if run.detectors[run.log_events[e].detector].reaction >= 0:
            owner = e
            break
    for i in range(n):
        offset = run.z[i] - run.log_rows[_STATE + i, before - run.base[0].rows]
        for e in range(first, last):
            offset -= run.log_impulses[rows - n + i, e]
        run.log_impulses[rows - n + i, owner] += offset


@shared
def go_on(run: Run, reached: bool) -> None:
    """Move to the state after the events, and go on from there."""
    now = run.now[0]
    if reached:
        status = now.status
        land_apart(run)
        now.status = now.status if status == RUNNING else status
    else:
        now.on_grid = 0
    move_apart(run)
    run.kept[0].since = BEGUN
    if run.plan[0].reactions > 0:
        entered_by(run.functions[TOUCHED], run, now.t, SETTLE)
        if run.balance[GUARD] != KEPT_ALL:
            end(run, CONTACT_INCONSISTENT)
    rearm(run)


@shared
def break_off(run: Run, row: int) -> None:
    """Stop before events that have no state after them."""
    now = run.now[0]
    for k in range(first_of_group(run, row), now.events - run.base[0].events):
        run.log_events[k].row_after = row
    move_apart(run)


@shared
def leave_out(run: Run) -> None:
    """Ignore that a grip is lost where the contact itself opens."""
    for i in range(run.detectors.shape[0]):
        grip = run.detectors[i]
        if grip.role not in (GRIP, SLIP) or run.watches[i].hit == NONE:
            continue
        for j in range(run.detectors.shape[0]):
            pull = run.detectors[j]
            opens = pull.role == PULL and run.watches[j].hit != NONE
            if opens and run.reactions[grip.reaction].normal == pull.reaction:
                run.watches[i].hit = NONE


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
        event = run.log_events[now.events - run.base[0].events]
        left = now.t + watch.left if watch.left > 0.0 else now.t - run.pending[i]
        event.time, event.left, event.residual, event.slope = trial.t, left, run.g1[i], run.slopes[i]
        if run.detectors[i].sampled:
            event.slope = -watch.armed * watch.up
        event.uncertainty, event.substeps = uncertainty(run, i, run.z), substeps
        event.interpolation = watch.drift / abs(event.slope) if watch.drift > 0.0 else 0.0
        event.murk = watch.clear - watch.zone if watch.zone >= 0.0 else 0.0
        event.row_before, event.row_after, event.detector, event.kind = row, row + 1, i, kind_of(run, i)
        event.direction = -watch.armed
        watch.seen += 1
        for k in range(run.log_rates.shape[0]):
            run.log_rates[k, now.events - run.base[0].events] = run.slopes[run.detectors.shape[0] + k]
        for k in range(run.log_impulses.shape[0]):
            run.log_impulses[k, now.events - run.base[0].events] = 0.0
        now.events += 1


@shared
def act(run: Run, row: int) -> bool:
    """Do what the events of a group declare, in the order of declaration; whether forces have to be evaluated anew."""
    now, changed = run.now[0], False
    for k in range(first_of_group(run, row), now.events - run.base[0].events):
        event = run.log_events[k]
        detector = run.detectors[event.detector]
        if detector.role in (SWITCH_ROLE, KINK) and event.kind in (_CROSSED, _JUMPED):
            event.kind = _SWITCHED
        if run.watches[event.detector].seen < detector.count:
            continue
        if detector.action == STOP:
            now.status = STOPPED
        elif detector.action == SWITCH:
            now.regime, run.at[REGIME], event.kind, changed = detector.to, detector.to, _SWITCHED, True
        elif detector.action == RESET:
            reset(run, event.detector, k)
            event.kind, changed = _RESET, True
    return changed


@shared
def reset(run: Run, i: int, e: int) -> None:
    """Reset the state as an event declares, all from the state before; its row notes how far positions are moved."""
    first = run.log_impulses.shape[0] - run.plan[0].coordinates
    called(run.law[RESETS], run, run.z, run.resets, 0)
    carried = run.plan[0].used + run.plan[0].evaluated
    for k in range(run.targets.shape[0]):
        if run.targets[k, 0] == i:
            if run.targets[k, 1] < run.plan[0].coordinates:
                run.log_impulses[first + run.targets[k, 1], e] += run.resets[k] - run.z[run.targets[k, 1]]
            run.z[run.targets[k, 1]] = run.resets[k]
            if carried < run.z.shape[0]:  # rounding carried for the value before is not that of the new one
                run.z[carried + run.targets[k, 1]] = 0.0


@shared
def rearm(run: Run) -> None:
    """Determine the side of zero of each event function after an event; one within its uncertainty has yet to leave."""
    run.at[T] = run.now[0].t
    called(run.law[DETECT], run, run.y, run.g, 0)
    for i in range(run.detectors.shape[0]):
        watch, pending = run.watches[i], 0.0
        if watch.hit != NONE or sign(run.g[i]) != watch.armed:
            if is_pending(run, i):
                pending = run.pending[i] + run.trial[0].h - watch.left
            elif watch.hit == TANGENT and run.plan[0].apart == 0:
                rearm_behind_touch(run, i)
            else:
                arm(run, i, run.g[i])
        run.pending[i] = pending


@shared
def rearm_behind_touch(run: Run, i: int) -> None:
    """Arm a function that touched zero once it has left, by its uncertainty over the whole step.

    The shortened step that ends at the touch is more certain, but the next one is as long as the one before, and would
    find the same touch again.
    """
    copy(run.full_e, run.located_e)
    arm(run, i, run.g[i])
    copy(run.e, run.located_e)


@shared
def is_pending(run: Run, i: int) -> bool:
    """Whether an event, perhaps just passed, is so near the one landed on that it is left to the next step.

    As far as is known, it is on the side that it came from: nothing but motion has changed its function.
    """
    watch, detector = run.watches[i], run.detectors[i]
    if run.plan[0].apart or watch.hit != NONE or watch.armed == 0 or detector.reaction >= 0 or run.g[i] != run.g1[i]:
        return False
    watched = detector.direction == 0 or detector.direction == -watch.armed
    return bool(watched or abs(run.g[i]) <= murk(run, i, run.y))
