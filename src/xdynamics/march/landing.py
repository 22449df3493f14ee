"""Landing on the first event of a trial: its state on both sides, its actions, and the march after it.

The trial is shortened to end at the event.

Rows of the record about events have their times, uncertainties and kinds, and their effect on the state. Events act as
declared: they stop the run, go on by the forces of another regime, or reset the state.
"""

from __future__ import annotations

from math import nan
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.bounds import SMOOTH
from xdynamics.kernels.compiling import jit_separate, noinline
from xdynamics.kernels.law import DETECT, RESETS, SLOPES
from xdynamics.kernels.program import REGIME, T
from xdynamics.march.assembly.holding import release_moved
from xdynamics.march.calls import call_law
from xdynamics.march.contacts.balance import check_contact_law
from xdynamics.march.contacts.phases import change_by_contacts, derive_again, settle_contacts, weigh_contacts
from xdynamics.march.control import (
    AT_BORDER,
    AT_GRID,
    count_landing_apart,
    end_march,
    forget_rounding,
    grow_step,
    judge_trial_apart,
    move_to_end_apart,
    nonfinite_reason,
)
from xdynamics.march.events.departures import (
    LEAVING,
    arm_event,
    begin_instant,
    find_sides,
    has_action,
    judge_actions,
    judges_departures,
    meet_departures,
    note_rates,
    rearm,
    rearm_rejected,
    take_departure,
)
from xdynamics.march.events.enclosures import end_region
from xdynamics.march.events.root_finding import event_kind, is_plain, locate_events
from xdynamics.march.events.switch_sides import (
    find_bends,
    has_flat_zeros,
    is_flat,
    keep_sides,
    ring_events,
    rings_at_end,
    slides_along_switch,
    tick_at_end,
    ticks_at_end,
)
from xdynamics.march.events.zero_tests import CROSSED, NONE, event_resolution, function_uncertainty
from xdynamics.march.force_evaluation import evaluate_held, finite_state, put_reset_value, set_time
from xdynamics.march.log import append_row, first_of_group, note_sample, note_samples, note_trial
from xdynamics.march.outcomes import (
    AT_SWITCH,
    CONTACT_INCONSISTENT,
    CONTACT_PENETRATED,
    NONFINITE_OBSERVABLE,
    RUNNING,
    SLIDING_MODE,
    SOUND,
    STOPPED,
)
from xdynamics.march.past import break_here, note_past
from xdynamics.march.phases import WATCHERS, phase
from xdynamics.march.run import (
    BEFORE,
    BEGINS,
    BEGUN,
    BEHIND,
    ENDS_THERE,
    GUARD,
    KEPT_ALL,
    NO_LINK,
    Run,
)
from xdynamics.march.trial_step import copy_numbers, evaluate_events, propose_step_apart
from xdynamics.model.detectors import GRIP, KINK, PERIODIC, PULL, SHARE, SLIP
from xdynamics.model.detectors import SWITCH as SWITCH_ROLE
from xdynamics.model.parts import ACTIONS

State = NDArray[Any]

# no literals: numba compiles a copy of a function for each literal that it is given
_CROSSING, _JUMP = np.int64(schema.CROSSING), np.int64(schema.JUMP)
_SWITCHED, _RESET = np.int64(schema.REGIME_SWITCH), np.int64(schema.RESET_KIND)
_LEAVE = np.int64(schema.LEAVE)
BEYOND = 16.0  # times as far from a switch as it was left at, its function is on a side again
_BEFORE, _AFTER, _NODE = np.int64(schema.EVENT_BEFORE), np.int64(schema.EVENT_AFTER), np.int64(schema.NODE)
STATE = 2  # of a row of the log, after time and step
NEWTON_TURNS = 3  # from the time tolerance to 31 digits
_, STOP, SWITCH, RESET = range(len(ACTIONS))
append_row_apart, note_samples_apart, grow_step_apart = (
    noinline(append_row),
    noinline(note_samples),
    noinline(grow_step),
)
forget_rounding_apart = noinline(forget_rounding)


