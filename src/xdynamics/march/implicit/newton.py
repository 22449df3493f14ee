"""A step whose equations are solved by Newton's method with the exact Jacobian at every iteration."""

from __future__ import annotations

from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.law import PROPOSE
from xdynamics.kernels.linear import solve_linear
from xdynamics.kernels.newton_matrix import DIRECT
from xdynamics.kernels.program import H
from xdynamics.march.calls import called
from xdynamics.march.force_evaluation import State
from xdynamics.march.run import Run

MOST_ITERATIONS = 25
NEWTON_TOLERANCE = 1e-10  # of a correction against the size of its unknown; what is left is of the order of its square


@compiled
def newton_step(run: Run, y: State, z: State, sample: int) -> None:
    """Make a step by the lines of the method: solve its equations in turn, and execute what follows each."""
    called(run.law[PROPOSE], run, y, z, sample)
    run.now[0].evaluations += run.plan[0].stages
    for k in range(run.equations.shape[0]):
        turns = newton(run, k, y, z, sample)
        trial = run.trial[0]
        trial.iterations = trial.iterations + turns if turns >= 0 and trial.iterations >= 0 else -1
        called(run.law[PROPOSE + 2 * k + 2], run, y, z, sample)


@compiled
def newton(run: Run, k: int, y: State, z: State, sample: int) -> int:
    """Solve by Newton's method with the exact Jacobian at every iteration; return the iterations, -1 if in vain."""
    equation, w = run.equations[k], run.w
    n, right = equation.unknowns, run.right
    turns, solved = 0, n == 0
    while turns < MOST_ITERATIONS and not solved:
        turns += 1
        called(run.law[PROPOSE + 2 * k + 1], run, y, z, sample)
        assemble(run, k)
        run.now[0].jacobians += 1
        run.now[0].factorisations += 1
        for i in range(n):
            right[i] = w[equation.residuals + i]
        if not solve_linear(run.matrix, right, n):
            break
        solved = True
        for i in range(n):
            row = equation.first_unknown + i
            unknown, before, rate = run.unknowns[row, 0], run.unknowns[row, 1], run.unknowns[row, 2]
            w[unknown] -= right[i]
            if right[i] != 0.0:
                size = abs(w[unknown]) + abs(y[before]) + abs(run.at[H] * y[rate])
                solved = solved and abs(right[i]) / size <= NEWTON_TOLERANCE
    run.now[0].evaluations += max(0, turns - 1) * equation.evaluations
    return turns if solved else -1


@shared
def assemble(run: Run, k: int) -> None:
    """Assemble the matrix: the unit matrix less derivatives of the equations, by themselves and through the forces."""
    equation, w = run.equations[k], run.w
    n, matrix = equation.unknowns, run.matrix
    for i in range(n * n):
        matrix[i] = 0.0
    for i in range(n):
        matrix[i * n + i] = 1.0
    for i in range(equation.first_entry, equation.first_entry + equation.entries):
        row, column, place, slope = run.entries[i, 0], run.entries[i, 1], run.entries[i, 2], run.entries[i, 3]
        # an entry left out has no such term at all: a derivative that is NaN must not reach the others
        matrix[row * n + column] -= w[place] if slope == DIRECT else w[place] * w[slope]
