"""Names of units: how UDUNITS spells them, and their exact sizes.

pint is the dictionary of names and nothing else: it is only ever asked for a single name.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units.unit import COHERENT, NONE, TIME, Dimension, base_powers

# pint's name of a unit -> how UDUNITS spells it, where both mean the same size (an electronvolt differs; a year of
# UDUNITS is the tropical one, pint's its Julian_year); a unit outside this table has no place in a record
SPELLING = {
    "meter": "m", "gram": "g", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd",
    "radian": "rad", "degree": "degree", "newton": "N", "joule": "J", "watt": "W", "pascal": "Pa", "hertz": "Hz",
    "volt": "V", "coulomb": "C", "ohm": "ohm", "farad": "F", "tesla": "T", "weber": "Wb", "henry": "H",
    "siemens": "S", "minute": "min", "hour": "h", "day": "d", "year": "Julian_year", "liter": "L", "bar": "bar",
    "astronomical_unit": "astronomical_unit", "inch": "inch", "foot": "foot", "mile": "mile",
    "pound": "lb", "force_pound": "lbf", "percent": "percent", "metric_ton": "tonne",
}  # fmt: skip
PREFIX = {"": "", "kilo": "k", "milli": "m", "micro": "u", "nano": "n", "pico": "p", "centi": "c", "deci": "d",
          "hecto": "h", "mega": "M", "giga": "G", "tera": "T", "femto": "f", "atto": "a", "peta": "P", "exa": "E",
          "zepto": "z", "yocto": "y", "zetta": "Z", "yotta": "Y", "deca": "da"}  # fmt: skip
# prefixes of 2022 (27th CGPM, resolution 3), which UDUNITS cannot read: a record has no spelling for them
_UNSPELLED = {"ronna": "1e27", "quetta": "1e30", "ronto": "1e-27", "quecto": "1e-30"}
NO_PREFIX = ("minute", "hour", "day", "year", "degree", "inch", "foot", "mile", "pound", "force_pound", "percent", "metric_ton",
             "astronomical_unit")  # fmt: skip
# unit names that are constants of the expression language: no number there is without a unit
CONSTANTS = ("metre", "meter", "second", "kilogram", "gram", "ampere", "kelvin", "mole", "candela", "radian",
             "degree", "newton", "joule", "watt", "pascal", "hertz", "volt", "coulomb", "ohm", "farad", "tesla",
             "minute", "hour", "day")  # fmt: skip
CALENDAR = ("year", "month")  # Julian, 365.25 days and a twelfth of that; constants too, unless a model has that name

_PI = Fraction("3.1415926535897932384626433832795028841971693993751")
# lengths that values may be given in, m; UDUNITS has others under these names (9.46073e15 and 3.085678e16 m), so that they
# have no place in a record: c times a Julian year (IAU, style manual, 1989), and 648000/pi au (IAU, 2015, resolution B2,
# note 4), of which an au is 149597870700 m (IAU, 2012, resolution B2)
LENGTHS_OF_VALUES = {
    "light_year": Fraction(299_792_458 * 31_557_600),
    "parsec": Fraction(648_000 * 149_597_870_700) / _PI,
}
# spelling of each unit constant, and what is not coherent with its factor: known here, so that a model in SI units
# does not wait for pint's dictionary
_SPELLED = dict(zip(CONSTANTS, ("m", "m", "s", "kg", "g", "A", "K", "mol", "cd", "rad", "degree", "N", "J", "W", "Pa", "Hz",
                                "V", "C", "ohm", "F", "T", "min", "h", "d"), strict=True), year="Julian_year")  # fmt: skip
_FACTORS = {
    "g": (base_powers(kg=1), Fraction(1, 1000)),
    "degree": (NONE, _PI / 180),
    "min": (TIME, Fraction(60)),
    "h": (TIME, Fraction(3600)),
    "d": (TIME, Fraction(86400)),
    "mm": (base_powers(m=1), Fraction(1, 1000)),
    "ms": (TIME, Fraction(1, 1000)),
    "cm": (base_powers(m=1), Fraction(1, 100)),
    "km": (base_powers(m=1), Fraction(1000)),
    "Julian_year": (TIME, Fraction(31_557_600)),
}


def constant_of(name: str) -> str:
    """Return the constant of the expression language that is a unit's name; empty if none is.

    Examples
    --------
    >>> constant_of("m"), constant_of("degrees"), constant_of("cm")
    ('metre', 'degree', '')
    """
    if name in CALENDAR:
        return name
    spelling = look_up_unit(name)[0]
    return next((constant for constant, spelled in _SPELLED.items() if spelled == spelling), "")


@lru_cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(non_int_type=Fraction)


def _unit_remedy(readings: list[tuple[str, str]], fitting: list[tuple[str, str]]) -> str:
    """Return how to replace a unit that a record cannot spell."""
    for prefix, unit in fitting:
        if prefix in _UNSPELLED:
            return (
                f": UDUNITS has no prefix {prefix}, {_UNSPELLED[prefix]}, and a record could not spell it; write the number in"
                f" '{SPELLING[unit]}', or with a prefix from y to Y"
            )
    for _, unit in readings:
        if unit in LENGTHS_OF_VALUES:
            return (
                f" here: a value alone may be given in light_year (ly) or parsec (pc, kpc, Mpc, Gpc), like '20 {unit}', and is"
                " kept in m; in a product write 'm', 'km' or 'astronomical_unit'"
            )
    return "; use SI names and symbols, like 'm', 'kg', 'degree'"


@lru_cache(maxsize=512)
def look_up_unit(name: str) -> tuple[str, Dimension, Fraction]:
    """Look one unit name up: its spelling, dimension and exact SI factor.

    Raises
    ------
    InputError
        If there is no unit of that name.
    """
    spelling = _SPELLED.get(name, name)
    if spelling in COHERENT:
        return spelling, COHERENT[spelling], Fraction(1)
    if spelling in _FACTORS:
        return spelling, *_FACTORS[spelling]
    if len(name) > 40:
        raise InputError(f"unit '{name[:40]}…' is not known")
    registry = _registry()
    readings = [(prefix, unit) for prefix, unit, _ in registry.parse_unit_name(name)]
    fitting = [
        (prefix, unit) for prefix, unit in readings if unit in SPELLING and (not prefix or unit not in NO_PREFIX)
    ]
    prefix, unit = next(((prefix, unit) for prefix, unit in fitting if prefix in PREFIX), ("", ""))
    if not unit:
        raise InputError(f"unit '{name}' is not known{_unit_remedy(readings, fitting)}")
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
    return PREFIX[prefix] + SPELLING[unit], base_powers(**base), Fraction(factor)
