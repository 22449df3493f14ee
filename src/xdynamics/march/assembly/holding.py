"""Closed links hold a motion: forces at every evaluation, and a state that is put back on them after every step.

Where closed links hold more than needs holding, their forces have many shares; one within all bounds is taken, and one
that lasts. Where a share of before still fits, with the same links at their bounds, it is gone on with: forces then
change as the motion does, and do not jump from one share to another, of which each jump would seem to lift a link or
break its grip.
"""

from __future__ import annotations

from math import inf, nan
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import UNSOUND
from xdynamics.march.assembly.broad_phase import ASTRAY, FASTEST, NOISE, READY, ROWS, STRAIN
from xdynamics.march.assembly.closed_links import (
    BREAKS,
    DRAG,
    FIRST_X,
    FRICTIONLESS,
    GAPS,
    GIVEN,
    LEAST,
    LIFTS,
    MOST,
    OWN_SCALE,
    RATES,
    RESIDUE,
    RIGHT,
    ROUGHLY,
    SCALE,
    SINCE,
    SLIDES_BACK,
    SLIDES_ON,
    STEEP,
    STICKS,
    X,
    add_answers,
    closed_from,
    closed_link_row,
    grip_at,
    list_ends,
    look_at_closed,
    prepare_patterns,
    release_of,
    rows_of_closed,
    size_of_forces,
)
from xdynamics.march.assembly.friction import (
    RESTLESS,
    bound_row,
    pose_press_bounds,
    solve_closed,
    solve_from,
    try_contact_sets,
)
from xdynamics.march.assembly.normal_forces import ALLOWED, largest_entry, solve_equations
from xdynamics.march.calls import floats_at, run_at
from xdynamics.march.force_evaluation import evaluate_forces, finite_state, nan_maximum
from xdynamics.march.phases import ASSEMBLIES, phase
from xdynamics.march.run import Run

HELD = 1e-10  # of the largest term: an acceleration that is no motion


@jit_separate
def share_forces(run: Run) -> None:
    """Where closed links hold more than needs holding, share forces so that none pulls nor drags beyond its bound.

    The motion stays as it is, which these forces have in common with those of `solve_closed`.
    """
    first, rows, all_in_bounds = closed_from(run), rows_of_closed(run), True
    size = size_of_forces(run)
    for a in range(run.closed[0]):
        release_kind = release_of(run, a, size)
        all_in_bounds = all_in_bounds and release_kind != LIFTS and release_kind != BREAKS
    if all_in_bounds:
        note_shares(run, first, rows)
        return
    for row in range(first, first + rows):
        run.vectors[FIRST_X, row], run.vectors[RIGHT, row] = run.vectors[X, row], run.vectors[GIVEN, row]
    if shares_hold(run, first, rows) or shares_are_found(run, first, rows):
        for a in range(run.closed[0]):
            row = closed_link_row(run, a)
            run.loads[a] = run.vectors[X, row] * run.vectors[SCALE, row]
            run.pulls[a] = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1]
        note_shares(run, first, rows)
        return
    for row in range(first, first + rows):
        run.vectors[X, row] = run.vectors[FIRST_X, row]


@jit_separate
def note_shares(run: Run, first: int, rows: int) -> None:
    """Remember the forces of closed links."""
    for row in range(first, first + rows):
        run.shares[row - first] = run.vectors[X, row] * run.vectors[SCALE, row]


@jit_separate
def shares_hold(run: Run, first: int, rows: int) -> bool:
    """Try the links that pressed, and were at their bounds, when forces were shared last: of many shares, one that lasts."""
    pose_press_bounds(run, first, rows)
    for row in range(first, first + rows):
        scale, force = run.vectors[SCALE, row], run.shares[row - first]
        run.vectors[X, row] = force / scale if scale > 0.0 else 0.0
    for row in range(first + 1, first + rows, 2):
        bound_row(run, row)
        low, x, high = run.vectors[LEAST, row], run.vectors[X, row], run.vectors[MOST, row]
        near = RESTLESS * (high - low)
        # exactly at a bound, or `choose_sets` would let it hold
        run.vectors[X, row] = low if x <= low + near else (high if x >= high - near else x)
    return try_contact_sets(run, first, rows) and all_held(run, first, rows)


@jit_separate
def shares_are_found(run: Run, first: int, rows: int) -> bool:
    """Share forces anew, first from the last shares, as far as these apply, then from the present ones."""
    if solve_from(run, first, run.closed[0]) <= ALLOWED and all_held(run, first, rows):
        return True
    for row in range(first, first + rows):
        run.vectors[X, row], run.vectors[RIGHT, row] = run.vectors[FIRST_X, row], run.vectors[GIVEN, row]
    return solve_from(run, first, run.closed[0]) <= ALLOWED and all_held(run, first, rows)


@jit_separate
def all_held(run: Run, first: int, rows: int) -> bool:
    """Whether no closed link accelerates along its constrained directions."""
    is_balanced, size = True, max(largest_entry(run, X, first, rows), largest_entry(run, RIGHT, first, rows))
    for row in range(first, first + rows):
        if run.vectors[DRAG, row] == 0.0:
            is_balanced = is_balanced and abs(run.vectors[RESIDUE, row]) <= HELD * size
    return is_balanced


State = NDArray[Any]
MOST_CORRECTIONS = 10  # Newton steps to gaps of zero


def add_closed_link_forces(address: Any, t: float, z: Any) -> None:
    """Add the effect of closed links' forces to accelerations; an entry of the engine, called by laws.

    Parameters
    ----------
    address : int
        Of a `Run`.
    t : float
    z : int
        Address of the table entry of a state, whose accelerations are those without these forces.
    """
    run = run_at(address)
    if run.closed.shape[0] > 0 and run.closed[0] > 0:
        press_closed(run, t, floats_at(z))


