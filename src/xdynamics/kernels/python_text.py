"""A program as Python: what a record quotes, and what runs where nothing is compiled.

Each operation of a law is one function of numbers, with its spelling in Python. All are operations of IEEE 754 or
functions of `elementary`, and the same everywhere: for floats, for arrays and for numbers that stand for lines of LLVM
text.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import SETS
from xdynamics.elementary.double_double.functions import DoubleDoubles
from xdynamics.elementary.fma import fma
from xdynamics.elementary.numbers import (
    absolute,
    binary_power,
    ceiling,
    choose,
    exponent,
    floor,
    maximum_of_two,
    minimum_of_two,
    modulo,
    positive_or_nan,
    round_half_even,
    sign,
    significand,
    sqrt,
)
from xdynamics.expressions import CALLED_ALONE
from xdynamics.expressions.evaluation import NUMERIC
from xdynamics.kernels.drive_tables import PYTHON_TABLES
from xdynamics.kernels.program import (
    ARRAYS,
    AT,
    FLOAT,
    OF_FLOAT,
    Compute,
    EngineCall,
    Gather,
    Instruction,
    Load,
    Location,
    Loop,
    Operand,
    Ordinal,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
)

# operation: sign in Python and how strongly it binds
INFIX = {"add": (" + ", 1), "subtract": (" - ", 1), "multiply": ("*", 2), "divide": ("/", 2)}
COMPARISONS = {"less": " < ", "at_most": " <= ", "more": " > ", "at_least": " >= ", "equal": " == ", "unequal": " != "}
RULES: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "less": operator.lt,
    "at_most": operator.le,
    "more": operator.gt,
    "at_least": operator.ge,
    "equal": operator.eq,
    "unequal": operator.ne,
    "negative": operator.neg,
    "abs": absolute,
    "sqrt": sqrt,
    "choose": choose,
    "sign": sign,
    "least": minimum_of_two,
    "greatest": maximum_of_two,
    "positive": positive_or_nan,
    "floor": floor,
    "ceil": ceiling,
    "round": round_half_even,
    "mod": modulo,
    "fma": fma,
    "significand": significand,
    "exponent": exponent,
    "binary_power": binary_power,
    "newest": lambda _, new: new,
}


def unsound(numbers: NDArray[np.float64]) -> float:
    """Return 0 if all numbers are finite, else nan."""
    return 0.0 if np.isfinite(numbers).all() else math.nan


def _as_numpy_float(function: Callable[..., float]) -> Callable[..., float]:
    """Make a function return NumPy floats, which divide by zero as IEEE 754 requires, unlike Python's."""

    @wraps(function)
    def wrapped(*arguments: float) -> Any:
        return np.float64(function(*(float(argument) for argument in arguments)))

    return wrapped


# by their names in printed Python, where a model's own names cannot collide with those that have an underscore
_PRIVATE = ("positive", "power", *CALLED_ALONE)
PYTHON: dict[str, Any] = {
    **{f"_{name}" if name in _PRIVATE else name: _as_numpy_float(function) for name, function in NUMERIC.items()},
    "_least": _as_numpy_float(minimum_of_two),
    "_greatest": _as_numpy_float(maximum_of_two),
    "_fma": _as_numpy_float(fma),
    "_ordinal": np.float64,
    "_unsound": unsound,
}


def python_of_set(math_functions: str) -> dict[str, Any]:
    """Return the functions that printed Python calls, with the elementary functions of a set."""
    functions = {
        f"_{name}" if name == "power" else name: _as_numpy_float(function)
        for name, function in SETS[math_functions].items()
    }
    return PYTHON | functions | {"_double_double": DoubleDoubles()}


_SUM, _PRODUCT, _ATOM = 1, 2, 3  # how strongly an expression binds; a comparison or a choice does not: 0
SIGNATURE = ", ".join(f"_{name}" for name in ARRAYS)

HIGHEST = 100  # nesting levels of a printed expression: Python's compiler allows some thousand, and 200 parentheses

Text = tuple[str, int]  # an expression and how strongly it binds


