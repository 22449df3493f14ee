"""Files that save a compilation: the user's own, written whole or not at all, and trusted only by a keyed digest.

What is read here is executed. A folder or file that anybody else owns or may write to is therefore never used, no
matter which variable named it. This is checked on the descriptors that are read, so that nothing can be exchanged
between check and use. Every file begins with the HMAC-SHA256 (RFC 2104) of its name and content under a secret of the
user, which lies beside the default folder and never in a folder that `$XDYNAMICS_CACHE` names: a file that somebody
else prepared is rejected even if the folder was once open.
"""

from __future__ import annotations

import hashlib
import hmac
import logging
import os
import secrets
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from xdynamics.faults import escaped
from xdynamics.runtime.environment import megabytes

ENVIRONMENT, LIMIT = "XDYNAMICS_CACHE", "XDYNAMICS_CACHE_LIMIT"
MOST_MEGABYTES = 256.0  # of all that is kept, unless $XDYNAMICS_CACHE_LIMIT is set
MOST_DAYS = 180.0  # since a file was last read or written
LOOKS = 32  # times the folder is looked through while as much is written as may be kept
ROOM = 8_000_000  # free bytes that keeping an engine requires
LARGEST = 500_000_000  # bytes; larger files are not read
ABANDONED = 3600.0  # seconds after which an unfinished part counts as abandoned
FRESH = 3600.0  # seconds for which a file that was read is not marked as used again
_FORMAT = "keyed digest in front"
_PART = ".part"
_SEAL = hashlib.sha256().digest_size
_OTHERS = stat.S_IWGRP | stat.S_IWOTH
_ADVISED: list[str] = []
# opening a pipe in place of a file would wait for its writer forever; a link may lead anywhere
_FLAGS = sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_NOFOLLOW", "O_CLOEXEC", "O_BINARY"))
_POSIX = os.name == "posix"


def folder() -> Path:
    """Return the folder of compiled code: $XDYNAMICS_CACHE, or `xdynamics` in the user's cache folder."""
    if configured := os.environ.get(ENVIRONMENT):
        return _from_here(configured)
    return _default_folder()


def _default_folder() -> Path:
    if cache_home := os.environ.get("XDG_CACHE_HOME"):
        return _from_here(cache_home) / "xdynamics"
    try:
        return _from_here(str(Path.home())) / ".cache" / "xdynamics"
    except RuntimeError:  # a user without a home folder
        return Path(tempfile.gettempdir()) / f"xdynamics-{_user()}"


@lru_cache
def _from_here(path_text: str) -> Path:
    """Make a path absolute as of its first use, wherever the process changes its folder to later."""
    return Path(path_text).absolute()


def text_digest(*parts: str) -> str:
    """Return the SHA-256 digest of texts, separated by null characters."""
    return hashlib.sha256("\0".join([_FORMAT, *parts]).encode()).hexdigest()


def read(name: str) -> bytes | None:
    """Return the content of a file; None if it is missing, not the user's own, or not what was written.

    The bytes that were compared with the digest are the bytes returned: the file is read once.
    """
    try:
        with _open_folder(folder()) as directory:
            sealed = _read_content(directory, name)
    except OSError:
        return None
    if sealed is None:
        return None
    seal, content = sealed[:_SEAL], sealed[_SEAL:]
    try:
        return content if hmac.compare_digest(seal, _seal(name, content, create=False)) else None
    except OSError:
        return None


def write(name: str, content: bytes) -> None:
    """Keep a file with its digest in front; if that fails, warn once and go on."""
    try:
        sealed = _seal(name, content, create=True) + content
        with _open_folder(folder(), create=True) as directory:
            part = f"{name[:20]}-{secrets.token_hex(8)}{_PART}"
            try:
                with os.fdopen(
                    os.open(part, _FLAGS | os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600, **_dir_fd_argument(directory)),
                    "wb",
                ) as file:
                    file.write(sealed)
                _replace_file(directory, part, name)
            except BaseException:
                with suppress(OSError):
                    os.unlink(part, **_dir_fd_argument(directory))
                raise
            if _looks_through(len(sealed)):
                _prune(directory, name)
    except OSError as error:
        advise(_error_reason(error))


def caching_obstacle() -> str:
    """Return why no engine could be kept, before time is spent on compiling one; empty if it could."""
    try:
        _secret(create=True)
        with _open_folder(folder(), create=True), tempfile.NamedTemporaryFile(dir=folder(), suffix=_PART) as probe:
            probe.write(bytes(ROOM))
            probe.flush()
    except OSError as error:
        return _error_reason(error)
    return ""


def advise(reason: str) -> None:
    """Warn once per process that nothing can be kept, and say what helps."""
    if _ADVISED:
        return
    _ADVISED.append(reason)
    logging.getLogger("xdynamics").warning(
        "xdynamics: compiled code cannot be kept in '%s' (%s), so every process compiles it again; set %s to a folder"
        " of your own that nobody else can write to and that has room",
        escaped(str(folder())),
        reason,
        ENVIRONMENT,
    )


def _error_reason(error: OSError) -> str:
    return error.strerror or str(error)


@contextmanager
def _open_folder(path: Path, *, create: bool = False) -> Iterator[int]:
    """Hold a folder open that belongs to the user and that nobody else can write to.

    Raises
    ------
    OSError
        If there is none, or it is somebody else's.
    """
    if create:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
    if not _POSIX:
        yield -1
        return
    flags = os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC
    # in the shared temporary folder a link may be anybody's; elsewhere a user's own link to a larger disk is intended
    descriptor = os.open(path, flags | (os.O_NOFOLLOW if path.parent == Path(tempfile.gettempdir()) else 0))
    try:
        _check_ownership(os.fstat(descriptor), "folder")
        yield descriptor
    finally:
        os.close(descriptor)


