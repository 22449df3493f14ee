"""Names of variables that are elements of quantities with dimensions, gathered by their quantities."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.schema import ELEMENT_NAME, ELEMENTS, NOWHERE, side_of
from xdynamics.shapes import Shapes
from xdynamics.shapes.naming import DOT, display_text

Array = NDArray[Any]

FORCES = ("force_", "sample_force_")  # of which the elements that are not there are 0: the force does not act there


SIDE = side_of("")


@dataclass(frozen=True)
class QuantityElements:
    """A quantity with dimensions among variables that are its elements.

    Attributes
    ----------
    name : str
    dims : tuple of str
    shape : tuple of int
    members : dict of int to str
        By its number, the last dimension fastest, the name of each element that is there.
    pattern : str
        How the names of elements are made, like ``event_{}_uncertainty``; empty where labels stand at their end.
    """

    name: str
    dims: tuple[str, ...]
    shape: tuple[int, ...]
    pattern: str = ""
    members: dict[int, str] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """How many elements it has."""
        return int(np.prod(self.shape))

    @property
    def missing(self) -> float:
        """The value of an element that is not there."""
        return 0.0 if self.name.startswith(FORCES) else np.nan

    @property
    def more(self) -> dict[str, str]:
        """Attributes that say how its elements are named, and which it has."""
        listed_elements = (
            {}
            if len(self.members) == self.size or not self.missing
            else {ELEMENTS: names_as_words(self.members.values())}
        )
        return listed_elements | ({ELEMENT_NAME: self.pattern} if self.pattern else {})

    def stacked(self, parts: Mapping[int, Array]) -> Array:
        """Return the values of elements as one array, its dimensions last."""
        first = next(iter(parts.values()))
        stack = np.empty((self.size, *first.shape), first.dtype)
        if len(parts) < self.size:
            # where an element has no switch, its side is elsewhere
            stack[:] = self.missing if first.dtype.kind == "f" else 0 if self.name.startswith(SIDE) else NOWHERE
        for number, values in parts.items():
            stack[number] = values
        return np.moveaxis(stack, 0, -1).reshape((*first.shape, *self.shape))


def names_as_words(names: Iterable[str]) -> str:
    """Write names as words of one text, elements as people write them."""
    return " ".join(display_text(name).replace(" ", "") for name in names)


def expand_quantities(names: Iterable[str], known_names: Iterable[str], shapes: Shapes) -> tuple[str, ...]:
    """Return names with the elements of a quantity, as far as they are known, in its place."""
    quantities = Names(shapes).by_quantity(known_names) if shapes.dims else {}
    return tuple(
        member for name in names for member in (quantities[name].members.values() if name in quantities else (name,))
    )


class Names:
    """Which names are elements of which quantity."""

    def __init__(self, shapes: Shapes) -> None:
        self.shapes = shapes
        self._known: dict[tuple[str, int], tuple[str, ...]] = {}
        self._labels = {name: frozenset(extent.labels) for name, extent in shapes.extents.items()}

    def by_quantity(self, names: Iterable[str]) -> dict[str, QuantityElements]:
        """Gather names that are elements by their quantities."""
        quantities: dict[str, QuantityElements] = {}
        for name in names:
            if DOT in name and (position := self._element_position(name)):
                quantity, number = position
                quantities.setdefault(quantity.name, quantity).members[number] = name
        return quantities

    def _element_position(self, name: str) -> tuple[QuantityElements, int] | None:
        """Return the quantity of an element, and its number there."""
        stem, *labels = name.split(DOT)
        dims = self._dims(stem, len(labels))
        if not dims:
            return None
        last, tail = self._cut(labels[-1], dims[-1])
        if not all(map(self._has, dims, (*labels[:-1], last))):
            return None
        numbers = [self._number(dim, label) for dim, label in zip(dims, (*labels[:-1], last), strict=True)]
        shape = self.shapes.shape(dims)
        number = 0
        for size, index in zip(shape, numbers, strict=True):
            number = number * size + index
        return QuantityElements(stem + tail, dims, shape, f"{stem}{{}}{tail}" if tail else ""), number

    def _dims(self, stem: str, count: int) -> tuple[str, ...]:
        """Return the dimensions of a quantity: of the longest name at its end that has some."""
        if (stem, count) not in self._known:
            self._known[stem, count] = self.shapes.dims_at_end(stem, count)
        return self._known[stem, count]

    def _cut(self, label: str, dim: str) -> tuple[str, str]:
        """Part the last label from what follows it, as in ``event_height·Jupiter_uncertainty``."""
        if self._has(dim, label):
            return label, ""
        ends = (i for i in range(len(label) - 1, 0, -1) if label[i] == "_" and self._has(dim, label[:i]))
        end = next(ends, len(label))
        return label[:end], label[end:]

    def _has(self, dim: str, label: str) -> bool:
        known_labels = self._labels.get(dim)
        return label in known_labels if known_labels else label.isdigit() and int(label) < self.shapes.extent(dim).size

    def _number(self, dim: str, label: str) -> int:
        return self.shapes.extent(dim).number(label if self._labels.get(dim) else int(label))
