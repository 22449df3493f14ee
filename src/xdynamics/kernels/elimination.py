"""Small linear systems written out, for lanes whose pivots differ: the operations of `kernels.linear`, in their order.

Matrices are lists of columns. Where the single march skips an operation because a number is zero, a lane keeps its old
value: subtracting a zero can change the sign of a zero.
"""

from __future__ import annotations

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Operand

Columns = list[list[Operand]]


def factorise(lines: Assignments, m: Columns) -> tuple[list[Operand], Operand]:
    """Factorise a matrix as P L U in place; return the row exchanged with each, and whether the matrix is regular."""
    n, pivots = len(m), list[Operand]()
    sound: Operand = 1.0
    for k in range(n):
        sizes = [lines.compute("abs", entry) for entry in m[k]]
        filled = _filled_from(lines, sizes)
        pivot: Operand = float(k)
        size = sizes[k]
        for i in range(k + 1, n):
            larger = lines.compute("more", sizes[i], size)
            pivot = lines.compute("choose", larger, float(i), pivot)
            size = lines.compute("choose", larger, sizes[i], size)
        sound = _still(lines, sound, size)
        pivots.append(pivot)
        _exchange(lines, m, k, pivot)
        for i in range(k + 1, n):
            m[k][i] = lines.compute("choose", filled[i], lines.compute("divide", m[k][i], m[k][k]), m[k][i])
        for j in range(k + 1, n):
            nonzero = lines.compute("unequal", m[j][k], 0.0)
            for i in range(k + 1, n):
                reduced = lines.compute("subtract", m[j][i], lines.compute("multiply", m[j][k], m[k][i]))
                m[j][i] = _where_both(lines, nonzero, filled[i], reduced, m[j][i])
    return pivots, sound


def substitute(lines: Assignments, m: Columns, pivots: list[Operand], right: list[Operand]) -> None:
    """Solve with the factors of `factorise`; the solution replaces the right-hand side."""
    n = len(m)
    for k in range(n):
        _exchange(lines, [right], k, pivots[k])
    for k in range(n):
        filled = _filled_from(lines, m[k])
        for i in range(k + 1, n):
            reduced = lines.compute("subtract", right[i], lines.compute("multiply", right[k], m[k][i]))
            right[i] = lines.compute("choose", filled[i], reduced, right[i])
    for k in range(n - 1, -1, -1):
        right[k] = lines.compute("divide", right[k], m[k][k])
        filled = _filled_to(lines, m[k])
        for i in range(k):
            reduced = lines.compute("subtract", right[i], lines.compute("multiply", right[k], m[k][i]))
            right[i] = lines.compute("choose", filled[i], reduced, right[i])


def factorise_complex(lines: Assignments, re: Columns, im: Columns) -> tuple[list[Operand], Operand]:
    """Factorise a complex matrix as `factorise` does a real one; the diagonal of U is left inverted."""
    n, pivots = len(re), list[Operand]()
    sound: Operand = 1.0
    for k in range(n):
        sizes = _sizes(lines, re[k], im[k])
        filled = _filled_from(lines, sizes)
        pivot: Operand = float(k)
        size: Operand = -1.0
        for i in range(k, n):
            larger = lines.compute("more", sizes[i], size)
            pivot = lines.compute("choose", larger, float(i), pivot)
            size = lines.compute("choose", larger, sizes[i], size)
        sound = _still(lines, sound, size)
        pivots.append(pivot)
        _exchange(lines, re, k, pivot)
        _exchange(lines, im, k, pivot)
        x, y = lines.compute("divide", re[k][k], size), lines.compute("divide", im[k][k], size)
        squares = lines.compute("add", lines.compute("multiply", x, x), lines.compute("multiply", y, y))
        square = lines.compute("multiply", squares, size)
        x, y = lines.compute("divide", x, square), lines.compute("divide", lines.compute("negative", y), square)
        re[k][k], im[k][k] = x, y
        for i in range(k + 1, n):
            real, imaginary = _product(lines, re[k][i], im[k][i], x, y)
            re[k][i] = lines.compute("choose", filled[i], real, re[k][i])
            im[k][i] = lines.compute("choose", filled[i], imaginary, im[k][i])
        for j in range(k + 1, n):
            u, v = re[j][k], im[j][k]
            nonzero = lines.compute(
                "choose",
                lines.compute("unequal", u, 0.0),
                1.0,
                lines.compute("choose", lines.compute("unequal", v, 0.0), 1.0, 0.0),
            )
            nonzero = lines.compute("more", nonzero, 0.0)
            for i in range(k + 1, n):
                real, imaginary = _product(lines, u, v, re[k][i], im[k][i])
                reduced = lines.compute("subtract", re[j][i], real)
                re[j][i] = _where_both(lines, nonzero, filled[i], reduced, re[j][i])
                reduced = lines.compute("subtract", im[j][i], imaginary)
                im[j][i] = _where_both(lines, nonzero, filled[i], reduced, im[j][i])
    return pivots, sound


