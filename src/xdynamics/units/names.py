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
_WITH_PREFIXES = {
    "meter": "m", "gram": "g", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd",
    "radian": "rad", "newton": "N", "joule": "J", "watt": "W", "pascal": "Pa", "hertz": "Hz", "volt": "V", "coulomb": "C",
    "ohm": "ohm", "farad": "F", "tesla": "T", "weber": "Wb", "henry": "H", "siemens": "S", "liter": "L", "bar": "bar",
    "calorie": "thermochemical_calorie",
}  # fmt: skip
NO_PREFIX = {
    "degree": "degree", "minute": "min", "hour": "h", "day": "d", "week": "week", "year": "Julian_year", "inch": "inch",
    "foot": "foot", "yard": "yard", "mile": "mile", "nautical_mile": "nautical_mile", "astronomical_unit": "astronomical_unit",
    "angstrom": "angstrom", "hectare": "hectare", "knot": "knot", "pound": "lb", "metric_ton": "tonne", "force_pound": "lbf",
    "force_kilogram": "kgf", "kip": "kip", "dyne": "dyne", "erg": "erg", "pound_force_per_square_inch": "psi",
    "kip_per_square_inch": "ksi", "standard_atmosphere": "atm", "standard_gravity": "gravity", "poise": "poise",
    "stokes": "stokes", "turn": "revolution", "revolutions_per_minute": "rpm", "arcminute": "arcminute",
    "arcsecond": "arcsecond", "percent": "percent", "ppm": "ppm",
}  # fmt: skip
SPELLING = _WITH_PREFIXES | NO_PREFIX
PREFIX = {"": "", "kilo": "k", "milli": "m", "micro": "u", "nano": "n", "pico": "p", "centi": "c", "deci": "d",
          "hecto": "h", "mega": "M", "giga": "G", "tera": "T", "femto": "f", "atto": "a", "peta": "P", "exa": "E",
          "zepto": "z", "yocto": "y", "zetta": "Z", "yotta": "Y", "deca": "da"}  # fmt: skip
# prefixes of 2022 (27th CGPM, resolution 3), which UDUNITS cannot read: a record has no spelling for them
_UNSPELLED = {"ronna": "1e27", "quetta": "1e30", "ronto": "1e-27", "quecto": "1e-30"}
# names that stand for products, or that instruments write in capitals, and how a record spells them
PRODUCTS = {
    "mph": "mile h-1", "kph": "km h-1", "kmh": "km h-1", "Wh": "W h", "kWh": "kW h", "MWh": "MW h", "Ah": "A h", "mAh": "mA h",
    "Nm": "N m", "kNm": "kN m", "Nmm": "N mm", "cc": "cm3", "cP": "mPa s", "cSt": "mm2 s-1", "rev": "revolution", "lbm": "lb",
    "MPH": "mile h-1", "RPM": "rpm", "PSI": "psi", "Rpm": "rpm", "Psi": "psi", "Ft": "foot", "FT": "foot", "Kg": "kg",
    "KG": "kg", "Lb": "lb", "LB": "lb", "Lbf": "lbf", "LBF": "lbf", "Sec": "s", "SEC": "s", "Deg": "degree", "DEG": "degree",
    "Bar": "bar", "Hr": "h",
}  # fmt: skip
# unit names that are constants of the expression language: no number there is without a unit
CONSTANTS = ("metre", "meter", "second", "kilogram", "gram", "ampere", "kelvin", "mole", "candela", "radian",
             "degree", "newton", "joule", "watt", "pascal", "hertz", "volt", "coulomb", "ohm", "farad", "tesla",
             "minute", "hour", "day")  # fmt: skip
CALENDAR = ("year", "month")  # Julian, 365.25 days and a twelfth of that; constants too, unless a model has that name

_PI = Fraction("3.1415926535897932384626433832795028841971693993751")
# units that values may be given in, and what they are kept in; UDUNITS has other sizes under these names (9.46073e15 and
# 3.085678e16 m, 745.6999 W, 14.5939 kg, 0.02834952 kg, 133.322387415 Pa, 1.60217733e-19 J), so that they have no place in a
# record: c times a Julian year (IAU, style manual, 1989), and 648000/pi au (IAU, 2015, resolution B2, note 4), of which an au
# is 149597870700 m (IAU, 2012, resolution B2); 550 foot lbf s-1, lbf s2 foot-1, 1/16 lb and 1/760 atm (NIST SP 811, 2008,
# appendix B); e V (SI brochure, 9th ed., 2019)
UNITS_OF_VALUES = {
    "light_year": ("m", Fraction(299_792_458 * 31_557_600)),
    "parsec": ("m", Fraction(648_000 * 149_597_870_700) / _PI),
    "horsepower": ("W", 550 * Fraction("0.3048") * Fraction("4.4482216152605")),
    "slug": ("kg", Fraction("4.4482216152605") / Fraction("0.3048")),
    "ounce": ("lb", Fraction(1, 16)),
    "torr": ("Pa", Fraction(101_325, 760)),
    "electron_volt": ("J", Fraction("1.602176634e-19")),
}
# what to write for units of several sizes, or of none
REMEDIES = {
    "gallon": "a gallon is 3.785411784 L in the US and 4.54609 L in the UK: write the number in L",
    "imperial_gallon": "an imperial gallon is 4.54609 L: write the number in L",
    "british_thermal_unit": "a BTU has several sizes, of which the international one is 1055.05585262 J: write the number in J",
    "ton": "a ton has several sizes: write 'tonne' for 1000 kg, or the number in lb, 2000 of a short and 2240 of a long ton",
    "decibel": "a level is the logarithm of a ratio: write the ratio itself, 10**(level/20) of amplitudes, 10**(level/10) of powers",
}
# spelling of each unit constant, and what is not coherent with its factor: known here, so that a model in SI units
# does not wait for pint's dictionary
_SPELLED = {name: (SPELLING | {"metre": "m", "kilogram": "kg"})[name] for name in CONSTANTS} | {"year": "Julian_year"}
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
    "mmHg": (COHERENT["Pa"], Fraction("133.322387415")),
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
        if unit in REMEDIES:
            return f" here: {REMEDIES[unit]}"
        if unit in UNITS_OF_VALUES and (kept := UNITS_OF_VALUES[unit][0]) != "m":
            return f" here: a value alone may be given in {unit}, and is kept in {kept}; in a product write '{kept}'"
        if unit in UNITS_OF_VALUES:
            return (
                f" here: a value alone may be given in light_year (ly) or parsec (pc, kpc, Mpc, Gpc), like '20 {unit}', and is"
                " kept in m; in a product write 'm', 'km' or 'astronomical_unit'"
            )
    return "; use names and symbols of SI, or of UDUNITS where it has the exact size, like 'm', 'kg', 'degree', 'lbf', 'rpm'"


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
    if not readings and len(name) > 3:  # a full name as tables write it, Newtons, FEET; no symbol, as of Cal and Mpa
        in_full = registry.parse_unit_name(name.lower())
        readings = [(prefix, unit) for prefix, unit, _ in in_full if not prefix]
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
