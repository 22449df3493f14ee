"""The elementary functions, from arithmetic that is the same on every machine.

Each is one sequence of operations, for floats, arrays and written programs alike, and at most 1 ulp from the true
value. In place of a branch both results are computed and one is chosen; work that few arguments need is skipped by
`usually`. Reduction and polynomials are those of fdlibm (Ng 1993), tables as Tang proposed (1989,
doi:10.1145/63522.214389), and rounding errors are kept as a second number (Dekker 1971, doi:10.1007/BF01397083).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from xdynamics.elementary.numbers import (
    MAGIC,
    MAGIC_BITS,
    Number,
    Truth,
    Whole,
    absolute,
    bits,
    choose,
    entry,
    exact_product,
    exact_sum,
    number,
    ordered_sum,
    power_of_two,
    rounded,
    signed,
    sqrt,
    upper,
    usually,
    whole_number,
)

NAME = "xdynamics 2"  # of this set: a different order of operations is a different set; `sets` keeps the older ones

INF, NAN = math.inf, math.nan
SIGN = -(1 << 63)
FRACTION, ONE = (1 << 52) - 1, 1023 << 52
SMALLEST_NORMAL, INFINITE = 1 << 52, 2047 << 52  # as bits
LARGE_EXPONENT = 0x4086200000000000  # 708
HALF_PI, HALF_PI_TAIL = 1.5707963267948966, 6.123233995736766e-17
PI, PI_TAIL = 3.141592653589793, 1.2246467991473532e-16
TWO_OVER_PI = 0.6366197723675814
# pi/2 in parts: two of 34 bits, whose products with 19 bits are exact, and one of 53
PART1, PART2, PART3 = 1.5707963267341256, 6.077100506303966e-11, 2.0222662487959506e-21
LOG2_128 = 184.6649652337873  # 128/log(2)
# log(2)/128: 34 bits, whose products with 18 are exact; the rest
STEP, STEP_TAIL = 0.005415212347998022, 1.2655086083325438e-13
LOG2, LOG2_TAIL = 0.6931471805598903, 5.497923018708371e-14  # log(2): 42 bits after the point; the rest

# of 1 - sin(x)/x over x**2, cos(x) - 1 + x**2/2 over x**4, from fdlibm's k_sin.c and k_cos.c (Sun Microsystems 1993);
# the others fitted at Chebyshev's points to (f(x)/x - 1)/x**2 by tests/elementary_tables.py
SINE = (1.66666666666666324348e-01, -8.33333333332248946124e-03, 1.98412698298579493134e-04, -2.75573137070700676789e-06, 2.50507602534068634195e-08, -1.58969099521155010221e-10)  # fmt: skip
SINE_OF_EIGHTH = (8.0 * SINE[0] - 1.0, *(8.0 * coefficient for coefficient in SINE[1:]))  # the same over x**3/8, less 1
COSINE = (4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05, -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11)  # fmt: skip
ARCTANGENT = (-0.3333333333333333, 0.19999999999999984, -0.1428571428570344, 0.11111111108020631, -0.0909090864922547, 0.07692272169458476, -0.06664983363564835, 0.05835588665745958, -0.045522960151103915)  # fmt: skip
ARCSINE = (0.16666666666666669, 0.07499999999998433, 0.04464285714635543, 0.030381944138531247, 0.02237217294214989, 0.017352392720869973, 0.013971212973552933, 0.011479177415184906, 0.01032281435018578, 0.005457506718640358, 0.01740087944269402, -0.014851887071247204, 0.028757851367421566)  # fmt: skip
SINH = (0.16666666666666666, 0.008333333333333333, 0.00019841269841269773, 2.755731922404034e-06, 2.505210836405804e-08, 1.6059048396350562e-10, 7.646625361656657e-13, 2.8445264169895285e-15)  # fmt: skip
TANH = (-0.3333333333333333, 0.13333333333333333, -0.05396825396825387, 0.021869488536134365, -0.008863235527730825, 0.0035921279064936957, -0.001455829636195592, 0.0005899197816047852, -0.00023764750063180886, 8.548775370045155e-05)  # fmt: skip


def polynomial(u: Number, powers: tuple[float, ...]) -> Number:
    """Evaluate a polynomial by pairs of terms in parallel (Estrin), with half the latency of Horner's scheme."""
    terms: list[Number] = list(powers)
    step = u
    while len(terms) > 3:
        terms = [terms[i] + step * terms[i + 1] for i in range(0, len(terms) - 1, 2)] + terms[len(terms) // 2 * 2 :]
        step = step * step
    value = terms.pop()
    while terms:
        value = terms.pop() + step * value
    return value


# ----------------------------------------------------------------------------------------------------------- angles

LIMB = 28  # bits of the whole numbers that 2/pi is kept in
MASK = (1 << LIMB) - 1
PADDING = 3  # leading ones that are zero


def reduced(x: Number) -> Any:
    """Return x - n pi/2 in [-pi/4, pi/4] as a number and its tail, and n, of which only the last two bits count."""
    return usually(absolute(x) < 0.785, lambda: (x, x * 0.0, bits(x) & 0), lambda: reduced_near(x))


def reduced_near(x: Number) -> Any:
    """Reduce an angle of some turns."""
    rest, tail, n, turns = less_turns(x)
    # the tail is far below the last digit for small angles, and right for those that are no multiple but for 31 bits
    near = (turns < 8192.0) & (absolute(rest) >= turns * 2.0**-31)
    return usually(near, lambda: (rest, tail, n), lambda: reduced_far(x))


def reduced_far(x: Number) -> Any:
    """Reduce an angle that is large, or close to a multiple of pi/2."""
    rest, tail, n, turns = less_turns(x)
    high = rest + tail
    far = (turns < 500000.0) & (absolute(rest) >= turns * 2.0**-31)
    return usually(far, lambda: (high, (rest - high) + tail, n), lambda: reduced_exactly(x))


def less_turns(x: Number) -> tuple[Number, Number, Whole, Number]:
    """Return the remainder of an angle by pi/2 in three parts, its tail, n, and |n|."""
    turns, n = rounded(x * TWO_OVER_PI)
    rest, lost = ordered_sum(x - turns * PART1, -(turns * PART2))
    return rest, lost - turns * PART3, n, absolute(turns)


def reduced_exactly(x: Number) -> tuple[Number, Number, Whole]:
    """Reduce any angle by the bits of 2/pi that matter to it (Payne, Hanek 1983, doi:10.1145/1057600.1057602)."""
    word = bits(absolute(x))
    exponent = (word >> 52) - 1075
    exponent = choose(exponent > -53, exponent, -53)  # no smaller angle needs this
    mantissa = (word & FRACTION) | (1 << 52)
    first = whole_quotient(exponent)
    shift = exponent - first * LIMB
    low, high = (mantissa & MASK) << shift, (mantissa >> LIMB) << shift
    parts = (low & MASK, (low >> LIMB) + (high & MASK), high >> LIMB)
    parts = (parts[0], parts[1] & MASK, parts[2] + (parts[1] >> LIMB))
    window = [entry("two_over_pi", first + (PADDING - 1 + j)) for j in range(10)]
    carry: Whole = 0
    limbs = []
    for q in range(10):
        total = carry
        for b, part in enumerate(parts):
            if 0 <= b + 9 - q <= 9:
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


def whole_quotient(exponent: Whole) -> Whole:
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
    return near + (((1.0 - near) - half) + ((u * u) * p - x * tail))


def turned(x: Number, n: Whole) -> Number:
    """Return -x where the second bit of n is set, else x."""
    return x * choose((n & 2) == 0, 1.0, -1.0)


def circular(x: Number, tail: Number, sine: Truth) -> Number:
    """Sine of a reduced angle if `sine` holds, else its cosine."""
    p = polynomial(x * x, tuple(choose(sine, *pair) for pair in zip(SINE, COSINE, strict=True)))
    return choose(sine, sine_of(x, tail, p), cosine_of(x, tail, p))


def sin(x: Number) -> Number:
    """Sine of an angle in radians."""
    high, low, n = reduced(x)
    return turned(circular(high, low, (n & 1) == 0), n)


def cos(x: Number) -> Number:
    """Cosine of an angle in radians."""
    high, low, n = reduced(x)
    return turned(circular(high, low, (n & 1) == 1), n + 1)


def sin_cos(x: Number) -> tuple[Number, Number]:
    """Sine and cosine of one angle, with the same bits as `sin` and `cos`."""
    high, low, n = reduced(x)
    u = high * high
    sine, cosine = sine_of(high, low, polynomial(u, SINE)), cosine_of(high, low, polynomial(u, COSINE))
    even = (n & 1) == 0
    return turned(choose(even, sine, cosine), n), turned(choose(even, cosine, sine), n + 1)


def tan(x: Number) -> Number:
    """Tangent of an angle in radians."""
    high, low, n = reduced(x)
    u, lost = exact_product(high, high)
    lost = lost + 2.0 * (high * low)
    # sin(x) = x - x**3/8 (1 + 1/3 - …): an eighth is exact, and the rounding error of x**3/8 is kept
    eighth = 0.125 * high
    cube, cube_lost = exact_product(u, eighth)
    rest = cube_lost + (lost * eighth + cube * polynomial(u, SINE_OF_EIGHTH))
    above, above_tail = ordered_sum(high, -cube)
    above, above_tail = ordered_sum(above, above_tail + (low - rest))
    near, near_tail = ordered_sum(1.0, -0.5 * u)
    below, below_tail = ordered_sum(near, near_tail - 0.5 * lost + u * (u * polynomial(u, COSINE)))
    even = (n & 1) == 0
    numerator, numerator_tail = choose(even, above, -below), choose(even, above_tail, -below_tail)
    denominator, denominator_tail = choose(even, below, above), choose(even, below_tail, above_tail)
    quotient, rest = divided(numerator, numerator_tail, denominator, denominator_tail)
    return choose(high == 0.0, choose(even, high, quotient), quotient + rest)


def divided(x: Number, x_tail: Number, y: Number, y_tail: Number) -> tuple[Number, Number]:
    """Return the rounded quotient of two numbers with tails, and its tail."""
    quotient = x / choose(y == 0.0, 1.0, y)
    product, lost = exact_product(quotient, y)
    return quotient, (((x - product) - lost) + (x_tail - quotient * y_tail)) / choose(y == 0.0, 1.0, y)


# ----------------------------------------------------------------------------------------------------------- arcs


def arc(above: Number, below: Number) -> tuple[Number, Number]:
    """Return the arc whose tangent is above/below in [0, 1] as a number and its tail."""
    scale = choose(below < 2.0**-400, 2.0**600, 1.0)  # so that the rounding error of a product does not underflow
    y, x = above * scale, below * scale
    ratio = y / x
    product, lost = exact_product(ratio, x)
    # for a small ratio the rest is rounding error only, which may underflow
    rest = choose(ratio < 2.0**-60, 0.0, (y - product) - lost) / x
    sixteenths, nearest = rounded(choose(ratio > 0.15625, ratio * 16.0, 0.0))
    center = sixteenths * 0.0625
    t = (ratio - center) / (1.0 + center * ratio)
    u = t * t
    small = rest / (1.0 + ratio * ratio) + (t * u) * polynomial(u, ARCTANGENT)
    high, low = ordered_sum(entry("arc", nearest), t)
    return high, low + (small + entry("arc_tail", nearest))


def exponent_of(x: Number) -> Whole:
    """Return the exponent of |x|, limited to -1022 … 1021."""
    exponent = ((bits(x) >> 52) & 2047) - 1023
    return choose(exponent < 1022, choose(exponent < -1022, -1022, exponent), 1021)


def angle_by(arc: Callable[[Number, Number], tuple[Number, Number]], y: Number, x: Number) -> Number:
    """Angle of the point (x, y) from the arc tangent, in two parts, of a quotient between 0 and 1."""
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


def atan2(y: Number, x: Number) -> Number:
    """Angle of the point (x, y), in radians from -pi to pi."""
    return angle_by(arc, y, x)


def atan(x: Number) -> Number:
    """Angle with this tangent, in radians from -pi/2 to pi/2."""
    size = absolute(x)
    steep = size > 1.0
    high, low = arc(choose(steep, 1.0, size), choose(steep, choose(size < 2.0**60, size, 2.0**60), 1.0))
    total, lost = ordered_sum(HALF_PI, -high)
    angle = choose(steep, total + (lost + (HALF_PI_TAIL - low)), high + low)
    return choose(x == x, signed(angle, x), NAN)


def from_one(size: Number) -> tuple[Number, Number, Number]:
    """Return x, tail and more, where x + tail + x*more is asin(size) below 1/2, else asin(sqrt((1 - size)/2))."""
    inner = size < 0.5
    square = choose(inner, size * size, (1.0 - size) * 0.5)
    root = sqrt(square)
    product, lost = exact_product(root, root)
    tail = choose(inner, 0.0, (square - product) - lost) / choose(root == 0.0, 1.0, root + root)
    return choose(inner, size, root), tail, square * polynomial(square, ARCSINE)


def asin(x: Number) -> Number:
    """Angle with this sine, in radians from -pi/2 to pi/2; nan beyond 1."""
    size = absolute(x)
    arm, tail, more = from_one(size)
    rest = tail + arm * more
    total, lost = ordered_sum(HALF_PI, -2.0 * arm)
    angle = choose(size < 0.5, arm + rest, total + (lost + (HALF_PI_TAIL - 2.0 * rest)))
    return signed(angle, x)


def acos(x: Number) -> Number:
    """Angle with this cosine, in radians from 0 to pi; nan beyond 1."""
    size = absolute(x)
    arm, tail, more = from_one(size)
    rest = tail + arm * more
    behind = x < 0.0
    inner = size < 0.5
    base, base_tail = choose(inner, HALF_PI, PI), choose(inner, HALF_PI_TAIL, PI_TAIL)
    arm, rest = (
        choose(inner, choose(behind, -arm, arm), 2.0 * arm),
        choose(inner, choose(behind, -rest, rest), 2.0 * rest),
    )
    total, lost = ordered_sum(base, -arm)
    return choose(inner | behind, total + (lost + (base_tail - rest)), arm + rest)


# --------------------------------------------------------------------------------------------- exponentials, powers


def growth(x: Number, tail: Number) -> tuple[Number, Number, Whole]:
    """Return exp(x + tail)/2**k, between 1 and 2, as a number and a small one to be added, and k; |x| < 800."""
    steps, n = rounded(x * LOG2_128)
    r = ((x - steps * STEP) - steps * STEP_TAIL) + tail
    higher = (r * r) * (0.5 + r * (0.16666666666666666 + r * (0.041666666666666664 + r * 0.008333333333333333)))
    place = n & 127
    root = entry("root", place)
    return root, root * (r + (higher + entry("root_tail", place))), n >> 7


def scaled(x: Number, k: Whole) -> Number:
    """Return x 2**k, in two steps, since it may overflow or be subnormal."""
    half = k >> 1
    return (x * power_of_two(half)) * power_of_two(k - half)


def held(x: Number, limit: float) -> Number:
    """Return x clipped to plus or minus the limit; for nan, a limit."""
    return choose(x > limit, limit, choose(x > -limit, x, -limit))


def exp(x: Number) -> Number:
    """Exponential function."""
    within = (bits(x) & ~SIGN) < LARGE_EXPONENT
    return usually(within, lambda: normal_exp(x, 0.0), lambda: exp_anywhere(x))


def normal_exp(x: Number, tail: Number) -> Number:
    """Return exp(x + tail), a normal number."""
    root, more, k = growth(x, tail)
    return (root + more) * power_of_two(k)


def exp_anywhere(x: Number) -> Number:
    """Exponential function where the result may be infinite, subnormal or nan."""
    root, more, k = growth(held(x, 800.0), 0.0)
    return choose(x == x, scaled(root + more, k), NAN)


def split(x: Number) -> tuple[Number, Whole, Number, Number]:
    """Write a normal x > 0 as 2**k (1 + r)/c with c from a table: return k, the place of c, and r in two parts."""
    word = bits(x)
    fraction = word & FRACTION
    place = (fraction + (1 << 44)) >> 45
    # the distance from the center has 44 bits, and c has 9: both the difference and the product are exact
    part = (number(fraction | ONE) - entry("center", place)) * entry("inverse", place)
    return number((word >> 52) + (MAGIC_BITS - 1023)) - MAGIC, place, part, entry("offset", place)


def log(x: Number) -> Number:
    """Natural logarithm; -inf at 0, nan below."""
    word = bits(x)
    normal = (word >= SMALLEST_NORMAL) & (word < INFINITE)
    return usually(normal, lambda: log_of(*split(x)), lambda: log_anywhere(x))


def log_of(k: Number, place: Whole, part: Number, offset: Number) -> Number:
    """Natural logarithm of a split number."""
    r = part + offset
    base = k * LOG2 + entry("log", place)
    high, lost = ordered_sum(base, r)
    tail = k * LOG2_TAIL + entry("log_tail", place)
    return high + (lost + (tail + (r * r) * polynomial(r, LOG[:6])))


def log_anywhere(x: Number) -> Number:
    """Natural logarithm of anything but a positive normal number."""
    small = (x > 0.0) & (x < 1.0)
    k, *others = split(choose(small, x * 2.0**54, 1.0))
    return choose(small, log_of(k - 54.0, *others), choose(x == 0.0, -INF, choose(x > 0.0, x, NAN)))


def logarithm(k: Number, place: Whole, part: Number, offset: Number) -> tuple[Number, Number]:
    """Return the logarithm of a split number in double the precision, as two numbers."""
    r, r_tail = exact_sum(offset, part)
    r_upper = upper(r)
    square, square_tail = 0.5 * (r_upper * r_upper), (r - r_upper) * (0.5 * (r + r_upper))
    base, tail = k * LOG2 + entry("log", place), k * LOG2_TAIL + entry("log_tail", place)
    high, lost = exact_sum(base, r)
    high, more = ordered_sum(high, -square)
    higher = (r * (r * r)) * polynomial(r, LOG[1:])
    return ordered_sum(high, (lost + more) + ((r_tail * (1.0 - r) - square_tail) + (higher + tail)))


LOG = (-1 / 2, 1 / 3, -1 / 4, 1 / 5, -1 / 6, 1 / 7, -1 / 8, 1 / 9)  # of log(1 + r), from r**2 on


def power(x: Number, y: Number) -> Number:
    """Return x**y; nan below zero unless y is whole."""
    word = bits(x)
    normal = (word >= SMALLEST_NORMAL) & (word < INFINITE)
    high, low = logarithm(*split(x))
    product, lost = exact_product(y, high)
    within = normal & (absolute(product) < 708.0) & (absolute(y) < 2.0**70)
    return usually(within, lambda: normal_exp(product, lost + y * low), lambda: power_anywhere(x, y))


def power_anywhere(x: Number, y: Number) -> Number:
    """Return x**y for any two numbers, as IEEE 754 asks."""
    size = absolute(x)
    usable = (size > 0.0) & (size < INF)
    small = size < 2.0**-1022
    k, *others = split(choose(usable, choose(small, size * 2.0**54, size), 1.0))
    high, low = logarithm(choose(usable & small, k - 54.0, k), *others)
    far = held(y, 2.0**70)  # a larger product would overflow, where the result has long done so
    product, lost = exact_product(far, high)
    product, lost = ordered_sum(product, lost + far * low)
    within = absolute(product) < 800.0
    root, more, k = growth(choose(within, product, 0.0), choose(within, lost, 0.0))
    result = choose(within, scaled(root + more, k), choose(product > 0.0, INF, 0.0))
    nothing, endless = size == 0.0, size == INF
    result = choose(nothing | endless, choose((y > 0.0) == nothing, 0.0, INF), result)
    whole, odd = wholeness(y)
    result = choose((bits(x) < 0) & odd, -result, result)
    result = choose((x < 0.0) & (size < INF), choose(whole, result, NAN), result)
    result = choose((x == x) & (y == y), result, NAN)
    return choose((y == 0.0) | (x == 1.0), 1.0, result)


def wholeness(y: Number) -> tuple[Truth, Truth]:
    """Return whether a non-zero number is whole, and whether it is odd."""
    word = bits(absolute(y))
    places = 1075 - (word >> 52)  # after the point
    within = (places > 0) & (places <= 52)
    shift = choose(within, places, 0)
    mantissa = (word & FRACTION) | (1 << 52)
    whole = (((mantissa >> shift) << shift) == mantissa) & (places <= 52)
    return whole, whole & (((mantissa >> shift) & 1) == 1) & (places >= 0)


# --------------------------------------------------------------------------------------------- hyperbolic functions


def half_growth(size: Number) -> tuple[Number, Number, Number, Number]:
    """Return exp(size)/2 and exp(-size)/2, each as a number and its tail."""
    root, more, k = growth(choose(size < 800.0, size, 800.0), 0.0)
    high, low = ordered_sum(root, more)
    high, low = scaled(high, k - 1), scaled(low, k - 1)
    inverse = 0.25 / high
    return high, low, inverse, -4.0 * (inverse * inverse) * low


def cosh(x: Number) -> Number:
    """Hyperbolic cosine."""
    high, low, inverse, rest = half_growth(absolute(x))
    total, lost = ordered_sum(high, inverse)
    return choose(x == x, choose(total < INF, total + (lost + (low + rest)), INF), NAN)


def sinh(x: Number) -> Number:
    """Hyperbolic sine."""
    size = absolute(x)
    u = x * x
    near = x + x * (u * polynomial(u, SINH))
    high, low, inverse, rest = half_growth(size)
    total, lost = ordered_sum(high, -inverse)
    far = choose(total < INF, total + (lost + (low - rest)), INF)
    return choose(x == x, signed(choose(size < 1.0, near, far), x), NAN)


def tanh(x: Number) -> Number:
    """Hyperbolic tangent."""
    size = absolute(x)
    u = x * x
    near = x + x * (u * polynomial(u, TANH))
    root, more, k = growth(held(2.0 * size, 50.0), 0.0)
    high, low = ordered_sum(root, more)
    high, low = scaled(high, k), scaled(low, k)
    above, above_tail = ordered_sum(high, -1.0)
    below, below_tail = ordered_sum(high, 1.0)
    quotient, rest = divided(above, above_tail + low, below, below_tail + low)
    far = quotient + rest
    return choose(x == x, signed(choose(size < 0.25, near, far), x), NAN)


def hypot(x: Number, y: Number) -> Number:
    """Distance of the point (x, y) from the origin, without overflow of the squares."""
    width, height = absolute(x), absolute(y)
    larger, smaller = choose(width > height, width, height), choose(width > height, height, width)
    within = (larger < 2.0**500) & (smaller > 2.0**-450)
    return usually(within, lambda: length(larger, smaller), lambda: hypot_anywhere(x, y))


def length(a: Number, b: Number) -> Number:
    """Return sqrt(a**2 + b**2) for a >= b > 0."""
    square, lost = exact_product(a, a)
    added, more = exact_product(b, b)
    total, rest = ordered_sum(square, added)
    root = sqrt(total)
    product, taken = exact_product(root, root)
    return root + (((total - product) - taken) + (rest + (lost + more))) / (root + root)


def hypot_anywhere(x: Number, y: Number) -> Number:
    """Distance of any point from the origin, computed after scaling to about 1."""
    width, height = absolute(x), absolute(y)
    larger, smaller = choose(width > height, width, height), choose(width > height, height, width)
    usable = (larger > 0.0) & (larger < INF) & (smaller == smaller)
    larger, smaller = choose(usable, larger, 1.0), choose(usable, smaller, 0.0)
    k = exponent_of(larger)
    scale = power_of_two(0 - k)
    unusual = choose((width == INF) | (height == INF), INF, choose((x == x) & (y == y), 0.0, NAN))
    return choose(usable, scaled(length(larger * scale, smaller * scale), k), unusual)


PAIRS = {"sin": ("sin_cos", 0), "cos": ("sin_cos", 1)}  # functions that are cheaper when computed together
TOGETHER: dict[str, Callable[[Number], tuple[Number, ...]]] = {"sin_cos": sin_cos}
FUNCTIONS: dict[str, Callable[..., Number]] = {
    "sin": sin, "cos": cos, "tan": tan, "asin": asin, "acos": acos, "atan": atan, "atan2": atan2, "sinh": sinh,
    "cosh": cosh, "tanh": tanh, "exp": exp, "log": log, "power": power, "hypot": hypot,
}  # fmt: skip
