"""Archives that stay open: how xarray reaches a file long after it was opened, from any thread or process."""

from __future__ import annotations

import atexit
import gc
from collections import OrderedDict
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakSet, ref

from xdynamics.archive.file_structure import size_faults
from xdynamics.archive.netcdf_library import close_later, close_left, file_at, with_library_lock
from xdynamics.archive.store import LocalFile
from xdynamics.faults import ArchiveError, numbered_lines

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import netCDF4
    import xarray as xr

LAZY = 1 << 26  # bytes of a file from which on it is copied chunk by chunk
MOST_REPLACED = 20  # times that a file's name may go to another while it is read
MOST_OPEN = 128  # files at a time; what was used longest ago is closed, and opened again when it is read

Identity = tuple[int, int, int, int]  # device, inode, size, time of the last change

# by id: the archive as a key would be kept alive, and its finaliser never run
_open: OrderedDict[int, netCDF4.Dataset] = OrderedDict()
_archives: WeakSet[SharedArchive] = WeakSet()
_kept_open: set[int] = set()  # of those whose name another file has taken or is to take: they could not be opened again


class SharedArchive:
    """One archive for xarray's backend, opened whenever it is needed.

    It is the same file each time: if another has taken its name, or it was written to, that is an error and never a
    number of another run. A copy of what is in a store bears the name that it has there, and is fetched again in another
    process.
    """

    def __init__(self, path: Path, identity: Identity | None = None, local_file: LocalFile | None = None) -> None:
        self.path, self.local_file = path.absolute(), local_file
        self.location = local_file.location if local_file else self.path
        self.partial = local_file.partial if local_file else None
        self.identity = identity or identity_of(path)
        self.in_use = True
        _register_archive(self)

    @with_library_lock
    def acquire(self, needs_lock: bool = True) -> netCDF4.Dataset:  # noqa: ARG002, FBT001, FBT002 - xarray's signature
        """Return the open file."""
        file = _open.get(id(self))
        if file is None or not file.isopen():  # closed where the file was overwritten and opened anew
            file = _open[id(self)] = self._reopened()
            for oldest in [key for key in _open if key not in _kept_open][: max(0, len(_open) - MOST_OPEN)]:
                _open.pop(oldest).close()
        _open.move_to_end(id(self))
        return file

    def acquire_context(self, needs_lock: bool = True) -> Any:  # noqa: FBT001, FBT002 - xarray's signature
        """Return the open file for a `with` statement, which does not close it."""
        return nullcontext(self.acquire(needs_lock))

    @with_library_lock
    def close(self, needs_lock: bool = True) -> None:  # noqa: ARG002, FBT001, FBT002 - xarray's signature
        """Close the file; its name may go to another from now on, though this one may still be read again."""
        self.in_use = False
        _kept_open.discard(id(self))
        file = _open.pop(id(self), None)
        if file is not None:
            file.close()

    def check_unchanged(self) -> None:
        """Check that the file was not overwritten while it was open.

        Raises
        ------
        ArchiveError
            If it was. Another file under its name does no harm: the open one is unchanged.
        """
        try:
            _, inode, *now = identity_of(self.path)
        except OSError:  # removed, and readable as long as it is open
            return
        _, opened_inode, *then = self.identity
        if inode == opened_inode and now != then:
            raise ArchiveError(f"'{self.location}' was overwritten while it was open; open it again")

    def _reopened(self) -> netCDF4.Dataset:
        self._check_identity()  # before, too: the library follows links, and another file has not been examined
        file = file_at(self.path)
        try:
            self._check_identity()
        except ArchiveError:
            file.close()
            raise
        return file

    def _check_identity(self) -> None:
        if identity_of(self.path)[1:] != self.identity[1:]:  # a device has another number on another machine
            raise ArchiveError(f"'{self.location}' is another file than the one that was opened; open it again")

    def __del__(self) -> None:
        # this may run in any thread at any point: it must not wait
        if _open is None:  # the interpreter is shutting down
            return
        _kept_open.discard(id(self))
        file = _open.pop(id(self), None)
        if file is not None:
            close_later(file)

    def __reduce__(self) -> tuple[Any, ...]:
        if self.local_file and self.local_file.fetch_again:
            return _reopened_copy, (self.local_file.fetch_again,)
        return SharedArchive, (self.path, self.identity)


