"""Units: UDUNITS spelling in and out, dimensions, exact conversion to SI, scales.

pint is the dictionary of unit names and nothing else: text is taken apart here, under limits, and pint is
only ever asked for a single name. Conversion factors are exact fractions, so that ``"1 ms"``, ``"1e-3 s"``
and ``0.001`` seconds are the same float.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import isfinite
from numbers import Real
from typing import Any

from xdynamics.faults import InputError

BASE = ("kg", "m", "s", "A", "K", "mol", "cd")
LONGEST_TEXT = 200
LARGEST_EXPONENT = 16

# pint's name of a unit -> how UDUNITS spells it, where both mean the same size (a year and an electronvolt
# differ); a unit outside this table has no place in a record
SPELLING = {
    "meter": "m", "gram": "g", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd",
    "radian": "rad", "degree": "degree", "newton": "N", "joule": "J", "watt": "W", "pascal": "Pa", "hertz": "Hz",
    "volt": "V", "coulomb": "C", "ohm": "ohm", "farad": "F", "tesla": "T", "weber": "Wb", "henry": "H",
    "siemens": "S", "minute": "min", "hour": "h", "day": "d", "liter": "L", "bar": "bar",
    "astronomical_unit": "astronomical_unit", "inch": "inch", "foot": "foot", "mile": "mile",
    "pound": "lb", "force_pound": "lbf", "percent": "percent", "metric_ton": "tonne",
}  # fmt: skip
PREFIX = {"": "", "kilo": "k", "milli": "m", "micro": "u", "nano": "n", "pico": "p", "centi": "c", "deci": "d",
          "hecto": "h", "mega": "M", "giga": "G", "tera": "T", "femto": "f"}  # fmt: skip
NO_PREFIX = ("minute", "hour", "day", "degree", "inch", "foot", "mile", "pound", "force_pound", "percent", "metric_ton",
             "astronomical_unit")  # fmt: skip
# unit names that are constants of the expression language: no number there is without a unit
CONSTANTS = ("metre", "meter", "second", "kilogram", "gram", "ampere", "kelvin", "mole", "candela", "radian",
             "degree", "newton", "joule", "watt", "pascal", "hertz", "volt", "coulomb", "ohm", "farad", "tesla",
             "minute", "hour", "day")  # fmt: skip

_FACTOR = re.compile(r"1(?![\d^*])|(?P<name>[A-Za-z_]+)(?:(?:\^|\*\*)?(?P<exponent>[+-]?[0-9]{1,3}))?")
_BETWEEN = re.compile(r"\s*(?P<by>/|\*(?!\*)|\.|\s)\s*")
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?(?![0-9_.])")


@dataclass(frozen=True)
class Dimension:
    """Powers of the SI base units, in the order of `BASE`; an angle has none."""

    powers: tuple[Fraction, ...] = (Fraction(0),) * len(BASE)

    def __mul__(self, other: Dimension) -> Dimension:
        return Dimension(tuple(a + b if b else a for a, b in zip(self.powers, other.powers, strict=True)))

    def __truediv__(self, other: Dimension) -> Dimension:
        return Dimension(tuple(a - b if b else a for a, b in zip(self.powers, other.powers, strict=True)))

    def __pow__(self, exponent: Fraction | int) -> Dimension:
        return Dimension(tuple(power * exponent for power in self.powers))

    def __str__(self) -> str:
        """In base units, with the derived unit's name where there is one: ``kg m s-2 (N)``."""
        parts = [
            base + ("" if power == 1 else str(power)) for base, power in zip(BASE, self.powers, strict=True) if power
        ]
        name = _DERIVED.get(self)
        return (" ".join(parts) or "1") + (f" ({name})" if name else "")


NONE = Dimension()


def _base(**powers: int) -> Dimension:
    return Dimension(tuple(Fraction(powers.get(base, 0)) for base in BASE))


TIME = _base(s=1)
ENERGY = _base(kg=1, m=2, s=-2)
_COHERENT = {
    **{base: _base(**{base: 1}) for base in BASE}, "rad": NONE, "N": _base(kg=1, m=1, s=-2), "J": ENERGY,
    "W": _base(kg=1, m=2, s=-3), "Pa": _base(kg=1, m=-1, s=-2), "Hz": _base(s=-1), "C": _base(A=1, s=1),
    "V": _base(kg=1, m=2, s=-3, A=-1), "ohm": _base(kg=1, m=2, s=-3, A=-2), "F": _base(kg=-1, m=-2, s=4, A=2),
    "T": _base(kg=1, s=-2, A=-1),
}  # fmt: skip
_DERIVED: dict[Dimension, str] = {_COHERENT[name]: name for name in ("N", "J", "W", "Pa", "C", "V")}
_PI = Fraction("3.1415926535897932384626433832795028841971693993751")
# spelling of each unit constant, and what is not coherent with its factor: known here, so that a model in SI units
# does not wait for pint's dictionary
_SPELLED = dict(zip(CONSTANTS, ("m", "m", "s", "kg", "g", "A", "K", "mol", "cd", "rad", "degree", "N", "J", "W", "Pa", "Hz",
                                "V", "C", "ohm", "F", "T", "min", "h", "d"), strict=True))  # fmt: skip
