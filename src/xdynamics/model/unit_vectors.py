"""Directions and attitudes as plain numbers: of unit length, or brought to it."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from typing import Any

from xdynamics.faults import InputError, brief_repr

UNIT = 1e-12  # how far from 1 the length of a quaternion may be that is written in decimals
FORMS = {3: "[x, y, z]", 4: '[w, x, y, z], or { axis = [0, 0, 1], angle = "30 degree" }'}


def plain_numbers(value: Any, key: str, count: int) -> list[float]:
    """Read three or four numbers.

    Raises
    ------
    InputError
        If it is anything else.
    """
    plain = isinstance(value, list | tuple) and all(
        isinstance(entry, int | float) and not isinstance(entry, bool) for entry in value
    )
    if not plain or len(value) != count:
        raise InputError(f"{key} is {brief_repr(value)}, needs numbers {FORMS[count]}")
    return [float(entry) for entry in value]


def normalised(numbers: Sequence[float], key: str) -> list[float]:
    """Return numbers over their length.

    Raises
    ------
    InputError
        If that is zero or not finite.
    """
    length = hypot(*numbers)
    if not 0.0 < length < float("inf"):
        raise InputError(f"{key} is {[*numbers]}, of length {length!r}, and says nothing of directions")
    return [entry / length for entry in numbers]


def unit_quaternion(value: Any) -> list[float]:
    """Read four numbers of unit length.

    Raises
    ------
    InputError
        If they are not, or have another length.
    """
    numbers = plain_numbers(value, "attitude", 4)
    unit, length = normalised(numbers, "attitude"), hypot(*numbers)
    if abs(length - 1.0) > UNIT:
        raise InputError(f"attitude is {numbers}, of length {length!r}; a unit quaternion is needed: write {unit}")
    return unit
