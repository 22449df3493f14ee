"""Two bounds of a value, and what rounds them outward."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from xdynamics.elementary.numbers import Integer, Number, absolute, choose
from xdynamics.elementary.rounding_margins import EPS, MOST, SMOOTH, UNBOUNDED


class Interval(NamedTuple):
    """A value between two bounds, and its flaw: whether it may jump there, or be infinite or undefined."""

    low: Number
    high: Number
    flaw: Integer = SMOOTH


def below(x: Number, margin: Number) -> Number:
    """Return a number below x; -inf where x is."""
    return choose(x == inf, MOST, x - (absolute(x) + margin) * EPS)


def above(x: Number, margin: Number) -> Number:
    """Return a number above x; inf where x is."""
    return choose(x == -inf, -MOST, x + (absolute(x) + margin) * EPS)


def minimum(x: Number, *further_numbers: Number) -> Number:
    """Return the least of some numbers, two at a time; where one is nan, as Python's `min` does."""
    if not further_numbers:
        return x
    if len(further_numbers) > 1:
        return minimum(minimum(x, further_numbers[0]), minimum(*further_numbers[1:]))
    return choose(further_numbers[0] < x, further_numbers[0], x)


def maximum(x: Number, *further_numbers: Number) -> Number:
    """Return the greatest of some numbers, two at a time; where one is nan, as Python's `max` does."""
    if not further_numbers:
        return x
    if len(further_numbers) > 1:
        return maximum(maximum(x, further_numbers[0]), maximum(*further_numbers[1:]))
    return choose(further_numbers[0] > x, further_numbers[0], x)


def sound_interval(low: Number, high: Number, flaw: Integer) -> Interval:
    """Return an interval; what is none may be anything."""
    sound = low <= high
    return Interval(choose(sound, low, -inf), choose(sound, high, inf), choose(sound, flaw, UNBOUNDED))


def rounded_outward(low: Number, high: Number, margin: Number, flaw: Integer = SMOOTH) -> Interval:
    """Return the interval between two bounds, rounded outward."""
    return sound_interval(below(low, margin), above(high, margin), flaw)
