"""Impacts of many links at once: impulses that solve a linear complementarity problem, or one link after the other.

Few links are solved for by Lemke's method, many by `normal_forces`, whose residual has to fall to rounding. Laws are
those of `march.contacts.impact`.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import LOSS, RESIDUAL, ROWS, TERMS, TOGETHER, UNSOLVED, WORK, blame
from xdynamics.march.assembly.closed_links import DRAG, GRIP, OWN_SCALE, RETURNED, RIGHT, SCALE, X
from xdynamics.march.assembly.friction import solve_links
from xdynamics.march.assembly.links import ASSEMBLY, LINK, NOISE
from xdynamics.march.assembly.single_impacts import each_alone, reverse
from xdynamics.march.assembly.touching import (
    ACTS,
    BEFORE,
    BOUNCE,
    CANDIDATE,
    EARLY,
    GIVES_BACK,
    IMPULSE,
    KINETIC,
    LOST,
    OWN,
    PULL,
    RATE,
    RUBS,
    SLACK,
    SLIP,
    SLIP_AFTER,
    SLIP_EARLY,
    SLIP_OWN,
    TARGET_RATE,
    TOTAL,
    TOTAL_PULL,
    apply_impulse,
    gap_rate,
    slip_of,
)
from xdynamics.march.contacts.complementarity import clear_tableau, solve_complementarity
from xdynamics.march.contacts.impact import ENERGETIC, NEWTON, POISSON, SEQUENTIAL
from xdynamics.march.run import STEP_LINKS, Run

MOST_LEMKE = 32  # links that Lemke's method solves for
MOST_ROUNDS = 1000
ALLOWED_OVER_STEP = 1e-6  # of rates: what impulses over a step may leave, whose own error is far larger


@jit_separate
def collide_links(run: Run) -> bool:
    """Change the velocities of the trial's state by the impulses of the links that touch; whether they were found."""
    if not any_link_approaches(run):
        return True
    law = run.assemblies[run.candidates[int(run.touching[0, CANDIDATE]), ASSEMBLY]].law
    if law == SEQUENTIAL:
        return reverse_links_in_turn(run)
    if law == ENERGETIC:
        return each_alone(run)
    for _ in range(MOST_ROUNDS):
        if not press_links(run, 1.0 if law == NEWTON else 0.0):
            return False
        if law == POISSON and not restore_link_impulses(run):
            return False
        if not any_link_approaches(run):
            return True
    return press_links(run, 0.0)


@jit_separate
def weigh_link_impulses(run: Run) -> None:
    """Add the energy that impulses took, what moving surfaces gave by them, and the size of the terms."""
    for a in range(run.counters[TOGETHER]):
        impulse = run.touching[a, TOTAL]
        run.spans[LOSS] += run.touching[a, LOST]
        run.spans[WORK] -= impulse * run.touching[a, EARLY]
        run.spans[TERMS] += abs(impulse) * (abs(run.touching[a, RATE]) + abs(gap_rate(run, a)))
        if run.touching[a, RUBS] == 1.0:
            pull = run.touching[a, TOTAL_PULL]
            run.spans[WORK] -= pull * run.touching[a, SLIP_EARLY]
            run.spans[TERMS] += abs(pull) * (abs(run.touching[a, SLIP]) + abs(slip_of(run, a)))


@jit_separate
def any_link_approaches(run: Run) -> bool:
    """Whether a link that touches approaches by more than rounding leaves."""
    approaches = False
    for a in range(run.counters[TOGETHER]):
        approaches = approaches or gap_rate(run, a) < -run.touching[a, SLACK]
    return approaches


@jit_separate
def any_open_approaches(run: Run) -> bool:
    """Whether a link that was not closed just now approaches; what is left of others is by directions of a moment ago."""
    approaches = False
    for a in range(run.counters[TOGETHER]):
        approaches = approaches or (run.touching[a, ACTS] == 0.0 and gap_rate(run, a) < -run.touching[a, SLACK])
    return approaches


