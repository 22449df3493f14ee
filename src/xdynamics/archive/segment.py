"""One finished stretch of a march as a file: its identity, the march's memory at its end, its rows.

The first line is JSON: name, type and shape of every array, and for every variable the digest of all its rows up to here. The arrays of the memory follow, then a line with the sha256 of everything before it, then the rows.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import Place
from xdynamics.archive.seals import Seal
from xdynamics.archive.store import LocalFile
from xdynamics.archive.stores import store_of, taking_name
from xdynamics.faults import ArchiveError

Array = NDArray[Any]
Part = tuple[str, Array]
Shape = tuple[str, Any, tuple[int, ...]]  # name, type, shape of an array

MEMORY, ROWS = "memory", "rows"
_KIND = "xdynamics segment 1"
_MARK = b"\nsha256 "
_LONGEST_LINE = 1 << 26
_PIECE = 1 << 22  # bytes that are read at once


@dataclass(frozen=True)
class Segment:
    """A segment whose first line and memory are whole: the content of the line, where arrays begin, a digest of both."""

    local_file: LocalFile
    header: Mapping[str, Any]
    first: int
    digest: str

    @property
    def path(self) -> Path:
        """The file on this machine."""
        return self.local_file.path

    def memory(self) -> dict[str, Array]:
        """Return the march's memory."""
        with self.path.open("rb") as file:
            file.seek(self.first)
            return {
                name: _array_from_bytes(file.read(_array_bytes(kind, shape)), kind, shape)
                for name, kind, shape in self.header[MEMORY]
            }

    def rows(self) -> Iterator[Part]:
        """Yield the rows of one variable after the other, some megabytes at a time."""
        with self.path.open("rb") as file:
            file.seek(_behind_head(self.header, self.first))
            for name, kind, (rows, *inner) in self.header[ROWS]:
                max_rows = max(1, _PIECE // _array_bytes(kind, inner))
                for start in range(
                    0, max(1, rows), max_rows
                ):  # an empty array is yielded too: its shape is in the digests
                    shape = (min(max_rows, rows - start), *inner)
                    yield name, _array_from_bytes(file.read(_array_bytes(kind, shape)), kind, shape)

    def check(self, seals: Mapping[str, Seal]) -> None:
        """Add its rows to digests of those before it, and compare.

        Raises
        ------
        ArchiveError
            Naming the first variable that differs.
        """
        for name, values in self.rows():
            if name not in seals or seals[name].dtype != values.dtype:
                raise ArchiveError(f"has a variable '{name}' that the run has not")
            seals[name].update(values)
        for name, seal in seals.items():
            if self.header["digests"].get(name) != seal.hexdigest():
                raise ArchiveError(f"differs from the digest of '{name}'")


def write_segment(
    location: Place,
    march_header: Mapping[str, Any],
    memory: Mapping[str, Array],
    rows: list[Shape],
    values: Iterable[Array],
) -> str:
    """Write a segment whole or not at all; return its digest."""
    shapes = [(name, array.dtype, array.shape) for name, array in memory.items()]
    header = {"kind": _KIND} | dict(march_header) | {MEMORY: _array_headers(shapes), ROWS: _array_headers(rows)}
    head = json.dumps(header).encode() + b"\n" + b"".join(array.tobytes() for array in memory.values())
    digest = hashlib.sha256(head).hexdigest()
    with taking_name(location) as new, new.part.open("wb") as file:
        file.write(head + _MARK + digest.encode() + b"\n")
        for array in values:
            file.write(np.ascontiguousarray(array).data)
    return digest


def read_segment(location: Place) -> Segment:
    """Read the first line of a segment, and compare that and its memory with their digest.

    Raises
    ------
    ArchiveError
        With a predicate: what the segment is or does that no segment should.
    """
    store = store_of(location)
    if store.kind(location) is not None:
        raise ArchiveError("is no file")
    local_file = store.local_file(location)
    try:
        with local_file.path.open("rb") as file:
            header, first, digest = _read_segment_head(file)
            size = os.fstat(file.fileno()).st_size
        needed = _behind_head(header, first) + sum(_array_bytes(kind, shape) for _, kind, shape in header[ROWS])
    except OSError as error:
        raise ArchiveError(f"cannot be read: {error.strerror or error}") from None
    except ArchiveError:
        raise
    except (ValueError, LookupError, TypeError, AttributeError, MemoryError, OverflowError):
        raise ArchiveError("is damaged, or no segment of this version") from None
    if size != needed:
        raise ArchiveError(f"has {size} bytes and says {needed}")
    return Segment(local_file, header, first, digest)


def _read_segment_head(file: IO[bytes]) -> tuple[dict[str, Any], int, str]:
    """Return the content of the first line, where the memory begins, and the digest of both."""
    line = file.readline(_LONGEST_LINE)
    header = json.loads(line)
    if header["kind"] != _KIND:
        raise ArchiveError("is of another version")
    size = sum(_array_bytes(kind, shape) for _, kind, shape in header[MEMORY])
    if not 0 <= size <= os.fstat(file.fileno()).st_size:
        raise ArchiveError("is cut off")
    digest = hashlib.sha256(line + file.read(size)).hexdigest()
    if file.read(len(_MARK) + len(digest) + 1) != _MARK + digest.encode() + b"\n":
        raise ArchiveError("differs from its digest")
    return header, len(line), digest


def _behind_head(header: Mapping[str, Any], first: int) -> int:
    return first + sum(_array_bytes(kind, shape) for _, kind, shape in header[MEMORY]) + len(_MARK) + 64 + 1


def _array_headers(shapes: Iterable[Shape]) -> list[Any]:
    kinds = [(name, np.dtype(kind), shape) for name, kind, shape in shapes]
    return [(name, kind.descr if kind.names else kind.str, shape) for name, kind, shape in kinds]


def _array_dtype(described: Any) -> np.dtype[Any]:
    return np.dtype(described if isinstance(described, str) else [(name, kind) for name, kind in described])


def _array_bytes(described: Any, shape: Iterable[int]) -> int:
    return prod(shape) * _array_dtype(described).itemsize


def _array_from_bytes(content: bytes, described: Any, shape: Iterable[int]) -> Array:
    return np.frombuffer(content, _array_dtype(described)).reshape(tuple(shape))
