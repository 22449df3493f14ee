"""A step whose equations are solved by Newton's method with the Jacobian at every iteration.

Derivatives of the forces at a state are exact or by differences, one by one or group by group of the matrix's columns.
"""

from __future__ import annotations

import math

from xdynamics.elementary.bounds import EPS
from xdynamics.kernels.compiling import jit_inline, jit_separate, noinline
from xdynamics.kernels.law import LINEARISED, PROPOSE
from xdynamics.kernels.linear import factorise, factorise_band, solve_linear, substitute, substitute_band
from xdynamics.kernels.newton_matrix import DIRECT
from xdynamics.kernels.program import H, T
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
    # columns of a group have no row in common: one evaluation gives all of them (Curtis, Powell, Reid, 1974)
    for group in range(run.groups.shape[0] - 1):
        begin, end = run.groups[group], run.groups[group + 1]
        if differences:
            for i in range(used):
                shifted[i] = y[i]
        for k in range(begin, end):
            column = run.entries[k, 1]
            # zero marks a column that is not shifted yet: one with several entries is shifted once
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
    """Return the index of an entry in a matrix, which is banded or full."""
    if run.band.shape[0] > 0:
        return int(
            run.order[column] * column_height(run) + run.band[0] + run.band[1] + run.order[row] - run.order[column]
        )
    return column * run.order.shape[0] + row


MOST_ITERATIONS = 25
NEWTON_TOLERANCE = 1e-10  # of a correction against the size of its unknown; what is left is of the order of its square


@jit_inline
def newton_step(run: Run, y: State, z: State, sample: int) -> None:
    """Make a step by the lines of the method: solve its equations in turn, and execute the lines after each."""
    call_law(run.law[PROPOSE], run, y, z, sample)
    run.now[0].evaluations += run.plan[0].stages
    for k in range(run.equations.shape[0]):
        turns = solve_by_newton(run, k, y, z, sample)
        trial = run.trial[0]
        trial.iterations = trial.iterations + turns if turns >= 0 and trial.iterations >= 0 else -1
        call_law(run.law[PROPOSE + 2 * k + 2], run, y, z, sample)


@jit_inline
def solve_by_newton(run: Run, k: int, y: State, z: State, sample: int) -> int:
    """Solve by Newton's method with the exact Jacobian at every iteration; return the iterations, -1 if in vain."""
    equation, w = run.equations[k], run.w
    n, right = equation.unknowns, run.right
    turns, solved = 0, n == 0
    while turns < MOST_ITERATIONS and not solved:
        turns += 1
        call_law(run.law[PROPOSE + 2 * k + 1], run, y, z, sample)
        run.now[0].jacobians += 1
        run.now[0].factorisations += 1
        if not (corrected_by_groups(run, k) if equation.state >= 0 else corrected(run, k)):
            break
        solved = True
        for i in range(n):
            row = equation.first_unknown + i
            unknown, start_index, rate = run.unknowns[row, 0], run.unknowns[row, 1], run.unknowns[row, 2]
            w[unknown] -= right[i]
            if right[i] != 0.0:
                size = abs(w[unknown]) + abs(y[start_index]) + abs(run.at[H] * y[rate])
                solved = solved and abs(right[i]) / size <= NEWTON_TOLERANCE
        solved = solved or (turns >= LATE and iterate_is_rounding(run, k, y))
    run.now[0].evaluations += max(0, turns - 1) * equation.evaluations
    return turns if solved else -1


@jit_inline
def iterate_is_rounding(run: Run, k: int, y: State) -> bool:
    """Whether the last corrections are as small as the rounding of forces, as `radau.corrections_are_rounding`."""
    equation, n, scratch, coordinates = (
        run.equations[k],
        run.equations[k].unknowns,
        run.shifted,
        run.plan[0].coordinates,
    )
    for i in range(n):  # of each unknown: the terms of its equation; how steeply they follow it
        scratch[i], scratch[n + i] = unknown_size(run, equation.first_unknown + i, y), 1.0
    for i in range(equation.first_entry, equation.first_entry + equation.entries if equation.state < 0 else 0):
        add_term(run, k, run.entries[i, 0], run.entries[i, 1], written_entry(run, i), y)
    for i in range(run.entries.shape[0] if equation.state >= 0 else 0):
        column = run.entries[i, 1]
        unknown = column - coordinates if column >= coordinates else column
        add_term(run, k, run.entries[i, 0], unknown, grouped_entry(run, k, i), y)
    below = True
    for i in range(n):
        below = below and abs(run.right[i]) * scratch[n + i] <= ROUNDED * scratch[i]
    return below


@jit_separate
def add_term(run: Run, k: int, row: int, column: int, slope: float, y: State) -> None:
    """Add the term of one unknown to those of an equation."""
    n, scratch = run.equations[k].unknowns, run.shifted
    scratch[row] += abs(slope) * unknown_size(run, run.equations[k].first_unknown + column, y)
    if row == column:
        scratch[n + row] += abs(slope)


