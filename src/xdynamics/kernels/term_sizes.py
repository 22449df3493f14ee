"""Sizes of the terms in a program of forces, of which rounding of accelerations and rates is a share.

The size of a sum is the sum of the sizes of its terms, whatever their signs; the size of a product grows as its
factors' sizes do. Where nothing cancels, a size is the absolute value. What is solved for has the sizes of all that it
follows from: forces of contacts, friction and constraints are terms among the others (running error analysis; Higham,
Accuracy and Stability of Numerical Algorithms, 2nd ed., section 3.3).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import count
from typing import cast

from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import forces
from xdynamics.kernels.program import (
    Compute,
    EngineCall,
    Instruction,
    Line,
    Load,
    Location,
    Loop,
    Operand,
    Program,
    Reduction,
    StoreTo,
)

TERM_SIZES = "term_sizes"
# what joins the sizes of two operands
_JOINED = {"add": "add", "subtract": "add", "choose": "choose"}
_EXTREMA = ("least", "greatest")
_SCALED = ("multiply", "divide")


def term_sizes_program(layout: Layout) -> Program:
    """Write the term sizes of accelerations and rates at a state, to the locations of `forces`' results.

    What contacts of many links add is no part of it: they bear what the other terms press them with.
    """
    evaluation = forces(layout, arrays=True)
    first = layout.used.size
    writing = _TermSizes(evaluation, range(first, first + layout.accelerations.size + layout.rates.size))
    about = "Sizes of the terms that accelerations and rates are sums of."
    local = {name: 2 * length for name, length in evaluation.local.items()}
    return replace(
        evaluation, name=TERM_SIZES, about=about, body=writing.lines(evaluation.body), local=local, sound=None
    )


@dataclass(frozen=True)
class _TermSizes:
    """Writes the lines of one program with those of sizes; without one of its own, the size of a value is its absolute value."""

    program: Program
    slope_range: range  # places of `z`
    _numbers: Iterator[int] = field(default_factory=count)
    _sizes: dict[Operand, str] = field(default_factory=dict)

    def lines(self, body: Iterable[Instruction]) -> tuple[Instruction, ...]:
        """Return lines with sizes."""
        return tuple(new for line in body for new in self._rewrite_line(line))

    def _rewrite_line(self, line: Instruction) -> Iterator[Instruction]:
        match line:
            case EngineCall():
                return
            case Load():
                yield line
                if line.location.array in self.program.local:
                    yield Load(self._size_of_target(line.target), self._size_location(line.location))
            case StoreTo():
                yield from self._rewrite_store(line)
            case Compute():
                yield line
                yield from self._size_computation(line)
            case Loop():
                yield replace(line, body=cast("tuple[Line, ...]", self.lines(line.body)))
            case Reduction():
                yield from self._rewrite_reduction(line)
            case _:
                yield line

    def _size_location(self, location: Location) -> Location:
        """Return the location of a size: behind all numbers of an array of the program."""
        return replace(location, offset=location.offset + self.program.local[location.array])

    def _rewrite_store(self, line: StoreTo) -> Iterator[Line]:
        if line.location.array in self.program.local:
            yield line
            yield from self._store_size(self._size_location(line.location), line.value)
        elif line.location.offset in self.slope_range:
            yield from self._store_size(line.location, line.value)

    def _store_size(self, location: Location, value: Operand) -> Iterator[Line]:
        size, lines = self._size_of(value)
        yield from lines
        yield StoreTo(location, size)

    def _new_name(self) -> str:
        """Return a name for a value that stands nowhere in the program."""
        return f"_term{next(self._numbers)}"

    def _size_of_target(self, target: str) -> str:
        self._sizes[target] = self._new_name()
        return self._sizes[target]

    def _size_of(self, operand: Operand) -> tuple[Operand, list[Line]]:
        """Return the size of an operand, and the lines that it needs."""
        if operand in self._sizes:
            return self._sizes[operand], []
        if not isinstance(operand, str):
            return abs(operand), []
        name = self._new_name()
        return name, [Compute(name, "abs", (operand,))]

    def _size_computation(self, line: Compute) -> Iterator[Line]:
        """Write the size of a value where it is not its absolute value."""
        operation, operands = line.operation, line.arguments
        cancels = operation in ("add", "subtract") or any(operand in self._sizes for operand in operands)
        if operation in ("negative", "abs", "positive", "newest"):
            if operands[-1] in self._sizes:
                self._sizes[line.target] = self._sizes[operands[-1]]
        elif cancels and operation in _SCALED:
            yield from self._size_of_product(line)
        elif cancels and operation in _EXTREMA:
            yield from self._size_of_extremum(line)
        elif cancels and operation in _JOINED:
            *truth, left, right = operands
            (size, first), (second_size, second) = map(self._size_of, (left, right))
            sizes = (*truth, size, second_size)
            yield from (*first, *second, Compute(self._size_of_target(line.target), _JOINED[operation], sizes))

    def _size_of_extremum(self, line: Compute) -> Iterator[Line]:
        """Write the size of the less or the greater of two: that of the one it is, since the other may be any number."""
        left, right = line.arguments
        (size, first), (second_size, second) = map(self._size_of, (left, right))
        is_left = self._new_name()
        yield from (*first, *second, Compute(is_left, "equal", (line.target, left)))
        yield Compute(self._size_of_target(line.target), "choose", (is_left, size, second_size))

    def _size_of_product(self, line: Compute) -> Iterator[Line]:
        """Write the size of a product, or of a quotient, from the sizes of its operands."""
        left, right = line.arguments
        (size, first), (second_size, second) = map(self._size_of, line.arguments)
        yield from (*first, *second)
        quotient_share, of_left, of_right = self._new_name(), self._new_name(), self._new_name()
        if line.operation == "multiply":  # |a| size(b), size(a) |b|
            sizes = ("multiply", size, right), ("multiply", second_size, left)
        else:  # size(a)/|b|, |a/b| size(b)/|b|
            yield Compute(quotient_share, "divide", (line.target, right))
            sizes = ("divide", size, right), ("multiply", second_size, quotient_share)
        for name, (operation, grown, factor) in zip((of_left, of_right), sizes, strict=True):
            signed = self._new_name()
            yield Compute(signed, operation, (grown, factor))
            yield Compute(name, "abs", (signed,))
        yield Compute(self._size_of_target(line.target), "greatest", (of_left, of_right))

    def _rewrite_reduction(self, line: Reduction) -> Iterator[Line]:
        """Write a reduction with the sizes of its totals."""
        if line.operation not in ("add", "newest"):
            yield replace(line, body=cast("tuple[Line, ...]", self.lines(line.body)))
            return
        starts, lines_before = list(line.starts), list[Line]()
        for start in line.starts:
            size, lines = self._size_of(start)
            lines_before += lines
            starts.append(size)
        totals = [self._size_of_target(total) for total in line.totals]  # also read inside, as the totals so far
        body = [*self.lines(line.body)]
        terms = list(line.terms)
        for term in line.terms:
            size, lines = self._size_of(term)
            body += lines
            terms.append(size)
        yield from lines_before
        yield replace(
            line,
            body=cast("tuple[Line, ...]", tuple(body)),
            terms=tuple(terms),
            totals=(*line.totals, *totals),
            start=tuple(starts),
        )
