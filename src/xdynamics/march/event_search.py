"""The search for events in a march: at its start, and in a trial near a zero, which may end at the first of them."""

from __future__ import annotations

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.control import AT_BORDER, AT_BOTH, AT_NODE
from xdynamics.march.events.departures import arm_event, begin_departures, judges_departures, rearm_rejected
from xdynamics.march.events.enclosures import end_region
from xdynamics.march.events.isolation import ends_near_event, is_event_free, isolate
from xdynamics.march.events.zero_tests import event_resolution
from xdynamics.march.force_evaluation import set_time
from xdynamics.march.landing import check_contact_row, locate_and_land
from xdynamics.march.log import MOST_SUBSTEPS
from xdynamics.march.outcomes import SOUND
from xdynamics.march.phases import WATCHERS, phase
from xdynamics.march.run import Run
from xdynamics.march.trial_step import evaluate_events, restore_trial, store_trial, substep
from xdynamics.model.detectors import OCCASION
from xdynamics.schema import REASON_DOMAIN, REASON_EVENT, REASON_EVENT_FUNCTION


@phase(WATCHERS)
def find_event(run: Run, reason: int) -> int:
    """Find the first event of a trial and go on after it; return the verdict on the trial, of which `reason` was the one so far.

    It is SOUND for a trial to be accepted as it is, REASON_EVENT if an event was landed on, or why it is to be rejected.
    """
    run.piece[0].substeps = 0
    if reason == SOUND:
        reason = search_trial(run)
    if reason in (REASON_DOMAIN, REASON_EVENT_FUNCTION):
        reason = shrink_to_domain(run, reason)
    if reason == REASON_EVENT:
        reason = locate_and_land(run)
    end_region(run)
    if run.plan[0].apart == 0:
        for i in range(run.detectors.shape[0]):
            run.watches[i].alive = 0
    return reason


@phase(WATCHERS)
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
