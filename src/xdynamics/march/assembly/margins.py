"""What of a closed link falls to zero where it lifts, its grip breaks or its slip stops, and what rounding may leave of it.

The search for releases, that for their times and the sharing of forces judge by this alone.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import jit_separate
from xdynamics.march.assembly.closed_links import (
    FRICTIONLESS,
    GRIP,
    OWN_SCALE,
    RATES,
    RIGHT,
    SCALE,
    SLIDES_ON,
    STEEP,
    STICKS,
    X,
    closed_from,
    closed_link_row,
    grip_at,
    rows_of_closed,
)
from xdynamics.march.assembly.links import NOISE
from xdynamics.march.run import Run

LIFTING = 1e-10  # of the largest force: a pull, or a drag beyond its bound, that is smaller may be rounding
LIFTS, BREAKS, STOPS = range(1, 4)  # what happens to a closed link: its force, its grip, or its slip passes zero
# rows of `margins`: at start, middle and end of a step, its start, and what happens at its end
FIRST, MIDDLE, LAST, SINCE, AT_END = range(5)


@jit_separate
def margin(run: Run, a: int, release_kind: int) -> float:
    """What of a closed link falls to zero where it lifts, its grip breaks, or its slip stops."""
    row = closed_link_row(run, a)
    if release_kind == LIFTS:
        return float(run.loads[a])
    if release_kind == BREAKS:
        return float(run.vectors[GRIP, row + 1] * run.loads[a] - abs(run.pulls[a]))
    return slip_on(run, a)


@jit_separate
def slip_on(run: Run, a: int) -> float:
    """The slip of a link that slides, in the direction in which it began to."""
    from_row = run.vectors[RATES, closed_link_row(run, a) + 1]
    return float(from_row if run.grips[a] == SLIDES_ON else -from_row)


@jit_separate
def margin_rounding(run: Run, a: int, release_kind: int, size: float) -> float:
    """How far below zero rounding may leave a margin, with forces of a size."""
    row = closed_link_row(run, a)
    if release_kind == LIFTS:
        return float(LIFTING * size * run.vectors[SCALE, row])
    if release_kind == BREAKS:
        return float(LIFTING * size * run.vectors[OWN_SCALE, row + 1])
    return float(NOISE * run.vectors[STEEP, row + 1] * run.greatest[0])


@jit_separate
def size_of_forces(run: Run) -> float:
    """The largest scaled force of closed links, or acceleration that they hold, just found."""
    size = 0.0
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        size = max(size, abs(run.vectors[X, row]), abs(run.vectors[RIGHT, row]))
    return size


@jit_separate
def release_of(run: Run, a: int, size: float) -> int:
    """What happens to a closed link by the forces just found, of a size; 0 for nothing."""
    if margin(run, a, LIFTS) < -margin_rounding(run, a, LIFTS, size):
        return LIFTS
    grip = grip_at(run, a)
    if grip == FRICTIONLESS:
        return 0
    release_kind = BREAKS if grip == STICKS else STOPS
    return release_kind if margin(run, a, release_kind) < -margin_rounding(run, a, release_kind, size) else 0


@jit_separate
def note_margins(run: Run, margin_row: int) -> None:
    """Note what may fall to zero of every closed link: its force, and what is left of its grip, or its slip."""
    for a in range(run.closed[0]):
        grip = grip_at(run, a)
        run.release_functions[margin_row, 2 * a], run.release_functions[margin_row, 2 * a + 1] = (
            margin(run, a, LIFTS),
            inf,
        )
        if grip != FRICTIONLESS:
            run.release_functions[margin_row, 2 * a + 1] = margin(run, a, BREAKS if grip == STICKS else STOPS)


@jit_separate
def least_margin(run: Run) -> float:
    """The least of what falls to zero in the trial, as it was found last.

    One that rounding cannot tell from zero where the search begins, as a slip that has just begun, falls to below zero by as
    much.
    """
    smallest, size = inf, size_of_forces(run)
    for a in range(run.closed[0]):
        if run.lifted[a] > 0:
            smallest = min(smallest, remaining_margin(run, a, size))
    return smallest


@jit_separate
def remaining_margin(run: Run, a: int, size: float) -> float:
    """What is left of that which falls to zero of one closed link, with forces of a size."""
    release_kind = run.lifted[a]
    begins, rounding = (
        run.release_functions[FIRST, 2 * a + (0 if release_kind == LIFTS else 1)],
        margin_rounding(run, a, release_kind, size),
    )
    return float(margin(run, a, release_kind) + (rounding if begins <= rounding else 0.0))


@jit_separate
def keep_passed_margins(run: Run) -> None:
    """Forget, of what falls to zero in the trial, that which has not done so by the end that it was shortened to."""
    size = size_of_forces(run)
    for a in range(run.closed[0]):
        if run.lifted[a] > 0 and remaining_margin(run, a, size) > 0.0:
            run.lifted[a] = 0
