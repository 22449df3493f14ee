"""Departures of acting events whose functions are zero where the motion stands: at the start, or after an event.

A function at zero says nothing of a passage; where the motion takes it does. An event has happened if the motion goes
on in its direction, `rising` or `falling`, by the forces that hold then: a block that the force of one regime drives
back into the other is in the other at once. An event's own action makes it happen no second time. Actions that lead
back to a state that was met at the same instant, or crowd together in time, have no motion behind them, and end the
run.

The motion goes on from such an instant by the rate of the function, else by the change of that rate.

The side of zero of each event function is taken at the start, after an event, and after a trial that is rejected.
"""

from __future__ import annotations

from math import inf, isnan
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS, SMOOTH
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.events.zero_tests import (
    CROSSED,
    NEAR,
    NONE,
    ROUGHLY,
    TOUCHED,
    enclose_here,
    event_resolution,
    noise_floor,
    sign_of,
)
from xdynamics.march.force_evaluation import evaluate_forces, set_time, state_slope
from xdynamics.march.outcomes import EVENT_ACCUMULATION, RUNNING, SLIDING_MODE
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.model.detectors import OCCASION, PERIODIC
from xdynamics.model.parts import ACTIONS

State = NDArray[Any]

SHARE = 2.0**-20  # of a time over which the first steps count: a moment
SPACINGS = 64.0  # of t, which a moment is not shorter than
LATE = 4.0  # time tolerances within which a root is located: a function that may still be zero
DOUBTS = 4.0  # uncertainties of a rate that count as zero


@jit_separate
def moment(run: Run) -> float:
    """Return a time that is short for the motion and long for rounding."""
    return max(SHARE * run.plan[0].rest, SPACINGS * EPS * abs(run.now[0].t))


@jit_separate
def step_ahead(run: Run, state: State, duration: float) -> None:
    """Leave in `z` about where the motion is a moment after a state, with the forces there; t is the time then."""
    n, used, t = run.plan[0].coordinates, run.plan[0].used, run.now[0].t + duration
    for i in range(used):
        run.z[i] = state[i] + duration * state_slope(run, state, i)
    for i in range(n):
        run.z[i] += 0.5 * duration * duration * state_slope(run, state, n + i)
    evaluate_forces(run, t, run.z)
    set_time(run, T, t)


@jit_separate
def is_certain(run: Run, i: int, state: State) -> bool:
    """Whether the rate of an event function at a state is more than rounding; `slopes` are those there."""
    return bool(abs(run.slopes[i]) > DOUBTS * uncertainty_of_rate(run, i, state))


@jit_separate
def uncertainty_of_rate(run: Run, i: int, state: State) -> float:
    """How far rounding may move the rate of an event function at a state; t is its time."""
    slope = run.detectors[i].slope
    enclose_here(run, i, state, run.parts[2], 0.0)
    return float((run.over[slope] - run.under[slope]) / 2.0)


_RECORD, _STOP, _SWITCH, _RESET = range(len(ACTIONS))

BESIDE = 1e-3  # of its largest value in the step: farther from zero, a function is not zero within its uncertainty
CROWDED = 100.0  # time tolerances between two actions of an event, below which they may not go on
SHRINKING = 0.99  # ratio of one pause to the one before, below which pauses end at a time that can be told
FEWEST = 3  # pauses to tell it from
# of a function that is, or was, zero at an instant: whether it is on its way to a side, has reached it within the trial,
# or stays at zero where its own event has acted
STANDING, LEAVING, LEFT, ACTED = range(4)
# bits of how a reset failed to turn a motion back: it goes on from rest, or errors had carried it through zero
GOES_ON, STRAYS = 1, 2


@jit_separate
def judges_departures(run: Run) -> bool:
    """Whether acting events are judged where their functions are zero."""
    return bool(run.departures.shape[0] > 0)


@jit_separate
def has_action(run: Run, i: int) -> bool:
    """Whether an event does more than to be recorded."""
    return bool(run.detectors[i].role == OCCASION and run.detectors[i].action != _RECORD)