def substitute_complex(
    lines: Assignments, re: Columns, im: Columns, pivots: list[Operand], right: list[Operand], imaginary: list[Operand]
) -> None:
    """Solve with the factors of `factorise_complex`; the solution replaces both parts of the right-hand side."""
    n = len(re)
    for k in range(n):
        _exchange(lines, [right], k, pivots[k])
        _exchange(lines, [imaginary], k, pivots[k])
    for k in range(n):
        filled = _filled_from(lines, re[k], im[k])
        for i in range(k + 1, n):
            _take(lines, right, imaginary, k, i, re[k][i], im[k][i], filled[i])
    for k in range(n - 1, -1, -1):
        right[k], imaginary[k] = _product(lines, right[k], imaginary[k], re[k][k], im[k][k])
        filled = _filled_to(lines, re[k], im[k])
        for i in range(k):
            _take(lines, right, imaginary, k, i, re[k][i], im[k][i], filled[i])


def _take(
    lines: Assignments,
    right: list[Operand],
    imaginary: list[Operand],
    k: int,
    i: int,
    p: Operand,
    q: Operand,
    filled: Operand,
) -> None:
    """Subtract a multiple of the k-th unknown from the i-th equation."""
    real_part, imaginary_part = _product(lines, right[k], imaginary[k], p, q)
    right[i] = lines.compute("choose", filled, lines.compute("subtract", right[i], real_part), right[i])
    imaginary[i] = lines.compute(
        "choose", filled, lines.compute("subtract", imaginary[i], imaginary_part), imaginary[i]
    )


def _product(lines: Assignments, u: Operand, v: Operand, p: Operand, q: Operand) -> tuple[Operand, Operand]:
    """Multiply two complex numbers."""
    real = lines.compute("subtract", lines.compute("multiply", u, p), lines.compute("multiply", v, q))
    return real, lines.compute("add", lines.compute("multiply", u, q), lines.compute("multiply", v, p))


def _sizes(lines: Assignments, re: list[Operand], im: list[Operand]) -> list[Operand]:
    parts = zip(re, im, strict=True)
    return [lines.compute("add", lines.compute("abs", p), lines.compute("abs", q)) for p, q in parts]


def _still(lines: Assignments, sound: Operand, size: Operand) -> Operand:
    """Return whether the matrix was regular so far, and the pivot is positive and finite."""
    finite = lines.compute("equal", lines.compute("subtract", size, size), 0.0)
    regular = lines.compute("choose", lines.compute("more", size, 0.0), sound, 0.0)
    return lines.compute("choose", finite, regular, 0.0)


def _filled_from(lines: Assignments, *columns: list[Operand]) -> list[Operand]:
    """Return for each row whether it or a row below holds a nonzero number."""
    return _filled(lines, list(zip(*columns, strict=True))[::-1])[::-1]


def _filled_to(lines: Assignments, *columns: list[Operand]) -> list[Operand]:
    """Return for each row whether it or a row above holds a nonzero number."""
    return _filled(lines, list(zip(*columns, strict=True)))


def _filled(lines: Assignments, rows: list[tuple[Operand, ...]]) -> list[Operand]:
    filled: list[Operand] = []
    nonzero: Operand = 0.0
    for row in rows:
        for number in row:
            nonzero = lines.compute("choose", lines.compute("unequal", number, 0.0), 1.0, nonzero)
        filled.append(lines.compute("more", nonzero, 0.0))
    return filled


def _where_both(lines: Assignments, first: Operand, second: Operand, new: Operand, old: Operand) -> Operand:
    return lines.compute("choose", first, lines.compute("choose", second, new, old), old)


def _exchange(lines: Assignments, columns: Columns, k: int, pivot: Operand) -> None:
    """Exchange the k-th row with the pivot row of each lane."""
    for i in range(k + 1, len(columns[0])):
        chosen = lines.compute("equal", pivot, float(i))
        for column in columns:
            upper, lower = column[k], column[i]
            column[k] = lines.compute("choose", chosen, lower, upper)
            column[i] = lines.compute("choose", chosen, upper, lower)
