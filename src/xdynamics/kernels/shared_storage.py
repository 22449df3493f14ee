"""Storage of a program's large arrays: shared memory, copies that are saved, and allocation on the heap.

Where an array is read for the last time, another one may begin. A state at which a method evaluates forces is a
position, a velocity, an acceleration and a force for each coordinate, of which later stages read the velocity and the
acceleration alone, and not of every stage. So the position of the next one stands where the force of the last one was,
and what is read no more makes room, as registers of a compiler do. The new state and its error are written last: until
then stages may stand there, too.

What the lines of a program read and write is listed part by part of its arrays, with those of programs that it calls.

Some copies of vectors are saved in machine code: a vector stands where its copy goes, if no line tells the difference.
The lines of a method give every vector a name of its own, and the last of them copy some to the new state. As text that
is what a reader wants; for large models a step is as fast as its numbers come from memory, and half of them were
copies.

Large arrays are on the heap. A program cannot raise: one that was given no memory calls a function of this module, and
returns as if a number were missing. It is called on the thread on which the program runs, so what it notes belongs to
one call of compiled code.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import Any

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
    """The reads and writes of a line, by its names of arrays.

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
    """Return the effects of each line, with those of called programs; None where a line may have others.

    `names` has where arrays of a called program stand, None for those that nobody else sees.
    """
    line_effects: list[LineEffect] = []
    for line in body:
        if isinstance(line, ProgramCall):
            callee = callees.get(line.program)
            # with names, the line is one of a called program, whose own calls are not followed
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
    """Return the reads and writes of one line."""
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
    """Yield the part of an array that a location covers, for all values of its indices."""
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
    """Whether a location covers every element between its first and its last."""
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


Link = tuple[str, int, str, int, int]  # two arrays with the first elements of parts alike, and how many there are


def coalesce_copies(program: Program, callees: Mapping[str, Program], lengths: Mapping[str, int]) -> Program:
    """Return a program with fewer copies and unchanged results.

    Parameters
    ----------
    program : Program
    callees : mapping of str to Program
        Those that it may call.
    lengths : mapping of str to int
        Of given arrays that results go to, and of `y`. None of them overlap.
    """
    effects = effects_of(program.body, callees, {})
    if effects is None or program.spread:
        return program
    current, sizes = program, {**lengths, **program.local}
    for effect in effects:
        if not effect.copies:
            continue
        spans = spans_of(current, sizes)
        (source, first), (target, begin) = (part_root(part, spans) for part in (*effect.reads, *effect.writes))
        # `y` is the caller's, and is not written to
        if source not in current.local or target not in sizes or target in (source, "y"):
            continue
        distance, size = begin - first, current.local[source]
        if distance < 0 or distance + size > sizes[target]:
            continue
        # lines that know neither of the two find what they found
        pair = {name: sizes[name] for name in (source, target)}
        parts = [
            (number, line)
            for number, line in enumerate(effects)
            if any(part[0] in spans and spans[part[0]][0] in pair for part in (*line.reads, *line.writes))
        ]
        candidate, link = _merge_array(current, source, target, distance), (source, 0, target, distance, size)
        seen = [
            _contents_read(
                parts, {name: span for name, span in spans_of(version, sizes).items() if span[0] in pair}, pair, link
            )
            for version in (current, candidate)
        ]
        if seen[0] == seen[1]:
            current = candidate
    spans = spans_of(current, sizes)
    body = tuple(line for line in current.body if not _is_idle(line, spans))
    return replace(current, body=body)


def _merge_array(program: Program, source: str, target: str, distance: int) -> Program:
    """Make a local array a part of another one."""
    views = {
        name: (target, first + distance, count) if array == source else (array, first, count)
        for name, (array, first, count) in program.views.items()
    }
    views[source] = (target, distance, program.local[source])
    return replace(program, views=views, local={name: n for name, n in program.local.items() if name != source})


