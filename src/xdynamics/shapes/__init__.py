"""Shapes: named dimensions, relations between their elements, and what an expression is at one element.

A quantity with dimensions is a name for its elements, and every expression with dimensions one for each of its own: the
elements are what is marched, located and judged. A record has one variable for the whole.
"""

from xdynamics.shapes.extents import NO_SHAPES, Extent, Relation, Shapes
from xdynamics.shapes.gradient import gradient
from xdynamics.shapes.naming import element, parted, spoken, written
from xdynamics.shapes.trees import at, dims_of, prepared

__all__ = [
    "NO_SHAPES",
    "Extent",
    "Relation",
    "Shapes",
    "at",
    "dims_of",
    "element",
    "gradient",
    "parted",
    "prepared",
    "spoken",
    "written",
]
