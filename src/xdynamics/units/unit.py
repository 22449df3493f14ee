"""Units and quantities: numbers with a unit, converted to SI exactly."""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.units.dimension import NONE, TIME, Dimension
from xdynamics.units.rounded import Rounded, decimal_text, exact_value


@dataclass(frozen=True)
class Unit:
    """A unit in UDUNITS spelling.

    Attributes
    ----------
    text : str
        The spelling a record carries: ``kg m-1``.
    dimension : Dimension
    factor : Fraction
        SI units in one of these, exact (pi to 50 digits for a degree).
    """

    text: str
    dimension: Dimension
    factor: Fraction = Fraction(1)

    def per_second(self, times: int = 1) -> Unit:
        """Return the unit of this quantity's rate: ``m`` gives ``m s-1``, ``m s-2``."""
        text = f"s-{times}" if self.text == "1" else f"{self.text} s-{times}"
        dimension = self.dimension
        for _ in range(times):
            dimension = dimension / TIME
        return Unit(text, dimension, self.factor)

    def per(self, time: Unit, times: int = 1) -> Unit:
        """Return the unit of this quantity's rate by a time in seconds, or by one that is a pure number."""
        return self.per_second(times) if time.dimension == TIME else self

    def to_si(self, value: float) -> float:
        """Convert a number of these units to SI, correctly rounded.

        Raises
        ------
        InputError
            If the result is not finite.
        """
        if self.factor == 1:
            return value
        try:
            return float(exact_value(value) * self.factor)
        except OverflowError:
            raise InputError(f"{value!r} {self.text} is not finite in SI units") from None

    def all_to_si(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert many numbers of these units to SI, each as `to_si` does.

        Raises
        ------
        InputError
            If a result is not finite.
        """
        if self.factor == 1:
            return values
        up, down = self.factor.as_integer_ratio()
        exact = (Decimal(repr(value)).as_integer_ratio() for value in values.ravel().tolist())
        try:  # a quotient of whole numbers is rounded once; fractions would take four times as long
            si_values = np.fromiter((above * up / (below * down) for above, below in exact), float, values.size)
        except OverflowError:  # of the first that is too large
            si_values = np.array([self.to_si(value) for value in values.ravel().tolist()])
        return si_values.reshape(values.shape)


@dataclass(frozen=True)
class Scale:
    """A scale that numbers are written on, as `text`: `factor` and `offset`, exact, lead to its unit, as 273.15 to K."""

    unit: Unit
    factor: Fraction = Fraction(1)
    offset: Fraction = Fraction(0)
    text: str = field(default="", compare=False)

    @property
    def is_unit(self) -> bool:
        """Whether numbers on it are in its unit as they are."""
        return self.factor == 1 and self.offset == 0

    def value(self, number: float) -> float:
        """Return a number of this scale in its unit, correctly rounded."""
        if self.is_unit:
            return number
        exact = exact_value(number) * self.factor + self.offset
        return Rounded.from_exact(exact, float(exact))

    def difference(self, number: float) -> float:
        """Return a difference of two such numbers, or an uncertainty, in its unit: an offset is not in it."""
        return Scale(self.unit, self.factor).value(number)


@dataclass(frozen=True)
class Quantity:
    """A finite number with its unit, as it was written.

    Attributes
    ----------
    value : float
        In the unit.
    unit : Unit
    scale : Scale, optional
        On which it was written, and bare numbers in its place are, where this is not the unit itself: °C, a month.
    """

    value: float
    unit: Unit
    scale: Scale | None = field(default=None, compare=False, repr=False)

    @property
    def scale_of_numbers(self) -> Scale:
        """The scale that bare numbers in its place are on: that which it was written on, or its unit."""
        return self.scale or Scale(self.unit)

    @property
    def si(self) -> float:
        """The value in SI units, correctly rounded."""
        return self.unit.to_si(self.value)

    def into(self, unit: Unit) -> Quantity:
        """Return the same quantity in another unit of its dimension, correctly rounded."""
        if self.unit.factor == unit.factor:
            return Quantity(self.value, unit)
        return Quantity(float(exact_value(self.value) * self.unit.factor / unit.factor), unit)

    def __str__(self) -> str:
        return f"{decimal_text(self.value)} {self.unit.text}"


SECONDS = Unit("s", TIME)
NUMBERS = Unit("1", NONE)  # the unit of a time that has none
UNKNOWN_UNIT = "unknown unit"  # in the place of a unit, where values were edited since they were marched


def unit_suffix(unit: Unit | str) -> str:
    """Return a unit as it follows a number; empty for a dimensionless one.

    Examples
    --------
    >>> f"3{unit_suffix('s')}, 3{unit_suffix('1')}"
    '3 s, 3'
    """
    text = unit if isinstance(unit, str) else unit.text
    return "" if text == NUMBERS.text else f" {text}"
