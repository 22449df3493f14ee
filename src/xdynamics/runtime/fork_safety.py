"""Locks that a fork waits for: a child would find the locks of other threads taken for ever, and their work half done."""

from __future__ import annotations

import os
from typing import Any, TypeVar

Lock = TypeVar("Lock")

_shared: list[Any] = []
_held: list[Any] = []


def waited_for(lock: Lock) -> Lock:
    """Make forks wait for a lock as long as another thread holds it; it must be reentrant."""
    _shared.append(lock)
    return lock


def _before() -> None:
    """Take all locks, in whatever order others take them: none is held while another is waited for."""
    awaited = None
    while len(_held) < len(_shared):
        if awaited is not None:
            awaited.acquire()
            _held.append(awaited)
        awaited = next((lock for lock in _shared if lock is not awaited and not _taken(lock)), None)
        if awaited is not None:
            _after()


def _taken(lock: Any) -> bool:
    if not lock.acquire(blocking=False):
        return False
    _held.append(lock)
    return True


def _after() -> None:
    while _held:
        _held.pop().release()


os.register_at_fork(before=_before, after_in_parent=_after, after_in_child=_after)