@jit_separate
def begin_departures(run: Run) -> None:
    """Judge acting events whose functions are zero at the start, and ring periodic ones that are due then."""
    run.instant[0].meets, run.instant[0].states, run.instant[0].resets = 0, 0, 0
    for i in range(run.detectors.shape[0]):
        departure, watch = run.departures[i], run.watches[i]
        departure.rate, departure.side, departure.leaves, departure.met, departure.at_start = 0.0, 0, 0, 0, 0
        departure.last, departure.pause, departure.earlier, departure.longest, departure.short = -inf, inf, inf, inf, 0
        departure.limit, departure.doubt, departure.goes_on = -inf, 0.0, 0
        watch.hit = NONE
    find_sides(run)
    number = 0
    for i in range(run.detectors.shape[0]):
        departure = run.departures[i]
        if has_action(run, i):
            take_departure(run, i)
            departure.at_start = int(departure.leaves == LEAVING)
        elif run.detectors[i].role == PERIODIC:
            if run.alarms.shape[0] > 0 and (run.alarms[0] >> number) & 1 == 1:
                departure.side, departure.met, run.instant[0].meets = 1, 1, 1
            number += 1


@jit_separate
def may_be_zero(run: Run, i: int, value: float) -> bool:
    """Whether an acting event's function may be zero where the march stands; others need not be looked at closely."""
    watch = run.watches[i]
    near = watch.hit != NONE or watch.greatest == 0.0 or abs(value) <= BESIDE * watch.greatest
    return bool(has_action(run, i) and near)


@jit_separate
def find_sides(run: Run) -> None:
    """Find out to which side the motion takes each acting event's function from the march's state.

    The sign of its rate by the forces that hold from there on tells, where this is more than rounding; else that of its
    rate a moment later, or of the function itself where nothing is known of its rate.
    """
    set_time(run, T, run.now[0].t)
    call_law(run.law[DETECT], run, run.y, run.near_g, 0)
    call_law(run.law[SLOPES], run, run.y, run.slopes, 0)
    flat = False
    for i in range(run.detectors.shape[0]):
        departure = run.departures[i]
        departure.side, departure.from_rest = 0, 0
        if may_be_zero(run, i, run.near_g[i]):
            if not run.detectors[i].sampled and is_certain(run, i, run.y):
                departure.side = sign_of(run.slopes[i])
            flat = flat or departure.side == 0
    if flat:
        find_sides_from_rest(run)


@jit_separate
def find_sides_from_rest(run: Run) -> None:
    """Find the sides of functions whose rates are zero or unknown, by the state a moment later."""
    # `take_departure` still reads the slopes at the state itself; `arguments` is scratch space here
    copy_numbers(run.slopes, run.arguments)
    step_ahead(run, run.y, moment(run))
    call_law(run.law[DETECT], run, run.z, run.far_g, 0)
    call_law(run.law[SLOPES], run, run.z, run.slopes, 0)
    for i in range(run.detectors.shape[0]):
        departure, change = run.departures[i], run.far_g[i] - run.near_g[i]
        if departure.side != 0 or not may_be_zero(run, i, run.near_g[i]):
            continue
        if run.detectors[i].sampled:
            departure.side = sign_of(change) if abs(change) > ROUGHLY * abs(run.near_g[i]) else 0
        elif is_certain(run, i, run.z):
            departure.side, departure.from_rest = sign_of(run.slopes[i]), 1
    copy_numbers(run.arguments, run.slopes)
    copy_numbers(run.y, run.z)
    set_time(run, T, run.now[0].t)


@jit_separate
def take_departure(run: Run, i: int) -> None:
    """Arm an acting event where the motion takes its function; note that it has happened, if it has.

    One that is not zero is armed on its side. One that just acted has happened already; so has one that was on its way
    to this side before, and goes on.
    """
    watch, departure, direction = run.watches[i], run.departures[i], run.detectors[i].direction
    side, is_own, side_before = departure.side, watch.hit != NONE, sign_of(departure.rate)
    rate = 0.0 if isnan(run.slopes[i]) else run.slopes[i]
    zero_width = max(abs(departure.rate), abs(rate)) * LATE * event_resolution(run, i, 0.0)
    if not may_be_zero(run, i, run.g[i]) or abs(run.g[i]) > max(noise_floor(run, i, run.z), zero_width):
        watch.armed, departure.leaves = sign_of(run.g[i]), STANDING
        strayed = is_own and watch.flaw == SMOOTH and run.detectors[i].action == _RESET and watch.armed == direction
        departure.goes_on |= int(strayed and rate * direction < 0.0) * STRAYS
    else:
        goes_on = watch.armed == side and side_before == side
        watch.armed, departure.leaves = side, LEAVING if side != 0 else (ACTED if is_own else STANDING)
        if side != 0 and side == direction and not is_own and not goes_on:
            departure.met, run.instant[0].meets = 1, 1
        passes = is_own and side != 0 and side == direction and run.detectors[i].action == _RESET
        departure.goes_on |= int(passes and departure.from_rest > 0) * GOES_ON
    watch.ever = max(watch.ever, abs(watch.armed))
    departure.rate = rate


