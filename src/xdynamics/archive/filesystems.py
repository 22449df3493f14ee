"""The filesystems that fsspec reaches, and their refusals in words.

fsspec and its packages (s3fs, gcsfs, aiohttp) find credentials, regions and endpoints as their users set them, list,
split, repeat and time out calls. Here their errors become one line that names the file, the cause and the remedy.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any

from xdynamics.archive.store import OPEN, READABLE, Address
from xdynamics.faults import ArchiveError, InputError

CONNECT, READ = 10.0, 60.0  # s without an answer, after which a call is repeated
ATTEMPTS = 4
SLOWEST = 100_000  # bytes a second: a slower download is given up
PIECE = 1 << 24  # bytes that are asked for at once
UNMARKED = "unmarked"  # begins the stamp of a file whose versions nothing tells apart but its size
PARTIAL, WHOLE = 206, "200"  # the status of an answer that is a part of a file, and of one that is not

ABSENT = ("NoSuchKey", "404", "NotFound", "FileNotFoundError")
TAKEN = ("PreconditionFailed", "412", "ConditionalRequestConflict", "OperationAborted", "FileExistsError")
_CREDENTIALS = (
    "InvalidAccessKeyId",
    "SignatureDoesNotMatch",
    "ExpiredToken",
    "InvalidToken",
    "AuthFailure",
    "InvalidClientTokenId",
    "TokenRefreshRequired",
    "AuthorizationHeaderMalformed",
    "401",
)
_DENIED = ("AccessDenied", "403", "Forbidden", "AllAccessDisabled", "MethodNotAllowed", "405", "PermissionError")
_FULL = ("QuotaExceeded", "StorageFull", "XMinioStorageFull", "InsufficientStorage", "507", "EntityTooLarge")
_FAILED = ("InternalError", "ServiceUnavailable", "SlowDown", "500", "502", "503", "504", "RequestTimeout")
_REMEDY = "by the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_PROFILE) or ~/.aws"
_EXTRAS = {"s3": ("s3fs", "s3"), "gs": ("gcsfs", "gs"), "http": ("aiohttp", "http"), "https": ("aiohttp", "http")}


class RefusedError(Exception):
    """A call that a filesystem did not grant, or did not answer.

    Attributes
    ----------
    code : str
        The store's word for it, or the name of the error in the way to it.
    words : str
        The store's own explanation; empty without an answer.
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
        """Whether a condition on what stands under the name was not met."""
        return self.code in TAKEN


def filesystem(scheme: str) -> Any:
    """Return the filesystem of a scheme, for this process and its settings.

    Raises
    ------
    InputError
        If its package is missing.
    """
    settings = tuple(sorted(pair for pair in os.environ.items() if pair[0].startswith(("AWS_", "FSSPEC_", "GOOGLE_"))))
    # by process: the event loop and connections of a client do not survive a fork
    return _filesystem(scheme, os.getpid(), settings, CONNECT, READ, ATTEMPTS)


@lru_cache(maxsize=16)
def _filesystem(
    scheme: str, _process: int, _settings: tuple[tuple[str, str], ...], connect: float, read: float, attempts: int
) -> Any:
    if scheme == OPEN:
        from xdynamics.archive.open_files import OpenFiles

        return OpenFiles()
    import fsspec
    from fsspec.config import conf

    options: dict[str, Any] = {"use_listings_cache": False}
    if scheme == "s3":
        options["config_kwargs"] = {
            "connect_timeout": connect,
            "read_timeout": read,
            "retries": {"mode": "standard", "total_max_attempts": attempts},
        } | dict(conf.get("s3", {}).get("config_kwargs", {}))
    try:
        if scheme in READABLE:
            import aiohttp

            options["client_kwargs"] = {"timeout": aiohttp.ClientTimeout(sock_connect=connect, sock_read=read)}
        # fsspec caches by arguments, and would not notice that the environment has changed
        files = fsspec.filesystem(scheme, skip_instance_cache=True, **options)
    except ImportError:
        package, extra = _EXTRAS[scheme]
        raise InputError(
            f"addresses that begin with '{scheme}://' need the package {package}: pip install 'xdynamics[{extra}]'"
        ) from None
    if scheme == "s3":
        files.retries = 1  # the client behind it repeats calls itself
    return files


def ask(location: Address, method: str, *arguments: Any, **named_arguments: Any) -> Any:
    """Call a method of a location's filesystem, with the location first, like ``info``.

    Raises
    ------
    RefusedError
        If the store does not grant it, or does not answer.
    """
    return answered(getattr(filesystem(location.scheme), method), str(location), *arguments, **named_arguments)


def ask_s3(location: Address, method: str, **arguments: Any) -> dict[str, Any]:
    """Call a method of the client behind s3fs, like ``abort_multipart_upload``, for what fsspec has no word.

    Raises
    ------
    RefusedError
        As `ask`.
    """
    answer: dict[str, Any] = answered(filesystem("s3").call_s3, method, Bucket=location.root, **arguments)
    return answer


def answered(function: Callable[..., Any], *arguments: Any, **named_arguments: Any) -> Any:
    """Call a function of fsspec, whose errors are many, and return its answer.

    Raises
    ------
    RefusedError
        For every error that is none of this package.
    """
    try:
        return function(*arguments, **named_arguments)
    except (InputError, RefusedError):
        raise
    except Exception as error:  # noqa: BLE001 - of the client, whose kinds are many
        raise refusal_of(error) from None