_FACTORS = {
    "g": (_base(kg=1), Fraction(1, 1000)),
    "degree": (NONE, _PI / 180),
    "min": (TIME, Fraction(60)),
    "h": (TIME, Fraction(3600)),
    "d": (TIME, Fraction(86400)),
    "mm": (_base(m=1), Fraction(1, 1000)),
    "ms": (TIME, Fraction(1, 1000)),
    "cm": (_base(m=1), Fraction(1, 100)),
    "km": (_base(m=1), Fraction(1000)),
}


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
        return Unit(text, self.dimension / TIME**times, self.factor)

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
            return float(Fraction(repr(float(value))) * self.factor)
        except OverflowError:
            raise InputError(f"{value!r} {self.text} is not finite in SI units") from None


@dataclass(frozen=True)
class Quantity:
    """A finite number with its unit, as it was written."""

    value: float
    unit: Unit

    @property
    def si(self) -> float:
        """The value in SI units, correctly rounded."""
        return self.unit.to_si(self.value)

    def __str__(self) -> str:
        return f"{self.value!r} {self.unit.text}"


def spell(dimension: Dimension, *, angle: bool = False) -> Unit:
    """Return the SI unit of a dimension, spelled for a record; a torque (`angle`) is ``N m``.

    Raises
    ------
    InputError
        If a power is no whole number, which UDUNITS cannot spell.
    """
    if any(power.denominator != 1 for power in dimension.powers):
        raise InputError(f"units '{dimension}' have a fractional power, which a record cannot spell")
    if angle and dimension == ENERGY:
        return Unit("N m", dimension)
    base = str(dimension).split(" (")[0]
    return Unit(_DERIVED.get(dimension, base), dimension)


def coherent(unit: Unit) -> Unit:
    """Return the SI unit of a unit, spelled as it was: prefixes go, and what is no SI unit becomes base units.

    Examples
    --------
    >>> [coherent(parse_unit(one)).text for one in ("mN s m-1", "g", "degree s-1", "km h-1", "rad", "N m")]
    ['N s m-1', 'kg', 'rad s-1', 'm s-1', 'rad', 'N m']
    """
    if unit.factor == 1:
        return unit
    factors = []
    for part in unit.text.split():
        name = part.rstrip("-0123456789")
        power = int(part[len(name) :] or 1)
        factors += [(base, power * times) for base, times in _coherent(name)]
    return parse_unit(" ".join(f"{name}{power}" for name, power in factors) or "1")


def _coherent(name: str) -> list[tuple[str, int]]:
    """Spell the SI unit of one unit name: with its own name, without a prefix, by a derived name, or in base units."""
    spelling, dimension, factor = _named(name)
    if factor == 1:
        return [(spelling, 1)]
    stems = [spelling.removeprefix(symbol) for symbol in PREFIX.values() if symbol and spelling.startswith(symbol)]
    matching = [symbol for symbol in stems if symbol in _COHERENT and _COHERENT[symbol] == dimension]
    if matching or dimension in _DERIVED:
        return [(matching[0] if matching else _DERIVED[dimension], 1)]
    if dimension == NONE:
        return [("rad", 1)] if spelling == "degree" else []
    return [(base, int(power)) for base, power in zip(BASE, dimension.powers, strict=True) if power]


def parse_unit(text: str) -> Unit:
    """Read a unit: factors with whole powers, ``kg m-1``, ``m s^-2``, ``N*s/m``, ``1``.

    Raises
    ------
    InputError
        If the text is too long, has characters or powers that units do not have, or names an unknown unit.

    Examples
    --------
    >>> parse_unit("N s/m").dimension == parse_unit("kg s-1").dimension
    True
    >>> parse_unit("m/s**2").text
    'm s-2'
    """
    if not isinstance(text, str):
        raise InputError(f"unit {text!r} is no text; write it like 'm s-1'")
    shown = repr(text if len(text) <= 40 else text[:40] + "…")
    if len(text) > LONGEST_TEXT:
        raise InputError(f"unit {shown} has {len(text)} characters, {LONGEST_TEXT} at most")
    stripped = text.strip()
    if not stripped:
        raise InputError("unit is empty; a pure number has the unit '1'")
    return _product(stripped, shown)


