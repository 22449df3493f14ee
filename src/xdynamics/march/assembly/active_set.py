"""Which links that touch are closed from now on: the accelerations decide, and bounces too low are skipped.

Of links that touch and do not part, forces and accelerations solve a complementarity problem: either a link presses, or
its gap opens. A link that bounces so low that it may be skipped, or too briefly to be resolved, joins them. For slow
slips see `link_forces.halt_slips`.
"""

from __future__ import annotations

from math import inf, sqrt

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.broad_phase import ASSEMBLY, LINK, LOSS, NOISE, ROWS, STRAIN, TERMS, TOGETHER, WORK
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
from xdynamics.march.assembly.holding import project_on_links, remove_closed_rates
from xdynamics.march.assembly.impact import (
    ACTS,
    AFTER,
    BEFORE,
    BOUNCE,
    BOUNCES,
    BROKEN,
    CANDIDATE,
    DRAGS,
    EARLY,
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
    SLIP_ENDED,
    SLIP_OWN,
    SLIP_SLACK,
    TAKEN,
    WEDGED,
    gap_rate,
    slip_of,
)
from xdynamics.march.assembly.link_forces import (
    check_cone,
    end_slips,
    falling,
    halt_slips,
    hold_cones,
    is_low,
    link_resolution,
    skipped_time,
    slip_falling,
    solve_forces,
)
from xdynamics.march.assembly.normal_forces import largest_entry
from xdynamics.march.force_evaluation import evaluate_forces
from xdynamics.march.run import Run

ROUNDS = 4  # of examining again which links come to rest


@jit_separate
def close_resting_links(run: Run, t: float) -> bool:
    """Determine the closed links among those that touch, and project the trial's state onto them; whether it could."""
    note_speeds(run)
    for a in range(run.counters[TOGETHER] if run.counters[ROWS] == 2 else 0):
        run.touching[a, SLIP_SLACK] += slip_falling(run, a) * link_resolution(
            run, a
        )  # with the forces of the motion so far
    run.closed[0] = 0
    evaluate_forces(run, t, run.z)  # without forces of links
    for a in range(run.counters[TOGETHER]):
        still = abs(gap_rate(run, a)) <= run.touching[a, SLACK] + falling(run, a) * link_resolution(run, a)
        run.touching[a, ACTS] = 1.0 if still and run.touching[a, LIFTS] == 0.0 else 0.0
    for _ in range(ROUNDS):
        if not find_forces(run):
            return False
        # all three act: an `or` of the calls would leave out the later ones
        restored, skips, ends = restore_contacts(run), skip_bounces(run), end_slips(run)
        if not (restored or skips or ends):
            break
    if not hold_cones(run):
        return False
    record_closed_links(run)
    take_energy(run, t)
    project_on_links(run, t)
    let_slide(run)
    return True


@jit_separate
def note_speeds(run: Run) -> None:
    """Remember how fast links of each contact met."""
    for a in range(run.counters[TOGETHER]):
        c = run.candidates[int(run.touching[a, CANDIDATE]), ASSEMBLY]
        run.greatest[1 + c] = max(run.greatest[1 + c], -run.touching[a, RATE])


@jit_separate
def find_forces(run: Run) -> bool:
    """Solve for forces; without a solution, restore just broken grips, let low bounces go on, then halt slips."""
    if solve_forces(run) or (hold_breaks(run) and solve_forces(run)):
        return True
    while let_bounce(run):
        if solve_forces(run):
            return True
    return halt_slips(run) and solve_forces(run)


@jit_separate
def let_bounce(run: Run) -> bool:
    """Let the highest skipped bounce go on, as its closed link may make others wedge; whether there is one."""
    highest, best = 0.0, -1
    for a in range(run.counters[TOGETHER]):
        rate = gap_rate(run, a)
        if run.touching[a, SKIPS] == 1.0 and rate > run.touching[a, SLACK] and rate * rate > highest * falling(run, a):
            highest, best = rate * rate / falling(run, a), a
    if best >= 0:
        run.touching[best, ACTS], run.touching[best, SKIPS], run.touching[best, BOUNCES] = 0.0, 0.0, 1.0
        run.spans[STRAIN] = 0.0
    return best >= 0


