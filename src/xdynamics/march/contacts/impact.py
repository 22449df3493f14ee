"""Impacts: velocities change by impulses along the reactions of the contacts that touch, by one of four laws.

`newton`: each rate of approach is reversed and multiplied by the coefficient of restitution, all at once (Moreau). With
several contacts the impulses solve a linear complementarity problem, with Coulomb's friction for impulses.
`poisson`: a phase of compression up to rates of zero, then each contact gives back its share of the normal impulse
(Glocker and Pfeiffer, Nonlinear Dynamics 7, 1995, doi:10.1007/BF00121109). `sequential`: Newton's law for one contact
after the other in declared order, until none approaches. `energetic`: e**2 of the work of compression returns.

The phases of an energetic impact with friction are in closed form. The normal impulse p is the independent variable, in
which rates are straight lines while the contact slips one way, or sticks (Routh; W. J. Stronge, Impact Mechanics, 2nd
ed. 2018, chapters 3 and 4; Proc. R. Soc. Lond. A 431, 1990, 169, doi:10.1098/rspa.1990.0125): slip that comes to rest
sticks where friction can hold it and reverses where it cannot. The work is a parabola in each such phase. No energy can
be created, whatever friction does.

By the energetic law several contacts at once are struck one by one where none acts on another that approaches. Where
they do act on each other, the distribution of impulses depends on their stiffnesses (Liu, Zhao, Brogliato, Proc. R.
Soc. A 464, 2008, 3193, doi:10.1098/rspa.2008.0078), which rigid bodies do not have: there is no solution then.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.contacts.delassus import (
    ABSENT,
    GRIPPING,
    PRESSING,
    SUM_NOISE,
    TURNS,
    add_impulses,
    reaction_effect,
    solve_compliantly,
    solve_reactions,
)
from xdynamics.march.run import Run
from xdynamics.model.parts import IMPACT_LAWS
from xdynamics.model.reactions import NORMAL, TANGENT

COMPRESSION, RESTITUTION, ENDED, WITHOUT_END = range(4)
MOST_PHASES = 8  # compression and restitution, each slipping and then sticking or slipping back, are four


@jit_separate
def phase_slopes(
    self_response: float, across: float, slip_response: float, friction_ratio: float, slip: float
) -> tuple[float, float, float]:
    """How friction, the rate of the gap and the slip grow with the normal impulse.

    An impulse changes the rate of the gap by `self_response` and the slip by `across`, one of friction the slip by `slip_response`, which
    is 0 without friction. Friction acts against the slip, by the share `friction_ratio` of the normal impulse; without slip it
    holds or, where it cannot, is at its limit.
    """
    if slip_response == 0.0:
        return 0.0, self_response, 0.0
    holding = -across / slip_response
    ratio = min(max(holding, -friction_ratio), friction_ratio)
    if slip != 0.0:
        ratio = -friction_ratio if slip > 0.0 else friction_ratio
    # exact: clamping returns `holding` itself where friction can hold
    sticks = slip == 0.0 and ratio == holding
    return ratio, self_response + across * ratio, 0.0 if sticks else across + slip_response * ratio


@jit_separate
def end_of_phase(
    phase: int, opening: float, sliding: float, speed: float, slip: float, work: float, bounce: float
) -> tuple[int, float, float, float, float]:
    """Go on to the end of a phase: the next one, its normal impulse, and the rate of the gap, the slip and the work there.

    A phase ends where slip comes to rest, where compression ends, or where restitution has given back its work.
    """
    reached, step = 0.0, -speed / opening if opening > 0.0 else inf
    if phase == RESTITUTION:
        reached = sqrt(max(0.0, speed * speed + 2.0 * opening * work))
        # (reached - speed)/opening without its cancellation, and also where opening is zero
        step = 2.0 * work / (reached + speed) if reached + speed > 0.0 else 0.0
    until = -slip / sliding if slip * sliding < 0.0 else inf
    halts = until < step
    step = min(step, until)
    # negated, so that nan has no end either
    if not step < inf:
        return WITHOUT_END, step, speed, slip, work
    speed_after = speed + opening * step if halts else reached
    work -= step * (speed + speed_after) / 2.0
    if halts:
        return phase, step, speed_after, 0.0, work
    slip += sliding * step
    if phase == RESTITUTION:
        return ENDED, step, speed_after, slip, work
    return RESTITUTION, step, speed_after, slip, bounce * bounce * work


@jit_separate
def is_held(opening: float, self_response: float, slip: float) -> bool:
    """Whether sticking holds the gap too, as of a body with one coordinate: nothing moves any more."""
    return not opening > SUM_NOISE * self_response and slip == 0.0


FRICTIONLESS = -1


@jit_separate
def strike_energetically(run: Run) -> bool:
    """Find the impulse of every contact that approaches; whether they are determined."""
    for k in range(run.touches.shape[0]):
        run.touches[k].part = PRESSING if contact_approaches(run, k) else ABSENT
    solved = True
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            solved = solved and acts_alone(run, k)
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            solved = solved and strike_one(run, k)
    return solved


@jit_separate
def contact_approaches(run: Run, k: int) -> bool:
    """Whether a contact that touches approaches."""
    touch = run.touches[k]
    return bool(run.reactions[k].role == NORMAL and touch.near and touch.rate < -touch.slack)


@jit_separate
def acts_alone(run: Run, k: int) -> bool:
    """Whether a contact that approaches acts on no other one that does."""
    for j in range(run.touches.shape[0]):
        owner = run.reactions[j].normal
        if owner != k and run.reactions[j].role in (NORMAL, TANGENT) and run.touches[owner].part == PRESSING:
            for i in range(run.touches.shape[0]):
                is_own = i == k or (run.reactions[i].role == TANGENT and run.reactions[i].normal == k)
                if is_own and abs(run.delassus[j, i]) > SUM_NOISE * sqrt(run.delassus[j, j] * run.delassus[i, i]):
                    return False
    return True


@jit_separate
def tangent_of(run: Run, k: int) -> int:
    """The number of a contact's friction; `FRICTIONLESS` where it has none."""
    for j in range(run.touches.shape[0]):
        if run.reactions[j].role == TANGENT and run.reactions[j].normal == k:
            return j
    return FRICTIONLESS


