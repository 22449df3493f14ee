"""Open binary files, like ``io.BytesIO()``, as a filesystem of fsspec."""

from __future__ import annotations

from hashlib import sha256
from typing import Any, ClassVar
from weakref import finalize

from fsspec import AbstractFileSystem

from xdynamics.archive.store import OPEN, can, open_file
from xdynamics.faults import InputError

SIGNATURE = b"\x89HDF"  # the begin of an archive


class OpenFiles(AbstractFileSystem):  # type: ignore[misc]
    """All open files that were given, as files of one folder."""

    protocol = OPEN
    cachable = False
    _streams: ClassVar[dict[str, bytes]] = {}

    def info(self, path: str, **_: Any) -> dict[str, Any]:
        """Return size and type of a file; one without content is none yet.

        Raises
        ------
        FileNotFoundError
        """
        name, content = self._strip_protocol(path), self.cat_file(path)
        if not content:
            raise FileNotFoundError(name)
        # the digest tells what was written meanwhile from what was read before
        return {"name": name, "size": len(content), "type": "file", "ETag": sha256(content).hexdigest()}

    def ls(self, path: str, **_: Any) -> list[Any]:  # noqa: ARG002 - fsspec's signature
        """Return nothing: open files are in no folder."""
        return []

    def cat_file(self, path: str, start: int = 0, end: int | None = None, **_: Any) -> bytes:
        """Return bytes of a file; of one that cannot be read none, and one that cannot be moved in is read once."""
        name = self._strip_protocol(path)
        file = open_file(name)
        if not can(file, "readable") or not hasattr(file, "read"):
            return b""
        if can(file, "seekable"):
            file.seek(start or 0)
            return bytes(file.read() if end is None else file.read(end - (start or 0)))
        if name not in self._streams:
            # by name, which no other file gets: an address in memory is used again
            self._streams[name] = bytes(file.read())
            finalize(file, self._streams.pop, name)
        return self._streams[name][start:end]

    def pipe_file(self, path: str, value: bytes, **_: Any) -> None:
        """Write a file anew.

        Raises
        ------
        PermissionError
            If it was opened for reading.
        """
        file = open_file(self._strip_protocol(path))
        if not can(file, "writable"):
            raise PermissionError(path)
        if (there := self.cat_file(path)) and not there.startswith(SIGNATURE):
            raise InputError(f"'{path}' holds something that is no archive; give a file that is empty")
        if not there and can(file, "seekable") and file.tell():
            raise InputError(f"'{path}' is written at its begin, and is open somewhere else; give a file that is empty")
        if there:
            file.seek(0)
            file.truncate()
        file.write(value)
        file.flush()
