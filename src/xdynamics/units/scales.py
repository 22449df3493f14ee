"""Scales of length, time and mass, in which a march may be nondimensional."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units.dimension import TIME, Dimension, base_powers
from xdynamics.units.reading import parse_quantity

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
