"""Forces of links that touch, at accelerations without them: which press, which grip, and which slide.

Motions of links as low as bounces that may be skipped are judged by sizes that are stated here. Slow slips are stopped
at once, as bounces that are too low are skipped. Two kinds are:

A slip without forces, where links wedge and the more they press the more is needed (Painlevé's paradox; Génot and
Brogliato, Eur. J. Mech. A 18, 1999, 653): an impulse stops it, as if at an impact without approach.

A slip that an impact began, if friction ends it before it has gone as far, or lasted as long, as a bounce that may be
skipped. What would go on is not stopped, however slow: it speeds up, or its brake is too weak.

Impulses that stop slips have to lie in the cones of friction; those of the second kind together with what forces, once
all is held, give within the time of such a bounce. Then one time step of that length by Moreau and Jean ends there, too
(Jean, Comput. Methods Appl. Mech. Eng. 177, 1999, 235; Acary and Brogliato, Numerical Methods for Nonsmooth Dynamical
Systems, 2008, chapter 10). Links whose impulses would leave their cones slide on, as long as there are forces then.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import (
    ASSEMBLY,
    LINK,
    NEEDED,
    NEEDED_AT,
    OUTSIDE,
    OUTSIDE_LINK,
    OUTSIDE_OF,
    ROWS,
    STRAIN,
    STRAINED,
    TOGETHER,
    blame,
)
from xdynamics.march.assembly.closed_links import (
    DRAG,
    GRIP,
    RETURNED,
    RIGHT,
    SCALE,
    SLIDES_ON,
    X,
    clear_responses,
    respond,
)
from xdynamics.march.assembly.friction import RESTLESS, solve_links
from xdynamics.march.assembly.impact import (
    ACTS,
    AFTER,
    BIAS,
    BOUNCE,
    BROKEN,
    CANDIDATE,
    DRAGS,
    FORCE,
    GOES_ON,
    GRIPPED,
    HALTED,
    KINETIC,
    OWN,
    RUBS,
    SLACK,
    SLIP_AFTER,
    SLIP_BIAS,
    SLIP_ENDED,
    SLIP_OWN,
    SLIP_SLACK,
    STATIC,
    TOTAL,
    WEDGED,
    acceleration_along,
    gap_rate,
    pose_slip,
    slip_of,
)
from xdynamics.march.assembly.narrow_phase import resolution_of
from xdynamics.march.assembly.normal_forces import ALLOWED, largest_entry, solve_equations
from xdynamics.march.run import Run

LOW = 1e-9  # of the height of the highest bounce: those that may be skipped, unless the model says how low they are


@jit_separate
def link_resolution(run: Run, a: int) -> float:
    """The time resolution of a link's events."""
    return resolution_of(run, int(run.touching[a, CANDIDATE]), 0.0)


@jit_separate
def falling(run: Run, a: int) -> float:
    """The size of the terms of a link's acceleration without forces of links."""
    return size_along(run, int(run.counters[ROWS]) * a, run.touching[a, BIAS])


@jit_separate
def slip_falling(run: Run, a: int) -> float:
    """The size of the terms of the acceleration of a link's slip."""
    return size_along(run, 2 * a + 1, run.touching[a, SLIP_BIAS])


@jit_separate
def size_along(run: Run, row: int, bias: float) -> float:
    """The size of the terms of an acceleration along a row."""
    accelerations, size = run.plan[0].used, abs(bias)
    for i in range(run.normals.shape[1]):
        size += abs(run.normals[row, i] * run.z[accelerations + run.coordinate_indices[row, i]])
    return size


