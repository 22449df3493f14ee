"""Locks of folders in stores, which free themselves.

A lock is a file that is created if it is not there. In a bucket of S3 its holder renews it, so that the lock of a
process that died becomes free: it is taken over or renewed with ``If-Match``, for which fsspec has no word. The age of
a lock is read from the store's own clock. A lock that a dead process of this machine left is free at once: its holder
has a local file locked by the system.
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

from xdynamics.archive.filesystems import RefusedError, ask, ask_s3, filesystem, refusal_error
from xdynamics.archive.store import Address, LockedError
from xdynamics.archive.target import try_lock
from xdynamics.faults import InputError

LEASE = 30.0  # s without renewal after which a lock is free; a holder that was cut off longer writes under a condition
RENEWALS = 6  # in that time: a store tells ages in whole seconds, and some calls are tried several times


@contextmanager
def leased(lock: Address, locked_name: Address) -> Iterator[None]:
    """Hold a lock during the `with` block.

    Raises
    ------
    LockedError
        If another process holds it: says which, and when it would be free.
    """
    token = secrets.token_hex(8)
    handle = os.open(_witness(token), os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600)
    try:
        # locked before others see the token: a witness that can be locked stands for a dead holder
        try_lock(handle, needed=False)
        content = json.dumps({"token": token, "host": socket.gethostname(), "process": os.getpid()}).encode()
        if lock.scheme != "s3":
            _create_lock(lock, locked_name, content)
            lease: Any = None
        else:
            lease = _Lease(lock, content, _take_lock(lock, locked_name, content))
        try:
            yield
        finally:
            with suppress(RefusedError):
                lease.release() if lease else ask(lock, "rm_file")
    finally:
        _witness(token).unlink(missing_ok=True)
        os.close(handle)


def _create_lock(lock: Address, locked_name: Address, content: bytes) -> None:
    """Create the lock of a store whose locks are not renewed."""
    try:
        ask(lock, "pipe_file", content, mode="create")
    except RefusedError as error:
        if not error.is_taken:
            raise refusal_error(lock, "cannot be locked", error) from None
        raise LockedError(
            f"'{locked_name}' is locked; if the process that locked it has ended, remove '{lock}'"
        ) from None


class _Lease:
    """A lock that a thread renews until it ends."""

    def __init__(self, lock: Address, content: bytes, stamp: str) -> None:
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
        # a renewal under way would change the stamp that the deletion is conditional on
        self.thread.join()
        ask_s3(self.lock, "delete_object", Key=self.lock.key, IfMatch=self.stamp)


def _put_lock(lock: Address, content: bytes, **condition: str) -> str:
    return str(ask_s3(lock, "put_object", Key=lock.key, Body=content, **condition)["ETag"])


def _take_lock(lock: Address, locked_name: Address, content: bytes) -> str:
    """Create a lock, or take it over from a dead holder; return its stamp."""
    try:
        with suppress_taken():
            return _put_lock(lock, content, IfNoneMatch="*")
        answer = ask_s3(lock, "get_object", Key=lock.key)
        holder: dict[str, Any] = json.loads(_body_of(answer) or b"{}")
        if holder.get("token") == json.loads(content)["token"]:  # the answer to our own call was lost
            return str(answer["ETag"])
        age = _age(answer)
        if age >= LEASE or _is_dead(str(holder.get("token", ""))):
            with suppress_taken():
                stamp = _put_lock(lock, content, IfMatch=str(answer["ETag"]))
                _forget_token(str(holder.get("token", "")))
                return stamp
            # another process took the lock over at this moment, so it is as good as new
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


def _body_of(answer: dict[str, Any]) -> bytes:
    from fsspec.asyn import sync

    content: bytes = sync(filesystem("s3").loop, answer["Body"].read)
    return content


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
        # where the file system has no locks nothing is known, and the holder counts as alive
        return try_lock(handle, needed=True)
    finally:
        os.close(handle)
