"""Temporary files of archives, and how a finished file takes its name: complete, and with the old file's rights.

Temporary files that are being written are locked; those that dead processes left are removed.

Beside every temporary file stands an empty file with a system lock on it, which is released when its process ends,
however it does. So no process number is consulted, which may be used again or be of another machine. The lock is not on
the temporary file itself, because HDF5 puts its own there.
"""

from __future__ import annotations

import ctypes
import fcntl
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from xdynamics.archive.shared_handles import is_still_read
from xdynamics.archive.store import NewFile, check_no_backslash
from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.files import ask_path, decoded, file_above, path_kind, read_bounded, synced

if TYPE_CHECKING:
    from xdynamics.model import Model

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
    """Return a file's name with prefix and suffix; a name too long is shortened and given a digest."""
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
    # O_NONBLOCK: a pipe of such a name must not keep this waiting; O_NOFOLLOW: a link must not lead elsewhere
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
        # flock(2) locks the open file description: closing another descriptor of the file, which would release
        # POSIX locks, does not release this lock
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return not needed
    return True


_NEW, _PRIVATE = 0o666, 0o600
_RIGHTS = stat.S_IRWXU | stat.S_IRWXG | stat.S_IRWXO


def check_path_target(path: Path, model: Model | None = None) -> None:
    """Check that a file can be written to a path, and that nothing is lost there.

    Parameters
    ----------
    path : Path
    model : Model, optional
        The model whose file and tables must stay.

    Raises
    ------
    InputError
        If it is a directory, a pipe, a socket or a device, its folder does not exist, it is no path at all, it is a
        file of the model, or an archive of which variables are still to be read here.
    """
    check_no_backslash(path)
    kind = ask_path(path, path_kind)
    if kind == "a directory":
        raise InputError(
            f"'{path}' is a directory; name a file in it, like '{path / ('run' + (path.suffix or '.nc'))}'"
        )
    if kind:
        raise InputError(f"'{path}' is {kind}; name a file")
    folder = ask_path(path, Path.resolve).parent if path.is_symlink() else path.parent
    if not ask_path(folder, Path.is_dir):
        why = file_above(path) or f"the folder '{folder}' does not exist"
        raise InputError(f"'{path}' cannot be written: {why}")
    if kind is not None:
        return
    if model is not None:
        if model.file is not None and model.file.exists() and model.file.samefile(path):
            raise InputError(f"'{path}' is the model file itself; name another file")
        check_path_no_table(path, [drive.table.text for drive in model.elements.drives.values()])
    if is_still_read(path):
        raise InputError(
            f"'{path}' is open: a run that was opened from it still reads it; close that run (run.close()) or load it"
            " (run.load()) first, or name another file"
        )


def check_path_no_table(path: Path, tables: list[str]) -> None:
    """Check that a path holds no measured table, recognised by its text: a record keeps the text and not the path.

    Raises
    ------
    InputError
        If it holds one of the tables.
    """
    if not tables or path_kind(path) is not None:
        return
    try:
        text = decoded(read_bounded(path, 4 * max(map(len, tables))))
    except (OSError, ValueError):
        return  # longer than any of the tables, or no text
    if text in tables:
        raise InputError(f"'{path}' is a table of the model; name another file")


