"""Exponentials, logarithms, powers, hyperbolic functions and the length of a pair; see `functions`."""

from __future__ import annotations

from xdynamics.elementary.numbers import (
    FRACTION,
    INF,
    MAGIC,
    MAGIC_BITS,
    NAN,
    ONE,
    Integer,
    Number,
    Truth,
    absolute,
    bits,
    choose,
    divide_with_tails,
    exact_product,
    exact_sum,
    exponent_of,
    number,
    ordered_sum,
    polynomial,
    power_of_two,
    round_to_integer,
    signed,
    sqrt,
    table_entry,
    upper,
    usually,
)

SIGN = -(1 << 63)
SMALLEST_NORMAL, INFINITE = 1 << 52, 2047 << 52  # as bits
LARGE_EXPONENT = 0x4086200000000000  # 708
LOG2_128 = 184.6649652337873  # 128/log(2)
# log(2)/128: 34 bits, whose products with 18 are exact; the rest
STEP, STEP_TAIL = 0.005415212347998022, 1.2655086083325438e-13
LOG2, LOG2_TAIL = 0.6931471805598903, 5.497923018708371e-14  # log(2): 42 bits after the point; the rest
LOG = (-1 / 2, 1 / 3, -1 / 4, 1 / 5, -1 / 6, 1 / 7, -1 / 8, 1 / 9)  # of log(1 + r), from r**2 on

# fitted at Chebyshev's points to (f(x)/x - 1)/x**2 by tests/elementary_tables.py
SINH = (0.16666666666666666, 0.008333333333333333, 0.00019841269841269773, 2.755731922404034e-06, 2.505210836405804e-08, 1.6059048396350562e-10, 7.646625361656657e-13, 2.8445264169895285e-15)  # fmt: skip
TANH = (-0.3333333333333333, 0.13333333333333333, -0.05396825396825387, 0.021869488536134365, -0.008863235527730825, 0.0035921279064936957, -0.001455829636195592, 0.0005899197816047852, -0.00023764750063180886, 8.548775370045155e-05)  # fmt: skip


def scaled_exponential(x: Number, tail: Number) -> tuple[Number, Number, Integer]:
    """Return exp(x + tail)/2**k, between 1 and 2, as a number and a small one to be added, and k; |x| < 800."""
    # exp(x) is 2**k 2**(i/128) exp(r), where n = 128 k + i and r is at most log(2)/256 (Tang 1989)
    steps, n = round_to_integer(x * LOG2_128)
    r = ((x - steps * STEP) - steps * STEP_TAIL) + tail
    higher = (r * r) * (0.5 + r * (0.16666666666666666 + r * (0.041666666666666664 + r * 0.008333333333333333)))
    table_index = n & 127
    root = table_entry("root", table_index)
    return root, root * (r + (higher + table_entry("root_tail", table_index))), n >> 7


def scale_by_power(x: Number, k: Integer) -> Number:
    """Return x 2**k, in two steps, since it may overflow or be subnormal."""
    half = k >> 1
    return (x * power_of_two(half)) * power_of_two(k - half)


def clipped(x: Number, limit: float) -> Number:
    """Return x clipped to plus or minus the limit; for nan, a limit."""
    return choose(x > limit, limit, choose(x > -limit, x, -limit))


def exp(x: Number) -> Number:
    """Exponential function."""
    # bits of positive numbers are in the order of the numbers, with infinity and nan above all
    is_normal = (bits(x) & ~SIGN) < LARGE_EXPONENT
    return usually(is_normal, lambda: normal_exp(x, 0.0), lambda: exp_anywhere(x))


def normal_exp(x: Number, tail: Number) -> Number:
    """Return exp(x + tail), a normal number."""
    root, more, k = scaled_exponential(x, tail)
    return (root + more) * power_of_two(k)


def exp_anywhere(x: Number) -> Number:
    """Exponential function where the result may be infinite, subnormal or nan."""
    root, more, k = scaled_exponential(clipped(x, 800.0), 0.0)
    return choose(x == x, scale_by_power(root + more, k), NAN)


def split_mantissa(x: Number) -> tuple[Number, Integer, Number, Number]:
    """Write a normal x > 0 as 2**k (1 + r)/c with c from a table: return k, the index of c, and r in two parts."""
    word = bits(x)
    fraction = word & FRACTION
    # the seven leading bits of the fraction, rounded: from 0 to 128
    table_index = (fraction + (1 << 44)) >> 45
    # the distance from the center has 44 bits, and c has 9: both the difference and the product are exact
    part = (number(fraction | ONE) - table_entry("center", table_index)) * table_entry("inverse", table_index)
    return number((word >> 52) + (MAGIC_BITS - 1023)) - MAGIC, table_index, part, table_entry("offset", table_index)


