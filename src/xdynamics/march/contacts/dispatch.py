"""What contacts do in a march: at its start, after every step, at every event.

After an event, all that they do is derived again from the state; see `march.contacts.active_set`.
"""

from __future__ import annotations

from math import inf
from typing import Any

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.acceptance import end_march
from xdynamics.march.calls import run_at
from xdynamics.march.contacts.active_set import inform, solve_active_set
from xdynamics.march.contacts.admissibility import check_contact_law
from xdynamics.march.contacts.balance import (
    is_broken,
    open_balance,
    weigh_contact_impulses,
    weigh_energies,
    weigh_positions,
    weigh_rates,
)
from xdynamics.march.contacts.delassus import look_at_links
from xdynamics.march.contacts.event_rows import note_contact_changes, note_contact_impacts
from xdynamics.march.contacts.gaps import approaching, collect_detectors, find_touching, gap_width, impact_spread
from xdynamics.march.contacts.impact import collide_contacts, contact_rate_noise
from xdynamics.march.contacts.projection import hold_closed_contacts, list_holding
from xdynamics.march.contacts.time_stepping import step_in_time
from xdynamics.march.contacts.zeno import bounce
from xdynamics.march.events.zero_tests import NONE
from xdynamics.march.log import first_of_group
from xdynamics.march.outcomes import CONTACT_PENETRATED, RUNNING
from xdynamics.march.run import CHECK, DERIVE, HOLD, INFORM, RESOLVE, SETTLE, STEP_IN_TIME, WEIGH, Run
from xdynamics.march.trial_step import copy_numbers
from xdynamics.model.reactions import NORMAL
from xdynamics.schema import OPEN, REASON_CONTACT, SETTLING


def run_contact_command(address: Any, t: float, command: int) -> None:
    """Do what contacts need; an entry of the engine.

    Parameters
    ----------
    address : int
        Of a `Run`.
    t : float
        The time of the trial's state; the start's where the march begins.
    command : int
        `BEGIN_CONTACTS`: find which contacts touch at the start. `HOLD`: put the trial's state back on closed contacts.
        `SETTLE`: do so with the state of the march, after an event whose further bounces are skipped. `RESOLVE`: change
        the trial's state by impacts, and determine what contacts do after the events at its end. `INFORM`: pass the
        states of contacts, set by the caller, to the forces. `STEP_IN_TIME`: add what contacts do over a step, for
        Moreau's method. `WEIGH`: check the energies after the events against their rows. `DERIVE`: determine once more
        what contacts do after events, with forces that their impacts have changed. `CHECK`: end the run if the trial's
        state breaks the law of contact.
    """
    run = run_at(address)
    if command == STEP_IN_TIME:
        step_in_time(run, t)
    elif command == HOLD:
        hold_closed_contacts(run, t, True)
    elif command == SETTLE:
        settle_contacts(run, t)
    elif command == RESOLVE:
        resolve(run, t)
    elif command == WEIGH:
        weigh_energies(run, first_of_group(run, run.now[0].rows - 1))
        is_broken(run)
    elif command == DERIVE:
        derive_again(run, t)
    elif command == CHECK:
        check_contact_law(run, t)
    elif command == INFORM:
        copy_numbers(run.y, run.z)
        look_at_links(run, t)
        inform(run)
    else:
        begin_contacts(run, t)


@jit_separate
def begin_contacts(run: Run, t: float) -> None:
    """Determine what contacts and friction do at the start."""
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
    if run.plan[0].contacts == STEP_IN_TIME:
        inform(run)
        return
    find_touching(run)
    if not solve_active_set(run) and run.now[0].status == RUNNING:
        run.now[0].status = REASON_CONTACT
    for k in range(run.touches.shape[0]):
        run.touches[k].held = run.touches[k].state


@jit_separate
def derive_again(run: Run, t: float) -> None:
    """Determine what contacts do after the events at the trial's end, whose impacts have changed forces."""
    look_at_links(run, t)
    find_touching(run)
    if solve_active_set(run):
        note_contact_changes(run, first_of_group(run, run.now[0].rows - 1))
    else:
        end_march(run, REASON_CONTACT)


@jit_separate
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


@jit_separate
def resolve(run: Run, t: float) -> None:
    """Change the trial's state by what happens to contacts at its end."""
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