@jit_separate
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


@jit_separate
def note_events(run: Run, row: int, substeps: int) -> None:
    """Write a row for each event that the trial ends at, between the rows `row` and the next."""
    now, trial = run.now[0], run.trial[0]
    set_time(run, T, trial.t)
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    if trial.h > 0.0:
        note_rates(run)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        if watch.hit == NONE:
            continue
        event = run.log_events[now.events - run.base[0].events]
        left = now.t + watch.left if watch.left > 0.0 else now.t - run.pending[i]
        event.time, event.left, event.residual, event.slope = trial.t, left, run.g1[i], run.slopes[i]
        if run.detectors[i].sampled:
            event.slope = -watch.armed * watch.up
        event.uncertainty, event.substeps = function_uncertainty(run, i, run.z), substeps
        event.interpolation = watch.drift / abs(event.slope) if watch.drift > 0.0 else 0.0
        event.murk = watch.clear - watch.zone if watch.zone >= 0.0 else 0.0
        event.row_before, event.row_after, event.detector, event.kind = row, row + 1, i, event_kind(run, i)
        event.direction, event.link = -watch.armed, NO_LINK
        event.rest = rest_to_root(run, i) if run.plan[0].doubled > 0 else 0.0
        if run.detectors[i].role == PERIODIC:  # at a time that was known before
            event.left, event.residual, event.slope, event.uncertainty = trial.t, 0.0, 1.0, 0.0
            event.interpolation, event.murk, event.kind, event.rest = 0.0, 0.0, _CROSSING, trial.rest
        watch.seen += 1
        for k in range(run.log_rates.shape[0]):
            run.log_rates[k, now.events - run.base[0].events] = run.slopes[run.detectors.shape[0] + k]
        for k in range(run.log_impulses.shape[0]):
            run.log_impulses[k, now.events - run.base[0].events] = 0.0
        now.events += 1


@jit_separate
def rest_to_root(run: Run, i: int) -> float:
    """Return the rest of an event's time beside its float: of the trial's end, and to the root by the slope."""
    trial, change = run.trial[0], -run.g1[i] / run.slopes[i] if run.slopes[i] != 0.0 else 0.0
    return float(trial.rest + change) if is_plain(run, i) else float(trial.rest)


@jit_separate
def note_offsets(run: Run, row_before: int) -> None:
    """Store the shifts of positions by contacts that came to rest, beyond those that events set."""
    n, rows, first = run.plan[0].coordinates, run.log_impulses.shape[0], first_of_group(run, row_before)
    if rows == 0 or run.targets.shape[0] + run.touches.shape[0] == 0:
        return
    owner, last = first, run.now[0].events - run.base[0].events
    for e in range(first, last):
        if run.detectors[run.log_events[e].detector].reaction >= 0:
            owner = e
            break
    for i in range(n):
        offset = run.z[i] - run.log_rows[STATE + i, row_before - run.base[0].rows]
        for e in range(first, last):
            offset -= run.log_impulses[rows - n + i, e]
        run.log_impulses[rows - n + i, owner] += offset


@jit_separate
def act(run: Run, row: int) -> bool:
    """Run the actions of a group of events in order of declaration; whether forces have to be evaluated anew."""
    now, changed = run.now[0], False
    for k in range(first_of_group(run, row), now.events - run.base[0].events):
        event = run.log_events[k]
        detector = run.detectors[event.detector]
        if detector.role in (SWITCH_ROLE, KINK) and event.kind in (_CROSSING, _JUMP):
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
        elif detector.role == SHARE:
            event.kind, changed = _LEAVE, True
    return changed


@jit_separate
def reset(run: Run, i: int, e: int) -> None:
    """Reset the state as an event declares, all from the state before; its row notes how far positions are moved."""
    first = run.log_impulses.shape[0] - run.plan[0].coordinates
    call_law(run.law[RESETS], run, run.z, run.resets, 0)
    for k in range(run.targets.shape[0]):
        if run.targets[k, 0] == i:
            if run.targets[k, 1] < run.plan[0].coordinates:
                run.log_impulses[first + run.targets[k, 1], e] += run.resets[k] - run.z[run.targets[k, 1]]
            put_reset_value(run, k, run.z)


