"""The protocol of a store, the names of files and objects in it, and the checks of a path before it is read.

A store writes files complete or not at all, lists them, locks them, and identifies them by their content. The program
knows this protocol alone. The file system is one store (`folder_store`); all that fsspec reaches by an address is another
(`address_store`); `folder_store.store_of` says to which store a location belongs.

A location is a path of the file system, or an address like ``s3://bucket/runs/one.nc``.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from itertools import count
from os import PathLike, fspath
from pathlib import Path, PurePosixPath
from typing import IO, TYPE_CHECKING, Any, Generic, Protocol, TypeVar
from weakref import WeakValueDictionary

from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.files import ask_path, file_above, path_kind

if TYPE_CHECKING:
    from xdynamics.model import Model

LONGEST = 1024  # bytes of an object's name
FILE, OPEN = "file", "open"  # schemes of addresses that are paths, and of open files
WRITABLE, READABLE = ("s3", "gs", "memory"), ("https", "http")  # schemes of stores, by what can be done there
ZARR, METADATA = ".zarr", "zarr.json"  # a Zarr store's ending, and the file of its metadata
NOTES, DIGESTS = ".xdynamics", "digests.json"  # the folder in it with the digests of its files
SCHEMES = (FILE, *WRITABLE, *READABLE)
_ADDRESS = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_BUCKET = re.compile(r"[a-z0-9][a-z0-9.-]{1,61}[a-z0-9]")
_SECRETS = re.compile(r"[?&][^=&]*(X-Amz-|sig|token|key|secret|credential|passw)[^=&]*=", re.IGNORECASE)
_GIVEN_ELSEWHERE = {
    "s3": "by the environment (AWS_ACCESS_KEY_ID, AWS_SECRET_ACCESS_KEY, AWS_PROFILE) or ~/.aws",
    "gs": "by the environment (GOOGLE_APPLICATION_CREDENTIALS)",
}


@dataclass(frozen=True)
class Address:
    """The name of a file in a store that fsspec reaches, with the interface of a path; only the store reads the file.

    Attributes
    ----------
    scheme : str
        Like ``s3``.
    path : str
        Bucket or host, and the name there, without a slash at the end.
    """

    scheme: str
    path: str

    def __str__(self) -> str:
        return f"{self.scheme}://{self.path}"

    def __truediv__(self, name: str) -> Address:
        return Address(self.scheme, f"{self.path}/{name}" if self.path else name)

    @property
    def root(self) -> str:
        """The bucket or the host."""
        return self.path.partition("/")[0]

    @property
    def key(self) -> str:
        """The name in the bucket or at the host; empty for the bucket itself."""
        return self.path.partition("/")[2]

    @property
    def name(self) -> str:
        """The part of the name after the last slash; without the query of a web address."""
        return PurePosixPath(self.path.partition("?")[0]).name

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return PurePosixPath(self.name).stem

    @property
    def suffix(self) -> str:
        """The name's ending, like ``.nc``."""
        return PurePosixPath(self.name).suffix

    @property
    def parent(self) -> Address:
        """The part of the name before the last slash, as a folder."""
        return Address(self.scheme, self.path.partition("?")[0].rpartition("/")[0])

    def with_name(self, name: str) -> Address:
        """Return another name in the same folder."""
        return self.parent / name

    def with_suffix(self, suffix: str) -> Address:
        """Return the name with another ending."""
        return self.with_name(self.stem + suffix)

    def absolute(self) -> Address:
        """Return itself: an address depends on no current folder."""
        return self


_open_files: WeakValueDictionary[str, Any] = WeakValueDictionary()  # by name; a place keeps its file
_number = count(1)


@dataclass(frozen=True)
class OpenFile(Address):
    """The place of an open file, known in this process alone."""

    file: Any = field(default=None, compare=False, repr=False)

    @property
    def is_writable(self) -> bool:
        """Whether it was opened for writing."""
        return can(self.file, "writable")

    def __reduce__(self) -> Any:
        return Address, (self.scheme, self.path)


def _place_of(file: Any) -> OpenFile:
    """Return the place of an open binary file.

    Raises
    ------
    InputError
        If it is closed or opened for text.
    """
    kind = type(file).__name__
    if getattr(file, "closed", False) or hasattr(file, "encoding"):
        state = "closed" if getattr(file, "closed", False) else "opened for text, and an archive is bytes"
        raise InputError(f"the file ({kind}) is {state}; open it with open(…, 'rb') or open(…, 'wb')")
    name = next((known for known, other in _open_files.items() if other is file), f"{kind}-{next(_number)}")
    _open_files[name] = file
    return OpenFile(OPEN, name, file)


def open_file(name: str) -> Any:
    """Return an open file by its name.

    Raises
    ------
    FileNotFoundError
        If it is closed, or of another process.
    """
    file = _open_files.get(name)
    if file is None or getattr(file, "closed", False):
        raise FileNotFoundError(name)
    return file


def can(file: Any, ability: str) -> bool:
    """Whether a file is ``readable``, ``writable`` or ``seekable``; one that does not tell is."""
    return bool(getattr(file, ability, lambda: True)())


Place = Path | Address
Given = str | PathLike[str] | Address  # what a user may give for a place
GIVEN = (str, PathLike, Address)


