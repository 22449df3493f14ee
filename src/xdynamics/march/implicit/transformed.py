"""Linear systems of Radau IIA in transformed variables: gamma/h - J and (alpha + i beta)/h - J.

In both, the coordinates are eliminated by their rows c dq - dv = r, so that only velocities and first-order states are
factorised (Hairer, Wanner, Solving ODEs II, 2nd ed., section IV.8).
"""

from __future__ import annotations

from xdynamics.kernels.band import factorise_band, factorise_complex_band, substitute_band, substitute_complex_band
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.linear import factorise, factorise_complex, substitute, substitute_complex
from xdynamics.march.force_evaluation import State
from xdynamics.march.implicit.derivatives import column_height, matrix_index
from xdynamics.march.run import Run
from xdynamics.methods.radau import ALPHA, BETA, GAMMA


@jit_separate
def factorise_both(run: Run, h: float) -> bool:
    """Assemble the real and the complex matrix for a step size, and factorise them; False if one is singular."""
    n, first, matrix = run.plan[0].coordinates, 3 * run.plan[0].used, run.matrix
    size = run.plan[0].used - n
    gamma, alpha, beta = GAMMA / h, ALPHA / h, BETA / h
    square = alpha * alpha + beta * beta
    plane = size * column_height(run)
    for i in range(3 * plane):
        matrix[i] = 0.0
    re, im = plane, 2 * plane
    for i in range(size):
        diagonal = matrix_index(run, i, i)
        matrix[diagonal], matrix[re + diagonal], matrix[im + diagonal] = gamma, alpha, beta
    for k in range(run.entries.shape[0]):
        row, column, slope = run.entries[k, 0], run.entries[k, 1], run.w[first + k]
        if column < n:  # dq = dv/c, and 1/(alpha + i beta) is (alpha - i beta)/square
            entry_index = matrix_index(run, row, column)
            matrix[entry_index] -= slope / gamma
            matrix[re + entry_index] -= slope * (alpha / square)
            matrix[im + entry_index] += slope * (beta / square)
        else:
            entry_index = matrix_index(run, row, column - n)
            matrix[entry_index] -= slope
            matrix[re + entry_index] -= slope
    run.kept[0].factored = 0.0
    if not (factorised_in_band(run, size) if run.band.shape[0] > 0 else factorised_whole(run, size)):
        return False
    run.kept[0].factored = h
    run.now[0].factorisations += 1
    return True


@jit_separate
def factorised_whole(run: Run, size: int) -> bool:
    """Factorise both matrices, kept whole."""
    return factorise(run.matrix, run.pivots, size) and factorise_complex(run.matrix, run.pivots, size)


@jit_separate
def factorised_in_band(run: Run, size: int) -> bool:
    """Factorise both matrices, kept as bands."""
    lower, upper = run.band[0], run.band[1]
    real = factorise_band(run.matrix, run.pivots, size, lower, upper)
    return real and factorise_complex_band(run.matrix, run.pivots, size, lower, upper)


@jit_separate
def solve_real_system(run: Run, vector: State) -> None:
    """Solve (gamma/h - J) d = r in place, with the factors at hand."""
    n, used, first, right = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.right
    gamma = GAMMA / run.kept[0].factored
    for i in range(n, used):
        right[run.order[i - n]] = vector[i]
    for k in range(run.entries.shape[0]):
        column = run.entries[k, 1]
        if column < n:
            right[run.order[run.entries[k, 0]]] += run.w[first + k] * (vector[column] / gamma)
    if run.band.shape[0] > 0:
        substitute_band(run.matrix, run.pivots, right, used - n, run.band[0], run.band[1])
    else:
        substitute(run.matrix, run.pivots, right, used - n)
    for i in range(n, used):
        vector[i] = right[run.order[i - n]]
    for i in range(n):
        vector[i] = (vector[i] + vector[n + i]) / gamma


@jit_separate
def solve_complex_system(run: Run, vectors: State) -> None:
    """Solve ((alpha + i beta)/h - J) d = r in place, for the second and the third part of three vectors."""
    n, used, first, right = run.plan[0].coordinates, run.plan[0].used, 3 * run.plan[0].used, run.right
    size = used - n
    alpha, beta = ALPHA / run.kept[0].factored, BETA / run.kept[0].factored
    square = alpha * alpha + beta * beta
    x, y = alpha / square, -beta / square
    for i in range(n):
        u, v = vectors[used + i], vectors[2 * used + i]
        vectors[used + i], vectors[2 * used + i] = u * x - v * y, u * y + v * x
    for i in range(size):
        ordered_index = run.order[i]
        right[ordered_index], right[size + ordered_index] = vectors[used + n + i], vectors[2 * used + n + i]
    for k in range(run.entries.shape[0]):
        row, column = run.order[run.entries[k, 0]], run.entries[k, 1]
        if column < n:
            right[row] += run.w[first + k] * vectors[used + column]
            right[size + row] += run.w[first + k] * vectors[2 * used + column]
    if run.band.shape[0] > 0:
        substitute_complex_band(run.matrix, run.pivots, right, size, run.band[0], run.band[1])
    else:
        substitute_complex(run.matrix, run.pivots, right, size)
    for i in range(size):
        ordered_index = run.order[i]
        vectors[used + n + i], vectors[2 * used + n + i] = right[ordered_index], right[size + ordered_index]
    for i in range(n):
        u, v = right[run.order[i]], right[size + run.order[i]]
        vectors[used + i] += u * x - v * y
        vectors[2 * used + i] += u * y + v * x
