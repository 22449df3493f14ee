"""Elementary functions of 31 digits, to 100 bits.

Reduction and Taylor series: Hida, Li, Bailey 2001, doi:10.1109/ARITH.2001.930115, with series in place of their tables;
inverse functions correct the float's by one step of Newton's method, which doubles its digits.

Constants are computed from their decimal digits, coefficients from fractions. `DoubleDoubles` gives the operations of
programs for sums of two floats, by the names that they have for floats.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import factorial
from typing import Any

from xdynamics.elementary import circular, exponential
from xdynamics.elementary.double_double import sums
from xdynamics.elementary.double_double.sums import (
    ONE,
    DoubleDouble,
    absolute_value,
    add,
    choose_sum,
    divide,
    exact,
    multiply,
    nearest,
    negated,
    polynomial_of_sums,
    scaled_by_power,
    split_fraction,
    sqrt,
    subtract,
)
from xdynamics.elementary.numbers import (
    INF,
    Integer,
    Number,
    Truth,
    absolute,
    choose,
    exact_product,
    exact_sum,
    exponent_of,
    power_of_two,
    round_to_integer,
)

# Abramowitz and Stegun, table 1.1, continued; compared with mpmath by the tests
PI_DIGITS = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534")
LOG2_DIGITS = Fraction("0.69314718055994530941723212145817656807550013436025525412068000949339362196969471560586332700")

PI = nearest(PI_DIGITS)
LOG2 = nearest(LOG2_DIGITS)
LOG2_PARTS = split_fraction(LOG2_DIGITS, 42, 42)  # whose products with 11 bits are exact
HALF_PI_PARTS = split_fraction(PI_DIGITS / 2, 33, 33, 33)  # with 20 bits

INVERSE_FACTORIALS = tuple(nearest(Fraction(1, factorial(k))) for k in range(31))
INVERSE_ODD = tuple(nearest(Fraction(1, 2 * k + 1)) for k in range(24))


DOUBLINGS = 9
LOG2_E = 1.4426950408889634
LARGEST_TURNS = 2.0**19  # of reduction by parts of pi/2; beyond, by the digits of 2/pi
EXP_RANGE = 708.0  # arguments whose exponentials, and their rests, are normal numbers
ROOT_HALF = 0.7071067811865476


def _precise_or_float(usual: Truth, precise: DoubleDouble, unusual: Number) -> DoubleDouble:
    """Return a result, and where it is infinite, zero or nan that of floats."""
    return DoubleDouble(choose(usual, precise.high, unusual), choose(usual, precise.low, 0.0))


# ------------------------------------------------------------------------------------------------------- exponentials


def exp(x: DoubleDouble) -> DoubleDouble:
    """Exponential function."""
    usual = absolute(x.high) < EXP_RANGE
    usual_argument = DoubleDouble(choose(usual, x.high, 0.0), choose(usual, x.low, 0.0))
    growth, k = _scaled_exponential(usual_argument)
    return _precise_or_float(usual, scaled_by_power(growth, power_of_two(k)), exponential.exp(x.high))


def _scaled_exponential(x: DoubleDouble) -> tuple[DoubleDouble, Integer]:
    """Return exp(x)/2**k, between 0.7 and 1.5, and k."""
    turns, k = round_to_integer(x.high * LOG2_E)
    first, second, third = LOG2_PARTS
    remainder = add(DoubleDouble(x.high - turns * first, x.low), exact(-(turns * second)))
    remainder = scaled_by_power(add(remainder, exact(-(turns * third))), 2.0**-DOUBLINGS)
    less_one = multiply(remainder, polynomial_of_sums(remainder, INVERSE_FACTORIALS[1:11]))
    for _ in range(DOUBLINGS):  # exp(2 r) - 1 from exp(r) - 1
        less_one = add(scaled_by_power(less_one, 2.0), multiply(less_one, less_one))
    return add(ONE, less_one), k


def log(x: DoubleDouble) -> DoubleDouble:
    """Natural logarithm; -inf at 0, nan below."""
    # below, the rest is a subnormal number, which lacks digits
    usual = (x.high >= 2.0**-969) & (x.high < INF)
    usual_argument = DoubleDouble(choose(usual, x.high, 1.0), choose(usual, x.low, 0.0))
    k = exponent_of(usual_argument.high)
    fraction = scaled_by_power(usual_argument, power_of_two(0 - k))
    # between sqrt(1/2) and sqrt(2) z is at most 0.172, and the 22 terms reach beyond 106 bits
    above = fraction.high > 2.0 * ROOT_HALF
    fraction = scaled_by_power(fraction, choose(above, 0.5, 1.0))
    k = choose(above, k + 1, k)
    # log((1 + z)/(1 - z)) = 2 (z + z**3/3 + …)
    z = divide(subtract(fraction, ONE), add(fraction, ONE))
    series = multiply(scaled_by_power(z, 2.0), polynomial_of_sums(multiply(z, z), INVERSE_ODD[:22]))
    precise = add(multiply(exact(_integer_as_float(k)), LOG2), series)
    return _precise_or_float(usual, precise, exponential.log(x.high))


def _integer_as_float(k: Integer) -> Number:
    from xdynamics.elementary.numbers import whole_number

    return whole_number(k)


def power(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x**y; accurate to 2**-100 times the size of y log(x); nan below zero unless y is whole."""
    product = multiply(y, log(absolute_value(x)))
    usual = (absolute(product.high) < EXP_RANGE) & (x.high != 0.0) & (absolute(x.high) < INF)
    plain = exponential.power(x.high, y.high)
    precise = exp(DoubleDouble(choose(usual, product.high, 0.0), choose(usual, product.low, 0.0)))
    precise = choose_sum(plain < 0.0, negated(precise), precise)
    return _precise_or_float(usual & (plain == plain), precise, plain)


