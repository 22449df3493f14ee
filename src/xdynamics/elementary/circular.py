"""Sine, cosine, tangent and their inverses; see `functions`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from xdynamics.elementary.numbers import (
    FRACTION,
    INF,
    NAN,
    Integer,
    Number,
    Truth,
    absolute,
    bits,
    choose,
    divide_with_tails,
    exact_product,
    exact_sum,
    ordered_sum,
    polynomial,
    round_to_integer,
    signed,
    sqrt,
    table_entry,
    usually,
    whole_number,
)

HALF_PI, HALF_PI_TAIL = 1.5707963267948966, 6.123233995736766e-17
PI, PI_TAIL = 3.141592653589793, 1.2246467991473532e-16
TWO_OVER_PI = 0.6366197723675814
# pi/2 in parts: two of 34 bits, whose products with 19 bits are exact, and one of 53
PART1, PART2, PART3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21

# of 1 - sin(x)/x over x**2, cos(x) - 1 + x**2/2 over x**4, from fdlibm's k_sin.c and k_cos.c (Sun Microsystems 1993);
# the others fitted at Chebyshev's points to (f(x)/x - 1)/x**2 by tests/elementary_tables.py
SINE = (1.66666666666666324348e-01, -8.33333333332248946124e-03, 1.98412698298579493134e-04, -2.75573137070700676789e-06, 2.50507602534068634195e-08, -1.58969099521155010221e-10)  # fmt: skip
SINE_OF_EIGHTH = (8.0 * SINE[0] - 1.0, *(8.0 * coefficient for coefficient in SINE[1:]))  # the same over x**3/8, less 1
COSINE = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11)  # fmt: skip
ARCTANGENT = (-0.3333333333333333, 0.19999999999999984, -0.1428571428570344, 0.11111111108020631, -0.0909090864922547, 0.07692272169458476, -0.06664983363564835, 0.05835588665745958, -0.045522960151103915)  # fmt: skip
ARCSINE = (0.16666666666666669, 0.07499999999998433, 0.04464285714635543, 0.030381944138531247, 0.02237217294214989, 0.017352392720869973, 0.013971212973552933, 0.011479177415184906, 0.01032281435018578, 0.005457506718640358, 0.01740087944269402, -0.014851887071247204, 0.028757851367421566)  # fmt: skip

LIMB = 28  # bits of the whole numbers that 2/pi is kept in
MASK = (1 << LIMB) - 1
PADDING = 3  # leading ones that are zero


def reduce_angle(x: Number) -> Any:
    """Return x - n pi/2 in [-pi/4, pi/4] as a number and its tail, and n, of which only the last two bits count."""
    return usually(absolute(x) < 0.785, lambda: (x, x * 0.0, bits(x) & 0), lambda: reduce_near(x))


def reduce_near(x: Number) -> Any:
    """Reduce an angle of some turns."""
    remainder, tail, n, turns = less_turns(x)
    # the tail is far below the last digit for small angles, and right for those that are no multiple but for 31 bits
    near = (turns < 8192.0) & (absolute(remainder) >= turns * 2.0**-31)
    return usually(near, lambda: (remainder, tail, n), lambda: reduce_far(x))


def reduce_far(x: Number) -> Any:
    """Reduce an angle that is large, or close to a multiple of pi/2."""
    remainder, tail, n, turns = less_turns(x)
    high = remainder + tail
    far = (turns < 500000.0) & (absolute(remainder) >= turns * 2.0**-31)
    return usually(far, lambda: (high, (remainder - high) + tail, n), lambda: reduce_exactly(x))


def less_turns(x: Number) -> tuple[Number, Number, Integer, Number]:
    """Return the remainder of an angle by pi/2 in three parts, its tail, n, and |n|."""
    turns, n = round_to_integer(x * TWO_OVER_PI)
    # up to 19 bits of turns both products are exact by their bits, and the difference from x by Sterbenz's lemma
    remainder, lost = ordered_sum(x - turns * PART1, -(turns * PART2))
    return remainder, lost - turns * PART3, n, absolute(turns)


def reduce_exactly(x: Number) -> tuple[Number, Number, Integer]:
    """Reduce any angle by the bits of 2/pi that matter to it (Payne, Hanek 1983, doi:10.1145/1057600.1057602)."""
    word = bits(absolute(x))
    # the angle is a whole mantissa times 2**exponent: a bias of 1023, and 52 places
    exponent = (word >> 52) - 1075
    exponent = choose(exponent > -53, exponent, -53)  # no smaller angle needs this
    # with the leading 1 of a normal number, which IEEE 754 does not store
    mantissa = (word & FRACTION) | (1 << 52)
    first = whole_quotient(exponent)
    shift = exponent - first * LIMB
    low, high = (mantissa & MASK) << shift, (mantissa >> LIMB) << shift
    parts = (low & MASK, (low >> LIMB) + (high & MASK), high >> LIMB)
    parts = (parts[0], parts[1] & MASK, parts[2] + (parts[1] >> LIMB))
    window = [table_entry("two_over_pi", first + (PADDING - 1 + j)) for j in range(10)]
    carry: Integer = 0
    limbs = []
    for q in range(10):
        total = carry
        for b, part in enumerate(parts):
            if 0 <= b + 9 - q <= 9:
                # factors of 28 bits: three products and a carry stay far below 2**63
                total = part * window[b + 9 - q] + total
        limbs.append(total & MASK)
        carry = total >> LIMB
    top = limbs[8]
    above = top >> (LIMB - 1)  # 1 where the fraction is a half or more: then it is measured from the next whole number
    turns = limbs[9] + above
    fraction, tail = whole_number(top - (above << LIMB)) * 2.0**-LIMB, 0.0
    for q in range(7, -1, -1):
        fraction, lost = exact_sum(fraction, whole_number(limbs[q]) * 2.0 ** (-LIMB * (9 - q)))
        tail = tail + lost
    high, low = exact_product(fraction, HALF_PI)
    high, low = ordered_sum(high, low + (fraction * HALF_PI_TAIL + tail * HALF_PI))
    negative = x < 0.0
    high = high + (x - x)  # no angle is infinite
    return choose(negative, -high, high), choose(negative, -low, low), choose(negative, 4 - (turns & 3), turns & 3)


def whole_quotient(exponent: Integer) -> Integer:
    """Return exponent/28 rounded down, for |exponent| < 2**13."""
    return (exponent * 37450) >> 20


def sine_of(x: Number, tail: Number, p: Number) -> Number:
    """Sine of a reduced angle; p is its polynomial."""
    u = x * x
    return x - ((u * x) * p - tail * (1.0 - 0.5 * u))


def cosine_of(x: Number, tail: Number, p: Number) -> Number:
    """Cosine of a reduced angle; p is its polynomial."""
    u = x * x
    half = 0.5 * u
    near = 1.0 - half
    # (1 - near) - half is exactly what rounding 1 - half has lost
    return near + (((1.0 - near) - half) + ((u * u) * p - x * tail))


def signed_by_quadrant(x: Number, n: Integer) -> Number:
    """Return -x where the second bit of n is set, else x."""
    return x * choose((n & 2) == 0, 1.0, -1.0)


def circular(x: Number, tail: Number, sine: Truth) -> Number:
    """Sine of a reduced angle if `sine` holds, else its cosine."""
    p = polynomial(x * x, tuple(choose(sine, *pair) for pair in zip(SINE, COSINE, strict=True)))
    return choose(sine, sine_of(x, tail, p), cosine_of(x, tail, p))


def sin(x: Number) -> Number:
    """Sine of an angle in radians."""
    high, low, n = reduce_angle(x)
    return signed_by_quadrant(circular(high, low, (n & 1) == 0), n)


def cos(x: Number) -> Number:
    """Cosine of an angle in radians."""
    high, low, n = reduce_angle(x)
    return signed_by_quadrant(circular(high, low, (n & 1) == 1), n + 1)


def sin_cos(x: Number) -> tuple[Number, Number]:
    """Sine and cosine of one angle, with the same bits as `sin` and `cos`."""
    high, low, n = reduce_angle(x)
    u = high * high
    sine, cosine = sine_of(high, low, polynomial(u, SINE)), cosine_of(high, low, polynomial(u, COSINE))
    even = (n & 1) == 0
    return signed_by_quadrant(choose(even, sine, cosine), n), signed_by_quadrant(choose(even, cosine, sine), n + 1)


def tan(x: Number) -> Number:
    """Tangent of an angle in radians."""
    high, low, n = reduce_angle(x)
    u, lost = exact_product(high, high)
    lost = lost + 2.0 * (high * low)
    # sin(x) = x - x**3/8 (1 + 1/3 - …): an eighth is exact, and the rounding error of x**3/8 is kept
    eighth = 0.125 * high
    cube, cube_lost = exact_product(u, eighth)
    correction = cube_lost + (lost * eighth + cube * polynomial(u, SINE_OF_EIGHTH))
    above, above_tail = ordered_sum(high, -cube)
    above, above_tail = ordered_sum(above, above_tail + (low - correction))
    near, near_tail = ordered_sum(1.0, -0.5 * u)
    below, below_tail = ordered_sum(near, near_tail - 0.5 * lost + u * (u * polynomial(u, COSINE)))
    even = (n & 1) == 0
    numerator, numerator_tail = choose(even, above, -below), choose(even, above_tail, -below_tail)
    denominator, denominator_tail = choose(even, below, above), choose(even, below_tail, above_tail)
    quotient, correction = divide_with_tails(numerator, numerator_tail, denominator, denominator_tail)
    # a tail of 0.0 added to -0.0 would take its sign
    return choose(high == 0.0, choose(even, high, quotient), quotient + correction)


def arc_of_ratio(above: Number, below: Number) -> tuple[Number, Number]:
    """Return the arc whose tangent is above/below in [0, 1] as a number and its tail."""
    scale = choose(below < 2.0**-400, 2.0**600, 1.0)  # so that the rounding error of a product does not underflow
    y, x = above * scale, below * scale
    ratio = y / x
    product, lost = exact_product(ratio, x)
    # for a small ratio the rest is rounding error only, which may underflow
    remainder = choose(ratio < 2.0**-60, 0.0, (y - product) - lost) / x
    sixteenths, nearest = round_to_integer(choose(ratio > 0.15625, ratio * 16.0, 0.0))
    center = sixteenths * 0.0625
    # atan(r) - atan(c) = atan((r - c)/(1 + c r))
    t = (ratio - center) / (1.0 + center * ratio)
    u = t * t
    small = remainder / (1.0 + ratio * ratio) + (t * u) * polynomial(u, ARCTANGENT)
    high, low = ordered_sum(table_entry("arc", nearest), t)
    return high, low + (small + table_entry("arc_tail", nearest))


def angle_by(arc: Callable[[Number, Number], tuple[Number, Number]], y: Number, x: Number) -> Number:
    """Angle of the point (x, y) from the arc tangent, in two parts, of a quotient between 0 and 1."""
    up, right = absolute(y), absolute(x)
    steep = up > right
    above, below = choose(steep, right, up), choose(steep, up, right)
    endless = below == INF
    # as IEEE 754 has it: pi/4 where both are infinite, 0 where both are zero
    above, below = choose(endless, choose(above == INF, 1.0, 0.0), above), choose(endless | (below == 0.0), 1.0, below)
    high, low = arc(above, below)
    base, base_tail = choose(steep, HALF_PI, 0.0), choose(steep, HALF_PI_TAIL, 0.0)
    high, low = choose(steep, -high, high), choose(steep, -low, low)
    # by the sign bit: the angle of (-0.0, 0.0) is pi
    behind = bits(x) < 0
    base, base_tail = choose(behind, PI - base, base), choose(behind, PI_TAIL - base_tail, base_tail)
    high, low = choose(behind, -high, high), choose(behind, -low, low)
    total, lost = exact_sum(base, high)
    angle = total + (lost + (low + base_tail))
    return choose((x == x) & (y == y), signed(angle, y), NAN)


def atan2(y: Number, x: Number) -> Number:
    """Angle of the point (x, y), in radians from -pi to pi."""
    return angle_by(arc_of_ratio, y, x)


def atan(x: Number) -> Number:
    """Angle with this tangent, in radians from -pi/2 to pi/2."""
    size = absolute(x)
    steep = size > 1.0
    # from 2**60 on the arc of 1/size no longer changes pi/2, and infinity needs no case of its own
    high, low = arc_of_ratio(choose(steep, 1.0, size), choose(steep, choose(size < 2.0**60, size, 2.0**60), 1.0))
    total, lost = ordered_sum(HALF_PI, -high)
    angle = choose(steep, total + (lost + (HALF_PI_TAIL - low)), high + low)
    return choose(x == x, signed(angle, x), NAN)


def from_one(size: Number) -> tuple[Number, Number, Number]:
    """Return x, tail and more, where x + tail + x*more is asin(size) below 1/2, else asin(sqrt((1 - size)/2))."""
    inner = size < 0.5
    # 1 - size is exact from 1/2 on (Sterbenz), so that no digits are lost near 1
    square = choose(inner, size * size, (1.0 - size) * 0.5)
    root = sqrt(square)
    product, lost = exact_product(root, root)
    tail = choose(inner, 0.0, (square - product) - lost) / choose(root == 0.0, 1.0, root + root)
    return choose(inner, size, root), tail, square * polynomial(square, ARCSINE)


def asin(x: Number) -> Number:
    """Angle with this sine, in radians from -pi/2 to pi/2; nan beyond 1."""
    size = absolute(x)
    arm, tail, more = from_one(size)
    correction = tail + arm * more
    total, lost = ordered_sum(HALF_PI, -2.0 * arm)
    angle = choose(size < 0.5, arm + correction, total + (lost + (HALF_PI_TAIL - 2.0 * correction)))
    return signed(angle, x)


def acos(x: Number) -> Number:
    """Angle with this cosine, in radians from 0 to pi; nan beyond 1."""
    size = absolute(x)
    arm, tail, more = from_one(size)
    correction = tail + arm * more
    behind = x < 0.0
    inner = size < 0.5
    base, base_tail = choose(inner, HALF_PI, PI), choose(inner, HALF_PI_TAIL, PI_TAIL)
    arm, correction = (
        choose(inner, choose(behind, -arm, arm), 2.0 * arm),
        choose(inner, choose(behind, -correction, correction), 2.0 * correction),
    )
    total, lost = ordered_sum(base, -arm)
    return choose(inner | behind, total + (lost + (base_tail - correction)), arm + correction)
