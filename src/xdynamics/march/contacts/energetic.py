"""Impacts by the energetic coefficient of restitution: restitution gives back e**2 of the work of compression.

The normal impulse p is the independent variable, in which rates are straight lines while the contact slips one way, or
sticks (Routh; W. J. Stronge, Impact Mechanics, 2nd ed. 2018, chapters 3 and 4; Proc. R. Soc. Lond. A 431, 1990, 169,
doi:10.1098/rspa.1990.0125): slip that comes to rest sticks where friction can hold it and reverses where it cannot. All
is in closed form: the work is a parabola in each such phase. No energy can be created, whatever friction does.

Several contacts at once are struck one by one where none acts on another that approaches. Where they do act on each
other, the distribution of impulses depends on their stiffnesses (Liu, Zhao, Brogliato, Proc. R. Soc. A 464, 2008, 3193,
doi:10.1098/rspa.2008.0078), which rigid bodies do not have: there is no solution then.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import shared
from xdynamics.march.contacts.delassus import ABSENT, NOISE, PRESSING, add_impulses, gained
from xdynamics.march.run import Run
from xdynamics.model.reactions import NORMAL, TANGENT

FRICTIONLESS = -1
MOST_PHASES = 8  # compression and restitution, each slipping and then sticking or slipping back, are four


@shared
def strike(run: Run) -> bool:
    """Find the impulse of every contact that approaches; whether they are determined."""
    for k in range(run.touches.shape[0]):
        run.touches[k].part = PRESSING if struck(run, k) else ABSENT
    solved = True
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            solved = solved and alone(run, k)
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            solved = solved and strike_one(run, k)
    return solved


@shared
def struck(run: Run, k: int) -> bool:
    """Whether a contact that touches approaches."""
    touch = run.touches[k]
    return bool(run.reactions[k].role == NORMAL and touch.near and touch.rate < -touch.slack)


@shared
def alone(run: Run, k: int) -> bool:
    """Whether a contact that approaches acts on no other one that does."""
    for j in range(run.touches.shape[0]):
        owner = run.reactions[j].normal
        if owner != k and run.reactions[j].role in (NORMAL, TANGENT) and run.touches[owner].part == PRESSING:
            for i in range(run.touches.shape[0]):
                own = i == k or (run.reactions[i].role == TANGENT and run.reactions[i].normal == k)
                if own and abs(run.delassus[j, i]) > NOISE * sqrt(run.delassus[j, j] * run.delassus[i, i]):
                    return False
    return True


@shared
def tangent_of(run: Run, k: int) -> int:
    """The number of a contact's friction; `FRICTIONLESS` where it has none."""
    for j in range(run.touches.shape[0]):
        if run.reactions[j].role == TANGENT and run.reactions[j].normal == k:
            return j
    return FRICTIONLESS


@shared
def strike_one(run: Run, k: int) -> bool:
    """Find the impulse of one contact phase by phase, and what it does to all rates; whether no other one is pressed.

    A phase ends where slip comes to rest, where compression ends, or where restitution has given back its work.
    """
    along, normal = tangent_of(run, k), run.touches[k]
    speed, slip = normal.rate, run.touches[along].rate if along != FRICTIONLESS else 0.0
    impulse, friction, work, compressing = 0.0, 0.0, 0.0, True
    for j in range(run.touches.shape[0]):
        run.touches[j].found = 0.0
    for _ in range(MOST_PHASES):
        ratio, opening, sliding = slopes(run, k, along, slip)
        if not opening > NOISE * run.delassus[k, k] and slip == 0.0:
            # sticking holds the gap too, as for a body with one coordinate: nothing moves any more
            return abs(speed) <= NOISE * abs(normal.rate) and add_impulses(run)
        reached, step = 0.0, -speed / opening if opening > 0.0 else inf
        if not compressing:
            reached = sqrt(max(0.0, speed * speed + 2.0 * opening * work))
            step = 2.0 * work / (reached + speed) if reached + speed > 0.0 else 0.0
        until = -slip / sliding if slip * sliding < 0.0 else inf
        halts = until < step
        step = min(step, until)
        if not step < inf:
            return False
        after = speed + opening * step if halts else reached
        work -= step * (speed + after) / 2.0
        impulse, friction, speed = impulse + step, friction + ratio * step, after
        slip = 0.0 if halts else slip + sliding * step
        normal.found = impulse
        if along != FRICTIONLESS:
            run.touches[along].found = friction
        if presses_others(run, k):
            return False
        if not halts and not compressing:
            return add_impulses(run)
        if not halts:
            compressing, work = False, normal.bounce * normal.bounce * work
    return False


@shared
def slopes(run: Run, k: int, along: int, slip: float) -> tuple[float, float, float]:
    """How friction, the rate of the gap and the slip grow with the normal impulse.

    Friction acts against the slip; without slip it holds or, where it cannot, is at its limit.
    """
    if along == FRICTIONLESS:
        return 0.0, run.delassus[k, k], 0.0
    most, holding = run.links[along].coefficient, -run.delassus[along, k] / run.delassus[along, along]
    ratio = min(max(holding, -most), most)
    if slip != 0.0:
        ratio = -most if slip > 0.0 else most
    sliding = run.delassus[along, k] + run.delassus[along, along] * ratio
    sticks = slip == 0.0 and ratio == holding
    return ratio, run.delassus[k, k] + run.delassus[k, along] * ratio, 0.0 if sticks else sliding


@shared
def presses_others(run: Run, k: int) -> bool:
    """Whether the impulses so far make another contact that touches approach."""
    for j in range(run.touches.shape[0]):
        touch = run.touches[j]
        if j != k and run.reactions[j].role == NORMAL and touch.near and touch.part == ABSENT:
            change = gained(run, j)
            if change < 0.0 and touch.rate + change < -max(touch.slack, NOISE * (abs(touch.rate) + abs(change))):
                return True
    return False
