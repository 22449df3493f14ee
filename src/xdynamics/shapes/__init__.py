"""Shapes: named dimensions, relations between their elements, and what an expression is at one element.

A quantity with dimensions is a name for its elements, and every expression with dimensions one for each of its own: the
elements are what is marched, located and judged. A record has one variable for the whole.
"""

from xdynamics.shapes.extents import NO_SHAPES, Extent, Relation, Shapes
from xdynamics.shapes.gradient import gradient
from xdynamics.shapes.naming import display_text, internal_text, join_element_name, split_element_name
from xdynamics.shapes.trees import at_element, dims_of, resolve_min_max

__all__ = [
    "NO_SHAPES",
    "Extent",
    "Relation",
    "Shapes",
    "at_element",
    "dims_of",
    "display_text",
    "gradient",
    "internal_text",
    "join_element_name",
    "resolve_min_max",
    "split_element_name",
]
