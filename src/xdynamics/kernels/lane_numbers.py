"""The numbers of a lane: which they are, where they stand, and how many there are."""

from __future__ import annotations

from collections import namedtuple

from xdynamics.kernels.layout import Layout
from xdynamics.kernels.radau_memory import memory_width
from xdynamics.methods.steppers import SERIES, SIMPLIFIED

# Numbers of a lane besides its state, in the working memory `w`, which explicit steps leave alone: `lives` is 1 where a
# run goes on; `done` counts accepted and rejected trials, `most` is their limit; h and norm are those of the last
# accepted step, tried is the norm of the last trial; `inner` is 1 where the next node is not the end, `landed` where
# the last step ended at such a node; `doubtful` is 1 where a trial is weighed again by the sizes of terms, `weighed`
# its norm then. After them: absolute tolerances, largest values, the error of that step; for each event
# function the side of zero on which it has to stay (2: either, 0: unknown), and for a gap how large it was; what
# `collocation` keeps; for each switch declared smooth its side, how often it was passed, and when first.
Lane = namedtuple(
    "Lane",
    "t h norm tried step step_log rejected grid on_grid done accepted most lives node snap inner landed start step_size"
    " rtol floor rest rounding weighs doubtful weighed k safety least greatest min_step max_step end first_step ordinary",
)
LANE, PLACES = Lane._fields, Lane(*range(len(Lane._fields)))


def lane_width(layout: Layout, memory: int) -> int:
    """Return how many numbers a lane has in `w`, for steps that work on so many of them."""
    return of_smooth(layout, memory) + 3 * len(layout.smooth)


def noted_width(layout: Layout) -> int:
    """Return how many numbers a step in lanes records besides the state: energies, observables, smooth switches."""
    return max(1, len(layout.derived) + 2 * len(layout.smooth))


def of_collocation(layout: Layout) -> int:
    """Return where in a lane's memory the numbers that a step of Radau IIA keeps begin, or those of Taylor series."""
    return len(LANE) + 3 * layout.used.size + 2 * len(layout.watched)


def of_smooth(layout: Layout, memory: int) -> int:
    """Return where in a lane's memory the numbers of switches declared smooth begin."""
    memory_length = memory_width(layout) if is_solved(layout) else memory if has_series(layout) else 0
    return of_collocation(layout) + memory_length


def is_solved(layout: Layout) -> bool:
    """Whether a step solves equations in lanes, by iterations that keep what they know for the next one."""
    return layout.scheme is not None and layout.scheme.method.solver == SIMPLIFIED


def has_series(layout: Layout) -> bool:
    """Whether a step sums Taylor series, which choose its size."""
    return layout.scheme is not None and layout.scheme.method.solver == SERIES