@lru_cache(maxsize=512)
def _product(stripped: str, shown: str) -> Unit:
    """Read the factors of a unit."""
    dimension, factor, position, sign = NONE, Fraction(1), 0, 1
    powers: dict[str, int] = {}
    while True:
        match = _FACTOR.match(stripped, position)
        if not match:
            raise InputError(
                f"unit {shown} cannot be read at column {position + 1}; write factors with whole powers, like 'kg m-1'"
            )
        exponent = sign * int(match["exponent"] or 1)
        if not 0 < abs(exponent) <= LARGEST_EXPONENT:
            raise InputError(f"unit {shown} has the power {exponent}, needs 1 to {LARGEST_EXPONENT} in size")
        if match["name"]:
            spelling, one_dimension, one_factor = _named(match["name"])
            powers[spelling] = powers.get(spelling, 0) + exponent
            dimension, factor = dimension * one_dimension**exponent, factor * one_factor**exponent
        position = match.end()
        if position == len(stripped):
            break
        between = _BETWEEN.match(stripped, position)
        if not between:
            raise InputError(f"unit {shown} cannot be read at column {position + 1}, near {stripped[position]!r}")
        sign = -1 if between["by"] == "/" else 1
        position = between.end()
    parts = [name + ("" if power == 1 else str(power)) for name, power in powers.items() if power]
    return Unit(" ".join(parts) or "1", dimension, factor)


def parse_quantity(given: Any) -> Quantity:
    """Read ``"0.145 kg"``, a bare number (unit ``1``) or a pint quantity.

    Raises
    ------
    InputError
        If the number is missing or not finite, or the unit cannot be read.

    Examples
    --------
    >>> parse_quantity("10.8 g").si
    0.0108
    """
    if hasattr(given, "magnitude") and hasattr(given, "unit_items"):
        powers = [(name, int(power) if power == int(power) else power) for name, power in given.unit_items()]
        return _quantity(
            _number(given.magnitude), " ".join(f"{name}{power}" for name, power in powers) or "1", repr(str(given))
        )
    if not isinstance(given, str):
        return _quantity(_number(given), "1", repr(given))
    text = given.strip()
    shown = repr(text if len(text) <= 40 else text[:40] + "…")
    if len(text) > LONGEST_TEXT:
        raise InputError(f"quantity {shown} has {len(text)} characters, {LONGEST_TEXT} at most")
    match = _NUMBER.match(text)
    if not match:
        raise InputError(f"quantity {shown} does not start with a finite number; write it like '0.145 kg'")
    return _quantity(float(match[0]), text[match.end() :].strip() or "1", shown)


_RANGE = re.compile(r"\s*(?P<start>[^:\s]+)\s*:\s*(?P<stop>[^:\s]+)\s*:\s*(?P<count>\d+)(?![.\d])\s*(?P<unit>[^:]*)")


def is_range(given: Any) -> bool:
    """Whether a text is meant as ``start:stop:count unit``."""
    return isinstance(given, str) and _RANGE.fullmatch(given) is not None


@dataclass(frozen=True)
class Range:
    """``0:20:201 s``: evenly spaced numbers, both ends included.

    Attributes
    ----------
    start, stop : float
        In `unit`.
    count : int
    unit : Unit
        Given after the count, or at the ends; ``1`` if there is none.
    """

    start: float
    stop: float
    count: int
    unit: Unit

    @classmethod
    def parse(cls, text: str) -> Range:
        """Read a range.

        Raises
        ------
        InputError
            If its ends have different units, or units in addition to the one after the count.
        """
        match = _RANGE.fullmatch(text)
        if match is None:
            raise InputError(f"is {text!r}, needs start:stop:count unit, like '0:20:201 s'")
        ends = [parse_quantity(match[name]) for name in ("start", "stop")]
        units = [item.unit for item in ends if item.unit.text != "1"]
        if units and match["unit"]:
            raise InputError(f"is {text!r}, with units after its ends and after the count; write one, after the count")
        if units and len({item.dimension for item in units}) > 1:
            raise InputError(
                f"is {text!r}, from '{units[0].text}' to '{units[1].text}'; its ends need one kind of unit"
            )
        unit = units[-1] if units else parse_unit(match["unit"] or "1")
        start, stop = (
            item.value if item.unit.text in ("1", unit.text) else item.si / float(unit.factor) for item in ends
        )
        return cls(start, stop, int(match["count"]), unit)


SECONDS = Unit("s", TIME)
NUMBERS = Unit("1", NONE)  # the unit of a time that has none


def behind(unit: Unit | str) -> str:
    """Return a unit as it follows a number; empty for a dimensionless one.

    Examples
    --------
    >>> f"3{behind('s')}, 3{behind('1')}"
    '3 s, 3'
    """
    text = unit if isinstance(unit, str) else unit.text
    return "" if text == NUMBERS.text else f" {text}"


