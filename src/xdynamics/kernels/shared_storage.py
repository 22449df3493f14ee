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

from xdynamics.kernels.array_effects import LineEffect, Part, effects_of, parts_of, spans_of
from xdynamics.kernels.program import Load, Loop, Program, ProgramCall, Reduction, StoreTo

SHARED = "shared"  # the array in which others stand
APART = "_results"  # what follows the name of an array in that of its results
RESULTS = ("z", "e")  # given arrays that a program writes last

Times = list[tuple[int, LineEffect]]  # what is read and written, with the number of the line, a call being one


@dataclass(frozen=True)
class _Held:
    """Elements of an array that hold something from one line to another, both included."""

    low: int
    high: int
    first: int
    last: float


def with_shared_storage(
    program: Program, others: Mapping[str, Program], lengths: Mapping[str, int], least: int
) -> Program:
    """Return a program whose large arrays stand in one, or in its results, as long as they are read; with the same numbers.

    Parameters
    ----------
    program : Program
    others : mapping of str to Program
        Those that it calls.
    lengths : mapping of str to int
        Of given arrays that results go to.
    least : int
        Numbers above which an array is large. Others stay on the stack.
    """
    large = {name: count for name, count in program.local.items() if count > least}
    if not large or program.spread or _times(program, others) is None:
        return program
    program = _with_results_apart(program, others, large)
    large = {name: count for name, count in program.local.items() if count > least}
    times = _times(program, others)
    assert times is not None  # noqa: S101 - the same lines as before
    sizes = {**{name: lengths[name] for name in RESULTS}, **large}
    touched = _touched(times, program, sizes)
    held = {name: list(_held(touched[name], sizes[name], is_result=name in RESULTS)) for name in sizes}
    places, count = _placed(held, sizes)
    views = {
        name: (places[array][0], places[array][1] + first, number) if array in places else (array, first, number)
        for name, (array, first, number) in program.views.items()
    }
    views |= {name: (*place, large[name]) for name, place in places.items()}
    local = {name: number for name, number in program.local.items() if name not in places}
    return replace(program, views=views, local=local | {SHARED: count} if count else local)


def _times(program: Program, others: Mapping[str, Program]) -> Times | None:
    """Return what lines do; of a call all at one time, as the called program is told that its arrays lie apart."""
    times: Times = []
    for number, line in enumerate(program.body):
        effects = effects_of((line,), others, {})
        if effects is None:
            return None
        times += [(number, effect) for effect in effects]
    return times


# --------------------------------------------------------------------------------- what forces read, and what they give


def _with_results_apart(program: Program, others: Mapping[str, Program], large: Iterable[str]) -> Program:
    """Return a program in which what a call reads and what it writes are two arrays, so that they need not be neighbours."""
    named = list(_named(program))
    begins: dict[str, int] = {}
    for line in program.body:
        if isinstance(line, ProgramCall) and line.y == line.z and line.y in large:
            begin = _first_result(line, others)
            if begin is not None and not any(array == line.y and low < begin < high for array, low, high in named):
                begins[line.y] = begin
    return _divided(program, begins) if begins else program


def _first_result(line: ProgramCall, others: Mapping[str, Program]) -> int | None:
    """Return the first element that a call writes, if it reads none of its state from there on; None if it may."""
    effects = effects_of((replace(line, z=""),), others, {}) or []
    parts = [part for effect in effects for part in (*effect.reads, *effect.writes)]
    given, results = ([part for part in parts if part[0] == name] for name in (line.y, ""))
    if not results or any(low < 0 for _, low, _ in (*given, *results)):
        return None
    begin = min(low for _, low, _ in results)
    return begin if all(high <= begin for *_, high in given) else None


def _named(program: Program) -> Iterator[Part]:
    """Yield every part that a line names itself, and every view."""
    for line in program.body:
        yield from (part for effect in effects_of((line,), {}, {}) or [] for part in (*effect.reads, *effect.writes))
    for array, first, count in program.views.values():
        yield array, first, first + count


