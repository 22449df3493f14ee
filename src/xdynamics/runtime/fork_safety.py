"""Safety of forks and threads: locks that a fork waits for, and linear algebra on one thread.

A forked child would find the locks of other threads taken for ever, and their work half done.

The bits of linear algebra depend on the number of threads: inside `one_blas_thread` there is a single thread.
"""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from itertools import product
from threading import RLock
from typing import Any, TypeVar

Lock = TypeVar("Lock")

_shared: list[Any] = []
_acquired_locks: list[Any] = []


def waited_for(lock: Lock) -> Lock:
    """Make forks wait for a lock as long as another thread holds it; it must be reentrant."""
    _shared.append(lock)
    return lock


def _acquire_all_locks() -> None:
    """Take all locks without a deadlock: none is held while another is waited for."""
    awaited = None
    while len(_acquired_locks) < len(_shared):
        if awaited is not None:
            awaited.acquire()
            _acquired_locks.append(awaited)
        awaited = next((lock for lock in _shared if lock is not awaited and not _try_acquire(lock)), None)
        if awaited is not None:
            _release_all_locks()


def _try_acquire(lock: Any) -> bool:
    if not lock.acquire(blocking=False):
        return False
    _acquired_locks.append(lock)
    return True


def _release_all_locks() -> None:
    while _acquired_locks:
        _acquired_locks.pop().release()


os.register_at_fork(before=_acquire_all_locks, after_in_parent=_release_all_locks, after_in_child=_release_all_locks)


LIBRARIES = ("numpy.linalg._umath_linalg", "scipy.linalg._flapack")  # each is linked to a BLAS of its own in wheels
PREFIXES, SUFFIXES = ("scipy_openblas", "openblas"), ("64_", "")
LOCK = waited_for(RLock())


# eq=False: compared and hashed by identity, as a key of `previous_counts`
@dataclass(frozen=True, eq=False)
class ThreadCount:
    """The two functions of an OpenBLAS by which its number of threads is read and set."""

    read: Callable[[], int]
    set: Callable[[int], None]


class _Use:
    """How many calls are at work on one thread, and how many threads there were in each library before."""

    calls = 0
    previous_counts: dict[ThreadCount, int] = {}  # noqa: RUF012 - of the process, as the number of threads is


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Let OpenBLAS compute on one thread, in all of the process, until the last such block is done.

    The eigenvalues of 200 rows take 3 ms so; two threads that wait for one another on a busy machine take 130. Another
    BLAS than OpenBLAS keeps its threads, and so does a library that is loaded meanwhile.
    """
    with LOCK:
        for count in (count for name in LIBRARIES if name in sys.modules for count in thread_counts(name)):
            if count not in _Use.previous_counts:
                _Use.previous_counts[count] = count.read()
                count.set(1)
        _Use.calls += 1
    try:
        yield
    finally:
        with LOCK:
            _Use.calls -= 1
            if not _Use.calls:
                for count, threads in _Use.previous_counts.items():
                    count.set(threads)
                _Use.previous_counts.clear()


@cache
def thread_counts(name: str) -> tuple[ThreadCount, ...]:
    """Return the thread-count functions of a loaded library and of the libraries it is linked to."""
    counts = []
    with suppress(OSError, TypeError):  # built otherwise: its threads stay as they are
        library = ctypes.CDLL(sys.modules[name].__file__)
        for prefix, suffix in product(PREFIXES, SUFFIXES):
            with suppress(AttributeError):
                read, write = (getattr(library, f"{prefix}_{verb}_num_threads{suffix}") for verb in ("get", "set"))
                write.argtypes, write.restype = [ctypes.c_int], None
                counts.append(ThreadCount(read, write))
    return tuple(counts)
