"""Which of the links that touch are closed from now on: the accelerations decide, and bounces too low are skipped.

Of links that touch and do not part, forces and accelerations solve a complementarity problem: either a link presses, or
its gap opens. A link that bounces so low that it may be skipped, or too briefly to be resolved, joins them. Slow slips:
`slip_stops`.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import shared
from xdynamics.march.assembly.broad_phase import (
    LOSS,
    ROWS,
    STRAIN,
    TERMS,
    TOGETHER,
    WORK,
)
from xdynamics.march.assembly.closed_links import (
    DRAG,
    FRICTIONLESS,
    GRIP,
    SCALE,
    SLIDES_BACK,
    SLIDES_ON,
    STICKS,
    X,
    closed_from,
    list_ends,
    look_at_closed,
)
from xdynamics.march.assembly.friction import RESTLESS
from xdynamics.march.assembly.holding import project, stop
from xdynamics.march.assembly.link_forces import solve_forces
from xdynamics.march.assembly.links import ASSEMBLY, LINK, NOISE
from xdynamics.march.assembly.low_motions import falling, is_low, resolution, slip_falling
from xdynamics.march.assembly.normal_forces import largest
from xdynamics.march.assembly.slip_stops import check_cone, end_slips, halt_slips, hold_cones, skipped_time
from xdynamics.march.assembly.touching import (
    ACTS,
    AFTER,
    BEFORE,
    BOUNCE,
    BOUNCES,
    BROKEN,
    CANDIDATE,
    DRAGS,
    EARLY,
    ENDED,
    FORCE,
    GRIPS,
    HALTED,
    LASTS,
    LIFTS,
    OWN,
    PULL,
    RATE,
    RUBS,
    SKIPS,
    SLACK,
    SLIP_AFTER,
    SLIP_EARLY,
    SLIP_OWN,
    SLIP_SLACK,
    TAKEN,
    WEDGED,
    rate_of,
    slip_of,
)
from xdynamics.march.force_evaluation import evaluate
from xdynamics.march.run import Run

ROUNDS = 4  # of examining again which links come to rest


@shared
def rest(run: Run, t: float) -> bool:
    """Find out which links that touch are closed, and put the trial's state on them; whether their forces were found."""
    note_speeds(run)
    for a in range(run.tallies[TOGETHER] if run.tallies[ROWS] == 2 else 0):
        run.touching[a, SLIP_SLACK] += slip_falling(run, a) * resolution(run, a)  # with the forces of the motion so far
    run.closed[0] = 0
    evaluate(run, t, run.z)  # without forces of links
    for a in range(run.tallies[TOGETHER]):
        still = abs(rate_of(run, a)) <= run.touching[a, SLACK] + falling(run, a) * resolution(run, a)
        run.touching[a, ACTS] = 1.0 if still and run.touching[a, LIFTS] == 0.0 else 0.0
    for _ in range(ROUNDS):
        if not find_forces(run):
            return False
        restored, skips, ends = restore_contacts(run), skip_bounces(run), end_slips(run)
        if not (restored or skips or ends):
            break
    if not hold_cones(run):
        return False
    close(run)
    take_energy(run, t)
    project(run, t)
    let_slide(run)
    return True


@shared
def note_speeds(run: Run) -> None:
    """Remember how fast links of each contact met."""
    for a in range(run.tallies[TOGETHER]):
        c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
        run.greatest[1 + c] = max(run.greatest[1 + c], -run.touching[a, RATE])


@shared
def find_forces(run: Run) -> bool:
    """Solve for forces; where there are none, with grips that have just broken held, low bounces not skipped, slips halted."""
    if solve_forces(run) or (hold_breaks(run) and solve_forces(run)):
        return True
    while let_bounce(run):
        if solve_forces(run):
            return True
    return halt_slips(run) and solve_forces(run)


