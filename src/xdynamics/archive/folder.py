"""Folders written whole or not at all: built under another name, and renamed when every file is on the disk."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from xdynamics.archive.temporary_files import LONGEST
from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.files import asked, kind_of, made_folder, synced

BUILT = ".building"


@contextmanager
def taking_folder(path: Path) -> Iterator[Path]:
    """Lend a folder beside a path; when the `with` block is done, it takes the path's name, whole.

    Remains of killed processes under the same name are removed. Of two processes the first takes the name.

    Raises
    ------
    InputError
        If something has that name: before anything is done, or in the end if another process was faster.
    ArchiveError
        If it cannot be written.
    """
    target = asked(path, Path.resolve)
    check_empty(path)
    made_folder(target.parent)
    try:
        _sweep(target)
        built, handle = _begun(target)
        try:
            yield built
            _finish(built, target)
        finally:
            os.close(handle)
            shutil.rmtree(built, ignore_errors=True)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            check_empty(path)
        raise ArchiveError(
            f"'{path}' cannot be written: {error.strerror or error}; nothing is changed there"
        ) from error


def check_empty(path: Path) -> None:
    """Check that a path is an empty folder, or does not exist.

    Raises
    ------
    InputError
        If it is anything else.
    """
    kind = asked(path, kind_of)
    if kind not in ("", "a directory"):
        raise InputError(f"'{path}' is {kind or 'a file'}; name a folder")
    if kind and (names := sorted(entry.name for entry in path.iterdir())):
        raise InputError(f"'{path}' holds '{names[0]}' already; name a folder that is empty, or not there")


def _finish(built: Path, target: Path) -> None:
    if target.is_dir():
        shutil.copymode(target, built)
    for file in built.iterdir():
        with synced(file):
            pass
    with synced(built):
        pass
    built.rename(target)  # replaces an empty folder, and fails on any other
    with synced(target.parent):
        pass


def _begun(target: Path) -> tuple[Path, int]:
    """Make a folder beside a path, locked as long as this process lives."""
    while True:
        built = target.with_name(f"{_stem(target)}{secrets.token_hex(4)}{BUILT}")
        built.mkdir()
        with suppress(FileNotFoundError):  # another process may sweep it away before it is locked, or even opened
            handle = os.open(built, os.O_RDONLY | os.O_CLOEXEC)
            if _is_taken(handle) and built.exists():
                return built, handle
            os.close(handle)


def _sweep(target: Path) -> None:
    """Remove the folders that dead processes began under the same name."""
    names = re.compile(re.escape(_stem(target)) + r"[0-9a-f]{8}" + re.escape(BUILT))
    for folder in target.parent.iterdir():
        if not names.fullmatch(folder.name) or folder.is_symlink() or not folder.is_dir():
            continue
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                if _is_taken(handle):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(handle)


def _is_taken(handle: int) -> bool:
    """Lock a folder, unless another process has it locked; on a file system without locks it counts as this one's."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _stem(target: Path) -> str:
    room = LONGEST - len(BUILT) - 8 - 2
    return f".{os.fsdecode(os.fsencode(target.name)[:room])}."
