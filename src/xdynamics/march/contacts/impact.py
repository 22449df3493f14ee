"""Impacts: velocities change by impulses along the reactions of the contacts that touch, by one of four laws.

`newton`: each rate of approach is reversed and multiplied by the coefficient of restitution, all at once (Moreau). With
several contacts the impulses solve a linear complementarity problem, with Coulomb's friction for impulses.
`poisson`: a phase of compression up to rates of zero, then each contact gives back its share of the normal impulse
(Glocker and Pfeiffer, Nonlinear Dynamics 7, 1995, doi:10.1007/BF00121109). `sequential`: Newton's law for one contact
after the other in declared order, until none approaches. `energetic`: see `march.contacts.energetic`.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.contacts.delassus import ABSENT, GRIPPING, PRESSING, SUM_NOISE, add_impulses, solve_reactions
from xdynamics.march.contacts.energetic import strike_energetically
from xdynamics.march.run import Run
from xdynamics.model.parts import IMPACT_LAWS
from xdynamics.model.reactions import NORMAL, TANGENT

NEWTON, POISSON, SEQUENTIAL, ENERGETIC = range(len(IMPACT_LAWS))
MOST_ROUNDS = 1000  # of impacts one after the other
ALL, AGAIN = -1, -2  # contacts that do not part; those of the phase before


@jit_separate
def collide_contacts(run: Run) -> bool:
    """Find the impulses of the contacts that touch, and change the trial's velocities; whether they exist."""
    law = NEWTON
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        touch.rate, touch.total, touch.known, touch.lost = run.links[k].rate, 0.0, 0.0, 0.0
        if run.reactions[k].role == NORMAL and touch.near:
            law, touch.bounce = run.reactions[k].law, run.links[k].coefficient
            if not 0.0 <= touch.bounce <= 1.0:
                return False
    if law == SEQUENTIAL:
        solved = strike_in_turn(run)
    elif law == ENERGETIC:
        solved = strike_energetically(run)
    else:
        solved = strike_at_once(run, law)
    if solved:
        for k in range(run.touches.shape[0]):
            for i in range(run.plan[0].coordinates):
                run.z[run.plan[0].coordinates + i] += run.responses[k, i] * run.touches[k].total
    return solved


@jit_separate
def strike_at_once(run: Run, law: int) -> bool:
    """Find the impulses of all contacts that approach or rest, together, until none approaches."""
    for _ in range(MOST_ROUNDS):
        if not press_contacts(run, ALL, 1.0 if law == NEWTON else 0.0):
            return False
        if law == POISSON and not restore_impulses(run):
            return False
        if not any_contact_approaches(run):
            return True
    return press_contacts(run, ALL, 0.0)


@jit_separate
def restore_impulses(run: Run) -> bool:
    """Have each contact give back its share of the impulse of compression."""
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        if touch.part == PRESSING:
            touch.known = touch.bounce * touch.found
    solved = press_contacts(run, AGAIN, 0.0)
    for k in range(run.touches.shape[0]):
        run.touches[k].known = 0.0
    return solved


@jit_separate
def any_contact_approaches(run: Run) -> bool:
    """Whether a contact that touches approaches by more than rounding leaves."""
    approaches = False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        approaches = approaches or (
            run.reactions[k].role == NORMAL and touch.near == 1 and touch.rate < -contact_rate_noise(run, k)
        )
    return approaches


@jit_separate
def strike_in_turn(run: Run) -> bool:
    """Find the impulses of one contact after the other, until none approaches."""
    for _ in range(MOST_ROUNDS):
        quiet = True
        for k in range(run.touches.shape[0]):
            touch = run.touches[k]
            if run.reactions[k].role == NORMAL and touch.near and touch.rate < -contact_rate_noise(run, k):
                quiet = False
                if not press_contacts(run, k, 1.0):
                    return False
        if quiet:
            return True
    # what is left after so many is far below what began
    return press_contacts(run, ALL, 0.0)


@jit_separate
def press_contacts(run: Run, only: int, share: float) -> bool:
    """Find the impulses of all contacts that touch, or of one; `share` of each restitution counts."""
    for k in range(run.touches.shape[0]):
        touch, reaction = run.touches[k], run.reactions[k]
        acts = touch.near == 1 and touch.rate <= contact_rate_noise(run, k) if only == ALL else touch.part == PRESSING
        acts = k == only if only >= 0 else acts
        touch.part, touch.origin = ABSENT, touch.rate
        if reaction.role == NORMAL and acts:
            touch.part = PRESSING
            touch.origin += share * touch.bounce * min(touch.rate, 0.0)
        elif reaction.role == TANGENT and run.touches[reaction.normal].part == PRESSING:
            touch.part, touch.coefficient, touch.bound = GRIPPING, run.links[k].coefficient, 0.0
    return solve_reactions(run) and add_impulses(run)


@jit_separate
def contact_rate_noise(run: Run, k: int) -> float:
    """How far from zero rounding may leave a rate after an impact."""
    size = abs(run.links[k].rate)
    for j in range(run.touches.shape[0]):
        size += abs(run.delassus[k, j] * run.touches[j].total)
    return max(run.touches[k].slack, SUM_NOISE * size)
