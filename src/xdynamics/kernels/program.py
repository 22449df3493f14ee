"""Single-assignment programs: what a law computes, before it is printed as Python or as LLVM text.

A program is a list of instructions in the order in which the model and the method were written. Every value is computed
once and never changed, so that both printers, and any number of lanes, do the same operations in the same order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Operand = str | float | int  # a value by its name, a number, or the number of a table

# what every program is given: pointers to numbers, in lanes with one number a lane
ARRAYS = ("at", "y", "p", "tables", "pieces", "z", "e", "samples", "w")
# Who calls a law says where y, z and the samples are; the rest, and the rows of the log, it finds in a table, `WORDS`
# words for each array in this order: its address, the length of its first dimension, that of its last.
TABLE = (*ARRAYS, "rows")
WORDS = 3
# The numbers of `at`: ends and size of a step, place in it from 0 to 1, regime; what a row of the log keeps of a step
# besides; and `unsound`, which a program sets to 0 where the numbers that it answers for are finite, else to nan.
AT = ("t", "t1", "h", "s", "regime", "norm", "turns", "unsound")
T, T1, H, S, REGIME, NORM, TURNS, UNSOUND = range(len(AT))


@dataclass(frozen=True)
class Place:
    """An element of an array or of a view; inside `Each` the element this far behind the i-th, or the same for every i."""

    array: str
    index: int = 0
    same: bool = False


@dataclass(frozen=True)
class Compute:
    """``target = operation(arguments)``; the operations stand in `kernels.operations`."""

    target: str
    operation: str
    arguments: tuple[Operand, ...]


@dataclass(frozen=True)
class Load:
    """``target = place``."""

    target: str
    place: Place


@dataclass(frozen=True)
class Store:
    """``place = value``."""

    place: Place
    value: Operand


@dataclass(frozen=True)
class Call:
    """Another program of the same text, at another state: its `at` and `y` are given, and where it puts what it finds."""

    program: str
    at: str
    y: str
    z: str
    e: str = "e"


@dataclass(frozen=True)
class Each:
    """The same lines for every component i of vectors of one length."""

    count: int
    body: tuple[Compute | Load | Store, ...]


@dataclass(frozen=True)
class When:
    """A call that is made where a number is not zero; in lanes, where it is not in any of them."""

    place: Place
    call: Call


@dataclass(frozen=True)
class While:
    """A call that is made again and again, until a number is zero; in lanes, until it is in all of them."""

    place: Place
    call: Call


Instruction = Compute | Load | Store | Call | Each | When | While


@dataclass(frozen=True)
class Program:
    """A function of the law.

    Attributes
    ----------
    name : str
    about : str
        One sentence.
    body : tuple of Instruction
    views : mapping of str to (str, int, int)
        Names for parts of the arrays: array, first element, length.
    local : mapping of str to int
        Arrays of its own, with their lengths.
    sound : (int, int)
        First and how many elements of `z` it answers for in `unsound`.
    spread : bool
        Whether `z` is a row of the log, whose elements stand apart.
    """

    name: str
    about: str
    body: tuple[Instruction, ...]
    views: Mapping[str, tuple[str, int, int]] = field(default_factory=dict)
    local: Mapping[str, int] = field(default_factory=dict)
    sound: tuple[int, int] | None = None
    spread: bool = False

    @property
    def size(self) -> int:
        """How many instructions it has when it is written out."""
        return sum(one.count * len(one.body) if isinstance(one, Each) else 1 for one in self.body)
