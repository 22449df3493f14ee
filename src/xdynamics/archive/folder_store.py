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
from xdynamics.archive.store import Held, LockedError, NewFile
from xdynamics.archive.temporary_files import is_ours, sweep, take
from xdynamics.runtime.files import asked, kind_of, made_folder, read_bounded

if TYPE_CHECKING:
    from xdynamics.archive.target import Batch
    from xdynamics.model import Model


class FolderStore:
    """Folders of the file system; see `Store`."""

    def check_source(self, place: Path) -> None:
        """Check that there is a regular file."""
        source.check_source(place)

    def check_target(self, place: Path, model: Model | None = None) -> None:
        """Check the name, what it leads to, its folder, and that it is no file of the model nor open here."""
        target.check_target(place, model)

    def check_no_table(self, place: Path, tables: list[str]) -> None:
        """Compare a file with the tables."""
        target.check_no_table(place, tables)

    def kind(self, place: Path) -> str | None:
        """Return what a path leads to."""
        return asked(place, kind_of)

    def stamp(self, place: Path) -> Any:
        """Return device, inode, size and time of the last change."""
        try:
            return identity_of(place)
        except OSError:
            return None

    def names(self, folder: Path) -> list[Path]:
        """List a folder."""
        if not folder.is_dir():
            return []
        return sorted(entry for entry in folder.iterdir() if not is_ours(entry.name))

    def content(self, place: Path, most: int) -> bytes:
        """Read a small file."""
        return read_bounded(place, most)

    def held(self, place: Path) -> Held:
        """Return the file itself."""
        return Held(place, place)

    def written_at(self, place: Path) -> Path:
        """Return the path itself."""
        return place

    def taking_name(self, place: Path, batch: Batch | None = None) -> AbstractContextManager[NewFile[Path]]:
        """Lend a temporary name beside it; the file reaches the disk before it is renamed."""
        return target.taking_name(place, batch)

    def batch(self, places: Sequence[Path]) -> target.Batch:  # noqa: ARG002 - what is there is replaced, whatever it is
        """Return what has files reach the disk together."""
        return target.Batch()

    def check_each(self, places: Sequence[Path]) -> None:
        """Check all targets."""
        for place in places:
            self.check_target(place)

    def check_empty(self, place: Path) -> None:
        """Check that a path is an empty folder, or does not exist."""
        folders.check_empty(place)

    def taking_folder(self, place: Path) -> AbstractContextManager[Path]:
        """Lend a folder beside it, which is renamed."""
        return folders.taking_folder(place)

    def made_folder(self, place: Path) -> Path:
        """Make a folder, and those that it is in."""
        return made_folder(place)

    def new_folder(self, place: Path) -> None:
        """Make a folder."""
        place.mkdir()

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
            if not take(handle, needed=False):
                raise LockedError(f"it has the folder '{folder}' locked")
            yield
        finally:
            os.close(handle)

    def remove(self, place: Path) -> None:
        """Remove a file, or an empty folder."""
        if place.is_dir() and not place.is_symlink():
            place.rmdir()
        else:
            place.unlink()

    def remove_folder(self, folder: Path) -> None:
        """Remove a folder with all that is in it."""
        shutil.rmtree(folder, ignore_errors=True)

    def clear(self, folder: Path) -> None:
        """Remove temporary files that nobody has locked."""
        sweep(folder)


FOLDERS = FolderStore()
