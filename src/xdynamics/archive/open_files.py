"""Open binary files, like ``io.BytesIO()``, as a filesystem of fsspec."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count
from typing import Any
from weakref import WeakValueDictionary

from fsspec import AbstractFileSystem

from xdynamics.archive.store import OPEN, Address
from xdynamics.faults import InputError

_files: WeakValueDictionary[str, Any] = WeakValueDictionary()  # by name; a place keeps its file
_number = count(1)


@dataclass(frozen=True)
class OpenFile(Address):
    """The place of an open file, known in this process alone."""

    file: Any = field(default=None, compare=False, repr=False)

    @property
    def is_writable(self) -> bool:
        """Whether it was opened for writing."""
        return _can(self.file, "writable")

    def __reduce__(self) -> Any:
        return Address, (self.scheme, self.path)


def place_of(file: Any) -> OpenFile:
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
    name = next((known for known, other in _files.items() if other is file), f"{kind}-{next(_number)}")
    _files[name] = file
    return OpenFile(OPEN, name, file)


class OpenFiles(AbstractFileSystem):  # type: ignore[misc]
    """All open files that were given, as files of one folder."""

    protocol = OPEN
    cachable = False

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Return size and type of a file; one without content is none yet.

        Raises
        ------
        FileNotFoundError
        """
        name = self._strip_protocol(path)
        file = self._file(name)
        size = file.seek(0, 2) if _can(file, "readable") and _can(file, "seekable") else 0
        if not size:
            raise FileNotFoundError(name)
        return {"name": name, "size": size, "type": "file"}

    def ls(self, path: str, **_: Any) -> list[Any]:  # noqa: ARG002 - fsspec's signature
        """Return nothing: open files are in no folder."""
        return []

    def cat_file(self, path: str, start: int = 0, end: int | None = None, **_: Any) -> bytes:
        """Return bytes of a file."""
        file = self._file(self._strip_protocol(path))
        file.seek(start or 0)
        content: bytes = file.read() if end is None else file.read(end - (start or 0))
        return content

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        """Write a file anew.

        Raises
        ------
        PermissionError
            If it was opened for reading.
        """
        file = self._file(self._strip_protocol(path))
        if not _can(file, "writable"):
            raise PermissionError(path)
        if _can(file, "seekable"):
            file.seek(0)
            file.truncate()
        file.write(value)
        file.flush()

    def _file(self, name: str) -> Any:
        file = _files.get(name)
        if file is None or getattr(file, "closed", False):
            raise FileNotFoundError(name)
        return file


def _can(file: Any, ability: str) -> bool:
    return bool(getattr(file, ability, lambda: True)())
