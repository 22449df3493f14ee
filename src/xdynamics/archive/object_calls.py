"""Calls of an object store through s3fs, and what a store's refusals mean, in words.

s3fs finds credentials, regions and endpoints as its users set them, and hands conditional headers to the client behind it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from xdynamics.archive.place import ObjectName
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
        """Whether what is there is not what the call was to meet."""
        return self.code in TAKEN


def client() -> Any:
    """Return the file system of s3fs for this process and its settings.

    Raises
    ------
    InputError
        If the package is missing.
    """
    settings = tuple(sorted(pair for pair in os.environ.items() if pair[0].startswith(("AWS_", "FSSPEC_"))))
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
    """Return what went wrong, by the client's own error behind that of s3fs."""
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
        loop.call_soon_threadsafe(body.close)


def body_of(answer: dict[str, Any]) -> bytes:
    """Return all bytes of an answer."""
    return b"".join(pieces_of(answer))


def refusal_error(location: ObjectName, failure: str, error: RefusedError) -> InputError:
    """Put what a store refused into one line.

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
