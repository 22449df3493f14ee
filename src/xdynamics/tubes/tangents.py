"""Programs of motions for intervals, with their derivatives by the start: values followed by their tangents.

A tangent is the derivative of a value by one number of the start; a loop over these numbers goes through the lines once
more (Griewank and Walther, Evaluating Derivatives, 2nd ed., chapter 3). At a corner the choice of a side decides, which
intervals cannot make where a corner is among the values.

A program for intervals has three numbers in place of each one: its lower and its upper bound, and whether it is
undefined. It is the same program, printed for another kind of number and computed by machine code: only + - * / and
square roots rounded outward, the same bounds on every machine.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import count

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels import machine
from xdynamics.kernels.interval_program import squared
from xdynamics.kernels.jets.recurrences import CONSTANT
from xdynamics.kernels.llvm_program import llvm_of
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
        # kept: the entry is a bare address within it
        self._code = machine.compiled(text, [program.name])
        self._entry = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4)(self._code.addresses[program.name])
        self.arrays = {name: np.zeros((count, len(PARTS))) for name, count in sizes.items()}
        self._table = np.zeros(WORDS * len(TABLE), np.int64)
        for name, array in self.arrays.items():
            self._table[WORDS * ARRAYS.index(name)] = array.ctypes.data
        addresses = [self.arrays[name].ctypes.data if name in sizes else 0 for name in ("y", "z", "samples")]
        self._addresses = [self._table.ctypes.data, *addresses]

    def run(self) -> None:
        """Run the program on its arrays."""
        self._entry(*self._addresses)


def _enclosed_program(program: Program) -> Program:
    """Return the program for intervals."""
    return replace(program, body=tuple(_Enclosing().lines(program.body)))


class _Enclosing:
    """Writes lines for intervals; integers that are counted stay plain numbers."""

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
                    operation, operands = squared(line), list[Operand]()
                    for operand in operation.arguments:
                        point = self._point(operand)
                        yield from point
                        operands.append(point[0].target if point else operand)
                    yield replace(operation, arguments=tuple(operands), kind=ENCLOSED)
                case Ordinal():
                    self._exact.add(line.target)
                    yield line
                case Loop():
                    yield replace(line, body=tuple(self.lines(line.body)))
                case Reduction():
                    yield replace(line, body=tuple(self.lines(line.body)), kind=ENCLOSED)

    def _counts(self, line: Compute) -> bool:
        """Whether a line adds integers; other constant lines, such as 1/3, round and need intervals."""
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


SEED = "_seed"  # the index of the loop over numbers of the start
ZERO = 0.0


class Tangents:
    """Writes the tangents of the values of some lines.

    Parameters
    ----------
    read : callable
        Returns the place of the tangents of what is at a place; None of what does not depend on the start.
    """

    def __init__(self, read: Callable[[Location], Location | None]) -> None:
        self.lines: list[Line] = []
        self._read = read
        self._tangents: dict[str, Operand] = {}
        self._serial = count()

    def tangent_of(self, operand: Operand) -> Operand:
        """Return the tangent of a value."""
        return self._tangents.get(operand, ZERO) if isinstance(operand, str) else ZERO

    def follow(self, line: Load | Compute) -> None:
        """Write the tangent of a line's value."""
        tangent: Operand = ZERO
        if isinstance(line, Load):
            if (address := self._read(line.location)) is not None:
                tangent = self._new_name()
                self.lines.append(Load(tangent, address))
        elif line.operation not in CONSTANT and any(self.tangent_of(argument) != ZERO for argument in line.arguments):
            tangent = RULES[line.operation](self, line.target, *line.arguments)
        self._tangents[line.target] = tangent

    def write(self, operation: str, *arguments: Operand) -> Operand:
        """Write an operation, unless zeros and ones settle it."""
        first, last = arguments[0], arguments[-1]
        match operation:
            case "add" if first == ZERO or last == ZERO:
                return last if first == ZERO else first
            case "subtract" if last == ZERO:
                return first
            case "subtract" if first == ZERO:
                return self.write("negative", last)
            case "multiply" if ZERO in (first, last):
                return ZERO
            case "divide" | "negative" if first == ZERO:
                return ZERO
        name = self._new_name()
        self.lines.append(Compute(name, operation, arguments))
        return name

    def _new_name(self) -> str:
        return f"_tangent{next(self._serial)}"


Rule = Callable[..., Operand]  # of the tangents, a value by its name, and the arguments that it is computed from


def _linear_rule(operation: str) -> Rule:
    return lambda write, _, *arguments: write.write(operation, *map(write.tangent_of, arguments))


def _product_rule(write: Tangents, _: str, a: Operand, b: Operand) -> Operand:
    return write.write(
        "add", write.write("multiply", write.tangent_of(a), b), write.write("multiply", write.tangent_of(b), a)
    )


def _quotient_rule(write: Tangents, value: str, a: Operand, b: Operand) -> Operand:
    numerator = write.write("subtract", write.tangent_of(a), write.write("multiply", write.tangent_of(b), value))
    return write.write("divide", numerator, b)


