"""Two bounds of a value, and what rounds them outward."""

from __future__ import annotations

from math import inf
from typing import NamedTuple

from xdynamics.elementary.numbers import Number, Whole, absolute, choose
from xdynamics.elementary.rounding_margins import EPS, MOST, SMOOTH, UNBOUNDED


class Interval(NamedTuple):
    """A value between two bounds, and its flaw: whether it may jump there, or be infinite or undefined."""

    low: Number
    high: Number
    flaw: Whole = SMOOTH


def below(x: Number, margin: Number) -> Number:
    """Return a number below x; -inf where x is."""
    return choose(x == inf, MOST, x - (absolute(x) + margin) * EPS)


def above(x: Number, margin: Number) -> Number:
    """Return a number above x; inf where x is."""
    return choose(x == -inf, -MOST, x + (absolute(x) + margin) * EPS)


def least(x: Number, *others: Number) -> Number:
    """Return the least of some numbers, two at a time; where one is nan, as Python's `min` does."""
    if not others:
        return x
    if len(others) > 1:
        return least(least(x, others[0]), least(*others[1:]))
    return choose(others[0] < x, others[0], x)


def greatest(x: Number, *others: Number) -> Number:
    """Return the greatest of some numbers, two at a time; where one is nan, as Python's `max` does."""
    if not others:
        return x
    if len(others) > 1:
        return greatest(greatest(x, others[0]), greatest(*others[1:]))
    return choose(others[0] > x, others[0], x)


def settled(low: Number, high: Number, flaw: Whole) -> Interval:
    """Return an interval; what is none may be anything."""
    sound = low <= high
    return Interval(choose(sound, low, -inf), choose(sound, high, inf), choose(sound, flaw, UNBOUNDED))


def outward(low: Number, high: Number, margin: Number, flaw: Whole = SMOOTH) -> Interval:
    """Return the interval between two bounds, rounded outward."""
    return settled(below(low, margin), above(high, margin), flaw)