@jit_separate
def meet_departures(run: Run) -> None:
    """Select the events that have happened at the march's present state, and no others, for the record."""
    for i in range(run.detectors.shape[0]):
        watch, departure = run.watches[i], run.departures[i]
        watch.hit, run.pending[i] = NONE, 0.0
        if departure.met > 0:
            watch.hit, watch.armed, watch.left, watch.broken = CROSSED, -departure.side, 0.0, SMOOTH
            watch.zone, watch.before, watch.drift, departure.met = -1.0, run.g[i], 0.0, 0
    run.instant[0].meets = 0


@jit_separate
def leave_again(run: Run) -> None:
    """Mark functions that left zero within a rejected or cut trial as still to leave it."""
    for i in range(run.departures.shape[0]):
        if run.departures[i].leaves == LEFT:
            run.departures[i].leaves = LEAVING


@jit_separate
def end_leaving(run: Run) -> None:
    """Mark functions that left zero within the last trial as departed for good."""
    for i in range(run.departures.shape[0]):
        acted = run.departures[i].leaves == ACTED and run.watches[i].armed != 0
        if run.departures[i].leaves == LEFT or acted:
            run.departures[i].leaves = STANDING


@jit_separate
def has_left(run: Run, i: int) -> None:
    """Mark that a function has left zero within the trial."""
    if judges_departures(run) and run.departures[i].leaves == LEAVING:
        run.departures[i].leaves = LEFT


@jit_separate
def is_leaving(run: Run, i: int) -> bool:
    """Whether a function has yet to leave zero for the side that it is armed on."""
    return bool(judges_departures(run) and run.departures[i].leaves == LEAVING)


@jit_separate
def happens_late(run: Run, i: int, came: int) -> bool:
    """Whether an acting event whose function was zero for a while leaves it in its direction."""
    return bool(
        judges_departures(run)
        and has_action(run, i)
        and run.departures[i].leaves == STANDING
        and run.detectors[i].direction == came
    )


@jit_separate
def note_rates(run: Run) -> None:
    """Store the rates of event functions before the events at the trial's end act."""
    for i in range(run.departures.shape[0]):
        run.departures[i].rate = 0.0 if isnan(run.slopes[i]) else run.slopes[i]


@jit_separate
def begin_instant(run: Run) -> None:
    """Remember the state before the events of an instant."""
    run.instant[0].states, run.instant[0].resets = 0, 0
    remember_state(run)


@jit_separate
def remember_state(run: Run) -> None:
    """Remember a state that was met at the instant."""
    instant, used = run.instant[0], run.met_states.shape[1] - 1
    run.met_states[instant.states, 0] = run.now[0].regime
    for i in range(used):
        run.met_states[instant.states, 1 + i] = run.z[i]
    instant.states += 1


@jit_separate
def place_met(run: Run) -> int:
    """Return the number of the trial's state and regime among those met at the instant; -1 if they are new."""
    for k in range(run.instant[0].states):
        same = run.met_states[k, 0] == run.now[0].regime
        for i in range(run.met_states.shape[1] - 1):
            same = same and run.met_states[k, 1 + i] == run.z[i]
        if same:
            return k
    return -1


@jit_separate
def judge_actions(run: Run) -> None:
    """End a run whose events lead back to where they were at this instant, or crowd together in time."""
    now, instant = run.now[0], run.instant[0]
    for i in range(run.detectors.shape[0]):
        acted = run.watches[i].hit != NONE and run.detectors[i].action in (_SWITCH, _RESET)
        if acted and run.watches[i].seen >= run.detectors[i].count:
            instant.resets = max(instant.resets, int(run.detectors[i].action == _RESET))
            note_pause(run, i)
    met_number = place_met(run)
    # the last state met is the one before this action: an action that changes nothing leads nowhere back
    leads_back = 0 <= met_number < instant.states - 1
    full = met_number < 0 and instant.states >= run.met_states.shape[0]
    if now.status == RUNNING and (leads_back or full):
        now.status = EVENT_ACCUMULATION if instant.resets > 0 or full else SLIDING_MODE
        accumulate_here(run)
    if met_number < 0 and not full:
        remember_state(run)


@jit_separate
def accumulate_here(run: Run) -> None:
    """Store that the actions of the instant have no end in time."""
    for i in range(run.detectors.shape[0]):
        if run.departures[i].last == run.trial[0].t:
            run.departures[i].limit, run.departures[i].doubt = run.trial[0].t, event_resolution(run, i, 0.0)