@jit_separate
def unknown_size(run: Run, row: int, y: State) -> float:
    """Return the size of an unknown; of a velocity also that of its coordinate, over the step."""
    unknown, start_index, coordinates = run.unknowns[row, 0], run.unknowns[row, 1], run.plan[0].coordinates
    size = abs(run.w[unknown]) + abs(y[start_index])
    if coordinates <= start_index < 2 * coordinates:
        size += abs(y[start_index - coordinates] / run.at[H])
    return float(size)


@jit_separate
def corrected(run: Run, k: int) -> bool:
    """Solve for the corrections of one iteration with the full matrix; False if it is singular."""
    equation, n = run.equations[k], run.equations[k].unknowns
    assemble(run, k)
    for i in range(n):
        run.right[i] = run.w[equation.residuals + i]
    return solve_linear(run.matrix, run.right, n)


@jit_separate
def corrected_by_groups(run: Run, k: int) -> bool:
    """Solve for the corrections with derivatives by column groups, and with a band where the pattern has one."""
    equation, n, right, order, corrections = (
        run.equations[k],
        run.equations[k].unknowns,
        run.right,
        run.order,
        run.shifted,
    )
    find_at_iterate(run, k)
    assemble_by_groups(run, k)
    for i in range(n):
        right[order[i]] = run.w[equation.residuals + i]
    if run.band.shape[0] > 0:
        lower, upper = run.band[0], run.band[1]
        if not factorise_band(run.matrix, run.pivots, n, lower, upper):
            return False
        substitute_band(run.matrix, run.pivots, right, n, lower, upper)
    else:
        if not factorise(run.matrix, run.pivots, n):
            return False
        substitute(run.matrix, run.pivots, right, n)
    # within one array the permutation would overwrite what is still to be read
    for i in range(n):
        corrections[i] = right[order[i]]
    for i in range(n):
        right[i] = corrections[i]
    return True


@jit_separate
def find_at_iterate(run: Run, k: int) -> None:
    """Find the derivatives at the state and the time of the last force evaluation."""
    equation, start, h = run.equations[k], run.at[T], run.at[H]
    for i in range(run.stage.shape[0]):
        run.stage[i] = run.w[equation.state + i]
    time = run.w[equation.derivatives + run.entries.shape[0] + run.plan[0].used]
    direction_law = PROPOSE + 2 * run.equations.shape[0] + 1
    find_by_groups(run, time, h, run.stage, run.shifted, direction_law, equation.derivatives)
    run.at[T] = start


@jit_separate
def assemble_by_groups(run: Run, k: int) -> None:
    """Assemble the matrix, as `assemble` does, at the places of the pattern's entries."""
    equation, w, n, coordinates = run.equations[k], run.w, run.equations[k].unknowns, run.plan[0].coordinates
    weights, matrix = equation.weights, run.matrix
    for i in range(n * column_height(run)):
        matrix[i] = 0.0
    for i in range(n):
        matrix[matrix_index(run, i, i)] = 1.0 - w[weights + (0 if i < coordinates else 1)]
    for i in range(run.entries.shape[0]):
        entry = grouped_entry(run, k, i)
        if entry != 0.0:
            row, column = run.entries[i, 0], run.entries[i, 1]
            matrix[matrix_index(run, row, column - coordinates if column >= coordinates else column)] -= entry


@jit_separate
def grouped_entry(run: Run, k: int, i: int) -> float:
    """Return the subtrahend of an entry of the unit matrix: a derivative of the forces, weighted by its kind."""
    equation, row, column, coordinates = run.equations[k], run.entries[i, 0], run.entries[i, 1], run.plan[0].coordinates
    kind = 0 if column < coordinates else 1 if column < 2 * coordinates else 2
    weight = run.w[equation.weights + (2 if row < coordinates else 5) + kind]
    return float(weight * or_none(run.w[equation.derivatives + i]))


@jit_separate
def written_entry(run: Run, i: int) -> float:
    """Return the subtrahend of an entry of the unit matrix that is written out."""
    entry_index, slope = run.entries[i, 2], run.entries[i, 3]
    return float(or_none(run.w[entry_index] if slope == DIRECT else run.w[entry_index] * run.w[slope]))


@jit_separate
def assemble(run: Run, k: int) -> None:
    """Assemble the matrix: the unit matrix less derivatives of the equations, by themselves and through the forces."""
    equation, n, matrix = run.equations[k], run.equations[k].unknowns, run.matrix
    for i in range(n * n):
        matrix[i] = 0.0
    for i in range(n):
        matrix[i * n + i] = 1.0
    for i in range(equation.first_entry, equation.first_entry + equation.entries):
        matrix[run.entries[i, 0] * n + run.entries[i, 1]] -= written_entry(run, i)
