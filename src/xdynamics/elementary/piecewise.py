"""Look-up in piecewise polynomials, for any kind of number: cubic tables, and the past of a march.

A table has five rows: the origins of its pieces, and their coefficients from the cubic one down.

The past of a march has a polynomial in s for every accepted step. A piece is one step: its start, its length, the
number of its stretch between breaking points, then the coefficients of all components, power by power.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from xdynamics.elementary.numbers import Integer, Number, repeat_while, usually

Read = Callable[[int, Integer], Number]  # a number of the table: of a row and of a piece


def last_piece_begun(read: Read, count: Integer, x: Number) -> Integer:
    """Return the last of `count` pieces that begins at x or before; the first where none does."""

    def halve_range(low: Integer, high: Integer) -> tuple[Integer, Integer]:
        middle = (low + high + 1) >> 1
        # a branch: an argument that moves little from step to step is found the same way
        begins_before = read(0, middle) <= x
        return usually(begins_before, lambda: (middle, high), lambda: (low, middle - 1))  # type: ignore[no-any-return]

    # last - last is a zero of the kind that `last` is: a whole number, an array, a line of text
    last = count - 1
    return repeat_while(lambda low, high: low < high, halve_range, last - last, last)[0]


def find_piece(read: Read, count: Integer, x: Number) -> Integer:
    """Return the piece that applies from x on; the table's last point still belongs to its last inner piece."""
    at_end = read(0, count - 1) == x
    return usually(at_end, lambda: count - 2, lambda: last_piece_begun(read, count, x))


def value_at(read: Read, x: Number, piece: Integer) -> Number:
    """Return the value of a piece at x."""
    u, cubic, square, slope, value = _coefficients(read, x, piece)
    return ((cubic * u + square) * u + slope) * u + value


def slope_at(read: Read, x: Number, piece: Integer) -> Number:
    """Return the slope of a piece at x."""
    u, cubic, square, slope, _ = _coefficients(read, x, piece)
    return (cubic * 3.0 * u + square * 2.0) * u + slope


def bend_at(read: Read, x: Number, piece: Integer) -> Number:
    """Return half the second derivative of a piece at x."""
    u, cubic, square, _, _ = _coefficients(read, x, piece)
    return cubic * 3.0 * u + square


def cube_at(read: Read, x: Number, piece: Integer) -> Number:
    """Return a sixth of the third derivative of a piece, which is constant on it."""
    _, cubic, *_ = _coefficients(read, x, piece)
    return cubic


def _coefficients(read: Read, x: Number, piece: Integer) -> tuple[Number, ...]:
    return (x - read(0, piece), *(read(row, piece) for row in range(1, 5)))


def origin_of(read: Read, _x: Number, piece: Integer) -> Number:
    """Return where a piece begins."""
    return read(0, piece)


def _coefficient_of_row(row: int) -> Callable[[Read, Number, Integer], Number]:
    return lambda read, _x, piece: read(row, piece)


POLYNOMIALS: Mapping[str, Callable[[Read, Number, Integer], Number]] = {
    "value_at": value_at,
    "slope_at": slope_at,
    "bend_at": bend_at,
    "cube_at": cube_at,
    "origin_of": origin_of,
    "square_of": _coefficient_of_row(2),
    "slope_of": _coefficient_of_row(3),
    "value_of": _coefficient_of_row(4),
}


BEGIN, LENGTH, STRETCH = range(3)
HEAD = 3  # numbers before the coefficients


def width_of(components: int, degree: int) -> int:
    """Return how many numbers a piece has."""
    return HEAD + (degree + 1) * components


def past_at(read: Read, count: Integer, x: Number, component: int, components: int, degree: int) -> Number:
    """Return the value of a component at a time, of the last of `count` pieces that begins by then."""
    piece = last_piece_begun(read, count, x)
    s = (x - read(BEGIN, piece)) / read(LENGTH, piece)
    value = read(HEAD + degree * components + component, piece)
    for power in reversed(range(degree)):
        value = value * s + read(HEAD + power * components + component, piece)
    return value


def past_slope_at(read: Read, count: Integer, x: Number, component: int, components: int, degree: int) -> Number:
    """Return the time derivative of a component at a time, of the last of `count` pieces that begins by then."""
    piece = last_piece_begun(read, count, x)
    h = read(LENGTH, piece)
    s = (x - read(BEGIN, piece)) / h
    slope = read(HEAD + degree * components + component, piece) * float(degree)
    for power in reversed(range(1, degree)):
        slope = slope * s + read(HEAD + power * components + component, piece) * float(power)
    return slope / h


PAST: Mapping[str, Callable[..., Number]] = {"past_at": past_at, "past_slope_at": past_slope_at}
