"""Contacts and friction elements at a state, and the forces or impulses that they have together.

Each reaction has a part in a problem: it presses (is non-negative, and its contact does not approach), it grips (is
within its bound, and does not slip), it slides, or its value is known. The same problem is posed in rates for impulses,
and in accelerations for forces (Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008,
chapter 10).
"""

from __future__ import annotations

from math import frexp, ldexp

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.law import TOUCHING
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.contacts.complementarity import SMALL, clear_tableau, solve_complementarity
from xdynamics.march.run import Run
from xdynamics.model.reactions import TANGENT

ABSENT, PRESSING, SLIDING, GRIPPING, KNOWN = range(5)
SUM_NOISE = 64.0 * EPS  # of a sum's terms: what rounding may leave


@jit_separate
def look_at_links(run: Run, t: float) -> None:
    """Compute gaps, rates, coefficients and matrices at the trial's state."""
    run.at[T] = t
    call_law(run.law[TOUCHING], run, run.z, run.contact_tables, 0)


@jit_separate
def solve_reactions(run: Run) -> bool:
    """Find the forces or impulses from the part of each reaction; whether they exist."""
    n = place_unknowns(run)
    clear_tableau(run, n)
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
        run.touches[k].after = run.touches[k].origin + reaction_effect(run, k)
    return True


@jit_separate
def reaction_effect(run: Run, k: int) -> float:
    """The effect of all reactions just found on the rate, or acceleration, of one."""
    total = 0.0
    for j in range(run.touches.shape[0]):
        total += run.delassus[k, j] * run.touches[j].found
    return total


@jit_separate
def add_impulses(run: Run) -> bool:
    """Add the impulses just found to those of the whole impact, and change the rates by them."""
    for j in range(run.touches.shape[0]):
        touch = run.touches[j]
        rate_before = touch.rate
        touch.rate += reaction_effect(run, j)
        touch.total += touch.found
        touch.lost -= touch.found * (rate_before + touch.rate) / 2.0  # as seen from the body that is struck
    return True


@jit_separate
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


@jit_separate
def pose_pressing(run: Run, k: int, n: int) -> None:
    """Write the row of a contact that presses: it does not approach."""
    unknown_index = run.touches[k].place
    for j in range(n):
        run.problem[unknown_index, n + j] = -unknown_response(run, k, j)
    run.problem[unknown_index, 2 * n + 1] = free_rate(run, k)


@jit_separate
def pose_gripping(run: Run, k: int, n: int) -> None:
    """Write the rows of a grip: there is no slip, or the grip is at its bound, against the slip."""
    touch = run.touches[k]
    unknown_index, slip = touch.place, touch.place + 2
    bound = touch.bound
    for j in range(n):
        value = unknown_response(run, k, j)
        run.problem[unknown_index, n + j], run.problem[unknown_index + 1, n + j] = -value, value
    for i in (unknown_index, unknown_index + 1):
        run.problem[i, n + slip] = -1.0
        run.problem[slip, n + i] = 1.0
    if run.reactions[k].role == TANGENT:
        normal = run.touches[run.reactions[k].normal]
        run.problem[slip, n + normal.place] = -touch.coefficient * normal.scale / touch.scale
        bound += touch.coefficient * normal.known
    run.problem[unknown_index, 2 * n + 1] = free_rate(run, k)
    run.problem[unknown_index + 1, 2 * n + 1] = -free_rate(run, k)
    run.problem[slip, 2 * n + 1] = bound / touch.scale


@jit_separate
def unknown_response(run: Run, k: int, j: int) -> float:
    """The effect of a unit of unknown j on the rate, or acceleration, of a reaction, both scaled."""
    total = 0.0
    for i in range(run.touches.shape[0]):
        total += run.delassus[k, i] * (run.touches[i].scale * run.effects[i, j])
    return run.touches[k].scale * total


@jit_separate
def free_rate(run: Run, k: int) -> float:
    """The rate, or acceleration, of a reaction without the unknowns, scaled."""
    total = run.touches[k].origin
    for i in range(run.touches.shape[0]):
        total += run.delassus[k, i] * run.touches[i].known
    return run.touches[k].scale * total


@jit_separate
def slips(run: Run, k: int) -> bool:
    """Whether a grip slips all the same."""
    touch = run.touches[k]
    return run.solution[touch.place + 2] > SMALL * touch.scale * size_of_terms(run, k)


@jit_separate
def size_of_terms(run: Run, k: int) -> float:
    """The size of the terms of a reaction's rate, or acceleration, with all reactions just found."""
    size = abs(run.touches[k].origin)
    for j in range(run.touches.shape[0]):
        size += abs(run.delassus[k, j] * run.touches[j].found)
    return size
