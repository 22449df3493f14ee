"""Units, dimensions and quantities: numbers with a unit, converted to SI exactly.

A dimension is the powers of the SI base units; some derived units are spelled by a name. `Rounded` is a float that
knows the number that was written, for arithmetic of more digits than a float has.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from decimal import Context, Decimal
from fractions import Fraction
from math import inf

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError

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
    """Write a float with the digits that it was written with, if these exceed its own precision.

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


BASE = ("kg", "m", "s", "A", "K", "mol", "cd")


@dataclass(frozen=True)
class Dimension:
    """Powers of the SI base units, in the order of `BASE`; an angle has none."""

    powers: tuple[Fraction, ...] = (Fraction(0),) * len(BASE)

    def __mul__(self, factor: Dimension) -> Dimension:
        return Dimension(tuple(a + b if b else a for a, b in zip(self.powers, factor.powers, strict=True)))

    def __truediv__(self, divisor: Dimension) -> Dimension:
        return Dimension(tuple(a - b if b else a for a, b in zip(self.powers, divisor.powers, strict=True)))

    def __pow__(self, exponent: Fraction | int) -> Dimension:
        return Dimension(tuple(power * exponent for power in self.powers))

    def __str__(self) -> str:
        """In base units, with the derived unit's name where there is one: ``kg m s-2 (N)``."""
        parts = [
            base + ("" if power == 1 else str(power)) for base, power in zip(BASE, self.powers, strict=True) if power
        ]
        name = DERIVED.get(self)
        return (" ".join(parts) or "1") + (f" ({name})" if name else "")


NONE = Dimension()


def base_powers(**powers: int) -> Dimension:
    """Return the dimension with these powers of base units: ``base_powers(m=1, s=-2)``."""
    return Dimension(tuple(Fraction(powers.get(base, 0)) for base in BASE))


TIME = base_powers(s=1)
ENERGY = base_powers(kg=1, m=2, s=-2)
COHERENT = {
    **{base: base_powers(**{base: 1}) for base in BASE}, "rad": NONE, "N": base_powers(kg=1, m=1, s=-2), "J": ENERGY,
    "W": base_powers(kg=1, m=2, s=-3), "Pa": base_powers(kg=1, m=-1, s=-2), "Hz": base_powers(s=-1), "C": base_powers(A=1, s=1),
    "V": base_powers(kg=1, m=2, s=-3, A=-1), "ohm": base_powers(kg=1, m=2, s=-3, A=-2), "F": base_powers(kg=-1, m=-2, s=4, A=2),
    "T": base_powers(kg=1, s=-2, A=-1),
}  # fmt: skip
DERIVED: dict[Dimension, str] = {COHERENT[name]: name for name in ("N", "J", "W", "Pa", "C", "V")}


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
        """The scale on which bare numbers replace the quantity: the scale it was written on, or its unit."""
        return self.scale or Scale(self.unit)

    @property
    def si(self) -> float:
        """The value in SI units, correctly rounded."""
        return self.unit.to_si(self.value)

    def into(self, unit: Unit) -> Quantity:
        """Return an equal quantity in another unit of its dimension, correctly rounded."""
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
