"""Calls of an object store through s3fs: refusals in words, and locks that free themselves.

s3fs finds credentials, regions and endpoints as its users set them, and hands conditional headers to the client behind
it.

A lock is an object that its holder renews, so that the lock of a process that died becomes free. A new lock is put with
``If-None-Match: *``; a lock is taken over or renewed with ``If-Match``. The age of a lock is read from the store's own
clock. A lock that a dead process of this machine left is free at once: its holder has a local file locked by the
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
from functools import lru_cache
from pathlib import Path
from typing import Any

from xdynamics.archive.store import LockedError, ObjectName
from xdynamics.archive.target import try_lock
from xdynamics.faults import ArchiveError, InputError

CONNECT, READ = 10.0, 60.0  # s without an answer, after which a call is repeated
ATTEMPTS = 4
PIECE = 1 << 22  # bytes of an answer at once

ABSENT = ("NoSuchKey", "404", "NotFound")
TAKEN = ("PreconditionFailed", "412", "ConditionalRequestConflict", "OperationAborted")
_CREDENTIALS = (
    "InvalidAccessKeyId",
    "SignatureDoesNotMatch",
    "ExpiredToken",
    "InvalidToken",
    "AuthFailure",
    "InvalidClientTokenId",
    "TokenRefreshRequired",
    "AuthorizationHeaderMalformed",
)
_DENIED = ("AccessDenied", "403", "Forbidden", "AllAccessDisabled", "MethodNotAllowed", "405")
_FULL = ("QuotaExceeded", "StorageFull", "XMinioStorageFull", "InsufficientStorage", "507", "EntityTooLarge")
_REMEDY = "by the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_PROFILE) or ~/.aws"


class RefusedError(Exception):
    """A call that the store did not grant, or did not answer.

    Attributes
    ----------
    code : str
        The store's word for it, or the name of the error in the way to it.
    """

    def __init__(self, code: str, words: str) -> None:
        super().__init__(f"{code}: {words}")
        self.code, self.words = code, words

    @property
    def is_absent(self) -> bool:
        """Whether there is nothing under the name."""
        return self.code in ABSENT

    @property
    def is_taken(self) -> bool:
        """Whether a store refused a call because its condition on the object was not met."""
        return self.code in TAKEN


def client() -> Any:
    """Return the file system of s3fs for this process and its settings.

    Raises
    ------
    InputError
        If the package is missing.
    """
    settings = tuple(sorted(pair for pair in os.environ.items() if pair[0].startswith(("AWS_", "FSSPEC_"))))
    # by process: the event loop and connections of a client do not survive a fork
    return _client(os.getpid(), settings, CONNECT, READ, ATTEMPTS)


@lru_cache(maxsize=8)
def _client(_process: int, _settings: tuple[tuple[str, str], ...], connect: float, read: float, attempts: int) -> Any:
    try:
        import s3fs
    except ImportError:
        raise InputError("object stores need the package s3fs: pip install 'xdynamics[s3]'") from None
    from fsspec.config import conf

    config = {
        "connect_timeout": connect,
        "read_timeout": read,
        "retries": {"mode": "standard", "total_max_attempts": attempts},
    } | dict(conf.get("s3", {}).get("config_kwargs", {}))
    # fsspec caches by arguments, and would not notice that the environment has changed
    files = s3fs.S3FileSystem(config_kwargs=config, skip_instance_cache=True)
    files.retries = 1  # the client behind it repeats calls itself
    return files


def call_store(location: ObjectName, method: str, **arguments: Any) -> dict[str, Any]:
    """Call a method of the client behind s3fs, like ``put_object``.

    Raises
    ------
    RefusedError
        If the store does not grant it, or does not answer.
    """
    try:
        answer: dict[str, Any] = client().call_s3(method, Bucket=location.bucket, **arguments)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - of the client, whose kinds are many
        raise refusal_of(error) from None
    return answer


def refusal_of(error: Exception) -> RefusedError:
    """Return the refusal of a call, from the client's own error behind that of s3fs."""
    cause = error if getattr(error, "response", None) else error.__cause__ or error
    response = getattr(cause, "response", None)
    if isinstance(response, dict) and "Error" in response:
        return RefusedError(str(response["Error"].get("Code", "")), str(response["Error"].get("Message", "")))
    return RefusedError(type(cause).__name__, "")


def pieces_of(answer: dict[str, Any]) -> Iterator[bytes]:
    """Yield the bytes of an answer as they come, some megabytes at a time, and close its connection in the end.

    Raises
    ------
    RefusedError
        If the connection is lost, or the bytes differ from their checksum.
    """
    from fsspec.asyn import sync

    loop, body = client().loop, answer["Body"]
    try:
        while piece := sync(loop, body.read, PIECE):
            yield piece
    except Exception as error:  # noqa: BLE001 - as above
        raise refusal_of(error) from None
    finally:
        # the connection belongs to the loop, which runs in a thread of fsspec's own
        loop.call_soon_threadsafe(body.close)


def body_of(answer: dict[str, Any]) -> bytes:
    """Return all bytes of an answer."""
    return b"".join(pieces_of(answer))


def refusal_error(location: ObjectName, failure: str, error: RefusedError) -> InputError:
    """Return the error that states a store's refusal in one line.

    Parameters
    ----------
    location : ObjectName
    failure : str
        What was not done: ``"cannot be read"``.
    error : RefusedError
    """
    code = error.code
    if code == "NoSuchBucket":
        return InputError(f"'{location}' {failure}: there is no bucket '{location.bucket}'; make it, or name another")
    if code in ("NoCredentialsError", "PartialCredentialsError", "ProfileNotFound", "NoCredentialProviders"):
        return InputError(f"'{location}' {failure}: there are no credentials for its store; give them {_REMEDY}")
    if code in _CREDENTIALS:
        return InputError(
            f"'{location}' {failure}: its store does not accept the credentials ({code}); give others {_REMEDY}"
        )
    if code in _DENIED:
        return ArchiveError(f"'{location}' {failure}: its store denies access with these credentials ({code})")
    if code in _FULL:
        return ArchiveError(f"'{location}' {failure}: its store is full ({code}); make room there, or name another")
    if code == "NotImplemented":
        return ArchiveError(
            f"'{location}' {failure}: its store has no conditional writes (If-None-Match, If-Match), which keep two writers from"
            " each other's files; name another store"
        )
    if code in ("InternalError", "ServiceUnavailable", "SlowDown", "500", "502", "503", "504", "RequestTimeout"):
        return ArchiveError(f"'{location}' {failure}: its store failed {ATTEMPTS} times ({code}); call again later")
    if not error.words:  # no answer of the store
        return ArchiveError(
            f"'{location}' {failure}: no answer from its store ({code}); call again when it can be reached"
        )
    return ArchiveError(f"'{location}' {failure}: its store refuses ({error})")


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
        # locked before others see the token: a witness that can be locked stands for a dead holder
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
        # a renewal under way would change the stamp that the deletion is conditional on
        self.thread.join()
        with suppress(RefusedError):
            call_store(self.lock, "delete_object", Key=self.lock.key, IfMatch=self.stamp)


def _put_lock(lock: ObjectName, content: bytes, **condition: str) -> str:
    return str(call_store(lock, "put_object", Key=lock.key, Body=content, **condition)["ETag"])


def _take_lock(lock: ObjectName, locked_name: ObjectName, content: bytes) -> str:
    """Create a lock, or take it over from a dead holder; return its stamp."""
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
