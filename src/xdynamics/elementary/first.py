"""The tangent and the angle of a point as the set `xdynamics 1` had them: for archives that were made with it.

That tangent is up to 1.1 ulp from the true value, that angle loses digits where y is subnormal.
"""

from __future__ import annotations

from xdynamics.elementary.functions import (
    ARCTANGENT,
    COSINE,
    HALF_PI,
    HALF_PI_TAIL,
    INF,
    NAN,
    PI,
    PI_TAIL,
    SINE,
    divided,
    polynomial,
    reduced,
)
from xdynamics.elementary.numbers import (
    Number,
    absolute,
    bits,
    choose,
    entry,
    exact_product,
    exact_sum,
    ordered_sum,
    rounded,
    signed,
)


def tan(x: Number) -> Number:
    """Tangent of an angle in radians."""
    high, low, n = reduced(x)
    u, lost = exact_product(high, high)
    lost = lost + 2.0 * (high * low)
    above, above_tail = ordered_sum(high, low - (u * high) * polynomial(u, SINE))
    near, near_tail = ordered_sum(1.0, -0.5 * u)
    below, below_tail = ordered_sum(near, near_tail - 0.5 * lost + u * (u * polynomial(u, COSINE)))
    even = (n & 1) == 0
    one, one_tail = choose(even, above, -below), choose(even, above_tail, -below_tail)
    other, other_tail = choose(even, below, above), choose(even, below_tail, above_tail)
    found, rest = divided(one, one_tail, other, other_tail)
    return choose(high == 0.0, choose(even, high, found), found + rest)


def arc(above: Number, below: Number) -> tuple[Number, Number]:
    """Return the arc whose tangent is above/below in [0, 1] as a number and its tail."""
    scale = choose(below < 2.0**-400, 2.0**600, 1.0)  # so that what rounding takes from a product is a number
    y, x = above * scale, below * scale
    ratio = y / x
    product, lost = exact_product(ratio, x)
    rest = ((y - product) - lost) / x
    sixteenths, nearest = rounded(choose(ratio > 0.15625, ratio * 16.0, 0.0))
    center = sixteenths * 0.0625
    t = (ratio - center) / (1.0 + center * ratio)
    u = t * t
    small = rest / (1.0 + ratio * ratio) + (t * u) * polynomial(u, ARCTANGENT)
    high, low = ordered_sum(entry("arc", nearest), t)
    return high, low + (small + entry("arc_tail", nearest))


def atan2(y: Number, x: Number) -> Number:
    """Angle of the point (x, y), in radians from -pi to pi."""
    up, right = absolute(y), absolute(x)
    steep = up > right
    above, below = choose(steep, right, up), choose(steep, up, right)
    endless = below == INF
    above, below = choose(endless, choose(above == INF, 1.0, 0.0), above), choose(endless | (below == 0.0), 1.0, below)
    high, low = arc(above, below)
    base, base_tail = choose(steep, HALF_PI, 0.0), choose(steep, HALF_PI_TAIL, 0.0)
    high, low = choose(steep, -high, high), choose(steep, -low, low)
    behind = bits(x) < 0
    base, base_tail = choose(behind, PI - base, base), choose(behind, PI_TAIL - base_tail, base_tail)
    high, low = choose(behind, -high, high), choose(behind, -low, low)
    total, lost = exact_sum(base, high)
    angle = total + (lost + (low + base_tail))
    return choose((x == x) & (y == y), signed(angle, y), NAN)
