"""Slow slips that are stopped at once, as bounces that are too low are skipped.

Two kinds are. A slip without forces, where links wedge and the more they press the more is needed (Painlevé's paradox;
Génot and Brogliato, Eur. J. Mech. A 18, 1999, 653): an impulse stops it, as if at an impact without approach.

A slip that an impact began, if friction ends it before it has gone as far, or lasted as long, as a bounce that may be
skipped. What would go on is not stopped, however slow: it speeds up, or its brake is too weak.

Impulses that stop slips have to lie in the cones of friction; those of the second kind together with what forces, once all
is held, give within the time of such a bounce. Then one time step of that length by Moreau and Jean ends there, too (Jean,
Comput. Methods Appl. Mech. Eng. 177, 1999, 235; Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical Systems,
2008, chapter 10). Links whose impulses would leave their cones slide on, as long as there are forces then.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import (
    NEEDED,
    NEEDED_AT,
    OUTSIDE,
    OUTSIDE_LINK,
    OUTSIDE_OF,
    ROWS,
    STRAIN,
    TOGETHER,
)
from xdynamics.march.assembly.closed_links import DRAG, GRIP, RIGHT, SCALE, SLIDES_ON, X
from xdynamics.march.assembly.friction import RESTLESS
from xdynamics.march.assembly.link_forces import solve_forces
from xdynamics.march.assembly.links import ASSEMBLY, LINK
from xdynamics.march.assembly.low_motions import bounce_time, falling, is_short, passes_soon, slip_falling
from xdynamics.march.assembly.normal_forces import ALLOWED, largest_entry, solve_equations
from xdynamics.march.assembly.touching import (
    ACTS,
    CANDIDATE,
    DRAGS,
    FORCE,
    GOES_ON,
    GRIPPED,
    HALTED,
    OWN,
    RUBS,
    SLIP_AFTER,
    SLIP_ENDED,
    SLIP_OWN,
    SLIP_SLACK,
    STATIC,
    TOTAL,
    WEDGED,
    gap_rate,
    slip_of,
)
from xdynamics.march.run import Run


@jit_separate
def halt_slips(run: Run) -> bool:
    """Have slips grip that are as slow as bounces that may be skipped, where no forces exist else; whether forces do then.

    Of these, those slide on whose impulses would leave their cones of friction, as long as there are forces.
    """
    count, any_halts = run.counters[TOGETHER] if run.counters[ROWS] == 2 else 0, False
    for a in range(count):
        slides = run.touching[a, ACTS] == 1.0 and run.vectors[DRAG, 2 * a + 1] != 0.0 and run.touching[a, HALTED] == 0.0
        if slides and is_short(run, a, slip_of(run, a), falling(run, a)):
            run.touching[a, HALTED], any_halts = WEDGED, True
    run.spans[STRAIN] = 0.0 if any_halts else run.spans[STRAIN]
    return any_halts


@jit_separate
def hold_cones(run: Run) -> bool:
    """Let links slide on that only an impulse outside their cones of friction would stop, if there are forces then."""
    any_halts = False
    for a in range(run.counters[TOGETHER] if run.counters[ROWS] == 2 else 0):
        any_halts = any_halts or run.touching[a, HALTED] != 0.0
    if not any_halts:
        return True
    has_forces = True
    while has_forces and free_outside(run):
        has_forces = find_again(run)
    if not has_forces:
        halt_again(run)
    return find_again(run)


@jit_separate
def find_again(run: Run) -> bool:
    """Solve for forces after others were not found."""
    run.spans[STRAIN] = 0.0
    return bool(solve_forces(run))


@jit_separate
def free_outside(run: Run) -> bool:
    """Let links slide on, of those that are halted, whose impulses would leave their cones of friction; whether any does."""
    count, any_leaves, lasting = run.counters[TOGETHER], False, skipped_time(run)
    pose_stop(run)
    solve_equations(run, 0, 2 * count)
    for a in range(count):
        pressing = run.vectors[X, 2 * a] * run.vectors[SCALE, 2 * a]
        rubbing = run.vectors[X, 2 * a + 1] * run.vectors[SCALE, 2 * a + 1]
        if run.touching[a, HALTED] != 0.0 and not share_of_cone(run, a, pressing, rubbing, lasting) <= 1.0 + ALLOWED:
            run.touching[a, HALTED], run.touching[a, GOES_ON], any_leaves = 0.0, 1.0, True
    return any_leaves


@jit_separate
def skipped_time(run: Run) -> float:
    """How long forces may act on while slips end that are skipped: as long as the shortest bounce of their links that is."""
    shortest = inf
    for a in range(run.counters[TOGETHER]):
        shortest = min(shortest, bounce_time(run, a)) if run.touching[a, HALTED] == SLIP_ENDED else shortest
    return shortest


@jit_separate
def share_of_cone(run: Run, a: int, pressing: float, rubbing: float, lasting: float) -> float:
    """The friction of a link in its cone's bound, by impulses that stop it and forces that act meanwhile; inf where it is pulled."""
    if run.touching[a, HALTED] == SLIP_ENDED:
        pressing += run.touching[a, FORCE] * lasting
        rubbing += run.touching[a, DRAGS] * lasting
    rubbing = abs(rubbing)
    if pressing > 0.0 and run.touching[a, STATIC] > 0.0:
        return float(rubbing / (run.touching[a, STATIC] * pressing))
    return inf if rubbing > 0.0 else 0.0


