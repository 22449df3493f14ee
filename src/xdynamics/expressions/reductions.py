"""Sums, extremes and products of traced rows: what makes one number of many, and matrices."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions.real_numbers import real
from xdynamics.expressions.traced_grid import ZERO, Floats, IrregularError, element, varies
from xdynamics.expressions.traced_rows import Line, combined, of_ufunc
from xdynamics.expressions.tracing import Traced, choice
from xdynamics.expressions.tree import Along, Call, Compare

MOST_DIAGONALS = 12  # of a matrix, each a row of numbers
LARGEST_DENSE = 200  # rows of a matrix with more


def reduced(function: str, row: Line, axis: Any = None, **options: Any) -> Traced:
    """Return the sum, the largest or the smallest element of a row.

    Raises
    ------
    IrregularError
        If it is asked for along another axis, or with options.
    """
    if axis not in (None, 0, -1) or options:
        raise IrregularError(f"the function takes the {function} of a row with {options or axis}")
    grid, inside = row.grid, row.value
    index = Traced(Along("index", (), (grid.dim,)))
    outside: Any = 0.0 if function == "sum" else Traced(element(row.value.node, row.offset, grid))
    for within in row.limits():
        inside = choice(within, inside, outside)
    last = row.last + 1
    if last < grid.size:
        inside = choice(index < last, inside, outside)
    if row.offset:
        inside = choice(index < row.offset, outside, inside)
    if not varies(inside.node, grid):
        return inside * row.size if function == "sum" else inside
    return Traced(Along(function, (inside.node,), (grid.dim,)), inside.nodes + 1)


def product(left: Any, right: Any) -> Any:
    """Return the product of two rows, or of a matrix of numbers and a row: by its diagonals if these are few.

    Raises
    ------
    IrregularError
        If the other factor is no square matrix of numbers.
    """
    if not isinstance(right, Line) and isinstance(left, Line) and np.ndim(right) == 2:
        left, right = np.asarray(right).T, left
    if isinstance(left, Line) or np.ndim(left) == 1:
        row = left if isinstance(left, Line) else right
        return reduced("sum", combined(partial(of_ufunc, "multiply"), left, right) if row.size > 1 else row)
    matrix = left.toarray() if hasattr(left, "toarray") else np.asarray(left)
    if matrix.dtype == object or matrix.shape != (right.size, right.size):
        raise IrregularError("the function multiplies a row by an array that is no square matrix of numbers")
    matrix = real(matrix).astype(float)
    n = right.size
    diagonals = [k for k in range(1 - n, n) if np.diagonal(matrix, k).any()]
    if len(diagonals) > MOST_DIAGONALS or n <= 2:
        return _dense(matrix, right)
    total: Any = right.of(Traced(ZERO), n, right.offset)
    for k in diagonals:
        # element i takes matrix[i, i + k] times element i + k
        first, numbers = max(0, -k), np.diagonal(matrix, k)
        part = right.of(Traced(ZERO), n, right.offset)
        part[first : first + n - abs(k)] = numbers * right[first + k : first + k + n - abs(k)]
        total = part if total.value.node == ZERO else total + part
    return total


def _dense(matrix: Floats, row: Line) -> Line:
    """Multiply by a whole matrix: sums along the row belong to a second dimension, from which they are put back."""
    grid = row.grid
    if row.size > LARGEST_DENSE or row.size != grid.size:
        raise IrregularError(f"the function multiplies a row by a matrix of {matrix.shape}")
    entries = Traced(grid.constant(matrix, 0))
    sums = Along("sum", ((entries * row.value).node,), (grid.dim,))
    here = Compare("==", Along("index", (), (grid.other,)), Along("index", (), (grid.dim,)))
    return row.of(Traced(Along("sum", (Call("where", (here, sums, ZERO)),), (grid.other,))), row.size)
