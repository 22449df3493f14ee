"""The corrections of a step by Radau IIA, measured by tolerances, by the sizes of unknowns, and by rounding."""

from __future__ import annotations

from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.formulas import larger
from xdynamics.march.assembly.closed_links import SCALE, X, closed_from, rows_of_closed
from xdynamics.march.control import term_rounding
from xdynamics.march.force_evaluation import State
from xdynamics.march.implicit.derivatives import ROUNDED, slope_apart
from xdynamics.march.run import Run
from xdynamics.methods.radau import T as TRANSFORMATION

# single numbers: numba would build tuples anew at every use
(T00, T01, T02), (T10, T11, T12), (T20, _, _) = TRANSFORMATION


@jit_separate
def largest_correction(run: Run, h: float, y: State, weighed: bool) -> float:
    """Return the largest of the last corrections, relative to its tolerance or to the size of its unknown.

    They stand where stages will; the largest of each unknown is left in `right`, for messages. If `weighed` by the sizes
    of terms, those within their rounding are none.
    """
    n, plan, largest = run.plan[0].used, run.plan[0], 0.0
    holds_links = plan.assemblies > 0 and run.closed[0] > 0
    if holds_links:
        held_of_kinds(run, h)
    for i in range(n):
        scale = run.atol[i] + plan.rtol * abs(y[i])
        move = largest_move(run, i)
        if plan.follows and scale == 0.0:  # it was at rest: its move is the only scale
            scale = plan.rtol * move
        if settles_to_rounding(run):
            scale = abs(y[i]) + abs(h * slope_apart(run, y, i)) + move
            if holds_links:
                scale += held_from(run, h, i)
        run.right[i] = 0.0
        rounding_floor = term_rounding(run, i, h) if weighed and run.adaptive_atol[i] else 0.0
        for k in range(3):
            change = abs(run.stages[k * n + i])
            run.right[i] = larger(run.right[i], change)
            if change <= rounding_floor and scale < rounding_floor:
                continue
            if change != 0.0:
                largest = larger(largest, change / scale)
    return largest


@jit_separate
def largest_move(run: Run, i: int) -> float:
    """Return how far an unknown has moved since the start of the step, at most."""
    n, transformed = run.plan[0].used, run.turned
    first, second, third = at_stages(transformed[i], transformed[n + i], transformed[2 * n + i])
    return max(abs(first), abs(second), abs(third))


@jit_separate
def settles_to_rounding(run: Run) -> bool:
    """Whether steps are solved to rounding: given ones, and where links meet, as a gap is to pass through zero but once."""
    return not run.plan[0].adaptive or run.plan[0].assemblies > 0


@jit_separate
def held_of_kinds(run: Run, h: float) -> None:
    """Find the largest velocity of each kind that the forces of closed links, just found, keep from bodies in the step.

    What links hold has no size of its own but rounding about zero, and that is a share of the terms that cancel.
    """
    n = run.plan[0].coordinates
    for k in range(run.tops.shape[0]):
        run.tops[k] = 0.0
    for row in range(closed_from(run), closed_from(run) + rows_of_closed(run)):
        amount = h * run.vectors[X, row] * run.vectors[SCALE, row]
        for i in range(run.normals.shape[1]):
            kind = run.kinds[n + run.coordinate_indices[row, i]]
            run.tops[kind] = max(run.tops[kind], abs(run.unit_responses[row, i] * amount))


@jit_separate
def held_from(run: Run, h: float, i: int) -> float:
    """Return what closed links keep from an unknown of the kind of this one in the step."""
    n = run.plan[0].coordinates
    if i < n:
        return float(h * run.tops[run.kinds[n + i]])
    return float(run.tops[run.kinds[i]]) if i < 2 * n else 0.0


@jit_inline
def corrections_are_rounding(run: Run, h: float, y: State) -> bool:
    """Whether the last corrections are what rounding of the state does to the forces.

    What is left of large terms that cancel, as of bars that pull to both sides, has no digits below: a correction is then
    no share of its unknown.
    """
    n, used, first, scratch = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.turned
    if not run.kept[0].factored > 0.0:
        return False
    for i in range(used):  # of each unknown: its size; the terms of its equation; how steeply they follow it
        size = abs(y[i]) + largest_move(run, i)
        scratch[i], scratch[used + i], scratch[2 * used + i] = size, size, 1.0
    for k in range(run.entries.shape[0]):
        row, column, slope = n + run.entries[k, 0], run.entries[k, 1], abs(h * run.w[first + k])
        scratch[used + row] += slope * scratch[column]
        if column == row or column == row - n:
            scratch[2 * used + row] += slope if column == row else h * slope
    for i in range(used):
        terms = scratch[used + i] / scratch[2 * used + i]
        if i < n:
            terms += h * scratch[used + n + i] / scratch[2 * used + n + i]
        if not run.right[i] <= ROUNDED * terms:
            return False
    return True


@jit_separate
def at_stages(w0: float, w1: float, w2: float) -> tuple[float, float, float]:
    """Multiply one component of three vectors by T."""
    return T00 * w0 + T01 * w1 + T02 * w2, T10 * w0 + T11 * w1 + T12 * w2, T20 * w0 + w1
