"""Where the values of a large archive are in its file, with their digests: of a remote file only what is used is read.

Before its seal a large archive has a list of extents: the bytes of every chunk, and those of the structure between
chunks, each with its sha256. A copy begins with the structure, some hundred kilobytes, and gets a chunk when values of
it are read; the netCDF library reads the copy. It knows a file by its time of change, so that of a copy stays.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from ctypes import POINTER, byref, c_int, c_int64, c_uint, c_uint64
from dataclasses import astuple, dataclass, field, replace
from hashlib import sha256
from operator import attrgetter
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from xdynamics.archive.file_structure import library_handle, loaded_library
from xdynamics.archive.netcdf_library import opened_file, with_library_lock
from xdynamics.faults import ArchiveError

LEAST = 1 << 25  # bytes of a file from which on it has a list of extents
MOST_LISTED = MOST_STRUCTURE = 1 << 26  # bytes of the list, and of what is read at the opening
LARGEST = 1 << 24  # bytes of a chunk
AT_ONCE = 16  # extents at a time
MARK = b"\nxdynamics extents 1 "
FOOTER = len(MARK) + 12 + 1 + 64 + 1  # bytes behind the list
_FOOTER = re.compile(MARK + rb"(\d{12}) ([0-9a-f]{64})\n")
_NOWHERE = 2**64 - 1
_MOST_DIMS = 32


@dataclass(frozen=True)
class FileExtent:
    """Bytes of a file: a chunk, which begins at an index of a variable, or structure, which has no name."""

    start: int
    size: int
    digest: str = ""
    name: str = ""
    index: tuple[int, ...] = ()


def append_extents(path: Path) -> None:
    """Append the list of extents to a large file, before it is sealed; none if the library does not tell them."""
    size = path.stat().st_size
    library = loaded_library()
    if size < LEAST or not (hasattr(library, "H5Dget_num_chunks") and hasattr(library, "H5Dget_chunk_info")):
        return

    def entry(extent: FileExtent) -> tuple[Any, ...]:
        with path.open("rb") as file:
            file.seek(extent.start)
            return astuple(replace(extent, digest=sha256(file.read(extent.size)).hexdigest()))

    chunks = sorted(_chunks_of(path), key=attrgetter("start"))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        listed = json.dumps([*pool.map(entry, _with_gaps(chunks, size))], separators=(",", ":")).encode()
    with path.open("ab") as file:
        file.write(listed + MARK + f"{len(listed):012d} {sha256(listed).hexdigest()}\n".encode())


def _with_gaps(chunks: Sequence[FileExtent], size: int) -> Iterator[FileExtent]:
    """Yield chunks, and before, between and behind them the rest of a file of that size."""
    end = 0
    for chunk in [*chunks, FileExtent(size, 0)]:
        if end < chunk.start:
            yield FileExtent(end, chunk.start - end)
        if chunk.size:
            yield chunk
        end = chunk.start + chunk.size


@with_library_lock
def _chunks_of(path: Path) -> list[FileExtent]:
    """Return every chunk of a file."""
    library, chunks = loaded_library(), []
    count, index, mask, start, size = c_uint64(), (c_uint64 * _MOST_DIMS)(), c_uint(), c_uint64(), c_uint64()
    pointer = POINTER(c_uint64)
    library.H5Dget_num_chunks.argtypes = c_int64, c_int64, pointer
    library.H5Dget_chunk_info.argtypes = c_int64, c_int64, c_uint64, pointer, POINTER(c_uint), pointer, pointer
    library.H5Dget_num_chunks.restype = library.H5Dget_chunk_info.restype = c_int
    with opened_file(path) as file:
        dims = {name: variable.ndim for name, variable in file.variables.items() if variable.chunking() != "contiguous"}
    # the zeros are H5F_ACC_RDONLY, H5P_DEFAULT and H5S_ALL
    with library_handle("H5Fopen", os.fsencode(path.absolute()), 0, 0, close="H5Fclose") as root:
        for name, ndim in dims.items():
            with library_handle("H5Oopen", root, name.encode(), 0, close="H5Oclose") as values:
                library.H5Dget_num_chunks(values, 0, byref(count))
                for number in range(count.value):
                    library.H5Dget_chunk_info(values, 0, number, index, byref(mask), byref(start), byref(size))
                    if start.value != _NOWHERE:
                        chunks.append(FileExtent(start.value, size.value, name=name, index=tuple(index[:ndim])))
    return chunks


def extents_of(read: Callable[[int, int], bytes], end: int) -> list[FileExtent]:
    """Return the extents of a file before its seal, which begins at `end`.

    None if it is small, has no list of them, or if chunks or structure are larger than `save` makes them.

    Raises
    ------
    ArchiveError
        If the list is damaged.
    """
    footer = _FOOTER.fullmatch(read(end - FOOTER, end)) if end >= LEAST else None
    if footer is None or int(footer[1]) > min(MOST_LISTED, end - FOOTER):
        return []
    begin = end - FOOTER - int(footer[1])
    listed = read(begin, end - FOOTER)
    if sha256(listed).hexdigest() != footer[2].decode():
        raise ArchiveError("the list of its extents differs from its digest")
    try:
        extents = [
            FileExtent(int(start), int(size), str(digest), str(name), tuple(map(int, index)))
            for start, size, digest, name, index in json.loads(listed)
        ]
    except (ValueError, TypeError, OverflowError, RecursionError):
        extents = []
    starts = [extent.start for extent in extents]
    # all bytes of the file, in order
    if starts != [0, *(extent.start + extent.size for extent in extents)][:-1] or min(starts, default=-1) < 0:
        raise ArchiveError("the list of its extents is not of its bytes")
    if not extents or extents[-1].start + extents[-1].size != begin:
        raise ArchiveError("the list of its extents is not of its bytes")
    structure = sum(extent.size for extent in extents if not extent.name)
    is_usual = structure <= MOST_STRUCTURE and max(extent.size for extent in extents if extent.name) <= LARGEST
    return extents if is_usual else []


@dataclass
class PartialCopy:
    """A copy of a file, with the chunks that were read so far.

    Parameters
    ----------
    path : Path
        Of an empty file.
    location
        Of the original.
    read : callable
        Returns bytes of the original from one position to another.
    extents : list of FileExtent
        Of all of it; structure is copied now.
    size : int
        Bytes of it.
    """

    path: Path
    location: Any
    read: Callable[[int, int], bytes]
    extents: list[FileExtent] = field(repr=False)
    size: int
    _filling: Lock = field(default_factory=Lock)

    def __post_init__(self) -> None:
        os.truncate(self.path, self.size)
        self._fill([extent for extent in self.extents if not extent.name])

    def provide(self, name: str, widths: Sequence[int], shape: Sequence[int], key: tuple[Any, ...]) -> None:
        """Copy the chunks, of these widths, that hold values of a variable of this shape, unless they are here.

        Raises
        ------
        ArchiveError
            If bytes differ from their digest, or cannot be read or kept.
        """
        with self._filling:
            missing = [extent for extent in self.extents if extent.name == name]
            starts = [*map(_chunk_starts, key, widths, shape)]
            self._fill([chunk for chunk in missing if all(map(set.__contains__, starts, chunk.index))])

    def _fill(self, extents: list[FileExtent]) -> None:
        if not extents:
            return
        with ThreadPoolExecutor(AT_ONCE) as pool:
            for begin in range(0, len(extents), AT_ONCE):
                batch = extents[begin : begin + AT_ONCE]
                self._write(batch, [*pool.map(self._checked_content, batch)])
        filled = {extent.start for extent in extents}
        self.extents = [extent for extent in self.extents if extent.start not in filled]

    def _checked_content(self, extent: FileExtent) -> bytes:
        content = self.read(extent.start, extent.start + extent.size)
        if sha256(content).hexdigest() != extent.digest:
            what = f"variable '{extent.name}' from {list(extent.index)} on" if extent.name else "its structure"
            raise ArchiveError(
                f"'{self.location}' is damaged, or was replaced since it was opened: {what} differs from its digest"
            )
        return content

    @with_library_lock
    def _write(self, extents: list[FileExtent], contents: list[bytes]) -> None:
        status = self.path.stat()
        try:
            with self.path.open("r+b") as file:
                for extent, content in zip(extents, contents, strict=True):
                    file.seek(extent.start)
                    file.write(content)
        except OSError as error:
            raise ArchiveError(
                f"values of '{self.location}' need a temporary file in '{self.path.parent}', which cannot be written:"
                f" {error.strerror or error}; name another folder by TMPDIR"
            ) from None
        finally:
            os.utime(self.path, ns=(status.st_atime_ns, status.st_mtime_ns))


def _chunk_starts(index: Any, width: int, size: int) -> set[int]:
    """Return where the chunks of this width begin, along a dimension of this size, in which rows of an index are."""
    rows = index
    if isinstance(index, slice):
        rows = range(*index.indices(size))
        if rows and abs(rows.step) <= width:  # every chunk between two rows
            rows = range(min(rows[0], rows[-1]) // width * width, max(rows[0], rows[-1]) + 1, width)
    return set((np.atleast_1d(rows).astype(np.int64) % max(1, size) // width * width).tolist())