def resolve_links(location: Place) -> Place:
    """Return the location that symbolic links lead to."""
    return Path(os.path.realpath(location)) if isinstance(location, Path) else location


def location_of(named_location: Given | IO[bytes]) -> Place:
    """Return the location that a text or a path names, or of an open binary file.

    Raises
    ------
    InputError
        If it is neither a text, a path nor a file, an address of another kind, has credentials in it, or is no name in a store.
        Credentials are not repeated in the message.

    Examples
    --------
    >>> str(location_of("s3://bucket/runs/one.nc").with_suffix(".png"))
    's3://bucket/runs/one.png'
    """
    if isinstance(named_location, Address | Path):
        text = str(named_location)
        if isinstance(named_location, Path) and text.startswith(tuple(f"{scheme}:/" for scheme in SCHEMES)):
            raise InputError(f"{text[:80]!r} is a Path, which drops a slash of an address; give the address as a text")
        return named_location
    if hasattr(named_location, "read") or hasattr(named_location, "write"):
        return _place_of(named_location)
    if not isinstance(named_location, str | PathLike):
        raise InputError(
            f"{type(named_location).__name__} is no name of a file; give a text, a Path or an open binary file"
        )
    text = fspath(named_location)
    address = _ADDRESS.match(text)
    if address is None:
        return Path(text)
    scheme, path = address[1], text[address.end() :]
    if scheme == FILE:
        return Path(path)
    if scheme not in (*WRITABLE, *READABLE):
        known = ", ".join(f"'{name}://'" for name in SCHEMES)
        raise InputError(
            f"addresses that begin with '{address[0]}' are unknown; there are folders, and addresses that begin with {known}"
        )
    root, _, key = path.partition("/")
    if "@" in root or ("@" in key.partition("/")[0] and ":" in root) or _SECRETS.search(text):
        elsewhere = _GIVEN_ELSEWHERE.get(scheme, "by the configuration of fsspec (~/.config/fsspec)")
        raise InputError(
            f"credentials stand in an address that begins with '{address[0]}'; leave them out of it, and give them {elsewhere}"
        )
    if fault := _address_fault(scheme, root, key.rstrip("/")):
        raise InputError(f"'{text[:80]}' names no object: {fault}")
    return Address(scheme, path.rstrip("/"))


def _address_fault(scheme: str, root: str, key: str) -> str:
    """Describe why no file of a store can have a name; empty if one can."""
    if scheme in ("s3", "gs") and not _BUCKET.fullmatch(root):
        return f"the bucket is '{root[:70]}', needs 3 to 63 small letters, digits, dots or hyphens"
    if not root:
        return "nothing stands behind '://'"
    parts = key.split("/") if key else []
    if odd := [part for part in parts if part in ("", ".", "..")]:
        return f"it has '{odd[0]}' between slashes, which other programs take for another folder"
    if not key.isprintable():
        return "it holds characters that cannot be shown"
    if len(key.encode()) > LONGEST:
        return f"it has {len(key.encode())} bytes, {LONGEST} are the most"
    return ""


def check_writable(location: Address | OpenFile) -> None:
    """Check that files at addresses of a kind can be written.

    Raises
    ------
    InputError
    """
    if location.scheme not in (*WRITABLE, OPEN):
        raise InputError(
            f"'{location}' cannot be written: addresses that begin with '{location.scheme}://' are read; name a folder, or"
            f" an address that begins with {', '.join(f'{scheme}://' for scheme in WRITABLE)}"
        )
    if isinstance(location, OpenFile) and not location.is_writable:
        raise InputError(f"'{location}' is opened for reading; open it with open(…, 'wb')")


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
    partial : PartialCopy, optional
        Of a copy with some of the values: reads others.
    """

    path: Path
    location: Any
    fetch_again: Callable[[], LocalFile] | None = field(default=None, compare=False)
    copy: Any = field(default=None, compare=False)
    partial: Any = field(default=None, compare=False)


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

    def local_file(self, location: Name, *, whole: bool = True) -> LocalFile:
        """Return a file as one of this machine; where it need not be whole, its values may come when they are read."""

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

    def filled_folder(self, location: Name) -> AbstractContextManager[Path]:
        """Lend a folder of this machine, whose files are durable in a new folder when the `with` block is done."""

    def made_folder(self, location: Name) -> Name:
        """Return a folder, made if it does not exist."""

    def new_folder(self, location: Name) -> None:
        """Make a folder that does not exist; raises FileExistsError if it does."""

    def locked(self, folder: Name) -> AbstractContextManager[None]:
        """Lock a folder against other processes; the lock of a process that died is free. Raises `LockedError`."""

    def move(self, names: Sequence[str], folder: Name, target: Name) -> None:
        """Move files of a folder to another, in place of what is there; those that are not in the folder are passed over."""

    def remove(self, location: Name) -> None:
        """Remove a file, or a folder that is empty; raises OSError or `ArchiveError` if it cannot be removed."""

    def remove_folder(self, folder: Name) -> None:
        """Remove a folder with its content; entries that cannot be removed stay."""

    def clear(self, folder: Name) -> None:
        """Remove half-written files of dead processes in a folder."""