def python_of(program: Program) -> str:
    """Print a program as a function of arrays; a value that is used once is written where it is used."""
    lines = [f'"""{program.about}"""']
    array_views = {name: view for name, view in program.views.items() if view[0] in ARRAYS}
    local_views = {name: view for name, view in program.views.items() if name not in array_views}
    lines += [_view_line(name, *view) for name, view in array_views.items()]
    lines += [f"{name} = _empty({count})" for name, count in program.local.items()]
    lines += [_view_line(name, *view) for name, view in local_views.items()]
    lines += [f"{name} = {numbers}" for name, numbers in program.tables.items()]
    lines += _PythonPrinter(program.body).lines
    if program.sound:
        first, count = program.sound
        lines.append(f"_at[{AT.index('unsound')}] = _unsound(_z[{first}:{first + count}])")
    body = "\n".join(f"    {line}" for line in lines)
    return f"def {program.name}({SIGNATURE}):\n{body}\n"


def function_text(
    name: str, argument_names: Iterable[str], body: Iterable[Instruction], results: Iterable[Operand]
) -> str:
    """Print instructions as a function of numbers that returns numbers."""
    printer = _PythonPrinter(tuple(body), returned=tuple(results))
    lines = [*printer.lines, f"return {', '.join(map(printer.text, results))}"]
    return f"def {name}({', '.join(argument_names)}):\n" + "".join(f"    {line}\n" for line in lines)


