"""Single-assignment programs: what a law computes, before it is printed as Python or as LLVM text.

A program is a list of instructions in the order in which the model and the method were written. Every value is computed
once and never changed, so that both printers, and any number of lanes, do the same operations in the same order.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

Operand = str | float | int  # a value by its name, a number, or the number of a table
# kinds of numbers: a value is one float, lies between two (enclosed: by functions that are called), or is the sum of two
FLOAT, INTERVAL, ENCLOSED, DOUBLE_DOUBLE = "float", "interval", "enclosed", "double_double"
OF_FLOAT = {INTERVAL: "point", ENCLOSED: "point", DOUBLE_DOUBLE: "exact"}  # the operation that makes one of a float

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
DEVIATION = 2 * len(AT)  # behind them and their rests: how far from 1 a step has left the length of a quaternion


@dataclass(frozen=True)
class Location:
    """An element of an array, of a view or of a table: an offset and strides times indices.

    Attributes
    ----------
    array : str
    offset : int
    strides : tuple of (str, int)
        Indices of the loops around it, or gathered ones, each with its stride.
    """

    array: str
    offset: int = 0
    strides: tuple[tuple[str, int], ...] = ()


def loop_element(array: str, offset: int = 0, index: str = "i") -> Location:
    """Return the location of the element of a vector that a loop is at."""
    return Location(array, offset, ((index, 1),))


@dataclass(frozen=True)
class Compute:
    """``target = operation(arguments)``; the operations are in `kernels.python_text`.

    Of another kind of number they are those of that kind, as `elementary.intervals.Intervals`.
    """

    target: str
    operation: str
    arguments: tuple[Operand, ...]
    kind: str = FLOAT


@dataclass(frozen=True)
class Load:
    """``target = location``."""

    target: str
    location: Location


@dataclass(frozen=True)
class StoreTo:
    """``location = value``."""

    location: Location
    value: Operand


@dataclass(frozen=True)
class ProgramCall:
    """A call of another program of this text at another state: its `at` and `y`, and where results go."""

    program: str
    at: str
    y: str
    z: str
    e: str = "e"


@dataclass(frozen=True)
class EngineCall:
    """A call of an entry of the engine, which changes results of forces in `z`.

    Attributes
    ----------
    first : int
        Place in `p` of two words: the address of the run, and that of the entry.
    """

    first: int


@dataclass(frozen=True)
class Gather:
    """``index = location``, an integer of one of the program's tables: an index for the locations that follow."""

    index: str
    location: Location


@dataclass(frozen=True)
class Ordinal:
    """``target = index``, as a number."""

    target: str
    index: str


@dataclass(frozen=True)
class Loop:
    """Lines that are repeated for every value of an index from 0 to count - 1, ascending.

    Attributes
    ----------
    index : str
    count : int
    body : tuple of Line
    exclusive_arrays : frozenset of str
        Arrays of which every pass reads and writes elements that no other does.
    """

    index: str
    count: int
    body: tuple[Line, ...]
    exclusive_arrays: frozenset[str] = frozenset()

    @property
    def independent(self) -> bool:
        """Whether no pass reads or writes a location that another pass writes: passes may go side by side."""
        lines = list(nested_lines(self.body))
        counts = {line.index: line.count for line in (self, *lines) if isinstance(line, Loop | Reduction)}
        indices = {*counts, *(line.index for line in lines if isinstance(line, Gather))}

        def without_outer_indices(location: Location) -> Location:  # indices of loops around are the same in all passes
            return replace(
                location, strides=tuple((index, stride) for index, stride in location.strides if index in indices)
            )

        loads = {without_outer_indices(line.location) for line in lines if isinstance(line, Load)}
        stored_locations: dict[str, list[Location]] = {}
        for line in lines:
            if isinstance(line, StoreTo):
                stored_locations.setdefault(line.location.array, []).append(without_outer_indices(line.location))
        return all(
            self.index in dict(places[0].strides)
            and are_distinct(places, counts)
            # a load from any other place may find what another pass stores
            and all(load in places for load in loads if load.array == array)
            for array, places in stored_locations.items()
            if array not in self.exclusive_arrays
        )


