"""Programs as LLVM text, with any number of lanes: one lane is what a single run calls."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable
from re import findall

from xdynamics.elementary import NAME
from xdynamics.elementary.fma import FMA, fma_definition
from xdynamics.elementary.text import (
    INTERVALS,
    count_calls,
    declarations,
    definition,
    definitions,
    interval_definitions,
)
from xdynamics.kernels import machine
from xdynamics.kernels.heap_arrays import DECLARED
from xdynamics.kernels.jets.series import ORDER
from xdynamics.kernels.llvm_program import ProgramText
from xdynamics.kernels.machine import AS_WRITTEN
from xdynamics.kernels.program import ARRAYS, TABLE, WORDS, Loop, Program, ProgramCall, When, While, line_count

INLINED = 1500  # instructions up to which a program is inlined
_SIGNATURE = ", ".join(f"ptr noalias %_{name}" for name in ARRAYS) + ", i64 %_apart"
_GIVEN = ("y", "z", "samples")  # by callers from outside, besides the table


def llvm_of(
    programs: Iterable[Program],
    lanes: int = 1,
    functions: Iterable[tuple[str, int]] = (),
    entered: Container[str] | None = None,
    math_functions: str = NAME,
    abreast: int = 1,
) -> str:
    """Print programs as one LLVM module.

    Parameters
    ----------
    programs : iterable of Program
        Each after those that it calls.
    lanes : int
        Runs side by side; each number of a run is an element of a vector.
    functions : iterable of (str, int)
        Python functions that are called, with how many arguments each takes.
    entered : container of str, optional
        Programs that are called from outside; all by default.
    math_functions : str
        The set of elementary functions.
    abreast : int
        Of a single run, how many neighbouring elements of independent loops are computed side by side.
    """
    parts = {part.name: part for part in programs}
    wide = abreast if lanes == 1 else lanes
    # loops over elements are not unrolled: no step is faster, and how long compiling takes depends on their number
    text = [AS_WRITTEN] if abreast > 1 or any(map(_has_orders, parts.values())) else []
    text.append(declarations(*{lanes, wide}))
    text += [f"declare double @_python_{name}({', '.join(['double'] * count)})" for name, count in functions]
    bodies = {name: ProgramText(part, lanes, wide).body() for name, part in parts.items()}
    if any("@malloc(" in body for body in bodies.values()):
        text.append(DECLARED)
    widths = {int(lanes) for body in bodies.values() for lanes in findall(rf"@{FMA}\.(\d+)\(", body)}
    text += [fma_definition(width, native=machine.fuses()) for width in sorted({1, *widths} if widths else widths)]
    intervals = interval_definitions(bodies.values())
    used = {name: count_calls(body) for name, body in (bodies | {INTERVALS: intervals}).items()}
    sizes = {name: _size_of(name, lanes, math_functions) for counts in used.values() for name in counts}
    inner = {name: sizes[name] * n <= INLINED // 2 for name, n in sum(used.values(), Counter[str]()).items()}
    text += [definitions(inner, lanes, math_functions), intervals]
    for name, part in parts.items():
        calls = sum(_call_count(caller, name) for caller in parts.values())
        weight = line_count(part.body) + sum(sizes[function] * count for function, count in used[name].items())
        attributes = "#2" if weight * calls <= INLINED else "#0"
        text += [_table_constant(name, *table) for table in part.tables.items()]
        text.append(f"define internal void @{name}.inner({_SIGNATURE}) {attributes} {{\nentry:\n{bodies[name]}\n}}")
        if entered is None or name in entered:
            text.append(_entry_function(name))
    # "prefer-vector-width": without it 16 lanes are split into vectors of 256 bits where 512 are available
    # "stackrealign": what registers do not hold is kept on the stack, and a vector of 64 bytes there would cross two lines
    # of the cache each time that it is written or read
    kinds = 'nounwind "prefer-vector-width"="512"' + (' alignstack=64 "stackrealign"' if lanes > 1 else "")
    text.append(f"attributes #0 = {{ {kinds} }}")
    text.append(f"attributes #2 = {{ alwaysinline {kinds} }}")
    return "\n".join(part for part in text if part) + "\n"


def _has_orders(program: Program) -> bool:
    """Whether a program has a loop over the orders of series: unrolled by LLVM, its many short ones take six times as long."""
    return any(isinstance(line, Loop) and line.index == ORDER for line in program.body)


def _size_of(name: str, lanes: int, math_functions: str) -> int:
    return definition(name, lanes, math_functions)[0].count("\n")


def _call_count(program: Program, name: str) -> int:
    lines = (line.call if isinstance(line, When | While) else line for line in program.body)
    return sum(isinstance(line, ProgramCall) and line.program == name for line in lines)


def _table_constant(program: str, name: str, numbers: tuple[int, ...]) -> str:
    entries = ", ".join(f"i64 {number}" for number in numbers)
    return f"@{program}.{name} = internal constant [{len(numbers)} x i64] [{entries}]"


def _entry_function(name: str) -> str:
    """Print the entry point from outside, which reads from the table what its caller does not pass."""
    lines = []
    for array in (*ARRAYS, "apart"):
        if array in _GIVEN:
            continue
        # for rows of the log, the length of the last dimension: the distance between their elements
        word_index = WORDS * TABLE.index(array) if array in ARRAYS else WORDS * TABLE.index("rows") + 2
        kind = "ptr" if array in ARRAYS else "i64"
        lines.append(f"%{array}_at = getelementptr i64, ptr %table, i64 {word_index}")
        lines.append(f"%_{array} = load {kind}, ptr %{array}_at, align 8, !invariant.load !0")
    parameters = ", ".join(f"ptr noalias %_{array}" for array in _GIVEN)
    body = "\n  ".join(lines)
    arrays = ", ".join(f"ptr %_{array}" for array in ARRAYS)
    return (
        f"define void @{name}(ptr %table, {parameters}) #0 {{\n  {body}\n"
        f"  call void @{name}.inner({arrays}, i64 %_apart)\n  ret void\n}}"
    )
