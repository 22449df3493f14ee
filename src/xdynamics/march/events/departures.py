"""Acting events whose functions are zero where the motion stands: at the start, and where another event has acted.

A function at zero says nothing of a passage; where the motion takes it does. An event has happened if the motion goes on
in its direction, `rising` or `falling`, by the forces that hold then: a block that the force of one regime drives back
into the other is in the other at once. An event's own action makes it happen no second time. Actions that lead back to
a state that was met at the same instant, or crowd together in time, have no motion behind them, and end the run.
"""

from __future__ import annotations

from math import inf, isnan

from xdynamics.elementary.rounding_margins import SMOOTH
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.events.one_sided_rates import LATE, is_certain, moment, step_ahead
from xdynamics.march.events.zero_tests import CROSSED, NONE, ROUGHLY, event_resolution, noise_floor, sign_of
from xdynamics.march.exact_times import set_time
from xdynamics.march.outcomes import EVENT_ACCUMULATION, RUNNING, SLIDING_MODE
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.model.detectors import OCCASION, PERIODIC
from xdynamics.model.parts import ACTIONS

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
    """Do so for functions whose rates are zero, or not known, a moment later."""
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
    """Have the events that have happened where the march stands among those that it is noted with; no others."""
    for i in range(run.detectors.shape[0]):
        watch, departure = run.watches[i], run.departures[i]
        watch.hit, run.pending[i] = NONE, 0.0
        if departure.met > 0:
            watch.hit, watch.armed, watch.left, watch.broken = CROSSED, -departure.side, 0.0, SMOOTH
            watch.zone, watch.before, watch.drift, departure.met = -1.0, run.g[i], 0.0, 0
    run.instant[0].meets = 0


@jit_separate
def leave_again(run: Run) -> None:
    """Have functions that left zero within a trial yet to leave it, where the trial is rejected or cut."""
    for i in range(run.departures.shape[0]):
        if run.departures[i].leaves == LEFT:
            run.departures[i].leaves = LEAVING


@jit_separate
def end_leaving(run: Run) -> None:
    """Note that functions which left zero within the last trial have left it for good."""
    for i in range(run.departures.shape[0]):
        acted = run.departures[i].leaves == ACTED and run.watches[i].armed != 0
        if run.departures[i].leaves == LEFT or acted:
            run.departures[i].leaves = STANDING


@jit_separate
def has_left(run: Run, i: int) -> None:
    """Note that a function has left zero within the trial."""
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
    """Note the rates of event functions before the events at the trial's end act."""
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
    leads_back = 0 <= met_number < instant.states - 1
    full = met_number < 0 and instant.states >= run.met_states.shape[0]
    if now.status == RUNNING and (leads_back or full):
        now.status = EVENT_ACCUMULATION if instant.resets > 0 or full else SLIDING_MODE
        accumulate_here(run)
    if met_number < 0 and not full:
        remember_state(run)


@jit_separate
def accumulate_here(run: Run) -> None:
    """Note that the actions of the instant have no end in time."""
    for i in range(run.detectors.shape[0]):
        if run.departures[i].last == run.trial[0].t:
            run.departures[i].limit, run.departures[i].doubt = run.trial[0].t, event_resolution(run, i, 0.0)


@jit_separate
def note_pause(run: Run, i: int) -> None:
    """Note when an event acts; end the run where its pauses shrink to nothing within the time tolerance.

    Three pauses in a row whose ratio stays below 1 are as good as a geometric series, and what is left of its sum tells
    when it ends. Where rounding shapes the last ones, it is enough that pauses near the time tolerance have halved.
    """
    departure, t, tolerance = run.departures[i], run.trial[0].t, event_resolution(run, i, 0.0)
    pause = t - departure.last
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
    if (time_left <= tolerance and departure.earlier < inf) or halved:
        if halved:  # of a geometric series, from how much its last terms have shrunk together
            time_left = departure.short * pause * pause / (departure.longest - pause)
        departure.limit, departure.doubt = t + time_left, time_left + tolerance
        if run.now[0].status == RUNNING:
            run.now[0].status = EVENT_ACCUMULATION
    departure.earlier, departure.pause, departure.last = departure.pause, pause, t
