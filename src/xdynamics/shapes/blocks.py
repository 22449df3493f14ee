"""Blocks: the order of quantities and their elements in an array of numbers."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes.extents import Extent, Shapes, element_name, element_names, indices_of_element, number_of_element
from xdynamics.shapes.naming import DOT, split_element_name


class Block(NamedTuple):
    """Numbers that belong together: a coordinate, its velocity, a force component.

    Attributes
    ----------
    name : str
    role : str
        What kind of quantity it is: "coordinate", "velocity", "state", ….
    dims : tuple of str
        The names of its dimensions.
    shape : tuple of int
        Their lengths; () for a single number.
    extents : tuple of Extent
        Its dimensions, which know the labels of elements; without them elements are numbered.
    """

    name: str
    role: str
    dims: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()
    extents: tuple[Extent, ...] = ()

    @classmethod
    def from_shapes(cls, name: str, role: str, shapes: Shapes) -> Block:
        """Return the block of a quantity with the dimensions that its name has."""
        return cls.of_dims(name, role, shapes.dims.get(name, ()), shapes)

    @classmethod
    def of_dims(cls, name: str, role: str, dims: tuple[str, ...], shapes: Shapes) -> Block:
        """Return the block of a quantity with some dimensions."""
        extents = tuple(map(shapes.extent, dims))
        return cls(name, role, dims, tuple(extent.size for extent in extents), extents)

    @property
    def size(self) -> int:
        """How many numbers it has."""
        return math.prod(self.shape)

    @property
    def first(self) -> str:
        """The name of its first number."""
        return self.element(0)

    def element(self, number: int) -> str:
        """Return the name of one of its numbers."""
        return element_name(self.name, number, self._dimension_extents)

    def elements(self) -> Iterator[str]:
        """Yield the names of its numbers, the last dimension fastest."""
        return element_names(self.name, self._dimension_extents)

    def number(self, name: str) -> int | None:
        """Return the number of an element by its name; None if it is none of this block."""
        return number_of_element(name, self._dimension_extents)

    def indices_of(self, name: str) -> dict[str, int]:
        """Return the index of an element along each dimension by its name."""
        return dict(zip(self.dims, indices_of_element(name, self._dimension_extents) or (), strict=True))

    @property
    def _dimension_extents(self) -> tuple[Extent, ...]:
        return self.extents or tuple(map(Extent, self.dims, self.shape))


class Blocks(Sequence[str]):
    """The blocks of an array, one after another; as a sequence, the names of its numbers, made on look-up.

    Examples
    --------
    >>> moving = Blocks.from_names("coordinate", ["x", "y"]) + Blocks([Block("s", "state")])
    >>> tuple(moving), moving.size, moving.offset_of("s")
    (('x', 'y', 's'), 3, 2)
    """

    def __init__(self, blocks: Iterable[Block]) -> None:
        self.blocks = tuple(blocks)

    @classmethod
    def from_names(cls, role: str, names: Iterable[str], shapes: Shapes | None = None) -> Blocks:
        """Return quantities of one role, with the dimensions that they have in `shapes`.

        Names of elements become their quantity where all of them stand one after the other: numbers are where they were.
        """
        if shapes is None or not shapes.dims:
            return cls([Block(name, role) for name in names])
        return cls(_gathered([*names], role, shapes))

    def __add__(self, right: Blocks) -> Blocks:
        """Return the blocks of one array followed by those of another."""
        return Blocks(self.blocks + right.blocks)

    def renamed(self, role: str, rename: Callable[[str], str]) -> Blocks:
        """Return blocks with equal shapes and other names."""
        return Blocks([block._replace(name=rename(block.name), role=role) for block in self.blocks])

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return self.size

    def __getitem__(self, number: Any) -> Any:
        if isinstance(number, slice):
            return self._names[number]
        number = range(self.size)[number]
        block = bisect_right(self._starts, number) - 1
        return self.blocks[block].element(number - self._starts[block])

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self._find(name) is not None

    def __eq__(self, other: object) -> bool:
        return self is other or (isinstance(other, Sequence) and tuple(self) == tuple(other))

    def __hash__(self) -> int:
        return hash(self._names)

    def __repr__(self) -> str:
        return repr(self._names)

    def index(self, name: str, *bounds: int) -> int:
        """Return the index of a number by its name; a `ValueError` if there is none.

        Raises
        ------
        ValueError
            If there is none of that name.
        """
        if (offset := self._find(name)) is None:
            raise ValueError(f"'{name}' is not among {self._names[slice(*bounds)]}")
        return offset

    def offset_of(self, name: str) -> int:
        """Return the offset of a number, or of a block's first number, in the array.

        Raises
        ------
        KeyError
            If there is none of that name.
        """
        if (offset := self.find_offset(name)) is None:
            raise KeyError(name)
        return offset

    def find_offset(self, name: str) -> int | None:
        """Return the offset of a number, or of a block's first number; None if there is none."""
        offset = self._block_offsets.get(name)
        return self._find(name) if offset is None else offset

    @cached_property
    def size(self) -> int:
        """How many numbers the array has."""
        return sum(block.size for block in self.blocks)

    def block(self, name: str) -> Block:
        """Return the block that has a number of some name."""
        return self._by_name[split_element_name(name)[0] if name not in self._by_name else name]

    def spread(self, numbers: Sequence[float]) -> NDArray[np.float64]:
        """Return a number for each block at all of its places, to be read alone; equal ones take no memory."""
        block_numbers = np.array(numbers, float)
        if block_numbers.size and np.array_equal(
            block_numbers, np.full_like(block_numbers, block_numbers[0]), equal_nan=True
        ):
            return np.broadcast_to(block_numbers[0], self.size)
        repeated = np.repeat(block_numbers, [block.size for block in self.blocks])
        repeated.flags.writeable = False
        return repeated

    def values_of(self, numbers: Mapping[str, Any], name: str) -> Any:
        """Return numbers of a block or of one of its elements, from those of blocks, whose dimensions are last."""
        if name in numbers:
            return numbers[name]
        block = self.block(name)
        indices: Any = (..., *block.indices_of(name).values())
        return numbers[block.name][indices]

    def _find(self, name: str) -> int | None:
        """Return the offset of a number by its own name."""
        if DOT in name and name not in self._block_offsets:
            stem = split_element_name(name)[0]
            block = self._by_name.get(stem)
            number = None if block is None else block.number(name)
            return None if number is None else self._block_offsets[stem] + number
        block = self._by_name.get(name)
        return None if block is None or block.dims else self._block_offsets[name]

    @cached_property
    def _names(self) -> tuple[str, ...]:
        return tuple(chain.from_iterable(block.elements() if block.dims else (block.name,) for block in self.blocks))

    @cached_property
    def _starts(self) -> list[int]:
        starts, offset = list[int](), 0
        for block in self.blocks:
            starts.append(offset)
            offset += block.size
        return starts

    @cached_property
    def _by_name(self) -> dict[str, Block]:
        return {block.name: block for block in reversed(self.blocks)}

    @cached_property
    def _block_offsets(self) -> dict[str, int]:
        return dict(zip((block.name for block in reversed(self.blocks)), reversed(self._starts), strict=True))


def _gathered(names: Sequence[str], role: str, shapes: Shapes) -> Iterator[Block]:
    """Yield blocks of names, with consecutive elements of a complete quantity merged into its block."""
    number = 0
    while number < len(names):
        block = Block.from_shapes(names[number], role, shapes)
        if DOT in block.name:
            stem, labels = split_element_name(block.name)
            quantity = Block.of_dims(stem, role, shapes.dims_at_end(stem, len(labels)), shapes)
            is_first = block.name == quantity.first  # elements without it are compared with nothing
            if is_first and tuple(names[number : number + quantity.size]) == tuple(quantity.elements()):
                number, block = number + quantity.size - 1, quantity
        yield block
        number += 1
