"""The elementary functions as LLVM text, for any number of lanes."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from functools import lru_cache

from xdynamics.elementary.functions import FUNCTIONS
from xdynamics.elementary.tables import TABLES
from xdynamics.elementary.written import Lines, Written


def arguments(name: str) -> int:
    """Return how many numbers a function is given."""
    return len(inspect.signature(FUNCTIONS[name]).parameters)


@lru_cache(maxsize=256)
def definition(name: str, lanes: int) -> tuple[str, tuple[str, ...]]:
    """Print one function, `@elementary_sin` say, and name the tables that it reads."""
    lines = Lines(lanes)
    given = [Written(lines, "n", f"%x{i}") for i in range(arguments(name))]
    found = FUNCTIONS[name](*given)
    kind = lines.kind("n")
    signature = ", ".join(f"{kind} {one.text}" for one in given)
    body = "\n".join(one if one.endswith(":") else f"  {one}" for one in lines.lines)
    text = f"define internal {kind} @elementary_{name}({signature}) #4 {{\nentry:\n{body}\n  ret {kind} {found.text}\n}}"
    return text, tuple(sorted(lines.tables))


def definitions(names: Iterable[str], lanes: int) -> str:
    """Print functions, the tables that they read, and what they call."""
    printed = [definition(name, lanes) for name in names]
    tables = sorted({table for _, read in printed for table in read})
    text = [*map(_table, tables), *(text for text, _ in printed)]
    return "\n".join([*text, "attributes #4 = { nounwind }"]) if printed else ""


def declarations(lanes: int) -> list[str]:
    """Declare what the functions call of LLVM's own."""
    if lanes == 1:
        return []
    gathers = [
        f"declare <{lanes} x {kind}> @llvm.masked.gather.v{lanes}{short}.v{lanes}p0"
        f"(<{lanes} x ptr>, i32, <{lanes} x i1>, <{lanes} x {kind}>)"
        for kind, short in (("double", "f64"), ("i64", "i64"))
    ]
    return [*gathers, f"declare i1 @llvm.vector.reduce.and.v{lanes}i1(<{lanes} x i1>)"]


def _table(name: str) -> str:
    table = TABLES[name]
    lines = Lines(1)
    kind = lines.kind("w" if isinstance(table[0], int) else "n")
    entries = ", ".join(f"{kind} {lines.constant(one).text}" for one in table)
    return f"@table_{name} = internal constant [{len(table)} x {kind}] [{entries}]"