def are_distinct(places: list[Location], counts: Mapping[str, int]) -> bool:
    """Whether places of an array are other elements for any other values of their indices."""
    first = min(location.offset for location in places)
    distances = [location.offset - first for location in places]
    between = math.gcd(*distances)
    # as if a further index numbered the places
    strides = [(between, max(distances) // between + 1)] if between else []
    for index, stride in places[0].strides:
        if index not in counts:  # a gathered index may have one value twice
            return False
        strides.append((stride, counts[index]))
    reach = 0
    for stride, count in sorted(strides):
        # as digits of a number: a stride longer than all smaller ones reach together gives every choice of indices
        # another sum
        if stride <= reach:
            return False
        reach += stride * (count - 1)
    return len({location.strides for location in places}) == 1


@dataclass(frozen=True)
class Reduction:
    """Numbers of all passes of a loop joined one after the other, ascending: sums, if they are added.

    Attributes
    ----------
    index : str
    count : int
    body : tuple of Line
    terms, totals : tuple of str
        What is joined, of each pass, and the names of the results.
    operation : str
        How a total so far and a term are joined: "add", "least", "greatest", …
    start : float or str, or a tuple of them
        What every total begins as, or each.
    where : str, optional
        A truth: a pass where it does not hold keeps the totals (adding zero would make -0.0 into 0.0).
    kind : str
    below, above : str
        Index of a loop around it: only passes before its number are made, or only those after it.
    in_any_order : bool
        Whether it is a sum of numbers that are 0 or nan, so that no order of additions changes it.

    Notes
    -----
    In the body a total's name means the total so far; "newest" makes a term the total.
    """

    index: str
    count: int
    body: tuple[Line, ...]
    terms: tuple[Operand, ...]
    totals: tuple[str, ...]
    operation: str = "add"
    start: Operand | tuple[Operand, ...] = 0.0
    where: str | None = None
    kind: str = FLOAT
    below: str = ""
    above: str = ""
    in_any_order: bool = False

    @property
    def starts(self) -> tuple[Operand, ...]:
        """The initial value of each total."""
        return self.start if isinstance(self.start, tuple) else (self.start,) * len(self.totals)


@dataclass(frozen=True)
class When:
    """A call made if a number is nonzero; in lanes, if it is nonzero in any of them."""

    location: Location
    call: ProgramCall


@dataclass(frozen=True)
class While:
    """A call repeated until a number is zero; in lanes, until it is zero in all of them."""

    location: Location
    call: ProgramCall


Line = Compute | Load | StoreTo | Gather | Ordinal | Loop | Reduction  # what loops may contain
Instruction = Line | ProgramCall | EngineCall | When | While


def nested_lines(body: Iterable[Instruction]) -> Iterator[Instruction]:
    """Yield every line that is executed, and those of loops after the loop."""
    for line in body:
        yield line
        if isinstance(line, Loop | Reduction) and line.count:
            yield from nested_lines(line.body)


def named_arrays(line: Instruction) -> set[str]:
    """Return the arrays that a line names: that of its location, or those that it hands to another program."""
    match line:
        case Load() | StoreTo():
            return {line.location.array}
        case ProgramCall():
            return {line.at, line.y, line.z, line.e}
        case When() | While():
            return {line.location.array} | named_arrays(line.call)
        case _:
            return set()


def line_count(body: Iterable[Instruction]) -> int:
    """Return the number of lines when loops are written out."""
    return sum(line.count * line_count(line.body) if isinstance(line, Loop | Reduction) else 1 for line in body)


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
    tables : mapping of str to tuple of int
        Whole numbers that are known when the program is written, the same in all lanes: ends of links, neighbours.
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
    tables: Mapping[str, tuple[int, ...]] = field(default_factory=dict)


def shift_array(program: Program, array: str, distance: int) -> Program:
    """Return a program whose places in an array are so much further on."""

    def shift_location(location: Location) -> Location:
        return replace(location, offset=location.offset + distance) if location.array == array else location

    def shift_line(instruction: Any) -> Any:
        match instruction:
            case Load() | StoreTo() | Gather():
                return replace(instruction, location=shift_location(instruction.location))
            case When() | While():
                return replace(instruction, location=shift_location(instruction.location))
            case Loop() | Reduction():
                return replace(instruction, body=tuple(map(shift_line, instruction.body)))
        return instruction

    views = {
        name: (viewed_array, first + distance if viewed_array == array else first, count)
        for name, (viewed_array, first, count) in program.views.items()
    }
    return replace(program, body=tuple(map(shift_line, program.body)), views=views)


def soundness(array: str, first: int, count: int, total: str) -> Reduction:
    """Sum numbers less themselves: 0 if all are finite, else nan."""
    lines = Load("_number", loop_element(array, first)), Compute("_nothing", "subtract", ("_number", "_number"))
    return Reduction("i", count, lines, ("_nothing",), (total,), in_any_order=True)