def log(x: Number) -> Number:
    """Natural logarithm; -inf at 0, nan below."""
    word = bits(x)
    normal = (word >= SMALLEST_NORMAL) & (word < INFINITE)
    return usually(normal, lambda: log_of_split(*split_mantissa(x)), lambda: log_anywhere(x))


def log_of_split(k: Number, table_index: Integer, part: Number, offset: Number) -> Number:
    """Natural logarithm of a split number."""
    r = part + offset
    base = k * LOG2 + table_entry("log", table_index)
    # base is 0 or larger than r, as Dekker's sum needs them
    high, lost = ordered_sum(base, r)
    tail = k * LOG2_TAIL + table_entry("log_tail", table_index)
    return high + (lost + (tail + (r * r) * polynomial(r, LOG[:6])))


def log_anywhere(x: Number) -> Number:
    """Natural logarithm of anything but a positive normal number."""
    # of numbers that are not normal, those in between are the subnormal ones
    small = (x > 0.0) & (x < 1.0)
    k, *mantissa_parts = split_mantissa(choose(small, x * 2.0**54, 1.0))
    return choose(small, log_of_split(k - 54.0, *mantissa_parts), choose(x == 0.0, -INF, choose(x > 0.0, x, NAN)))


def logarithm(k: Number, table_index: Integer, part: Number, offset: Number) -> tuple[Number, Number]:
    """Return the logarithm of a split number in double the precision, as two numbers."""
    r, r_tail = exact_sum(offset, part)
    r_upper = upper(r)
    square, square_tail = 0.5 * (r_upper * r_upper), (r - r_upper) * (0.5 * (r + r_upper))
    base, tail = k * LOG2 + table_entry("log", table_index), k * LOG2_TAIL + table_entry("log_tail", table_index)
    high, lost = exact_sum(base, r)
    high, more = ordered_sum(high, -square)
    higher = (r * (r * r)) * polynomial(r, LOG[1:])
    return ordered_sum(high, (lost + more) + ((r_tail * (1.0 - r) - square_tail) + (higher + tail)))


def power(x: Number, y: Number) -> Number:
    """Return x**y; nan below zero unless y is whole."""
    word = bits(x)
    normal = (word >= SMALLEST_NORMAL) & (word < INFINITE)
    high, low = logarithm(*split_mantissa(x))
    product, lost = exact_product(y, high)
    is_normal = normal & (absolute(product) < 708.0) & (absolute(y) < 2.0**70)
    return usually(is_normal, lambda: normal_exp(product, lost + y * low), lambda: power_anywhere(x, y))


def power_anywhere(x: Number, y: Number) -> Number:
    """Return x**y for any two numbers, as IEEE 754 asks."""
    size = absolute(x)
    usable = (size > 0.0) & (size < INF)
    small = size < 2.0**-1022
    k, *mantissa_parts = split_mantissa(choose(usable, choose(small, size * 2.0**54, size), 1.0))
    high, low = logarithm(choose(usable & small, k - 54.0, k), *mantissa_parts)
    far = clipped(y, 2.0**70)  # a larger product would overflow, where the result has long done so
    product, lost = exact_product(far, high)
    product, lost = ordered_sum(product, lost + far * low)
    in_range = absolute(product) < 800.0
    root, more, k = scaled_exponential(choose(in_range, product, 0.0), choose(in_range, lost, 0.0))
    result = choose(in_range, scale_by_power(root + more, k), choose(product > 0.0, INF, 0.0))
    nothing, endless = size == 0.0, size == INF
    result = choose(nothing | endless, choose((y > 0.0) == nothing, 0.0, INF), result)
    is_whole, odd = wholeness(y)
    result = choose((bits(x) < 0) & odd, -result, result)
    # powers of -inf that are not whole are those of inf, by IEEE 754
    result = choose((x < 0.0) & (size < INF), choose(is_whole, result, NAN), result)
    result = choose((x == x) & (y == y), result, NAN)
    # last, as IEEE 754 gives 1 even where the other number is nan
    return choose((y == 0.0) | (x == 1.0), 1.0, result)