class Batch:
    """Files that take their names together: all reach the disk by one synchronisation, and then are renamed one by one.

    Until then none of them has its name; files that were not renamed are removed when the batch is over.
    """

    def __init__(self) -> None:
        self._parts = ExitStack()
        self._files: list[NewFile[Path]] = []

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *_error: object) -> None:
        self._parts.close()

    def __len__(self) -> int:
        return len(self._files)

    def add(self, target: Path) -> NewFile[Path]:
        """Make the temporary file of a target."""
        self._files.append(_begin_new_file(self._parts, target))
        return self._files[-1]

    def take_names(self) -> None:
        """Force all files to the disk, and give them their names.

        Raises
        ------
        ArchiveError
            If that fails; files renamed before are whole under their names, under the others nothing is changed.
        """
        renamed_count = 0
        try:
            for new in self._files:
                handle = os.open(new.part, os.O_RDONLY | os.O_CLOEXEC)
                try:
                    _inherit(handle, new.name)
                finally:
                    os.close(handle)
            # rights were set before, so that they reach the disk together with the content
            sync_file_systems([new.part for new in self._files])
            for new in self._files:
                new.part.replace(new.name)
                renamed_count += 1
            for folder in dict.fromkeys(new.name.parent for new in self._files):
                with synced(folder):
                    pass
        except OSError as error:
            failed_name = self._files[min(renamed_count, len(self._files) - 1)].name
            raise ArchiveError(
                f"'{failed_name}' cannot be written: {error.strerror or error}; {renamed_count} of {len(self._files)} files have"
                " their names, under the others nothing is changed"
            ) from error
        self._files.clear()


def _begin_new_file(parts: ExitStack, target: Path) -> NewFile[Path]:
    part = parts.enter_context(TemporaryFile.create_beside(target, _NEW if not target.exists() else _PRIVATE))
    return NewFile(part.path, target)


def sync_file_systems(paths: list[Path]) -> None:
    """Force the file systems of some paths to the disk.

    Raises
    ------
    OSError
        If the system reports that this failed.
    """
    try:
        syncfs = ctypes.CDLL(None, use_errno=True).syncfs
    except (OSError, AttributeError):  # no Linux
        os.sync()
        return
    for path in {path.stat().st_dev: path for path in paths}.values():
        handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        try:
            if syncfs(handle):
                number = ctypes.get_errno()
                raise OSError(number, os.strerror(number))
        finally:
            os.close(handle)


@contextmanager
def taking_path_name(path: Path, batch: Batch | None = None) -> Iterator[NewFile[Path]]:
    """Lend a temporary name in the folder of a path; when the `with` block is done, the file takes the path's name.

    A link goes on pointing: the file that it points to is replaced. Mode and owner of that file stay. The name may be
    changed in between, for another in the same folder. In a batch it takes the name together with the others.

    Raises
    ------
    ArchiveError
        If it cannot be written; under its name nothing is changed then.
    """
    check_path_target(path)
    target = path.resolve()
    sweep_temporary_files(target.parent)
    try:
        if batch is not None:
            yield batch.add(target)
            return
        with ExitStack() as parts:
            new = _begin_new_file(parts, target)
            yield new
            # on the disk before it has the name: a power cut could otherwise leave the name with an empty file
            with synced(new.part) as handle:
                _inherit(handle, new.name)
            new.part.replace(new.name)
            with synced(target.parent):
                pass
    except (OSError, RuntimeError) as error:
        raise ArchiveError(
            f"'{path}' cannot be written: {_write_failure(target.parent, error)}; nothing is changed there"
        ) from error


def _inherit(part: int, old: Path) -> None:
    """Give a new file mode and owner of its predecessor; if the owner cannot be set, no right is widened."""
    try:
        status = old.stat()
    except FileNotFoundError:
        return
    mode, current = status.st_mode & _RIGHTS, os.fstat(part)
    # the group before the mode: no other group is to have these rights meanwhile
    if current.st_gid != status.st_gid:
        try:
            os.fchown(part, -1, status.st_gid)
        except PermissionError:  # another group gets no more rights than everybody has
            mode &= ~stat.S_IRWXG | (mode & stat.S_IRWXO) << 3
    if mode != current.st_mode & _RIGHTS:
        os.fchmod(part, mode)
    if current.st_uid != status.st_uid:
        with suppress(PermissionError):
            os.fchown(part, status.st_uid, -1)


def _write_failure(folder: Path, error: Exception) -> str:
    """Return why a write failed; the netCDF library itself guesses."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0" * 1_000_000)
    except OSError as why:
        return why.strerror or str(why)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return f"{error} (disk full, file-size limit or lost device)"
