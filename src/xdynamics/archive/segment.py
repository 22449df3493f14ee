"""One finished stretch of a march as a file: what it is of, the march's memory at its end, its rows, a digest of all.

The first line is JSON; it says of every array its name, type and shape. The arrays follow in that order, then a line
with the sha256 of everything before it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import ArchiveError

Array = NDArray[Any]
Part = tuple[str, Array]
Shape = tuple[str, Any, tuple[int, ...]]  # name, type, shape of an array

MEMORY, ROWS = "memory", "rows"
_KIND = "xdynamics segment 1"
_MARK = b"\nsha256 "
_TAIL = len(_MARK) + 64 + 1
_LONGEST_LINE = 1 << 26
_PIECE = 1 << 22  # bytes that are read at once


@dataclass(frozen=True)
class Segment:
    """A whole segment: what its first line says, where its arrays begin, its digest."""

    path: Path
    said: Mapping[str, Any]
    first: int
    digest: str

    def memory(self) -> dict[str, Array]:
        """Return the march's memory."""
        with self.path.open("rb") as file:
            file.seek(self.first)
            return {name: _taken(file.read(_size(kind, shape)), kind, shape) for name, kind, shape in self.said[MEMORY]}

    def rows(self) -> Iterator[Part]:
        """Yield the rows of one variable after the other, some megabytes at a time."""
        with self.path.open("rb") as file:
            file.seek(self.first + sum(_size(kind, shape) for _, kind, shape in self.said[MEMORY]))
            for name, kind, (rows, *inner) in self.said[ROWS]:
                most = max(1, _PIECE // _size(kind, inner))
                for start in range(0, max(1, rows), most):  # none is told too: its form is in the digests
                    shape = (min(most, rows - start), *inner)
                    yield name, _taken(file.read(_size(kind, shape)), kind, shape)


def write(path: Path, of: Mapping[str, Any], memory: Mapping[str, Array], rows: list[Shape], values: Iterable[Array]) -> str:  # fmt: skip
    """Write a segment whole or not at all; return its digest."""
    shapes = [(name, one.dtype, one.shape) for name, one in memory.items()]
    said = {"kind": _KIND} | dict(of) | {MEMORY: _described(shapes), ROWS: _described(rows)}
    part, sha = path.with_suffix(".part"), hashlib.sha256()
    try:
        with part.open("wb") as file:
            for content in (json.dumps(said).encode() + b"\n", *(_bytes_of(one) for one in memory.values())):
                file.write(content)
                sha.update(content)
            for one in values:
                content = _bytes_of(one)
                file.write(content)
                sha.update(content)
            file.write(_MARK + sha.hexdigest().encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        with suppress(OSError):
            part.unlink(missing_ok=True)
        raise
    return sha.hexdigest()


def read(path: Path) -> Segment:
    """Read what a segment says, and compare it with its digest.

    Raises
    ------
    ArchiveError
        With a predicate: what the segment is or does that no segment should.
    """
    try:
        size = path.stat().st_size - _TAIL
        if not path.is_file() or size < 0:
            raise ArchiveError("is cut off")
        with path.open("rb") as file:
            digest = _digest_of(file, size)
            if file.read() != _MARK + digest.encode() + b"\n":
                raise ArchiveError("differs from its digest")
            file.seek(0)
            said = json.loads(file.readline(_LONGEST_LINE))
            first = file.tell()
        if not isinstance(said["of"], dict):
            raise ArchiveError("is no segment")
        arrays = sum(_size(kind, shape) for _, kind, shape in (*said[MEMORY], *said[ROWS]))
        if said["kind"] != _KIND or first + arrays != size:
            raise ArchiveError("is no segment of this version")
    except OSError as error:
        raise ArchiveError(f"cannot be read: {error.strerror or error}") from None
    except (ValueError, LookupError, TypeError) as error:
        if isinstance(error, ArchiveError):
            raise
        raise ArchiveError("is no segment") from None
    return Segment(path, said, first, digest)


def _digest_of(file: Any, size: int) -> str:
    sha = hashlib.sha256()
    for start in range(0, size, _PIECE):
        sha.update(file.read(min(_PIECE, size - start)))
    return sha.hexdigest()


def _bytes_of(array: Array) -> Any:
    return np.ascontiguousarray(array).data if array.dtype.names is None else array.tobytes()


def _described(shapes: Iterable[Shape]) -> list[Any]:
    return [
        (name, np.dtype(kind).descr if np.dtype(kind).names else np.dtype(kind).str, shape)
        for name, kind, shape in shapes
    ]


def _kind(described: Any) -> np.dtype[Any]:
    return np.dtype(described if isinstance(described, str) else [(name, one) for name, one in described])


def _size(described: Any, shape: Iterable[int]) -> int:
    return prod(shape) * _kind(described).itemsize


def _taken(content: bytes, described: Any, shape: Iterable[int]) -> Array:
    return np.frombuffer(content, _kind(described)).reshape(tuple(shape))