@jit_separate
def press_closed(run: Run, t: float, state: State) -> None:
    """Solve for forces of closed links, so that no gap accelerates, and add their effect to accelerations."""
    if run.counters[READY] == 0:
        prepare_patterns(run)
    look_at_closed(run, t, state)
    left = solve_closed(run)
    run.spans[STRAIN] = nan_maximum(run.spans[STRAIN], left)
    for a in range(run.closed[0]):
        row = closed_link_row(run, a)
        run.loads[a] = run.vectors[X, row] * run.vectors[SCALE, row]
        run.remains[a] = -run.vectors[RESIDUE, row] / run.vectors[SCALE, row]
        run.pulls[a] = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1] if grip_at(run, a) != FRICTIONLESS else 0.0
    # before forces are shared, which changes who holds how much but not the motion
    add_answers(run, state, run.plan[0].used)
    if run.counters[ROWS] == 2:
        share_forces(run)


@jit_separate
def put_on_closed_links(run: Run, t: float) -> None:
    """Project the trial's state onto its closed links, if there are any, and evaluate the forces there."""
    run.spans[STRAIN], run.spans[ASTRAY] = 0.0, 0.0
    if run.closed[0] == 0 or not finite_state(run):
        return
    project_on_links(run, t)
    evaluate_forces(run, t, run.z)
    run.at[UNSOUND] = 0.0 if finite_state(run) else nan


@jit_separate
def project_on_links(run: Run, t: float) -> None:
    """Close the gaps of closed links in the trial's state, as far as rounding goes, then remove their rates."""
    first, count, worst_before = closed_from(run), rows_of_closed(run), inf
    for _ in range(MOST_CORRECTIONS):
        look_at_closed(run, t, run.z)
        worst = 0.0
        for a in range(run.closed[0]):
            row = closed_link_row(run, a)
            worst = max(worst, abs(run.vectors[GAPS, row]))
            run.vectors[RIGHT, row] = -run.vectors[GAPS, row] * run.vectors[SCALE, row]
            if run.counters[ROWS] == 2:
                # slips have no positions to be put back to
                run.vectors[RIGHT, row + 1], run.vectors[SCALE, row + 1] = 0.0, 0.0
        if worst == 0.0 or not worst < worst_before / 2.0:
            break
        worst_before = worst
        solve_equations(run, first, count)
        add_answers(run, run.z, 0)
    for a in range(run.closed[0]):
        row = closed_link_row(run, a)
        far = 8.0 * run.vectors[STEEP, row] * run.spans[FASTEST] * event_time_width(run)
        # at rest in the origin every term of a gap is zero, but not what rounding leaves of accelerations
        far += NOISE * abs(run.loads[a]) / run.vectors[SCALE, row] ** 2 * run.trial[0].h * run.trial[0].h
        astray = abs(run.vectors[GAPS, row]) - (16.0 * NOISE * run.vectors[ROUGHLY, row] + far)
        run.spans[ASTRAY] = nan_maximum(run.spans[ASTRAY], astray)
    remove_closed_rates(run)


@phase(ASSEMBLIES)
def release_moved(run: Run, t: float) -> None:
    """Release closed links whose gaps, or rates, are not zero in a state that an event has set.

    Those that stuck and now slip slide.
    """
    kept_count, run.release_functions[SINCE, 0] = 0, -inf  # forces at the start of a step are other ones
    for row in range(run.shares.shape[0]):
        run.shares[row] = 0.0
    look_at_closed(run, t, run.z)
    for a in range(run.closed[0]):
        row, grip = closed_link_row(run, a), grip_at(run, a)
        speed = NOISE * run.vectors[STEEP, row] * run.greatest[0]
        far = 16.0 * NOISE * run.vectors[ROUGHLY, row] + 8.0 * speed / NOISE * event_time_width(run)
        if grip != FRICTIONLESS:
            slip = run.vectors[RATES, row + 1]
            slips = abs(slip) > NOISE * run.vectors[STEEP, row + 1] * run.greatest[0]
            grip = (SLIDES_ON if slip > 0.0 else SLIDES_BACK) if slips else grip
        if abs(run.vectors[RATES, row]) <= speed and abs(run.vectors[GAPS, row]) <= far:
            if run.counters[ROWS] == 2:
                run.grips[kept_count] = grip
            kept_count += 1
            run.closed[kept_count] = run.closed[1 + a]
    run.closed[0] = kept_count
    list_ends(run)


@jit_separate
def event_time_width(run: Run) -> float:
    """The time within which events of links are located."""
    widest = 2.0 * EPS * abs(run.now[0].t + run.trial[0].h)
    for c in range(run.assemblies.shape[0]):
        widest = max(widest, run.assemblies[c].tolerance)
    return widest


@jit_separate
def remove_closed_rates(run: Run) -> None:
    """Remove the rates of closed links, and slips of those that stick, all looked at, from the trial's state."""
    first, count = closed_from(run), rows_of_closed(run)
    for a in range(run.closed[0]):
        row = closed_link_row(run, a)
        run.vectors[RIGHT, row] = -run.vectors[RATES, row] * run.vectors[SCALE, row]
        if run.counters[ROWS] == 2:
            run.vectors[SCALE, row + 1] = run.vectors[OWN_SCALE, row + 1] if run.grips[a] == STICKS else 0.0
            run.vectors[RIGHT, row + 1] = -run.vectors[RATES, row + 1] * run.vectors[SCALE, row + 1]
    solve_equations(run, first, count)
    add_answers(run, run.z, run.plan[0].coordinates)
