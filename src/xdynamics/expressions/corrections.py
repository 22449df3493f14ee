"""What was probably meant by a text that cannot be read: numbers with units, marks of derivatives, signs of print."""

from __future__ import annotations

import re
from collections.abc import Callable

from xdynamics.faults import InputError
from xdynamics.units import coherent, constant_of, parse_quantity

LONGEST_CORRECTED = 1000  # characters; a longer text is not rewritten

_SIGNS = {
    **dict.fromkeys("·×∙⋅", "*"),
    **dict.fromkeys("−–", "-"),
    "÷": "/",
    "²": "**2",
    "³": "**3",
    "^": "**",
    "π": "pi",
    "°": " degree",
}
_MODULE = re.compile(r"\b(?:np|numpy|math)\.(?=[a-z])")
_MARKED = re.compile(r"\b(?!v_)([A-Za-z][A-Za-z0-9_]*)'(?!')")
_NUMBER = r"(?<![A-Za-z0-9_.])(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)(?![0-9.]|[eE][+-]?[0-9])"
_WORD = r"[A-Za-z]+(?:(?:\*\*|\^)?[+-]?[0-9]+(?![A-Za-z0-9_.]))?(?![A-Za-z0-9_(])"
_WITH_UNIT = re.compile(rf"{_NUMBER} *(?P<unit>{_WORD}(?:(?: +| */ *){_WORD})*)")
_FACTOR = re.compile(r"(?P<sign>/?) *(?P<name>[A-Za-z]+)(?:\*\*)?(?P<power>[+-]?[0-9]+)?")
_IMPLIED = re.compile(rf"{_NUMBER} *(?=[A-Za-z_(])|(?<=\)) *(?=[A-Za-z0-9_(])")


def likely_correction(source: str, is_readable: Callable[[str], bool]) -> str:
    """Return what to write in the place of a text that cannot be read, as the end of a message; empty if that is not known.

    Examples
    --------
    >>> likely_correction("sin(30 degree)", lambda text: " d" not in text)
    "; write 'sin(30*degree)'"
    """
    if len(source) > LONGEST_CORRECTED:
        return ""
    plain = _MARKED.sub(r"v_\1", _MODULE.sub("", "".join(_SIGNS.get(sign, sign) for sign in source)))
    with_units, multiplied = _multiplied(_WITH_UNIT.sub(_unit_product, plain)), _multiplied(plain)
    candidates = [text for text in dict.fromkeys((with_units, multiplied)) if text != source and is_readable(text)]
    if not candidates:
        return ""
    if len(candidates) == 1:
        return f"; write '{candidates[0]}'"
    symbol = next(re.finditer("[A-Za-z0-9]+", next(_WITH_UNIT.finditer(plain))["unit"]))[0]
    return f"; write '{candidates[0]}', or '{candidates[1]}' if {symbol} is a name of the model"


def with_unit_names(quantity: str) -> str:
    """Return a quantity as an expression: its number times the names of its unit.

    Examples
    --------
    >>> with_unit_names("-5 N"), with_unit_names("10 ms")
    ('-5*newton', '0.01*second')
    """
    return _WITH_UNIT.sub(_unit_product, quantity)


def _unit_product(match: re.Match[str]) -> str:
    """Write a number and its unit as a product of unit names; one that has no name in SI units."""
    try:
        quantity = parse_quantity(match[0])
    except InputError:
        return match[0]
    factors = [*_FACTOR.finditer(match["unit"])]
    number = match["number"]
    if not all(constant_of(factor["name"]) for factor in factors):
        number, factors = repr(quantity.si), [*_FACTOR.finditer(coherent(quantity.unit).text)]
    names = (f"{factor['sign'] or '*'}{constant_of(factor['name'])}" for factor in factors)
    powers = (f"**{int(factor['power'])}" if factor["power"] else "" for factor in factors)
    return number + "".join(name + power for name, power in zip(names, powers, strict=True))


def _multiplied(text: str) -> str:
    """Write the products that a text leaves out, as after the number of ``2 x``."""
    return _IMPLIED.sub(lambda match: f"{match['number'] or ''}*", text)
