"""Units and quantities from text, under limits; from numbers and from pint.

A range is evenly spaced numbers with a unit, in one text. A record spells the SI unit of a dimension or of a unit.
Scales of length, time and mass are the units in which a march may be nondimensional.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import isfinite
from numbers import Real
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units.names import PREFIX, PRODUCTS, UNITS_OF_VALUES, look_up_unit
from xdynamics.units.unit import (
    BASE,
    COHERENT,
    DERIVED,
    ENERGY,
    NONE,
    TIME,
    UNKNOWN_UNIT,
    Dimension,
    Quantity,
    Rounded,
    Scale,
    Unit,
    base_powers,
    exact_value,
    read_decimal,
)

LONGEST_TEXT = 200
LARGEST_EXPONENT = 16

_FACTOR = re.compile(r"1(?![\d^*])|(?P<name>[A-Za-z_]+)(?:(?:\^|\*\*)?(?P<exponent>[+-]?[0-9]{1,3}))?")
_BETWEEN = re.compile(r"\s*(?P<by>/|\*(?!\*)|\.|\s)\s*")
_SIGNS = {
    **dict(zip("⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺", "0123456789-+", strict=True)),
    **dict.fromkeys("·⋅∙×", "*"),
    **dict.fromkeys("µμ", "u"),
    **dict.fromkeys("ΩΩ", "ohm"),
    "−": "-",
}
_RAISED = re.compile("(?<![⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺])(?=[⁰¹²³⁴⁵⁶⁷⁸⁹⁻⁺])")
_CELSIUS, _FAHRENHEIT, _MONTH = ("°C", "℃", "degC", "celsius", "Celsius"), ("°F", "℉", "degF"), ("month", "months")
_OF_VALUES = re.compile(
    r"(?P<prefix>kilo|mega|giga|k|M|G|)(?:(?P<parsec>pc|parsecs?)|(?P<light_year>ly|light[-_ ]?years?)|(?P<electron_volt>eV))"
    r"|(?P<horsepower>hp|HP|horsepower)|(?P<slug>slugs?)|(?P<ounce>oz|ounces?)|(?P<torr>[Tt]orr)"
)
_THOUSANDS = {"": 0, "k": 1, "M": 2, "G": 3, "kilo": 1, "mega": 2, "giga": 3}
_OF_TIME = "units of time are s, ms, us, min, h, day, month and year"
_DAYS_OF_MONTH = Fraction("365.25") / 12
_OF_DIFFERENCES = re.compile("|".join(f"(?<![A-Za-z]){unit}(?![A-Za-z])" for unit in _CELSIUS))
_FRACTION = re.compile(r"\.[0-9]")
_BELOW = re.compile(r"/\s*\(([^()/]+)\)")
OPERATORS = ("*", "+", "-", "(", ")")  # that an expression has behind a number, and no unit begins with
_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?(?![0-9_.])")


def parse_scale(text: str) -> Scale:
    """Read a unit, or a scale that values alone are given on: ``°C``, ``°F``, ``month``, ``light_year``, ``Mpc``, ``hp``, ``oz``.

    A month is a twelfth of a Julian year; a light-year is what light goes in one, 9460730472580800 m, and a parsec 648000/pi
    astronomical units, as the International Astronomical Union has them (style manual, 1989; resolution B2, 2015, note 4).

    Examples
    --------
    >>> celsius = parse_scale("°C")
    >>> celsius.value(20.0), celsius.difference(0.5), celsius.unit.text
    (293.15, 0.5, 'K')
    >>> parse_scale("ly").value(1.0), parse_scale("kpc").value(1.0)
    (9460730472580800.0, 3.085677581491367e+19)
    """
    word = text.strip() if isinstance(text, str) else ""
    if word in _CELSIUS:
        return Scale(parse_unit("K"), Fraction(1), Fraction("273.15"), word)
    if word in _FAHRENHEIT:
        return Scale(parse_unit("K"), Fraction(5, 9), Fraction("459.67") * Fraction(5, 9), word)
    if word in _MONTH:
        return Scale(parse_unit("d"), _DAYS_OF_MONTH, text=word)
    if match := _OF_VALUES.fullmatch(word):
        kept_unit, factor = UNITS_OF_VALUES[match.lastgroup or ""]
        return Scale(parse_unit(kept_unit), factor * 1000 ** _THOUSANDS[match["prefix"] or ""], text=word)
    return Scale(parse_unit(text), text=word)


def parse_unit(text: str) -> Unit:
    """Read a unit: factors with whole powers, ``kg m-1``, ``m s^-2``, ``N*s/m``, ``J/(kg·K)``, ``m/s²``, ``1``.

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
    shown_text = repr(text if len(text) <= 40 else text[:40] + "…")
    if len(text) > LONGEST_TEXT:
        raise InputError(f"unit {shown_text} has {len(text)} characters, {LONGEST_TEXT} at most")
    stripped = text.strip()
    if not stripped:
        raise InputError("unit is empty; a pure number has the unit '1'")
    if stripped == UNKNOWN_UNIT:
        raise InputError(
            "the unit is unknown: the values were edited since they were computed; state it as their 'units'"
        )
    if stripped in (*_CELSIUS, *_FAHRENHEIT, *_MONTH) or _OF_VALUES.fullmatch(stripped):
        kept_unit = parse_scale(stripped).unit.text
        raise InputError(
            f"unit {shown_text} is for values alone, like '20 {stripped}': they are kept in {kept_unit}; write '{kept_unit}'"
        )
    plain = stripped.isascii() and not {*"(%"} & {*stripped}
    return _unit_product(stripped if plain else _ascii_unit(stripped), shown_text)