@jit_separate
def locate_and_land(run: Run) -> int:
    """Locate the first event of the trial, land on it, and note the state on either side; return the verdict."""
    now, plan, whole_step = run.now[0], run.plan[0], run.located[0].h
    if plan.apart:  # note the whole trial too, and count only substeps of its bracket
        note_trial(run, whole_step, now.norm if plan.estimates else nan, schema.REASON_EVENT)
        run.piece[0].substeps = 1
    if plan.adaptive:
        grow_step_apart(run, whole_step, run.located[0].landing != AT_GRID)
    reached = shorten_to_event(run)
    reason = judge_trial_apart(run)
    if reason != SOUND:
        rearm_rejected(run)
        return reason
    if reached and rings_at_end(run):
        ring_events(run)
    note_both_sides(run, reached)
    return schema.REASON_EVENT


@jit_separate
def stand_here(run: Run) -> None:
    """Make the march's present state a trial that ends where it begins, with its event functions."""
    now, trial = run.now[0], run.trial[0]
    run.piece[0].substeps = 0
    trial.t, trial.h, trial.rest = now.t, 0.0, now.rest
    trial.landing, trial.iterations, trial.unsound = AT_BORDER, 0, 0.0
    copy_numbers(run.y, run.z)
    evaluate_events(run)


@phase(WATCHERS)
def meet_here(run: Run) -> None:
    """Act for events that have happened at the march's present state, and go on from there."""
    stand_here(run)
    meet_departures(run)
    note_both_sides(run, False)
    end_region(run)


@phase(WATCHERS)
def ring_alone(run: Run) -> int:
    """Act as periodic events at the end of a trial say, where nothing else happens; return the verdict: that it has events."""
    run.piece[0].substeps = 0
    evaluate_events(run)
    for i in range(run.detectors.shape[0]):
        run.watches[i].hit = NONE
    ring_events(run)
    if run.plan[0].adaptive:
        grow_step_apart(run, run.trial[0].h, run.trial[0].landing != AT_GRID)
    note_both_sides(run, True)
    end_region(run)
    return schema.REASON_EVENT


@jit_separate
def note_both_sides(run: Run, reached: bool) -> None:
    """Write the states before and after the events at the trial's end, act on them, and continue."""
    row_before = run.now[0].rows
    if run.delays.shape[0] > 0 and run.trial[0].h > 0.0:
        note_past(run)
    if run.plan[0].passing > 0 and passes_kinks(run, reached):
        pass_kinks(run, reached, row_before)
        return
    if not append_row_apart(run, _BEFORE, run.trial[0].t, run.trial[0].h, run.z):
        end_march(run, NONFINITE_OBSERVABLE)
        return
    if run.trial[0].h > 0.0:
        note_samples_apart(run, row_before)
    note_events(run, row_before, run.piece[0].substeps)
    if judges_departures(run) and (run.trial[0].h > 0.0 or run.instant[0].states == 0):
        begin_instant(run)
    if not cross_events(run, row_before):
        return
    if now_slides(run):
        go_on_after_events(run, reached)
        return
    if judges_departures(run):
        judge_actions(run)
    if reached and tick_at_end(run) and not finite_state(run):
        break_off(run, row_before)
        end_march(run, nonfinite_reason(run))
        return
    if not append_row_apart(run, _AFTER, run.trial[0].t, 0.0, run.z):
        end_march(run, NONFINITE_OBSERVABLE)
        return
    go_on_after_events(run, reached)


@jit_separate
def passes_kinks(run: Run, reached: bool) -> bool:
    """Whether nothing happens at the trial's end but kinks at points of tables."""
    for i in range(run.detectors.shape[0]):
        detector = run.detectors[i]
        if run.watches[i].hit != NONE and (detector.role != KINK or detector.drive < 0):
            return False
    return not (reached and ticks_at_end(run))


