"""Elementary functions of 31 digits, to 100 bits.

Reduction and Taylor series: Hida, Li, Bailey 2001, doi:10.1109/ARITH.2001.930115, with series in place of their tables;
inverse functions correct the float's by one step of Newton's method, which doubles its digits.
"""

from __future__ import annotations

from collections.abc import Callable

from xdynamics.elementary import circular, exponential
from xdynamics.elementary.double_double.constants import (
    HALF_PI_PARTS,
    INVERSE_FACTORIALS,
    INVERSE_ODD,
    LOG2,
    LOG2_PARTS,
)
from xdynamics.elementary.double_double.sums import (
    ONE,
    DoubleDouble,
    absolute_value,
    add,
    chosen,
    divide,
    exact,
    multiply,
    negative,
    polynomial,
    scaled,
    sqrt,
    subtract,
)
from xdynamics.elementary.numbers import (
    INF,
    Number,
    Truth,
    Whole,
    absolute,
    choose,
    exact_product,
    exact_sum,
    exponent_of,
    power_of_two,
    rounded,
)

DOUBLINGS = 9
LOG2_E = 1.4426950408889634
LARGEST_TURNS = 2.0**19  # of reduction by parts of pi/2; beyond, by the digits of 2/pi
EXP_RANGE = 708.0  # arguments whose exponentials, and their rests, are normal numbers
ROOT_HALF = 0.7071067811865476


def _or_float(usual: Truth, found: DoubleDouble, unusual: Number) -> DoubleDouble:
    """Return a result, and where it is infinite, zero or nan that of floats."""
    return DoubleDouble(choose(usual, found.high, unusual), choose(usual, found.low, 0.0))


# ------------------------------------------------------------------------------------------------------- exponentials


def exp(x: DoubleDouble) -> DoubleDouble:
    """Exponential function."""
    usual = absolute(x.high) < EXP_RANGE
    held = DoubleDouble(choose(usual, x.high, 0.0), choose(usual, x.low, 0.0))
    growth, k = _growth(held)
    return _or_float(usual, scaled(growth, power_of_two(k)), exponential.exp(x.high))


def _growth(x: DoubleDouble) -> tuple[DoubleDouble, Whole]:
    """Return exp(x)/2**k, between 0.7 and 1.5, and k."""
    turns, k = rounded(x.high * LOG2_E)
    first, second, third = LOG2_PARTS
    rest = add(DoubleDouble(x.high - turns * first, x.low), exact(-(turns * second)))
    rest = scaled(add(rest, exact(-(turns * third))), 2.0**-DOUBLINGS)
    less_one = multiply(rest, polynomial(rest, INVERSE_FACTORIALS[1:11]))
    for _ in range(DOUBLINGS):  # exp(2 r) - 1 from exp(r) - 1
        less_one = add(scaled(less_one, 2.0), multiply(less_one, less_one))
    return add(ONE, less_one), k


def log(x: DoubleDouble) -> DoubleDouble:
    """Natural logarithm; -inf at 0, nan below."""
    usual = (x.high >= 2.0**-969) & (x.high < INF)
    held = DoubleDouble(choose(usual, x.high, 1.0), choose(usual, x.low, 0.0))
    k = exponent_of(held.high)
    fraction = scaled(held, power_of_two(0 - k))
    above = fraction.high > 2.0 * ROOT_HALF
    fraction = scaled(fraction, choose(above, 0.5, 1.0))
    k = choose(above, k + 1, k)
    # log((1 + z)/(1 - z)) = 2 (z + z**3/3 + …)
    z = divide(subtract(fraction, ONE), add(fraction, ONE))
    series = multiply(scaled(z, 2.0), polynomial(multiply(z, z), INVERSE_ODD[:22]))
    found = add(multiply(exact(_whole(k)), LOG2), series)
    return _or_float(usual, found, exponential.log(x.high))


def _whole(k: Whole) -> Number:
    from xdynamics.elementary.numbers import whole_number

    return whole_number(k)


