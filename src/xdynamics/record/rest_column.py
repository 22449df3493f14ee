"""The column of what is left of a number beside its float, where numbers are sums of two."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.double_double import DoubleDouble, nearest
from xdynamics.elementary.double_double.sums import add, multiply
from xdynamics.march import LogBlock
from xdynamics.record.column import About, Column, row_of, times
from xdynamics.schema import STEPS, Variable
from xdynamics.shapes.blocks import Block as Quantity

Array = NDArray[Any]


def rest_column(about: About, own: Quantity, rest: Quantity) -> Column:
    """Return what is left of a number beside the nearest float that is recorded."""
    unit, rows = about.units.known[own.name], [about.layout.row.place(quantity.name) for quantity in (own, rest)]
    factor = about.units.factor(unit)
    exact = nearest(1 / Fraction(unit.factor))

    def left(block: LogBlock) -> Array:
        numbers = [row_of(row, 1.0, own.shape)(block) for row in rows]
        product = multiply(DoubleDouble(*numbers), exact)
        rests: Array = add(product, DoubleDouble(-times(numbers[0], factor), 0.0 * numbers[0])).high
        return rests

    long_name = f"what a float does not hold of {own.name}: the number is {own.name} + {rest.name}"
    return Column(Variable(rest.name, (STEPS, *own.dims), "f8", unit.text, long_name, schema.LEFT_OVER), left)
