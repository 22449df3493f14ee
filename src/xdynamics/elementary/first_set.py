"""The tangent and the angle of a point as in the set `xdynamics 1`, for archives made with it.

This tangent is up to 1.1 ulp from the true value; this angle loses digits where y is subnormal.
"""

from __future__ import annotations

from xdynamics.elementary.circular import ARCTANGENT, COSINE, SINE, angle_by, reduce_angle
from xdynamics.elementary.numbers import (
    Number,
    choose,
    divide_with_tails,
    exact_product,
    ordered_sum,
    polynomial,
    round_to_integer,
    table_entry,
)


def tan(x: Number) -> Number:
    """Tangent of an angle in radians."""
    high, low, n = reduce_angle(x)
    u, lost = exact_product(high, high)
    lost = lost + 2.0 * (high * low)
    above, above_tail = ordered_sum(high, low - (u * high) * polynomial(u, SINE))
    near, near_tail = ordered_sum(1.0, -0.5 * u)
    below, below_tail = ordered_sum(near, near_tail - 0.5 * lost + u * (u * polynomial(u, COSINE)))
    even = (n & 1) == 0
    numerator, numerator_tail = choose(even, above, -below), choose(even, above_tail, -below_tail)
    denominator, denominator_tail = choose(even, below, above), choose(even, below_tail, above_tail)
    quotient, correction = divide_with_tails(numerator, numerator_tail, denominator, denominator_tail)
    return choose(high == 0.0, choose(even, high, quotient), quotient + correction)


def first_arc(above: Number, below: Number) -> tuple[Number, Number]:
    """Return the arc whose tangent is above/below in [0, 1] as a number and its tail."""
    scale = choose(below < 2.0**-400, 2.0**600, 1.0)  # so that the rounding error of a product does not underflow
    y, x = above * scale, below * scale
    ratio = y / x
    product, lost = exact_product(ratio, x)
    remainder = ((y - product) - lost) / x
    sixteenths, nearest = round_to_integer(choose(ratio > 0.15625, ratio * 16.0, 0.0))
    center = sixteenths * 0.0625
    t = (ratio - center) / (1.0 + center * ratio)
    u = t * t
    small = remainder / (1.0 + ratio * ratio) + (t * u) * polynomial(u, ARCTANGENT)
    high, low = ordered_sum(table_entry("arc", nearest), t)
    return high, low + (small + table_entry("arc_tail", nearest))


def atan2(y: Number, x: Number) -> Number:
    """Angle of the point (x, y), in radians from -pi to pi."""
    return angle_by(first_arc, y, x)
