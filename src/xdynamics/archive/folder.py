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
from xdynamics.runtime.files import ask_path, make_folder, path_kind, synced

BUILT = ".building"


@contextmanager
def new_folder_at(path: Path) -> Iterator[Path]:
    """Lend a folder beside a path; when the `with` block is done, it takes the path's name, whole.

    Remains of killed processes under the same name are removed. Of two processes the first takes the name.

    Raises
    ------
    InputError
        If something has that name: before anything is done, or in the end if another process was faster.
    ArchiveError
        If it cannot be written.
    """
    target = ask_path(path, Path.resolve)
    check_folder_empty(path)
    make_folder(target.parent)
    try:
        _sweep_dead_folders(target)
        built, handle = _make_locked_folder(target)
        try:
            yield built
            _rename_built_folder(built, target)
        finally:
            os.close(handle)
            shutil.rmtree(built, ignore_errors=True)
    except OSError as error:
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            check_folder_empty(path)
        raise ArchiveError(
            f"'{path}' cannot be written: {error.strerror or error}; nothing is changed there"
        ) from error


def check_folder_empty(path: Path) -> None:
    """Check that a path is an empty folder, or does not exist.

    Raises
    ------
    InputError
        If it is anything else.
    """
    kind = ask_path(path, path_kind)
    if kind not in ("", "a directory"):
        raise InputError(f"'{path}' is {kind or 'a file'}; name a folder")
    if kind and (names := sorted(entry.name for entry in path.iterdir())):
        raise InputError(f"'{path}' holds '{names[0]}' already; name a folder that is empty, or not there")


def _rename_built_folder(built: Path, target: Path) -> None:
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


def _make_locked_folder(target: Path) -> tuple[Path, int]:
    """Make a folder beside a path, locked as long as this process lives."""
    while True:
        built = target.with_name(f"{_stem(target)}{secrets.token_hex(4)}{BUILT}")
        built.mkdir()
        with suppress(FileNotFoundError):  # another process may sweep it away before it is locked, or even opened
            handle = os.open(built, os.O_RDONLY | os.O_CLOEXEC)
            if _try_folder_lock(handle) and built.exists():
                return built, handle
            os.close(handle)


def _sweep_dead_folders(target: Path) -> None:
    """Remove the folders that dead processes began under the same name."""
    names = re.compile(re.escape(_stem(target)) + r"[0-9a-f]{8}" + re.escape(BUILT))
    for folder in target.parent.iterdir():
        if not names.fullmatch(folder.name) or folder.is_symlink() or not folder.is_dir():
            continue
        with suppress(OSError):
            handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                if _try_folder_lock(handle):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(handle)


def _try_folder_lock(handle: int) -> bool:
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
