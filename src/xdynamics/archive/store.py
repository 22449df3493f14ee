"""The protocol of a store, the names of files and objects in it, and the checks of a path before it is read.

A store writes files complete or not at all, lists them, locks them, and identifies them by their content. The program
knows this protocol alone. The file system is one store (`folder_store`), a bucket of an object store another
(`object_store`); `folder_store.store_of` says to which store a location belongs.

A location is a path of the file system, or the name of an object like ``s3://bucket/runs/one.nc``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from os import PathLike, fspath
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.files import ask_path, file_above, path_kind

if TYPE_CHECKING:
    from xdynamics.model import Model

SCHEME = "s3://"
LONGEST = 1024  # bytes of an object's name
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")


@dataclass(frozen=True)
class ObjectName:
    """The name of an object in a bucket, with the interface of a file's name; only the store reads the object.

    Attributes
    ----------
    bucket : str
    key : str
        Without a slash at either end; empty for the bucket itself.
    """

    bucket: str
    key: str

    def __str__(self) -> str:
        return f"{SCHEME}{self.bucket}/{self.key}".removesuffix("/")

    def __truediv__(self, name: str) -> ObjectName:
        return ObjectName(self.bucket, f"{self.key}/{name}" if self.key else name)

    @property
    def name(self) -> str:
        """The part of the name after the last slash."""
        return PurePosixPath(self.key).name

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return PurePosixPath(self.key).stem

    @property
    def suffix(self) -> str:
        """The name's ending, like ``.nc``."""
        return PurePosixPath(self.key).suffix

    @property
    def parent(self) -> ObjectName:
        """The part of the name before the last slash, as a folder."""
        return ObjectName(self.bucket, self.key.rpartition("/")[0])

    def with_name(self, name: str) -> ObjectName:
        """Return another object name in the same folder."""
        return self.parent / name

    def with_suffix(self, suffix: str) -> ObjectName:
        """Return the object with another ending."""
        return self.with_name(self.stem + suffix)

    def absolute(self) -> ObjectName:
        """Return itself: a name in a bucket depends on no current folder."""
        return self


Place = Path | ObjectName
Given = str | PathLike[str] | ObjectName  # what a user may give for a place
GIVEN = (str, PathLike, ObjectName)


def resolve_links(location: Place) -> Place:
    """Return the location that symbolic links lead to."""
    return Path(os.path.realpath(location)) if isinstance(location, Path) else location


def location_of(named_location: Given) -> Place:
    """Return the location that a text or a path names.

    Raises
    ------
    InputError
        If it is neither a text nor a path, an address of another kind, has credentials in it, or is no name of an object.
        Credentials are not repeated in the message.

    Examples
    --------
    >>> str(location_of("s3://bucket/runs/one.nc").with_suffix(".png"))
    's3://bucket/runs/one.png'
    """
    if isinstance(named_location, ObjectName | Path):
        text = str(named_location)
        if isinstance(named_location, Path) and text.startswith("s3:/"):
            raise InputError(f"{text[:80]!r} is a Path, which drops a slash of an address; give the address as a text")
        return named_location
    if not isinstance(named_location, str | PathLike):
        raise InputError(f"{type(named_location).__name__} is no name of a file; give a text or a Path")
    text = fspath(named_location)
    address = _ADDRESS.match(text)
    if address is None:
        return Path(text)
    if address[0] != SCHEME:
        raise InputError(
            f"addresses that begin with '{address[0]}' are unknown; there are folders, and '{SCHEME}bucket/name'"
        )
    bucket, _, key = text.removeprefix(SCHEME).partition("/")
    if (
        "@" in bucket
        or ("@" in key.partition("/")[0] and ":" in bucket)
        or re.search(r"[?&]X-Amz-", text, re.IGNORECASE)
    ):
        raise InputError(
            f"credentials stand in an address that begins with '{SCHEME}'; leave them out of it, and give them by the"
            " environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_PROFILE) or ~/.aws"
        )
    if fault := _object_name_fault(bucket, key.rstrip("/")):
        raise InputError(f"'{text[:80]}' names no object: {fault}")
    return ObjectName(bucket, key.rstrip("/"))


def check_file_name(name: str) -> None:
    """Check that a text can name a file in a folder, and no other folder.

    Raises
    ------
    InputError

    Examples
    --------
    >>> check_file_name("rocket_2")
    """
    if not name.strip(" ") or name.startswith(".") or not name.isprintable() or {"/", "\\"} & {*name}:
        raise InputError(
            f"{name[:60]!r} is no name of a file in the folder; use letters, digits, '-' and '_', and name other folders"
            " where the folder is given"
        )


