"""A program of forces as one of the sizes of their terms: what the rounding of accelerations and rates is a share of.

The size of a sum is the sum of the sizes of its terms, whatever their signs; the size of a product grows as its factors'
sizes do. Where nothing cancels, a size is the absolute value. What is solved for has the sizes of all that it follows from:
forces of contacts, friction and constraints are terms among the others (running error analysis; Higham, Accuracy and
Stability of Numerical Algorithms, 2nd ed., section 3.3).
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
    Loop,
    Operand,
    Place,
    Program,
    Reduction,
    StoreTo,
)

TERM_SIZES = "term_sizes"
# what joins the sizes of two operands
_JOINED = {"add": "add", "subtract": "add", "choose": "choose"}
_EXTREMA = ("least", "greatest")
_SCALED = ("multiply", "divide")


def term_sizes(layout: Layout) -> Program:
    """Write the size of the terms of every acceleration and rate at a state, where `forces` writes these themselves.

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
    wanted: range  # places of `z`
    _numbers: Iterator[int] = field(default_factory=count)
    _sizes: dict[Operand, str] = field(default_factory=dict)

    def lines(self, body: Iterable[Instruction]) -> tuple[Instruction, ...]:
        """Return lines with sizes."""
        return tuple(new for line in body for new in self._written(line))

    def _written(self, line: Instruction) -> Iterator[Instruction]:
        match line:
            case EngineCall():
                return
            case Load():
                yield line
                if line.place.array in self.program.local:
                    yield Load(self._size_of_target(line.target), self._beside(line.place))
            case StoreTo():
                yield from self._stored(line)
            case Compute():
                yield line
                yield from self._computed(line)
            case Loop():
                yield replace(line, body=cast("tuple[Line, ...]", self.lines(line.body)))
            case Reduction():
                yield from self._reduced(line)
            case _:
                yield line

    def _beside(self, place: Place) -> Place:
        """Return the place of a size: behind all numbers of an array of the program."""
        return replace(place, offset=place.offset + self.program.local[place.array])

    def _stored(self, line: StoreTo) -> Iterator[Line]:
        if line.place.array in self.program.local:
            yield line
            yield from self._put(self._beside(line.place), line.value)
        elif line.place.offset in self.wanted:
            yield from self._put(line.place, line.value)

    def _put(self, place: Place, value: Operand) -> Iterator[Line]:
        size, lines = self._size(value)
        yield from lines
        yield StoreTo(place, size)

    def _new(self) -> str:
        """Return a name for a value that stands nowhere in the program."""
        return f"_term{next(self._numbers)}"

    def _size_of_target(self, target: str) -> str:
        self._sizes[target] = self._new()
        return self._sizes[target]

    def _size(self, operand: Operand) -> tuple[Operand, list[Line]]:
        """Return the size of an operand, and the lines that it needs."""
        if operand in self._sizes:
            return self._sizes[operand], []
        if not isinstance(operand, str):
            return abs(operand), []
        name = self._new()
        return name, [Compute(name, "abs", (operand,))]

    def _computed(self, line: Compute) -> Iterator[Line]:
        """Write the size of a value where it is not its absolute value."""
        operation, given = line.operation, line.arguments
        cancels = operation in ("add", "subtract") or any(operand in self._sizes for operand in given)
        if operation in ("negative", "abs", "positive", "newest"):
            if given[-1] in self._sizes:
                self._sizes[line.target] = self._sizes[given[-1]]
        elif cancels and operation in _SCALED:
            yield from self._scaled(line)
        elif cancels and operation in _EXTREMA:
            yield from self._selected(line)
        elif cancels and operation in _JOINED:
            *truth, left, right = given
            (size, first), (other, second) = map(self._size, (left, right))
            sizes = (*truth, size, other)
            yield from (*first, *second, Compute(self._size_of_target(line.target), _JOINED[operation], sizes))

    def _selected(self, line: Compute) -> Iterator[Line]:
        """Write the size of the less or the greater of two: that of the one it is, since the other may be any number."""
        left, right = line.arguments
        (size, first), (other, second) = map(self._size, (left, right))
        is_left = self._new()
        yield from (*first, *second, Compute(is_left, "equal", (line.target, left)))
        yield Compute(self._size_of_target(line.target), "choose", (is_left, size, other))

    def _scaled(self, line: Compute) -> Iterator[Line]:
        """Write the size of a product, or of a quotient: what the size of either operand makes of it."""
        left, right = line.arguments
        (size, first), (other, second) = map(self._size, line.arguments)
        yield from (*first, *second)
        beside, of_left, of_right = self._new(), self._new(), self._new()
        if line.operation == "multiply":  # |a| size(b), size(a) |b|
            sizes = ("multiply", size, right), ("multiply", other, left)
        else:  # size(a)/|b|, |a/b| size(b)/|b|
            yield Compute(beside, "divide", (line.target, right))
            sizes = ("divide", size, right), ("multiply", other, beside)
        for name, (operation, grown, by) in zip((of_left, of_right), sizes, strict=True):
            signed = self._new()
            yield Compute(signed, operation, (grown, by))
            yield Compute(name, "abs", (signed,))
        yield Compute(self._size_of_target(line.target), "greatest", (of_left, of_right))

    def _reduced(self, line: Reduction) -> Iterator[Line]:
        """Write a reduction with the sizes of its totals."""
        if line.operation not in ("add", "newest"):
            yield replace(line, body=cast("tuple[Line, ...]", self.lines(line.body)))
            return
        starts, before = list(line.starts), list[Line]()
        for start in line.starts:
            size, lines = self._size(start)
            before += lines
            starts.append(size)
        totals = [self._size_of_target(total) for total in line.totals]  # also read inside, as the totals so far
        body = [*self.lines(line.body)]
        terms = list(line.terms)
        for term in line.terms:
            size, lines = self._size(term)
            body += lines
            terms.append(size)
        yield from before
        yield replace(
            line,
            body=cast("tuple[Line, ...]", tuple(body)),
            terms=tuple(terms),
            totals=(*line.totals, *totals),
            start=tuple(starts),
        )
