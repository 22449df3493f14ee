"""Operations on arrays by arithmetic that is the same on every machine.

numpy's logarithms and powers, and the products and solutions of BLAS and LAPACK, depend on the processor: their last
bits differ between machines. Everything that enters evidence is computed here.
"""

from __future__ import annotations

from math import prod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.sets import NAME, SETS

Floats = NDArray[np.float64]

FEW = 8  # numbers, up to which a function is applied to one after the other: the same bits, without arrays' overhead
PIECE = 1 << 15  # numbers, to which a function is applied at a time: it makes dozens of arrays on its way
DEPENDENT = 1e-14  # of a column: a smaller remainder beside the preceding columns counts as zero


def integral(y: Floats, t: Floats) -> Any:
    """Return the integral of straight lines through values, along their last dimension; numpy has it under two names."""
    return (np.diff(t) * (y[..., 1:] + y[..., :-1]) / 2.0).sum(axis=-1)


def log(x: Any) -> Floats:
    """Return natural logarithms: -inf at 0, nan below."""
    return apply_elementary("log", x)


def exp(x: Any) -> Floats:
    """Return powers of e."""
    return apply_elementary("exp", x)


def expm1(x: Any) -> Floats:
    """Return exp(x) - 1, accurate near 0 too: 2 sinh(x/2) exp(x/2)."""
    half = np.asarray(x, float) / 2.0
    return 2.0 * apply_elementary("sinh", half) * apply_elementary("exp", half)


def power(x: Any, y: Any) -> Floats:
    """Return x**y for non-negative x."""
    return apply_elementary("power", x, y)


def product(left: Floats, right: Floats) -> Floats:
    """Return the matrix product over the last two axes, summed from the first term on.

    Examples
    --------
    >>> product(np.eye(2), np.array([[1.0, 2.0], [3.0, 4.0]])).tolist()
    [[1.0, 2.0], [3.0, 4.0]]
    """
    shape = np.broadcast_shapes(left.shape[:-2], right.shape[:-2])
    total: Floats = np.zeros((*shape, left.shape[-2], right.shape[-1]))
    # outermost, so that every entry is summed in this order whichever way numpy goes over its arrays
    for k in range(left.shape[-1]):
        total += left[..., :, k : k + 1] * right[..., k : k + 1, :]
    return total


def dot(left: Floats, right: Floats) -> Floats:
    """Return the sum of products along the last axis, from the first term on.

    Examples
    --------
    >>> float(dot(np.array([1.0, 2.0]), np.array([3.0, 4.0])))
    11.0
    """
    total: Floats = product(np.asarray(left)[..., None, :], np.asarray(right)[..., :, None])[..., 0, 0]
    return total


def solve_systems(matrices: Floats, right: Floats) -> Floats:
    """Solve stacked linear systems by elimination with partial pivoting.

    Golub and Van Loan, Matrix Computations, 4th ed., section 3.4. Singular ones give inf or nan.

    Parameters
    ----------
    matrices : ndarray, shape (..., n, n)
    right : ndarray, shape (..., n, m)

    Examples
    --------
    >>> solve_systems(np.array([[0.0, 2.0], [1.0, 1.0]]), np.array([[4.0], [5.0]])).tolist()
    [[3.0], [2.0]]
    """
    n, shape = matrices.shape[-1], np.broadcast_shapes(matrices.shape[:-2], right.shape[:-2])
    augmented = np.concatenate(
        [np.broadcast_to(array, shape + array.shape[-2:]) for array in (matrices, right)], axis=-1
    )
    rows = augmented.reshape(-1, n, augmented.shape[-1])  # a view, but of a copy: `concatenate` made one
    systems = np.arange(len(rows))
    with np.errstate(all="ignore"):
        for k in range(n):
            best = k + np.argmax(np.abs(rows[:, k:, k]), axis=1)
            pivot_rows = rows[systems, best].copy()
            rows[systems, best] = rows[:, k]
            rows[:, k] = pivot_rows
            factors = rows[:, k + 1 :, k] / pivot_rows[:, None, k]
            rows[:, k + 1 :, k:] -= factors[:, :, None] * pivot_rows[:, None, k:]
        solution = rows[:, :, n:]
        for k in reversed(range(n)):
            solution[:, k] /= rows[:, k, k, None]
            solution[:, :k] -= rows[:, :k, k, None] * solution[:, k, None]
    return solution.reshape(*shape, n, right.shape[-1])


