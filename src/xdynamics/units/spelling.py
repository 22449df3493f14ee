"""The SI unit of a dimension or of a unit, as a record spells it."""

from __future__ import annotations

from xdynamics.faults import InputError
from xdynamics.units.dimension import BASE, COHERENT, DERIVED, ENERGY, NONE, Dimension
from xdynamics.units.names import PREFIX, look_up_unit
from xdynamics.units.reading import parse_unit
from xdynamics.units.unit import Unit


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
    """Return the SI unit of a unit, spelled as it was: prefixes go, and what is no SI unit becomes base units.

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
