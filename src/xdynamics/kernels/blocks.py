"""Blocks: what stands where in an array of numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

from xdynamics.runtime.cached_properties import cached_property


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
    """

    name: str
    role: str
    dims: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()


class Blocks(tuple[str, ...]):
    """The blocks of an array, one after another; as a sequence, their names.

    Examples
    --------
    >>> moving = Blocks.of("coordinate", ["x", "y"]) + Blocks([Block("v", "velocity", ("link",), (3,)), Block("s", "state")])
    >>> moving, moving.size, moving.place("s")
    (('x', 'y', 'v', 's'), 6, 5)
    """

    blocks: tuple[Block, ...]

    def __new__(cls, blocks: Iterable[Block]) -> Blocks:
        """Place each block after those before it."""
        blocks = tuple(blocks)
        self = super().__new__(cls, [block.name for block in blocks])
        self.blocks = blocks
        return self

    @classmethod
    def of(cls, role: str, names: Iterable[str]) -> Blocks:
        """Return single numbers of one role."""
        return cls([Block(name, role) for name in names])

    def __getnewargs__(self) -> tuple[tuple[Block, ...]]:
        """Return what a copy is made from."""
        return (self.blocks,)

    def __add__(self, other: Blocks) -> Blocks:  # type: ignore[override]
        """Return the blocks of one array followed by those of another."""
        return Blocks(self.blocks + other.blocks)

    def place(self, name: str) -> int:
        """Return the place of a block's first number in the array."""
        return self._offsets[name]

    def find(self, name: str) -> int | None:
        """Return the place of a block's first number; None if there is no such block."""
        return self._offsets.get(name)

    @cached_property
    def size(self) -> int:
        """How many numbers the array has."""
        return sum(math.prod(block.shape) for block in self.blocks)

    @cached_property
    def _offsets(self) -> dict[str, int]:
        offset, places = 0, dict[str, int]()
        for block in self.blocks:
            places.setdefault(block.name, offset)
            offset += math.prod(block.shape)
        return places
