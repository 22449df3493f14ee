"""Guards of contacts: the effect of a group of events, and every recorded row, against the law of contact.

The guards of a group of events are identities of mechanics, whatever the law of impacts and however surfaces move, so
that their residual is due to rounding, or to the location of events. A group that breaks one ends the run.

The guard of recorded rows: contacts press and do not pull, friction stays within its bound, gaps are not negative. The
march lands where one of these would be broken. A row that breaks one all the same contradicts the law of contact,
whatever led to it, and ends the run.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import DETECT, SLOPES
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.contacts.delassus import SUM_NOISE, brake, impact_spread, list_holding, location_time, size_of_gap
from xdynamics.march.events.departures import LATE
from xdynamics.march.events.zero_tests import NEAR, event_resolution, noise_floor
from xdynamics.march.force_evaluation import set_time, settle_constraints
from xdynamics.march.outcomes import CONTACT_INCONSISTENT, CONTACT_VIOLATED, RUNNING
from xdynamics.march.phases import CONTACTS, phase
from xdynamics.march.run import (
    APART,
    BALANCE,
    BEFORE,
    BEHIND,
    BOUND,
    FIGURE,
    GUARD,
    KEPT_ALL,
    LOSSES,
    OWNER,
    SHIFTED,
    SKIPPED,
    SLOWED,
    TAKEN,
    TERMS,
    WORK,
    Run,
)
from xdynamics.model.detectors import GAP, GRIP, PULL, SLIP
from xdynamics.model.reactions import NORMAL

LEFT = 16.0 * SUM_NOISE  # of the energies of a group: what rounding may leave for each of its bodies and contacts


@jit_separate
def open_balance(run: Run) -> None:
    """Keep the state that contacts are to change; links are at that state."""
    for i in range(2 * run.plan[0].coordinates):
        run.entry[i] = run.z[i]
    for k in range(run.touches.shape[0]):
        run.pulled[k], run.slowed[k], run.approach[k] = 0.0, 0.0, run.links[k].rate
    run.balance[GUARD] = KEPT_ALL
    for i in range(TAKEN, BALANCE):
        run.balance[i] = 0.0


@jit_separate
def note_broken_guard(run: Run, guard: int, owner: int, figure: float, bound: float) -> None:
    """Store the first guard that is broken; a figure that is NaN breaks it, too."""
    if run.balance[GUARD] == KEPT_ALL and not figure <= bound:
        run.balance[GUARD], run.balance[OWNER], run.balance[FIGURE], run.balance[BOUND] = guard, owner, figure, bound


@jit_separate
def weigh_contact_impulses(run: Run) -> None:
    """Check the gaps of contacts that acted, and sum the energy that impulses took; links are those after them."""
    for k in range(run.touches.shape[0]):
        touch, rate_after = run.touches[k], run.links[k].rate
        if touch.total == 0.0:
            continue
        run.balance[TAKEN] -= touch.total * (run.approach[k] + rate_after) / 2.0
        run.balance[TERMS] += abs(touch.total) * (abs(run.approach[k]) + abs(rate_after))
        if run.reactions[k].role == NORMAL:
            note_broken_guard(run, APART, k, abs(run.links[k].gap), 2.0 * gap_reach(run, k))


@jit_separate
def gap_reach(run: Run, k: int) -> float:
    """How far from zero a gap that acted may be: by its location, on whose bracket its rate changes, too, and by rounding."""
    width = location_time(run, k)
    return max(impact_spread(run, k), SUM_NOISE * size_of_gap(run, k)) + abs(run.links[k].free) * width * width


@jit_separate
def weigh_rates(run: Run) -> None:
    """Check the rates that were taken from resting contacts, and sticking friction, with no impulse recorded."""
    for i in range(list_holding(run, False)):
        k = run.chosen[i]
        touch, free = run.touches[k], abs(run.links[k].free)
        slow = touch.slack + (free + brake(run, k)) * location_time(run, k)
        if touch.lost > 0.0:  # skipped bounces, whose energy is recorded
            slow += sqrt(2.0 * run.delassus[k, k] * touch.lost)
        if (
            touch.hit == GAP and touch.total == 0.0
        ):  # a gap that a step of low order closed; see `active_set.assign_part`
            slow += free * run.trial[0].h
        note_broken_guard(run, SLOWED, k, abs(run.slowed[k]), 4.0 * slow)


@jit_separate
def weigh_positions(run: Run, settling: bool) -> None:
    """Check how far resting contacts have moved the state of `open_balance`: no farther than their gaps were open."""
    count, farthest = list_holding(run, settling), 0.0
    for i in range(count):
        k = run.chosen[i]
        if run.reactions[k].role == NORMAL:
            farthest = max(farthest, gap_reach(run, k))
    for i in range(run.plan[0].coordinates):
        response_sum = 0.0
        for j in range(count):
            response_sum += abs(run.responses[run.chosen[j], i]) / run.delassus[run.chosen[j], run.chosen[j]]
        # rows of the inverse of a chain of `count` gaps have sums up to count**2/8 of that of one
        bound = response_sum * farthest * (1.0 + count * count / 4.0)
        note_broken_guard(run, SHIFTED, i, abs(run.z[i] - run.entry[i]), 2.0 * bound)


@jit_separate
def weigh_energies(run: Run, first: int) -> None:
    """Check kinetic energy on both sides, and the energies of a group's rows, against the impulses of these rows.

    Kinetic energy changes by each impulse times the mean of its velocities before and after: for masses M and impulses
    p with M (v1 - v0) = p it is (v1 + v0) p/2. Constraints that move lead velocities by u, and do the work of what they
    add to p: with them it is ((v1 + v0)/2 - u) p.
    """
    n, last = run.plan[0].coordinates, run.now[0].events - run.base[0].events
    work, terms, lost = 0.0, run.balance[BEFORE] + run.balance[BEHIND], 0.0
    if run.plan[0].held > 0:
        find_led_velocities(run)
    for i in range(n):
        impulse = 0.0
        for e in range(first, last):
            impulse += run.log_impulses[i, e]
        for k in range(run.touches.shape[0]):
            impulse += run.directions[k, i] * run.pulled[k]
        velocity_before, velocity_after = run.entry[n + i], run.z[n + i]
        led = run.whole[n + i] if run.plan[0].held > 0 else 0.0
        work += impulse * ((velocity_before + velocity_after) / 2.0 - led)
        terms += abs(impulse) * (abs(velocity_before) + abs(velocity_after) + abs(led))
    for e in range(first, last):
        lost += run.log_impulses[n, e]
    bound = LEFT * (n + run.touches.shape[0]) * (terms + run.balance[TERMS])
    if run.plan[0].kinetic >= 0:
        note_broken_guard(run, WORK, 0, abs(run.balance[BEHIND] - run.balance[BEFORE] - work), bound)
    note_broken_guard(run, LOSSES, 0, abs(lost - run.balance[SKIPPED] - run.balance[TAKEN]), bound)


@jit_separate
def find_led_velocities(run: Run) -> None:
    """Store in `whole` the velocities that constraints impose on a state at rest."""
    n = run.plan[0].coordinates
    for i in range(run.z.shape[0]):
        run.whole[i] = 0.0 if n <= i < 2 * n else run.z[i]
    settle_constraints(run, run.trial[0].t, run.whole, 0.0)


@jit_separate
def is_broken(run: Run) -> bool:
    """Whether a guard was broken, which ends the run."""
    if run.balance[GUARD] == KEPT_ALL:
        return False
    run.now[0].status, run.now[0].h = CONTACT_INCONSISTENT, run.trial[0].h
    return True


State = NDArray[Any]

ALLOWED = 16.0  # times what rounding and the location of events leave of a force, slip or gap at its zero


@phase(CONTACTS)
def check_contact_law(run: Run, t: float) -> None:
    """End a run where a contact pulls, holds more than friction can, slips against its friction, or is penetrated.

    The state is that of the trial, which is a row or becomes one, at time t.
    """
    state, values = run.z, run.g1
    set_time(run, T, t)
    call_law(run.law[DETECT], run, state, values, 0)
    for i in range(run.detectors.shape[0]):
        watch, detector = run.watches[i], run.detectors[i]
        if detector.role not in (GAP, PULL, GRIP, SLIP) or watch.asleep or not values[i] * watch.guard < 0.0:
            continue
        if run.now[0].status == RUNNING and abs(values[i]) > ALLOWED * allowed_residue(run, i, abs(values[i]), state):
            run.now[0].status = CONTACT_VIOLATED
            run.balance[OWNER], run.balance[FIGURE] = float(i), values[i]


@jit_separate
def allowed_residue(run: Run, i: int, value: float, state: State) -> float:
    """Return how far from its zero rounding and the location of events may leave a function that may not pass it.

    A force is compared with what it had to hold at the last event, and its larger value in the last step.
    """
    k, role = run.detectors[i].reaction, run.detectors[i].role
    call_law(run.law[SLOPES], run, state, run.arguments, 0)
    left = max(noise_floor(run, i, state), LATE * event_resolution(run, i, 0.0) * abs(run.arguments[i]))
    if role == GAP:
        return max(left, impact_spread(run, k))
    if role == SLIP:
        return max(left, run.touches[k].slack)
    held_force = abs(run.links[k].free) / run.delassus[k, k] if run.delassus[k, k] > 0.0 else 0.0
    return max(left, NEAR * max(held_force, run.watches[i].greatest - value))