@jit_separate
def pass_kinks(run: Run, reached: bool, row: int) -> None:
    """Go on behind points of tables, in one row that has the forces behind them, and count them."""
    for i in range(run.detectors.shape[0]):
        run.watches[i].seen += np.int64(run.watches[i].hit != NONE)
    if judges_departures(run):
        run.instant[0].changed = 0
    keep_sides(run, False, True)
    if run.delays.shape[0] > 0:
        break_here(run, run.trial[0].t, 1)
    evaluate_held(run, run.trial[0].t, run.z, 0.0)
    if not (finite_state(run) and append_row_apart(run, _NODE, run.trial[0].t, run.trial[0].h, run.z)):
        end_march(run, NONFINITE_OBSERVABLE if finite_state(run) else nonfinite_reason(run))
        return
    note_samples_apart(run, row)
    note_sample(run, run.trial[0].t, run.z, row)
    go_on_after_events(run, reached)


@jit_separate
def shorten_to_event(run: Run) -> bool:
    """Shorten the trial to end just after its first event; whether it is as long as it was."""
    trial, whole_step, target, landing = run.trial[0], run.located[0].h, run.located[0].t, run.located[0].landing
    locate_events(run)
    leave_out(run)
    if run.plan[0].doubled > 0:
        land_on_roots(run)
    # two events closer than the spacing of t still have two rows
    located = trial.t
    trial.t = max(trial.t, np.nextafter(run.now[0].t, np.inf))
    reached = landing != AT_BORDER and (trial.h == whole_step or trial.t >= target)
    trial.t = target if reached else trial.t
    # what the float moved by goes into the rest, so that their sum stays at the root
    if run.plan[0].doubled > 0:
        trial.rest = trial.rest + (located - trial.t)
    return bool(reached)


@jit_separate
def land_on_roots(run: Run) -> None:
    """Move the trial's end onto the last root of its events, by Newton's method with rates of one float.

    The search ends within a float's spacing or the time tolerance; each turn squares what is left.
    """
    trial = run.trial[0]
    for _ in range(NEWTON_TURNS):
        set_time(run, T, trial.t)
        call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
        latest, reach = -np.inf, np.inf
        for i in range(run.detectors.shape[0]):
            if run.watches[i].hit == NONE:
                continue
            if not is_plain(run, i) or run.slopes[i] == 0.0:
                return
            latest = max(latest, -run.g1[i] / run.slopes[i])
            reach = min(reach, event_resolution(run, i, trial.h))
        if not abs(latest) <= reach:
            return
        t = trial.t + (trial.rest + latest)
        if not t > run.now[0].t:
            return
        # what the float t could not take up of the move
        trial.rest = trial.rest + latest - (t - trial.t)
        propose_step_apart(run, t, t - run.now[0].t)
        evaluate_events(run)


@jit_separate
def cross_events(run: Run, row_before: int) -> bool:
    """Change the trial's state by the events at its end; whether there is a state after them."""
    now, plan, trial = run.now[0], run.plan[0], run.trial[0]
    acted = act(run, row_before)
    row = -1 if acted or plan.kinetic < 0 else row_before - run.base[0].rows
    if plan.switches > 0:  # what holds bodies together is judged by the forces behind the event
        acted = keep_sides(run, acted, True) or acted
    changed = acted or plan.reactions > 0
    if holds_contacts(run) and not resolve_contacts(run, row):
        break_off(run, row_before)
        return False
    note_offsets(run, row_before)
    if plan.assemblies > 0 and changed:
        release_moved(run, trial.t)
    if plan.switches > 0 and plan.reactions > 0 and not reconcile_sides(run):
        break_off(run, row_before)
        return False
    if changed and run.delays.shape[0] > 0:
        break_here(run, trial.t, 0)
    if changed:
        evaluate_held(run, trial.t, run.z, 0.0)
        note_sample(run, trial.t, run.z, row_before + 1)
    if judges_departures(run):
        run.instant[0].changed = int(acted or meets_contact(run))
    slides = (plan.switches > 0 or plan.slides > 0) and slides_along_switch(run)
    if slides and now.status == RUNNING:  # a stop outweighs it
        now.status = AT_SWITCH if plan.slides > 0 else SLIDING_MODE
    if plan.along > 0 and changed and now.status == RUNNING:  # other forces have other shares
        now.status = AT_SWITCH
    if not finite_state(run):
        status = nonfinite_reason(run)
        break_off(run, row_before)
        end_march(run, status)
        now.h = 0.0  # no step failed, but the state after the event
        return False
    return True


