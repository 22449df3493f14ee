"""What of a closed link falls to zero where it lifts, its grip breaks or its slip stops, and what rounding may leave of it.

The search for releases, that for their times and the sharing of forces judge by this alone.
"""

from __future__ import annotations

from math import inf

from xdynamics.kernels.compiling import shared
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
    grip_at,
    row_of,
    rows_of_closed,
)
from xdynamics.march.assembly.links import NOISE
from xdynamics.march.run import Run

LIFTING = 1e-10  # of the largest force: a pull, or a drag beyond its bound, that is smaller may be rounding
LIFTS, BREAKS, STOPS = range(1, 4)  # what happens to a closed link: its force, its grip, or its slip passes zero
# rows of `margins`: at start, middle and end of a step, its start, and what happens at its end
FIRST, MIDDLE, LAST, SINCE, AT_END = range(5)


@shared
def margin(run: Run, a: int, what: int) -> float:
    """What of a closed link falls to zero where it lifts, its grip breaks, or its slip stops."""
    row = row_of(run, a)
    if what == LIFTS:
        return float(run.loads[a])
    if what == BREAKS:
        return float(run.vectors[GRIP, row + 1] * run.loads[a] - abs(run.pulls[a]))
    return slip_on(run, a)


@shared
def slip_on(run: Run, a: int) -> float:
    """The slip of a link that slides, in the direction in which it began to."""
    from_row = run.vectors[RATES, row_of(run, a) + 1]
    return float(from_row if run.grips[a] == SLIDES_ON else -from_row)


@shared
def rounding_of(run: Run, a: int, what: int, size: float) -> float:
    """How far below zero rounding may leave a margin, with forces of a size."""
    row = row_of(run, a)
    if what == LIFTS:
        return float(LIFTING * size * run.vectors[SCALE, row])
    if what == BREAKS:
        return float(LIFTING * size * run.vectors[OWN_SCALE, row + 1])
    return float(NOISE * run.vectors[STEEP, row + 1] * run.greatest[0])


@shared
def size_of_forces(run: Run) -> float:
    """The largest scaled force of closed links, or acceleration that they hold, just found."""
    size = 0.0
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        size = max(size, abs(run.vectors[X, row]), abs(run.vectors[RIGHT, row]))
    return size


@shared
def release_of(run: Run, a: int, size: float) -> int:
    """What happens to a closed link by the forces just found, of a size; 0 for nothing."""
    if margin(run, a, LIFTS) < -rounding_of(run, a, LIFTS, size):
        return LIFTS
    grip = grip_at(run, a)
    if grip == FRICTIONLESS:
        return 0
    what = BREAKS if grip == STICKS else STOPS
    return what if margin(run, a, what) < -rounding_of(run, a, what, size) else 0


@shared
def note_margins(run: Run, place: int) -> None:
    """Note what may fall to zero of every closed link: its force, and what is left of its grip, or its slip."""
    for a in range(run.closed[0]):
        grip = grip_at(run, a)
        run.margins[place, 2 * a], run.margins[place, 2 * a + 1] = margin(run, a, LIFTS), inf
        if grip != FRICTIONLESS:
            run.margins[place, 2 * a + 1] = margin(run, a, BREAKS if grip == STICKS else STOPS)


@shared
def least_margin(run: Run) -> float:
    """The least of what falls to zero in the trial, as it was found last.

    One that rounding cannot tell from zero where the search begins, as a slip that has just begun, falls to below zero by as
    much.
    """
    least, size = inf, size_of_forces(run)
    for a in range(run.closed[0]):
        if run.lifted[a] > 0:
            least = min(least, left_of(run, a, size))
    return least


@shared
def left_of(run: Run, a: int, size: float) -> float:
    """What is left of that which falls to zero of one closed link, with forces of a size."""
    what = run.lifted[a]
    begins, rounding = run.margins[FIRST, 2 * a + (0 if what == LIFTS else 1)], rounding_of(run, a, what, size)
    return float(margin(run, a, what) + (rounding if begins <= rounding else 0.0))


@shared
def keep_passed(run: Run) -> None:
    """Forget, of what falls to zero in the trial, that which has not done so by the end that it was shortened to."""
    size = size_of_forces(run)
    for a in range(run.closed[0]):
        if run.lifted[a] > 0 and left_of(run, a, size) > 0.0:
            run.lifted[a] = 0
