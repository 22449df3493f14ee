"""Whether the elements of a quantity fit into memory, asked before they are made."""

from __future__ import annotations

import math

from xdynamics.faults import InputError
from xdynamics.runtime.free_memory import ROOM, free_memory, size_text
from xdynamics.shapes import Shapes

NUMBERS_OF_ELEMENT = 30  # at least, of a coordinate in a march
FEW_ELEMENTS = 100_000  # which always fit


def check_element_memory(dims: tuple[str, ...], shapes: Shapes) -> None:
    """Refuse a quantity whose elements could not be marched in the memory that can be had, before they are made.

    Raises
    ------
    InputError
        With the number of elements, what they take, and what there is.
    """
    size = math.prod(shapes.extent(dim).size for dim in dims)
    needed = NUMBERS_OF_ELEMENT * 8.0 * size
    if size > FEW_ELEMENTS and needed > (room := ROOM * free_memory()):
        raise InputError(
            f"has {size} elements along {', '.join(dims)}, which take {size_text(needed)} to march, and"
            f" {size_text(room)} of memory can be had; take fewer"
        )