def refusal_of(error: Exception) -> RefusedError:
    """Return the refusal of a call, from the client's own error behind that of fsspec."""
    cause = error if getattr(error, "response", None) else error.__cause__ or error
    response = getattr(cause, "response", None)
    if isinstance(response, dict) and "Error" in response:
        return RefusedError(str(response["Error"].get("Code", "")), str(response["Error"].get("Message", "")))
    if isinstance(status := getattr(cause, "status", None), int):  # the answer of a web server
        return RefusedError(str(status), str(getattr(cause, "message", "")) or str(status))
    return RefusedError(type(cause).__name__, "")


def refusal_error(location: Address, failure: str, error: RefusedError) -> InputError:
    """Return the error that states a store's refusal in one line.

    Parameters
    ----------
    location : Address
    failure : str
        What was not done: ``"cannot be read"``.
    error : RefusedError
    """
    code = error.code
    if code == "NoSuchBucket" or error.is_absent:  # of what is written, the bucket alone can be
        return InputError(f"'{location}' {failure}: there is no bucket '{location.root}'; make it, or name another")
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
    if code in ("NotImplemented", "NotImplementedError"):
        return ArchiveError(
            f"'{location}' {failure}: its store has no conditional writes (If-None-Match, If-Match), which keep two writers from"
            " each other's files; name another store"
        )
    if code in _FAILED:
        return ArchiveError(f"'{location}' {failure}: its store failed {ATTEMPTS} times ({code}); call again later")
    if not error.words:  # no answer of the store
        return ArchiveError(
            f"'{location}' {failure}: no answer from its store ({code}); call again when it can be reached"
        )
    return ArchiveError(f"'{location}' {failure}: its store refuses ({error})")


@contextmanager
def refusals_in_words(location: Address, failure: str) -> Iterator[None]:
    """Raise a store's refusals as errors in words.

    Raises
    ------
    InputError
        As `refusal_error`, or if the file does not exist.
    """
    try:
        yield
    except RefusedError as error:
        if error.is_absent and failure == "cannot be read":
            raise InputError(f"'{location}' does not exist") from None
        raise refusal_error(location, failure, error) from None


def status_of(location: Address) -> dict[str, Any] | None:
    """Return what a filesystem tells of a name: ``size``, ``type``, ``ETag``; None if nothing is there."""
    try:
        status: dict[str, Any] = ask(location, "info")
    except RefusedError as error:
        if error.is_absent:
            return None
        raise
    return status


def stamp_of(status: dict[str, Any] | None) -> str | None:
    """Return the stamp that distinguishes versions of a file under one name; None where there is no file."""
    if status is None or status["type"] != "file":
        return None
    names = ("etag", "generation", "Content-MD5", "Digest", "created", "mtime", "LastModified", "Last-Modified")
    marks = [f"{name} {status[name]}" for name in names if status.get(name)]
    return str(status.get("ETag") or " ".join([*(marks or [UNMARKED]), str(status["size"])]))


def fetch(location: Address, start: int, end: int) -> bytes:
    """Read bytes of a file, from one position to another.

    Raises
    ------
    RefusedError
        If the connection breaks again and again, or fewer arrive; with the code `WHOLE` if a web server has no parts.
    """
    content = BytesIO()
    _receive(location, content, start, end)
    return content.getvalue()


def download(location: Address, file: Path, size: int) -> None:
    """Download a file: as many bytes as its store says that it has, and not slower than `SLOWEST`.

    Raises
    ------
    RefusedError
        If the connection breaks again and again, or the file has another size.
    """
    width = size if location.scheme in READABLE else PIECE
    with file.open("wb") as copy:
        for start in range(0, size, max(1, width)):
            _receive(location, copy, start, min(start + width, size))


def _receive(location: Address, file: IO[bytes], start: int, end: int) -> None:
    """Write a part of a file behind what another has, and go on where the connection breaks."""
    begin = file.tell() - start
    for attempt in range(ATTEMPTS):
        try:
            _receive_once(location, file, file.tell() - begin, end)
        except RefusedError as error:
            # with words it is the store's own answer, which would be the same again
            if error.is_absent or error.words or attempt + 1 == ATTEMPTS:
                raise
        if file.tell() - begin == end:
            return
    raise RefusedError("IncompleteRead", "")


def _receive_once(location: Address, file: IO[bytes], start: int, end: int) -> None:
    if location.scheme not in READABLE:
        file.write(ask(location, "cat_file", start=start, end=end))
        return
    from fsspec.asyn import sync

    files, seconds = filesystem(location.scheme), ATTEMPTS * READ + (end - start) / SLOWEST
    answered(sync, files.loop, _stream, files, str(location), file, start, end, timeout=seconds)


async def _stream(files: Any, url: str, file: IO[bytes], start: int, end: int) -> None:
    """Write bytes of a web server into a file as they come; what it sends beyond the end is not read."""
    session = await files.set_session()
    headers = {"Accept-Encoding": "identity", "Range": f"bytes={start}-{end - 1}"}
    async with session.get(files.encode_url(url), headers=headers, **files.kwargs) as answer:
        files._raise_not_found_for_status(answer, url)  # noqa: SLF001 - as `cat_file` does
        if start and answer.status != PARTIAL:
            if isinstance(file, BytesIO):
                raise RefusedError(WHOLE, "it was asked for a part, and answers with the whole file")
            file.seek(0)  # from the begin again, as it has no parts
            start = 0
        left = end - start
        while left and (content := await answer.content.read(min(PIECE, left))):
            file.write(content)
            left -= len(content)
