"""The part of contacts in a march: at its start, after every step, at every event.

After an event, the effect of all contacts is derived again from the state; see `march.contacts.active_set`. The record
gets the impulses, rest, take-off, stick and slip of contacts and friction at the event.

Moreau's time-stepping takes the action of contacts over a complete step, as impulses at its middle. The law of impacts
holds for a contact that stays as for one that is hit: after the step its rate is not less than -e times the rate
before. No event is located, and many contacts may close and open in one step.
"""

from __future__ import annotations

from math import inf, nan

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.contacts.active_set import bounce, inform, solve_active_set
from xdynamics.march.contacts.balance import (
    is_broken,
    open_balance,
    weigh_contact_impulses,
    weigh_energies,
    weigh_positions,
    weigh_rates,
)
from xdynamics.march.contacts.delassus import (
    ABSENT,
    GRIPPING,
    PRESSING,
    approaching,
    collect_detectors,
    find_touching,
    gap_width,
    hold_closed_contacts,
    impact_spread,
    list_holding,
    look_at_links,
    slips,
    solve_reactions,
)
from xdynamics.march.contacts.impact import collide_contacts, contact_rate_noise
from xdynamics.march.control import end_march
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.force_evaluation import evaluate_forces, finite_state
from xdynamics.march.log import first_of_group
from xdynamics.march.outcomes import CONTACT_PENETRATED, RUNNING
from xdynamics.march.phases import CONTACTS, phase
from xdynamics.march.run import NO_LINK, SKIPPED, Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.model.detectors import GAP, GRIP, LIMIT, PULL, SLIP
from xdynamics.model.reactions import NORMAL, TANGENT
from xdynamics.schema import (
    BACKWARD,
    CLOSED,
    FORWARD,
    IMPACT,
    LOOSE,
    OPEN,
    REASON_CONTACT,
    REST,
    SETTLING,
    STICKING,
    TAKEOFF,
    TOUCH,
)
from xdynamics.schema import SLIP as SLIPPED
from xdynamics.schema import STICK as STUCK


@jit_separate
def note_contact_impacts(run: Run, first: int) -> None:
    """Write the impulse of each contact to the log, and the energy that it dissipated."""
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
    """Write the modes of contacts and friction after the events to the log."""
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
    """Write to the log that a contact came to rest, or opened."""
    touch, struck = run.touches[k], run.touches[k].total != 0.0
    if touch.hit == LIMIT and touch.state == CLOSED:
        note_rest(run, k, event_row_of(run, k, first))
    elif touch.hit == PULL or (touch.hit == LIMIT and touch.state == OPEN and not struck):
        run.log_events[event_row_of(run, k, first)].kind = TAKEOFF
    elif touch.state == CLOSED and touch.held == OPEN:
        note_rest(run, k, another_row(run, k, first) if struck or touch.hit == NONE else event_row_of(run, k, first))
    elif touch.hit == GAP and not struck:
        run.log_events[event_row_of(run, k, first)].kind = TOUCH
    elif touch.state == OPEN and touch.held != OPEN and not struck:
        run.log_events[another_row(run, k, first)].kind = TAKEOFF


@jit_separate
def note_rest(run: Run, k: int, e: int) -> None:
    """Write to the log that a contact came to rest, with the energy of the skipped bounces."""
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


@jit_separate
def step_in_time(run: Run, t1: float) -> None:
    """Add the impulses of a step to the trial, which was made without them."""
    n, h = run.plan[0].coordinates, run.trial[0].h
    middle = run.now[0].t + h / 2.0
    for i in range(2 * n):
        run.half[i] = run.z[i]
    for i in range(n):
        # the middle with velocities from before the step: restitution multiplies those rates, not the ones of the
        # free motion
        run.z[i], run.z[n + i] = run.y[i] + h / 2.0 * run.y[n + i], run.y[n + i]
    look_at_links(run, middle)
    find_closed_contacts(run)
    for i in range(n):
        run.z[n + i] = run.half[n + i]
    look_at_links(run, middle)
    solved = push_closed_contacts(run, h)
    for i in range(n):
        change = 0.0
        for k in range(run.touches.shape[0]):
            change += run.responses[k, i] * run.touches[k].found
        # impulses act at the middle, so that they move positions for half the step only
        run.z[i], run.z[n + i] = run.half[i] + h / 2.0 * change, run.half[n + i] + change
    evaluate_forces(run, t1, run.z)
    for k in range(run.touches.shape[0]):
        run.z[run.plan[0].pressed + k] = run.touches[k].found / h
        conclude_step(run, k)
    run.at[UNSOUND] = 0.0 if solved and finite_state(run) else nan


