"""A step whose equations are solved by Newton's method with the exact Jacobian at every iteration."""

from __future__ import annotations

from xdynamics.kernels.band import factorise_band, substitute_band
from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.law import PROPOSE
from xdynamics.kernels.linear import factorise, solve_linear, substitute
from xdynamics.kernels.newton_matrix import DIRECT
from xdynamics.kernels.program import H, T
from xdynamics.march.calls import call_law
from xdynamics.march.force_evaluation import State
from xdynamics.march.implicit.derivatives import LATE, ROUNDED, column_height, find_by_groups, matrix_index, or_none
from xdynamics.march.run import Run

MOST_ITERATIONS = 25
NEWTON_TOLERANCE = 1e-10  # of a correction against the size of its unknown; what is left is of the order of its square


@jit_inline
def newton_step(run: Run, y: State, z: State, sample: int) -> None:
    """Make a step by the lines of the method: solve its equations in turn, and execute what follows each."""
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
    """Whether the last corrections are what rounding of the state does to the forces, as in `corrections.corrections_are_rounding`."""
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
    """Solve for the corrections of one iteration, with the matrix whole; False if it is singular."""
    equation, n = run.equations[k], run.equations[k].unknowns
    assemble(run, k)
    for i in range(n):
        run.right[i] = run.w[equation.residuals + i]
    return solve_linear(run.matrix, run.right, n)


@jit_separate
def corrected_by_groups(run: Run, k: int) -> bool:
    """Solve for the corrections with derivatives found group by group, and with a band where the pattern has one."""
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
    """Return what an entry of the pattern takes from the unit matrix: a derivative of the forces, weighted by its kind."""
    equation, row, column, coordinates = run.equations[k], run.entries[i, 0], run.entries[i, 1], run.plan[0].coordinates
    kind = 0 if column < coordinates else 1 if column < 2 * coordinates else 2
    weight = run.w[equation.weights + (2 if row < coordinates else 5) + kind]
    return float(weight * or_none(run.w[equation.derivatives + i]))


@jit_separate
def written_entry(run: Run, i: int) -> float:
    """Return what an entry that is written out takes from the unit matrix."""
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
