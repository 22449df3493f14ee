"""Locks that a fork waits for: a child would find the locks of other threads taken for ever, and their work half done."""

from __future__ import annotations

import os
from typing import Any, TypeVar

Lock = TypeVar("Lock")

_shared: list[Any] = []
_acquired_locks: list[Any] = []


def waited_for(lock: Lock) -> Lock:
    """Make forks wait for a lock as long as another thread holds it; it must be reentrant."""
    _shared.append(lock)
    return lock


def _acquire_all_locks() -> None:
    """Take all locks, in whatever order others take them: none is held while another is waited for."""
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
