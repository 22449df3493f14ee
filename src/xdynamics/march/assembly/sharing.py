"""Forces of closed links that hold more than needs holding: of many shares, one within all bounds, and one that lasts.

Where a share of before still fits, with the same links at their bounds, it is gone on with: forces then change as the
motion does, and do not jump from one share to another, of which each jump would seem to lift a link or break its grip.
"""

from __future__ import annotations

from xdynamics.kernels.compiling import shared
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
    row_of,
    rows_of_closed,
)
from xdynamics.march.assembly.friction import (
    RESTLESS,
    bound_row,
    pose_bounds,
    settle,
    solve_from,
)
from xdynamics.march.assembly.margins import BREAKS, LIFTS, release_of, size_of_forces
from xdynamics.march.assembly.normal_forces import ALLOWED, largest
from xdynamics.march.run import Run

HELD = 1e-10  # of the largest term: an acceleration that is no motion


@shared
def share_forces(run: Run) -> None:
    """Where closed links hold more than needs holding, share forces so that none pulls nor drags beyond its bound.

    The motion stays as it is, which these forces have in common with those of `solve_closed`.
    """
    first, rows, within = closed_from(run), rows_of_closed(run), True
    size = size_of_forces(run)
    for a in range(run.closed[0]):
        what = release_of(run, a, size)
        within = within and what != LIFTS and what != BREAKS
    if within:
        note_shares(run, first, rows)
        return
    for row in range(first, first + rows):
        run.vectors[FIRST_X, row], run.vectors[RIGHT, row] = run.vectors[X, row], run.vectors[GIVEN, row]
    if shares_hold(run, first, rows) or shares_are_found(run, first, rows):
        for a in range(run.closed[0]):
            row = row_of(run, a)
            run.loads[a] = run.vectors[X, row] * run.vectors[SCALE, row]
            run.pulls[a] = run.vectors[X, row + 1] * run.vectors[SCALE, row + 1]
        note_shares(run, first, rows)
        return
    for row in range(first, first + rows):
        run.vectors[X, row] = run.vectors[FIRST_X, row]


@shared
def note_shares(run: Run, first: int, rows: int) -> None:
    """Remember the forces of closed links."""
    for row in range(first, first + rows):
        run.shares[row - first] = run.vectors[X, row] * run.vectors[SCALE, row]


@shared
def shares_hold(run: Run, first: int, rows: int) -> bool:
    """Try the links that pressed, and were at their bounds, when forces were shared last: of many shares, one that lasts."""
    pose_bounds(run, first, rows)
    for row in range(first, first + rows):
        scale, force = run.vectors[SCALE, row], run.shares[row - first]
        run.vectors[X, row] = force / scale if scale > 0.0 else 0.0
    for row in range(first + 1, first + rows, 2):
        bound_row(run, row)
        low, x, high = run.vectors[LEAST, row], run.vectors[X, row], run.vectors[MOST, row]
        near = RESTLESS * (high - low)
        run.vectors[X, row] = low if x <= low + near else (high if x >= high - near else x)
    return settle(run, first, rows) and all_held(run, first, rows)


@shared
def shares_are_found(run: Run, first: int, rows: int) -> bool:
    """Share forces anew, first from what was shared last, as far as it goes, then from what is there."""
    if solve_from(run, first, run.closed[0]) <= ALLOWED and all_held(run, first, rows):
        return True
    for row in range(first, first + rows):
        run.vectors[X, row], run.vectors[RIGHT, row] = run.vectors[FIRST_X, row], run.vectors[GIVEN, row]
    return solve_from(run, first, run.closed[0]) <= ALLOWED and all_held(run, first, rows)


@shared
def all_held(run: Run, first: int, rows: int) -> bool:
    """Whether no closed link accelerates along what it holds."""
    held, size = True, max(largest(run, X, first, rows), largest(run, RIGHT, first, rows))
    for row in range(first, first + rows):
        if run.vectors[DRAG, row] == 0.0:
            held = held and abs(run.vectors[RESIDUE, row]) <= HELD * size
    return held
