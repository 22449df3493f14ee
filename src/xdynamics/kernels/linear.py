"""Small linear systems in compiled code, without a library whose version or threads could change a bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import compiled


@compiled
def solve_linear(matrix: NDArray[np.float64], right: NDArray[np.float64]) -> bool:
    """Solve in place by Gaussian elimination with partial pivoting.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        Destroyed.
    right : ndarray, shape (n,)
        The right-hand side; the solution takes its place.

    Returns
    -------
    bool
        False where the matrix is singular or not finite; the right-hand side is then of no use.
    """
    n = right.shape[0]
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i, k]) > abs(matrix[pivot, k]):
                pivot = i
        if not abs(matrix[pivot, k]) > 0.0 or not np.isfinite(matrix[pivot, k]):
            return False
        if pivot != k:
            for j in range(k, n):
                matrix[k, j], matrix[pivot, j] = matrix[pivot, j], matrix[k, j]
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, n):
            factor = matrix[i, k] / matrix[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                right[i] -= factor * right[k]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            right[i] -= matrix[i, j] * right[j]
        right[i] /= matrix[i, i]
    return True