@jit_separate
def reverse_links_in_turn(run: Run) -> bool:
    """Reverse the rate of one link after the other, until none approaches."""
    for _ in range(MOST_ROUNDS * run.counters[TOGETHER]):
        quiet = True
        for a in range(run.counters[TOGETHER]):
            rate = gap_rate(run, a)
            if rate < -run.touching[a, SLACK]:
                quiet = False
                if not reverse(run, a):
                    return False
        if quiet:
            return True
    return press_links(run, 0.0)  # what is left after so many is far below what began


@jit_separate
def press_links(run: Run, share: float) -> bool:
    """Find the impulses of links that approach or rest together; `share` of each restitution counts."""
    for a in range(run.counters[TOGETHER]):
        rate = gap_rate(run, a)
        run.touching[a, ACTS] = 1.0 if rate <= run.touching[a, SLACK] else 0.0
        run.touching[a, TARGET_RATE] = share * run.touching[a, BOUNCE] * min(rate, 0.0)
        run.touching[a, GIVES_BACK] = 0.0
    return solve_link_impulses(run)


@jit_separate
def restore_link_impulses(run: Run) -> bool:
    """Have each link give back its share of the impulse of compression (Poisson)."""
    rows = int(run.counters[ROWS])
    for a in range(run.counters[TOGETHER]):
        acts = run.touching[a, ACTS] == 1.0
        run.touching[a, BEFORE], run.touching[a, TARGET_RATE] = gap_rate(run, a), 0.0
        run.touching[a, GIVES_BACK] = run.touching[a, BOUNCE] * run.touching[a, IMPULSE] if acts else 0.0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, GIVES_BACK] != 0.0:
            apply_impulse(run, rows * a, run.touching[a, GIVES_BACK])
    for a in range(run.counters[TOGETHER]):
        impulse = run.touching[a, GIVES_BACK]
        run.touching[a, TOTAL] += impulse
        run.touching[a, LOST] -= impulse * (run.touching[a, BEFORE] + gap_rate(run, a)) / 2.0
    return solve_link_impulses(run)


