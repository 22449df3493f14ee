"""Derivatives of the forces at a state: exact or by differences, one by one or group by group; where a matrix has them."""

from __future__ import annotations

import math

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate, noinline
from xdynamics.kernels.law import LINEARISED
from xdynamics.kernels.program import T
from xdynamics.march.calls import call_law
from xdynamics.march.force_evaluation import State, evaluate_forces, state_slope
from xdynamics.march.run import Run

ROUNDED = 64.0 * EPS  # of the terms of an equation: what a correction below does is rounding
LATE = 6  # iterations after which corrections are no smaller than rounding makes them, if ever

slope_apart = noinline(state_slope)


@jit_separate
def linearise_forces(run: Run, t: float, h: float, y: State) -> None:
    """Evaluate the derivatives at a state; factors of earlier ones are discarded.

    A state next to it stands where the trial's end will, but where what was there is read: constraints are solved for, and
    forces of links, from those found last.
    """
    shifted = run.z
    if run.plan[0].held > 0 or run.plan[0].assemblies > 0:
        shifted = run.shifted
    if run.groups.shape[0] > 0:
        find_by_groups(run, t, h, y, shifted, LINEARISED, 3 * run.plan[0].used)
    elif run.plan[0].differences:
        differentiate(run, t, h, y, shifted)
    else:
        run.at[T] = t
        call_law(run.law[LINEARISED], run, y, run.stage, 0)
    first = 3 * run.plan[0].used
    for k in range(run.entries.shape[0]):
        run.w[first + k] = or_none(run.w[first + k])
    run.kept[0].linearised, run.kept[0].factored = 1, 0.0
    run.now[0].jacobians += 1


@jit_separate
def or_none(slope: float) -> float:
    """Return a derivative, or 0 where it has no value, as of v*hypot(v, w) at rest: iterations only need one that is near."""
    return slope if math.isfinite(slope) else 0.0


@jit_separate
def differentiate(run: Run, t: float, h: float, y: State, shifted: State) -> None:
    """Find the derivatives by one-sided differences, each over sqrt(eps) of the size of its variable."""
    used, entry_index = run.plan[0].used, 3 * run.plan[0].used
    for column in range(used):
        for i in range(used):
            shifted[i] = y[i]
        change = shift_variable(run, h, y, shifted, column)
        evaluate_forces(run, t, shifted)
        for i in range(run.plan[0].coordinates, used):
            run.w[entry_index] = (slope_apart(run, shifted, i) - slope_apart(run, y, i)) / change
            entry_index += 1


@jit_separate
def shift_variable(run: Run, h: float, y: State, shifted: State, column: int) -> float:
    """Shift a variable of a state next to y by sqrt(eps) of its size; return by how much."""
    size = max(abs(y[column]), abs(h * slope_apart(run, y, column)))
    if math.isfinite(run.atol[column]):
        size = max(size, run.atol[column])
    shifted[column] += math.sqrt(EPS) * size if size > 0.0 else math.sqrt(EPS)
    return float(shifted[column] - y[column])  # as it was rounded


@jit_separate
def find_by_groups(run: Run, t: float, h: float, y: State, shifted: State, direction_law: int, first: int) -> None:
    """Find the derivatives of all columns of a group at once: along their sum, or by a difference, in a state for it.

    They go to `w` from `first` on; `direction_law` is the number of the law that gives derivatives along a direction.
    """
    used, w, differences = run.plan[0].used, run.w, run.plan[0].differences
    direction = first + run.entries.shape[0]
    for group in range(run.groups.shape[0] - 1):
        begin, end = run.groups[group], run.groups[group + 1]
        if differences:
            for i in range(used):
                shifted[i] = y[i]
        for k in range(begin, end):
            column = run.entries[k, 1]
            if w[direction + column] == 0.0:
                w[direction + column] = shift_variable(run, h, y, shifted, column) if differences else 1.0
        if differences:
            evaluate_forces(run, t, shifted)
        else:
            run.at[T] = t
            call_law(run.law[direction_law], run, y, shifted, 0)
        for k in range(begin, end):
            row, column = run.entries[k, 0], run.entries[k, 1]
            w[first + k] = shifted[used + row]
            if differences:
                w[first + k] = (shifted[used + row] - y[used + row]) / w[direction + column]
        for k in range(begin, end):
            w[direction + run.entries[k, 1]] = 0.0


@jit_separate
def column_height(run: Run) -> int:
    """Return how many numbers a column of a matrix has."""
    return int(2 * run.band[0] + run.band[1] + 1) if run.band.shape[0] > 0 else run.order.shape[0]


@jit_separate
def matrix_index(run: Run, row: int, column: int) -> int:
    """Return the place of an entry in a matrix, which is a band or whole."""
    if run.band.shape[0] > 0:
        return int(
            run.order[column] * column_height(run) + run.band[0] + run.band[1] + run.order[row] - run.order[column]
        )
    return column * run.order.shape[0] + row
