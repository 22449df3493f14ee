"""The engine: the march compiled once for all models and methods, kept in the cache for the next process."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import cfunc, config, from_dtype, njit, types

from xdynamics.kernels import cache
from xdynamics.kernels.compiling import OPTIONS, PLAIN
from xdynamics.march import entries, loop
from xdynamics.march.run import NOW, PLAN

SECONDS, SOLVERS_SECONDS = 10, 8  # that compiling takes on a machine of 2026
NEWTON, RADAU = -1, -2  # keys of steps where nothing is compiled
_LOCK = threading.Lock()
_FOUND: dict[str, Any] = {}
_KEPT: list[Any] = []


class Engine(NamedTuple):
    """The compiled entries, to be called with a run: `loop.march`, and those of `march.entries`."""

    march: Callable[..., None]
    march_many: Callable[..., int]
    states_inside: Callable[..., None]


class Solvers(NamedTuple):
    """Where the steps that solve equations begin."""

    newton: int  # `entries.step_by_newton`
    radau: int  # `entries.step_by_radau`


def engine() -> Engine:
    """Return the engine, compiled if that was not done on this machine."""
    found: Engine = _part("engine", "the engine", SECONDS, _entries, _plain_entries)
    return found


def solvers() -> Solvers:
    """Return the solvers of implicit methods, compiled if that was not done on this machine."""
    found: Solvers = _part("solvers", "the solvers of implicit methods", SOLVERS_SECONDS, _solvers, _plain_solvers)
    return found


def _part(name: str, words: str, seconds: int, compiled: Callable[[Path | None], Any], plain: Callable[[], Any]) -> Any:
    with _LOCK:
        if name not in _FOUND:
            jit = not config.DISABLE_JIT  # type: ignore[attr-defined]
            _FOUND[name] = _loaded(f"{name}-{_key()}", words, seconds, compiled) if jit else plain()
        return _FOUND[name]


def _loaded(name: str, words: str, seconds: int, compiled: Callable[[Path | None], Any]) -> Any:
    if kept := cache.sealed(name):
        try:
            return compiled(kept)
        except Exception:  # noqa: BLE001 - whatever a damaged file does, it is compiled anew
            cache.remove(name)
    logging.getLogger("xdynamics").warning("xdynamics: compiling %s, once per installation: about %d s", words, seconds)
    try:
        with cache.filling(name) as folder:
            return compiled(folder)
    except OSError:  # the disk filled up meanwhile
        return compiled(None)


def _plain_entries() -> Engine:
    many = entries.march_many
    return Engine(loop.march, lambda run, *given: many(run, loop.march, *given), entries.states_inside)


def _plain_solvers() -> Solvers:
    PLAIN[NEWTON], PLAIN[RADAU] = entries.step_by_newton, entries.step_by_radau
    return Solvers(NEWTON, RADAU)


def _entries(folder: Path | None) -> Engine:
    """Compile the entries, or load what numba kept of them in a folder; without one, nothing is kept."""
    with _keeping(folder) as keep:
        march = cfunc(types.void(types.int64, types.int64), cache=keep, **OPTIONS)(loop.march)
        others = [njit(cache=keep, **OPTIONS)(one) for one in (entries.march_many, entries.states_inside)]
    for one, signature in zip(others, _SIGNATURES, strict=True):
        one.compile(signature)
    march_many, states_inside = others
    address, call = march.address, march.ctypes
    _KEPT.append(march)  # the code behind an address lives as long as this
    return Engine(
        lambda run, rows: call(run.address, rows),
        lambda run, *given: march_many(run.address, address, *given),
        lambda run, *given: states_inside(run.address, *given),
    )


def _solvers(folder: Path | None) -> Solvers:
    """The same for the solvers."""
    with _keeping(folder) as keep:
        steps: list[Any] = [
            cfunc(_STEP, cache=keep, **OPTIONS)(one) for one in (entries.step_by_newton, entries.step_by_radau)
        ]
    _KEPT.extend(steps)
    return Solvers(*(one.address for one in steps))


@contextmanager
def _keeping(folder: Path | None) -> Iterator[bool]:
    """Let numba keep in a folder what is compiled meanwhile."""
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder or "")  # type: ignore[attr-defined]
    try:
        yield folder is not None
    finally:
        config.CACHE_DIR = before  # type: ignore[attr-defined]


def _array(dtype: Any, dims: int) -> Any:
    return types.Array(from_dtype(np.dtype(dtype)), dims, "C")


_STEP = types.void(types.int64, *[types.float64] * 3, *[types.int64] * 3)
_MANY = (_array(PLAN, 1), *[_array("f8", 2)] * 3, _array(NOW, 1), _array("f8", 2), types.int64, types.boolean)
_SIGNATURES = ((types.int64, types.int64, *_MANY), (types.int64, *[_array("f8", 2)] * 4, types.boolean))


def _key() -> str:
    """Digest of all that is compiled into the engine: its sources, the schema's flags, numba, the processor."""
    import numba
    from llvmlite import binding

    package = Path(__file__).parents[1]
    rooms = [*(package / "kernels").glob("*.py"), *(package / "march").glob("*.py")]
    files = sorted([*rooms, package / "schema.py", package / "methods" / "radau.py"])
    # numba believes a file it kept only if the entries' own files have the place and the date of then
    ways_in = [Path(str(room.__file__)).resolve() for room in (entries, loop)]
    stamps = [f"{path} {path.stat().st_mtime!r}" for path in ways_in]
    return cache.digest(
        *(path.read_text(encoding="utf-8") for path in files), numba.__version__, np.__version__, *stamps,
        binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten(),
    )  # fmt: skip