@jit_separate
def hold_breaks(run: Run) -> bool:
    """Restore grips that have just broken, up to their bound: with the others they may not slide; whether any is."""
    any_holds = False
    for a in range(run.counters[TOGETHER] if run.counters[ROWS] == 2 else 0):
        if run.touching[a, ACTS] == 1.0 and run.touching[a, BROKEN] != 0.0:
            run.touching[a, BROKEN], any_holds = 0.0, True
    run.spans[STRAIN] = 0.0 if any_holds else run.spans[STRAIN]
    return any_holds


@jit_separate
def let_slide(run: Run) -> None:
    """Set the grips of closed links by their forces, so that a halted slip goes on where these accelerate it."""
    closed = 0
    for a in range(run.counters[TOGETHER] if run.counters[ROWS] == 2 else 0):
        if run.touching[a, ACTS] == 1.0:
            run.grips[closed] = int(run.touching[a, GRIPS])
            closed += 1


@jit_separate
def restore_contacts(run: Run) -> bool:
    """Restore broken grips whose slip would follow the friction, and lifted links that close; whether any is.

    Where several links change at one time, what one alone would do is not what it does with the others.
    """
    any_holds, force = False, largest_entry(run, X, 0, 2 * run.counters[TOGETHER]) if run.counters[ROWS] == 2 else 0.0
    for a in range(run.counters[TOGETHER] if run.counters[ROWS] == 2 else 0):
        size = slip_falling(run, a) + force * sqrt(run.touching[a, SLIP_OWN])
        slides = run.touching[a, RUBS] == 1.0 and run.vectors[GRIP, 2 * a + 1] == 0.0
        if slides and run.touching[a, BROKEN] * run.touching[a, SLIP_AFTER] > 4.0 * RESTLESS * size:
            run.touching[a, BROKEN], any_holds = 0.0, True
        size = falling(run, a) + force * sqrt(run.touching[a, OWN])
        if run.touching[a, LIFTS] == 1.0 and run.touching[a, AFTER] < -4.0 * RESTLESS * size:
            run.touching[a, LIFTS], run.touching[a, ACTS], any_holds = 0.0, 1.0, True
    return any_holds


@jit_separate
def skip_bounces(run: Run) -> bool:
    """Close links whose next bounce is too low; whether there is any."""
    any_settles = False
    for a in range(run.counters[TOGETHER]):
        rate, fall = gap_rate(run, a), -run.touching[a, AFTER]
        waits = run.touching[a, ACTS] + run.touching[a, LIFTS] + run.touching[a, BOUNCES] == 0.0
        if waits and rate > 0.0 and fall > NOISE * falling(run, a) and is_low(run, a, rate, fall):
            share = 1.0 - run.touching[a, BOUNCE]  # by which each remaining bounce is shorter than the last
            run.touching[a, LASTS] = 2.0 * rate / fall / share if share > 0.0 else inf
            run.touching[a, ACTS], run.touching[a, SKIPS], any_settles = 1.0, 1.0, True
    return any_settles


