"""What the lines of a program read and write, part by part of its arrays, with those of programs that it calls."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from xdynamics.kernels.program import (
    Compute,
    Gather,
    Instruction,
    Load,
    Loop,
    Ordinal,
    Place,
    Program,
    ProgramCall,
    Reduction,
    StoreTo,
    nested,
)

Part = tuple[str, int, int]  # of an array: its name, the first element, the one after the last
Spans = dict[str, tuple[str, int]]  # by name: in which array it stands, and from which element on


@dataclass(frozen=True)
class LineEffect:
    """What a line reads and writes, by the names that it has for arrays.

    Attributes
    ----------
    reads, writes : tuple of Part
    whole : bool
        Whether every element of what it writes is written.
    copies : bool
        Whether what it writes is what it reads, element by element.
    """

    reads: tuple[Part, ...]
    writes: tuple[Part, ...]
    whole: bool
    copies: bool


def effects_of(
    body: Sequence[Instruction], others: Mapping[str, Program], names: Mapping[str, Part | None]
) -> list[LineEffect] | None:
    """Return what each line does, with those of programs that are called; None where a line may do more.

    `names` has where arrays of a called program stand, None for those that nobody else sees.
    """
    found: list[LineEffect] = []
    for line in body:
        if isinstance(line, ProgramCall):
            called = others.get(line.program)
            if called is None or names:
                return None
            given: dict[str, Part | None] = {
                "at": (line.at, 0, 0),
                "y": (line.y, 0, 0),
                "z": (line.z, 0, 0),
                "e": (line.e, 0, 0),
            }
            inner = dict.fromkeys(called.local) | given
            for name, (array, first, _) in called.views.items():
                known = inner.get(array, (array, 0, 0))
                inner[name] = known and (known[0], known[1] + first, 0)
            effects = effects_of(called.body, {}, inner)
            if effects is None:
                return None
            found += effects
        elif isinstance(line, Load | StoreTo | Loop | Reduction):
            found.append(effect_of(line, names))
        elif not isinstance(line, Compute | Gather | Ordinal):
            return None
    return found


def effect_of(line: Instruction, names: Mapping[str, Part | None]) -> LineEffect:
    """Return what one line reads and writes."""
    lines = list(nested((line,)))
    counts = {inner.index: inner.count for inner in lines if isinstance(inner, Loop | Reduction)}
    reads = [part for inner in lines if isinstance(inner, Load) for part in parts_of(inner.place, counts, names)]
    stores = [inner for inner in lines if isinstance(inner, StoreTo)]
    writes = [part for store in stores for part in parts_of(store.place, counts, names)]
    bounded = any(isinstance(inner, Reduction) and (inner.below or inner.above) for inner in lines)
    whole = not bounded and all(_is_whole(store.place, counts) for store in stores)
    return LineEffect(tuple(reads), tuple(writes), whole, _is_copy(line) and len(reads) == len(writes) == 1)


def _is_copy(line: Instruction) -> bool:
    """Whether a loop copies neighbouring elements."""
    match line:
        case Loop(index, _, (Load(value, source), StoreTo(target, stored))) if stored == value:
            return source.strides == target.strides == ((index, 1),)
    return False


def parts_of(place: Place, counts: Mapping[str, int], names: Mapping[str, Part | None]) -> Iterator[Part]:
    """Yield the part of an array in which a place is, for all values of its indices."""
    known = names.get(place.array, (place.array, 0, 0))
    if known is None:
        return
    name, first, _ = known
    if any(index not in counts for index, _ in place.strides):  # a gathered one: anywhere
        yield name, -1, -1
        return
    ends = [stride * (counts[index] - 1) for index, stride in place.strides]
    low = first + place.offset + sum(end for end in ends if end < 0)
    high = first + place.offset + sum(end for end in ends if end > 0)
    yield name, low, high + 1


def _is_whole(place: Place, counts: Mapping[str, int]) -> bool:
    """Whether a place is every element between its first and its last."""
    return not place.strides or (
        len(place.strides) == 1 and place.strides[0][1] == 1 and counts.get(place.strides[0][0], 0) > 0
    )


def spans_of(program: Program, sizes: Mapping[str, int]) -> Spans:
    """Return where every array stands that has a known length."""
    own: Spans = {name: (name, 0) for name in (*sizes, *program.local)}
    return own | {name: (array, first) for name, (array, first, _) in program.views.items() if array in own}


def root_of(part: Part, spans: Spans) -> tuple[str, int]:
    """Return the array in which a part stands, and its first element there."""
    array, first = spans.get(part[0], (part[0], 0))
    return array, first + part[1]