def _halves(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Return exp(x)/2 and exp(-x)/2."""
    growth = exp(x)
    return scaled_by_power(growth, 0.5), divide(DoubleDouble(choose(growth.high == 0.0, INF, 0.5), 0.0), growth)


def cosh(x: DoubleDouble) -> DoubleDouble:
    """Hyperbolic cosine."""
    usual = absolute(x.high) < EXP_RANGE
    return _precise_or_float(usual, add(*_halves(_replace_unusual(usual, x))), exponential.cosh(x.high))


def sinh(x: DoubleDouble) -> DoubleDouble:
    """Hyperbolic sine."""
    usual = absolute(x.high) < EXP_RANGE
    usual_argument = _replace_unusual(usual, x)
    # near zero the difference of exponentials cancels
    near = multiply(
        usual_argument, polynomial_of_sums(multiply(usual_argument, usual_argument), INVERSE_FACTORIALS[1:27:2])
    )
    return _precise_or_float(
        usual, choose_sum(absolute(x.high) < 0.5, near, subtract(*_halves(usual_argument))), exponential.sinh(x.high)
    )


def tanh(x: DoubleDouble) -> DoubleDouble:
    """Hyperbolic tangent."""
    # from 40 on it is 1 to 34 digits
    usual = absolute(x.high) < 40.0
    usual_argument = _replace_unusual(usual, x)
    return _precise_or_float(usual, divide(sinh(usual_argument), cosh(usual_argument)), exponential.tanh(x.high))


def _replace_unusual(usual: Truth, x: DoubleDouble, instead: float = 0.0) -> DoubleDouble:
    """Return a number, or another where it is unusual."""
    return DoubleDouble(choose(usual, x.high, instead), choose(usual, x.low, 0.0))


def hypot(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Distance of the point (x, y) from the origin, without overflow of the squares."""
    width, height = absolute(x.high), absolute(y.high)
    larger = choose(width > height, width, height)
    usual = (larger > 0.0) & (larger < INF) & (x.high == x.high) & (y.high == y.high)
    k = exponent_of(choose(usual, larger, 1.0))
    down, up = power_of_two(0 - k), power_of_two(k)
    first, second = (scaled_by_power(_replace_unusual(usual, number), down) for number in (x, y))
    length = sqrt(add(multiply(first, first), multiply(second, second)))
    return _precise_or_float(usual, scaled_by_power(length, up), exponential.hypot(x.high, y.high))


# ------------------------------------------------------------------------------------------------------------- angles


def _reduce_angle(x: DoubleDouble) -> tuple[DoubleDouble, Integer]:
    """Return x - n pi/2, between -pi/4 and pi/4, and n, of which only the last two bits count."""
    turns, n = round_to_integer(choose(absolute(x.high) < 2.0**50, x.high, 0.0) * circular.TWO_OVER_PI)
    near = absolute(turns) < LARGEST_TURNS
    turns = choose(near, turns, 0.0)
    first, second, third, fourth = HALF_PI_PARTS
    remainder = DoubleDouble(*exact_sum(x.high - turns * first, -(turns * second)))
    remainder = add(remainder, DoubleDouble(*exact_sum(-(turns * third), x.low)))
    remainder = subtract(remainder, DoubleDouble(*exact_product(turns, fourth)))
    high, low, far = circular.reduce_exactly(x.high)
    beyond = add(DoubleDouble(high, low), exact(x.low))
    return choose_sum(near, remainder, beyond), choose(near, n, far)


def sin_cos(x: DoubleDouble) -> tuple[DoubleDouble, DoubleDouble]:
    """Sine and cosine of an angle in radians."""
    usual = (x.high - x.high) == 0.0
    remainder, n = _reduce_angle(_replace_unusual(usual, x))
    square = negated(multiply(remainder, remainder))
    sine = multiply(remainder, polynomial_of_sums(square, INVERSE_FACTORIALS[1:31:2]))
    cosine = polynomial_of_sums(square, INVERSE_FACTORIALS[0:31:2])
    swapped = (n & 1) == 1
    sine, cosine = choose_sum(swapped, cosine, sine), choose_sum(swapped, sine, cosine)
    sine = choose_sum((n & 2) == 2, negated(sine), sine)
    cosine = choose_sum(((n + 1) & 2) == 2, negated(cosine), cosine)
    return _precise_or_float(usual, sine, x.high - x.high), _precise_or_float(usual, cosine, x.high - x.high)


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
    scaled_y, scaled_x = (scaled_by_power(_replace_unusual(usual, number), down) for number in (y, x))
    sine, cosine = sin_cos(exact(choose(usual, plain, 0.0)))
    # what is left is an angle of some 1e-16, which is its own tangent
    top = subtract(multiply(scaled_y, cosine), multiply(scaled_x, sine))
    below = add(multiply(scaled_x, cosine), multiply(scaled_y, sine))
    below = choose_sum(usual, below, ONE)
    return _precise_or_float(usual, add(exact(plain), divide(top, below)), plain)


def atan(x: DoubleDouble) -> DoubleDouble:
    """Angle between -pi/2 and pi/2 with this tangent."""
    return atan2(x, ONE)


def _leg(x: DoubleDouble) -> DoubleDouble:
    """Return sqrt(1 - x**2)."""
    # keeps the digits that 1 - x**2 loses near 1
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


RULES: Mapping[str, Callable[..., Any]] = {
    "add": sums.add,
    "subtract": sums.subtract,
    "multiply": sums.multiply,
    "divide": sums.divide,
    "less": sums.is_less,
    "at_most": sums.at_most,
    "more": lambda x, y: sums.is_less(y, x),
    "at_least": lambda x, y: sums.at_most(y, x),
    "equal": sums.equal,
    "unequal": lambda x, y: (x.high != y.high) | (x.low != y.low),
    "negative": sums.negated,
    "abs": sums.absolute_value,
    "sqrt": sums.sqrt,
    "choose": sums.choose_sum,
    "sign": sums.sign_of_sum,
    "least": sums.minimum_of_sums,
    "greatest": sums.maximum_of_sums,
    "positive": sums.positive_sum,
    "floor": sums.floor_of_sum,
    "ceil": sums.ceiling_of_sum,
    "round": sums.nearest_integer,
    "mod": sums.modulo_of_sums,
    "newest": lambda _, new: new,
    # between sums and floats
    "joined": DoubleDouble,
    "exact": sums.exact,
    "added": lambda x, y: DoubleDouble(*exact_sum(x, y)),
    "high": lambda x: x.high,
    "low": lambda x: x.low,
}

# operations that programs of sums call; written out, one of ten lines would be one of two hundred
CALLED = {
    name: RULES[name] for name in ("add", "subtract", "multiply", "divide", "sqrt", "floor", "ceil", "round", "mod")
}


@dataclass(frozen=True)
class DoubleDoubles:
    """The operations.

    Parameters
    ----------
    functions : mapping of str to callable
        The elementary functions; where programs are written, calls of them and of what is long of `RULES`.
    """

    functions: Mapping[str, Callable[..., DoubleDouble]] = field(default_factory=lambda: FUNCTIONS)

    def of(self, operation: str, *arguments: DoubleDouble | Number | Truth) -> Any:
        """Return the result of an operation."""
        return (self.functions.get(operation) or RULES[operation])(*arguments)
