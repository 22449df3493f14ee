"""The search for events in a march: at its start, on a trial near a zero, where a state is set.

It is compiled apart from the loop, which calls it by address.
"""

from __future__ import annotations

from typing import Any

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law, run_at
from xdynamics.march.control import AT_BORDER, AT_BOTH, AT_NODE
from xdynamics.march.events.departures import arm_event, begin_departures, judges_departures, rearm_rejected
from xdynamics.march.events.enclosures import end_region
from xdynamics.march.events.isolation import ends_near_event, is_event_free, isolate
from xdynamics.march.events.switch_sides import take_sides
from xdynamics.march.events.transition import check_contact_row, locate_and_land, meet_here, resume, ring_alone
from xdynamics.march.events.zero_tests import event_resolution
from xdynamics.march.force_evaluation import set_time
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.outcomes import SOUND
from xdynamics.march.run import BEGIN_EVENTS, MEET_HERE, RESUME, RING, TAKE_SIDES, Run
from xdynamics.march.trial_step import evaluate_events, restore_trial, store_trial, substep
from xdynamics.model.detectors import OCCASION
from xdynamics.schema import REASON_DOMAIN, REASON_EVENT, REASON_EVENT_FUNCTION


def run_event_command(address: Any, _number: float, command: int) -> None:
    """Run a command of events; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`.
    command : int
        `BEGIN_EVENTS`: determine on which side of zero every event function is at the start. `TAKE_SIDES`: set the
        switches hidden in forces to the sides of the march's state. `FIND_EVENTS`: find the first event of the trial
        and go on after it. `RING`: act as periodic events at the trial's end say. `MEET_HERE`: act as events that have
        happened where the march stands. `RESUME`: go on with other forces, along switches or away from them.
    """
    run = run_at(address)
    if command == TAKE_SIDES:
        take_sides(run)
    elif command == BEGIN_EVENTS:
        begin_events(run)
    elif command == RING:
        ring_alone(run)
    elif command == MEET_HERE:
        meet_here(run)
    elif command == RESUME:
        resume(run)
    else:
        find_event(run)


@jit_separate
def find_event(run: Run) -> None:
    """Find the first event of a trial and go on after it.

    `piece.verdict` is the verdict on the trial: SOUND for one that may be accepted, else why not. Afterwards it is SOUND
    for a trial to be accepted as it is; or an event was landed on; or it is why the trial is to be rejected.
    """
    reason = run.piece[0].verdict
    run.piece[0].substeps = 0
    if reason == SOUND:
        reason = search_trial(run)
    if reason in (REASON_DOMAIN, REASON_EVENT_FUNCTION):
        reason = shrink_to_domain(run, reason)
    if reason == REASON_EVENT:
        reason = locate_and_land(run)
    run.piece[0].verdict = reason
    end_region(run)
    if run.plan[0].apart == 0:
        for i in range(run.detectors.shape[0]):
            run.watches[i].alive = 0


@jit_separate
def begin_events(run: Run) -> None:
    """Determine on which side of zero every event function is at the start."""
    end_region(run)  # the region of an earlier run
    for i in range(run.detectors.shape[0]):
        watch = run.watches[i]
        watch.seen, watch.greatest = 0, 0.0  # left by an earlier run in the same memory
        watch.ever = int(run.detectors[i].role != OCCASION)
        arm_event(run, i, run.g[i])
    if judges_departures(run):
        begin_departures(run)
    check_contact_row(run, run.now[0].t)


@jit_separate
def search_trial(run: Run) -> int:
    """Look for events in the trial: REASON_EVENT if it holds one, SOUND if it holds none and stays as it is."""
    now, trial = run.now[0], run.trial[0]
    # a zero in the run's last trial cannot be left to a later step
    growth, final = run.kept[0].growth, trial.landing in (AT_NODE, AT_BOTH) and now.node >= run.nodes.shape[0]
    set_time(run, T, now.t)
    call_law(run.law[DETECT], run, run.y, run.g, 0)
    evaluate_events(run)
    store_trial(run)
    if trial.unsound_events != 0.0:
        return REASON_EVENT_FUNCTION
    if isolate(run, final):
        return REASON_EVENT
    restore_trial(run)
    # substeps of a stepper that proposes its next step leave proposals of their own
    run.kept[0].growth, run.piece[0].cut = growth, int(run.piece[0].substeps > 0)
    check_contact_row(run, trial.t)
    return SOUND


@jit_separate
def shrink_to_domain(run: Run, reason: int) -> int:
    """Shorten a trial that leaves the domain of the model to the part inside; an event may be on the border."""
    now, trial = run.now[0], run.trial[0]
    whole_step, target, landing, low, high = trial.h, trial.t, trial.landing, 0.0, trial.h
    tolerance = 2.0 * EPS * max(abs(now.t), abs(now.t + high))
    for _ in range(MOST_SUBSTEPS // 2):
        s = (low + high) / 2.0
        # between adjacent floats the rounded middle is one of them
        if high - low <= tolerance or not low < s < high:
            break
        substep(run, s)
        sound = trial.iterations >= 0 and trial.unsound == 0.0 and trial.unsound_events == 0.0
        low, high = (s, high) if sound else (low, s)
    if low > 0.0:
        substep(run, low)
        set_time(run, T, now.t)
        call_law(run.law[DETECT], run, run.y, run.g, 0)
        trial.landing = AT_BORDER
        store_trial(run)
        is_event_free(run)
        # True: beyond the border there is no later step that might find a zero left to it
        if isolate(run, True) or ends_near_event(run):
            return REASON_EVENT
        if not run.plan[0].adaptive and low > max(tolerance, event_resolution(run, 0, low)):
            restore_trial(run)
            run.piece[0].cut = 1
            return SOUND
        rearm_rejected(run)
    substep(run, whole_step)
    trial.t, trial.landing = target, landing
    return reason
