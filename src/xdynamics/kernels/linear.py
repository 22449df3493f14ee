"""Small linear systems in compiled code, without a library whose version or threads could change a bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import compiled, shared


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


@compiled
def factorise(matrix: NDArray[np.float64], pivots: NDArray[np.int64], n: int) -> bool:
    """Take a matrix apart as P L U in place, with partial pivoting; columns without a part in a row are left alone.

    Parameters
    ----------
    matrix : ndarray, shape (n*n,) or longer
        Column by column.
    pivots : ndarray of int, shape (n,) or longer
        Filled: the row exchanged with each.
    n : int

    Returns
    -------
    bool
        False where the matrix is singular or not finite.
    """
    for k in range(n):
        pivot, column = k, k * n
        for i in range(k + 1, n):
            if abs(matrix[column + i]) > abs(matrix[column + pivot]):
                pivot = i
        size = abs(matrix[column + pivot])
        if not size > 0.0 or not np.isfinite(size):
            return False
        pivots[k] = pivot
        if pivot != k:
            for j in range(n):
                matrix[j * n + k], matrix[j * n + pivot] = matrix[j * n + pivot], matrix[j * n + k]
        for i in range(k + 1, n):
            matrix[column + i] /= matrix[column + k]
        for j in range(k + 1, n):
            factor = matrix[j * n + k]
            if factor != 0.0:
                for i in range(k + 1, n):
                    matrix[j * n + i] -= factor * matrix[column + i]
    return True


@compiled
def substitute(matrix: NDArray[np.float64], pivots: NDArray[np.int64], right: NDArray[np.float64], n: int) -> None:
    """Solve with the factors of `factorise`; the solution takes the place of the right-hand side."""
    for k in range(n):
        pivot = pivots[k]
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
    for k in range(n):
        factor = right[k]
        if factor != 0.0:
            for i in range(k + 1, n):
                right[i] -= factor * matrix[k * n + i]
    for k in range(n - 1, -1, -1):
        right[k] /= matrix[k * n + k]
        factor = right[k]
        if factor != 0.0:
            for i in range(k):
                right[i] -= factor * matrix[k * n + i]


@compiled
def factorise_complex(matrix: NDArray[np.float64], pivots: NDArray[np.int64], n: int) -> bool:
    """Do what `factorise` does for a complex matrix behind a real one; the diagonal of U is left inverted.

    Parameters
    ----------
    matrix : ndarray, shape (3*n*n,) or longer
        From n*n on the real parts, from 2*n*n on the imaginary ones, each column by column.
    pivots : ndarray of int, shape (2*n,) or longer
        Filled from n on.
    n : int

    Returns
    -------
    bool
        False where the matrix is singular or not finite.
    """
    re, im = n * n, 2 * n * n
    for k in range(n):
        pivot, column, size = k, k * n, -1.0
        for i in range(k, n):
            one = abs(matrix[re + column + i]) + abs(matrix[im + column + i])
            if one > size:
                pivot, size = i, one
        if not size > 0.0 or not np.isfinite(size):
            return False
        pivots[n + k] = pivot
        if pivot != k:
            for j in range(n):
                a, b = re + j * n, im + j * n
                matrix[a + k], matrix[a + pivot] = matrix[a + pivot], matrix[a + k]
                matrix[b + k], matrix[b + pivot] = matrix[b + pivot], matrix[b + k]
        # divided by their size first, so that the square neither overflows nor vanishes
        x, y = matrix[re + column + k] / size, matrix[im + column + k] / size
        square = (x * x + y * y) * size
        x, y = x / square, -y / square
        matrix[re + column + k], matrix[im + column + k] = x, y
        for i in range(k + 1, n):
            u, v = matrix[re + column + i], matrix[im + column + i]
            matrix[re + column + i], matrix[im + column + i] = u * x - v * y, u * y + v * x
        for j in range(k + 1, n):
            a, b = re + j * n, im + j * n
            u, v = matrix[a + k], matrix[b + k]
            if u != 0.0 or v != 0.0:
                for i in range(k + 1, n):
                    p, q = matrix[re + column + i], matrix[im + column + i]
                    matrix[a + i] -= u * p - v * q
                    matrix[b + i] -= u * q + v * p
    return True


@compiled
def substitute_complex(
    matrix: NDArray[np.float64], pivots: NDArray[np.int64], right: NDArray[np.float64], n: int
) -> None:
    """Solve with the factors of `factorise_complex`; of `right` the first n numbers are real, the next n imaginary."""
    re, im = n * n, 2 * n * n
    for k in range(n):
        pivot = pivots[n + k]
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
            right[n + k], right[n + pivot] = right[n + pivot], right[n + k]
    for k in range(n):
        u, v = right[k], right[n + k]
        if u != 0.0 or v != 0.0:
            for i in range(k + 1, n):
                p, q = matrix[re + k * n + i], matrix[im + k * n + i]
                right[i] -= u * p - v * q
                right[n + i] -= u * q + v * p
    for k in range(n - 1, -1, -1):
        x, y = matrix[re + k * n + k], matrix[im + k * n + k]
        u, v = right[k] * x - right[n + k] * y, right[k] * y + right[n + k] * x
        right[k], right[n + k] = u, v
        if u != 0.0 or v != 0.0:
            for i in range(k):
                p, q = matrix[re + k * n + i], matrix[im + k * n + i]
                right[i] -= u * p - v * q
                right[n + i] -= u * q + v * p
