"""The engine: the march compiled once for all models and methods, kept in the cache for the next process."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import config, njit

from xdynamics.kernels import cache
from xdynamics.kernels.compiling import OPTIONS
from xdynamics.march import entries
from xdynamics.march.run import Run

_LOCK = threading.Lock()
_FOUND: list[Engine] = []
SECONDS = 12  # that compiling takes on a machine of 2026


class Engine(NamedTuple):
    """The compiled entries; see `march.entries`."""

    march_one: Callable[..., None]
    march_many: Callable[..., int]
    states_inside: Callable[..., None]


def engine(run: Run) -> Engine:
    """Return the engine, compiled if that was not done on this machine.

    Parameters
    ----------
    run : Run
        Any run: the arrays of all have the same types.
    """
    with _LOCK:
        if not _FOUND:
            _FOUND.append(_PLAIN if config.DISABLE_JIT else _found(run))  # type: ignore[attr-defined]
    return _FOUND[0]


_PLAIN = Engine(entries.march_one, entries.march_many, entries.states_inside)


def _found(run: Run) -> Engine:
    name = f"engine-{_key()}"
    if kept := cache.sealed(name):
        try:
            return _called(_entries(kept), run)
        except Exception:  # noqa: BLE001 - whatever a damaged file does, the engine is compiled anew
            cache.remove(name)
    logging.getLogger("xdynamics").warning("xdynamics: compiling the engine, once per installation: about %d s", SECONDS)
    with cache.filling(name) as folder:
        try:
            return _called(_entries(folder), run)
        except OSError:  # the disk filled up meanwhile
            return _called(_entries(None), run)


def _entries(folder: Path | None) -> Engine:
    """Give the entries to numba, which keeps what it compiles in a folder; without one, in memory."""
    before, config.CACHE_DIR = config.CACHE_DIR, str(folder or "")  # type: ignore[attr-defined]
    try:
        compiled = njit(cache=folder is not None, **OPTIONS)
        return Engine(*(compiled(one) for one in _PLAIN))
    finally:
        config.CACHE_DIR = before  # type: ignore[attr-defined]


def _called(found: Engine, run: Run) -> Engine:
    """Compile, or load, every entry now: a call that has nothing to do."""
    copy = Run(*(np.copy(one) for one in run[:-1]), run.log._replace(base=run.log.base.copy()))  # type: ignore[arg-type]
    n, states = len(run.y), np.zeros((0, len(run.y)))
    found.march_one(copy, 0)
    found.march_many(copy, copy.plan[:0], states, np.zeros((0, len(run.p))), copy.now[:0], states.copy(), 0, False)  # noqa: FBT003
    found.states_inside(copy, np.zeros((4, 0)), np.zeros((n, 0)), np.zeros((2 * n, 0)))
    return found


def _key() -> str:
    """Digest of all that is compiled into the engine: its sources, the schema's flags, numba, the processor."""
    import numba
    from llvmlite import binding

    package = Path(__file__).parents[1]
    files = sorted([*(package / "kernels").glob("*.py"), *(package / "march").glob("*.py"), package / "schema.py"])
    # numba believes a file it kept only if the entries' own file has the date and size of then
    stamp = Path(entries.__file__).stat()
    return cache.digest(
        *(path.read_text(encoding="utf-8") for path in files), numba.__version__, np.__version__, repr(stamp.st_mtime),
        binding.get_host_cpu_name(), binding.get_host_cpu_features().flatten(),
    )  # fmt: skip


