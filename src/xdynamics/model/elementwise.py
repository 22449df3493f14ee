"""Trees, masses and numbers of a model by the names of its elements, made where they are first read.

They are lazy because a model of many bodies has many trees.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, KeysView, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node
from xdynamics.expressions.calculus import ZERO
from xdynamics.model.given_values import Values
from xdynamics.model.parts import Force, Parameter
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Shapes
from xdynamics.shapes.blocks import Block, Blocks
from xdynamics.units import Quantity, Scale, Unit

Part = TypeVar("Part")


class Lazy(Mapping[str, Part], Generic[Part]):
    """A mapping with known names, whose values are made on first look-up and cached.

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
    """A diagonal mass matrix, of which only the diagonal is stored.

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
        # a range resolves negative numbers, and raises IndexError beyond its ends, by which iteration stops
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
    """A force term of the elements, whose potential is made on first use."""

    def __init__(self, declared_force: Force, potential: Callable[[], Node], components: Mapping[str, Any]) -> None:
        # frozen: its numbers are those of the other, and nothing sets `potential`, which is found on the class
        self.__dict__.update(vars(declared_force) | {"components": components, "over": "", "_potential": potential})
        del self.__dict__["potential"]

    @cached_property
    def potential(self) -> Node:
        """The sum over all elements."""
        made: Callable[[], Node] = self.__dict__["_potential"]
        return made()


Make = Callable[[Mapping[str, int]], Part]


def always(part: Part) -> Make[Part]:
    """Return a function that gives one part for every element."""
    return lambda _: part


class Numbers:
    """Makes the quantity of an element from the numbers of all.

    Parameters
    ----------
    numbers : array_like
        Along the quantity's dimensions, in the unit.
    unit : Unit
    scale : Scale, optional
        That bare numbers in their place are on.
    """

    def __init__(self, numbers: Any, unit: Unit, scale: Scale | None = None) -> None:
        self.numbers, self.unit, self.scale = np.asarray(numbers, float), unit, scale

    def __call__(self, indices: Mapping[str, int]) -> Quantity:
        """Return the quantity of an element."""
        return Quantity(float(self.numbers[tuple(indices.values())]), self.unit, self.scale)

    @property
    def si(self) -> NDArray[np.float64]:
        """All numbers in SI units, in a row."""
        return self.numbers.reshape(-1) if self.unit.factor == 1 else self._converted

    @cached_property
    def _converted(self) -> NDArray[np.float64]:
        return self.unit.all_to_si(self.numbers.ravel())


class ParameterNumbers:
    """Makes the parameter of an element from the numbers of all.

    Parameters
    ----------
    numbers : sequence of float
        The last dimension fastest, in the unit; each may be the nearest float of a decimal number with more digits.
    shape : tuple of int
        How many elements there are along each dimension.
    unit : Unit
    declared_values : Values
        What the model says of them.
    """

    def __init__(
        self,
        numbers: Sequence[float] | NDArray[np.float64],
        shape: tuple[int, ...],
        unit: Unit,
        declared_values: Values,
    ) -> None:
        self.numbers, self.shape, self.unit, self.declared_values = numbers, shape, unit, declared_values

    def __call__(self, indices: Mapping[str, int]) -> Parameter:
        """Return the parameter of an element."""
        number = 0
        for index, size in zip(indices.values(), self.shape, strict=True):
            number = number * size + index
        return Parameter(
            self._as_quantity(self.numbers[number]),
            self.declared_values.spread(number),
            self.declared_values.description,
        )

    def _as_quantity(self, value: float) -> Quantity:
        return Quantity(float(value) if isinstance(value, np.float64) else value, self.unit, self.declared_values.scale)

    @property
    def values(self) -> NDArray[np.float64]:
        """All numbers in the unit."""
        return np.array(self.numbers, float).reshape(self.shape)

    @cached_property
    def si(self) -> NDArray[np.float64]:
        """All numbers in SI units, in a row."""
        if self.unit.factor == 1:
            return np.array(self.numbers, float)
        return np.array([self._as_quantity(value).si for value in self.numbers])


def put_in_si(values: Mapping[str, Any], blocks: Blocks, numbers: NDArray[np.float64]) -> None:
    """Write quantities or parameters in SI units into an array of shape (n,), in the order of some blocks."""
    first = 0
    for block in blocks.blocks:
        if isinstance(values, Elementwise) and block.dims:
            made = values.makers[block.name]
            part = made.si if isinstance(made, Numbers | ParameterNumbers) else values[block.first].si
        else:
            part = [values[name].si for name in block.elements()]
        numbers[first : first + block.size] = part
        first += block.size


def parameter_numbers(parameters: Mapping[str, Any], name: str) -> ParameterNumbers | None:
    """Return the numbers of a parameter with dimensions; None of others."""
    if not isinstance(parameters, Elementwise):
        return None
    made = parameters.makers.get(name)
    return made if isinstance(made, ParameterNumbers) and made.shape else None


def element_blocks(values: Mapping[str, Any]) -> Blocks:
    """Return the names of quantities or of elements as blocks, of which none is made."""
    return values.names if isinstance(values, Elementwise) else Blocks.from_names("", values)


def in_si(values: Mapping[str, Any], blocks: Blocks) -> NDArray[np.float64]:
    """Return quantities or parameters in SI units, in the order of some blocks."""
    numbers = np.empty(blocks.size)
    put_in_si(values, blocks, numbers)
    return numbers


class Elementwise(dict[str, Part]):
    """A dictionary by names of elements, whose names and values are made on look-up.

    A model of a million elements is read without one of them. What is asked for is kept as in any dictionary.

    Parameters
    ----------
    shapes : Shapes
        Which quantity has which dimensions.
    makers : mapping of str to callable
        By the name of each quantity, what makes the value at a place: a number for each of its dimensions.
    """

    def __init__(self, shapes: Shapes, makers: Mapping[str, Make[Part]]) -> None:
        super().__init__()
        self.names = Blocks.from_names("", makers, shapes)
        self.makers = dict(makers)

    @classmethod
    def _from_parts(cls, names: Iterable[Block], makers: Mapping[str, Make[Part]], values: Mapping[str, Part]) -> Any:
        merged = cls.__new__(cls)
        dict.__init__(merged)
        dict.update(merged, values)
        merged.names, merged.makers = Blocks(names), dict(makers)
        return merged

    def __missing__(self, name: str) -> Part:
        if name not in self.names:
            raise KeyError(name)
        block = self.names.block(name)
        value = self.makers[block.name](block.indices_of(name) if block.dims else {})
        self[name] = value
        return value

    def get(self, name: str, default: Any = None) -> Any:
        """Return the value of an element."""
        try:
            return self[name]
        except KeyError:
            return default

    def __contains__(self, name: object) -> bool:
        return dict.__contains__(self, name) or name in self.names

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __len__(self) -> int:
        return self.names.size

    def __bool__(self) -> bool:
        return bool(self.names.blocks)

    def keys(self) -> Any:
        """Return the names."""
        return KeysView(self)

    def values(self) -> Any:
        """Return the values."""
        return [value for _, value in self._made_items()]

    def items(self) -> Any:
        """Return names with values."""
        return [*self._made_items()]

    def _made_items(self) -> Iterator[tuple[str, Part]]:
        """Yield names with values; missing values are made and cached."""
        for block in self.names.blocks:
            numbers = product(*map(range, block.shape))
            for name, indices in zip(block.elements(), numbers, strict=True):
                if not dict.__contains__(self, name):
                    self[name] = self.makers[block.name](dict(zip(block.dims, indices, strict=True)))
                yield name, self[name]

    def __or__(self, right: Mapping[str, Any]) -> Any:  # type: ignore[override]
        if not isinstance(right, Elementwise):
            if any(name in self.names for name in right):  # which no maker has
                return dict(self) | dict(right)
            return self._from_parts(
                (*self.names.blocks, *_single(right)), self.makers, self._made_values() | dict(right)
            )
        return self._from_parts(
            (*self.names.blocks, *(block for block in right.names.blocks if block.name not in self.makers)),
            self.makers | right.makers,
            self._made_values() | right._made_values(),
        )

    def __ror__(self, left: Mapping[str, Any]) -> Any:  # type: ignore[override]
        new = {name: part for name, part in left.items() if name not in self.names}
        return self._from_parts((*_single(new), *self.names.blocks), self.makers, new | self._made_values())

    def __eq__(self, other: object) -> bool:
        return self is other or dict(self) == other

    # a dictionary has a comparison of its own for this, which would see only what was made so far
    def __ne__(self, other: object) -> bool:
        return not self == other

    __hash__ = None

    def __reduce__(self) -> tuple[Any, ...]:
        # makers may be local functions, which cannot be pickled: elsewhere it is a plain dictionary
        return dict, (dict(self),)

    def _made_values(self) -> dict[str, Part]:
        """Return the values made so far."""
        # by the methods of the base class: those of this one would make all elements
        return dict(zip(dict.keys(self), dict.values(self), strict=True))


def _single(names: Iterable[str]) -> list[Block]:
    """Return a block for each of some names, without dimensions."""
    return [Block(name, "") for name in names]