def _ascii_unit(text: str) -> str:
    """Return a unit in ASCII: raised digits as powers, products as stars, a bracket below a stroke as strokes."""
    text = (
        _OF_DIFFERENCES.sub("K", text)
        .replace("%", " percent ")
        .replace("°", " degree ")
        .replace("º", " degree ")
        .strip()
    )
    text = "".join(_SIGNS.get(sign, sign) for sign in _RAISED.sub("^", text))
    text = _BELOW.sub(lambda match: "/" + "/".join(re.split(r"\s*[*.]\s*|\s+", match[1].strip())), text)
    return re.sub(r"\s*([*/])\s*", r"\1", text)


@lru_cache(maxsize=512)
def _unit_product(stripped: str, shown_text: str) -> Unit:
    """Read the factors of a unit."""
    dimension, factor, position, sign = NONE, Fraction(1), 0, 1
    powers: dict[str, int] = {}
    while True:
        match = _FACTOR.match(stripped, position)
        if not match:
            raise InputError(
                f"unit {shown_text} cannot be read at column {position + 1}; write factors with whole powers, like 'kg m-1'"
            )
        if match["name"] and (rest := _FRACTION.match(stripped, match.end())):
            raise InputError(
                f"unit {shown_text} has the power {match['exponent'] or ''}{rest[0]}, and a record spells whole powers alone; put the"
                " root into the expression, as in K*sqrt(h/metre) with K in m3 s-1"
            )
        exponent = sign * int(match["exponent"] or 1)
        if not 0 < abs(exponent) <= LARGEST_EXPONENT:
            raise InputError(f"unit {shown_text} has the power {exponent}, needs 1 to {LARGEST_EXPONENT} in size")
        for spelling, power, one_dimension, one_factor in _spelled(match["name"] or ""):
            powers[spelling] = powers.get(spelling, 0) + power * exponent
            dimension = dimension * one_dimension ** (power * exponent)
            factor *= one_factor ** (power * exponent)
        position = match.end()
        if position == len(stripped):
            break
        between = _BETWEEN.match(stripped, position)
        if not between:
            raise InputError(f"unit {shown_text} cannot be read at column {position + 1}, near {stripped[position]!r}")
        sign = -1 if between["by"] == "/" else 1
        position = between.end()
    parts = [name + ("" if power == 1 else str(power)) for name, power in powers.items() if power]
    return Unit(" ".join(parts) or "1", dimension, factor)


def _spelled(name: str) -> Iterator[tuple[str, int, Dimension, Fraction]]:
    """Yield spelling, power, dimension and factor of each unit that a name stands for: one, or several, as mph for mile h-1."""
    for part in PRODUCTS.get(name, name).split():
        stem = part.rstrip("-0123456789") if name in PRODUCTS else part
        spelling, dimension, factor = look_up_unit(stem)
        yield spelling, int(part[len(stem) :] or 1), dimension, factor