@jit_separate
def is_low(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether the next bounce of a link is as good as none."""
    if rate <= max(run.touching[a, SLACK], 2.0 * fall * link_resolution(run, a)):
        return True
    if run.touching[a, BOUNCE] >= 1.0:  # bounces never end
        return False
    return is_short(run, a, rate, fall)


@jit_separate
def is_short(run: Run, a: int, rate: float, fall: float) -> bool:
    """Whether a motion that begins with a rate is as low as a bounce of a link that may be skipped."""
    c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
    height = run.assemblies[c].rest_height
    # heights of bounces are as the squares of their speeds
    return rate * rate <= (2.0 * fall * height if height >= 0.0 else LOW * run.greatest[1 + c] * run.greatest[1 + c])


@jit_separate
def bounce_time(run: Run, a: int) -> float:
    """How long a bounce of a link lasts that may just be skipped."""
    c, fall = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY], falling(run, a)
    height = run.assemblies[c].rest_height
    speed = sqrt(2.0 * fall * height) if height >= 0.0 else sqrt(LOW) * run.greatest[1 + c]
    return 2.0 * speed / fall if fall > 0.0 else 0.0


@jit_separate
def passes_soon(run: Run, a: int, slip: float, brake: float) -> bool:
    """Whether a slip that is braked goes no farther, and lasts no longer, than a bounce of its link that may be skipped."""
    fall = falling(run, a)
    # with this speed `is_short` compares how far it slides, slip**2/(2 brake), with the height of a bounce
    return slip <= brake * bounce_time(run, a) and is_short(run, a, slip * sqrt(fall / brake), fall)


@jit_separate
def solve_forces(run: Run) -> bool:
    """Find the forces of links that do not part, and the acceleration of every gap with them."""
    count, rows = run.counters[TOGETHER], int(run.counters[ROWS])
    for a in range(count):
        acts, row = run.touching[a, ACTS] == 1.0, rows * a
        run.vectors[SCALE, row] = 1.0 / sqrt(run.touching[a, OWN]) if acts else 0.0
        run.vectors[RIGHT, row] = -acceleration_along(run, row, run.touching[a, BIAS]) * run.vectors[SCALE, row]
        run.vectors[RETURNED, row] = 0.0
        if rows == 2:
            pose_grip(run, a, acts)
    left = solve_links(run, 0, count)
    if not left <= ALLOWED:
        k = int(run.touching[0, CANDIDATE])
        blame(run, STRAINED, run.candidates[k, ASSEMBLY], run.candidates[k, LINK])
        run.spans[STRAIN] = left
        return False
    for a in range(count):
        run.touching[a, FORCE] = run.vectors[X, rows * a] * run.vectors[SCALE, rows * a]
        if rows == 2:
            run.touching[a, DRAGS] = run.vectors[X, rows * a + 1] * run.vectors[SCALE, rows * a + 1]
    note_accelerations(run)
    return True


@jit_separate
def pose_grip(run: Run, a: int, acts: bool) -> None:
    """Write down whether a link grips, and within which bounds, or slides already, or since its grip has just broken."""
    row = 2 * a + 1
    pose_slip(run, a, acts, acceleration_along(run, row, run.touching[a, SLIP_BIAS]))
    if run.touching[a, RUBS] == 1.0:
        slip, fast = slip_of(run, a), run.touching[a, SLIP_SLACK] + slip_falling(run, a) * link_resolution(run, a)
        if abs(slip) > fast and run.touching[a, HALTED] == 0.0:
            run.vectors[DRAG, row] = -run.touching[a, KINETIC] if slip > 0.0 else run.touching[a, KINETIC]
        elif run.touching[a, BROKEN] != 0.0:
            run.vectors[DRAG, row] = run.touching[a, BROKEN] * run.touching[a, KINETIC]
        else:
            run.vectors[GRIP, row] = run.touching[a, STATIC]


@jit_separate
def note_accelerations(run: Run) -> None:
    """Store the acceleration of every touching gap, with the last forces."""
    count, rows = run.counters[TOGETHER], int(run.counters[ROWS])
    clear_responses(run, 0, rows * count)
    for a in range(count):
        respond(run, rows * a, run.touching[a, FORCE])
        if rows == 2:
            respond(run, 2 * a + 1, run.touching[a, DRAGS])
    for a in range(count):
        run.touching[a, AFTER] = pressed_along(run, rows * a, run.touching[a, BIAS])
        if rows == 2:
            run.touching[a, SLIP_AFTER] = pressed_along(run, 2 * a + 1, run.touching[a, SLIP_BIAS])


@jit_separate
def pressed_along(run: Run, row: int, bias: float) -> float:
    """The acceleration along a row, forces of links included."""
    total = acceleration_along(run, row, bias)
    for i in range(run.coordinate_indices.shape[1]):
        total += run.normals[row, i] * run.swing[run.coordinate_indices[row, i]]
    return total


@jit_separate
def halt_slips(run: Run) -> bool:
    """Stop slips as slow as skipped bounces, where no forces exist otherwise; whether forces exist then.

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
    """Let links slide on whose stop needs an impulse outside their friction cone, if forces exist then."""
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
    """Solve for forces after an earlier solution failed."""
    run.spans[STRAIN] = 0.0
    return bool(solve_forces(run))


@jit_separate
def free_outside(run: Run) -> bool:
    """Release halted links whose impulses would leave their friction cones; whether there is any."""
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
    """Halt the links that were to slide on."""
    for a in range(run.counters[TOGETHER]):
        if run.touching[a, HALTED] == 0.0 and run.touching[a, GOES_ON] == 1.0:
            run.touching[a, HALTED] = WEDGED


@jit_separate
def end_slips(run: Run) -> bool:
    """Stop slips of an impact that friction ends soon, unless they slip on; whether any changes."""
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
    """Record an impulse that stopped a slip with more friction than allowed, or by pulling."""
    needed = share_of_cone(run, a, pressing, rubbing, lasting)
    if needed <= 1.0 + ALLOWED:
        return
    run.counters[OUTSIDE] += 1
    if needed > run.spans[NEEDED]:
        k = int(run.touching[a, CANDIDATE])
        run.spans[NEEDED], run.spans[NEEDED_AT] = needed, run.trial[0].t
        run.counters[OUTSIDE_OF], run.counters[OUTSIDE_LINK] = run.candidates[k, ASSEMBLY], run.candidates[k, LINK]