class _PythonPrinter:
    """Prints the lines of one scope; an unnamed value that is read once gets no line of its own."""

    def __init__(
        self, body: tuple[object, ...], outer_texts: dict[str, Text] | None = None, returned: tuple[Operand, ...] = ()
    ) -> None:
        self.lines: list[str] = []
        self._texts: dict[str, Text] = dict(outer_texts or {})
        self._heights: dict[Operand, int] = {}  # of expressions written where they are used
        self._uses = Counter([*_operands_read(body), *returned])
        for line in body:
            self._print_line(line)

    def _print_line(self, line: object) -> None:
        match line:
            case Load():
                self._define_value(line.target, (_element_text(line.location), _ATOM))
            case Gather():
                self.lines.append(f"{line.index} = {_element_text(line.location)}")
            case Ordinal():
                self._define_value(line.target, (f"_ordinal({line.index})", _ATOM))
            case Compute():
                height = 1 + max((self._heights.get(entry, 0) for entry in line.arguments), default=0)
                self._define_value(line.target, self._computed_text(line), height)
            case StoreTo():
                self.lines.append(f"{_element_text(line.location)} = {self.text(line.value)}")
            case ProgramCall():
                passed = {"at": line.at, "y": line.y, "z": line.z, "e": line.e}
                places = (passed.get(entry, entry) for entry in ARRAYS)
                self.lines.append(f"{line.program}({', '.join(_array_name(entry) for entry in places)})")
            case EngineCall():
                words = f"_p[{line.first}], _p[{line.first + 1}]"
                self.lines.append(f"_entered({words}, _at[{AT.index('t')}], _z)")
            case When() | While():
                word, inner = "while" if isinstance(line, While) else "if", _PythonPrinter((line.call,)).lines
                self.lines += [f"{word} {_element_text(line.location)}:", *(f"    {entry}" for entry in inner)]
            case Loop() if line.count:
                self._print_pass(line, _PythonPrinter(line.body, self._texts).lines)
            case Reduction():
                self._reduction(line)

    def _print_pass(self, line: Loop | Reduction, inner: list[str]) -> None:
        """Print a loop over given lines."""
        passes = str(line.count)
        if isinstance(line, Reduction) and (line.below or line.above):
            passes = line.below or f"{line.above} + 1, {line.count}"
        self.lines += [f"for {line.index} in range({passes}):", *(f"    {entry}" for entry in inner)]

    def _reduction(self, line: Reduction) -> None:
        for total, start in zip(line.totals, line.starts, strict=True):
            text = self.text(start)
            exact = line.kind == FLOAT or isinstance(start, str)
            self.lines.append(
                f"{total} = {text}" if exact else f"{total} = _{line.kind}.of({OF_FLOAT[line.kind]!r}, {text})"
            )
        read = (*line.terms, *([line.where] if line.where else ()))
        inner = _PythonPrinter(line.body, self._texts, read)
        join_lines = [
            f"{total} = {inner._computed_text(Compute(total, line.operation, (total, term), line.kind))[0]}"
            for total, term in zip(line.totals, line.terms, strict=True)
        ]
        if line.where:
            join_lines = [f"if {inner.text(line.where)}:", *(f"    {entry}" for entry in join_lines)]
        if line.count:
            self._print_pass(line, [*inner.lines, *join_lines])

    def _define_value(self, target: str, text: Text, height: int = 0) -> None:
        if target.startswith("_") and self._uses[target] == 1 and height < HIGHEST:
            self._texts[target], self._heights[target] = text, height
            return
        self._texts[target] = (target, _ATOM)
        self.lines.append(f"{target} = {text[0]}")

    def _computed_text(self, line: Compute) -> Text:
        name, arguments = line.operation, line.arguments
        if line.kind != FLOAT:
            return f"_{line.kind}.of({', '.join([repr(name), *map(self.text, arguments)])})", _ATOM
        if name in INFIX:
            sign, strength = INFIX[name]
            # a literal is a float of Python, whose division by zero raises; `_zero` is NumPy's
            if name == "divide" and arguments[1] == 0.0:
                return f"{self._parenthesised(arguments[0], _PRODUCT)}/_zero", _PRODUCT
            return (
                # strength + 1 keeps the parentheses of a + (b + c), which round otherwise than (a + b) + c
                f"{self._parenthesised(arguments[0], strength)}{sign}{self._parenthesised(arguments[1], strength + 1)}",
                strength,
            )
        if name in COMPARISONS:
            return (
                f"{self._parenthesised(arguments[0], _SUM)}{COMPARISONS[name]}{self._parenthesised(arguments[1], _SUM)}",
                0,
            )
        if name == "newest":
            return self._expression_text(arguments[1])
        if name == "negative":
            return f"-{self._parenthesised(arguments[0], _ATOM)}", _ATOM
        if name == "choose":
            condition, yes, no = (
                self.text(arguments[0]),
                *(self._parenthesised(argument, _SUM) for argument in arguments[1:]),
            )
            return f"{yes} if {condition} else {no}", 0
        if f"_{name}" in PYTHON_TABLES:
            extra = ", ".join(["_tables, _pieces", *(self.text(argument) for argument in arguments)])
            return f"_{name}({extra})", _ATOM
        function_name = name if name in PYTHON else f"_{name}"
        return f"{function_name}({', '.join(self.text(argument) for argument in arguments)})", _ATOM

    def _parenthesised(self, operand: Operand, needed: int) -> str:
        text, strength = self._expression_text(operand)
        return f"({text})" if strength < needed else text

    def text(self, operand: Operand) -> str:
        """Return the expression of an operand."""
        return self._expression_text(operand)[0]

    def _expression_text(self, operand: Operand) -> Text:
        if isinstance(operand, str):
            return self._texts.get(operand, (operand, _ATOM))
        return repr(operand) if math.isfinite(operand) else f"float('{operand}')", _ATOM


def _element_text(location: Location) -> str:
    terms = [index if stride == 1 else f"{stride}*{index}" for index, stride in location.strides]
    if location.offset or not terms:
        terms.insert(0, str(location.offset))
    return f"{_array_name(location.array)}[{' + '.join(terms)}]"


def _view_line(name: str, array: str, first: int, count: int) -> str:
    return f"{name} = {_array_name(array)}[{first}:{first + count}]"


def _array_name(name: str) -> str:
    return f"_{name}" if name in ARRAYS else name


def _operands_read(body: tuple[object, ...]) -> Iterator[Operand]:
    for line in body:
        match line:
            case Compute():
                yield from line.arguments
            case StoreTo():
                yield line.value
            case Loop() | Reduction():
                yield from line.starts if isinstance(line, Reduction) else ()
                # a value that a loop reads from outside is computed before it
                yield from (operand for operand in _operands_read(line.body) for _ in range(2))