def _object_name_fault(bucket: str, key: str) -> str:
    """Describe why a name cannot be one of an object; empty if it can."""
    if not _BUCKET.fullmatch(bucket):
        return f"the bucket is '{bucket[:70]}', needs 3 to 63 small letters, digits, dots or hyphens"
    parts = key.split("/") if key else []
    if odd := [part for part in parts if part in ("", ".", "..")]:
        return f"it has '{odd[0]}' between slashes, which other programs take for another folder"
    if not key.isprintable():
        return "it holds characters that cannot be shown"
    if len(key.encode()) > LONGEST:
        return f"it has {len(key.encode())} bytes, {LONGEST} are the most"
    return ""


def check_source(path: Path) -> None:
    """Check that an archive can be read from a path, without opening it.

    Raises
    ------
    InputError
        If it is a directory, a pipe, a socket or a device, does not exist, or is no path, for the system or the library.
    """
    check_no_backslash(path)
    kind = ask_path(path, path_kind)
    if kind == "":
        above = file_above(path)
        raise InputError(f"'{path}' does not exist{above and f': {above}'}")
    if kind is not None:
        raise InputError(f"'{path}' is {kind}; name a file{' in it' if kind == 'a directory' else ''}")


def check_no_backslash(path: Path) -> None:
    """Check a path for a name that the netCDF library would take for another.

    Raises
    ------
    InputError
        If there is a backslash in it.
    """
    if "\\" in str(ask_path(path, Path.absolute)):
        raise InputError(
            f"'{path}' has a backslash in its whole name, which the netCDF library takes for the end of a folder's"
            " name; name another file"
        )


Name = TypeVar("Name")
FOLDER = "a directory"  # as a kind


class TakenError(ArchiveError):
    """Another process wrote the file that this one was about to write; that file is complete."""


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
    """The content of a name as a local file, which stays as long as this object does.

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
        """Give all files their names; if that fails, the error lists the files that have theirs."""


class Store(Protocol[Name]):
    """Files by name, each complete or absent. Every fault is one line that names location, cause and remedy."""

    def check_source(self, location: Name) -> None:
        """Check that there is a file to read."""

    def check_target(self, location: Name, model: Model | None = None) -> None:
        """Check before any work that a file can be written to a location without loss."""

    def check_no_table(self, location: Name, tables: list[str]) -> None:
        """Check that a location has none of the measured tables of a record, recognised by their texts."""

    def kind(self, location: Name) -> str | None:
        """Return the kind of a location: nothing (``""``), a file (None), or other words (``"a directory"``)."""

    def stamp(self, location: Name) -> Any:
        """Return the stamp that distinguishes versions of a file under one name; None without a file."""

    def names(self, folder: Name) -> list[Name]:
        """List the files and folders of a folder in order, without temporary ones; none where there is no such folder."""

    def content(self, location: Name, max_bytes: int) -> bytes:
        """Read a small file completely; one of over `max_bytes` bytes is refused."""

    def local_file(self, location: Name) -> LocalFile:
        """Return a file as one of this machine."""

    def written_at(self, location: Name) -> Path:
        """Return a path of the disk on which a file is written before it takes its name."""

    def taking_name(self, location: Name, batch: Any = None) -> AbstractContextManager[NewFile[Name]]:
        """Lend a temporary file, which takes its name, complete, when the `with` block is done.

        What is new stays alone under its name, and what replaces replaces what was there when the block began: of two
        writers one is told by `TakenError`, where the store can tell them apart. Files of a `batch` reach the disk
        together, where that is faster.
        """

    def batch(self, locations: Sequence[Name]) -> FileBatch:
        """Return the batch that gives files at these locations their names together."""

    def check_each(self, locations: Sequence[Name]) -> None:
        """Check all targets, as `check_target` does; several at once where each waits for an answer."""

    def check_empty(self, location: Name) -> None:
        """Check that a location is an empty folder, or does not exist."""

    def taking_folder(self, location: Name) -> AbstractContextManager[Path]:
        """Lend a temporary folder, which takes its name, complete, when the `with` block is done."""

    def made_folder(self, location: Name) -> Name:
        """Return a folder, made if it does not exist."""

    def new_folder(self, location: Name) -> None:
        """Make a folder that does not exist; raises FileExistsError if it does."""

    def locked(self, folder: Name) -> AbstractContextManager[None]:
        """Lock a folder against other processes; the lock of a process that died is free. Raises `LockedError`."""

    def remove(self, location: Name) -> None:
        """Remove a file, or a folder that is empty; raises OSError or `ArchiveError` if it cannot be removed."""

    def remove_folder(self, folder: Name) -> None:
        """Remove a folder with its content; entries that cannot be removed stay."""

    def clear(self, folder: Name) -> None:
        """Remove half-written files of dead processes in a folder."""