def _check_ownership(status: os.stat_result, file_kind: str) -> None:
    if _POSIX and status.st_uid != _user():
        raise PermissionError(1, f"the {file_kind} belongs to user {status.st_uid}, not to user {_user()}")
    if _POSIX and status.st_mode & _OTHERS:
        raise PermissionError(1, f"others may write to the {file_kind}: take that from them by `chmod go-w`")


def _dir_fd_argument(directory: int) -> dict[str, int]:
    return {"dir_fd": directory} if _POSIX else {}


def _read_content(directory: int, name: str) -> bytes | None:
    """Return all bytes of a regular file of the user's own; renew its time of use, by which files are pruned."""
    with os.fdopen(
        os.open(name if _POSIX else folder() / name, _FLAGS | os.O_RDONLY, **_dir_fd_argument(directory)), "rb"
    ) as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or status.st_size > LARGEST:
            return None
        _check_ownership(status, "file")
        content = file.read()
        if _POSIX and time.time() - status.st_mtime > FRESH:
            with suppress(OSError):
                os.utime(file.fileno())
    return content


def _replace_file(directory: int, part: str, name: str) -> None:
    """Move a finished part to the place of its file."""
    if not _POSIX:
        (folder() / part).replace(folder() / name)
        return
    with suppress(FileNotFoundError):
        if stat.S_ISDIR(os.stat(name, dir_fd=directory, follow_symlinks=False).st_mode):
            shutil.rmtree(name, dir_fd=directory)  # os.replace does not put a file over a folder
    os.replace(part, name, src_dir_fd=directory, dst_dir_fd=directory)


def _seal(name: str, content: bytes, *, create: bool) -> bytes:
    return hmac.digest(_secret(create=create), name.encode() + b"\0" + content, "sha256")


def _secret(*, create: bool) -> bytes:
    """Return the user's secret, from a file of mode 600 beside the default folder.

    Raises
    ------
    OSError
        If there is none, or others may read or write it.
    """
    path = _default_folder().with_name(f"{_default_folder().name}.secret")
    try:
        handle = os.open(path, _FLAGS | os.O_RDONLY)
    except FileNotFoundError:
        if not create:
            raise
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        _found_secret(path)
        handle = os.open(path, _FLAGS | os.O_RDONLY)
    with os.fdopen(handle, "rb") as file:
        status = os.fstat(file.fileno())
        _check_ownership(status, f"secret '{path}'")
        if not stat.S_ISREG(status.st_mode) or (_POSIX and status.st_mode & 0o077):
            raise PermissionError(1, f"others may read '{path}': remove it, and a new secret is made")
        secret = file.read()
    if len(secret) != _SEAL:
        raise OSError(22, f"'{path}' holds no secret: remove it, and a new one is made")
    return secret


def _found_secret(path: Path) -> None:
    """Make a secret; if several processes do so at once, the first one's stays."""
    handle, part = tempfile.mkstemp(dir=path.parent, prefix=f"{path.name}-", suffix=_PART)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(secrets.token_bytes(_SEAL))
        try:
            os.link(part, path, follow_symlinks=False)
        except FileExistsError:
            pass
        except OSError:  # a file system without links: the last one's stays
            Path(part).replace(path)
    finally:
        Path(part).unlink(missing_ok=True)


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


def _looks_through(size: int) -> bool:
    """Whether a file of this size is one after which the folder is pruned: by chance, `LOOKS` times while a full one is written.

    To look through ten thousand files takes longer than to compile a law. Chance needs no memory that processes share,
    and it is not Python's own generator, whose seed is the user's.
    """
    limit = int(1e6 * max_megabytes())
    return LOOKS * size >= limit or secrets.randbelow(limit) < LOOKS * size


def _prune(directory: int, written_name: str) -> None:
    """Remove old files, the least recently used beyond the limit, and parts of processes that died while writing."""
    now, kept_files, limit = time.time(), [], 1e6 * max_megabytes()
    with os.scandir(directory if _POSIX else folder()) as scan:
        entries = list(scan)
    for entry in entries:
        try:
            status = entry.stat(follow_symlinks=False)
        except FileNotFoundError:  # another process has removed it since
            continue
        age = now - status.st_mtime
        if entry.name.endswith(_PART) and age > ABANDONED:
            _remove_entry(directory, entry)
        elif stat.S_ISREG(status.st_mode) and entry.name != written_name and not entry.name.endswith(_PART):
            kept_files.append((age, status.st_size, entry))
    total = 0
    for age, size, entry in sorted(kept_files, key=lambda row: (row[0], row[2].name)):
        total += size
        if total > limit or age > 86400.0 * MOST_DAYS:
            _remove_entry(directory, entry)


def _remove_entry(directory: int, entry: os.DirEntry[str]) -> None:
    with suppress(OSError):
        if entry.is_dir(follow_symlinks=False):
            shutil.rmtree(entry.name if _POSIX else entry.path, dir_fd=directory if _POSIX else None)
        else:
            os.unlink(entry.name if _POSIX else entry.path, **_dir_fd_argument(directory))


def max_megabytes() -> float:
    """Return how many MB may be kept: $XDYNAMICS_CACHE_LIMIT, or the default if that is not a valid number."""
    return megabytes(LIMIT, MOST_MEGABYTES)
