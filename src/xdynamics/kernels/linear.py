"""Small linear systems, full and banded, in compiled code.

No library is called, whose version or threads could change a bit.

Band matrices are factored as LU with partial pivoting within the band, in the storage of LAPACK's gbtrf. A column has
`height` numbers: from `lower + upper` above the diagonal, where row exchanges fill, to `lower` below it. Entry (i, j)
is number `j*height + lower + upper + i - j`. As for full matrices a real matrix is one plane, a complex one two planes
after it, and the operations are those of full matrices, in their order, on entries of the band.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_inline, jit_separate

REAL, COMPLEX = np.int64(1), np.int64(2)  # no literals: numba compiles a copy of a function for each literal argument


@jit_separate
def solve_linear(matrix: NDArray[np.float64], right: NDArray[np.float64], n: int) -> bool:
    """Solve in place by Gaussian elimination with partial pivoting.

    Parameters
    ----------
    matrix : ndarray, shape (n*n,) or longer
        Row by row; destroyed.
    right : ndarray, shape (n,) or longer
        The right-hand side; the solution replaces it.
    n : int

    Returns
    -------
    bool
        False if the matrix is singular or not finite; the right-hand side is then invalid.
    """
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(matrix[i * n + k]) > abs(matrix[pivot * n + k]):
                pivot = i
        # negated, so that a nan is refused too
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


@jit_separate
def note_extents(matrix: NDArray[np.float64], pivots: NDArray[np.int64], n: int, planes: int) -> None:
    """Store the first and the last nonzero row of every column after the row exchanges; matrices of chains have few.

    A real matrix is one plane; a complex one is two planes after it, for the real and the imaginary parts.
    """
    extents_start = 3 * n * (planes - 1)
    for k in range(n):
        top, bottom = k, k
        for i in range(n):
            filled = False
            for plane in range(planes):
                filled = filled or matrix[(planes - 1 + plane) * n * n + k * n + i] != 0.0
            if filled:
                top, bottom = min(top, i), max(bottom, i)
        pivots[extents_start + n + k], pivots[extents_start + 2 * n + k] = top, bottom


@jit_inline
def factorise(matrix: NDArray[np.float64], pivots: NDArray[np.int64], n: int) -> bool:
    """Factorise a matrix as P L U in place, with partial pivoting.

    Parameters
    ----------
    matrix : ndarray, shape (n*n,) or longer
        Column by column.
    pivots : ndarray of int, shape (3*n,) or longer
        Filled with the row exchanged with each, and the first and the last nonzero row of each column.
    n : int

    Returns
    -------
    bool
        False if the matrix is singular or not finite.
    """
    for k in range(n):
        pivot, column, last = k, k * n, k
        for i in range(k + 1, n):
            size = abs(matrix[column + i])
            # below the last nonzero row all factors are zero: matrices of chains have few rows above it
            last = i if size != 0.0 else last
            pivot = i if size > abs(matrix[column + pivot]) else pivot
        size = abs(matrix[column + pivot])
        if not size > 0.0 or not np.isfinite(size):
            return False
        pivots[k] = pivot
        if pivot != k:
            for j in range(n):
                matrix[j * n + k], matrix[j * n + pivot] = matrix[j * n + pivot], matrix[j * n + k]
        for i in range(k + 1, last + 1):
            matrix[column + i] /= matrix[column + k]
        for j in range(k + 1, n):
            factor = matrix[j * n + k]
            if factor != 0.0:
                for i in range(k + 1, last + 1):
                    matrix[j * n + i] -= factor * matrix[column + i]
    note_extents(matrix, pivots, n, REAL)
    return True


@jit_inline
def substitute(matrix: NDArray[np.float64], pivots: NDArray[np.int64], right: NDArray[np.float64], n: int) -> None:
    """Solve with the factors of `factorise`; the solution replaces the right-hand side."""
    for k in range(n):
        pivot = pivots[k]
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
    for k in range(n):
        for i in range(k + 1, pivots[2 * n + k] + 1):
            right[i] -= right[k] * matrix[k * n + i]
    for k in range(n - 1, -1, -1):
        right[k] /= matrix[k * n + k]
        for i in range(pivots[n + k], k):
            right[i] -= right[k] * matrix[k * n + i]


@jit_inline
def factorise_complex(matrix: NDArray[np.float64], pivots: NDArray[np.int64], n: int) -> bool:
    """Factorise a complex matrix stored after a real one, as `factorise` does; the diagonal of U is left inverted.

    Parameters
    ----------
    matrix : ndarray, shape (3*n*n,) or longer
        From n*n on the real parts, from 2*n*n on the imaginary ones, each column by column.
    pivots : ndarray of int, shape (6*n,) or longer
        Filled from 3*n on.
    n : int

    Returns
    -------
    bool
        False if the matrix is singular or not finite.
    """
    re, im = n * n, 2 * n * n
    for k in range(n):
        pivot, column, size, last = k, k * n, -1.0, k
        for i in range(k, n):
            magnitude = abs(matrix[re + column + i]) + abs(matrix[im + column + i])
            last = i if magnitude != 0.0 else last
            pivot, size = (i, magnitude) if magnitude > size else (pivot, size)
        if not size > 0.0 or not np.isfinite(size):
            return False
        pivots[3 * n + k] = pivot
        if pivot != k:
            for j in range(n):
                a, b = re + j * n, im + j * n
                matrix[a + k], matrix[a + pivot] = matrix[a + pivot], matrix[a + k]
                matrix[b + k], matrix[b + pivot] = matrix[b + pivot], matrix[b + k]
        # divided by their size first, so that the square neither overflows nor underflows
        x, y = matrix[re + column + k] / size, matrix[im + column + k] / size
        square = (x * x + y * y) * size
        x, y = x / square, -y / square
        matrix[re + column + k], matrix[im + column + k] = x, y
        for i in range(k + 1, last + 1):
            u, v = matrix[re + column + i], matrix[im + column + i]
            matrix[re + column + i], matrix[im + column + i] = u * x - v * y, u * y + v * x
        for j in range(k + 1, n):
            a, b = re + j * n, im + j * n
            u, v = matrix[a + k], matrix[b + k]
            if u != 0.0 or v != 0.0:
                for i in range(k + 1, last + 1):
                    p, q = matrix[re + column + i], matrix[im + column + i]
                    matrix[a + i] -= u * p - v * q
                    matrix[b + i] -= u * q + v * p
    note_extents(matrix, pivots, n, COMPLEX)
    return True


@jit_inline
def substitute_complex(
    matrix: NDArray[np.float64], pivots: NDArray[np.int64], right: NDArray[np.float64], n: int
) -> None:
    """Solve with the factors of `factorise_complex`; `right` is n real parts followed by n imaginary ones."""
    re, im = n * n, 2 * n * n
    for k in range(n):
        pivot = pivots[3 * n + k]
        if pivot != k:
            right[k], right[pivot] = right[pivot], right[k]
            right[n + k], right[n + pivot] = right[n + pivot], right[n + k]
    for k in range(n):
        u, v = right[k], right[n + k]
        for i in range(k + 1, pivots[5 * n + k] + 1):
            p, q = matrix[re + k * n + i], matrix[im + k * n + i]
            right[i] -= u * p - v * q
            right[n + i] -= u * q + v * p
    for k in range(n - 1, -1, -1):
        x, y = matrix[re + k * n + k], matrix[im + k * n + k]
        u, v = right[k] * x - right[n + k] * y, right[k] * y + right[n + k] * x
        right[k], right[n + k] = u, v
        for i in range(pivots[4 * n + k], k):
            p, q = matrix[re + k * n + i], matrix[im + k * n + i]
            right[i] -= u * p - v * q
            right[n + i] -= u * q + v * p


Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


@jit_separate
def factorise_band(matrix: Floats, pivots: IntArray, n: int, lower: int, upper: int) -> bool:
    """Factorise a band matrix as P L U in place, with partial pivoting; row exchanges leave L unchanged.

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
        # the last column that row exchanges have filled so far, `ju` of LAPACK's dgbtf2
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