def _is_idle(line: Instruction, spans: Spans) -> bool:
    """Whether a line copies a vector to where it stands."""
    effect = line_effect_of(line, {}) if isinstance(line, Loop) else None
    return (
        effect is not None and effect.copies and part_root(effect.reads[0], spans) == part_root(effect.writes[0], spans)
    )


# ------------------------------------------------------------------------------------------ what its lines find there


def _contents_read(
    effects: Sequence[tuple[int, LineEffect]], spans: Spans, sizes: Mapping[str, int], link: Link
) -> list[Any]:
    """Return the writer of every value that each line reads, and the writers of the final contents.

    Two programs of the same lines that find the same everywhere compute the same, wherever their arrays stand. A line
    that reads where it writes by another name is noted, too: its passes may not be made in any order.
    """
    cuts = _cuts(effects, spans, sizes, link)
    contents: dict[tuple[str, int], Any] = {}
    values_found: list[Any] = []

    def atoms(part: Part) -> list[tuple[str, int, int]]:
        """Return array, first element, and the same from the beginning of the part's name, piece by piece."""
        if part[0] not in spans:
            return []
        array, first = spans[part[0]]
        low, high = (0, sizes[array]) if part[1] < 0 else (first + part[1], first + part[2])
        return [(array, cut, cut - first) for cut in cuts[array][:-1] if low <= cut < high]

    for number, effect in effects:
        read = [(array, cut) for part in effect.reads for array, cut, _ in atoms(part)]
        values = [contents.get(atom, atom) for atom in read]
        values_found.append(values)
        written_values: list[tuple[tuple[str, int], Any]] = [
            (atom[:2], (number, part[0], atom[2])) for part in effect.writes for atom in atoms(part)
        ]
        crossing = _overlapping_names(effect, atoms)
        if crossing:
            values_found.append(crossing)
        if effect.copies and len(written_values) == len(values):
            written_values = [(atom, value) for (atom, _), value in zip(written_values, values, strict=True)]
        elif not effect.is_complete:
            # elements between may have kept what they held, so that is part of what is found there
            written_values = [(atom, (value, contents.get(atom, atom))) for atom, value in written_values]
        contents.update(written_values)
    results = [name for name in sizes if spans.get(name) == (name, 0) and name in ("z", "e")]
    return [
        values_found,
        [(cut, contents.get((name, cut), (name, cut))) for name in results for cut in cuts[name][:-1]],
    ]


def _overlapping_names(effect: LineEffect, atoms: Any) -> list[tuple[str, str]]:
    """Return pairs of names by which a line reads and writes, or writes twice, common elements."""
    places = [(part[0], {atom[:2] for atom in atoms(part)}) for part in effect.writes]
    read_names = [(part[0], {atom[:2] for atom in atoms(part)}) for part in effect.reads]
    return [
        (name, second_name)
        for i, (name, elements) in enumerate(places)
        for second_name, second_elements in (*read_names, *places[:i])
        if elements & second_elements and not (effect.copies and elements == second_elements)
    ]


def _cuts(
    effects: Sequence[tuple[int, LineEffect]], spans: Spans, sizes: Mapping[str, int], link: Link
) -> dict[str, list[int]]:
    """Return the elements at which parts of arrays begin or end, those of copies wherever their originals have one.

    `link` is of two arrays that may become one.
    """
    cuts: dict[str, set[int]] = {name: {0, size} for name, size in sizes.items()}
    links = [link]
    for _, effect in effects:
        known_parts = [part for part in (*effect.reads, *effect.writes) if part[0] in spans]
        for name, low, high in known_parts:
            if low >= 0:
                array, first = spans[name]
                cuts[array] |= {first + low, first + high}
        if effect.copies and len(known_parts) == 2:
            (source, begin), (target, end) = (part_root(part, spans) for part in known_parts)
            links.append((source, begin, target, end, known_parts[0][2] - known_parts[0][1]))
    changed = True
    # a cut may go on through copies of copies
    while changed:
        changed = False
        for source, begin, target, end, count in links:
            for first_array, first, second_array, second in (
                (source, begin, target, end),
                (target, end, source, begin),
            ):
                new = {cut - first + second for cut in cuts[first_array] if first <= cut <= first + count} - cuts[
                    second_array
                ]
                cuts[second_array] |= new
                changed |= bool(new)
    return {name: sorted(array_cuts) for name, array_cuts in cuts.items()}


