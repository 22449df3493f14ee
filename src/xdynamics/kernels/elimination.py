"""Small linear systems written out, for lanes whose pivots differ: the operations of `kernels.linear`, in their order.

Matrices are lists of columns. Where the single march leaves something out because a number is zero, a lane keeps what it
had: to subtract a zero can change the sign of one.
"""

from __future__ import annotations

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Operand

Columns = list[list[Operand]]


def factorise(lines: Assignments, m: Columns) -> tuple[list[Operand], Operand]:
    """Take a matrix apart as P L U in place; return the row exchanged with each, and whether it is regular."""
    n, pivots = len(m), list[Operand]()
    sound: Operand = 1.0
    for k in range(n):
        sizes = [lines.compute("abs", one) for one in m[k]]
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
            there = lines.compute("unequal", m[j][k], 0.0)
            for i in range(k + 1, n):
                less = lines.compute("subtract", m[j][i], lines.compute("multiply", m[j][k], m[k][i]))
                m[j][i] = _where_both(lines, there, filled[i], less, m[j][i])
    return pivots, sound


def substitute(lines: Assignments, m: Columns, pivots: list[Operand], right: list[Operand]) -> None:
    """Solve with those factors; the solution takes the place of the right-hand side."""
    n = len(m)
    for k in range(n):
        _exchange(lines, [right], k, pivots[k])
    for k in range(n):
        filled = _filled_from(lines, m[k])
        for i in range(k + 1, n):
            less = lines.compute("subtract", right[i], lines.compute("multiply", right[k], m[k][i]))
            right[i] = lines.compute("choose", filled[i], less, right[i])
    for k in range(n - 1, -1, -1):
        right[k] = lines.compute("divide", right[k], m[k][k])
        filled = _filled_to(lines, m[k])
        for i in range(k):
            less = lines.compute("subtract", right[i], lines.compute("multiply", right[k], m[k][i]))
            right[i] = lines.compute("choose", filled[i], less, right[i])


def factorise_complex(lines: Assignments, re: Columns, im: Columns) -> tuple[list[Operand], Operand]:
    """Do what `factorise` does for a complex matrix; the diagonal of U is left inverted."""
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
            there = lines.compute("choose", lines.compute("unequal", u, 0.0), 1.0, lines.compute("choose", lines.compute("unequal", v, 0.0), 1.0, 0.0))  # fmt: skip
            there = lines.compute("more", there, 0.0)
            for i in range(k + 1, n):
                real, imaginary = _product(lines, u, v, re[k][i], im[k][i])
                less = lines.compute("subtract", re[j][i], real)
                re[j][i] = _where_both(lines, there, filled[i], less, re[j][i])
                less = lines.compute("subtract", im[j][i], imaginary)
                im[j][i] = _where_both(lines, there, filled[i], less, im[j][i])
    return pivots, sound


def substitute_complex(lines: Assignments, re: Columns, im: Columns, pivots: list[Operand], right: list[Operand], imaginary: list[Operand]) -> None:  # fmt: skip
    """Solve with those factors; both parts of the solution take the place of those of the right-hand side."""
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


def _take(lines: Assignments, right: list[Operand], imaginary: list[Operand], k: int, i: int, p: Operand, q: Operand, filled: Operand) -> None:  # fmt: skip
    """Take a multiple of the k-th unknown from the i-th equation."""
    real, other = _product(lines, right[k], imaginary[k], p, q)
    right[i] = lines.compute("choose", filled, lines.compute("subtract", right[i], real), right[i])
    imaginary[i] = lines.compute("choose", filled, lines.compute("subtract", imaginary[i], other), imaginary[i])


def _product(lines: Assignments, u: Operand, v: Operand, p: Operand, q: Operand) -> tuple[Operand, Operand]:
    """Multiply two complex numbers."""
    real = lines.compute("subtract", lines.compute("multiply", u, p), lines.compute("multiply", v, q))
    return real, lines.compute("add", lines.compute("multiply", u, q), lines.compute("multiply", v, p))


def _sizes(lines: Assignments, re: list[Operand], im: list[Operand]) -> list[Operand]:
    parts = zip(re, im, strict=True)
    return [lines.compute("add", lines.compute("abs", p), lines.compute("abs", q)) for p, q in parts]


def _still(lines: Assignments, sound: Operand, size: Operand) -> Operand:
    """Whether it was regular so far, and the pivot is positive and finite."""
    finite = lines.compute("equal", lines.compute("subtract", size, size), 0.0)
    regular = lines.compute("choose", lines.compute("more", size, 0.0), sound, 0.0)
    return lines.compute("choose", finite, regular, 0.0)


def _filled_from(lines: Assignments, *columns: list[Operand]) -> list[Operand]:
    """Tell of each row whether there is a number that is not zero in it or below."""
    return _filled(lines, list(zip(*columns, strict=True))[::-1])[::-1]


def _filled_to(lines: Assignments, *columns: list[Operand]) -> list[Operand]:
    """Tell of each row whether there is a number that is not zero in it or above."""
    return _filled(lines, list(zip(*columns, strict=True)))


def _filled(lines: Assignments, rows: list[tuple[Operand, ...]]) -> list[Operand]:
    found: list[Operand] = []
    some: Operand = 0.0
    for row in rows:
        for one in row:
            some = lines.compute("choose", lines.compute("unequal", one, 0.0), 1.0, some)
        found.append(lines.compute("more", some, 0.0))
    return found


def _where_both(lines: Assignments, one: Operand, other: Operand, new: Operand, old: Operand) -> Operand:
    return lines.compute("choose", one, lines.compute("choose", other, new, old), old)


def _exchange(lines: Assignments, columns: Columns, k: int, pivot: Operand) -> None:
    """Exchange the k-th row with the one that a lane chose."""
    for i in range(k + 1, len(columns[0])):
        here = lines.compute("equal", pivot, float(i))
        for column in columns:
            upper, lower = column[k], column[i]
            column[k] = lines.compute("choose", here, lower, upper)
            column[i] = lines.compute("choose", here, upper, lower)
