"""Evenly spaced numbers with a unit, as one text."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from xdynamics.faults import InputError
from xdynamics.units.reading import parse_quantity, parse_scale
from xdynamics.units.unit import Unit

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
