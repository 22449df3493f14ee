"""Units: UDUNITS spelling in and out, dimensions, exact conversion to SI, scales.

Text is taken apart here, under limits. Conversion factors are exact fractions, so that ``"1 ms"``, ``"1e-3 s"`` and
``0.001`` seconds are the same float.
"""

from xdynamics.units.names import CALENDAR, CONSTANTS, PREFIX, PRODUCTS, SPELLING, constant_of
from xdynamics.units.reading import (
    UNSCALED,
    Range,
    Scales,
    coherent,
    constant,
    is_number,
    is_range,
    parse_quantity,
    parse_scale,
    parse_time,
    parse_unit,
    quotient,
    spell,
    time_in,
    unit_text,
)
from xdynamics.units.unit import (
    BASE,
    ENERGY,
    NONE,
    NUMBERS,
    SECONDS,
    TIME,
    UNKNOWN_UNIT,
    Dimension,
    Quantity,
    Scale,
    Unit,
    unit_suffix,
)

__all__ = [
    "BASE", "CALENDAR", "CONSTANTS", "ENERGY", "NONE", "NUMBERS", "PREFIX", "PRODUCTS", "SECONDS", "SPELLING", "TIME", "UNKNOWN_UNIT", "UNSCALED", "Dimension", "Quantity",
    "Range", "Scale", "Scales", "Unit", "coherent", "constant", "constant_of", "is_number", "is_range", "parse_quantity", "parse_scale", "parse_time", "parse_unit", "quotient",
    "spell", "time_in", "unit_suffix", "unit_text",
]  # fmt: skip
