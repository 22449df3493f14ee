"""Locks in an object store: an object that its holder renews, so that the lock of a process that died becomes free.

What is new is put with ``If-None-Match: *``, what is taken over or renewed with ``If-Match``. The age of a lock is that of the
store's own clock. A lock that a process of this machine left is free at once: its holder has a file here locked by the
system.
"""

from __future__ import annotations

import json
import os
import secrets
import socket
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import Any

from xdynamics.archive.object_calls import RefusedError, body_of, call_store, refusal_error
from xdynamics.archive.place import ObjectName
from xdynamics.archive.store import LockedError
from xdynamics.archive.temporary_files import try_lock
from xdynamics.faults import InputError

LEASE = 30.0  # s without renewal after which a lock is free; a holder that was cut off longer writes under a condition
RENEWALS = 6  # in that time: a store tells ages in whole seconds, and some calls are tried several times


@contextmanager
def leased(lock: ObjectName, locked_name: ObjectName) -> Iterator[None]:
    """Hold a lock during the `with` block.

    Raises
    ------
    LockedError
        If another process holds it: says which, and when it would be free.
    """
    token = secrets.token_hex(8)
    handle = os.open(_witness(token), os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600)
    try:
        try_lock(handle, needed=False)
        content = json.dumps({"token": token, "host": socket.gethostname(), "process": os.getpid()}).encode()
        lease = _Lease(lock, content, _take_lock(lock, locked_name, content))
        try:
            yield
        finally:
            lease.release()
    finally:
        _witness(token).unlink(missing_ok=True)
        os.close(handle)


class _Lease:
    """A lock that a thread renews until it ends."""

    def __init__(self, lock: ObjectName, content: bytes, stamp: str) -> None:
        self.lock, self.content, self.stamp, self.over = lock, content, stamp, threading.Event()
        self.thread = threading.Thread(target=self._renew, daemon=True)
        self.thread.start()

    def _renew(self) -> None:
        while not self.over.wait(LEASE / RENEWALS):
            try:
                self.stamp = _put_lock(self.lock, self.content, IfMatch=self.stamp)
            except RefusedError as error:
                if error.is_taken or error.is_absent:
                    return  # another holds it: what is written under it is conditional, too
            except InputError:
                return

    def release(self) -> None:
        """Release the lock, if it is still this process' own."""
        self.over.set()
        self.thread.join()
        with suppress(RefusedError):
            call_store(self.lock, "delete_object", Key=self.lock.key, IfMatch=self.stamp)


def _put_lock(lock: ObjectName, content: bytes, **condition: str) -> str:
    return str(call_store(lock, "put_object", Key=lock.key, Body=content, **condition)["ETag"])


def _take_lock(lock: ObjectName, locked_name: ObjectName, content: bytes) -> str:
    """Put a lock, in the place of one whose holder is dead; return its stamp."""
    try:
        with suppress_taken():
            return _put_lock(lock, content, IfNoneMatch="*")
        answer = call_store(lock, "get_object", Key=lock.key)
        holder: dict[str, Any] = json.loads(body_of(answer) or b"{}")
        if holder.get("token") == json.loads(content)["token"]:  # the answer to our own call was lost
            return str(answer["ETag"])
        age = _age(answer)
        if age >= LEASE or _is_dead(str(holder.get("token", ""))):
            with suppress_taken():
                stamp = _put_lock(lock, content, IfMatch=str(answer["ETag"]))
                _forget_token(str(holder.get("token", "")))
                return stamp
            age = 0.0
    except RefusedError as error:
        if error.is_absent:  # released in between
            return _take_lock(lock, locked_name, content)
        raise refusal_error(lock, "cannot be locked", error) from None
    except ValueError:
        holder, age = {}, 0.0
    raise LockedError(
        f"'{locked_name}' is locked by process {holder.get('process', '?')} of {str(holder.get('host', '?'))[:80]}, which renewed"
        f" its lock {age:.0f} s ago; unless it does so again, the lock is free in {max(LEASE - age, 1.0):.0f} s: try again then"
    )


@contextmanager
def suppress_taken() -> Iterator[None]:
    """Go on where another was faster."""
    try:
        yield
    except RefusedError as error:
        if not error.is_taken:
            raise


def _age(answer: dict[str, Any]) -> float:
    """Return how long ago an object was written, by the store's clock."""
    now = parsedate_to_datetime(answer["ResponseMetadata"]["HTTPHeaders"]["date"])
    return float((now - answer["LastModified"]).total_seconds())


def _witness(token: str) -> Path:
    """Return the file that the holder of a lock keeps locked on its own machine."""
    return Path(tempfile.gettempdir()) / f".xdynamics.{token}.lease"


def _forget_token(token: str) -> None:
    if token.isalnum():
        _witness(token).unlink(missing_ok=True)


def _is_dead(token: str) -> bool:
    """Whether a lock was a process' of this machine that has ended; False if it is not known here."""
    if not token.isalnum():
        return False
    try:
        handle = os.open(_witness(token), os.O_RDWR | os.O_NOFOLLOW | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        return try_lock(handle, needed=True)
    finally:
        os.close(handle)
