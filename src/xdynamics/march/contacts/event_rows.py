"""What the record says of contacts and friction at an event: impulses, rest, take-off, stick and slip."""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.run import NO_LINK, SKIPPED, Run
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL, SLIP
from xdynamics.model.reactions import NORMAL, TANGENT
from xdynamics.schema import CLOSED, IMPACT, LOOSE, OPEN, REST, STICKING, TAKEOFF, TOUCH
from xdynamics.schema import SLIP as SLIPPED
from xdynamics.schema import STICK as STUCK


@jit_separate
def note_contact_impacts(run: Run, first: int) -> None:
    """Note the impulse of each contact, and the energy that it took."""
    n = run.plan[0].coordinates
    for k in range(run.touches.shape[0]):
        if run.reactions[k].role != NORMAL or run.touches[k].total == 0.0:
            continue
        e = event_row_of(run, k, first)
        run.log_events[e].kind = IMPACT
        for j in range(run.touches.shape[0]):
            if j == k or (run.reactions[j].role == TANGENT and run.reactions[j].normal == k):
                for i in range(n):
                    run.log_impulses[i, e] += run.directions[j, i] * run.touches[j].total
                run.log_impulses[n, e] += run.touches[j].lost


@jit_separate
def note_contact_changes(run: Run, first: int) -> None:
    """Note what contacts and friction do after the events."""
    for k in range(run.touches.shape[0]):
        touch, state_before = run.touches[k], run.touches[k].held
        if run.reactions[k].role == NORMAL:
            note_contact(run, k, first)
        elif touch.hit in (SLIP, GRIP):
            run.log_events[event_row_of(run, k, first)].kind = STUCK if touch.state == STICKING else SLIPPED
        elif (
            STICKING in (touch.state, state_before)
            and touch.state != state_before
            and LOOSE not in (touch.state, state_before)
        ):
            run.log_events[another_row(run, k, first)].kind = STUCK if touch.state == STICKING else SLIPPED
        touch.held = touch.state


@jit_separate
def note_contact(run: Run, k: int, first: int) -> None:
    """Note that a contact came to rest, or opened."""
    touch, struck = run.touches[k], run.touches[k].total != 0.0
    if touch.hit == LIMIT and touch.state == CLOSED:
        note_rest(run, k, event_row_of(run, k, first))
    elif touch.hit == PULL:
        run.log_events[event_row_of(run, k, first)].kind = TAKEOFF
    elif touch.state == CLOSED and touch.held == OPEN:
        note_rest(run, k, another_row(run, k, first) if struck or touch.hit == NONE else event_row_of(run, k, first))
    elif touch.hit == GAP and not struck:
        run.log_events[event_row_of(run, k, first)].kind = TOUCH
    elif touch.state == OPEN and touch.held != OPEN and not struck:
        run.log_events[another_row(run, k, first)].kind = TAKEOFF


@jit_separate
def note_rest(run: Run, k: int, e: int) -> None:
    """Note that a contact came to rest, with the energy of the bounces that were skipped."""
    run.log_events[e].kind, run.log_events[e].murk = REST, 2.0 * run.touches[k].doubt
    run.balance[SKIPPED] += run.touches[k].lost
    run.log_impulses[run.plan[0].coordinates, e] += run.touches[k].lost


@jit_separate
def event_row_of(run: Run, k: int, first: int) -> int:
    """The row of the event that a detector of a reaction located; a new one where there is none."""
    for e in range(first, run.now[0].events - run.base[0].events):
        detector = run.detectors[run.log_events[e].detector]
        if detector.role == run.touches[k].hit and detector.reaction == k:
            return e
    return another_row(run, k, first)


@jit_separate
def another_row(run: Run, k: int, first: int) -> int:
    """Add a row to the group, for a reaction of which no detector located an event."""
    e = run.now[0].events - run.base[0].events
    event = run.log_events[e]
    event.time, event.left = run.trial[0].t, run.trial[0].t
    if e > first:
        event.left = run.log_events[first].left
    event.residual, event.slope, event.uncertainty, event.murk = 0.0, 0.0, 0.0, 0.0
    event.rest, event.substeps = 0.0, 0
    event.interpolation = 0.0
    event.row_before, event.row_after, event.direction = run.now[0].rows - 1, run.now[0].rows, -1
    event.link = NO_LINK
    for i in range(run.detectors.shape[0]):
        if run.detectors[i].reaction == k:
            event.detector = i
            break
    for i in range(run.log_rates.shape[0]):
        run.log_rates[i, e] = run.slopes[run.detectors.shape[0] + i]
    clear_impulses(run, e)
    run.now[0].events += 1
    return e


@jit_separate
def clear_impulses(run: Run, e: int) -> None:
    """Set the impulses of an event to zero."""
    for i in range(run.log_impulses.shape[0]):
        run.log_impulses[i, e] = 0.0
