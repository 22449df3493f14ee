"""The values along an axis as people write them: a range, a list, a row of texts or numbers, an array with units."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.units import Quantity, Range, Scale, Unit, is_range, parse_quantity, parse_scale, parse_unit

Values = NDArray[Any]

MAX_VALUES = 10_000_000  # along one axis


def axis_numbers(entries: Any, declared: Scale) -> tuple[Values, Unit]:
    """Read values: a text with a range or a list, a row of texts or numbers, an array with units.

    Those without a unit are on the declared scale.

    Raises
    ------
    InputError
        If there are no values, or one is not a finite number with a unit of the declared dimension.
    """
    values, unit = exact_numbers(entries, declared)
    return np.array(values, float), unit


def exact_numbers(entries: Any, declared: Scale) -> tuple[Values | list[float], Unit]:
    """Read the same; numbers in a list keep the digits that they were written with, where these are more than a float has.

    Raises
    ------
    InputError
        If there are no values, or one is not a finite number with a unit of the declared dimension.
    """
    if is_range(entries):
        values, unit = _read_range(entries)
        if unit == parse_unit("1"):
            values, unit = _scaled_numbers(values, declared), declared.unit
        return _checked_array(values, unit, declared.unit), unit
    if isinstance(entries, str):
        quantities = _read_list_text(entries)
    elif isinstance(entries, Quantity | int | float):
        quantities = [_read_quantity(entries, declared)]
    else:
        attrs = getattr(entries, "attrs", {})
        scale = parse_scale(str(attrs["units"])) if "units" in attrs else declared
        try:
            row = getattr(entries, "values", entries)
            row = row if isinstance(row, np.ndarray) and row.dtype.kind in "fiu" and row.ndim == 1 else list(row)
        except TypeError:
            raise InputError(f"is {str(entries)[:60]!r}, needs values like ['1 {declared.unit.text}']") from None
        if isinstance(row, np.ndarray):
            return _checked_array(_scaled_numbers(row, scale), scale.unit, declared.unit), scale.unit
        quantities = [_read_quantity(quantity, scale) for quantity in row]
    if not quantities:
        raise InputError("has no values")
    quantities = _with_default_unit(quantities, declared)
    for quantity in quantities:
        _check_unit(quantity.value, quantity.unit, declared.unit)
    unit = quantities[0].unit
    return [quantity.into(unit).value for quantity in quantities], unit


def _checked_array(values: Values, unit: Unit, declared: Unit) -> Values:
    """Check an array of numbers in one unit."""
    if not values.size:
        raise InputError("has no values")
    non_finite = values[~np.isfinite(values)]
    if non_finite.size:
        raise InputError(f"has {float(non_finite[0])!r}, needs finite numbers")
    _check_unit(float(values[0]), unit, declared)
    return values.astype(float)


def _check_unit(value: float, unit: Unit, declared: Unit) -> None:
    if unit.dimension != declared.dimension:
        raise InputError(f"has {value!r} {unit.text}, needs the unit '{declared.text}'")


def _scaled_numbers(values: Values, scale: Scale) -> Values:
    """Return bare numbers in the unit of their scale."""
    return values if scale.is_unit else np.array([*map(scale.value, values.tolist())])


def _with_default_unit(quantities: list[Quantity], scale: Scale) -> list[Quantity]:
    """Put the quantities that have no unit on a scale."""
    no_unit = parse_unit("1")
    return [
        Quantity(scale.value(quantity.value), scale.unit) if quantity.unit == no_unit else quantity
        for quantity in quantities
    ]


def _read_quantity(value: Any, declared: Scale) -> Quantity:
    if isinstance(value, Quantity):
        return value
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        raise InputError(f"has {value!r}, needs numbers")
    if isinstance(value, int | float):
        if not np.isfinite(value):
            raise InputError(f"has {value!r}, needs finite numbers")
        return Quantity(declared.value(float(value)), declared.unit)
    return parse_quantity(value)


def _read_list_text(text: str) -> list[Quantity]:
    """Read ``1, 2, 5 kg`` or ``1 kg``."""
    if ":" in text:
        raise InputError(f"is {text!r}, needs start:stop:count unit, count a whole number, like '0:2e-3:41 kg m-1'")
    quantities = [parse_quantity(part) for part in text.split(",")]
    return _with_default_unit(quantities, quantities[-1].scale_of_numbers)


def _read_range(text: str) -> tuple[Values, Unit]:
    """Read ``0:2e-3:41 kg m-1``: start:stop:count, both ends included."""
    value_range = Range.parse(text)
    if not (1 < value_range.count <= MAX_VALUES or (value_range.count == 1 and value_range.start == value_range.stop)):
        raise InputError(f"is {text!r}, needs start:stop:count unit, both ends included, count from 2 to {MAX_VALUES}")
    return np.linspace(value_range.start, value_range.stop, value_range.count), value_range.unit