@jit_separate
def now_slides(run: Run) -> bool:
    """Whether the march waits for other forces; the state behind the events is noted with those."""
    return bool(run.now[0].status == AT_SWITCH)


@phase(WATCHERS)
def resume(run: Run) -> None:
    """Go on with other forces: along switches, or away from them."""
    now, begins, ends = run.now[0], run.plan[0].resumes == BEGINS, run.plan[0].resumes == ENDS_THERE
    run.plan[0].resumes = 0
    end_region(run)
    run.kept[0].since, run.kept[0].weighs = BEGUN, 1
    if begins:
        stand_on_switches(run)
        return
    copy_numbers(run.y, run.z)
    evaluate_held(run, now.t, run.z, 0.0)
    if not finite_state(run):
        now.status = nonfinite_reason(run)
        return
    note_sample(run, now.t, run.z, now.rows)
    if not append_row_apart(run, _AFTER, now.t, 0.0, run.z):
        end_march(run, NONFINITE_OBSERVABLE)
        return
    copy_numbers(run.z, run.y)
    for i in range(run.detectors.shape[0]):
        run.watches[i].greatest, run.pending[i] = 0.0, 0.0
    if judges_departures(run):
        run.instant[0].meets = 0
        find_sides(run)
    set_time(run, T, now.t)
    call_law(run.law[DETECT], run, run.y, run.g, 0)
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        beyond = run.detectors[i].role == SWITCH_ROLE and run.g[i] * watch.guard < 0.0
        watch.floor = BEYOND * abs(run.g[i]) if beyond else 0.0  # a switch that is left, off its surface by rounding
        if judges_departures(run) and has_action(run, i):
            run.departures[i].met = 0
            take_departure(run, i)
        else:
            arm_event(run, i, run.g[i])
        if judges_departures(run) and run.detectors[i].slides > 0 and watch.guard != 0:
            run.departures[i].met, run.departures[i].leaves = 0, LEAVING
            watch.armed, watch.guard = watch.guard, 0
        watch.hit = watch.hit if ends else NONE
    if ends:
        now.status = SLIDING_MODE


@jit_separate
def stand_on_switches(run: Run) -> None:
    """Note switches on which a march begins, and to which the motion is driven back, as events there."""
    now = run.now[0]
    stand_here(run)
    call_law(run.law[SLOPES], run, run.y, run.slopes, 0)
    if has_flat_zeros(run):
        find_bends(run)
    for i in range(run.detectors.shape[0]):
        watch, side = run.watches[i], 0.0
        watch.hit, run.pending[i] = NONE, 0.0
        if run.detectors[i].role == SWITCH_ROLE and run.detectors[i].drive < 0 and run.g[i] == 0.0:
            side = run.modes[run.detectors[i].to]
        if side * run.slopes[i] < 0.0 or (is_flat(run, i) and side * run.arguments[i] < 0.0):
            watch.hit, watch.armed, watch.left, watch.broken = CROSSED, np.int64(-side), 0.0, SMOOTH
            watch.zone, watch.before, watch.drift = -1.0, 0.0, 0.0
            now.status = AT_SWITCH
    if now.status == AT_SWITCH:
        row = now.rows
        if not append_row_apart(run, _BEFORE, now.t, 0.0, run.z):
            end_march(run, NONFINITE_OBSERVABLE)
            return
        note_events(run, row, 0)


