"""The column of what is left of a number beside its float, where numbers are sums of two."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.double_double import DoubleDouble, nearest
from xdynamics.elementary.double_double.sums import add, multiply
from xdynamics.march import LogBlock
from xdynamics.record.column import About, Column, multiply_values, take_row
from xdynamics.schema import STEPS, Variable
from xdynamics.shapes.blocks import Block as Quantity

Array = NDArray[Any]


def rest_column(about: About, number_quantity: Quantity, rest_quantity: Quantity) -> Column:
    """Return what is left of a number beside the nearest float that is recorded."""
    unit, rows = (
        about.units.known[number_quantity.name],
        [about.layout.row.offset_of(quantity.name) for quantity in (number_quantity, rest_quantity)],
    )
    factor = about.units.factor(unit)
    exact = nearest(1 / Fraction(unit.factor))

    def take_rest(block: LogBlock) -> Array:
        numbers = [take_row(row, 1.0, number_quantity.shape)(block) for row in rows]
        product = multiply(DoubleDouble(*numbers), exact)
        rests: Array = add(product, DoubleDouble(-multiply_values(numbers[0], factor), 0.0 * numbers[0])).high
        return rests

    long_name = f"what a float does not hold of {number_quantity.name}: the number is {number_quantity.name} + {rest_quantity.name}"
    return Column(
        Variable(rest_quantity.name, (STEPS, *number_quantity.dims), "f8", unit.text, long_name, schema.LEFT_OVER),
        take_rest,
    )