SHARED = "shared"  # the array in which others stand
APART = "_results"  # what follows the name of an array in that of its results
RESULTS = ("z", "e")  # given arrays that a program writes last

Times = list[tuple[int, LineEffect]]  # what is read and written, with the number of the line, a call being one


@dataclass(frozen=True)
class _Lifetime:
    """Elements of an array that hold something from one line to another, both included."""

    low: int
    high: int
    first: int
    last: float


def with_shared_storage(
    program: Program, callees: Mapping[str, Program], lengths: Mapping[str, int], threshold: int
) -> Program:
    """Return a program whose large arrays share storage, or use its results, while they are read.

    Parameters
    ----------
    program : Program
    callees : mapping of str to Program
        Those that it calls.
    lengths : mapping of str to int
        Of given arrays that results go to.
    threshold : int
        Numbers above which an array is large. Others stay on the stack.
    """
    large = {name: count for name, count in program.local.items() if count > threshold}
    if not large or program.spread or _timed_effects(program, callees) is None:
        return program
    program = _separate_results(program, callees, large)
    large = {name: count for name, count in program.local.items() if count > threshold}
    times = _timed_effects(program, callees)
    assert times is not None  # noqa: S101 - the same lines as before
    sizes = {**{name: lengths[name] for name in RESULTS}, **large}
    touched = _touched(times, program, sizes)
    lifetimes = {name: list(_lifetimes(touched[name], sizes[name], is_result=name in RESULTS)) for name in sizes}
    places, count = _place_arrays(lifetimes, sizes)
    views = {
        name: (places[array][0], places[array][1] + first, number) if array in places else (array, first, number)
        for name, (array, first, number) in program.views.items()
    }
    views |= {name: (*array_start, large[name]) for name, array_start in places.items()}
    local = {name: number for name, number in program.local.items() if name not in places}
    return replace(program, views=views, local=local | {SHARED: count} if count else local)


def _timed_effects(program: Program, callees: Mapping[str, Program]) -> Times | None:
    """Return effects by line; those of a call have one time, as the callee is told that its arrays do not overlap."""
    times: Times = []
    for number, line in enumerate(program.body):
        effects = effects_of((line,), callees, {})
        if effects is None:
            return None
        times += [(number, effect) for effect in effects]
    return times


# --------------------------------------------------------------------------------- what forces read, and what they give


def _separate_results(program: Program, callees: Mapping[str, Program], large: Iterable[str]) -> Program:
    """Return a program in which reads and writes of a call are two arrays, which need not be adjacent."""
    named_parts = list(_named_parts(program))
    begins: dict[str, int] = {}
    for line in program.body:
        if isinstance(line, ProgramCall) and line.y == line.z and line.y in large:
            begin = _first_result(line, callees)
            if begin is not None and not any(
                array == line.y and low < begin < high for array, low, high in named_parts
            ):
                begins[line.y] = begin
    return _split_arrays(program, begins) if begins else program


def _first_result(line: ProgramCall, callees: Mapping[str, Program]) -> int | None:
    """Return the first element that a call writes, if it reads none of its state from there on; None if it may."""
    effects = effects_of((replace(line, z=""),), callees, {}) or []
    parts = [part for effect in effects for part in (*effect.reads, *effect.writes)]
    state_parts, results = ([part for part in parts if part[0] == name] for name in (line.y, ""))
    if not results or any(low < 0 for _, low, _ in (*state_parts, *results)):
        return None
    begin = min(low for _, low, _ in results)
    return begin if all(high <= begin for *_, high in state_parts) else None