@jit_separate
def strike_one(run: Run, k: int) -> bool:
    """Solve for one contact's impulse phase by phase, with its effect on all rates; whether it presses no other."""
    tangent, normal, self_response = tangent_of(run, k), run.touches[k], run.delassus[k, k]
    speed, slip, across, slip_response, friction_ratio = normal.rate, 0.0, 0.0, 0.0, 0.0
    if tangent != FRICTIONLESS:
        across, slip_response = run.delassus[tangent, k], run.delassus[tangent, tangent]
        slip, friction_ratio = run.touches[tangent].rate, run.links[tangent].coefficient
    impulse, friction, work, phase = 0.0, 0.0, 0.0, COMPRESSION
    for j in range(run.touches.shape[0]):
        run.touches[j].found = 0.0
    for _ in range(MOST_PHASES):
        ratio, opening, sliding = phase_slopes(self_response, across, slip_response, friction_ratio, slip)
        if is_held(opening, self_response, slip):
            return abs(speed) <= SUM_NOISE * abs(normal.rate) and add_impulses(run)
        phase, step, speed, slip, work = end_of_phase(phase, opening, sliding, speed, slip, work, normal.bounce)
        if phase == WITHOUT_END:
            return False
        impulse, friction = impulse + step, friction + ratio * step
        normal.found = impulse
        if tangent != FRICTIONLESS:
            run.touches[tangent].found = friction
        if presses_others(run, k):
            return False
        if phase == ENDED:
            return add_impulses(run)
    return False


@jit_separate
def presses_others(run: Run, k: int) -> bool:
    """Whether the impulses so far make another contact that touches approach."""
    for j in range(run.touches.shape[0]):
        touch = run.touches[j]
        if j != k and run.reactions[j].role == NORMAL and touch.near and touch.part == ABSENT:
            change = reaction_effect(run, j)
            if change < 0.0 and touch.rate + change < -max(touch.slack, SUM_NOISE * (abs(touch.rate) + abs(change))):
                return True
    return False


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
    # what still approaches after so many rounds is stopped without restitution
    return press_contacts(run, ALL, 0.0)


@jit_separate
def restore_impulses(run: Run) -> bool:
    """Add each contact's share of restitution to its impulse of compression."""
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
    # friction of contacts along one line may leave Lemke's method on a ray
    solved = solve_reactions(run) or (run.plan[0].indeterminate == 1 and solve_compliantly(run, TURNS))
    return solved and add_impulses(run)


@jit_separate
def contact_rate_noise(run: Run, k: int) -> float:
    """How far from zero rounding may leave a rate after an impact."""
    size = abs(run.links[k].rate)
    for j in range(run.touches.shape[0]):
        size += abs(run.delassus[k, j] * run.touches[j].total)
    return max(run.touches[k].slack, SUM_NOISE * size)
