"""The elementary functions as LLVM text, for any number of lanes."""

from __future__ import annotations

import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache, partial
from typing import Any

from xdynamics.elementary.bounds import LEAST, Interval
from xdynamics.elementary.double_double import FUNCTIONS as FUNCTIONS_OF_SUMS
from xdynamics.elementary.double_double import DoubleDouble
from xdynamics.elementary.double_double.functions import CALLED, DoubleDoubles
from xdynamics.elementary.intervals import BY_ZERO, Intervals, with_zeros
from xdynamics.elementary.numbers import FunctionLines, LaneValue, Number
from xdynamics.elementary.sets import FUNCTIONS, NAME, PAIRS, SETS, TOGETHER
from xdynamics.elementary.tables import TABLES

OF_SUMS = "double_double_"  # before the names of functions of sums of two numbers
INTERVALS = "interval"  # before the names of operations on intervals that are called
_PARTS = ("double", "double", "i64")
_BOUNDS = f"{{ {', '.join(_PARTS)} }}"
_INLINE = ("point", "between", "low", "high", "flaw", "flawed", "negative")  # a line or two
LONG_FUNCTIONS = {**CALLED, **FUNCTIONS_OF_SUMS}


@lru_cache(maxsize=256)
def definition(name: str, lanes: int, math_functions: str = NAME) -> tuple[str, tuple[str, ...]]:
    """Print one function of a set, `@elementary_sin` say, and name the tables that it reads.

    `@elementary_sin.8` is that of eight numbers in a text of another number of lanes.
    """
    base_name, _, wide = name.partition(".")
    lines = FunctionLines(int(wide or lanes))
    function = TOGETHER.get(base_name) or _function_of_parts(base_name) or SETS[math_functions][base_name]
    arguments = [LaneValue(lines, "n", f"%x{i}") for i in range(_parameter_count(base_name, function))]
    result, kind, returned = function(*arguments), lines.kind("n"), lines.kind("n")
    if isinstance(result, tuple):
        returned, aggregate = struct(len(result), lines.lanes), "poison"
        for i, item in enumerate(result):
            aggregate = lines.line("n", f"insertvalue {returned} {aggregate}, {kind} {item.text}, {i}").text
        result = LaneValue(lines, "n", aggregate)
    signature = ", ".join(f"{kind} {item.text}" for item in arguments)
    body = "\n".join(item if item.endswith(":") else f"  {item}" for item in lines.lines)
    # ATTRIBUTES is filled in by `definitions`: to inline depends on the text, and this function is kept for all
    text = (
        f"define internal {returned} @elementary_{name}({signature}) ATTRIBUTES {{\nentry:\n{body}\n  ret {returned}"
        f" {result.text}\n}}"
    )
    return text, tuple(sorted(lines.tables))


def count_calls(text: str) -> Counter[str]:
    """Return how often a text calls each function, those of more numbers than it has lanes with their number."""
    return Counter(re.findall(r"call .*@elementary_(\w+(?:\.\d+)?)\(", text))


def written_intervals(lines: FunctionLines, margin: Number = LEAST, *, rough: bool) -> Intervals:
    """Return the operations on intervals for bounds that are written as lines, which call the elementary functions."""
    functions = {name: lambda x, name=name: lines.call(f"elementary_{name}", [x]) for name in FUNCTIONS}
    return Intervals(functions, margin, rough)


def called_intervals(lines: FunctionLines) -> Callable[..., Any]:
    """Return the operations on intervals as calls of functions, so that a text of many is short; of single numbers.

    Sums and products with zero, which they are of as a rule, are exact: rounded outward they would be the least normal
    numbers, whose products take many processors a hundred cycles.
    """
    inline = written_intervals(lines, rough=False)

    def call_operation(operation: str, *operands: Any) -> Any:
        if operation in _INLINE:
            return inline.of(operation, *operands)
        arguments = ", ".join(
            f"{kind} {part.text}"
            for operand in operands
            for kind, part in zip(_PARTS, map(lines.value, operand), strict=True)
        )
        call_result = lines.line("n", f"call {_BOUNDS} @{INTERVALS}_{operation}.{len(operands)}({arguments})").text
        parts = [f"extractvalue {_BOUNDS} {call_result}, {k}" for k in range(len(_PARTS))]
        return Interval(*(lines.line(letter, part) for letter, part in zip("nnw", parts, strict=True)))

    return call_operation


def interval_definitions(texts: Iterable[str]) -> str:
    """Print the operations on intervals that some texts call."""
    operation_names = {name for text in texts for name in re.findall(rf"@{INTERVALS}_(\w+\.\d)\(", text)}
    return "\n".join(map(_interval_definition, sorted(operation_names)))


