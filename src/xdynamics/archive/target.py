"""Where a new file may be written, and how it takes its name: whole, last, and with the rights of the old one."""

from __future__ import annotations

import ctypes
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from xdynamics.archive.shared_handles import is_still_read
from xdynamics.archive.source import check_no_backslash
from xdynamics.archive.store import NewFile
from xdynamics.archive.temporary_files import TemporaryFile, sweep_temporary_files
from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.files import ask_path, decoded, file_above, path_kind, read_bounded, synced

if TYPE_CHECKING:
    from xdynamics.model import Model

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
        raise InputError(f"'{path}' is a directory; name a file in it, like '{path / 'run.nc'}'")
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
        check_path_no_table(path, [drive.table.text for drive in model.drives.values()])
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
        """Have all files reach the disk, and give them their names.

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
    """Have everything written on the file systems of some paths reach the disk.

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
    """Give a new file mode and owner of the one that it replaces; where an owner cannot be kept, no right is widened."""
    try:
        status = old.stat()
    except FileNotFoundError:
        return
    mode, current = status.st_mode & _RIGHTS, os.fstat(part)
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
