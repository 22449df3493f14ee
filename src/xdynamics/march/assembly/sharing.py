"""Forces of closed links that hold more than needs holding: of many shares, one within all bounds, and one that lasts.

Where a share of before still fits, with the same links at their bounds, it is gone on with: forces then change as the
motion does, and do not jump from one share to another, of which each jump would seem to lift a link or break its grip.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import (
    DRAG,
    FIRST_X,
    GIVEN,
    LEAST,
    MOST,
    RESIDUE,
    RIGHT,
    SCALE,
    X,
    closed_from,
    closed_link_row,
    rows_of_closed,
)
from xdynamics.march.assembly.friction import RESTLESS, bound_row, pose_press_bounds, solve_from, try_contact_sets
from xdynamics.march.assembly.margins import BREAKS, LIFTS, release_of, size_of_forces
from xdynamics.march.assembly.normal_forces import ALLOWED, largest_entry
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
        run.vectors[X, row] = low if x <= low + near else (high if x >= high - near else x)
    return try_contact_sets(run, first, rows) and all_held(run, first, rows)


@jit_separate
def shares_are_found(run: Run, first: int, rows: int) -> bool:
    """Share forces anew, first from what was shared last, as far as it goes, then from what is there."""
    if solve_from(run, first, run.closed[0]) <= ALLOWED and all_held(run, first, rows):
        return True
    for row in range(first, first + rows):
        run.vectors[X, row], run.vectors[RIGHT, row] = run.vectors[FIRST_X, row], run.vectors[GIVEN, row]
    return solve_from(run, first, run.closed[0]) <= ALLOWED and all_held(run, first, rows)


@jit_separate
def all_held(run: Run, first: int, rows: int) -> bool:
    """Whether no closed link accelerates along what it holds."""
    is_balanced, size = True, max(largest_entry(run, X, first, rows), largest_entry(run, RIGHT, first, rows))
    for row in range(first, first + rows):
        if run.vectors[DRAG, row] == 0.0:
            is_balanced = is_balanced and abs(run.vectors[RESIDUE, row]) <= HELD * size
    return is_balanced
