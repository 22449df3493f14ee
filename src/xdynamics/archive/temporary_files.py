"""Temporary files: those being written are locked, and those that dead processes left are removed.

Beside every temporary file stands an empty one with a system lock on it, which is released when its process ends, however
it does. So no process number is consulted, which may be used again or be of another machine. The lock is not on the file
itself, because HDF5 puts its own there.
"""

from __future__ import annotations

import fcntl
import os
import re
import secrets
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

PART, LOCK = ".part", ".part.lock"
_OURS = re.compile(rb"\..+\.[a-z0-9_]{8}\.part(\.lock)?", re.DOTALL)
LONGEST = 255  # bytes of a name in most file systems
_BEGINS = (b"\x89HDF\r\n\x1a\n", b"\0" * 8, b"")  # of what HDF5 was writing when its process died


@dataclass(frozen=True)
class TemporaryFile:
    """A temporary file, empty to begin with, and the descriptor that holds the lock beside it."""

    path: Path
    handle: int

    @classmethod
    @contextmanager
    def create_beside(cls, target: Path, mode: int) -> Iterator[TemporaryFile]:
        """Make a temporary file in the folder of another, and remove it in the end if it has not been renamed.

        Parameters
        ----------
        target : Path
        mode : int
            As for `open`, subject to the umask of the process.
        """
        path, handle = _free_locked_name(target)
        try:
            os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, mode))
            yield cls(path, handle)
        finally:
            with suppress(OSError):
                os.truncate(path, 0)  # a file that HDF5 cannot close stays open, and would keep a full disk full
            path.unlink(missing_ok=True)
            _lock_of(path).unlink(missing_ok=True)
            os.close(handle)


def _free_locked_name(target: Path) -> tuple[Path, int]:
    """Find a name that is free, and lock it."""
    while True:
        token = f".{secrets.token_hex(4)}"
        room = LONGEST - len(token) - len(LOCK) - 1
        stem = os.fsdecode(os.fsencode(target.name)[:room])
        path = target.with_name(f".{stem}{token}{PART}")
        lock = _lock_of(path)
        try:
            handle = os.open(lock, os.O_CREAT | os.O_EXCL | os.O_RDWR | os.O_CLOEXEC, 0o600)
        except FileExistsError:
            continue
        try:
            if try_lock(handle, needed=False) and lock.exists():  # another process may have swept it away before
                return path, handle
        except BaseException:
            lock.unlink(missing_ok=True)
            os.close(handle)
            raise
        os.close(handle)


def _lock_of(part: Path) -> Path:
    return part.with_suffix(LOCK)


def fitting_name(name: str, *, prefix: str = "", suffix: str = "") -> str:
    """Return a file's name with a prefix and a suffix; if that is too long, its beginning and a digest take its place."""
    encoded = os.fsencode(name)
    if len(encoded) + len(prefix) + len(suffix) > LONGEST:
        encoded = encoded[: LONGEST - 32] + b"~" + sha256(encoded).hexdigest()[:16].encode()
    return f"{prefix}{os.fsdecode(encoded)}{suffix}"


def is_ours(name: str) -> bool:
    """Whether a name is that of a temporary file, or of its lock."""
    return _OURS.fullmatch(os.fsencode(name)) is not None


def sweep_temporary_files(folder: Path) -> None:
    """Remove the temporary files of dead processes; those that cannot be removed stay."""
    with suppress(OSError), os.scandir(folder) as entries:
        paths = [Path(entry.path) for entry in entries if is_ours(entry.name)]
        for path in paths:
            lock = path if path.name.endswith(LOCK) else _lock_of(path)
            with suppress(OSError):
                if path == lock:
                    _remove_unlocked(lock, [lock.with_suffix(""), lock])
                elif not lock.exists():  # left by a version that made no locks
                    _remove_unlocked(path, [path])


def _remove_unlocked(guard: Path, paths: list[Path]) -> None:
    """Remove files if the first is one of ours and locked by nobody."""
    handle = os.open(guard, os.O_RDWR | os.O_NONBLOCK | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        ours = stat.S_ISREG(os.fstat(handle).st_mode) and os.read(handle, 8) in _BEGINS
        if ours and try_lock(handle, needed=True):
            for path in paths:
                path.unlink(missing_ok=True)
    finally:
        os.close(handle)


def try_lock(handle: int, *, needed: bool) -> bool:
    """Lock an open file until it is closed, unless another process holds its lock.

    On a file system without locks a needed one is not obtained: nothing is removed there, but files are written.
    """
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return not needed
    return True
