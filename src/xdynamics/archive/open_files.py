"""Open binary files, like ``io.BytesIO()``, as a filesystem of fsspec."""

from __future__ import annotations

from typing import Any

from fsspec import AbstractFileSystem

from xdynamics.archive.store import OPEN, can, open_file


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
        file = open_file(name)
        size = file.seek(0, 2) if can(file, "readable") and can(file, "seekable") else 0
        if not size:
            raise FileNotFoundError(name)
        return {"name": name, "size": size, "type": "file"}

    def ls(self, path: str, **_: Any) -> list[Any]:  # noqa: ARG002 - fsspec's signature
        """Return nothing: open files are in no folder."""
        return []

    def cat_file(self, path: str, start: int = 0, end: int | None = None, **_: Any) -> bytes:
        """Return bytes of a file."""
        file = open_file(self._strip_protocol(path))
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
        file = open_file(self._strip_protocol(path))
        if not can(file, "writable"):
            raise PermissionError(path)
        if can(file, "seekable"):
            file.seek(0)
            file.truncate()
        file.write(value)
        file.flush()
