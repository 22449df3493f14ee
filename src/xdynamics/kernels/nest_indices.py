"""Indices of loops over elements, and what is raised where loops cannot be written as they stand."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class UnprintedError(Exception):
    """An expression that has no loops; its elements are written out."""


class LoopIndex(NamedTuple):
    """The number of an element: that of a loop's index and a shift, or a known one.

    Attributes
    ----------
    name : str
        Of the index; empty where the number is known.
    shift : int
        What is added to it; the known number.
    first, last : int
        The numbers that it may have, from `first` to before `last`.
    level : int
        How many loops are around it.
    gathered : bool
        Whether the index is read from a table.
    """

    name: str
    shift: int
    first: int
    last: int
    level: int = 0
    gathered: bool = False


class Link(NamedTuple):
    """A link of a relation of every two, by its ends."""

    first: LoopIndex
    second: LoopIndex

    @property
    def level(self) -> int:
        """How many loops are around it."""
        return max(self.first.level, self.second.level)


class SplitError(Exception):
    """An index whose numbers are not all treated alike: those before a number, and those from there on.

    Attributes
    ----------
    index : str
        Of the loop.
    count : int
        How many of its passes come before. The index may be another one than the loop's own: shifted, by one shift within
        another.
    """

    def __init__(self, index: LoopIndex, number: int) -> None:
        self.index, self.count = index.name, number - index.first


Env = Mapping[str, LoopIndex | Link]


def known_index(number: int) -> LoopIndex:
    """Return the index of a known element."""
    return LoopIndex("", number, number, number + 1)