@shared
def let_bounce(run: Run) -> bool:
    """Let the highest of the bounces go on that were to be skipped: with its link held the others may wedge; whether one does."""
    highest, best = 0.0, -1
    for a in range(run.tallies[TOGETHER]):
        rate = rate_of(run, a)
        if run.touching[a, SKIPS] == 1.0 and rate > run.touching[a, SLACK] and rate * rate > highest * falling(run, a):
            highest, best = rate * rate / falling(run, a), a
    if best >= 0:
        run.touching[best, ACTS], run.touching[best, SKIPS], run.touching[best, BOUNCES] = 0.0, 0.0, 1.0
        run.spans[STRAIN] = 0.0
    return best >= 0


@shared
def hold_breaks(run: Run) -> bool:
    """Have links grip whose grip has just broken, up to their bound: with the others they may not slide; whether any did."""
    any_holds = False
    for a in range(run.tallies[TOGETHER] if run.tallies[ROWS] == 2 else 0):
        if run.touching[a, ACTS] == 1.0 and run.touching[a, BROKEN] != 0.0:
            run.touching[a, BROKEN], any_holds = 0.0, True
    run.spans[STRAIN] = 0.0 if any_holds else run.spans[STRAIN]
    return any_holds


@shared
def let_slide(run: Run) -> None:
    """Let links whose slip was stopped slide, if their forces have them slide."""
    closed = 0
    for a in range(run.tallies[TOGETHER] if run.tallies[ROWS] == 2 else 0):
        if run.touching[a, ACTS] == 1.0:
            run.grips[closed] = int(run.touching[a, GRIPS])
            closed += 1


@shared
def restore_contacts(run: Run) -> bool:
    """Take back what broke or lifted where slips would go with their friction, or gaps close; whether any is.

    Where several links change at one time, what one alone would do is not what it does with the others.
    """
    any_holds, force = False, largest(run, X, 0, 2 * run.tallies[TOGETHER]) if run.tallies[ROWS] == 2 else 0.0
    for a in range(run.tallies[TOGETHER] if run.tallies[ROWS] == 2 else 0):
        size = slip_falling(run, a) + force * sqrt(run.touching[a, SLIP_OWN])
        slides = run.touching[a, RUBS] == 1.0 and run.vectors[GRIP, 2 * a + 1] == 0.0
        if slides and run.touching[a, BROKEN] * run.touching[a, SLIP_AFTER] > 4.0 * RESTLESS * size:
            run.touching[a, BROKEN], any_holds = 0.0, True
        size = falling(run, a) + force * sqrt(run.touching[a, OWN])
        if run.touching[a, LIFTS] == 1.0 and run.touching[a, AFTER] < -4.0 * RESTLESS * size:
            run.touching[a, LIFTS], run.touching[a, ACTS], any_holds = 0.0, 1.0, True
    return any_holds


@shared
def skip_bounces(run: Run) -> bool:
    """Let links settle whose next bounce is too low; whether any did."""
    any_settles = False
    for a in range(run.tallies[TOGETHER]):
        rate, fall = rate_of(run, a), -run.touching[a, AFTER]
        waits = run.touching[a, ACTS] + run.touching[a, LIFTS] + run.touching[a, BOUNCES] == 0.0
        if waits and rate > 0.0 and fall > NOISE * falling(run, a) and is_low(run, a, rate, fall):
            share = 1.0 - run.touching[a, BOUNCE]  # by which each remaining bounce is shorter than the last
            run.touching[a, LASTS] = 2.0 * rate / fall / share if share > 0.0 else inf
            run.touching[a, ACTS], run.touching[a, SKIPS], any_settles = 1.0, 1.0, True
    return any_settles


