"""A store: where files are written whole or not at all, listed, locked, and known by what is there.

The program knows this protocol alone. A folder of the file system is one store (`folder_store`), a bucket of an object
store another (`object_store`); `stores.store_of` says which one a place is of.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from xdynamics.faults import ArchiveError, InputError

if TYPE_CHECKING:
    from xdynamics.model import Model

Name = TypeVar("Name")
FOLDER = "a directory"  # as a kind


class TakenError(ArchiveError):
    """Another process wrote what this one was about to write: what is there is whole, and of the other."""


class LockedError(InputError):
    """Another process has the lock."""


@dataclass
class NewFile(Generic[Name]):
    """A file while it is written.

    Attributes
    ----------
    part : Path
        Where it is written, on this machine.
    name
        The place whose name it takes in the end; may be changed to another of the same folder.
    keeps : bool
        Whether it stays on this machine if it cannot take its name.
    """

    part: Path
    name: Name
    keeps: bool = False


@dataclass(frozen=True)
class LocalFile:
    """What is under a name, as a file of this machine, which stays there as long as this object does.

    Attributes
    ----------
    path : Path
        The file itself, or a copy.
    location
        Its name in the store.
    fetch_again : callable, optional
        Of a copy: returns the same file again, in another process too, or raises an error.
    copy : object
        Removes the copy in the end.
    """

    path: Path
    location: Any
    fetch_again: Callable[[], LocalFile] | None = field(default=None, compare=False)
    copy: Any = field(default=None, compare=False)


class FileBatch(Protocol):
    """Files that take their names together, as far as their store allows: none of them before `take_names`."""

    def __enter__(self) -> FileBatch:
        """Begin."""

    def __exit__(self, *error: object) -> None:
        """Remove the files that have not taken their names."""

    def take_names(self) -> None:
        """Give all files their names; if that fails, the error says which have theirs."""


class Store(Protocol[Name]):
    """Files by name, each whole or not at all. Every fault is one line that names the place, the cause and the remedy."""

    def check_source(self, location: Name) -> None:
        """Check that there is a file to read."""

    def check_target(self, location: Name, model: Model | None = None) -> None:
        """Check before any work that a file can be written to a place, and that nothing is lost there."""

    def check_no_table(self, location: Name, tables: list[str]) -> None:
        """Check that a place holds none of the measured tables that a record keeps, recognised by its text."""

    def kind(self, location: Name) -> str | None:
        """Return what is at a place: nothing (``""``), a file (None), or anything else in words (``"a directory"``)."""

    def stamp(self, location: Name) -> Any:
        """Return what distinguishes a file from another under its name; None where there is none."""

    def names(self, folder: Name) -> list[Name]:
        """List the files and folders of a folder in order, without temporary ones; none where there is no such folder."""

    def content(self, location: Name, max_bytes: int) -> bytes:
        """Read a small file whole; one of over `max_bytes` bytes is refused."""

    def local_file(self, location: Name) -> LocalFile:
        """Return a file as one of this machine."""

    def written_at(self, location: Name) -> Path:
        """Return a path of the disk on which a file is written before it takes its name."""

    def taking_name(self, location: Name, batch: Any = None) -> AbstractContextManager[NewFile[Name]]:
        """Lend a temporary file, which takes its name whole when the `with` block is done.

        What is new stays alone under its name, and what replaces replaces what was there when the block began: of two
        writers one is told by `TakenError`, where the store can tell them apart. Files of a `batch` reach the disk
        together, where that is faster.
        """

    def batch(self, locations: Sequence[Name]) -> FileBatch:
        """Return what gives files of these places their names together."""

    def check_each(self, locations: Sequence[Name]) -> None:
        """Check all targets, as `check_target` does; several at once where each waits for an answer."""

    def check_empty(self, location: Name) -> None:
        """Check that a place is an empty folder, or does not exist."""

    def taking_folder(self, location: Name) -> AbstractContextManager[Path]:
        """Lend a temporary folder, which takes its name whole when the `with` block is done."""

    def made_folder(self, location: Name) -> Name:
        """Return a folder, made if it does not exist."""

    def new_folder(self, location: Name) -> None:
        """Make a folder that does not exist; raises FileExistsError if it does."""

    def locked(self, folder: Name) -> AbstractContextManager[None]:
        """Lock a folder against other processes; the lock of a process that died is free. Raises `LockedError`."""

    def remove(self, location: Name) -> None:
        """Remove a file, or a folder that is empty; raises OSError or `ArchiveError` if it cannot be removed."""

    def remove_folder(self, folder: Name) -> None:
        """Remove a folder with all that is in it; what cannot be removed stays."""

    def clear(self, folder: Name) -> None:
        """Remove what dead processes left half-written in a folder."""
