"""What the lines of a program read and write, part by part of its arrays, with those of programs that it calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from xdynamics.kernels.program import (
    Compute,
    Gather,
    Instruction,
    Load,
    Location,
    Loop,
    Ordinal,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    nested_lines,
)

Part = tuple[str, int, int]  # of an array: its name, the first element, the one after the last
Spans = dict[str, tuple[str, int]]  # by name: in which array it stands, and from which element on


@dataclass(frozen=True)
class LineEffect:
    """What a line reads and writes, by the names that it has for arrays.

    Attributes
    ----------
    reads, writes : tuple of Part
    is_complete : bool
        Whether every element of what it writes is written.
    copies : bool
        Whether what it writes is what it reads, element by element.
    """

    reads: tuple[Part, ...]
    writes: tuple[Part, ...]
    is_complete: bool
    copies: bool


def effects_of(
    body: Sequence[Instruction], callees: Mapping[str, Program], names: Mapping[str, Part | None]
) -> list[LineEffect] | None:
    """Return what each line does, with those of programs that are called; None where a line may do more.

    `names` has where arrays of a called program stand, None for those that nobody else sees.
    """
    line_effects: list[LineEffect] = []
    for line in body:
        if isinstance(line, ProgramCall):
            callee = callees.get(line.program)
            if callee is None or names:
                return None
            passed_arrays: dict[str, Part | None] = {
                "at": (line.at, 0, 0),
                "y": (line.y, 0, 0),
                "z": (line.z, 0, 0),
                "e": (line.e, 0, 0),
            }
            inner = dict.fromkeys(callee.local) | passed_arrays
            for name, (array, first, _) in callee.views.items():
                inner_part = inner.get(array, (array, 0, 0))
                inner[name] = inner_part and (inner_part[0], inner_part[1] + first, 0)
            effects = effects_of(callee.body, {}, inner)
            if effects is None:
                return None
            line_effects += effects
        elif isinstance(line, Load | StoreTo | Loop | Reduction):
            line_effects.append(line_effect_of(line, names))
        elif not isinstance(line, Compute | Gather | Ordinal):
            return None
    return line_effects


def line_effect_of(line: Instruction, names: Mapping[str, Part | None]) -> LineEffect:
    """Return what one line reads and writes."""
    lines = list(nested_lines((line,)))
    counts = {inner.index: inner.count for inner in lines if isinstance(inner, Loop | Reduction)}
    reads = [
        part for inner in lines if isinstance(inner, Load) for part in location_parts(inner.location, counts, names)
    ]
    stores = [inner for inner in lines if isinstance(inner, StoreTo)]
    writes = [part for store in stores for part in location_parts(store.location, counts, names)]
    bounded = any(isinstance(inner, Reduction) and (inner.below or inner.above) for inner in lines)
    is_complete = not bounded and all(_is_contiguous(store.location, counts) for store in stores)
    return LineEffect(tuple(reads), tuple(writes), is_complete, _is_copy(line) and len(reads) == len(writes) == 1)


def _is_copy(line: Instruction) -> bool:
    """Whether a loop copies neighbouring elements."""
    match line:
        case Loop(index, _, (Load(value, source), StoreTo(target, stored))) if stored == value:
            return source.strides == target.strides == ((index, 1),)
    return False


def location_parts(location: Location, counts: Mapping[str, int], names: Mapping[str, Part | None]) -> Iterator[Part]:
    """Yield the part of an array in which a place is, for all values of its indices."""
    array_part = names.get(location.array, (location.array, 0, 0))
    if array_part is None:
        return
    name, first, _ = array_part
    if any(index not in counts for index, _ in location.strides):  # a gathered one: anywhere
        yield name, -1, -1
        return
    ends = [stride * (counts[index] - 1) for index, stride in location.strides]
    low = first + location.offset + sum(end for end in ends if end < 0)
    high = first + location.offset + sum(end for end in ends if end > 0)
    yield name, low, high + 1


def _is_contiguous(location: Location, counts: Mapping[str, int]) -> bool:
    """Whether a place is every element between its first and its last."""
    return not location.strides or (
        len(location.strides) == 1 and location.strides[0][1] == 1 and counts.get(location.strides[0][0], 0) > 0
    )


def spans_of(program: Program, sizes: Mapping[str, int]) -> Spans:
    """Return where every array stands that has a known length."""
    known_arrays: Spans = {name: (name, 0) for name in (*sizes, *program.local)}
    return known_arrays | {
        name: (array, first) for name, (array, first, _) in program.views.items() if array in known_arrays
    }


def part_root(part: Part, spans: Spans) -> tuple[str, int]:
    """Return the array in which a part stands, and its first element there."""
    array, first = spans.get(part[0], (part[0], 0))
    return array, first + part[1]
