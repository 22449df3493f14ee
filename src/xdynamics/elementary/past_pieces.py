"""Look-up in the past of a march, as functions of any kind of number: a polynomial in s of every accepted step.

A piece is one step: where it begins, its length, the number of the stretch between breaking points that it is in, then
the coefficients of all components, power by power.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from xdynamics.elementary.numbers import Integer, Number
from xdynamics.elementary.piecewise import Read, last_piece_begun

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
    """Return the time derivative of a component at a time, in the same way."""
    piece = last_piece_begun(read, count, x)
    h = read(LENGTH, piece)
    s = (x - read(BEGIN, piece)) / h
    slope = read(HEAD + degree * components + component, piece) * float(degree)
    for power in reversed(range(1, degree)):
        slope = slope * s + read(HEAD + power * components + component, piece) * float(power)
    return slope / h


PAST: Mapping[str, Callable[..., Number]] = {"past_at": past_at, "past_slope_at": past_slope_at}