def power(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x**y; accurate to 2**-100 times the size of y log(x); nan below zero unless y is whole."""
    product = multiply(y, log(absolute_value(x)))
    usual = (absolute(product.high) < EXP_RANGE) & (x.high != 0.0) & (absolute(x.high) < INF)
    plain = exponential.power(x.high, y.high)
    found = exp(DoubleDouble(choose(usual, product.high, 0.0), choose(usual, product.low, 0.0)))
    found = chosen(plain < 0.0, negative(found), found)
    return _or_float(usual & (plain == plain), found, plain)


def _halves(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Return exp(x)/2 and exp(-x)/2."""
    growth = exp(x)
    return scaled(growth, 0.5), divide(DoubleDouble(choose(growth.high == 0.0, INF, 0.5), 0.0), growth)


def cosh(x: DoubleDouble) -> DoubleDouble:
    """Hyperbolic cosine."""
    usual = absolute(x.high) < EXP_RANGE
    return _or_float(usual, add(*_halves(_held(usual, x))), exponential.cosh(x.high))


def sinh(x: DoubleDouble) -> DoubleDouble:
    """Hyperbolic sine."""
    usual = absolute(x.high) < EXP_RANGE
    held = _held(usual, x)
    near = multiply(held, polynomial(multiply(held, held), INVERSE_FACTORIALS[1:27:2]))
    return _or_float(usual, chosen(absolute(x.high) < 0.5, near, subtract(*_halves(held))), exponential.sinh(x.high))


def tanh(x: DoubleDouble) -> DoubleDouble:
    """Hyperbolic tangent."""
    usual = absolute(x.high) < 40.0
    held = _held(usual, x)
    return _or_float(usual, divide(sinh(held), cosh(held)), exponential.tanh(x.high))


def _held(usual: Truth, x: DoubleDouble, instead: float = 0.0) -> DoubleDouble:
    """Return a number, or another where it is unusual."""
    return DoubleDouble(choose(usual, x.high, instead), choose(usual, x.low, 0.0))


def hypot(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Distance of the point (x, y) from the origin, without overflow of the squares."""
    width, height = absolute(x.high), absolute(y.high)
    larger = choose(width > height, width, height)
    usual = (larger > 0.0) & (larger < INF) & (x.high == x.high) & (y.high == y.high)
    k = exponent_of(choose(usual, larger, 1.0))
    down, up = power_of_two(0 - k), power_of_two(k)
    first, second = (scaled(_held(usual, number), down) for number in (x, y))
    length = sqrt(add(multiply(first, first), multiply(second, second)))
    return _or_float(usual, scaled(length, up), exponential.hypot(x.high, y.high))


# ------------------------------------------------------------------------------------------------------------- angles


def _reduced(x: DoubleDouble) -> tuple[DoubleDouble, Whole]:
    """Return x - n pi/2, between -pi/4 and pi/4, and n, of which only the last two bits count."""
    turns, n = rounded(choose(absolute(x.high) < 2.0**50, x.high, 0.0) * circular.TWO_OVER_PI)
    near = absolute(turns) < LARGEST_TURNS
    turns = choose(near, turns, 0.0)
    first, second, third, fourth = HALF_PI_PARTS
    rest = DoubleDouble(*exact_sum(x.high - turns * first, -(turns * second)))
    rest = add(rest, DoubleDouble(*exact_sum(-(turns * third), x.low)))
    rest = subtract(rest, DoubleDouble(*exact_product(turns, fourth)))
    high, low, far = circular.reduced_exactly(x.high)
    beyond = add(DoubleDouble(high, low), exact(x.low))
    return chosen(near, rest, beyond), choose(near, n, far)


def sin_cos(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Sine and cosine of an angle in radians."""
    usual = (x.high - x.high) == 0.0
    rest, n = _reduced(_held(usual, x))
    square = negative(multiply(rest, rest))
    sine = multiply(rest, polynomial(square, INVERSE_FACTORIALS[1:31:2]))
    cosine = polynomial(square, INVERSE_FACTORIALS[0:31:2])
    swapped = (n & 1) == 1
    sine, cosine = chosen(swapped, cosine, sine), chosen(swapped, sine, cosine)
    sine = chosen((n & 2) == 2, negative(sine), sine)
    cosine = chosen(((n + 1) & 2) == 2, negative(cosine), cosine)
    return _or_float(usual, sine, x.high - x.high), _or_float(usual, cosine, x.high - x.high)


def sin(x: DoubleDouble) -> DoubleDouble:
    """Sine of an angle in radians."""
    return sin_cos(x)[0]


def cos(x: DoubleDouble) -> DoubleDouble:
    """Cosine of an angle in radians."""
    return sin_cos(x)[1]


def tan(x: DoubleDouble) -> DoubleDouble:
    """Tangent of an angle in radians."""
    return divide(*sin_cos(x))


def atan2(y: DoubleDouble, x: DoubleDouble) -> DoubleDouble:
    """Angle of the point (x, y) from the positive x axis, between -pi and pi."""
    plain = circular.atan2(y.high, x.high)
    width, height = absolute(x.high), absolute(y.high)
    larger = choose(width > height, width, height)
    usual = (larger > 0.0) & (larger < INF) & (plain == plain)
    down = power_of_two(0 - exponent_of(choose(usual, larger, 1.0)))
    across, along = (scaled(_held(usual, number), down) for number in (y, x))
    sine, cosine = sin_cos(exact(choose(usual, plain, 0.0)))
    # what is left is an angle of some 1e-16, which is its own tangent
    top = subtract(multiply(across, cosine), multiply(along, sine))
    below = add(multiply(along, cosine), multiply(across, sine))
    below = chosen(usual, below, ONE)
    return _or_float(usual, add(exact(plain), divide(top, below)), plain)


def atan(x: DoubleDouble) -> DoubleDouble:
    """Angle between -pi/2 and pi/2 with this tangent."""
    return atan2(x, ONE)


def _leg(x: DoubleDouble) -> DoubleDouble:
    """Return sqrt(1 - x**2)."""
    return sqrt(multiply(subtract(ONE, x), add(ONE, x)))


def asin(x: DoubleDouble) -> DoubleDouble:
    """Angle between -pi/2 and pi/2 with this sine."""
    return atan2(x, _leg(x))


def acos(x: DoubleDouble) -> DoubleDouble:
    """Angle between 0 and pi with this cosine."""
    return atan2(_leg(x), x)


FUNCTIONS: dict[str, Callable[..., DoubleDouble]] = {
    "sin": sin,
    "cos": cos,
    "tan": tan,
    "asin": asin,
    "acos": acos,
    "atan": atan,
    "atan2": atan2,
    "sinh": sinh,
    "cosh": cosh,
    "tanh": tanh,
    "exp": exp,
    "log": log,
    "power": power,
    "hypot": hypot,
}
