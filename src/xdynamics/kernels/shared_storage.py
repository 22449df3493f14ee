"""Large arrays of a program that share memory: where one is read for the last time, another one may begin.

A state at which a method evaluates forces is a position, a velocity, an acceleration and a force for each coordinate, of
which later stages read the velocity and the acceleration alone, and not of every stage. So the position of the next one
stands where the force of the last one was, and what is read no more makes room, as registers of a compiler do. The new
state and its error are written last: until then stages may stand there, too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import inf
from typing import Any

from xdynamics.kernels.array_effects import LineEffect, Part, effects_of, location_parts, spans_of
from xdynamics.kernels.program import Load, Loop, Program, ProgramCall, Reduction, StoreTo

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
    """Return a program whose large arrays stand in one, or in its results, as long as they are read; with the same numbers.

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
    """Return what lines do; of a call all at one time, as the called program is told that its arrays lie apart."""
    times: Times = []
    for number, line in enumerate(program.body):
        effects = effects_of((line,), callees, {})
        if effects is None:
            return None
        times += [(number, effect) for effect in effects]
    return times


# --------------------------------------------------------------------------------- what forces read, and what they give


def _separate_results(program: Program, callees: Mapping[str, Program], large: Iterable[str]) -> Program:
    """Return a program in which what a call reads and what it writes are two arrays, so that they need not be neighbours."""
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
    """Give the elements of arrays from one on names of their own, of arrays of the same lengths."""

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