@jit_separate
def holds_contacts(run: Run) -> bool:
    """Whether contacts are located and kept closed, instead of time-stepping over impacts."""
    return bool(run.plan[0].reactions > 0 and run.plan[0].steps_over == 0)


@jit_separate
def check_contact_row(run: Run, t: float) -> None:
    """End the run where the trial's state, at a time, breaks the law of contact."""
    if holds_contacts(run):
        check_contact_law(run, t)


@jit_separate
def meets_contact(run: Run) -> bool:
    """Whether an event at the trial's end is one of a contact or friction."""
    met = False
    for i in range(run.detectors.shape[0]):
        met = met or (run.detectors[i].reaction >= 0 and run.watches[i].hit != NONE)
    return met


@jit_separate
def reconcile_sides(run: Run) -> bool:
    """Make forces and contacts agree: impacts may reverse a velocity that a switch reads; whether they can."""
    for _ in range(run.detectors.shape[0]):
        if not keep_sides(run, True, False):
            break
        if holds_contacts(run):
            derive_again(run, run.trial[0].t)
            if run.now[0].status == schema.REASON_CONTACT:
                return False
    return True


@jit_separate
def resolve_contacts(run: Run, row: int) -> bool:
    """Change the trial's state by contacts; whether there is a solution, and it agrees with the record.

    Row `row` of the log has the state before; it is -1 where an action has changed the state.
    """
    run.balance[BEFORE] = run.log_rows[run.plan[0].kinetic, row] if row >= 0 else kinetic_energy(run, run.z)
    change_by_contacts(run, run.trial[0].t)
    if run.now[0].status in (CONTACT_PENETRATED, schema.REASON_CONTACT, CONTACT_INCONSISTENT):
        return False
    copy_numbers(run.z, run.whole)
    for i in range(run.plan[0].coordinates):  # the energy of velocities alone: masses depend on positions
        run.whole[i] = run.entry[i]
    run.balance[BEHIND] = kinetic_energy(run, run.whole)
    weigh_contacts(run)
    return bool(run.now[0].status != CONTACT_INCONSISTENT)


@jit_separate
def kinetic_energy(run: Run, state: State) -> float:
    """The kinetic energy of a state, by a row of the log that is overwritten later."""
    now, plan = run.now[0], run.plan[0]
    if plan.kinetic < 0:
        return 0.0
    row = now.rows - run.base[0].rows
    if append_row_apart(run, _AFTER, run.trial[0].t, 0.0, state):
        now.rows -= 1
    return run.log_rows[plan.kinetic, row]


@jit_separate
def go_on_after_events(run: Run, reached: bool) -> None:
    """Move to the state after the events, and go on from there."""
    now = run.now[0]
    if reached:
        status = now.status
        count_landing_apart(run)
        # a stop or fault that the events brought about outweighs the landing's own
        now.status = now.status if status == RUNNING else status
    elif run.trial[0].h > 0.0:
        now.on_grid = 0
    move_to_end_apart(run)
    run.kept[0].since, run.kept[0].weighs = BEGUN, 1
    if run.plan[0].reactions > 0:
        settle_contacts(run, now.t)
        if run.balance[GUARD] != KEPT_ALL:
            end_march(run, CONTACT_INCONSISTENT)
        if meets_contact(run):
            forget_rounding_apart(run)
    if not now_slides(run):
        rearm(run, run.instant.shape[0] > 0 and run.instant[0].changed > 0)
    if holds_contacts(run):
        copy_numbers(run.y, run.z)
        check_contact_row(run, now.t)


@jit_separate
def break_off(run: Run, row: int) -> None:
    """Stop before events that have no state after them."""
    now = run.now[0]
    for k in range(first_of_group(run, row), now.events - run.base[0].events):
        run.log_events[k].row_after = row
    move_to_end_apart(run)
