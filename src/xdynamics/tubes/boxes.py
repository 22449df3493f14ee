"""Boxes: arrays of intervals whose first index tells lower ends from upper ones, with every operation rounded outward.

What IEEE 754 rounds to nearest lies next to the exact result or is it; one float further out is a bound of it, also where
a product underflows (Moore, Kearfott, Cloud, Introduction to Interval Analysis, 2009, section 3.2). An infinite or
undefined end stays one, and is refused where a proof would follow from it.
"""

from __future__ import annotations

from fractions import Fraction
from math import inf, nextafter

import numpy as np
from numpy.typing import NDArray

Box = NDArray[np.float64]  # shape (2, ...)
Floats = NDArray[np.float64]

EPS = 2.0**-52
_SIDES = [np.array([-1.0, 1.0]).reshape(2, *(1,) * n) for n in range(8)]
_TOWARDS = [np.array([-inf, inf]).reshape(2, *(1,) * n) for n in range(8)]


def round_outward(ends: Box) -> Box:
    """Return the next floats outside."""
    wider_ends: Box = np.nextafter(ends, _TOWARDS[ends.ndim - 1])
    return wider_ends


def point_box(values: Floats | float) -> Box:
    """Return intervals that are numbers."""
    numbers = np.asarray(values, float)
    intervals = np.empty((2, *numbers.shape))
    intervals[...] = numbers
    return intervals


def enclosed(exact: Fraction, half_width: Fraction = Fraction(0)) -> Box:
    """Return the interval of an exact number, or from one half width below it to one above."""
    ends = []
    for number, towards in ((exact - half_width, -inf), (exact + half_width, inf)):
        nearest = float(number)
        beyond = Fraction(nearest) > number if towards < 0 else Fraction(nearest) < number
        ends.append(float(np.nextafter(nearest, towards)) if beyond else nearest)
    return np.array(ends)


def add(a: Box, b: Box) -> Box:
    """Add."""
    return round_outward(a + b)


def subtract(a: Box, b: Box) -> Box:
    """Subtract."""
    return round_outward(a - b[::-1])


def negative(a: Box) -> Box:
    """Return the interval of opposite sign, which is exact."""
    return -a[::-1]


def multiply(a: Box, b: Box) -> Box:
    """Multiply: the ends are among the products of ends."""
    return _outermost(a[:, None] * b[None])


def _outermost(ends: Box) -> Box:
    """Return the interval of four numbers, rounded outward."""
    outer_ends = np.empty(ends.shape[1:])
    np.minimum.reduce(ends, axis=(0, 1), out=outer_ends[0, ...])
    np.maximum.reduce(ends, axis=(0, 1), out=outer_ends[1, ...])
    return np.asarray(np.nextafter(outer_ends, _TOWARDS[outer_ends.ndim - 1], out=outer_ends))


def square(a: Box) -> Box:
    """Multiply by itself, which has no negative values."""
    sizes = np.abs(a)
    sizes.sort(axis=0)
    ends = round_outward(sizes * sizes)
    ends[0] = np.where((a[0] <= 0.0) & (a[1] >= 0.0), 0.0, np.maximum(ends[0], 0.0))
    return ends


def divide(a: Box, b: Box) -> Box:
    """Divide by what is not zero; see `has_zero`."""
    return _outermost(a[:, None] / b[None])


def scaled(a: Box, factor: float) -> Box:
    """Multiply by a number."""
    ends = a * factor
    return round_outward(ends if factor >= 0.0 else ends[::-1])


def divided_by(a: Box, divisor: float) -> Box:
    """Divide by a number that is not zero."""
    ends = a / divisor
    return round_outward(ends if divisor > 0.0 else ends[::-1])


def has_zero(a: Box) -> bool:
    """Whether zero, or no number that is known, is among the values."""
    return not bool(((a[0] > 0.0) | (a[1] < 0.0)).all())


def sum_along(terms: Box, axis: int = 1) -> Box:
    """Sum along an axis, one addition after the other.

    Rounding errs by (m - 1) u of the sum of sizes, to first order (Higham, Accuracy and Stability of Numerical Algorithms,
    2nd ed., section 4.2), and the bound here is twice that of m terms.
    """
    count = terms.shape[axis]
    last = (slice(None),) * axis + (-1,)
    if count == 1:
        return np.asarray(terms[last])
    sums = np.add.accumulate(terms, axis=axis)[last]
    slack = np.add.accumulate(np.abs(terms), axis=axis)[last]
    slack *= count * EPS
    return round_outward(sums + slack * _SIDES[sums.ndim - 1])


def matrix_product(a: Box, b: Box) -> Box:
    """Multiply matrices, or a matrix with a vector."""
    if b.ndim == 2:
        return sum_along(multiply(a, b[:, None, :]), axis=2)
    return sum_along(multiply(a[:, :, :, None], b[:, None]), axis=2)


def midpoint(a: Box) -> Floats:
    """Return a number in the middle, or nearly."""
    return np.asarray(a[0] + 0.5 * (a[1] - a[0]))


def width(a: Box) -> Floats:
    """Return how far the ends are apart."""
    return np.asarray(a[1] - a[0])


def magnitude(a: Box) -> Floats:
    """Return the largest absolute value."""
    return np.asarray(np.abs(a).max(axis=0))


def hull(a: Box, b: Box) -> Box:
    """Return the least box that holds two."""
    return np.stack([np.minimum(a[0], b[0]), np.maximum(a[1], b[1])])


def intersection(a: Box, b: Box) -> Box:
    """Return what two boxes that both hold the same have in common."""
    return np.stack([np.maximum(a[0], b[0]), np.minimum(a[1], b[1])])


def interval_power(x: Box, n: int) -> Box:
    """Raise one interval without negative numbers to a power, by squares."""
    return np.array([_directed_power(float(end), n, towards) for end, towards in zip(x, (0.0, inf), strict=True)])


def _directed_power(x: float, n: int, towards: float) -> float:
    """Raise a number that is not negative to a power, every product being rounded towards zero or infinity."""
    power_value, square = 1.0, x
    while n:
        if n % 2:
            power_value = nextafter(power_value * square, towards)
        n //= 2
        if n:
            square = nextafter(square * square, towards)
    return power_value
