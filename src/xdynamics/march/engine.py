"""The engine: the march, compiled once for all models and methods, and cached for the next process."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from llvmlite.binding import ffi
from numba import config, from_dtype, types
from numba.core.compiler_lock import global_compiler_lock

from xdynamics.faults import InputError
from xdynamics.fork_safety import waited_for
from xdynamics.kernels import cache
from xdynamics.kernels.compiling import PLAIN, UNCOUNTED
from xdynamics.march import entries, loop, trial_step
from xdynamics.march.contacts import dispatch
from xdynamics.march.events import enclosures, transition
from xdynamics.march.lane_rows import gather_rows
from xdynamics.march.lanes import march_lanes
from xdynamics.march.numba_cache import Kept
from xdynamics.march.run import EVENT_ROW, NOW, PLAN
from xdynamics.march.step_parts import parts_of_steps

SECONDS, SOLVERS_SECONDS, WATCHERS_SECONDS, CONTACTS_SECONDS, LANES_SECONDS = (
    10,
    8,
    12,
    15,
    3,
)  # to compile each on a machine of 2026
NEWTON, RADAU, ENCLOSING, PARTING, HAPPENING, TOUCHING = (
    -1,
    -2,
    -3,
    -4,
    -5,
    -6,
)  # keys of entries where nothing is compiled
_LOCK = waited_for(threading.RLock())
for _of, _name in ((global_compiler_lock, "_lock"), (ffi.lib._lock, "_lock")):  # noqa: SLF001
    waited_for(getattr(_of, _name))  # numba's and LLVM's own, which a child needs to compile
_FOUND: dict[str, Any] = {}
_KEPT: list[Any] = []


class Engine(NamedTuple):
    """The compiled entries, called with a run: `loop.march`, and those of `march.entries`."""

    march: Callable[..., None]
    march_many: Callable[..., int]
    states_inside: Callable[..., None]
    fastest_rates: Callable[..., None]
    growths: Callable[..., None]
    rows_of_times: Callable[..., None]
    march_at: int  # where the compiled `loop.march` begins


class Lanes(NamedTuple):
    """The entries that march runs side by side."""

    march: Callable[..., bool]  # `lanes.march_lanes`, to be called with the runs
    gather: Callable[..., None]  # `lanes.gather_rows`
    parts: Callable[..., None]  # `lanes.parts_of_steps`, to be called with a run


class Solvers(NamedTuple):
    """Addresses of the steps that solve equations."""

    newton: int  # `entries.step_by_newton`
    radau: int  # `entries.step_by_radau`


class Watchers(NamedTuple):
    """Addresses of the code that finds events and lands on them."""

    enclose: int  # `enclosures.enclose_between`
    substep: int  # `trial_step.part_of_step`
    happen: int  # `transition.happen`


def engine() -> Engine:
    """Return the engine, compiled if the cache does not hold it."""
    compiled: Engine = _part("engine", "the engine", SECONDS, _entries, _plain_entries)
    return compiled


def solvers() -> Solvers:
    """Return the solvers of implicit methods, compiled if the cache does not hold them."""
    compiled: Solvers = _part("solvers", "the solvers of implicit methods", SOLVERS_SECONDS, _solvers, _plain_solvers)
    return compiled


def watchers() -> Watchers:
    """Return the search for events, compiled if the cache does not hold it."""
    compiled: Watchers = _part("watchers", "the search for events", WATCHERS_SECONDS, _watchers, _plain_watchers)
    return compiled


def contacts() -> int:
    """Return the address of the contact code, compiled if the cache does not hold it."""
    address: int = _part("contacts", "contacts and friction", CONTACTS_SECONDS, _contacts, _plain_contacts)
    return address


def lanes() -> Lanes:
    """Return the entries for runs side by side, compiled if the cache does not hold them."""
    march_at = engine().march_at
    compiled: Lanes = _part("lanes", "marches side by side", LANES_SECONDS, _lanes, _no_lanes)
    return compiled._replace(march=lambda runs, *arguments: compiled.march(runs, march_at, *arguments))


def _part(name: str, words: str, seconds: int, compiled: Callable[[Kept], Any], plain: Callable[[], Any]) -> Any:
    with _LOCK:
        if name not in _FOUND:
            jit = not config.DISABLE_JIT  # type: ignore[attr-defined]
            _FOUND[name] = _loaded(f"{name}-{_key()}.bin", words, seconds, compiled) if jit else plain()
        return _FOUND[name]


def _loaded(name: str, words: str, seconds: int, compiled: Callable[[Kept], Any]) -> Any:
    content = cache.read(name)
    if content is not None:
        try:
            return compiled(Kept(content))
        except Exception:  # noqa: BLE001, S110 - written by another build of numba: compiled anew
            pass
    reason = cache.obstacle()
    often = "" if reason else ", once per installation"
    logging.getLogger("xdynamics").warning("xdynamics: compiling %s%s: about %d s", words, often, seconds)
    if reason:
        cache.advise(reason)
    kept = Kept()
    functions = compiled(kept)
    if not reason:
        cache.write(name, kept.content)
    return functions


def _plain_entries() -> Engine:
    march_many = entries.march_many
    others = (entries.states_inside, entries.fastest_rates, entries.growths, entries.rows_of_times)
    return Engine(loop.march, lambda run, *arguments: march_many(run, loop.march, *arguments), *others, 0)


def _plain_solvers() -> Solvers:
    PLAIN[NEWTON], PLAIN[RADAU] = entries.step_by_newton, entries.step_by_radau
    return Solvers(NEWTON, RADAU)


def _entries(kept: Kept) -> Engine:
    """Compile the entries, or load them from the cache."""
    march = kept.callback(loop.march, types.void(types.int64, types.int64))
    functions = (
        entries.march_many,
        entries.states_inside,
        entries.fastest_rates,
        entries.growths,
        entries.rows_of_times,
    )
    march_many, states_inside, fastest_rates, growths, rows_of_times = (
        kept.function(function, signature) for function, signature in zip(functions, _SIGNATURES, strict=True)
    )
    address, call = march.address, march.ctypes
    _KEPT.append(march)  # keeps the code at the address alive
    return Engine(
        lambda run, rows: call(run.address, rows),
        lambda run, *arguments: march_many(run.address, address, *arguments),
        lambda run, *arguments: states_inside(run.address, *arguments),
        lambda run, *arguments: fastest_rates(run.address, *arguments),
        lambda run, *arguments: growths(run.address, *arguments),
        rows_of_times,
        address,
    )


def _solvers(kept: Kept) -> Solvers:
    """The same for the solvers."""
    steps: list[Any] = [kept.callback(step, _STEP) for step in (entries.step_by_newton, entries.step_by_radau)]
    _KEPT.extend(steps)
    return Solvers(*(step.address for step in steps))


def _plain_watchers() -> Watchers:
    PLAIN[ENCLOSING], PLAIN[PARTING], PLAIN[HAPPENING] = (
        enclosures.enclose_between,
        trial_step.part_of_step,
        transition.happen,
    )
    return Watchers(ENCLOSING, PARTING, HAPPENING)


def _watchers(kept: Kept) -> Watchers:
    """The same for the search for events."""
    functions: list[Any] = [kept.callback(enclosures.enclose_between, types.void(*[types.int64] * 6))]
    entry = types.void(types.int64, types.float64, types.int64)
    functions += [kept.callback(function, entry) for function in (trial_step.part_of_step, transition.happen)]
    _KEPT.extend(functions)
    return Watchers(*(function.address for function in functions))


def _plain_contacts() -> int:
    PLAIN[TOUCHING] = dispatch.touch
    return TOUCHING


def _contacts(kept: Kept) -> int:
    """The same for contacts."""
    callback: Any = kept.callback(dispatch.touch, types.void(types.int64, types.float64, types.int64))
    _KEPT.append(callback)
    return int(callback.address)


def _lanes(kept: Kept) -> Lanes:
    """The same for marches side by side."""
    march = kept.function(march_lanes, _LANES[0], **UNCOUNTED)
    gather, parts = (
        kept.function(function, signature)
        for function, signature in zip((gather_rows, parts_of_steps), _LANES[1:], strict=True)
    )
    return Lanes(march, gather, lambda run, *arguments: parts(run.address, *arguments))


def _no_lanes() -> Lanes:
    raise InputError("without a compiler there are no lanes")


def _array(dtype: Any, dims: int) -> Any:
    return types.Array(from_dtype(np.dtype(dtype)), dims, "C")


_STEP = types.void(types.int64, *[types.float64] * 3, *[types.int64] * 3)
_MANY = (_array(PLAN, 1), *[_array("f8", 2)] * 3, _array(NOW, 1), *[_array("f8", 2)] * 3, types.int64, types.boolean)
_SIGNATURES = (
    (types.int64, types.int64, *_MANY),
    (types.int64, *[_array("f8", 2)] * 5, types.boolean, types.boolean),
    (types.int64, *[_array("f8", 2)] * 2),
    (types.int64, *[_array("f8", 2)] * 4),
    (_array("f8", 1), *[_array("i8", 1)] * 2, _array("f8", 1), types.boolean, _array("i8", 1)),
)


_WHOLE, _BLOCK = _array("i8", 1), _array("f8", 2)
_FLAGS, _LISTS, _ROW = _array("i1", 2), _array("i8", 2), _array("f8", 1)
_ROWS = (_array("f8", 3), _array("i1", 3), _LISTS)  # with their flags and owners
_LANES = (
    types.boolean(
        _WHOLE,
        types.int64,
        types.int64,
        _WHOLE,
        *[_BLOCK] * 4,
        _LISTS,
        *[_BLOCK] * 2,
        _WHOLE,
        _WHOLE,
        _array(PLAN, 1),
        *[_BLOCK] * 3,
        _array(NOW, 1),
        *[_BLOCK] * 3,
        _array(EVENT_ROW, 1),
        *[_BLOCK] * 2,
        _WHOLE,
        _BLOCK,
        _LISTS,
        *_ROWS,
        _ROW,
        _FLAGS,
    ),
    types.void(*_ROWS, _LISTS, _WHOLE, _BLOCK, _FLAGS),
    types.void(
        types.int64,
        types.int64,
        types.int64,
        _WHOLE,
        *[_BLOCK] * 3,
        _LISTS,
        *[_BLOCK] * 2,
        _FLAGS,
        _BLOCK,
        _ROW,
        _LISTS,
        _ROW,
        _BLOCK,
    ),
)


def _key() -> str:
    """Digest of everything compiled into the engine: sources, the schema's flags, Python, numba, the processor."""
    import numba
    from llvmlite import binding

    package = Path(__file__).parents[1]
    rooms = [path for room in ("elementary", "kernels", "march") for path in (package / room).rglob("*.py")]
    constants = [
        package / "methods" / "radau.py",
        *(package / "model" / f"{name}.py" for name in ("parts", "detectors", "reactions")),
    ]
    files = sorted([*rooms, package / "schema.py", *constants])
    return cache.digest(
        *(path.read_text(encoding="utf-8") for path in files),
        numba.__version__,
        np.__version__,
        sys.version,
        binding.get_process_triple(),
        binding.get_host_cpu_name(),
        binding.get_host_cpu_features().flatten(),
    )
