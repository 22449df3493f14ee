"""Linear systems of band matrices in compiled code: LU with partial pivoting within the band, as LAPACK's gbtrf keeps it.

A column has `height` numbers: from `lower + upper` above the diagonal, where row exchanges fill, to `lower` below it.
Entry (i, j) is number `j*height + lower + upper + i - j`. As in `kernels.linear` a real matrix is one plane, a complex
one two planes after it, and the operations are those of that module, in their order, on entries of the band.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_separate

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


@jit_separate
def factorise_band(matrix: Floats, pivots: IntArray, n: int, lower: int, upper: int) -> bool:
    """Factorise a band matrix as P L U in place, with partial pivoting; row exchanges leave L as it is.

    Parameters
    ----------
    matrix : ndarray, shape (n*(2*lower + upper + 1),) or longer
        Column by column, zero where row exchanges may fill.
    pivots : ndarray of int, shape (n,) or longer
        Filled with the row exchanged with each.
    n, lower, upper : int

    Returns
    -------
    bool
        False if the matrix is singular or not finite.
    """
    height, diagonal, reach = 2 * lower + upper + 1, lower + upper, 0
    for k in range(n):
        column, last, pivot = k * height + diagonal, min(lower, n - 1 - k), 0
        for i in range(1, last + 1):
            pivot = i if abs(matrix[column + i]) > abs(matrix[column + pivot]) else pivot
        size = abs(matrix[column + pivot])
        if not size > 0.0 or not np.isfinite(size):
            return False
        pivots[k] = k + pivot
        reach = max(reach, min(k + upper + pivot, n - 1))
        if pivot != 0:
            for j in range(k, reach + 1):
                a = j * height + diagonal + k - j
                matrix[a], matrix[a + pivot] = matrix[a + pivot], matrix[a]
        for i in range(1, last + 1):
            matrix[column + i] /= matrix[column]
        for j in range(k + 1, reach + 1):
            a = j * height + diagonal + k - j
            factor = matrix[a]
            if factor != 0.0:
                for i in range(1, last + 1):
                    matrix[a + i] -= factor * matrix[column + i]
    return True


@jit_separate
def substitute_band(matrix: Floats, pivots: IntArray, right: Floats, n: int, lower: int, upper: int) -> None:
    """Solve with the factors of `factorise_band`; the solution replaces the right-hand side."""
    height, diagonal = 2 * lower + upper + 1, lower + upper
    for k in range(n):
        pivot, column = pivots[k], k * height + diagonal
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
        for i in range(1, min(lower, n - 1 - k) + 1):
            right[k + i] -= right[k] * matrix[column + i]
    for k in range(n - 1, -1, -1):
        column = k * height + diagonal
        right[k] /= matrix[column]
        for i in range(1, min(diagonal, k) + 1):
            right[k - i] -= right[k] * matrix[column - i]


@jit_separate
def factorise_complex_band(matrix: Floats, pivots: IntArray, n: int, lower: int, upper: int) -> bool:
    """Factorise a complex band matrix stored after a real one; the diagonal of U is left inverted.

    Parameters
    ----------
    matrix : ndarray, shape (3*n*(2*lower + upper + 1),) or longer
        The second third has the real parts, the last one the imaginary ones.
    pivots : ndarray of int, shape (6*n,) or longer
        Filled from 3*n on.
    n, lower, upper : int

    Returns
    -------
    bool
        False if the matrix is singular or not finite.
    """
    height, diagonal, reach = 2 * lower + upper + 1, lower + upper, 0
    re, im = n * height + diagonal, 2 * n * height + diagonal
    for k in range(n):
        column, last, pivot, size = k * height, min(lower, n - 1 - k), 0, -1.0
        for i in range(last + 1):
            magnitude = abs(matrix[re + column + i]) + abs(matrix[im + column + i])
            pivot, size = (i, magnitude) if magnitude > size else (pivot, size)
        if not size > 0.0 or not np.isfinite(size):
            return False
        pivots[3 * n + k] = k + pivot
        reach = max(reach, min(k + upper + pivot, n - 1))
        if pivot != 0:
            for j in range(k, reach + 1):
                a, b = re + j * height + k - j, im + j * height + k - j
                matrix[a], matrix[a + pivot] = matrix[a + pivot], matrix[a]
                matrix[b], matrix[b + pivot] = matrix[b + pivot], matrix[b]
        # divided by their size first, so that the square neither overflows nor underflows
        x, y = matrix[re + column] / size, matrix[im + column] / size
        square = (x * x + y * y) * size
        x, y = x / square, -y / square
        matrix[re + column], matrix[im + column] = x, y
        for i in range(1, last + 1):
            u, v = matrix[re + column + i], matrix[im + column + i]
            matrix[re + column + i], matrix[im + column + i] = u * x - v * y, u * y + v * x
        for j in range(k + 1, reach + 1):
            a, b = re + j * height + k - j, im + j * height + k - j
            u, v = matrix[a], matrix[b]
            if u != 0.0 or v != 0.0:
                for i in range(1, last + 1):
                    p, q = matrix[re + column + i], matrix[im + column + i]
                    matrix[a + i] -= u * p - v * q
                    matrix[b + i] -= u * q + v * p
    return True


@jit_separate
def substitute_complex_band(matrix: Floats, pivots: IntArray, right: Floats, n: int, lower: int, upper: int) -> None:
    """Solve with the factors of `factorise_complex_band`; `right` is n real parts followed by n imaginary ones."""
    height, diagonal = 2 * lower + upper + 1, lower + upper
    re, im = n * height + diagonal, 2 * n * height + diagonal
    for k in range(n):
        pivot, column = pivots[3 * n + k], k * height
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
            right[n + k], right[n + pivot] = right[n + pivot], right[n + k]
        u, v = right[k], right[n + k]
        for i in range(1, min(lower, n - 1 - k) + 1):
            p, q = matrix[re + column + i], matrix[im + column + i]
            right[k + i] -= u * p - v * q
            right[n + k + i] -= u * q + v * p
    for k in range(n - 1, -1, -1):
        column = k * height
        x, y = matrix[re + column], matrix[im + column]
        u, v = right[k] * x - right[n + k] * y, right[k] * y + right[n + k] * x
        right[k], right[n + k] = u, v
        for i in range(1, min(diagonal, k) + 1):
            p, q = matrix[re + column - i], matrix[im + column - i]
            right[k - i] -= u * p - v * q
            right[n + k - i] -= u * q + v * p
