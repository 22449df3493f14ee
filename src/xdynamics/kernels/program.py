"""Single-assignment programs: what a law computes, before it is printed as Python or as LLVM text.

A program is a list of instructions in the order in which the model and the method were written. Every value is computed
once and never changed, so that both printers, and any number of lanes, do the same operations in the same order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Operand = str | float | int  # a value by its name, a number, or the number of a table
FLOAT, INTERVAL = "float", "interval"  # kinds of numbers: a value is one float, or lies between two

# what every program is given: pointers to numbers; in lanes, one number for each lane
ARRAYS = ("at", "y", "p", "tables", "pieces", "z", "e", "samples", "w")
# Callers of a law pass y, z and the samples; the law finds the rest, and the rows of the log, in a table of `WORDS`
# words for each array in this order: its address, the length of its first dimension, that of its last.
TABLE = (*ARRAYS, "rows")
WORDS = 3
# The numbers of `at`: ends and size of a step, place in it from 0 to 1, regime; what else a row of the log keeps of a
# step; and `unsound`, which a program sets to 0 if the numbers that it answers for are finite, else to nan.
AT = ("t", "t1", "h", "s", "regime", "norm", "turns", "unsound")
T, T1, H, S, REGIME, NORM, TURNS, UNSOUND = range(len(AT))


@dataclass(frozen=True)
class Place:
    """An element of an array or of a view; inside `Each` an offset from the i-th element, or the same for every i."""

    array: str
    index: int = 0
    same: bool = False


@dataclass(frozen=True)
class Compute:
    """``target = operation(arguments)``; the operations are in `kernels.operations`.

    Of another kind of number they are those of that kind, as `elementary.intervals.Intervals`.
    """

    target: str
    operation: str
    arguments: tuple[Operand, ...]
    kind: str = FLOAT


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
    """A call of another program of the same text, at another state: its `at` and `y`, and where results go."""

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
    """A call made if a number is nonzero; in lanes, if it is nonzero in any of them."""

    place: Place
    call: Call


@dataclass(frozen=True)
class While:
    """A call repeated until a number is zero; in lanes, until it is zero in all of them."""

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
        Local arrays, with their lengths.
    sound : (int, int)
        First and number of the elements of `z` that it answers for in `unsound`.
    spread : bool
        Whether `z` is a row of the log, whose elements are not contiguous.
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
        """Number of instructions when the program is written out."""
        return sum(line.count * len(line.body) if isinstance(line, Each) else 1 for line in self.body)
