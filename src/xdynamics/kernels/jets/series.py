"""Series in time, one for every value of a program, and the lines that compute their next coefficient.

A series is a row of coefficients, the value of the program being the first; those of values that do not change with time
are zero but for that. There are two ways to write them: each coefficient as a value of its own, for small programs, or
in memory, by a loop over orders, for the others. The operations are those of any kind of number that a printer knows.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import Protocol

from xdynamics.kernels.program import Location, Operand

MEMORY, ORDER, TERM = "w", "_order", "_term"  # array of the coefficients; indices of loops over orders and over terms
# of the order k: (k - 1)//2, as many pairs of terms; whether there is a term in their middle, and k/2, which it is
HALF, ODD, MIDDLE = "_half", "_odd", "_middle"


@dataclass(eq=False)
class Series:
    """The coefficients of a value.

    Attributes
    ----------
    constant : bool
        Whether the value does not change with time.
    truth : bool
        Whether it is a comparison, which is in memory as 1 or 0.
    terms : dict of int to operand
        Coefficients that are values of the text: all of them, or the first alone.
    location : Place, optional
        Where the first coefficient is, of series in memory.
    stride : int
        How far a coefficient is from the one before.
    read : bool
        Whether a coefficient is read from memory.
    square : Series, optional
        That of which it is the square root.
    scaled : (Series, Operand), optional
        What it is a multiple of, and the factor.
    made : (str, tuple of Series), optional
        Of which others it is the sum, or the difference: its coefficients are computed again wherever they are read, as
        those of two bodies take less room than those of every two.
    """

    constant: bool = False
    truth: bool = False
    terms: dict[int, Operand] = field(default_factory=dict)
    location: Location | None = None
    stride: int = 1
    read: bool = False
    square: Series | None = None
    scaled: tuple[Series, Operand] | None = None
    made: tuple[str, tuple[Series, ...]] | None = None
    parts: dict[str, Series] = field(default_factory=dict)


class Order(Protocol):
    """The lines of one order: 0 is that of the values themselves."""

    fused: bool  # whether products are added by fma, and what is divided by is kept as a reciprocal
    high: bool  # whether coefficients are so small that reciprocals of 53 bits do

    @property
    def number(self) -> Operand:
        """The order as a number."""

    def divide_by_order(self, value: Operand) -> Operand:
        """Divide by the order."""

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write one operation; return its operand."""

    def product_added(self, a: Operand, b: Operand, total: Operand) -> Operand:
        """Write a*b + total."""

    def first(self, series: Series) -> Operand:
        """Return the coefficient of order 0."""

    def second(self, series: Series) -> Operand:
        """Return the coefficient of order 1, at orders above 0."""

    def now(self, series: Series) -> Operand:
        """Return the coefficient of this order."""

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Operand:
        """Sum a[j]*b[k - j] over j from `skip` to k, but for a skip of 2 over j from 1 to k - 1."""

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another, as the cosine with a sine."""

    def keep(self, series: Series, value: Operand) -> None:
        """Let a value be the coefficient of this order."""

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is written."""

    def read(self, location: Location) -> Operand:
        """Read a number that does not change."""


def has_pairs(source: str) -> bool:
    """Whether a law, printed as Python, has sums of products by pairs of terms."""
    return f" {HALF} = " in source


def reciprocal(number: float) -> tuple[float, float]:
    """Return the reciprocal of a number as the sum of two floats.

    Examples
    --------
    >>> reciprocal(4), reciprocal(3)
    ((0.25, 0.0), (0.3333333333333333, 1.850371707708594e-17))
    """
    nearest = 1.0 / number
    return nearest, float(1 / Fraction(number) - Fraction(nearest))


def slope_series(order: Order, series: Series) -> Series:
    """Return the series whose coefficients are k times those of another: that of its derivative times the time."""
    rising = order.part(series, "slope")
    if order.knows(rising):
        return rising
    if series.constant:
        rising.constant = True
        rising.terms[0] = 0.0
    elif order.number == 0.0:
        order.keep(rising, 0.0)
    else:
        order.keep(rising, order.compute("multiply", order.number, order.now(series)))
    return rising
