"""Linear systems of Radau IIA in transformed variables: gamma/h - J and (alpha + i beta)/h - J, with J and factors.

In both, the coordinates are eliminated by their rows c dq - dv = r, so that only velocities and first-order states are
factorised (Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8).
"""

from __future__ import annotations

import math

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import apart, shared
from xdynamics.kernels.law import LINEARISED
from xdynamics.kernels.linear import factorise, factorise_complex, substitute, substitute_complex
from xdynamics.kernels.program import T
from xdynamics.march.calls import called
from xdynamics.march.force_evaluation import State, evaluate, slope_of
from xdynamics.march.run import Run
from xdynamics.methods.radau import ALPHA, BETA, GAMMA

slope_apart = apart(slope_of)


@shared
def linearise(run: Run, t: float, h: float, y: State) -> None:
    """Evaluate the derivatives at a state; factors of earlier ones are discarded."""
    if run.plan[0].differences:
        differentiate(run, t, h, y)
    else:
        run.at[T] = t
        called(run.law[LINEARISED], run, y, run.stage, 0)
    run.kept[0].linearised, run.kept[0].factored = 1, 0.0
    run.now[0].jacobians += 1


@shared
def differentiate(run: Run, t: float, h: float, y: State) -> None:
    """Find the derivatives by one-sided differences, each over sqrt(eps) of the size of its variable."""
    used, shifted, place = run.plan[0].used, run.shifted, 3 * run.plan[0].used
    for column in range(used):
        for i in range(used):
            shifted[i] = y[i]
        size = max(abs(y[column]), abs(h * slope_apart(run, y, column)))
        if math.isfinite(run.atol[column]):
            size = max(size, run.atol[column])
        shifted[column] += math.sqrt(EPS) * size if size > 0.0 else math.sqrt(EPS)
        change = shifted[column] - y[column]  # as it was rounded
        evaluate(run, t, shifted)
        for i in range(run.plan[0].coordinates, used):
            run.w[place] = (slope_apart(run, shifted, i) - slope_apart(run, y, i)) / change
            place += 1


@shared
def factorise_both(run: Run, h: float) -> bool:
    """Assemble the real and the complex matrix for a step size, and factorise them; False if one is singular."""
    n, first, matrix = run.plan[0].coordinates, 3 * run.plan[0].used, run.matrix
    size = run.plan[0].used - n
    gamma, alpha, beta = GAMMA / h, ALPHA / h, BETA / h
    square = alpha * alpha + beta * beta
    for i in range(3 * size * size):
        matrix[i] = 0.0
    re, im = size * size, 2 * size * size
    for i in range(size):
        diagonal = i * size + i
        matrix[diagonal], matrix[re + diagonal], matrix[im + diagonal] = gamma, alpha, beta
    for k in range(run.entries.shape[0]):
        row, column, slope = run.entries[k, 0], run.entries[k, 1], run.w[first + k]
        if column < n:  # dq = dv/c, and 1/(alpha + i beta) is (alpha - i beta)/square
            place = column * size + row
            matrix[place] -= slope / gamma
            matrix[re + place] -= slope * (alpha / square)
            matrix[im + place] += slope * (beta / square)
        else:
            place = (column - n) * size + row
            matrix[place] -= slope
            matrix[re + place] -= slope
    run.kept[0].factored = 0.0
    if not factorise(matrix, run.pivots, size) or not factorise_complex(matrix, run.pivots, size):
        return False
    run.kept[0].factored = h
    run.now[0].factorisations += 1
    return True


@shared
def solve_real(run: Run, vector: State) -> None:
    """Solve (gamma/h - J) d = r in place, with the factors at hand."""
    n, used, first, right = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.right
    gamma = GAMMA / run.kept[0].factored
    for i in range(n, used):
        right[i - n] = vector[i]
    for k in range(run.entries.shape[0]):
        column = run.entries[k, 1]
        if column < n:
            right[run.entries[k, 0]] += run.w[first + k] * (vector[column] / gamma)
    substitute(run.matrix, run.pivots, right, used - n)
    for i in range(n, used):
        vector[i] = right[i - n]
    for i in range(n):
        vector[i] = (vector[i] + vector[n + i]) / gamma


@shared
def solve_complex(run: Run) -> None:
    """Solve ((alpha + i beta)/h - J) d = r in place, for the second and the third part of the defects."""
    n, used, first, right = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.right
    size, defects = used - n, run.defects
    alpha, beta = ALPHA / run.kept[0].factored, BETA / run.kept[0].factored
    square = alpha * alpha + beta * beta
    x, y = alpha / square, -beta / square
    for i in range(n):
        u, v = defects[used + i], defects[2 * used + i]
        defects[used + i], defects[2 * used + i] = u * x - v * y, u * y + v * x
    for i in range(size):
        right[i], right[size + i] = defects[used + n + i], defects[2 * used + n + i]
    for k in range(run.entries.shape[0]):
        row, column = run.entries[k, 0], run.entries[k, 1]
        if column < n:
            right[row] += run.w[first + k] * defects[used + column]
            right[size + row] += run.w[first + k] * defects[2 * used + column]
    substitute_complex(run.matrix, run.pivots, right, size)
    for i in range(size):
        defects[used + n + i], defects[2 * used + n + i] = right[i], right[size + i]
    for i in range(n):
        u, v = right[i], right[size + i]
        defects[used + i] += u * x - v * y
        defects[2 * used + i] += u * y + v * x
