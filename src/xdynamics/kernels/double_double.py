"""Programs of sums of two floats: the lines of a program of floats, with the rest of every number beside it."""

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
    Location,
    Loop,
    Operand,
    Ordinal,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    nested_lines,
    soundness,
)
from xdynamics.units.unit import exact_value

# coefficients of a piece of a table, from the cubic one down, and of what is derived from it; see `elementary.piecewise`
PIECES = {
    "value_at": (("cube_at", 1.0), ("square_of", 1.0), ("slope_of", 1.0), ("value_of", 1.0)),
    "slope_at": (("cube_at", 3.0), ("square_of", 2.0), ("slope_of", 1.0)),
    "bend_at": (("cube_at", 3.0), ("square_of", 1.0)),
    "cube_at": (("cube_at", 1.0),),
}

STEP = Location("at", AT.index("h"))


def double_double_program(program: Program, rests: Mapping[str, int]) -> Program:
    """Return a program of sums.

    Parameters
    ----------
    program : Program
    rests : mapping of str to int
        How many places after a number of an array its rest stands; the numbers of an array that is not named are exact.
    """
    calls = [line for line in nested_lines(program.body) if isinstance(line, ProgramCall)]
    passed = {program.views.get(name, (name,))[0] for call in calls for name in (call.y, call.z)}
    # an array that another program is given is as long as the one that it has otherwise
    local_distances = {name: rests["y"] if name in passed else size for name, size in program.local.items()}
    distances = {**rests, **local_distances}
    writing = _Doubling(program, distances)
    body = (*writing.lines(program.body), *writing.sound())
    views = {
        name: (array, first, size + distances.get(array, 0)) for name, (array, first, size) in program.views.items()
    }
    local = {name: size + local_distances[name] for name, size in program.local.items()}
    return replace(program, body=body, views=views, local=local, sound=None)


@dataclass(frozen=True)
class _Doubling:
    """Writes the lines of one program anew."""

    program: Program
    rests: Mapping[str, int]
    _numbers: Iterator[int] = field(default_factory=count)

    def _new_name(self) -> str:
        """Return a name for a value that stands nowhere in the program."""
        return f"_part{next(self._numbers)}"

    def lines(self, body: Iterable[Instruction]) -> tuple[Instruction, ...]:
        """Return lines of sums."""
        return tuple(line for old in body for line in self._rewrite_line(old))

    def sound(self) -> Iterator[Instruction]:
        """Answer for results by the floats that they are to within their rests."""
        if self.program.sound:
            yield soundness("z", *self.program.sound, "_sum")
            yield StoreTo(Location("at", AT.index("unsound")), "_sum")

    def _rewrite_line(self, line: Instruction) -> Iterator[Instruction]:
        match line:
            case Load():
                yield from self._rewrite_load(line)
            case StoreTo():
                yield from self._rewrite_store(line)
            case Ordinal():
                number = self._new_name()
                yield Ordinal(number, line.index)
                yield _sum_operation(line.target, "exact", number)
            case Compute():
                yield from self._rewrite_compute(line)
            case Loop():
                yield replace(line, body=cast("tuple[Line, ...]", self.lines(line.body)))
            case Reduction():
                starts = tuple(start if isinstance(start, str) else float(start) for start in line.starts)
                body = cast("tuple[Line, ...]", self.lines(line.body))
                yield replace(line, body=body, start=starts, kind=DOUBLE_DOUBLE)
            case _:
                yield line

    def _low_location(self, location: Location) -> Location | None:
        array = self.program.views.get(location.array, (location.array,))[0]
        distance = self.rests.get(array)
        if distance and array in ("y", "at") and location.offset >= distance:  # a rest itself
            return None
        return replace(location, offset=location.offset + distance) if distance else None

    def _rewrite_load(self, line: Load) -> Iterator[Line]:
        if line.location == STEP and not self.program.spread:  # the exact difference of its ends
            begin, end = self._new_name(), self._new_name()
            yield from self._rewrite_load(Load(begin, Location("at", AT.index("t"))))
            yield from self._rewrite_load(Load(end, Location("at", AT.index("t1"))))
            yield _sum_operation(line.target, "subtract", end, begin)
            return
        low_location, high = self._low_location(line.location), self._new_name()
        yield Load(high, line.location)
        if low_location is None:
            yield _sum_operation(line.target, "exact", high)
        else:
            low = self._new_name()
            yield Load(low, low_location)
            yield _sum_operation(line.target, "joined", high, low)

    def _rewrite_store(self, line: StoreTo) -> Iterator[Line]:
        low_location = self._low_location(line.location)
        value = yield from self._operand_as_sum(line.value)
        for part, location in (("high", line.location), ("low", low_location)):
            if location is not None:
                name = self._new_name()
                yield _sum_operation(name, part, value)
                yield StoreTo(location, name)

    def _operand_as_sum(self, operand: Operand) -> Generator[Line, None, Operand]:
        """Write a number as a sum; return the name of an operand."""
        if isinstance(operand, str):
            return operand
        name = self._new_name()
        yield _sum_operation(
            name, "joined", *nearest(exact_value(float(operand) if isinstance(operand, int) else operand))
        )
        return name

    def _rewrite_compute(self, line: Compute) -> Iterator[Line]:
        if line.operation in ("piece_of", "find_piece", *POLYNOMIALS):
            yield from self._rewrite_lookup(line)
            return
        operands: list[Operand] = []
        for operand in line.arguments:
            operand_name = yield from self._operand_as_sum(operand)
            operands.append(operand_name)
        yield replace(line, arguments=tuple(operands), kind=DOUBLE_DOUBLE)

    def _rewrite_lookup(self, line: Compute) -> Iterator[Line]:
        """Evaluate a piece of a table about its origin; its coefficients are the floats that they are."""
        if line.operation == "piece_of":
            yield line
            return
        argument = yield from self._operand_as_sum(line.arguments[0])
        argument_high, piece_arguments = self._new_name(), line.arguments[1:]
        yield _sum_operation(argument_high, "high", argument)
        if line.operation == "find_piece":
            yield replace(line, arguments=(argument_high, *piece_arguments))
            return
        origin, begin, u = self._new_name(), self._new_name(), self._new_name()
        yield Compute(origin, "origin_of", (argument_high, *piece_arguments))
        yield _sum_operation(begin, "exact", origin)
        yield _sum_operation(u, "subtract", argument, begin)
        total: Operand = ""
        for coefficient, factor in PIECES[line.operation]:  # by Horner's scheme
            read = self._new_name()
            yield Compute(read, coefficient, (argument_high, *piece_arguments))
            term = self._new_name()
            yield _sum_operation(term, "exact", read)
            if factor != 1.0:
                times = yield from self._operand_as_sum(factor)
                term, plain = self._new_name(), term
                yield _sum_operation(term, "multiply", plain, times)
            if total:
                scaled, sum_of_both = self._new_name(), self._new_name()
                yield _sum_operation(scaled, "multiply", total, u)
                yield _sum_operation(sum_of_both, "add", scaled, term)
                term = sum_of_both
            total = term
        yield _sum_operation(line.target, "newest", total, total)


def _sum_operation(target: str, operation: str, *arguments: Operand) -> Compute:
    return Compute(target, operation, arguments, DOUBLE_DOUBLE)