@jit_separate
def record_closed_links(run: Run) -> None:
    """Write down which links are closed from now on: those that press, and those whose gap does not open either."""
    count = 0
    for a in range(run.counters[TOGETHER]):
        still = 4.0 * NOISE * falling(run, a)
        if run.counters[ROWS] == 2:  # where forces are balanced by friction, what is left of them is no motion
            still += 4.0 * RESTLESS * largest_entry(run, X, 0, 2 * run.counters[TOGETHER]) * sqrt(run.touching[a, OWN])
        opens = run.touching[a, FORCE] == 0.0 and run.touching[a, AFTER] > still
        if run.touching[a, ACTS] == 1.0 and not opens:
            k = int(run.touching[a, CANDIDATE])
            if run.counters[ROWS] == 2:
                run.touching[a, GRIPS] = grip_of(run, a)
                # a halted slip sticks while rates are removed; `let_slide` then gives it what its forces say
                run.grips[count] = int(run.touching[a, GRIPS]) if run.touching[a, HALTED] == 0.0 else STICKS
                run.shares[2 * count], run.shares[2 * count + 1] = run.touching[a, FORCE], run.touching[a, DRAGS]
            count += 1
            run.closed[count] = run.assemblies[run.candidates[k, ASSEMBLY]].first_link + run.candidates[k, LINK]
        else:
            run.touching[a, ACTS], run.touching[a, SKIPS] = 0.0, 0.0
    run.closed[0] = count
    list_ends(run)


@jit_separate
def grip_of(run: Run, a: int) -> int:
    """The grip of a link that is closed from now on."""
    if run.touching[a, RUBS] == 0.0:
        return FRICTIONLESS
    drag, slip_acceleration = run.vectors[DRAG, 2 * a + 1], run.touching[a, SLIP_AFTER]
    slides = run.vectors[GRIP, 2 * a + 1] == 0.0 and run.touching[a, HALTED] == 0.0
    if slides and abs(slip_of(run, a)) > run.touching[a, SLIP_SLACK]:
        return SLIDES_ON if slip_of(run, a) > 0.0 else SLIDES_BACK
    if drag != 0.0:
        return SLIDES_ON if drag < 0.0 else SLIDES_BACK
    size = slip_falling(run, a) + largest_entry(run, X, 0, 2 * run.counters[TOGETHER]) * sqrt(run.touching[a, SLIP_OWN])
    if abs(slip_acceleration) > 4.0 * RESTLESS * size:
        return SLIDES_ON if slip_acceleration > 0.0 else SLIDES_BACK
    return STICKS


@jit_separate
def take_energy(run: Run, t: float) -> None:
    """Remove the rates of closed links, and note the energy of skipped bounces."""
    for a in range(run.counters[TOGETHER]):
        run.touching[a, BEFORE] = gap_rate(run, a)
        if run.counters[ROWS] == 2:
            run.touching[a, PULL] = slip_of(run, a)
    look_at_closed(run, t, run.z)
    remove_closed_rates(run)
    row, rows, lasting = closed_from(run), int(run.counters[ROWS]), skipped_time(run)
    for a in range(run.counters[TOGETHER]):
        rate_before = run.touching[a, BEFORE]
        if run.touching[a, ACTS] == 1.0:
            impulse, rate_after = run.vectors[X, row] * run.vectors[SCALE, row], gap_rate(run, a)
            energy_taken = -impulse * (rate_before + rate_after) / 2.0
            run.touching[a, TAKEN] += energy_taken if run.touching[a, SKIPS] == 1.0 else 0.0
            run.spans[LOSS] += energy_taken
            run.spans[WORK] -= impulse * run.touching[a, EARLY]
            run.spans[TERMS] += abs(impulse) * (abs(rate_before) + abs(rate_after))
            if rows == 2 and run.touching[a, RUBS] == 1.0:
                pull, slip = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1], run.touching[a, PULL]
                rubbed = -pull * (slip + slip_of(run, a)) / 2.0
                run.touching[a, TAKEN] += rubbed if run.touching[a, HALTED] != 0.0 else 0.0
                run.spans[LOSS] += rubbed
                run.spans[WORK] -= pull * run.touching[a, SLIP_EARLY]
                run.spans[TERMS] += abs(pull) * (abs(slip) + abs(slip_of(run, a)))
                if run.touching[a, HALTED] == WEDGED or run.touching[a, HALTED] == SLIP_ENDED:
                    check_cone(run, a, impulse, pull, lasting)
            row += rows