def parse_quantity(value: Any, *, difference: bool = False) -> Quantity:
    """Read ``"0.145 kg"``, a bare number (unit ``1``) or a pint quantity.

    Parameters
    ----------
    value : str, number or pint.Quantity
    difference : bool
        Whether it is a difference or an uncertainty: 0.5 °C is then 0.5 K.

    Raises
    ------
    InputError
        If the number is missing or not finite, or the unit cannot be read.

    Examples
    --------
    >>> parse_quantity("10.8 g").si
    0.0108
    """
    if hasattr(value, "magnitude") and hasattr(value, "unit_items"):
        powers = [(name, int(power) if power == int(power) else power) for name, power in value.unit_items()]
        return _scaled_quantity(
            _read_float(value.magnitude), " ".join(f"{name}{power}" for name, power in powers) or "1", repr(str(value))
        )
    if not isinstance(value, str):
        return _scaled_quantity(_read_float(value), "1", repr(value))
    text = value.strip()
    shown_text = repr(text if len(text) <= 40 else text[:40] + "…")
    if len(text) > LONGEST_TEXT:
        raise InputError(f"quantity {shown_text} has {len(text)} characters, {LONGEST_TEXT} at most")
    match = _NUMBER.match(text)
    if not match:
        raise InputError(f"quantity {shown_text} does not start with a finite number; write it like '0.145 kg'")
    unit_words = text[match.end() :].strip()
    if unit_words[:1] in OPERATORS:
        raise InputError(
            f"quantity {shown_text} has '{unit_words[0]}' after its number; write a number and a unit, like '0.145 kg'"
        )
    if comma := re.fullmatch(r",(\d+)(.*)", unit_words):
        raise InputError(f"quantity {shown_text} has a comma; write a decimal point, '{match[0]}.{comma[1]}{comma[2]}'")
    return _scaled_quantity(read_decimal(match[0]), unit_words or "1", shown_text, difference=difference)


def is_number(text: str) -> bool:
    """Whether a text is a number without a unit."""
    return _NUMBER.fullmatch(text.strip()) is not None


def unit_text(text: str) -> str:
    """Return the unit of a quantity as it was written."""
    match = _NUMBER.match(text.strip())
    return text.strip()[match.end() :].strip() if match else ""


def exact_si(quantity: Quantity) -> float:
    """Return the value in SI units, correctly rounded; it knows the number that it was rounded from."""
    if quantity.unit.factor == 1 and not isinstance(quantity.value, Rounded):
        return quantity.si
    return Rounded.from_exact(exact_value(quantity.value) * quantity.unit.factor, quantity.si)


def parse_time(value: Any, subject: str) -> float:
    """Read a time and return seconds; a bare number is seconds.

    Raises
    ------
    InputError
        If `value` is no finite time; the message names `subject`.
    """
    try:
        quantity = parse_quantity(value)
    except InputError as error:
        raise InputError(f"{subject}: {error}; {_OF_TIME}") from None
    if not isinstance(value, Real) and quantity.unit.dimension != TIME:
        raise InputError(f"{subject} {value!r} has units '{quantity.unit.dimension}', needs 's'; {_OF_TIME}")
    return exact_si(quantity)


def time_in(unit: Unit, value: Any, subject: str) -> float:
    """Read a time of a model: as `parse_time` does, or as a pure number where the model's time is one.

    A text without a unit is in the model's unit, as it is along the axes of a sweep.

    Raises
    ------
    InputError
        If it has another unit; the message names `subject`.
    """
    if isinstance(value, str) and is_number(value):
        value = f"{value} {unit.text}"
    if unit.dimension == TIME or not isinstance(value, str):
        return parse_time(value, subject)
    quantity = parse_quantity(value)
    if quantity.unit.dimension != NONE:
        raise InputError(
            f"{subject} {value!r} has units '{quantity.unit.dimension}', and the model's time is a pure number"
        )
    return exact_si(quantity)


def constant(name: str) -> Unit:
    """Return the unit that a unit constant of the expression language stands for."""
    if name in _MONTH:  # no unit of a record: that of UDUNITS is a twelfth of a tropical year
        return Unit(name, TIME, _DAYS_OF_MONTH * 86_400)
    spelling, dimension, factor = look_up_unit(name)
    return Unit(spelling, dimension, factor)


def _read_float(value: Any) -> float:
    if isinstance(value, Real) and not isinstance(value, bool):
        try:
            return value if isinstance(value, Rounded) else float(value)
        except OverflowError:
            pass
    raise InputError(f"quantity {str(value)[:40]!r} is no number with a unit; write it like '0.145 kg'")