def least_squares(columns: Floats, values: Floats) -> Floats:
    """Return the least-squares coefficients of columns for given values, of one system or of stacked ones.

    Golub and Van Loan, Matrix Computations, 4th ed., section 5.2.8 (modified Gram-Schmidt), with the values as a last
    column, which preserves small residuals (Björck 1967, doi:10.1007/BF01934122). A column that depends linearly on
    those before it has the coefficient 0.

    Parameters
    ----------
    columns : ndarray, shape (..., n, m)
    values : ndarray, shape (..., n)

    Examples
    --------
    >>> least_squares(np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 2.0]]), np.array([1.0, 3.0, 5.0])).round(12).tolist()
    [1.0, 2.0]
    """
    m = columns.shape[-1]
    last = np.broadcast_to(values[..., None], (*columns.shape[:-1], 1))
    left, upper = np.concatenate([columns, last], axis=-1), np.zeros((*columns.shape[:-2], m, m + 1))
    sizes, coefficients = np.sqrt(np.sum(columns**2, axis=-2)), np.zeros((*columns.shape[:-2], m))
    with np.errstate(all="ignore"):
        for k in range(m):
            size = np.sqrt(np.sum(left[..., k] ** 2, axis=-1))
            independent = (size > DEPENDENT * sizes[..., k])[..., None]
            unit = left[..., k] / size[..., None]
            row = np.sum(unit[..., None] * left[..., k:], axis=-2)
            upper[..., k, k:] = np.where(independent, row, 0.0)
            remainder = left[..., k:] - unit[..., None] * row[..., None, :]
            left[..., k:] = np.where(independent[..., None], remainder, left[..., k:])
        for k in reversed(range(m)):
            solved_part = np.sum(upper[..., k, k + 1 : m] * coefficients[..., k + 1 :], axis=-1)
            quotient = (upper[..., k, m] - solved_part) / upper[..., k, k]
            coefficients[..., k] = np.where(upper[..., k, k] != 0.0, quotient, 0.0)
    return coefficients


def flattened_rows(values: NDArray[Any]) -> NDArray[Any]:
    """Return an array with all dimensions but the first as one, also one without rows, of which numpy infers no size.

    Examples
    --------
    >>> flattened_rows(np.zeros((0, 3, 2))).shape, flattened_rows(np.zeros(4)).shape
    ((0, 6), (4, 1))
    """
    return values.reshape(len(values), prod(values.shape[1:]))


def apply_elementary(name: str, *operands: Any, math_functions: str = NAME) -> Floats:
    """Apply an elementary function of a set to numbers or arrays that broadcast together."""
    arrays = np.broadcast_arrays(*(np.asarray(argument, float) for argument in operands))
    function, shape = SETS[math_functions][name], arrays[0].shape
    if arrays[0].size <= FEW:
        columns = (array.ravel().tolist() for array in arrays)
        return np.array([function(*numbers) for numbers in zip(*columns, strict=True)], float).reshape(shape)
    with np.errstate(all="ignore"):
        if arrays[0].size <= PIECE:
            return np.asarray(function(*arrays))
        values, flat = np.empty(arrays[0].size), [array.reshape(-1) for array in arrays]
        for first in range(0, values.size, PIECE):
            piece = slice(first, first + PIECE)
            values[piece] = function(*(array[piece] for array in flat))
    return values.reshape(shape)
