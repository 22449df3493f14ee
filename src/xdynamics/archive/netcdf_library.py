"""The netCDF4 library, which one thread at a time may use: its lock, the opening of files, and files left open.

Neither netCDF-C nor HDF5 tolerates two threads, not even on two files. xarray has locks of its own for them; these
locks and the package's own are taken together, so that files opened here and files opened by xarray do not interfere.

HDF5 knows a file by its inode. If another archive is copied over one that this process has open, or that the library
could not close because it is damaged, the old file's structure is read with the new file's bytes.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import lru_cache, wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar
from weakref import WeakSet

from xdynamics.faults import ArchiveError

if TYPE_CHECKING:
    import netCDF4

Inode = tuple[int, int]
State = tuple[int, int]  # size, time of the last change


@dataclass(frozen=True)
class Opening:
    """One file of the disk, as it was when it was opened for reading."""

    state: State
    files: WeakSet[Any] = field(default_factory=WeakSet)


class Openings:
    """Files that were opened and not closed properly, by inode; used under the lock of the library."""

    def __init__(self) -> None:
        self._by_inode: dict[Inode, Opening] = {}

    def opening_of(self, path: Path) -> Opening:
        """Return the opening of a file that is about to be opened; close those from before it was overwritten.

        Raises
        ------
        ArchiveError
            If the library keeps the old one open nevertheless.
        """
        status = path.stat()
        inode, state = (status.st_dev, status.st_ino), (status.st_size, status.st_mtime_ns)
        earlier_opening = self._by_inode.get(inode)
        if earlier_opening and earlier_opening.state != state:
            for file in list(earlier_opening.files):
                with suppress(RuntimeError):
                    file.close()
            if _is_held(inode):
                self._by_inode[inode] = earlier_opening  # `closed` forgot it: whoever tries again is refused again
                raise ArchiveError(
                    f"'{path}' was overwritten while this process had it open, and the netCDF library would mix what it"
                    " was with what it is: copy it to another name, or read it in a new process"
                )
            self._by_inode.pop(inode, None)
        return self._by_inode.setdefault(inode, Opening(state))

    def closed(self, file: Any) -> None:
        """Forget a file that was closed properly."""
        for inode, opening in list(self._by_inode.items()):
            if file in opening.files:
                opening.files.discard(file)
                if not opening.files:
                    del self._by_inode[inode]


openings = Openings()


def _is_held(inode: Inode) -> bool:
    """Whether this process has a file open; False if the system does not say."""
    with suppress(OSError):
        for descriptor in Path("/dev/fd").iterdir():
            with suppress(OSError):
                status = os.fstat(int(descriptor.name))
                if (status.st_dev, status.st_ino) == inode:
                    return True
    return False


Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

# what the libraries raise on files that are damaged or of another kind
DAMAGE = (OSError, RuntimeError, ValueError, AttributeError, LookupError, TypeError, MemoryError, OverflowError)


READ_CACHE = 1 << 20  # bytes of chunks that are kept in memory of each variable that is read


def error_text(error: Exception) -> str:
    """Return the text of an error; its type's name if it has none, as a MemoryError."""
    return str(error) or type(error).__name__


_library_lock = threading.RLock()
_files_to_close: list[Any] = []


