"""Arithmetic of double-doubles: unevaluated sums of two floats, accurate to some 31 digits.

The second float is at most half a unit in the last place of the first. A sum is accurate to 2**-102, a product to
2**-102, a quotient and a root to 2**-101 of the result: Joldes, Muller, Popescu 2017, ACM TOMS 44, 15res,
doi:10.1145/3121432, algorithms 6, 12 and 17; the root is one step of Newton's method (Dekker 1971,
doi:10.1007/BF01397083). Written, as all that is elementary, for floats, arrays and lines of a program alike, without a
fused operation.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import NamedTuple

from xdynamics.elementary.numbers import (
    Number,
    Truth,
    absolute,
    choose,
    exact_product,
    exact_sum,
    ordered_sum,
    quotient,
)
from xdynamics.elementary.numbers import floor as floor_of
from xdynamics.elementary.numbers import round_half_even as nearest_whole
from xdynamics.elementary.numbers import sign as sign_of
from xdynamics.elementary.numbers import sqrt as root_of


class DoubleDouble(NamedTuple):
    """The nearest float, and the rest."""

    high: Number
    low: Number


ZERO, ONE = DoubleDouble(0.0, 0.0), DoubleDouble(1.0, 0.0)


def nearest(value: Fraction) -> DoubleDouble:
    """Return the sum of two floats that is nearest to a fraction."""
    high = float(value)
    return DoubleDouble(high, float(value - Fraction(high)))


def split_fraction(value: Fraction, *places: int) -> tuple[float, ...]:
    """Return a number in floats: each but the last has so many bits, the sum is that of one more."""
    float_parts: list[float] = []
    for count in places:
        unit = Fraction(2) ** (math.frexp(float(value))[1] - count)
        part = float(round(value / unit) * unit)
        float_parts.append(part)
        value -= Fraction(part)
    return (*float_parts, float(value))


def exact(x: Number) -> DoubleDouble:
    """Return a float as a sum."""
    # a zero of the kind that x is: a float, an array, a line of text
    return DoubleDouble(x, x * 0.0)


def renormalised(high: Number, low: Number) -> DoubleDouble:
    """Return the sum of a number and a smaller one; a sum that is not finite has no rest."""
    total, rounding_error = ordered_sum(high, low)
    return DoubleDouble(total, choose(rounding_error == rounding_error, rounding_error, 0.0))


def choose_sum(truth: Truth, yes: DoubleDouble, no: DoubleDouble) -> DoubleDouble:
    """Return one of two sums."""
    return DoubleDouble(choose(truth, yes.high, no.high), choose(truth, yes.low, no.low))


def negated(x: DoubleDouble) -> DoubleDouble:
    """Return -x."""
    return DoubleDouble(-x.high, -x.low)


def add(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x + y."""
    high, lost = exact_sum(x.high, y.high)
    low, left = exact_sum(x.low, y.low)
    total, rounding_error = ordered_sum(high, lost + low)
    # the errors of an infinite sum are nan, and would make the sum nan
    return renormalised(total, choose(total - total == 0.0, left + rounding_error, 0.0))