@jit_separate
def pose_stop(run: Run) -> None:
    """Write down rates of links that act, and slips of those that grip, to be taken away by impulses."""
    for a in range(run.counters[TOGETHER]):
        row = 2 * a
        acts = run.touching[a, ACTS] == 1.0
        holds = acts and run.touching[a, RUBS] == 1.0 and run.vectors[GRIP, row + 1] > 0.0
        run.vectors[SCALE, row] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[SCALE, row + 1] = 1.0 / sqrt(run.touching[a, SLIP_OWN]) if holds else 0.0
        run.vectors[RIGHT, row] = -gap_rate(run, a) * run.vectors[SCALE, row]
        run.vectors[RIGHT, row + 1] = -slip_of(run, a) * run.vectors[SCALE, row + 1] if holds else 0.0


@jit_separate
def halt_again(run: Run) -> None:
    """Have links grip that were to slide on."""
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, HALTED] == 0.0 and run.touching[a, GOES_ON] == 1.0:
            run.touching[a, HALTED] = WEDGED


@jit_separate
def end_slips(run: Run) -> bool:
    """Have links grip that an impact set slipping, if friction ends that soon, but not where they slip on; whether any changes."""
    if run.counters[ROWS] == 1 or not was_struck(run):
        return False
    any_changes, force = False, largest_entry(run, X, 0, 2 * run.counters[TOGETHER])
    for a in range(run.counters[TOGETHER]):
        begins = run.touching[a, RUBS] == 1.0 and run.touching[a, GRIPPED] < SLIDES_ON
        if not (begins and run.touching[a, ACTS] == 1.0):
            continue
        slip, slip_acceleration = slip_of(run, a), run.touching[a, SLIP_AFTER]
        noise = 4.0 * RESTLESS * (slip_falling(run, a) + force * sqrt(run.touching[a, SLIP_OWN]))
        on = slip_acceleration if slip > 0.0 else -slip_acceleration  # by how much it speeds up
        if run.touching[a, HALTED] == SLIP_ENDED and on > noise:
            run.touching[a, HALTED], run.touching[a, GOES_ON], any_changes = 0.0, 1.0, True
            continue
        slides = run.touching[a, HALTED] == 0.0 and run.touching[a, GOES_ON] == 0.0
        slides = slides and -on > noise and abs(slip) > run.touching[a, SLIP_SLACK]
        if slides and passes_soon(run, a, abs(slip), -on):
            run.touching[a, HALTED], any_changes = SLIP_ENDED, True
    return any_changes


@jit_separate
def was_struck(run: Run) -> bool:
    """Whether impulses changed velocities at this event."""
    struck = False
    for a in range(run.counters[TOGETHER]):
        struck = struck or run.touching[a, TOTAL] != 0.0
    return struck


@jit_separate
def check_cone(run: Run, a: int, pressing: float, rubbing: float, lasting: float) -> None:
    """Note an impulse that stopped a slip and rubs by more than friction allows, or pulls."""
    needed = share_of_cone(run, a, pressing, rubbing, lasting)
    if needed <= 1.0 + ALLOWED:
        return
    run.counters[OUTSIDE] += 1
    if needed > run.spans[NEEDED]:
        k = int(run.touching[a, CANDIDATE])
        run.spans[NEEDED], run.spans[NEEDED_AT] = needed, run.trial[0].t
        run.counters[OUTSIDE_OF], run.counters[OUTSIDE_LINK] = run.candidates[k, ASSEMBLY], run.candidates[k, LINK]