def with_library_lock(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Make a function run while no other thread is in the library; such functions may call each other.

    The locks are held for one call of the library or a few in a row, never while a caller's code runs or another thread
    is waited for. Ours is first, xarray's follow in its own order; who holds xarray's never asks for ours. All are locks
    of the interpreter, taken by `with` itself: no Ctrl-C comes between a lock and its release, as it does between the
    lines of a lock that is written in Python.
    """

    @wraps(function)
    def locked_call(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
        if _library_lock._is_owned():  # type: ignore[attr-defined]  # noqa: SLF001 - as `threading.Condition` asks
            return function(*args, **kwargs)
        first, second = _locks_of_xarray()
        with _library_lock, first, second:
            return function(*args, **kwargs)

    return locked_call


def _locks_of_xarray() -> list[Any]:
    """Return the two locks that xarray takes around the library, in its order; others while it is not imported."""
    backend = sys.modules.get("xarray.backends.netCDF4_")
    combined = getattr(getattr(backend, "NETCDF4_PYTHON_LOCK", None), "locks", ())
    locks = [lock.lock for lock in combined if hasattr(lock, "lock")]
    return [*locks, threading.Lock(), threading.Lock()][:2]


_forking: list[Any] = []


def _before_fork() -> None:
    # whoever owns ours holds xarray's as well, and those are not reentrant
    theirs = [] if _library_lock._is_owned() else _locks_of_xarray()  # type: ignore[attr-defined]  # noqa: SLF001
    _library_lock.acquire()
    for lock in theirs:
        lock.acquire()
    _forking[:] = [_library_lock, *theirs]


def _after_fork() -> None:
    while _forking:
        _forking.pop().release()


# a child that is forked while another thread is in the library would find its lock taken for ever, and its state inconsistent
os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork)


def close_later(file: netCDF4.Dataset) -> None:
    """Leave a file to be closed when the next one is opened; for finalisers, which must not wait for the lock."""
    _files_to_close.append(file)


@with_library_lock
def close_left() -> None:
    """Close the files that finalisers left."""
    while _files_to_close:
        with suppress(RuntimeError):
            _files_to_close.pop().close()


@with_library_lock
def file_at(path: Path, mode: Literal["r", "w"] = "r") -> netCDF4.Dataset:
    """Open a file with the library.

    The library takes texts, and a file's name is bytes: Latin-1 makes every name a text, and back without loss.
    The library also skips blanks at the beginning of a name, which an absolute one has not.

    Raises
    ------
    ArchiveError
        If the library still has the file open as it was before it was overwritten.
    """
    close_left()
    name = os.fsencode(path.absolute()).decode("latin-1")
    opening = openings.opening_of(path) if mode == "r" else None
    try:
        file = _open_by_library(name, mode)
    except BaseException:
        gc.collect()  # a file that was opened half is closed now, under the lock, not by whatever thread collects later
        raise
    if opening:
        opening.files.add(file)
    return file


def _open_by_library(name: str, mode: Literal["r", "w"]) -> netCDF4.Dataset:
    """Open a file; for reading, the chunk cache is small, as each chunk is read once and in order.

    The library takes the size from a setting of the process when a file is opened, and would keep 64 MiB of each variable.
    To set it afterwards is no way: in a file with a variable that bears the name of a dimension which it does not have,
    the library then reads from another one.
    """
    import netCDF4

    if mode == "w":
        return _kind_of_file()(name, mode, encoding="latin-1", format="NETCDF4")
    cache_settings = netCDF4.get_chunk_cache()
    netCDF4.set_chunk_cache(min(cache_settings[0], READ_CACHE), *cache_settings[1:])
    try:
        file = _kind_of_file()(name, mode, encoding="latin-1", format="NETCDF4")
    finally:
        netCDF4.set_chunk_cache(*cache_settings)
    dimensions: dict[str, Any] = file.dimensions
    dimensions.update({name: _MeasuredDimension(dimension) for name, dimension in dimensions.items()})
    return file


class _MeasuredDimension:
    """A dimension of a file that is read, whose length is asked for once.

    The library finds the length of an unlimited one, as every one without rows is, by asking each variable of the file, and
    does so whenever the shape of a variable along it is read: in a file of 3,600 variables that takes milliseconds.
    """

    def __init__(self, dimension: Any) -> None:
        self._dimension, self._length = dimension, len(dimension)

    def __len__(self) -> int:
        return self._length

    def __getattr__(self, name: str) -> Any:
        return getattr(self._dimension, name)


@lru_cache
def _kind_of_file() -> type[netCDF4.Dataset]:
    import netCDF4

    class File(netCDF4.Dataset):
        """A file that reports its own name, whatever its bytes, and is closed once."""

        def filepath(self, encoding: str | None = None) -> str:
            name = super().filepath(encoding="latin-1").encode("latin-1")
            return name.decode(encoding) if encoding else os.fsdecode(name)

        def close(self) -> memoryview:
            if not self.isopen():
                return memoryview(b"")
            try:
                closed = super().close()
            except Exception:
                # netCDF-C may have freed half of it: the finaliser, which closes what says that it is open, would use
                # what is free. A plain assignment would write an attribute into the file.
                netCDF4.Dataset.__dict__["_isopen"].__set__(self, 0)
                raise
            openings.closed(self)
            return closed

    return File


@with_library_lock
def close_file(file: netCDF4.Dataset) -> None:
    """Close a file."""
    file.close()


@contextmanager
def opened_file(path: Path, mode: Literal["r", "w"] = "r") -> Iterator[netCDF4.Dataset]:
    """Open a file, and close it. Other threads may use the library in between: read and write under `with_library_lock`."""
    file = file_at(path, mode)
    try:
        with_library_lock(file.set_auto_maskandscale)(mode == "w")
        yield file
    finally:
        close_file(file)


@with_library_lock
def read_stored(variable: Any, key: Any) -> Any:
    """Return values of a variable as they are stored."""
    return variable[key]


@with_library_lock
def stored_attributes(owner: Any) -> dict[str, Any]:
    """Return the attributes of a file or a variable."""
    return {key: owner.getncattr(key) for key in owner.ncattrs()}