@jit_separate
def solve_link_impulses(run: Run) -> bool:
    """Find non-negative impulses after which no link that acts is below its target, nor above it with an impulse."""
    count = 0
    for a in range(run.counters[TOGETHER]):
        run.touching[a, BEFORE], run.touching[a, IMPULSE] = gap_rate(run, a), 0.0
        count += 1 if run.touching[a, ACTS] == 1.0 else 0
    rubs = run.counters[ROWS] == 2
    for a in range(run.counters[TOGETHER]):
        if rubs:
            run.touching[a, SLIP_AFTER], run.touching[a, PULL] = slip_of(run, a), 0.0
    solved = solve_by_lemke(run, count) if count <= MOST_LEMKE and not rubs else solve_by_gradients(run)
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, TOTAL] += run.touching[a, IMPULSE]
            run.touching[a, LOST] -= run.touching[a, IMPULSE] * (run.touching[a, BEFORE] + gap_rate(run, a)) / 2.0
            if run.touching[a, RUBS] == 1.0 and rubs:
                pull = run.touching[a, PULL]
                run.touching[a, TOTAL_PULL] += pull
                run.touching[a, LOST] -= pull * (run.touching[a, SLIP_AFTER] + slip_of(run, a)) / 2.0
    residual = impulse_residual(run)
    run.spans[RESIDUAL] = max(run.spans[RESIDUAL], residual)
    allowed = largest_slack(run) * (ALLOWED_OVER_STEP / NOISE if run.plan[0].links == STEP_LINKS else 1.0)
    if not (solved and residual <= allowed):
        k = int(run.touching[0, CANDIDATE])
        blame(run, UNSOLVED, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
        return False
    return True


@jit_separate
def largest_slack(run: Run) -> float:
    """What rounding may leave of the residual of all links together: of their rates, and of what impulses change them by.

    A ball below many others has an impulse that would give it alone many times the velocity of all.
    """
    slack = 0.0
    for a in range(run.counters[TOGETHER]):
        slack = max(slack, run.touching[a, SLACK], NOISE * abs(run.touching[a, IMPULSE]) * run.touching[a, OWN])
    return slack


@jit_separate
def impulse_residual(run: Run) -> float:
    """The residual: how far a link that acts is below its target, or above it though it has an impulse."""
    worst = 0.0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            above = gap_rate(run, a) + run.touching[a, TARGET_RATE]
            worst = max(worst, abs(min(above, run.touching[a, IMPULSE] * run.touching[a, OWN])))
            if run.counters[ROWS] == 2 and run.touching[a, RUBS] == 1.0:
                self_response, load = run.touching[a, SLIP_OWN], run.touching[a, IMPULSE] + run.touching[a, GIVES_BACK]
                friction_limit = run.touching[a, KINETIC] * load
                pull = run.touching[a, PULL]
                projected = min(max(-friction_limit, pull - slip_of(run, a) / self_response), friction_limit)
                worst = max(worst, abs(pull - projected) * self_response)
    return worst


@jit_separate
def solve_by_gradients(run: Run) -> bool:
    """Find the impulses by projected gradients; whether they are finite, `impulse_residual` says how good they are."""
    count, rows = run.counters[TOGETHER], int(run.counters[ROWS])
    for a in range(count):
        acts, row = run.touching[a, ACTS] == 1.0, rows * a
        run.vectors[SCALE, row] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, row] = -(gap_rate(run, a) + run.touching[a, TARGET_RATE]) * run.vectors[SCALE, row]
        if rows == 2:
            pose_slip(run, a, acts, slip_of(run, a))
            run.vectors[GRIP, row + 1], run.vectors[RETURNED, row] = (
                run.touching[a, KINETIC],
                run.touching[a, GIVES_BACK],
            )
    left = solve_links(run, 0, count)
    for a in range(count):
        row = rows * a
        run.touching[a, IMPULSE] = run.vectors[X, row] * run.vectors[SCALE, row]
        apply_impulse(run, row, run.touching[a, IMPULSE])
        if rows == 2:
            run.touching[a, PULL] = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1]
            apply_impulse(run, row + 1, run.touching[a, PULL])
    return left < inf


@jit_separate
def pose_slip(run: Run, a: int, acts: bool, slip: float) -> None:
    """Write what a link's slip, or its acceleration, is to change by; nothing where it has no friction."""
    row, acts = 2 * a + 1, acts and run.touching[a, RUBS] == 1.0
    scale = 1.0 / sqrt(run.touching[a, SLIP_OWN]) if acts else 0.0
    run.vectors[SCALE, row], run.vectors[OWN_SCALE, row] = scale, scale
    run.vectors[RIGHT, row], run.vectors[GRIP, row], run.vectors[DRAG, row] = -slip * scale, 0.0, 0.0


@jit_separate
def solve_by_lemke(run: Run, n: int) -> bool:
    """Find the impulses by Lemke's method, scaled so that every link answers itself with one."""
    clear_tableau(run, n)
    i = 0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            j = 0
            for b in range(run.counters[TOGETHER]):
                if run.touching[b, ACTS] == 1.0:
                    run.problem[i, n + j] = -link_response(run, a, b) / run.touching[b, OWN]
                    j += 1
            run.problem[i, 2 * n + 1] = gap_rate(run, a) + run.touching[a, TARGET_RATE]
            i += 1
    if not solve_complementarity(run, n):
        return False
    i = 0
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, ACTS] == 1.0:
            run.touching[a, IMPULSE] = run.solution[i] / run.touching[a, OWN]
            apply_impulse(run, a, run.touching[a, IMPULSE])
            i += 1
    return True


@jit_separate
def link_response(run: Run, a: int, b: int) -> float:
    """The effect of a unit of one link's impulse on the rate of another."""
    total = 0.0
    for i in range(run.normals.shape[1]):
        for j in range(run.unit_responses.shape[1]):
            if run.coordinate_indices[a, i] == run.coordinate_indices[b, j]:
                total += run.normals[a, i] * run.unit_responses[b, j]
    return total
