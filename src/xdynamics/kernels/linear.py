"""Small linear systems in compiled code, without a library whose version or threads could change a bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import shared


@shared
def solve_linear(matrix: NDArray[np.float64], right: NDArray[np.float64], n: int) -> bool:
    """Solve in place by Gaussian elimination with partial pivoting.

    Parameters
    ----------
    matrix : ndarray, shape (n*n,) or longer
        Row by row; destroyed.
    right : ndarray, shape (n,) or longer
        The right-hand side; the solution takes its place.
    n : int

    Returns
    -------
    bool
        False where the matrix is singular or not finite; the right-hand side is then of no use.
    """
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i * n + k]) > abs(matrix[pivot * n + k]):
                pivot = i
        if not abs(matrix[pivot * n + k]) > 0.0 or not np.isfinite(matrix[pivot * n + k]):
            return False
        if pivot != k:
            for j in range(k, n):
                matrix[k * n + j], matrix[pivot * n + j] = matrix[pivot * n + j], matrix[k * n + j]
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(k + 1, n):
            factor = matrix[i * n + k] / matrix[k * n + k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i * n + j] -= factor * matrix[k * n + j]
                right[i] -= factor * right[k]
    for i in range(n - 1, -1, -1):
        for j in range(i + 1, n):
            right[i] -= matrix[i * n + j] * right[j]
        right[i] /= matrix[i * n + i]
    return True
