"""A program as Python: what a record quotes, and what runs where nothing is compiled."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator

from xdynamics.kernels.drive_tables import PYTHON_TABLES
from xdynamics.kernels.operations import COMPARISONS, INFIX, PYTHON
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
    Loop,
    Operand,
    Ordinal,
    Place,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    When,
    While,
)

_SUM, _PRODUCT, _ATOM = 1, 2, 3  # how strongly an expression binds; a comparison or a choice does not: 0
SIGNATURE = ", ".join(f"_{name}" for name in ARRAYS)

HIGHEST = 100  # nesting levels of a printed expression: Python's compiler allows some thousand, and 200 parentheses

Text = tuple[str, int]  # an expression and how strongly it binds


def python_of(program: Program) -> str:
    """Print a program as a function of arrays; a value that is used once is written where it is used."""
    lines = [f'"""{program.about}"""']
    given = {name: view for name, view in program.views.items() if view[0] in ARRAYS}
    own = {name: view for name, view in program.views.items() if name not in given}
    lines += [_view(name, *view) for name, view in given.items()]
    lines += [f"{name} = _empty({count})" for name, count in program.local.items()]
    lines += [_view(name, *view) for name, view in own.items()]
    lines += [f"{name} = {numbers}" for name, numbers in program.tables.items()]
    lines += _PythonPrinter(program.body).lines
    if program.sound:
        first, count = program.sound
        lines.append(f"_at[{AT.index('unsound')}] = _unsound(_z[{first}:{first + count}])")
    body = "\n".join(f"    {line}" for line in lines)
    return f"def {program.name}({SIGNATURE}):\n{body}\n"


def function_text(name: str, given: Iterable[str], body: Iterable[Instruction], results: Iterable[Operand]) -> str:
    """Print instructions as a function of numbers that returns numbers."""
    printer = _PythonPrinter(tuple(body), returned=tuple(results))
    lines = [*printer.lines, f"return {', '.join(map(printer.text, results))}"]
    return f"def {name}({', '.join(given)}):\n" + "".join(f"    {line}\n" for line in lines)


class _PythonPrinter:
    """Prints the lines of one scope; an unnamed value that is read once gets no line of its own."""

    def __init__(
        self,
        body: tuple[object, ...],
        known: dict[str, Text] | None = None,
        returned: tuple[Operand, ...] = (),
    ) -> None:
        self.lines: list[str] = []
        self._texts: dict[str, Text] = dict(known or {})
        self._heights: dict[Operand, int] = {}  # of expressions written where they are used
        self._uses = Counter([*_operands(body), *returned])
        for line in body:
            self._print(line)

    def _print(self, line: object) -> None:
        match line:
            case Load():
                self._define(line.target, (_element(line.place), _ATOM))
            case Gather():
                self.lines.append(f"{line.index} = {_element(line.place)}")
            case Ordinal():
                self._define(line.target, (f"_ordinal({line.index})", _ATOM))
            case Compute():
                height = 1 + max((self._heights.get(entry, 0) for entry in line.arguments), default=0)
                self._define(line.target, self._computed(line), height)
            case StoreTo():
                self.lines.append(f"{_element(line.place)} = {self.text(line.value)}")
            case ProgramCall():
                passed = {"at": line.at, "y": line.y, "z": line.z, "e": line.e}
                places = (passed.get(entry, entry) for entry in ARRAYS)
                self.lines.append(f"{line.program}({', '.join(_array(entry) for entry in places)})")
            case EngineCall():
                words = f"_p[{line.first}], _p[{line.first + 1}]"
                self.lines.append(f"_entered({words}, _at[{AT.index('t')}], _z)")
            case When() | While():
                word, inner = "while" if isinstance(line, While) else "if", _PythonPrinter((line.call,)).lines
                self.lines += [f"{word} {_element(line.place)}:", *(f"    {entry}" for entry in inner)]
            case Loop() if line.count:
                self._pass(line, _PythonPrinter(line.body, self._texts).lines)
            case Reduction():
                self._reduction(line)

    def _pass(self, line: Loop | Reduction, inner: list[str]) -> None:
        """Print a loop of these lines."""
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
        joined = [
            f"{total} = {inner._computed(Compute(total, line.operation, (total, term), line.kind))[0]}"
            for total, term in zip(line.totals, line.terms, strict=True)
        ]
        if line.where:
            joined = [f"if {inner.text(line.where)}:", *(f"    {entry}" for entry in joined)]
        if line.count:
            self._pass(line, [*inner.lines, *joined])

    def _define(self, target: str, text: Text, height: int = 0) -> None:
        if target.startswith("_") and self._uses[target] == 1 and height < HIGHEST:
            self._texts[target], self._heights[target] = text, height
            return
        self._texts[target] = (target, _ATOM)
        self.lines.append(f"{target} = {text[0]}")

    def _computed(self, line: Compute) -> Text:
        name, arguments = line.operation, line.arguments
        if line.kind != FLOAT:
            return f"_{line.kind}.of({', '.join([repr(name), *map(self.text, arguments)])})", _ATOM
        if name in INFIX:
            sign, strength = INFIX[name]
            if name == "divide" and arguments[1] == 0.0:
                return f"{self._bound(arguments[0], _PRODUCT)}/_zero", _PRODUCT
            return f"{self._bound(arguments[0], strength)}{sign}{self._bound(arguments[1], strength + 1)}", strength
        if name in COMPARISONS:
            return f"{self._bound(arguments[0], _SUM)}{COMPARISONS[name]}{self._bound(arguments[1], _SUM)}", 0
        if name == "newest":
            return self._expression(arguments[1])
        if name == "negative":
            return f"-{self._bound(arguments[0], _ATOM)}", _ATOM
        if name == "choose":
            condition, yes, no = self.text(arguments[0]), *(self._bound(argument, _SUM) for argument in arguments[1:])
            return f"{yes} if {condition} else {no}", 0
        if f"_{name}" in PYTHON_TABLES:
            extra = ", ".join(["_tables, _pieces", *(self.text(argument) for argument in arguments)])
            return f"_{name}({extra})", _ATOM
        called = name if name in PYTHON else f"_{name}"
        return f"{called}({', '.join(self.text(argument) for argument in arguments)})", _ATOM

    def _bound(self, operand: Operand, needed: int) -> str:
        text, strength = self._expression(operand)
        return f"({text})" if strength < needed else text

    def text(self, operand: Operand) -> str:
        """Return the expression of an operand."""
        return self._expression(operand)[0]

    def _expression(self, operand: Operand) -> Text:
        if isinstance(operand, str):
            return self._texts.get(operand, (operand, _ATOM))
        return repr(operand) if math.isfinite(operand) else f"float('{operand}')", _ATOM


def _element(place: Place) -> str:
    terms = [index if stride == 1 else f"{stride}*{index}" for index, stride in place.strides]
    if place.offset or not terms:
        terms.insert(0, str(place.offset))
    return f"{_array(place.array)}[{' + '.join(terms)}]"


def _view(name: str, array: str, first: int, count: int) -> str:
    return f"{name} = {_array(array)}[{first}:{first + count}]"


def _array(name: str) -> str:
    return f"_{name}" if name in ARRAYS else name


def _operands(body: tuple[object, ...]) -> Iterator[Operand]:
    for line in body:
        match line:
            case Compute():
                yield from line.arguments
            case StoreTo():
                yield line.value
            case Loop() | Reduction():
                yield from line.starts if isinstance(line, Reduction) else ()
                # a value that a loop reads from outside is computed before it
                yield from (operand for operand in _operands(line.body) for _ in range(2))