def subtract(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x - y."""
    return add(x, negated(y))


def multiply(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x*y."""
    product, lost = exact_product(x.high, y.high)
    return renormalised(product, lost + (x.high * y.low + x.low * y.high))


def scaled_by_power(x: DoubleDouble, power: float | Number) -> DoubleDouble:
    """Return x times a power of two."""
    return DoubleDouble(x.high * power, x.low * power)


def divide(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x/y."""
    first = quotient(x.high, y.high)
    product = multiply(y, exact(first))
    remainder = (x.high - product.high) + (x.low - product.low)
    return renormalised(first, quotient(remainder, y.high))


def sqrt(x: DoubleDouble) -> DoubleDouble:
    """Return the square root; nan below zero."""
    root = root_of(x.high)
    square, lost = exact_product(root, root)
    remainder = ((x.high - square) - lost) + x.low
    return renormalised(root, choose(root == 0.0, 0.0, quotient(remainder, root + root)))


# ------------------------------------------------------------------------------------------------- order and whole ones


def is_less(x: DoubleDouble, y: DoubleDouble) -> Truth:
    """Whether x < y."""
    return (x.high < y.high) | ((x.high == y.high) & (x.low < y.low))


def at_most(x: DoubleDouble, y: DoubleDouble) -> Truth:
    """Whether x <= y."""
    return (x.high < y.high) | ((x.high == y.high) & (x.low <= y.low))


def equal(x: DoubleDouble, y: DoubleDouble) -> Truth:
    """Whether x == y."""
    return (x.high == y.high) & (x.low == y.low)


def absolute_value(x: DoubleDouble) -> DoubleDouble:
    """Return |x|."""
    return choose_sum(is_less(x, ZERO), negated(x), DoubleDouble(absolute(x.high), x.low))


def minimum_of_sums(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return the smaller; nan if either is."""
    return choose_sum(is_less(x, y) | (x.high != x.high), x, y)


def maximum_of_sums(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return the larger; nan if either is."""
    return choose_sum(is_less(y, x) | (x.high != x.high), x, y)


def sign_of_sum(x: DoubleDouble) -> DoubleDouble:
    """Return 1, -1, or x if it is zero or nan."""
    return exact(sign_of(x.high))


def positive_sum(x: DoubleDouble) -> DoubleDouble:
    """Return x if it is positive, else nan."""
    return DoubleDouble(choose(x.high > 0.0, x.high, math.nan), x.low)


def floor_of_sum(x: DoubleDouble) -> DoubleDouble:
    """Return the greatest whole number that is at most x."""
    integer_part = floor_of(x.high)
    return renormalised(integer_part, choose(integer_part == x.high, floor_of(x.low), 0.0))


def ceiling_of_sum(x: DoubleDouble) -> DoubleDouble:
    """Return the least whole number that is at least x."""
    return negated(floor_of_sum(negated(x)))


def nearest_integer(x: DoubleDouble) -> DoubleDouble:
    """Return the whole number nearest to x; of two equally near ones the even one."""
    integer_part = nearest_whole(x.high)
    gap = x.high - integer_part
    # a half that the rest leads to the other side, or leaves on this one
    beyond = choose(
        absolute(gap) == 0.5,
        choose((gap > 0.0) & (x.low > 0.0), 1.0, choose((gap < 0.0) & (x.low < 0.0), -1.0, 0.0)),
        0.0,
    )
    # where the nearest float was the even neighbour on the wrong side of the half
    return renormalised(integer_part + beyond, choose(gap == 0.0, nearest_whole(x.low), 0.0))


def modulo_of_sums(x: DoubleDouble, y: DoubleDouble) -> DoubleDouble:
    """Return x - y*floor(x/y), with the sign of y; nan from 2**53 turns on."""
    turns = floor_of_sum(divide(x, y))
    remainder = subtract(x, multiply(y, turns))
    above, below = is_less(ZERO, y), is_less(y, ZERO)
    remainder = choose_sum(
        (is_less(remainder, ZERO) & above) | (is_less(ZERO, remainder) & below), add(remainder, y), remainder
    )  # the quotient was rounded
    remainder = choose_sum(
        (at_most(y, remainder) & above) | (at_most(remainder, y) & below), subtract(remainder, y), remainder
    )
    # a zero has the sign of y, as for floats
    remainder = choose_sum(equal(remainder, ZERO), DoubleDouble(choose(y.high < 0.0, -0.0, 0.0), 0.0), remainder)
    return DoubleDouble(choose(absolute(turns.high) < 2.0**53, remainder.high, math.nan), remainder.low)


def polynomial_of_sums(x: DoubleDouble, coefficients: tuple[DoubleDouble, ...]) -> DoubleDouble:
    """Evaluate a polynomial, the constant first, by Horner's scheme."""
    value = coefficients[-1]
    for coefficient in coefficients[-2::-1]:
        value = add(multiply(value, x), coefficient)
    return value