def _scaled_quantity(value: float, unit: str, shown_text: str, *, difference: bool = False) -> Quantity:
    if not isfinite(value):
        raise InputError(f"quantity {shown_text} is not finite")
    scale = parse_scale(unit)
    number = scale.difference(value) if difference else scale.value(value)
    return Quantity(number, scale.unit, None if scale.is_unit else scale)


def quotient(unit: str, divisor_unit: str) -> str:
    """Spell one unit over another."""
    inverse = []
    for factor in divisor_unit.split() if divisor_unit != "1" else ():
        name = factor.rstrip("-0123456789")
        power = int(factor[len(name) :] or 1)
        inverse.append(f"{name}{-power}")
    return parse_unit(" ".join(factor for factor in (unit, *inverse) if factor != "1") or "1").text


_RANGE = re.compile(r"\s*(?P<start>[^:\s]+)\s*:\s*(?P<stop>[^:\s]+)\s*:\s*(?P<count>\d+)(?![.\d])\s*(?P<unit>[^:]*)")


def is_range(value: Any) -> bool:
    """Whether a text is meant as ``start:stop:count unit``."""
    return isinstance(value, str) and _RANGE.fullmatch(value) is not None


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
        if not units:
            scale = parse_scale(match["unit"] or "1")
            start, stop = (scale.value(item.value) for item in ends)
            return cls(start, stop, int(match["count"]), scale.unit)
        unit = units[-1]
        start, stop = (
            item.value if item.unit.text in ("1", unit.text) else item.si / float(unit.factor) for item in ends
        )
        return cls(start, stop, int(match["count"]), unit)


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
    return Unit(DERIVED.get(dimension, base), dimension)


def coherent(unit: Unit) -> Unit:
    """Return the SI unit of a unit in its own spelling: without prefixes, and with base units for non-SI units.

    Examples
    --------
    >>> [coherent(parse_unit(text)).text for text in ("mN s m-1", "g", "degree s-1", "km h-1", "rad", "N m")]
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
    spelling, dimension, factor = look_up_unit(name)
    if factor == 1:
        return [(spelling, 1)]
    stems = [spelling.removeprefix(symbol) for symbol in PREFIX.values() if symbol and spelling.startswith(symbol)]
    matching = [symbol for symbol in stems if symbol in COHERENT and COHERENT[symbol] == dimension]
    if matching or dimension in DERIVED:
        return [(matching[0] if matching else DERIVED[dimension], 1)]
    if dimension == NONE:
        return [("rad", 1)] if spelling == "degree" else []
    return [(base, int(power)) for base, power in zip(BASE, dimension.powers, strict=True) if power]


_NEEDED = {"length": base_powers(m=1), "time": TIME, "mass": base_powers(kg=1)}


@dataclass(frozen=True)
class Scales:
    """Length, time and mass that count as one inside a march in nondimensional variables, in SI units."""

    length: float = 1.0
    time: float = 1.0
    mass: float = 1.0

    @classmethod
    def parse(cls, scales: dict[str, Any] | None) -> Scales:
        """Read ``{"length": "1 astronomical_unit", …}``; scales not given are one SI unit.

        Raises
        ------
        InputError
            If a scale is unknown, has the wrong dimension or is not positive.
        """
        values = {}
        if not isinstance(scales, Mapping | None):
            raise InputError(f'scales are {scales!r}, need a table like {{ length = "1 m" }}')
        for name, text in (scales or {}).items():
            if name not in _NEEDED:
                raise InputError(f"scale {name!r} is not known; there are length, time and mass")
            quantity = parse_quantity(text)
            if quantity.unit.dimension != _NEEDED[name] or not 1e-40 <= quantity.si <= 1e40:
                raise InputError(
                    f"{name} scale is {text!r}, needs a positive quantity in '{_NEEDED[name]}', 1e-40 to 1e40"
                )
            values[name] = quantity.si
        return cls(**values)

    def si_factor(self, dimension: Dimension) -> float:
        """SI units in one nondimensional unit of a dimension, by multiplication and square roots only."""
        kilogram, metre, second = dimension.powers[:3]
        return _scale_power(self.mass, kilogram) * _scale_power(self.length, metre) * _scale_power(self.time, second)


def _scale_power(base: float, exponent: Fraction) -> float:
    if base == 1.0 or exponent == 0:
        return 1.0
    if exponent.denominator == 2:
        return float(_scale_power(base, Fraction(exponent.numerator)) ** 0.5)
    result = 1.0
    for _ in range(abs(int(exponent))):
        result *= base
    return result if exponent > 0 else 1.0 / result


UNSCALED = Scales()
