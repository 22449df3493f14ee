"""Constants of the functions, from their decimal digits, and coefficients, from fractions."""

from __future__ import annotations

from fractions import Fraction
from math import factorial

from xdynamics.elementary.double_double.sums import nearest, split_fraction

# Abramowitz and Stegun, table 1.1, continued; compared with mpmath by the tests
PI_DIGITS = Fraction("3.14159265358979323846264338327950288419716939937510582097494459230781640628620899862803482534")
LOG2_DIGITS = Fraction("0.69314718055994530941723212145817656807550013436025525412068000949339362196969471560586332700")

PI, HALF_PI = nearest(PI_DIGITS), nearest(PI_DIGITS / 2)
LOG2 = nearest(LOG2_DIGITS)
LOG2_PARTS = split_fraction(LOG2_DIGITS, 42, 42)  # whose products with 11 bits are exact
HALF_PI_PARTS = split_fraction(PI_DIGITS / 2, 33, 33, 33)  # with 20 bits

INVERSE_FACTORIALS = tuple(nearest(Fraction(1, factorial(k))) for k in range(31))
INVERSE_ODD = tuple(nearest(Fraction(1, 2 * k + 1)) for k in range(24))