def wholeness(y: Number) -> tuple[Truth, Truth]:
    """Return whether a non-zero number is whole, and whether it is odd."""
    word = bits(absolute(y))
    places = 1075 - (word >> 52)  # after the point
    has_fraction_bits = (places > 0) & (places <= 52)
    shift = choose(has_fraction_bits, places, 0)
    mantissa = (word & FRACTION) | (1 << 52)
    is_whole = (((mantissa >> shift) << shift) == mantissa) & (places <= 52)
    # from 2**53 on, where places are negative, all numbers are even
    return is_whole, is_whole & (((mantissa >> shift) & 1) == 1) & (places >= 0)


def half_exponentials(size: Number) -> tuple[Number, Number, Number, Number]:
    """Return exp(size)/2 and exp(-size)/2, each as a number and its tail."""
    root, more, k = scaled_exponential(choose(size < 800.0, size, 800.0), 0.0)
    high, low = ordered_sum(root, more)
    high, low = scale_by_power(high, k - 1), scale_by_power(low, k - 1)
    # 1/(4 (high + low)) to first order in low, which is enough for a tail
    inverse = 0.25 / high
    return high, low, inverse, -4.0 * (inverse * inverse) * low


def cosh(x: Number) -> Number:
    """Hyperbolic cosine."""
    high, low, inverse, inverse_tail = half_exponentials(absolute(x))
    # where the exponential overflows, the rounding error of the sum is inf - inf
    total, lost = ordered_sum(high, inverse)
    return choose(x == x, choose(total < INF, total + (lost + (low + inverse_tail)), INF), NAN)


def sinh(x: Number) -> Number:
    """Hyperbolic sine."""
    size = absolute(x)
    u = x * x
    near = x + x * (u * polynomial(u, SINH))
    high, low, inverse, inverse_tail = half_exponentials(size)
    total, lost = ordered_sum(high, -inverse)
    far = choose(total < INF, total + (lost + (low - inverse_tail)), INF)
    return choose(x == x, signed(choose(size < 1.0, near, far), x), NAN)


def tanh(x: Number) -> Number:
    """Hyperbolic tangent."""
    size = absolute(x)
    u = x * x
    near = x + x * (u * polynomial(u, TANH))
    # from exp(50) on the quotient rounds to 1
    root, more, k = scaled_exponential(clipped(2.0 * size, 50.0), 0.0)
    high, low = ordered_sum(root, more)
    high, low = scale_by_power(high, k), scale_by_power(low, k)
    above, above_tail = ordered_sum(high, -1.0)
    below, below_tail = ordered_sum(high, 1.0)
    quotient, quotient_tail = divide_with_tails(above, above_tail + low, below, below_tail + low)
    far = quotient + quotient_tail
    return choose(x == x, signed(choose(size < 0.25, near, far), x), NAN)


def hypot(x: Number, y: Number) -> Number:
    """Distance of the point (x, y) from the origin, without overflow of the squares."""
    width, height = absolute(x), absolute(y)
    larger, smaller = choose(width > height, width, height), choose(width > height, height, width)
    # there the squares and their rounding errors are normal numbers
    in_range = (larger < 2.0**500) & (smaller > 2.0**-450)
    return usually(in_range, lambda: length(larger, smaller), lambda: hypot_anywhere(x, y))


def length(a: Number, b: Number) -> Number:
    """Return sqrt(a**2 + b**2) for a >= b > 0."""
    square, lost = exact_product(a, a)
    added, more = exact_product(b, b)
    total, sum_error = ordered_sum(square, added)
    root = sqrt(total)
    product, square_error = exact_product(root, root)
    # one step of Newton's method, with the remainder of the square to twice the digits
    return root + (((total - product) - square_error) + (sum_error + (lost + more))) / (root + root)


def hypot_anywhere(x: Number, y: Number) -> Number:
    """Distance of any point from the origin, computed after scaling to about 1."""
    width, height = absolute(x), absolute(y)
    larger, smaller = choose(width > height, width, height), choose(width > height, height, width)
    usable = (larger > 0.0) & (larger < INF) & (smaller == smaller)
    larger, smaller = choose(usable, larger, 1.0), choose(usable, smaller, 0.0)
    k = exponent_of(larger)
    scale = power_of_two(0 - k)
    # infinite even where the other number is nan, by IEEE 754
    unusual = choose((width == INF) | (height == INF), INF, choose((x == x) & (y == y), 0.0, NAN))
    return choose(usable, scale_by_power(length(larger * scale, smaller * scale), k), unusual)
