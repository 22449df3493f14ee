"""The file system as a store: temporary names, synchronisation and renaming, and locks of the system."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive import folder as folders
from xdynamics.archive import source, target
from xdynamics.archive.shared_handles import identity_of
from xdynamics.archive.store import LocalFile, LockedError, NewFile
from xdynamics.archive.temporary_files import is_ours, sweep_temporary_files, try_lock
from xdynamics.runtime.files import ask_path, make_folder, path_kind, read_bounded

if TYPE_CHECKING:
    from xdynamics.archive.target import Batch
    from xdynamics.model import Model


class FolderStore:
    """Folders of the file system; see `Store`."""

    def check_source(self, location: Path) -> None:
        """Check that there is a regular file."""
        source.check_source(location)

    def check_target(self, location: Path, model: Model | None = None) -> None:
        """Check the name, what it leads to, its folder, and that it is no file of the model nor open here."""
        target.check_path_target(location, model)

    def check_no_table(self, location: Path, tables: list[str]) -> None:
        """Compare a file with the tables."""
        target.check_path_no_table(location, tables)

    def kind(self, location: Path) -> str | None:
        """Return what a path leads to."""
        return ask_path(location, path_kind)

    def stamp(self, location: Path) -> Any:
        """Return device, inode, size and time of the last change."""
        try:
            return identity_of(location)
        except OSError:
            return None

    def names(self, folder: Path) -> list[Path]:
        """List a folder."""
        if not folder.is_dir():
            return []
        return sorted(entry for entry in folder.iterdir() if not is_ours(entry.name))

    def content(self, location: Path, max_bytes: int) -> bytes:
        """Read a small file."""
        return read_bounded(location, max_bytes)

    def local_file(self, location: Path) -> LocalFile:
        """Return the file itself."""
        return LocalFile(location, location)

    def written_at(self, location: Path) -> Path:
        """Return the path itself."""
        return location

    def taking_name(self, location: Path, batch: Batch | None = None) -> AbstractContextManager[NewFile[Path]]:
        """Lend a temporary name beside it; the file reaches the disk before it is renamed."""
        return target.taking_path_name(location, batch)

    def batch(self, locations: Sequence[Path]) -> target.Batch:  # noqa: ARG002 - what is there is replaced, whatever it is
        """Return what has files reach the disk together."""
        return target.Batch()

    def check_each(self, locations: Sequence[Path]) -> None:
        """Check all targets."""
        for location in locations:
            self.check_target(location)

    def check_empty(self, location: Path) -> None:
        """Check that a path is an empty folder, or does not exist."""
        folders.check_folder_empty(location)

    def taking_folder(self, location: Path) -> AbstractContextManager[Path]:
        """Lend a folder beside it, which is renamed."""
        return folders.new_folder_at(location)

    def made_folder(self, location: Path) -> Path:
        """Make a folder, and those that it is in."""
        return make_folder(location)

    def new_folder(self, location: Path) -> None:
        """Make a folder."""
        location.mkdir()

    @contextmanager
    def locked(self, folder: Path) -> Iterator[None]:
        """Lock a folder by the system's own locks, which end with their process.

        Raises
        ------
        LockedError
            If another process has the folder locked.
        """
        handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
        try:
            if not try_lock(handle, needed=False):
                raise LockedError(f"it has the folder '{folder}' locked")
            yield
        finally:
            os.close(handle)

    def remove(self, location: Path) -> None:
        """Remove a file, or an empty folder."""
        if location.is_dir() and not location.is_symlink():
            location.rmdir()
        else:
            location.unlink()

    def remove_folder(self, folder: Path) -> None:
        """Remove a folder with all that is in it."""
        shutil.rmtree(folder, ignore_errors=True)

    def clear(self, folder: Path) -> None:
        """Remove temporary files that nobody has locked."""
        sweep_temporary_files(folder)


FOLDERS = FolderStore()