@jit_separate
def note_pause(run: Run, i: int) -> None:
    """Store when an event acts; end the run where its pauses shrink to nothing within the time tolerance.

    Three pauses in a row whose ratio stays below 1 are as good as a geometric series, and what is left of its sum tells
    when it ends. Where rounding shapes the last ones, it is enough that pauses near the time tolerance have halved.
    """
    departure, t, tolerance = run.departures[i], run.trial[0].t, event_resolution(run, i, 0.0)
    pause = t - departure.last
    # two actions at one instant are judged by the states that are met there, see `judge_actions`
    if pause == 0.0:
        return
    ratio = max(pause / departure.pause, departure.pause / departure.earlier) if departure.pause < inf else inf
    time_left = pause * ratio / (1.0 - ratio) if ratio <= SHRINKING else inf
    if pause > CROWDED * tolerance:
        departure.short = 0
    else:
        departure.longest = pause if departure.short == 0 else max(departure.longest, pause)
        departure.short += 1
    halved = departure.short >= FEWEST and pause <= departure.longest / 2.0
    # `earlier` becomes finite with the third pause: one ratio alone says nothing of a series
    if (time_left <= tolerance and departure.earlier < inf) or halved:
        if halved:  # of a geometric series, from how much its last terms have shrunk together
            time_left = departure.short * pause * pause / (departure.longest - pause)
        departure.limit, departure.doubt = t + time_left, time_left + tolerance
        if run.now[0].status == RUNNING:
            run.now[0].status = EVENT_ACCUMULATION
    departure.earlier, departure.pause, departure.last = departure.pause, pause, t


@jit_separate
def arm_event(run: Run, i: int, value: float) -> None:
    """Arm an event at once where its function is away from zero, else once the function leaves it."""
    watch = run.watches[i]
    if watch.asleep:
        watch.armed = 0
        return
    away = abs(value) > max(noise_floor(run, i, run.z), NEAR * watch.greatest)
    watch.armed = sign_of(value) if away else 0
    watch.ever = max(watch.ever, abs(watch.armed))


@jit_separate
def rearm_rejected(run: Run) -> None:
    """Arm every event as it was before a trial that is rejected."""
    for i in range(run.watches.shape[0]):
        run.watches[i].armed = run.watches[i].began
    leave_again(run)


@jit_separate
def rearm(run: Run, changed: bool) -> None:
    """Determine the side of zero of each event function after an event; one within its uncertainty has yet to leave.

    Where events are judged, an acting one at zero is armed on the side to which the motion takes it; if that is a
    passage in its direction, due to another's action, it is met at this instant. `changed` says whether forces or the
    state were changed.
    """
    if judges_departures(run):
        find_sides(run)
    set_time(run, T, run.now[0].t)
    call_law(run.law[DETECT], run, run.y, run.g, 0)
    for i in range(run.detectors.shape[0]):
        watch, pending = run.watches[i], 0.0
        if (
            judges_departures(run)
            and has_action(run, i)
            and (watch.hit not in (NONE, TOUCHED) or (changed and watch.hit == NONE))
        ):
            take_departure(run, i)
        elif watch.hit != NONE or sign_of(run.g[i]) != watch.armed:
            if is_pending(run, i):
                pending = run.pending[i] + run.trial[0].h - watch.left
            elif watch.hit == TOUCHED and run.plan[0].apart == 0:
                rearm_behind_touch(run, i)
            else:
                arm_event(run, i, run.g[i])
        run.pending[i] = pending


@jit_separate
def rearm_behind_touch(run: Run, i: int) -> None:
    """Arm a function that touched zero once it has left, by its uncertainty over the full step.

    The shortened step that ends at the touch is more certain, but the next one is as long as the one before, and would
    find the same touch again.
    """
    copy_numbers(run.full_e, run.located_e)
    arm_event(run, i, run.g[i])
    copy_numbers(run.e, run.located_e)


@jit_separate
def is_pending(run: Run, i: int) -> bool:
    """Whether an event, perhaps just passed, is so near the one landed on that it is left to the next step.

    As far as is known, it is on the side that it came from: nothing but motion has changed its function.
    """
    watch, detector = run.watches[i], run.detectors[i]
    if run.plan[0].apart or watch.hit != NONE or watch.armed == 0 or detector.reaction >= 0 or run.g[i] != run.g1[i]:
        return False
    watched = detector.direction == 0 or detector.direction == -watch.armed
    return bool(watched or abs(run.g[i]) <= noise_floor(run, i, run.y))
