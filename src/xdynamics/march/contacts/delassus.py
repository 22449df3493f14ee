"""Contacts and friction elements at a state, and the forces or impulses that they have together.

Each reaction has a part in a problem: it presses (is non-negative, and its contact does not approach), it grips (is
within its bound, and does not slip), it slides, or its value is known. The same problem is posed in rates for impulses,
and in accelerations for forces (Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008,
chapter 10).
"""

from __future__ import annotations

from math import frexp, ldexp

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import shared
from xdynamics.kernels.law import TOUCHING
from xdynamics.kernels.program import T
from xdynamics.march.calls import called
from xdynamics.march.contacts.complementarity import SMALL, prepare, solve_complementarity
from xdynamics.march.run import Run
from xdynamics.model.reactions import TANGENT

ABSENT, PRESSING, SLIDING, GRIPPING, KNOWN = range(5)
NOISE = 64.0 * EPS  # of a sum's terms: what rounding may leave


@shared
def look_at_links(run: Run, t: float) -> None:
    """Compute gaps, rates, coefficients and matrices at the trial's state."""
    run.at[T] = t
    called(run.law[TOUCHING], run, run.z, run.contact_tables, 0)


@shared
def solve_reactions(run: Run) -> bool:
    """Find the forces or impulses from the part of each reaction; whether they exist."""
    n = place_unknowns(run)
    prepare(run, n)
    for k in range(run.touches.shape[0]):
        if run.touches[k].part == PRESSING:
            pose_pressing(run, k, n)
        elif run.touches[k].part == GRIPPING:
            pose_gripping(run, k, n)
    if not solve_complementarity(run, n):
        return False
    for k in range(run.touches.shape[0]):
        touch = run.touches[k]
        total = 0.0
        for j in range(n):
            total += run.effects[k, j] * run.solution[j]
        touch.found = touch.scale * total + touch.known
    for k in range(run.touches.shape[0]):
        run.touches[k].after = run.touches[k].origin + gained(run, k)
    return True


@shared
def gained(run: Run, k: int) -> float:
    """The effect of all reactions just found on the rate, or acceleration, of one."""
    total = 0.0
    for j in range(run.touches.shape[0]):
        total += run.delassus[k, j] * run.touches[j].found
    return total


@shared
def add_impulses(run: Run) -> bool:
    """Add the impulses just found to those of the whole impact, and change the rates by them."""
    for j in range(run.touches.shape[0]):
        touch = run.touches[j]
        before = touch.rate
        touch.rate += gained(run, j)
        touch.total += touch.found
        touch.lost -= touch.found * (before + touch.rate) / 2.0  # as seen from the body that is struck
    return True


@shared
def place_unknowns(run: Run) -> int:
    """Number the unknowns, and note what a unit of each adds to the reactions; return how many there are."""
    n, m = 0, run.touches.shape[0]
    for k in range(m):
        touch = run.touches[k]
        # a power of two, by which scaling is exact
        touch.scale = ldexp(1.0, -(frexp(run.delassus[k, k])[1] // 2))
        touch.place = n
        n += 1 if touch.part == PRESSING else (3 if touch.part == GRIPPING else 0)
    for k in range(m):
        for j in range(n):
            run.effects[k, j] = 0.0
    for k in range(m):
        touch = run.touches[k]
        if touch.part == PRESSING:
            run.effects[k, touch.place] = 1.0
        elif touch.part == GRIPPING:
            run.effects[k, touch.place], run.effects[k, touch.place + 1] = 1.0, -1.0
        elif touch.part == SLIDING:
            normal = run.touches[run.reactions[k].normal]
            run.effects[k, normal.place] = -touch.way * touch.coefficient * normal.scale / touch.scale
    return n


@shared
def pose_pressing(run: Run, k: int, n: int) -> None:
    """Write the row of a contact that presses: it does not approach."""
    place = run.touches[k].place
    for j in range(n):
        run.problem[place, n + j] = -answer(run, k, j)
    run.problem[place, 2 * n + 1] = start(run, k)


@shared
def pose_gripping(run: Run, k: int, n: int) -> None:
    """Write the rows of a grip: there is no slip, or the grip is at its bound, against the slip."""
    touch = run.touches[k]
    place, slip = touch.place, touch.place + 2
    bound = touch.bound
    for j in range(n):
        value = answer(run, k, j)
        run.problem[place, n + j], run.problem[place + 1, n + j] = -value, value
    for i in (place, place + 1):
        run.problem[i, n + slip] = -1.0
        run.problem[slip, n + i] = 1.0
    if run.reactions[k].role == TANGENT:
        normal = run.touches[run.reactions[k].normal]
        run.problem[slip, n + normal.place] = -touch.coefficient * normal.scale / touch.scale
        bound += touch.coefficient * normal.known
    run.problem[place, 2 * n + 1] = start(run, k)
    run.problem[place + 1, 2 * n + 1] = -start(run, k)
    run.problem[slip, 2 * n + 1] = bound / touch.scale


@shared
def answer(run: Run, k: int, j: int) -> float:
    """The effect of a unit of unknown j on the rate, or acceleration, of a reaction, both scaled."""
    total = 0.0
    for i in range(run.touches.shape[0]):
        total += run.delassus[k, i] * (run.touches[i].scale * run.effects[i, j])
    return run.touches[k].scale * total


@shared
def start(run: Run, k: int) -> float:
    """The rate, or acceleration, of a reaction without the unknowns, scaled."""
    total = run.touches[k].origin
    for i in range(run.touches.shape[0]):
        total += run.delassus[k, i] * run.touches[i].known
    return run.touches[k].scale * total


@shared
def slips(run: Run, k: int) -> bool:
    """Whether a grip slips all the same."""
    touch = run.touches[k]
    return run.solution[touch.place + 2] > SMALL * touch.scale * terms(run, k)


@shared
def terms(run: Run, k: int) -> float:
    """The size of the terms of a reaction's rate, or acceleration, with all reactions just found."""
    size = abs(run.touches[k].origin)
    for j in range(run.touches.shape[0]):
        size += abs(run.delassus[k, j] * run.touches[j].found)
    return size