def _named_parts(program: Program) -> Iterator[Part]:
    """Yield every part that a line names itself, and every view."""
    for line in program.body:
        yield from (part for effect in effects_of((line,), {}, {}) or [] for part in (*effect.reads, *effect.writes))
    for array, first, count in program.views.values():
        yield array, first, first + count


def _split_arrays(program: Program, begins: Mapping[str, int]) -> Program:
    """Name the elements of arrays from a given one on as arrays of their own, with unchanged lengths."""

    def array_name(array: str, first: int) -> str:
        return f"{array}{APART}" if first >= begins.get(array, first + 1) else array

    def split_line(instruction: Any, counts: Mapping[str, int]) -> Any:
        match instruction:
            case Load() | StoreTo() if instruction.location.array in begins:
                array, low, _ = next(location_parts(instruction.location, counts, {}))
                return replace(instruction, location=replace(instruction.location, array=array_name(array, low)))
            case Loop() | Reduction():
                body = tuple(
                    split_line(part, {**counts, instruction.index: instruction.count}) for part in instruction.body
                )
                if isinstance(instruction, Reduction):
                    return replace(instruction, body=body)
                return replace(
                    instruction,
                    body=body,
                    exclusive_arrays=instruction.exclusive_arrays
                    | {f"{array}{APART}" for array in instruction.exclusive_arrays & {*begins}},
                )
            case ProgramCall() if instruction.z in begins:
                return replace(instruction, z=f"{instruction.z}{APART}")
        return instruction

    views = {key: (array_name(array, first), first, count) for key, (array, first, count) in program.views.items()}
    local = {**program.local, **{f"{array}{APART}": program.local[array] for array in begins}}
    return replace(
        program, body=tuple(split_line(instruction, {}) for instruction in program.body), views=views, local=local
    )


# ------------------------------------------------------------------------------------------------- how long, and where


def _touched(times: Times, program: Program, sizes: Mapping[str, int]) -> dict[str, list[tuple[int, int, int, bool]]]:
    """Return, array by array, the first element that a line names and the one after the last, when, and if all are set."""
    spans = spans_of(program, sizes)
    touched: dict[str, list[tuple[int, int, int, bool]]] = {name: [] for name in sizes}
    for number, effect in times:
        for parts, is_whole in ((effect.reads, False), (effect.writes, effect.is_complete)):
            for part, low, high in parts:
                array, first = spans.get(part, ("", 0))
                if array in touched:
                    ends = (0, sizes[array]) if low < 0 else (first + low, first + high)
                    touched[array].append((*ends, number, is_whole and low >= 0))
    return touched


def _lifetimes(touched: Sequence[tuple[int, int, int, bool]], size: int, *, is_result: bool) -> Iterator[_Lifetime]:
    """Yield which elements of an array hold something, and how long: results to the end, from where all are set."""
    cuts = sorted({0, size, *(cut for low, high, *_ in touched for cut in (low, high))})
    for low, high in pairwise(cuts):
        lines = [(when, is_complete) for begin, end, when, is_complete in touched if begin <= low and high <= end]
        if is_result:
            yield _Lifetime(low, high, lines[0][0] if lines and lines[0][1] else 0, inf)
        elif lines:
            yield _Lifetime(low, high, lines[0][0], lines[-1][0])