def _factor_rule(factor: Callable[[Tangents, str, Operand], Operand]) -> Rule:
    """Return the rule of a function by its derivative."""
    return lambda write, value, a: write.write("multiply", write.tangent_of(a), factor(write, value, a))


def _divisor_rule(divisor: Callable[[Tangents, str, Operand], Operand], sign: float = 1.0) -> Rule:
    """Return the rule of a function with derivative 1/d, or -1/d, by the expression of d."""

    def rule(write: Tangents, value: str, a: Operand) -> Operand:
        quotient = write.write("divide", write.tangent_of(a), divisor(write, value, a))
        return quotient if sign > 0.0 else write.write("negative", quotient)

    return rule


def _one_and_square(sign: str) -> Callable[[Tangents, str, Operand], Operand]:
    return lambda write, value, _: write.write(sign, 1.0, write.write("multiply", value, value))


def _arc_divisor(write: Tangents, _: str, a: Operand) -> Operand:
    # (1 - a)*(1 + a) has the digits that 1 - a**2 loses near 1
    product = write.write("multiply", write.write("subtract", 1.0, a), write.write("add", 1.0, a))
    return write.write("sqrt", product)


def _power_rule(write: Tangents, value: str, a: Operand, exponent: Operand) -> Operand:
    slope = write.write("divide", write.write("multiply", value, exponent), a)
    return write.write("multiply", write.tangent_of(a), slope)


def _hypot_rule(write: Tangents, value: str, a: Operand, b: Operand) -> Operand:
    both = write.write(
        "add", write.write("multiply", write.tangent_of(a), a), write.write("multiply", write.tangent_of(b), b)
    )
    return write.write("divide", both, value)


def _atan2_rule(write: Tangents, _: str, y: Operand, x: Operand) -> Operand:
    turning = write.write(
        "subtract", write.write("multiply", write.tangent_of(y), x), write.write("multiply", write.tangent_of(x), y)
    )
    squares = write.write("add", write.write("multiply", y, y), write.write("multiply", x, x))
    return write.write("divide", turning, squares)


def _abs_rule(write: Tangents, _: str, a: Operand) -> Operand:
    return write.write(
        "choose", write.write("less", a, ZERO), write.write("negative", write.tangent_of(a)), write.tangent_of(a)
    )


def _extreme_tangent(comparison: str) -> Rule:
    return lambda write, _, a, b: write.write(
        "choose", write.write(comparison, a, b), write.tangent_of(a), write.tangent_of(b)
    )


def _choice_rule(write: Tangents, _: str, truth: Operand, a: Operand, b: Operand) -> Operand:
    return write.write("choose", truth, write.tangent_of(a), write.tangent_of(b))


def _mod_rule(write: Tangents, _: str, a: Operand, b: Operand) -> Operand:
    turns = write.write("floor", write.write("divide", a, b))
    return write.write("subtract", write.tangent_of(a), write.write("multiply", turns, write.tangent_of(b)))


RULES: Mapping[str, Rule] = {
    **{name: _linear_rule(name) for name in ("add", "subtract", "negative")},
    "multiply": _product_rule,
    "divide": _quotient_rule,
    "sqrt": _divisor_rule(lambda write, value, _: write.write("add", value, value)),
    "exp": _factor_rule(lambda _, value, __: value),
    "log": _divisor_rule(lambda _, __, a: a),
    "sin": _factor_rule(lambda write, _, a: write.write("cos", a)),
    "cos": _factor_rule(lambda write, _, a: write.write("negative", write.write("sin", a))),
    "tan": _factor_rule(_one_and_square("add")),
    "asin": _divisor_rule(_arc_divisor),
    "acos": _divisor_rule(_arc_divisor, -1.0),
    "atan": _divisor_rule(lambda write, _, a: write.write("add", 1.0, write.write("multiply", a, a))),
    "sinh": _factor_rule(lambda write, _, a: write.write("cosh", a)),
    "cosh": _factor_rule(lambda write, _, a: write.write("sinh", a)),
    "tanh": _factor_rule(_one_and_square("subtract")),
    "power": _power_rule,
    "hypot": _hypot_rule,
    "atan2": _atan2_rule,
    "abs": _abs_rule,
    "least": _extreme_tangent("less"),
    "greatest": _extreme_tangent("more"),
    "choose": _choice_rule,
    "mod": _mod_rule,
    "positive": lambda write, _, a: write.tangent_of(a),
}


def with_tangents(
    lines: Sequence[Line], read: Callable[[Location], Location | None], stored: Callable[[Location], Location]
) -> tuple[Line, ...]:
    """Return lines that compute and store the tangents of the values that straight lines store.

    Parameters
    ----------
    lines : sequence of Line
    read : callable
        From the place of a number to that of its tangents; None of what does not depend on the start.
    stored : callable
        From the place where a value goes to that of its tangents.
    """
    write = Tangents(read)
    for line in lines:
        if isinstance(line, Load | Compute):
            write.follow(line)
        elif isinstance(line, StoreTo):
            write.lines.append(StoreTo(stored(line.location), write.tangent_of(line.value)))
    return tuple(write.lines)
