"""The engine: the march, compiled once for all models and methods, and cached for the next process."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

from xdynamics.faults import InputError
from xdynamics.kernels.compiling import PLAINLY, keys_of
from xdynamics.kernels.engine_part import EnginePart
from xdynamics.kernels.entry_points import FLAG, FLOAT, INTEGER, NOTHING, Kind, array, returning
from xdynamics.kernels.heap_arrays import forget_refusal, was_refused
from xdynamics.march import engine_entries, loop, row_search, trial_step
from xdynamics.march.assembly import dispatch as assembly_dispatch
from xdynamics.march.assembly import holding
from xdynamics.march.contacts import dispatch as contact_dispatch
from xdynamics.march.events import dispatch as event_dispatch
from xdynamics.march.events import enclosures
from xdynamics.march.lane_rows import gather_rows
from xdynamics.march.lanes import march_lanes
from xdynamics.march.retracing import retrace
from xdynamics.march.run import EVENT_ROW, NOW, PLAN
from xdynamics.march.step_parts import parts_of_steps

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
    parts: Callable[..., None]  # `lanes.parts_of_steps`, to be called with a run


class Solvers(NamedTuple):
    """Addresses of the steps that are more than one program."""

    newton: int  # `engine_entries.step_by_newton`
    radau: int  # `engine_entries.step_by_radau`
    series: int  # `engine_entries.step_by_series`


class Watchers(NamedTuple):
    """Addresses of the code that finds events and lands on them."""

    enclose: int  # `enclosures.enclose_between`
    substep: int  # `trial_step.part_of_step`
    watch: int  # `events.dispatch.watch`


_WHOLE, _LISTS, _FLAGS = array("i8", 1), array("i8", 2), array("i1", 2)
_ROW, _BLOCK = array("f8", 1), array("f8", 2)
_ROWS: tuple[Kind, ...] = (array("f8", 3), array("i1", 3), _LISTS)  # with their flags and owners
_STEP = returning(NOTHING, INTEGER, *[FLOAT] * 3, *[INTEGER] * 3)
_ENTERED = returning(NOTHING, INTEGER, FLOAT, INTEGER)
_RUNS: tuple[Kind, ...] = (array(PLAN, 1), *[_BLOCK] * 3, array(NOW, 1), *[_BLOCK] * 3)  # from plans and starts to ends
_OF_LANES: tuple[Kind, ...] = (*[INTEGER] * 2, _WHOLE)  # addresses of programs, and the table of their arrays
_MARCH_LANES = returning(
    FLAG,
    _WHOLE,
    *_OF_LANES,
    *[_BLOCK] * 4,
    _LISTS,
    *[_BLOCK] * 2,
    *[_WHOLE] * 2,
    *_RUNS,
    array(EVENT_ROW, 1),
    *[_BLOCK] * 2,
    _WHOLE,
    _BLOCK,
    _LISTS,
    *_ROWS,
    _ROW,
    _FLAGS,
)
_GATHER_ROWS = returning(NOTHING, *_ROWS, _LISTS, _WHOLE, _BLOCK, _FLAGS)
_PARTS_OF_STEPS = returning(
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
    _WHOLE,
    _BLOCK,
)

PARTS = ENGINE, SOLVERS, WATCHERS, CONTACTS, ASSEMBLIES, LANES = (
    EnginePart(
        "engine",
        "the engine",
        18,
        (
            (loop.march, returning(NOTHING, INTEGER, INTEGER)),
            (engine_entries.march_many, returning(INTEGER, INTEGER, INTEGER, *_RUNS, INTEGER, FLAG)),
            (engine_entries.states_inside, returning(NOTHING, INTEGER, *[_BLOCK] * 4, _LISTS, _BLOCK, FLAG, FLAG)),
            (engine_entries.fastest_rates, returning(NOTHING, INTEGER, *[_BLOCK] * 2)),
            (engine_entries.growths, returning(NOTHING, INTEGER, *[_BLOCK] * 4)),
            (row_search.rows_of_times, returning(NOTHING, _ROW, *[_WHOLE] * 2, _ROW, FLAG, _WHOLE)),
            (retrace, returning(NOTHING, INTEGER, *[_BLOCK] * 2)),
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
        "watchers",
        "the search for events",
        22,
        (
            (enclosures.enclose_between, returning(NOTHING, *[INTEGER] * 6)),
            (trial_step.part_of_step, _ENTERED),
            (event_dispatch.watch, _ENTERED),
        ),
    ),
    EnginePart("contacts", "contacts and friction", 12, ((contact_dispatch.touch, _ENTERED),)),
    EnginePart(
        "assemblies",
        "contacts of many bodies",
        38,
        ((assembly_dispatch.meet, _ENTERED), (holding.press, _ENTERED)),
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
        _judged(lambda run, rows: call(run.address, rows)),
        _judged(lambda run, *arguments: march_many(run.address, march.address, *arguments)),
        _judged(lambda run, *arguments: states_inside(run.address, *arguments)),
        _judged(lambda run, *arguments: fastest_rates(run.address, *arguments)),
        _judged(lambda run, *arguments: growths(run.address, *arguments)),
        rows_of_times,
        _judged(lambda run, *arguments: retraced(run.address, *arguments)),
        march.address,
    )


def _judged(call: Callable[..., R]) -> Callable[..., R]:
    """Let a call of compiled code raise `NoMemoryError` where a program in it was given none."""

    def judged(*arguments: Any) -> R:
        forget_refusal()
        result = call(*arguments)
        if was_refused():
            raise NoMemoryError
        return result

    return judged


def _plain_engine() -> Engine:
    march_many = engine_entries.march_many
    others = (
        engine_entries.states_inside,
        engine_entries.fastest_rates,
        engine_entries.growths,
        row_search.rows_of_times,
        retrace,
    )
    return Engine(loop.march, lambda run, *arguments: march_many(run, loop.march, *arguments), *others, 0)


@lru_cache(maxsize=1)
def solvers() -> Solvers:
    """Return the solvers of implicit methods, made or loaded at the first call."""
    return Solvers(*_addresses(SOLVERS))


@lru_cache(maxsize=1)
def watchers() -> Watchers:
    """Return the search for events, made or loaded at the first call."""
    return Watchers(*_addresses(WATCHERS))


@lru_cache(maxsize=1)
def contacts() -> int:
    """Return the address of the contact code, made or loaded at the first call."""
    (address,) = _addresses(CONTACTS)
    return address


@lru_cache(maxsize=1)
def assemblies() -> int:
    """Return the address of the code of contacts of many bodies, made or loaded at the first call."""
    return _addresses(ASSEMBLIES)[0]


def pressing() -> int:
    """Return the address of the code that finds forces of closed links."""
    return _addresses(ASSEMBLIES)[1]


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
        _judged(lambda runs, *arguments: bool(march(runs, march_at, *arguments))),
        gather,
        _judged(lambda run, *arguments: parts(run.address, *arguments)),
    )


def origin() -> str:
    """Return where the engine's code is from: the text of a wheel, or numba; or that it is not compiled."""
    return "plain Python" if PLAINLY else ENGINE.origin()


def _addresses(part: EnginePart) -> Sequence[int]:
    """Return where the functions of a part begin; where nothing is compiled, their keys in `UNCOMPILED`."""
    if not PLAINLY:
        return [entry.address for entry in part.entries()]
    return keys_of(function for function, _ in part.functions)
