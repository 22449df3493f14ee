"""A program of floats as one of sums of two floats: the same lines, with the rest of every number beside it."""

from __future__ import annotations

from collections.abc import Generator, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from typing import cast

from xdynamics.elementary.double_double.sums import nearest
from xdynamics.elementary.piecewise import POLYNOMIALS
from xdynamics.kernels.program import (
    AT,
    DOUBLE_DOUBLE,
    Compute,
    Instruction,
    Line,
    Load,
    Loop,
    Operand,
    Ordinal,
    Place,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    nested,
    soundness,
)
from xdynamics.units.rounded import exact_value

# coefficients of a piece of a table, from the cubic one down, and of what is derived from it; see `elementary.piecewise`
PIECES = {
    "value_at": (("cube_at", 1.0), ("square_of", 1.0), ("slope_of", 1.0), ("value_of", 1.0)),
    "slope_at": (("cube_at", 3.0), ("square_of", 2.0), ("slope_of", 1.0)),
    "bend_at": (("cube_at", 3.0), ("square_of", 1.0)),
    "cube_at": (("cube_at", 1.0),),
}

STEP = Place("at", AT.index("h"))


def doubled(program: Program, rests: Mapping[str, int]) -> Program:
    """Return a program of sums.

    Parameters
    ----------
    program : Program
    rests : mapping of str to int
        How many places after a number of an array its rest stands; the numbers of an array that is not named are exact.
    """
    calls = [line for line in nested(program.body) if isinstance(line, ProgramCall)]
    passed = {program.views.get(name, (name,))[0] for call in calls for name in (call.y, call.z)}
    # an array that another program is given is as long as the one that it has otherwise
    own = {name: rests["y"] if name in passed else size for name, size in program.local.items()}
    distances = {**rests, **own}
    writing = _Doubling(program, distances)
    body = (*writing.lines(program.body), *writing.sound())
    views = {
        name: (array, first, size + distances.get(array, 0)) for name, (array, first, size) in program.views.items()
    }
    local = {name: size + own[name] for name, size in program.local.items()}
    return replace(program, body=body, views=views, local=local, sound=None)


@dataclass(frozen=True)
class _Doubling:
    """Writes the lines of one program anew."""

    program: Program
    rests: Mapping[str, int]
    _numbers: Iterator[int] = field(default_factory=count)

    def _new(self) -> str:
        """Return a name for a value that stands nowhere in the program."""
        return f"_part{next(self._numbers)}"

    def lines(self, body: Iterable[Instruction]) -> tuple[Instruction, ...]:
        """Return lines of sums."""
        return tuple(line for old in body for line in self._written(old))

    def sound(self) -> Iterator[Instruction]:
        """Answer for results by the floats that they are to within their rests."""
        if self.program.sound:
            yield soundness("z", *self.program.sound, "_sum")
            yield StoreTo(Place("at", AT.index("unsound")), "_sum")

    def _written(self, line: Instruction) -> Iterator[Instruction]:
        match line:
            case Load():
                yield from self._loaded(line)
            case StoreTo():
                yield from self._stored(line)
            case Ordinal():
                number = self._new()
                yield Ordinal(number, line.index)
                yield _sum(line.target, "exact", number)
            case Compute():
                yield from self._computed(line)
            case Loop():
                yield replace(line, body=cast("tuple[Line, ...]", self.lines(line.body)))
            case Reduction():
                starts = tuple(start if isinstance(start, str) else float(start) for start in line.starts)
                body = cast("tuple[Line, ...]", self.lines(line.body))
                yield replace(line, body=body, start=starts, kind=DOUBLE_DOUBLE)
            case _:
                yield line

    def _rest(self, place: Place) -> Place | None:
        array = self.program.views.get(place.array, (place.array,))[0]
        distance = self.rests.get(array)
        if distance and array in ("y", "at") and place.offset >= distance:  # a rest itself
            return None
        return replace(place, offset=place.offset + distance) if distance else None

    def _loaded(self, line: Load) -> Iterator[Line]:
        if line.place == STEP and not self.program.spread:  # the exact difference of its ends
            begin, end = self._new(), self._new()
            yield from self._loaded(Load(begin, Place("at", AT.index("t"))))
            yield from self._loaded(Load(end, Place("at", AT.index("t1"))))
            yield _sum(line.target, "subtract", end, begin)
            return
        rest, high = self._rest(line.place), self._new()
        yield Load(high, line.place)
        if rest is None:
            yield _sum(line.target, "exact", high)
        else:
            low = self._new()
            yield Load(low, rest)
            yield _sum(line.target, "joined", high, low)

    def _stored(self, line: StoreTo) -> Iterator[Line]:
        rest = self._rest(line.place)
        value = yield from self._operand(line.value)
        for part, place in (("high", line.place), ("low", rest)):
            if place is not None:
                name = self._new()
                yield _sum(name, part, value)
                yield StoreTo(place, name)

    def _operand(self, operand: Operand) -> Generator[Line, None, Operand]:
        """Write a number as a sum; return the name of an operand."""
        if isinstance(operand, str):
            return operand
        name = self._new()
        yield _sum(name, "joined", *nearest(exact_value(float(operand) if isinstance(operand, int) else operand)))
        return name

    def _computed(self, line: Compute) -> Iterator[Line]:
        if line.operation in ("piece_of", "find_piece", *POLYNOMIALS):
            yield from self._looked_up(line)
            return
        given: list[Operand] = []
        for operand in line.arguments:
            named = yield from self._operand(operand)
            given.append(named)
        yield replace(line, arguments=tuple(given), kind=DOUBLE_DOUBLE)

    def _looked_up(self, line: Compute) -> Iterator[Line]:
        """Evaluate a piece of a table about its origin; its coefficients are the floats that they are."""
        if line.operation == "piece_of":
            yield line
            return
        argument = yield from self._operand(line.arguments[0])
        at, others = self._new(), line.arguments[1:]
        yield _sum(at, "high", argument)
        if line.operation == "find_piece":
            yield replace(line, arguments=(at, *others))
            return
        origin, begin, u = self._new(), self._new(), self._new()
        yield Compute(origin, "origin_of", (at, *others))
        yield _sum(begin, "exact", origin)
        yield _sum(u, "subtract", argument, begin)
        total: Operand = ""
        for coefficient, factor in PIECES[line.operation]:  # by Horner's scheme
            read = self._new()
            yield Compute(read, coefficient, (at, *others))
            term = self._new()
            yield _sum(term, "exact", read)
            if factor != 1.0:
                times = yield from self._operand(factor)
                term, plain = self._new(), term
                yield _sum(term, "multiply", plain, times)
            if total:
                scaled, sum_of_both = self._new(), self._new()
                yield _sum(scaled, "multiply", total, u)
                yield _sum(sum_of_both, "add", scaled, term)
                term = sum_of_both
            total = term
        yield _sum(line.target, "newest", total, total)


def _sum(target: str, operation: str, *arguments: Operand) -> Compute:
    return Compute(target, operation, arguments, DOUBLE_DOUBLE)
