"""A Zarr store that is read, each file of which is compared with its digest: of an exchanged or lost one nothing is read."""

from __future__ import annotations

import asyncio
import stat
from collections.abc import AsyncIterator, Callable, Iterable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from math import prod
from typing import Any

import zarr.abc.store
from zarr.abc.store import OffsetByteRequest, RangeByteRequest, SuffixByteRequest
from zarr.core.buffer import default_buffer_prototype

from xdynamics.archive.store import Address, Place
from xdynamics.faults import ArchiveError
from xdynamics.runtime.files import is_inside, read_bounded

ZSTD = "zstd"
_MAGIC = b"\x28\xb5\x2f\xfd"


@dataclass(frozen=True)
class FileDigest:
    """What is known of a file of a store: its bytes, and their sha256."""

    size: int
    digest: str


@dataclass(frozen=True)
class ChunkForm:
    """How chunks of an array are packed.

    Attributes
    ----------
    items : int
        Of a chunk.
    width : int
        Bytes of an item; 0 of texts of any length.
    packed : bool
        Whether they are compressed.
    """

    items: int
    width: int
    packed: bool

    def fault(self, content: bytes) -> str:
        """Describe why a chunk does not unpack to its array's items; empty if it does."""
        if self.packed:
            return (
                "" if unpacked_size(content) == self.items * self.width else "is packed otherwise than its array says"
            )
        if self.width:
            return "" if len(content) == self.items * self.width else "has another size than its array says"
        # of texts: their number, then each with its length
        return (
            ""
            if int.from_bytes(content[:4], "little") == self.items
            else "has another number of texts than its array says"
        )


def unpacked_size(content: bytes) -> int:
    """Return how many bytes one frame of Zstandard unpacks to, as it says; -1 if it does not, or is not one frame (RFC 8878, 3.1)."""
    if content[:4] != _MAGIC or len(content) < 9:
        return -1
    descriptor = content[4]
    is_single, size_flag, dictionary_flag = descriptor >> 5 & 1, descriptor >> 6, descriptor & 3
    if dictionary_flag or descriptor >> 3 & 1:
        return -1
    width = (is_single, 2, 4, 8)[size_flag]
    begin = 6 - is_single  # behind the window's size, which a single segment has not
    size = int.from_bytes(content[begin : begin + width], "little") + (256 if width == 2 else 0)
    if not width:
        return -1
    position, last = begin + width, 0
    while not last and position + 3 <= len(content):
        header = int.from_bytes(content[position : position + 3], "little")
        last, kind, length = header & 1, header >> 1 & 3, header >> 3
        position += 3 + (1 if kind == 1 else length)  # a block of one repeated byte has that alone
    return size if last and position + 4 * (descriptor >> 2 & 1) == len(content) else -1