@shared
def close(run: Run) -> None:
    """Write down which links are closed from now on: those that press, and those whose gap does not open either."""
    count = 0
    for a in range(run.tallies[TOGETHER]):
        still = 4.0 * NOISE * falling(run, a)
        if run.tallies[ROWS] == 2:  # where forces are balanced by friction, what is left of them is no motion
            still += 4.0 * RESTLESS * largest(run, X, 0, 2 * run.tallies[TOGETHER]) * sqrt(run.touching[a, OWN])
        opens = run.touching[a, FORCE] == 0.0 and run.touching[a, AFTER] > still
        if run.touching[a, ACTS] == 1.0 and not opens:
            k = int(run.touching[a, CANDIDATE])
            if run.tallies[ROWS] == 2:
                run.touching[a, GRIPS] = grip_of(run, a)
                run.grips[count] = int(run.touching[a, GRIPS]) if run.touching[a, HALTED] == 0.0 else STICKS
                run.shares[2 * count], run.shares[2 * count + 1] = run.touching[a, FORCE], run.touching[a, DRAGS]
            count += 1
            run.closed[count] = run.assemblies[run.candidates[k, ASSEMBLY]].first_link + run.candidates[k, LINK]
        else:
            run.touching[a, ACTS], run.touching[a, SKIPS] = 0.0, 0.0
    run.closed[0] = count
    list_ends(run)


@shared
def grip_of(run: Run, a: int) -> int:
    """What a link that is closed from now on does along its slip."""
    if run.touching[a, RUBS] == 0.0:
        return FRICTIONLESS
    drag, after = run.vectors[DRAG, 2 * a + 1], run.touching[a, SLIP_AFTER]
    slides = run.vectors[GRIP, 2 * a + 1] == 0.0 and run.touching[a, HALTED] == 0.0
    if slides and abs(slip_of(run, a)) > run.touching[a, SLIP_SLACK]:
        return SLIDES_ON if slip_of(run, a) > 0.0 else SLIDES_BACK
    if drag != 0.0:
        return SLIDES_ON if drag < 0.0 else SLIDES_BACK
    size = slip_falling(run, a) + largest(run, X, 0, 2 * run.tallies[TOGETHER]) * sqrt(run.touching[a, SLIP_OWN])
    if abs(after) > 4.0 * RESTLESS * size:
        return SLIDES_ON if after > 0.0 else SLIDES_BACK
    return STICKS


@shared
def take_energy(run: Run, t: float) -> None:
    """Remove the rates of closed links, and note what energy bounces that are skipped had."""
    for a in range(run.tallies[TOGETHER]):
        run.touching[a, BEFORE] = rate_of(run, a)
        if run.tallies[ROWS] == 2:
            run.touching[a, PULL] = slip_of(run, a)
    look_at_closed(run, t, run.z)
    stop(run)
    row, rows, lasting = closed_from(run), int(run.tallies[ROWS]), skipped_time(run)
    for a in range(run.tallies[TOGETHER]):
        before = run.touching[a, BEFORE]
        if run.touching[a, ACTS] == 1.0:
            impulse, after = run.vectors[X, row] * run.vectors[SCALE, row], rate_of(run, a)
            taken = -impulse * (before + after) / 2.0
            run.touching[a, TAKEN] += taken if run.touching[a, SKIPS] == 1.0 else 0.0
            run.spans[LOSS] += taken
            run.spans[WORK] -= impulse * run.touching[a, EARLY]
            run.spans[TERMS] += abs(impulse) * (abs(before) + abs(after))
            if rows == 2 and run.touching[a, RUBS] == 1.0:
                pull, slip = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1], run.touching[a, PULL]
                rubbed = -pull * (slip + slip_of(run, a)) / 2.0
                run.touching[a, TAKEN] += rubbed if run.touching[a, HALTED] != 0.0 else 0.0
                run.spans[LOSS] += rubbed
                run.spans[WORK] -= pull * run.touching[a, SLIP_EARLY]
                run.spans[TERMS] += abs(pull) * (abs(slip) + abs(slip_of(run, a)))
                if run.touching[a, HALTED] == WEDGED or run.touching[a, HALTED] == ENDED:
                    check_cone(run, a, impulse, pull, lasting)
            row += rows
