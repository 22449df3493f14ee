"""What a model says of its elements, made where somebody asks for it: a model of many bodies has many trees."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Generic, TypeVar

from xdynamics.expressions import Node
from xdynamics.expressions.calculus import ZERO
from xdynamics.model.parts import Force
from xdynamics.runtime.cached_properties import cached_property

Part = TypeVar("Part")


class Lazy(Mapping[str, Part], Generic[Part]):
    """A mapping whose names are known, and whose values are made when they are asked for, and kept.

    Parameters
    ----------
    values : mapping of str to partial or anything
        What makes the value, or the value itself.
    """

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = dict(values)

    def __getitem__(self, name: str) -> Part:
        value = self._values[name]
        if isinstance(value, partial):
            value = self._values[name] = value()
        made: Part = value
        return made

    def __contains__(self, name: object) -> bool:
        return name in self._values

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)


class Diagonal(Sequence[tuple[Node, ...]]):
    """A diagonal mass matrix, of which only the diagonal is kept.

    Parameters
    ----------
    names : sequence of str
    entries : mapping of str to Node
        The mass of each.
    """

    def __init__(self, names: Sequence[str], entries: Mapping[str, Node]) -> None:
        self.names, self._entries = names, entries

    def __getitem__(self, i: Any) -> Any:
        if isinstance(i, slice):
            return tuple(self[k] for k in range(*i.indices(len(self))))
        i = range(len(self))[i]
        return (ZERO,) * i + (self._entries[self.names[i]],) + (ZERO,) * (len(self) - i - 1)

    def diagonal_entry(self, i: int) -> Node:
        """Return the mass of a coordinate by its number."""
        return self._entries[self.names[i]]

    def __len__(self) -> int:
        return len(self.names)

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Sequence) and tuple(self) == tuple(other))

    __hash__ = None  # type: ignore[assignment]

    @property
    def entries(self) -> dict[tuple[int, int], Node]:
        """Every entry that is not a literal zero, by row and column."""
        numbered_entries = ((i, self._entries[name]) for i, name in enumerate(self.names))
        return {(i, i): entry for i, entry in numbered_entries if entry != ZERO}


def own_mass(mass: Sequence[tuple[Node, ...]], i: int) -> Node:
    """Return the mass of a coordinate by its number: the entry on the diagonal."""
    entry: Node = mass.diagonal_entry(i) if isinstance(mass, Diagonal) else mass[i][i]
    return entry


class ForceOfPotential(Force):
    """A force term of the elements, whose potential is made when it is asked for."""

    def __init__(self, declared_force: Force, potential: Callable[[], Node], components: Mapping[str, Any]) -> None:
        # frozen: its numbers are those of the other, and nothing sets `potential`, which is found on the class
        self.__dict__.update(vars(declared_force) | {"components": components, "over": "", "_potential": potential})
        del self.__dict__["potential"]

    @cached_property
    def potential(self) -> Node:
        """The sum over all elements."""
        made: Callable[[], Node] = self.__dict__["_potential"]
        return made()