class ComparedStore(zarr.abc.store.Store):
    """The files of a store by their digests.

    Parameters
    ----------
    location : Path or Address
    folders : tuple of Path or Address
        Where the files are looked for, in this order.
    files : mapping of str to FileDigest
    forms : mapping of str to ChunkForm
        Of arrays, by name.
    reopen : callable
        Returns it in another process, by its location and identity.
    """

    supports_writes = supports_deletes = supports_partial_writes = False
    supports_listing = True

    def __init__(
        self,
        location: Place,
        folders: tuple[Place, ...],
        files: Mapping[str, FileDigest],
        forms: Mapping[str, ChunkForm],
        reopen: Callable[[Place, str], ComparedStore],
    ) -> None:
        super().__init__(read_only=True)
        self.location, self.folders, self.files, self.forms = location, folders, files, forms
        self._reopen = reopen

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ComparedStore) and self.location == other.location and self.files == other.files

    __hash__ = object.__hash__

    def __str__(self) -> str:
        return str(self.location)

    def __reduce__(self) -> Any:
        return self._reopen, (self.location, self.identity)

    @property
    def identity(self) -> str:
        """A digest of all digests."""
        return sha256(repr(sorted((name, file.digest) for name, file in self.files.items())).encode()).hexdigest()

    def read(self, key: str) -> bytes:
        """Read a file, compared with its digest.

        Raises
        ------
        ArchiveError
            Naming the file, if it is missing, no regular file, or another than was written.
        """
        file = self.files[key]
        content = None
        for folder in self.folders:
            if (content := _file_content(folder, key, file.size)) is not None:
                break
        what = f"file '{key}' of '{self.location}'"
        if content is None:
            raise ArchiveError(f"{what} is missing", (f"file '{key}' is missing",))
        if len(content) != file.size or sha256(content).hexdigest() != file.digest:
            raise ArchiveError(
                f"{what} differs from its digest: it is damaged, or was replaced since '{self.location}' was opened",
                (f"file '{key}' differs from its digest",),
            )
        form = self.forms.get(key.partition("/")[0])
        if form is not None and not key.endswith("zarr.json") and (fault := form.fault(content)):
            raise ArchiveError(f"{what} {fault}", (f"file '{key}' {fault}",))
        return content

    async def get(self, key: str, prototype: Any = None, byte_range: Any = None) -> Any:
        """Return the content of a file, or a part of it; None of a name that is none of the store's."""
        if key not in self.files:
            return None
        content = await asyncio.to_thread(self.read, key)
        match byte_range:
            case RangeByteRequest(start, end):
                content = content[start:end]
            case OffsetByteRequest(offset):
                content = content[offset:]
            case SuffixByteRequest(suffix):
                content = content[-suffix:]
        return (prototype or default_buffer_prototype()).buffer.from_bytes(content)

    async def get_partial_values(self, prototype: Any, key_ranges: Iterable[tuple[str, Any]]) -> list[Any]:
        """Return parts of files."""
        return list(await asyncio.gather(*(self.get(key, prototype, part) for key, part in key_ranges)))

    async def exists(self, key: str) -> bool:
        """Whether there is a digest of a file."""
        return key in self.files

    async def set(self, key: str, value: Any) -> None:
        """Refuse to write."""
        raise NotImplementedError

    async def delete(self, key: str) -> None:
        """Refuse to remove."""
        raise NotImplementedError

    async def list(self) -> AsyncIterator[str]:
        """List the files."""
        for key in self.files:
            yield key

    async def list_prefix(self, prefix: str) -> AsyncIterator[str]:
        """List the files whose names begin so."""
        for key in self.files:
            if key.startswith(prefix):
                yield key

    async def list_dir(self, prefix: str) -> AsyncIterator[str]:
        """List what is in a folder."""
        begin = f"{prefix.rstrip('/')}/".lstrip("/")
        for name in {key.removeprefix(begin).partition("/")[0] for key in self.files if key.startswith(begin)}:
            yield name


def _file_content(folder: Place, key: str, size: int) -> bytes | None:
    """Return the content of a file, a byte more than expected at most; None if it does not exist."""
    if isinstance(folder, Address):
        from xdynamics.archive.filesystems import RefusedError, fetch, refusal_error, status_of

        try:
            return fetch(folder / key, 0, size) if size else b"" if status_of(folder / key) else None
        except RefusedError as error:
            if error.is_absent:
                return None
            raise refusal_error(folder / key, "cannot be read", error) from None
    path = folder / key
    try:
        kind = path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None
    if not stat.S_ISREG(kind) or not is_inside(path, folder):
        raise ArchiveError(
            f"file '{key}' of '{folder}' is no regular file of this store", (f"file '{key}' is no regular file",)
        )
    if path.stat().st_size > size:
        return b""
    return read_bounded(path, size)


def chunk_form(array: Mapping[str, Any]) -> ChunkForm:
    """Return how the chunks of an array are packed, from its metadata."""
    chunk_shape = array["chunk_grid"]["configuration"]["chunk_shape"]
    width = (
        0 if array["data_type"] == "string" else max(1, int("".join(filter(str.isdigit, array["data_type"])) or 8) // 8)
    )
    return ChunkForm(prod(chunk_shape), width, any(codec["name"] == ZSTD for codec in array["codecs"]))