@lru_cache(maxsize=64)
def _interval_definition(name: str) -> str:
    operation, _, count = name.partition(".")
    lines = FunctionLines(1)
    operand_parts = [
        [LaneValue(lines, letter, f"%x{i}.{letter}{k}") for k, letter in enumerate("nnw")] for i in range(int(count))
    ]
    intervals = [Interval(*parts) for parts in operand_parts]
    enclosure = written_intervals(lines, rough=False).of(operation, *intervals)
    if operation in BY_ZERO:
        enclosure = with_zeros(operation, enclosure, *intervals)
    aggregate = "poison"
    for k, (kind, part) in enumerate(zip(_PARTS, map(lines.value, enclosure), strict=True)):
        aggregate = lines.line("n", f"insertvalue {_BOUNDS} {aggregate}, {kind} {part.text}, {k}").text
    signature = ", ".join(
        f"{kind} {part.text}" for parts in operand_parts for kind, part in zip(_PARTS, parts, strict=True)
    )
    body = "\n".join(item if item.endswith(":") else f"  {item}" for item in lines.lines)
    return (
        f"define internal {_BOUNDS} @{INTERVALS}_{name}({signature}) nounwind noinline {{\nentry:\n{body}\n"
        f"  ret {_BOUNDS} {aggregate}\n}}"
    )


def written_double_doubles(lines: FunctionLines, width: Callable[[], str]) -> DoubleDoubles:
    """Return the operations on sums of two numbers that are written as lines, which call the elementary functions."""

    def call_function(name: str, *operands: DoubleDouble) -> DoubleDouble:
        kind, parts = struct(2, lines.lanes), [lines.value(part) for number in operands for part in number]
        arguments = ", ".join(f"{lines.kind('n')} {part.text}" for part in parts)
        call_result = lines.line("n", f"call {kind} @elementary_{OF_SUMS}{name}{width()}({arguments})").text
        return DoubleDouble(*(lines.line("n", f"extractvalue {kind} {call_result}, {k}") for k in range(2)))

    return DoubleDoubles({name: partial(call_function, name) for name in LONG_FUNCTIONS})


def _function_of_parts(name: str) -> Callable[..., DoubleDouble] | None:
    """Return a function of sums of two numbers as one of the numbers."""
    if not name.startswith(OF_SUMS):
        return None
    function = LONG_FUNCTIONS[name.removeprefix(OF_SUMS)]
    return lambda *parts: function(*(DoubleDouble(*pair) for pair in zip(parts[::2], parts[1::2], strict=True)))


def _parameter_count(name: str, function: Callable[..., Any]) -> int:
    if name.startswith(OF_SUMS):
        return 2 * len(inspect.signature(LONG_FUNCTIONS[name.removeprefix(OF_SUMS)]).parameters)
    return len(inspect.signature(function).parameters)


def struct(count: int, lanes: int) -> str:
    """Return the LLVM type of so many results."""
    return f"{{ {', '.join([FunctionLines(lanes).kind('n')] * count)} }}"


def struct_of(name: str, lanes: int) -> str:
    """Return the LLVM type of the results of functions that are computed together."""
    return struct(sum(pair == name for pair, _ in PAIRS.values()), lanes)


def definitions(names: Mapping[str, bool], lanes: int, math_functions: str = NAME) -> str:
    """Print functions, which call those of `declarations`, and the tables that they read.

    Parameters
    ----------
    names : mapping of str to bool
        For each function whether it is inlined.
    lanes : int
    math_functions : str
        The set that they belong to.
    """
    printed = {name: definition(name, lanes, math_functions) for name in sorted(names)}
    tables = sorted({table for _, tables_read in printed.values() for table in tables_read})
    wide = '"prefer-vector-width"="512"'
    attributes = {True: f"nounwind alwaysinline {wide}", False: f"nounwind {wide}"}
    text = [text.replace("ATTRIBUTES", attributes[names[name]]) for name, (text, _) in printed.items()]
    return "\n".join([*map(_table_text, tables), *text])


def declarations(*lanes: int) -> str:
    """Declare the LLVM intrinsics that functions and laws call, for numbers of lanes."""
    return "\n".join([*map(_intrinsic_declarations, lanes), "!0 = !{}"])


def _intrinsic_declarations(lanes: int) -> str:
    lines = FunctionLines(lanes)
    number, suffix = lines.kind("n"), lines.suffix()
    printed = [f"declare {number} @llvm.{name}.{suffix}({number})" for name in ("sqrt", "fabs", "floor")]
    printed.append(f"declare {number} @llvm.copysign.{suffix}({number}, {number})")
    if lanes > 1:
        printed += [
            f"declare {lines.kind(letter)} @llvm.masked.gather.{lines.suffix(letter)}.v{lanes}p0"
            f"({lines.kind('p')}, i32, {lines.kind('t')}, {lines.kind(letter)})"
            for letter in "nw"
        ]
        printed.append(f"declare i1 @llvm.vector.reduce.and.{lines.suffix('t')}({lines.kind('t')})")
        scattered = f"{number}, {lines.kind('p')}, i32, {lines.kind('t')}"
        printed.append(f"declare void @llvm.masked.scatter.{suffix}.v{lanes}p0({scattered})")
    return "\n".join(printed)


def _table_text(name: str) -> str:
    table = TABLES[name]
    lines = FunctionLines(1)
    kind = lines.kind("w" if isinstance(table[0], int) else "n")
    entries = ", ".join(f"{kind} {lines.constant(value).text}" for value in table)
    return f"@table_{name} = internal constant [{len(table)} x {kind}] [{entries}]"