def _divided(program: Program, begins: Mapping[str, int]) -> Program:
    """Give the elements of arrays from one on names of their own, of arrays of the same lengths."""

    def name(array: str, first: int) -> str:
        return f"{array}{APART}" if first >= begins.get(array, first + 1) else array

    def line(of: Any, counts: Mapping[str, int]) -> Any:
        match of:
            case Load() | StoreTo() if of.place.array in begins:
                array, low, _ = next(parts_of(of.place, counts, {}))
                return replace(of, place=replace(of.place, array=name(array, low)))
            case Loop() | Reduction():
                body = tuple(line(part, {**counts, of.index: of.count}) for part in of.body)
                if isinstance(of, Reduction):
                    return replace(of, body=body)
                return replace(of, body=body, own=of.own | {f"{array}{APART}" for array in of.own & {*begins}})
            case ProgramCall() if of.z in begins:
                return replace(of, z=f"{of.z}{APART}")
        return of

    views = {key: (name(array, first), first, count) for key, (array, first, count) in program.views.items()}
    local = {**program.local, **{f"{array}{APART}": program.local[array] for array in begins}}
    return replace(program, body=tuple(line(of, {}) for of in program.body), views=views, local=local)


# ------------------------------------------------------------------------------------------------- how long, and where


def _touched(times: Times, program: Program, sizes: Mapping[str, int]) -> dict[str, list[tuple[int, int, int, bool]]]:
    """Return, array by array, the first element that a line names and the one after the last, when, and if all are set."""
    spans = spans_of(program, sizes)
    touched: dict[str, list[tuple[int, int, int, bool]]] = {name: [] for name in sizes}
    for number, effect in times:
        for parts, is_whole in ((effect.reads, False), (effect.writes, effect.whole)):
            for part, low, high in parts:
                array, first = spans.get(part, ("", 0))
                if array in touched:
                    ends = (0, sizes[array]) if low < 0 else (first + low, first + high)
                    touched[array].append((*ends, number, is_whole and low >= 0))
    return touched


def _held(touched: Sequence[tuple[int, int, int, bool]], size: int, *, is_result: bool) -> Iterator[_Held]:
    """Yield which elements of an array hold something, and how long: results to the end, from where all are set."""
    cuts = sorted({0, size, *(cut for low, high, *_ in touched for cut in (low, high))})
    for low, high in pairwise(cuts):
        lines = [(when, whole) for begin, end, when, whole in touched if begin <= low and high <= end]
        if is_result:
            yield _Held(low, high, lines[0][0] if lines and lines[0][1] else 0, inf)
        elif lines:
            yield _Held(low, high, lines[0][0], lines[-1][0])


def _placed(held: Mapping[str, Sequence[_Held]], sizes: Mapping[str, int]) -> tuple[dict[str, tuple[str, int]], int]:
    """Return where each array stands, in a result or in the shared one, and how many numbers that has.

    Arrays come in the order of their lines, each to where the shared one grows least; of places alike to the first.
    """
    full = {name: list(held[name]) for name in RESULTS} | {SHARED: []}
    places: dict[str, tuple[str, int]] = {}
    begin = end = 0
    own = [name for name in held if name not in RESULTS and held[name]]
    for name in sorted(own, key=lambda name: min(part.first for part in held[name])):
        parts = held[name]
        reach = max(part.high for part in parts)
        options = [
            (0, at, result)
            for result in RESULTS
            for at in _free(parts, full[result])
            if 0 <= at <= sizes[result] - reach
        ]
        for at in _free(parts, full[SHARED]):
            growth = max(end, at + reach) - min(begin, at) - (end - begin)
            options.append((growth, at, SHARED))
        _, at, array = min(options)
        if array == SHARED:
            begin, end = min(begin, at), max(end, at + reach)
        places[name] = array, at
        full[array] += [replace(part, low=part.low + at, high=part.high + at) for part in parts]
    return {name: (array, at - begin if array == SHARED else at) for name, (array, at) in places.items()}, end - begin


def _free(parts: Sequence[_Held], full: Sequence[_Held]) -> Iterator[int]:
    """Yield the ends of ranges of places that an array may have beside others that stand already."""
    taken = sorted(
        (other.low - part.high, other.high - part.low)
        for part in parts
        for other in full
        if part.first <= other.last and other.first <= part.last
    )
    if not taken:
        yield 0
        return
    yield taken[0][0]
    reach = taken[0][1]
    for low, high in taken[1:]:
        if low >= reach:
            yield from (reach, low)
        reach = max(reach, high)
    yield reach
