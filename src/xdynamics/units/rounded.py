"""Floats that know the number that was written, for arithmetic of more digits than a float has."""

from __future__ import annotations

from decimal import Context, Decimal
from fractions import Fraction
from math import inf

MOST_DIGITS = 400  # that are kept of a number, and written out again
ENOUGH = 40  # digits of a number that has no end, beyond those of the sum of two floats
SMALLEST = (
    1e-290  # of smaller numbers the rest would not be a float, and the exact value of hostile ones fills the memory
)


class Rounded(float):
    """A float that knows the number that it was rounded from; otherwise like any."""

    exact: Fraction

    @classmethod
    def from_exact(cls, exact: Fraction, value: float) -> float:
        """Return a float, as it is where its own decimal digits are that number."""
        if Fraction(repr(value)) == exact:
            return value
        rounded = cls(value)
        rounded.exact = exact
        return rounded


def read_decimal(text: str) -> float:
    """Read a decimal number, perhaps one that is not finite."""
    number = float(text)
    if not SMALLEST < abs(number) < inf or len(text) > MOST_DIGITS or text == repr(number):
        return number
    return Rounded.from_exact(Fraction(text.replace("_", "")), number)


def exact_value(number: float) -> Fraction:
    """Return the number that a float stands for: that which it was rounded from, or its fewest decimal digits."""
    return number.exact if isinstance(number, Rounded) else Fraction(repr(float(number)))


def decimal_text(number: float) -> str:
    """Write a float with the digits that it was written with, where these are more than its own.

    Examples
    --------
    >>> decimal_text(Rounded.from_exact(Fraction("0.12345678901234567890123"), 0.12345678901234568)), decimal_text(0.1)
    ('0.12345678901234567890123', '0.1')
    """
    if not isinstance(number, Rounded):
        return repr(float(number))
    above, below = Decimal(number.exact.numerator), Decimal(number.exact.denominator)
    digits = Context(prec=MOST_DIGITS).divide(above, below)
    return str(digits if Fraction(digits) == number.exact else Context(prec=ENOUGH).divide(above, below))