@jit_separate
def find_closed_contacts(run: Run) -> None:
    """Find which contacts are closed in the middle of the step, and their coefficients of restitution."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        touch.near = int(run.reactions[k].role == NORMAL and run.links[k].gap <= 0.0)
        touch.rate, touch.bounce, touch.found, touch.known = run.links[k].rate, run.links[k].coefficient, 0.0, 0.0


@jit_separate
def push_closed_contacts(run: Run, h: float) -> bool:
    """Find the impulses of the step; whether they exist."""
    for k in range(run.touches.shape[0]):
        touch, reaction = run.touches[k], run.reactions[k]
        touch.part, touch.origin, touch.bound = ABSENT, run.links[k].rate, 0.0
        if reaction.role == NORMAL:
            if touch.near:
                touch.part = PRESSING
                touch.origin += touch.bounce * min(touch.rate, 0.0)
        elif reaction.role == TANGENT:
            if run.touches[reaction.normal].near:
                touch.part, touch.coefficient = GRIPPING, run.links[k].coefficient
        else:
            touch.part, touch.bound = GRIPPING, h * run.links[k].coefficient
    return solve_reactions(run)


@jit_separate
def conclude_step(run: Run, k: int) -> None:
    """Set the mode of a contact, or friction, over the step."""
    touch = run.touches[k]
    if run.reactions[k].role == NORMAL:
        touch.state = CLOSED if touch.found > 0.0 else OPEN
    elif touch.part != GRIPPING:
        touch.state = LOOSE
    elif slips(run, k):
        touch.state = FORWARD if touch.after > 0.0 else BACKWARD
    else:
        touch.state = STICKING


@phase(CONTACTS)
def act_on_trial(run: Run, t: float) -> None:
    """Put the trial's state, at a time, back on closed contacts; or add what contacts do over the step, for Moreau's method."""
    if run.plan[0].steps_over > 0:
        step_in_time(run, t)
    else:
        hold_closed_contacts(run, t, True)


@phase(CONTACTS)
def inform_forces(run: Run, t: float) -> None:
    """Pass the states of contacts, set by the caller, to the forces."""
    copy_numbers(run.y, run.z)
    look_at_links(run, t)
    inform(run)


@phase(CONTACTS)
def weigh_contacts(run: Run) -> None:
    """Check the energies after the events against their rows."""
    weigh_energies(run, first_of_group(run, run.now[0].rows - 1))
    is_broken(run)


@phase(CONTACTS)
def begin_contacts(run: Run, t: float) -> None:
    """Determine the modes of contacts and friction at the start."""
    copy_numbers(run.y, run.z)
    look_at_links(run, t)
    for k in range(run.touches.shape[0]):
        contact = run.touches[k]
        contact.state, contact.limit, contact.lost, contact.hit, contact.known = OPEN, -inf, 0.0, NONE, 0.0
        contact.speed, contact.since, contact.doubt, contact.total, contact.fastest = 0.0, t, 0.0, 0.0, 0.0
        contact.steepest = run.delassus[k, k]
        contact.largest = max(0.0, run.links[k].gap)
        run.swiftest[k], run.lingering[k] = 0.0, 0.0
        if run.reactions[k].role == NORMAL and run.links[k].gap < -gap_width(run, k):
            run.now[0].status = CONTACT_PENETRATED
        contact.held = OPEN
    if run.plan[0].steps_over > 0:
        inform(run)
        return
    find_touching(run)
    if not solve_active_set(run) and run.now[0].status == RUNNING:
        run.now[0].status = REASON_CONTACT
    for k in range(run.touches.shape[0]):
        run.touches[k].held = run.touches[k].state


@phase(CONTACTS)
def derive_again(run: Run, t: float) -> None:
    """Determine the modes of contacts after the events at the trial's end, whose impacts have changed forces."""
    look_at_links(run, t)
    find_touching(run)
    if solve_active_set(run):
        note_contact_changes(run, first_of_group(run, run.now[0].rows - 1))
    else:
        end_march(run, REASON_CONTACT)


@phase(CONTACTS)
def settle_contacts(run: Run, t: float) -> None:
    """Go on as if no bounces were left."""
    waiting = False
    for k in range(run.touches.shape[0]):
        waiting = waiting or (run.reactions[k].role == NORMAL and run.touches[k].state == SETTLING)
    if waiting:
        copy_numbers(run.y, run.z)
        look_at_links(run, t)
        open_balance(run)
        hold_closed_contacts(run, t, True)
        weigh_positions(run, True)
        copy_numbers(run.z, run.y)


@phase(CONTACTS)
def change_by_contacts(run: Run, t: float) -> None:
    """Change the trial's state by the impacts and transitions of contacts at its end."""
    look_at_links(run, t)
    open_balance(run)
    collect_detectors(run)
    find_touching(run)
    first = first_of_group(run, run.now[0].rows - 1)
    for k in range(run.touches.shape[0]):
        gap, watched = run.links[k].gap, run.reactions[k].role == NORMAL and run.touches[k].hit == NONE
        if watched and gap < 0.0 and gap < -max(gap_width(run, k), impact_spread(run, k)):
            end_march(run, CONTACT_PENETRATED)
            return
    if approaching(run):
        if not collide_contacts(run):
            end_march(run, REASON_CONTACT)
            return
        note_contact_impacts(run, first)
        for k in range(run.touches.shape[0]):
            run.touches[k].slack, run.touches[k].lost = contact_rate_noise(run, k), 0.0
        look_at_links(run, t)
        weigh_contact_impulses(run)
    if not (solve_active_set(run) and bounce(run, t)):
        end_march(run, REASON_CONTACT)
        return
    note_contact_changes(run, first)
    if list_holding(run, False) > 0:
        hold_closed_contacts(run, t, False)
        if run.at[UNSOUND] != 0.0:
            end_march(run, REASON_CONTACT)
        else:
            weigh_positions(run, False)
            weigh_rates(run)
    is_broken(run)
