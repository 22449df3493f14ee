"""Small linear systems written out, for lanes whose pivots differ: the operations of `kernels.linear`, in their order.

Matrices are lists of columns; a number is its parts, one if it is real, two if it is complex. Where the single march
skips an operation because a number is zero, a lane keeps its old value: subtracting a zero can change the sign of a
zero.
"""

from __future__ import annotations

from collections.abc import Iterable

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Operand

Entry = tuple[Operand, ...]
Columns = list[list[Entry]]


def factorise_columns(lines: Assignments, m: Columns) -> tuple[list[Operand], Operand]:
    """Factorise a matrix as P L U in place; return the row exchanged with each, and whether the matrix is regular.

    The diagonal of a complex U is left inverted.
    """
    n, pivots = len(m), list[Operand]()
    sound: Operand = 1.0
    for k in range(n):
        pivot, size = _pivot_of_column(lines, m[k], k)
        filled = _nonzero_prefixes(lines, m[k][::-1])[::-1]
        sound = _is_regular(lines, sound, size)
        pivots.append(pivot)
        _exchange_rows(lines, m, k, pivot)
        m[k][k] = _pivoted(lines, m[k][k], size)
        for i in range(k + 1, n):
            m[k][i] = _select_entry(lines, [filled[i]], _divide_by_pivot(lines, m[k][i], m[k][k]), m[k][i])
        for j in range(k + 1, n):
            nonzero = _nonzero_prefixes(lines, [m[j][k]])
            for i in range(k + 1, n):
                reduced = _less_product(lines, m[j][i], m[j][k], m[k][i])
                m[j][i] = _select_entry(lines, [*nonzero, filled[i]], reduced, m[j][i])
    return pivots, sound


def substitute_columns(lines: Assignments, m: Columns, pivots: list[Operand], right: list[Entry]) -> None:
    """Solve with the factors of `factorise_columns`; the solution replaces the right-hand side."""
    n = len(m)
    for k in range(n):
        _exchange_rows(lines, [right], k, pivots[k])
    for k in range(n):
        filled = _nonzero_prefixes(lines, m[k][::-1])[::-1]
        for i in range(k + 1, n):
            right[i] = _select_entry(lines, [filled[i]], _less_product(lines, right[i], right[k], m[k][i]), right[i])
    for k in range(n - 1, -1, -1):
        right[k] = _divide_by_pivot(lines, right[k], m[k][k])
        filled = _nonzero_prefixes(lines, m[k])
        for i in range(k):
            right[i] = _select_entry(lines, [filled[i]], _less_product(lines, right[i], right[k], m[k][i]), right[i])


def _pivot_of_column(lines: Assignments, column: list[Entry], first: int) -> tuple[Operand, Operand]:
    """Return the row of the largest number of a column, and its size."""
    pivot: Operand = float(first)
    size: Operand = -1.0
    for i, entry in enumerate(column[first:], first):
        magnitude = lines.compute("abs", entry[0])
        for part in entry[1:]:
            magnitude = lines.compute("add", magnitude, lines.compute("abs", part))
        larger = lines.compute("more", magnitude, size)
        pivot = lines.compute("choose", larger, float(i), pivot)
        size = lines.compute("choose", larger, magnitude, size)
    return pivot, size


def _pivoted(lines: Assignments, pivot: Entry, size: Operand) -> Entry:
    """Return what a pivot is kept as: a complex one inverted, over its size first, which neither over- nor underflows."""
    if len(pivot) == 1:
        return pivot
    x, y = (lines.compute("divide", part, size) for part in pivot)
    squares = lines.compute("add", lines.compute("multiply", x, x), lines.compute("multiply", y, y))
    square = lines.compute("multiply", squares, size)
    return lines.compute("divide", x, square), lines.compute("divide", lines.compute("negative", y), square)


def _divide_by_pivot(lines: Assignments, number: Entry, pivot: Entry) -> Entry:
    """Return a number over a pivot as it is kept."""
    return (lines.compute("divide", *number, *pivot),) if len(pivot) == 1 else _entry_product(lines, number, pivot)


def _entry_product(lines: Assignments, x: Entry, y: Entry) -> Entry:
    if len(x) == 1:
        return (lines.compute("multiply", *x, *y),)
    (u, v), (p, q) = x, y
    real = lines.compute("subtract", lines.compute("multiply", u, p), lines.compute("multiply", v, q))
    return real, lines.compute("add", lines.compute("multiply", u, q), lines.compute("multiply", v, p))


def _less_product(lines: Assignments, number: Entry, x: Entry, y: Entry) -> Entry:
    """Return a number less a product."""
    return tuple(
        lines.compute("subtract", part, product_part)
        for part, product_part in zip(number, _entry_product(lines, x, y), strict=True)
    )


def _is_regular(lines: Assignments, sound: Operand, size: Operand) -> Operand:
    """Return whether the matrix was regular so far, and the pivot is positive and finite."""
    finite = lines.compute("equal", lines.compute("subtract", size, size), 0.0)
    regular = lines.compute("choose", lines.compute("more", size, 0.0), sound, 0.0)
    return lines.compute("choose", finite, regular, 0.0)


def _nonzero_prefixes(lines: Assignments, entries: Iterable[Entry]) -> list[Operand]:
    """Return for each number whether it or one before it is not zero."""
    filled: list[Operand] = []
    nonzero: Operand = 0.0
    for entry in entries:
        for part in entry:
            nonzero = lines.compute("choose", lines.compute("unequal", part, 0.0), 1.0, nonzero)
        filled.append(lines.compute("more", nonzero, 0.0))
    return filled


def _select_entry(lines: Assignments, conditions: list[Operand], new: Entry, old: Entry) -> Entry:
    """Return a new number where all conditions hold, else the old one."""
    for condition in conditions[::-1]:
        new = tuple(lines.compute("choose", condition, part, old_part) for part, old_part in zip(new, old, strict=True))
    return new


def _exchange_rows(lines: Assignments, columns: Columns, k: int, pivot: Operand) -> None:
    """Exchange the k-th row with the pivot row of each lane."""
    for i in range(k + 1, len(columns[0])):
        row_conditions = [lines.compute("equal", pivot, float(i))]
        for column in columns:
            upper, lower = column[k], column[i]
            column[k], column[i] = (
                _select_entry(lines, row_conditions, lower, upper),
                _select_entry(lines, row_conditions, upper, lower),
            )
