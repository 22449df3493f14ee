"""The engine: the march, compiled once for all models and methods, and cached for the next process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError
from xdynamics.kernels.compiling import PLAINLY, keys_of
from xdynamics.kernels.engine_part import EnginePart
from xdynamics.kernels.entry_points import FLAG, FLOAT, INTEGER, NOTHING, Kind, array_kind, signature_of
from xdynamics.kernels.shared_storage import forget_refusal, was_refused
from xdynamics.march import engine_entries, loop, phases, step_parts
from xdynamics.march.assembly import holding
from xdynamics.march.events import enclosures
from xdynamics.march.lanes import gather_rows, march_lanes
from xdynamics.march.phases import phase_numbers, phases_of
from xdynamics.march.run import EVENT_ROW, NOW, PLAN
from xdynamics.march.step_parts import parts_of_steps, retrace

R = TypeVar("R")


class NoMemoryError(InputError):
    """An evaluation of a model was given no memory by the system."""

    def __init__(self, model: str = "the model", when: str = "") -> None:
        super().__init__(
            f"the system gave no memory for what one evaluation of {model} needs{when}: nothing of it is kept; march fewer"
            " elements, or fewer runs at a time, or give the process more memory (ulimit -v)"
        )


class Engine(NamedTuple):
    """The compiled entries, called with a run: `loop.march`, and those of `march.engine_entries`."""

    march: Callable[..., None]
    march_many: Callable[..., int]
    states_inside: Callable[..., None]
    fastest_rates: Callable[..., None]
    growths: Callable[..., None]
    rows_of_times: Callable[..., None]
    retrace: Callable[..., None]
    march_at: int  # where the compiled `loop.march` begins


class Lanes(NamedTuple):
    """The entries that march runs side by side."""

    march: Callable[..., bool]  # `lanes.march_lanes`, to be called with the runs
    gather: Callable[..., None]  # `lanes.gather_rows`
    parts: Callable[..., None]  # `step_parts.parts_of_steps`, to be called with a run


class Solvers(NamedTuple):
    """Addresses of the steps that are more than one program."""

    newton: int  # `engine_entries.step_by_newton`
    radau: int  # `engine_entries.step_by_radau`
    series: int  # `engine_entries.step_by_series`


_INT_ARRAY, _LISTS, _FLAGS = array_kind("i8", 1), array_kind("i8", 2), array_kind("i1", 2)
_ROW, _BLOCK = array_kind("f8", 1), array_kind("f8", 2)
_ROWS: tuple[Kind, ...] = (array_kind("f8", 3), array_kind("i1", 3), _LISTS)  # with their flags and owners
_STEP = signature_of(NOTHING, INTEGER, *[FLOAT] * 3, *[INTEGER] * 3)
_RUNS: tuple[Kind, ...] = (
    array_kind(PLAN, 1),
    *[_BLOCK] * 3,
    array_kind(NOW, 1),
    *[_BLOCK] * 3,
)  # from plans and starts to ends
_OF_LANES: tuple[Kind, ...] = (*[INTEGER] * 2, _INT_ARRAY)  # addresses of programs, and the table of their arrays
_MARCH_LANES = signature_of(
    FLAG,
    _INT_ARRAY,
    *_OF_LANES,
    *[_BLOCK] * 4,
    _LISTS,
    *[_BLOCK] * 2,
    *[_INT_ARRAY] * 2,
    *_RUNS,
    array_kind(EVENT_ROW, 1),
    *[_BLOCK] * 2,
    _INT_ARRAY,
    _BLOCK,
    _LISTS,
    *_ROWS,
    _ROW,
    _FLAGS,
)
_GATHER_ROWS = signature_of(NOTHING, *_ROWS, _LISTS, _INT_ARRAY, _BLOCK, _FLAGS)
_PARTS_OF_STEPS = signature_of(
    NOTHING,
    INTEGER,
    *_OF_LANES,
    *[_BLOCK] * 3,
    _LISTS,
    *[_BLOCK] * 2,
    _FLAGS,
    _BLOCK,
    _ROW,
    _LISTS,
    _ROW,
    _BLOCK,
    _INT_ARRAY,
    _BLOCK,
)

PARTS = ENGINE, SOLVERS, WATCHERS, CONTACTS, ASSEMBLIES, LANES = (
    EnginePart(
        "engine",
        "the engine",
        18,
        (
            (loop.march, signature_of(NOTHING, INTEGER, INTEGER)),
            (engine_entries.march_in_turn, signature_of(INTEGER, INTEGER, INTEGER, *_RUNS, INTEGER, FLAG)),
            (engine_entries.states_inside, signature_of(NOTHING, INTEGER, *[_BLOCK] * 4, _LISTS, _BLOCK, FLAG, FLAG)),
            (engine_entries.fastest_rates, signature_of(NOTHING, INTEGER, *[_BLOCK] * 2)),
            (engine_entries.follow_growths, signature_of(NOTHING, INTEGER, *[_BLOCK] * 4)),
            (step_parts.rows_of_times, signature_of(NOTHING, _ROW, *[_INT_ARRAY] * 2, _ROW, FLAG, _INT_ARRAY)),
            (retrace, signature_of(NOTHING, INTEGER, *[_BLOCK] * 2)),
        ),
    ),
    EnginePart(
        "solvers",
        "the solvers of implicit methods",
        13,
        (
            (engine_entries.step_by_newton, _STEP),
            (engine_entries.step_by_radau, _STEP),
            (engine_entries.step_by_series, _STEP),
        ),
    ),
    EnginePart(
        phases.WATCHERS,
        "the search for events",
        22,
        (
            (enclosures.enclose_between, signature_of(NOTHING, *[INTEGER] * 6)),
            *phases_of(phases.WATCHERS),
        ),
    ),
    EnginePart(phases.CONTACTS, "contacts and friction", 12, phases_of(phases.CONTACTS)),
    EnginePart(
        phases.ASSEMBLIES,
        "contacts of many bodies",
        38,
        (
            (holding.add_closed_link_forces, signature_of(NOTHING, INTEGER, FLOAT, INTEGER)),
            *phases_of(phases.ASSEMBLIES),
        ),
    ),
    EnginePart(
        "lanes",
        "marches side by side",
        11,
        ((march_lanes, _MARCH_LANES), (gather_rows, _GATHER_ROWS), (parts_of_steps, _PARTS_OF_STEPS)),
    ),
)


@lru_cache(maxsize=1)
def engine() -> Engine:
    """Return the engine, made or loaded at the first call."""
    if PLAINLY:
        return _plain_engine()
    march, march_many, states_inside, fastest_rates, growths, rows_of_times, retraced = ENGINE.entries()
    call = march.call
    return Engine(
        _raising_no_memory(lambda run, rows: call(run.address, rows)),
        _raising_no_memory(lambda run, *arguments: march_many(run.address, march.address, *arguments)),
        _raising_no_memory(lambda run, *arguments: states_inside(run.address, *arguments)),
        _raising_no_memory(lambda run, *arguments: fastest_rates(run.address, *arguments)),
        _raising_no_memory(lambda run, *arguments: growths(run.address, *arguments)),
        rows_of_times,
        _raising_no_memory(lambda run, *arguments: retraced(run.address, *arguments)),
        march.address,
    )


def _raising_no_memory(call: Callable[..., R]) -> Callable[..., R]:
    """Let a call of compiled code raise `NoMemoryError` where a program in it was given none."""

    def call_or_raise(*arguments: Any) -> R:
        forget_refusal()
        result = call(*arguments)
        if was_refused():
            raise NoMemoryError
        return result

    return call_or_raise


def _plain_engine() -> Engine:
    march_many = engine_entries.march_in_turn
    further_entries = (
        engine_entries.states_inside,
        engine_entries.fastest_rates,
        engine_entries.follow_growths,
        step_parts.rows_of_times,
        retrace,
    )
    return Engine(loop.march, lambda run, *arguments: march_many(run, loop.march, *arguments), *further_entries, 0)


@lru_cache(maxsize=1)
def solvers() -> Solvers:
    """Return the solvers of implicit methods, made or loaded at the first call."""
    return Solvers(*_part_addresses(SOLVERS))


@lru_cache(maxsize=1)
def enclosing_address() -> int:
    """Return the address of the code that encloses event functions, made or loaded at the first call."""
    return _part_addresses(WATCHERS)[0]


@lru_cache(maxsize=1)
def pressing_address() -> int:
    """Return the address of the code that finds forces of closed links, made or loaded at the first call."""
    return _part_addresses(ASSEMBLIES)[0]


@lru_cache(maxsize=8)
def phase_addresses(*parts: str) -> NDArray[np.int64]:
    """Return the address of each phase that some parts of the engine have, made or loaded at the first call; else 0."""
    numbers = phase_numbers()
    addresses = np.zeros(len(numbers), np.int64)
    for part in () if PLAINLY else (part for part in PARTS if part.name in parts):
        for (function, _), entry in zip(part.functions, part.entries(), strict=True):
            if function.__name__ in numbers:
                addresses[numbers[function.__name__]] = entry.address
    return addresses


@lru_cache(maxsize=1)
def lanes() -> Lanes:
    """Return the entries for runs side by side, made or loaded at the first call.

    Raises
    ------
    InputError
        If numba's compiler is switched off.
    """
    if PLAINLY:
        raise InputError("without a compiler there are no lanes")
    march_at = engine().march_at
    march, gather, parts = LANES.entries()
    return Lanes(
        _raising_no_memory(lambda runs, *arguments: bool(march(runs, march_at, *arguments))),
        gather,
        _raising_no_memory(lambda run, *arguments: parts(run.address, *arguments)),
    )


def engine_origin() -> str:
    """Return where the engine's code is from: the text of a wheel, or numba; or that it is not compiled."""
    return "plain Python" if PLAINLY else ENGINE.origin()


def _part_addresses(part: EnginePart) -> Sequence[int]:
    """Return where the functions of a part begin; where nothing is compiled, their keys in `UNCOMPILED`."""
    if not PLAINLY:
        return [entry.address for entry in part.entries()]
    return keys_of(function for function, _ in part.functions)