def _reopened_copy(fetch_again: Callable[[], LocalFile]) -> SharedArchive:
    local_file = fetch_again()
    return SharedArchive(local_file.path, local_file=local_file)


@with_library_lock
def open_shared(
    path: Path, identity: Identity | None = None, local_file: LocalFile | None = None, *, as_stored: bool = False
) -> xr.Dataset:
    """Open an archive as a Dataset whose variables are read when they are used, by any thread.

    Parameters
    ----------
    path : Path
    identity : optional
        Of the expected file, if it was examined before.
    local_file : LocalFile, optional
        If it is one of a store.
    as_stored : bool
        Whether texts that are kept as numbers stay numbers, coordinates are not told from data, and a large file is given
        as dask arrays of its chunks.

    Raises
    ------
    ArchiveError
        If it is another file, or larger than it can be.
    """
    import xarray as xr

    from xdynamics.archive.stored_values import NumberStore, VariableStore

    archive = _open_untorn(path) if identity is None else SharedArchive(path, identity, local_file)
    if faults := size_faults(path, archive.acquire(), is_partial=archive.partial is not None):
        raise ArchiveError(f"'{archive.location}' is damaged or no run archive:{numbered_lines(faults)}", tuple(faults))
    store = (NumberStore if as_stored else VariableStore)(archive, mode="r")  # type: ignore[no-untyped-call]
    chunks: Any = {} if as_stored and path.stat().st_size > LAZY else None
    # undecoded: values are to have the bits that were recorded, and no time becomes a calendar date
    run = xr.open_dataset(store, decode_times=False, mask_and_scale=False, decode_coords=not as_stored, chunks=chunks)
    run.encoding["source"] = str(local_file.location if local_file else path)
    run.set_close(_Closing(archive))
    return run


def _open_untorn(path: Path) -> SharedArchive:
    """Open a file, again if another took its name at that moment."""
    for _ in range(MOST_REPLACED):
        archive = SharedArchive(path)
        try:
            archive.acquire()
        except ArchiveError as error:
            last = error
        else:
            return archive
    raise last


class _Closing:
    """Closes an archive without keeping it open: once every variable is in memory, the file is not needed any more."""

    def __init__(self, archive: SharedArchive | None) -> None:
        self._one = ref(archive) if archive is not None else lambda: None

    def __call__(self) -> None:
        archive = self._one()
        if archive is not None:
            archive.close()
        close_left()  # one that nothing reads any more, as all is in memory, was left to be closed

    def __reduce__(self) -> tuple[Any, ...]:
        return _Closing, (self._one(),)


@with_library_lock
def keep_open(path: Path) -> None:
    """Keep the open archives of a file that is about to be replaced: their values are read from the old file."""
    for archive in _readers(path):
        archive.acquire()
        _kept_open.add(id(archive))


def is_still_read(path: Path) -> bool:
    """Whether runs of this process have values to read from a file that is not kept open for them."""
    if not any(_readers(path)):
        return False
    gc.collect()  # unreachable runs that wait to be collected
    return any(_readers(path))


def _readers(path: Path) -> Iterator[SharedArchive]:
    try:
        device, inode, *_ = identity_of(path)
    except OSError:
        return
    yield from (archive for archive in _registered_archives() if _is_reader(archive, (device, inode)))


def _is_reader(archive: SharedArchive, inode: tuple[int, int]) -> bool:
    return archive.in_use and id(archive) not in _kept_open and archive.identity[:2] == inode


@with_library_lock
def _register_archive(archive: SharedArchive) -> None:
    _archives.add(archive)


@with_library_lock
def _registered_archives() -> list[SharedArchive]:
    return list(_archives)


def identity_of(path: Path) -> Identity:
    """Return the identity that distinguishes versions of a file under one name."""
    status = path.stat()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


@atexit.register
@with_library_lock
def _close_all_archives() -> None:
    """Close all open archives: a file collected during the interpreter's shutdown prints errors."""
    while _open:
        close_later(_open.popitem()[1])
    close_left()