def _place_arrays(
    lifetimes: Mapping[str, Sequence[_Lifetime]], sizes: Mapping[str, int]
) -> tuple[dict[str, tuple[str, int]], int]:
    """Return where each array stands, in a result or in the shared one, and how many numbers that has.

    Arrays come in the order of their lines, each to where the shared one grows least; of places alike to the first.
    """
    full = {name: list(lifetimes[name]) for name in RESULTS} | {SHARED: []}
    places: dict[str, tuple[str, int]] = {}
    begin = end = 0
    local_arrays = [name for name in lifetimes if name not in RESULTS and lifetimes[name]]
    for name in sorted(local_arrays, key=lambda name: min(part.first for part in lifetimes[name])):
        parts = lifetimes[name]
        reach = max(part.high for part in parts)
        options = [
            (0, start, result)
            for result in RESULTS
            for start in _free_starts(parts, full[result])
            if 0 <= start <= sizes[result] - reach
        ]
        for start in _free_starts(parts, full[SHARED]):
            growth = max(end, start + reach) - min(begin, start) - (end - begin)
            options.append((growth, start, SHARED))
        _, start, array = min(options)
        if array == SHARED:
            begin, end = min(begin, start), max(end, start + reach)
        places[name] = array, start
        full[array] += [replace(part, low=part.low + start, high=part.high + start) for part in parts]
    return {
        name: (array, start - begin if array == SHARED else start) for name, (array, start) in places.items()
    }, end - begin


def _free_starts(parts: Sequence[_Lifetime], full: Sequence[_Lifetime]) -> Iterator[int]:
    """Yield the ends of ranges of places that an array may have beside others that stand already."""
    blocked_ranges = sorted(
        (occupant.low - part.high, occupant.high - part.low)
        for part in parts
        for occupant in full
        if part.first <= occupant.last and occupant.first <= part.last
    )
    if not blocked_ranges:
        yield 0
        return
    yield blocked_ranges[0][0]
    reach = blocked_ranges[0][1]
    for low, high in blocked_ranges[1:]:
        if low >= reach:
            yield from (reach, low)
        reach = max(reach, high)
    yield reach


MOST_ON_STACK = 10_000  # numbers of an array; larger ones are on the heap
LACKING = "xdynamics_lacking"  # what a program calls that was given no memory
# noalias as a return attribute: no other pointer of the program reaches that memory
DECLARED = f"declare noalias ptr @malloc(i64)\ndeclare void @free(ptr)\ndeclare void @{LACKING}()"


class _Allocation(threading.local):
    """The state of allocations on one thread."""

    refused = False


_ALLOCATION = _Allocation()


@ctypes.CFUNCTYPE(None)
def note_refusal() -> None:
    """Record that a program was given no memory."""
    _ALLOCATION.refused = True


def forget_refusal() -> None:
    """Begin anew on this thread, before a call of compiled code."""
    _ALLOCATION.refused = False


def was_refused() -> bool:
    """Whether a program on this thread was given no memory since then."""
    return _ALLOCATION.refused


def refusal_lines(arrays: Sequence[str], unsound: str, lanes: int) -> list[str]:
    """Return the lines that check allocated arrays; without memory for one, the program reports it and returns nan.

    Parameters
    ----------
    arrays : sequence of str
        At least one, all asked for.
    unsound : str
        Where the number is that says whether results are finite, one for each lane.
    lanes : int
    """
    lines, any_lacks = [], "false"
    for k, name in enumerate(arrays):
        lines.append(f"%lacks{k} = icmp eq ptr %{name}, null")
        lines.append(f"%lack{k} = or i1 {any_lacks}, %lacks{k}")
        any_lacks = f"%lack{k}"
    lines += [f"br i1 {any_lacks}, label %lacking, label %given", "lacking:"]
    # free takes the null pointers among them, too
    lines += [f"call void @free(ptr %{name})" for name in arrays]
    lines.append(f"call void @{LACKING}()")
    for lane in range(lanes):
        lines.append(f"%lane{lane}.at = getelementptr double, ptr {unsound}, i64 {lane}")
        # nan, which LLVM's text spells in hexadecimal only
        lines.append(f"store double 0x7FF8000000000000, ptr %lane{lane}.at, align 8")
    return [*lines, "ret void"]