def parse_time(given: Any, what: str) -> float:
    """Read a time and return seconds; a bare number is seconds.

    Raises
    ------
    InputError
        If `given` is no finite time; the message names `what`.
    """
    try:
        quantity = parse_quantity(given)
    except InputError as error:
        raise InputError(f"{what}: {error}") from None
    bare = isinstance(given, Real)
    if not bare and quantity.unit.dimension != TIME:
        raise InputError(f"{what} {given!r} has units '{quantity.unit.dimension}', needs 's'")
    return quantity.si


def constant(name: str) -> Unit:
    """Return the unit that a unit constant of the expression language stands for."""
    spelling, dimension, factor = _named(name)
    return Unit(spelling, dimension, factor)


def time_in(unit: Unit, given: Any, what: str) -> float:
    """Read a time of a model: as `parse_time` does, or where its time is a pure number, such a one.

    Raises
    ------
    InputError
        If it has another unit; the message names `what`.
    """
    if unit.dimension == TIME or not isinstance(given, str):
        return parse_time(given, what)
    quantity = parse_quantity(given)
    if quantity.unit.dimension != NONE:
        raise InputError(
            f"{what} {given!r} has units '{quantity.unit.dimension}', and the model's time is a pure number"
        )
    return quantity.si


def _number(given: Any) -> float:
    if isinstance(given, Real) and not isinstance(given, bool):
        try:
            return float(given)
        except OverflowError:
            pass
    raise InputError(f"quantity {str(given)[:40]!r} is no number with a unit; write it like '0.145 kg'")


def _quantity(value: float, unit: str, shown: str) -> Quantity:
    if not isfinite(value):
        raise InputError(f"quantity {shown} is not finite")
    return Quantity(value, parse_unit(unit))


@lru_cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)


@lru_cache(maxsize=512)
def _named(name: str) -> tuple[str, Dimension, Fraction]:
    """Look one unit name up: its spelling, dimension and exact SI factor."""
    spelling = _SPELLED.get(name, name)
    if spelling in _COHERENT:
        return spelling, _COHERENT[spelling], Fraction(1)
    if spelling in _FACTORS:
        return spelling, *_FACTORS[spelling]
    if len(name) > 40:
        raise InputError(f"unit '{name[:40]}…' is not known")
    registry = _registry()
    readings = registry.parse_unit_name(name)
    prefix, unit, _ = readings[0] if readings else ("", "", "")
    if unit not in SPELLING or prefix not in PREFIX or (prefix and unit in NO_PREFIX):
        raise InputError(f"unit '{name}' is not known; use SI names and symbols, like 'm', 'kg', 'degree'")
    factor, _ = registry.get_base_units(prefix + unit)
    powers = {
        "[mass]": "kg",
        "[length]": "m",
        "[time]": "s",
        "[current]": "A",
        "[temperature]": "K",
        "[substance]": "mol",
        "[luminosity]": "cd",
    }
    base = {powers[key]: int(power) for key, power in registry.get_dimensionality(prefix + unit).items()}
    return PREFIX[prefix] + SPELLING[unit], _base(**base), Fraction(factor)


@dataclass(frozen=True)
class Scales:
    """Length, time and mass that count as one inside a march in nondimensional variables, in SI units."""

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    @classmethod
    def parse(cls, given: dict[str, Any] | None) -> Scales:
        """Read ``{"length": "1 astronomical_unit", …}``; scales not given are one SI unit.

        Raises
        ------
        InputError
            If a scale is unknown, has the wrong dimension or is not positive.
        """
        needed = {"length": _base(m=1), "time": TIME, "mass": _base(kg=1)}
        values = {}
        if not isinstance(given, Mapping | None):
            raise InputError(f'scales are {given!r}, need a table like {{ length = "1 m" }}')
        for name, text in (given or {}).items():
            if name not in needed:
                raise InputError(f"scale {name!r} is not known; there are length, time and mass")
            quantity = parse_quantity(text)
            if quantity.unit.dimension != needed[name] or not 1e-40 <= quantity.si <= 1e40:
                raise InputError(
                    f"{name} scale is {text!r}, needs a positive quantity in '{needed[name]}', 1e-40 to 1e40"
                )
            values[name] = quantity.si
        return cls(**values)

    def of(self, dimension: Dimension) -> float:
        """SI units in one nondimensional unit of a dimension, by multiplication and square roots only."""
        kilogram, metre, second = dimension.powers[:3]
        return _power(self.mass, kilogram) * _power(self.length, metre) * _power(self.time, second)


def _power(base: float, exponent: Fraction) -> float:
    if base == 1.0 or exponent == 0:
        return 1.0
    if exponent.denominator == 2:
        return float(_power(base, Fraction(exponent.numerator)) ** 0.5)
    result = 1.0
    for _ in range(abs(int(exponent))):
        result *= base
    return result if exponent > 0 else 1.0 / result


UNSCALED = Scales()
