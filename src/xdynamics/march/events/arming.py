"""On which side of zero each event function is: where it starts, after an event, after a trial that is rejected."""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.events.departures import find_sides, has_action, judges_departures, leave_again, take_departure
from xdynamics.march.events.zero_tests import NEAR, NONE, TOUCHED, noise_floor, sign_of
from xdynamics.march.exact_times import set_time
from xdynamics.march.run import Run
from xdynamics.march.trial_step import copy_numbers


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
    """Arm a function that touched zero once it has left, by its uncertainty over the whole step.

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
