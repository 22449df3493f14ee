"""Programs for intervals: in place of every number three, its lower and its upper bound and whether it is undefined.

The same program, printed for another kind of number, computed by machine code: only + - * / and square roots rounded
outward, the same bounds on every machine.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import machine
from xdynamics.kernels.llvm_text import llvm_of
from xdynamics.kernels.program import (
    ARRAYS,
    ENCLOSED,
    TABLE,
    WORDS,
    Compute,
    Instruction,
    Line,
    Load,
    Location,
    Loop,
    Operand,
    Ordinal,
    Program,
    Reduction,
    StoreTo,
)

PARTS = ("low", "high", "flaw")
Floats = NDArray[np.float64]


class EnclosedProgram:
    """A program for intervals as machine code, with the arrays that it reads and writes.

    Parameters
    ----------
    program : Program
        Of numbers, in straight lines and loops.
    sizes : mapping of str to int
        How many intervals each array has.
    """

    def __init__(self, program: Program, sizes: Mapping[str, int]) -> None:
        text = llvm_of([_enclosed_program(program)])
        self._code = machine.compiled(text, [program.name])
        self._entry = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(self._code.addresses[program.name])
        self.arrays = {name: np.zeros((count, len(PARTS))) for name, count in sizes.items()}
        self._table = np.zeros(WORDS * len(TABLE), np.int64)
        for name, array in self.arrays.items():
            self._table[WORDS * ARRAYS.index(name)] = array.ctypes.data
        addresses = [self.arrays[name].ctypes.data if name in sizes else 0 for name in ("y", "z", "samples")]
        self._addresses = [self._table.ctypes.data, *addresses]

    def run(self) -> None:
        """Compute what is written to the arrays from what is in them."""
        self._entry(*self._addresses)


def _enclosed_program(program: Program) -> Program:
    """Return the program for intervals."""
    return replace(program, body=tuple(_Enclosing().lines(program.body)))


class _Enclosing:
    """Writes lines for intervals; what is counted stays a number."""

    def __init__(self) -> None:
        self._exact: set[str] = set()
        self._points = 0

    def lines(self, body: Iterable[Instruction]) -> Iterable[Line]:
        """Yield the lines of a body."""
        for line in body:
            match line:
                case Load():
                    parts = [f"{line.target}.{part}" for part in PARTS]
                    yield from (Load(name, _component_place(line.location, k)) for k, name in enumerate(parts))
                    yield Compute(line.target, "flawed", tuple(parts), ENCLOSED)
                case StoreTo():
                    yield from self._stored(line)
                case Compute() if self._counts(line):
                    self._exact.add(line.target)
                    yield line
                case Compute():
                    operands: list[Operand] = []
                    for operand in line.arguments:
                        point = self._point(operand)
                        yield from point
                        operands.append(point[0].target if point else operand)
                    yield replace(line, arguments=tuple(operands), kind=ENCLOSED)
                case Ordinal():
                    self._exact.add(line.target)
                    yield line
                case Loop():
                    yield replace(line, body=tuple(self.lines(line.body)))
                case Reduction():
                    yield replace(line, body=tuple(self.lines(line.body)), kind=ENCLOSED)

    def _counts(self, line: Compute) -> bool:
        """Whether a line adds whole numbers; all else of numbers alone, as 1/3, is rounded, and so is of intervals."""
        operand_names = [operand for operand in line.arguments if isinstance(operand, str)]
        return line.operation == "add" and bool(operand_names) and self._exact.issuperset(operand_names)

    def _point(self, operand: Operand) -> list[Compute]:
        """Return the line that makes an interval of a number; none of an interval."""
        if isinstance(operand, str) and operand not in self._exact:
            return []
        self._points += 1
        return [Compute(f"_point{self._points}", "point", (operand,), ENCLOSED)]

    def _stored(self, line: StoreTo) -> Iterable[Line]:
        point = self._point(line.value)
        yield from point
        value = point[0].target if point else line.value
        for k, part in enumerate(PARTS):
            self._points += 1
            name = f"_{part}{self._points}"
            yield Compute(name, part, (value,), ENCLOSED)
            yield StoreTo(_component_place(line.location, k), name)


def _component_place(address: Location, k: int) -> Location:
    strides = tuple((index, len(PARTS) * stride) for index, stride in address.strides)
    return Location(address.array, len(PARTS) * address.offset + k, strides)
