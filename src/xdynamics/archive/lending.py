"""Archives that stay open: how xarray comes to a file again, long after it was opened, from any thread or process."""

from __future__ import annotations

import atexit
import gc
import os
from collections import OrderedDict
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any
from weakref import WeakSet, ref

from xdynamics.archive.bounds import oversize
from xdynamics.archive.library import alone, close_left, file_at, leave
from xdynamics.faults import ArchiveError, numbered

if TYPE_CHECKING:
    from collections.abc import Iterator

    import netCDF4
    import xarray as xr

MOST_REPLACED = 20  # times that a file's name may go to another while it is read
MOST_OPEN = 128  # files at a time; what was used longest ago is closed, and opened again when it is read

Identity = tuple[int, int, int, int]  # device, inode, size, time of the last change

_open: OrderedDict[int, netCDF4.Dataset] = OrderedDict()
_lent: WeakSet[Lent] = WeakSet()


class Lent:
    """One archive as xarray's backend asks for it, opened whenever it is wanted.

    It is the same file each time: where another has taken its name, or it was written to, that is an error and no
    number of another run.
    """

    def __init__(self, path: Path, identity: Identity | None = None) -> None:
        self.path = path.absolute()
        self.identity = identity or identity_of(path)
        self.in_use = True
        _enter(self)

    @alone
    def acquire(self, needs_lock: bool = True) -> netCDF4.Dataset:  # noqa: ARG002, FBT001, FBT002 - xarray's signature
        """Return the open file."""
        file = _open.get(id(self))
        if file is None or not file.isopen():  # closed where the file was overwritten and opened anew
            file = _open[id(self)] = self._reopened()
            while len(_open) > MOST_OPEN:
                _open.popitem(last=False)[1].close()
        _open.move_to_end(id(self))
        return file

    def acquire_context(self, needs_lock: bool = True) -> Any:  # noqa: FBT001, FBT002 - xarray's signature
        """Return the open file for a `with` statement, which does not close it."""
        return nullcontext(self.acquire(needs_lock))

    @alone
    def close(self, needs_lock: bool = True) -> None:  # noqa: ARG002, FBT001, FBT002 - xarray's signature
        """Close the file; its name may be given to another from now on, though this one may still be read again."""
        self.in_use = False
        file = _open.pop(id(self), None)
        if file is not None:
            file.close()

    def check_unchanged(self) -> None:
        """Refuse what was read of a file that was overwritten while it was open.

        Raises
        ------
        ArchiveError
            If it was. Another file under its name does no harm: what is open is still the one that it was.
        """
        try:
            _, inode, *now = identity_of(self.path)
        except OSError:  # removed, and readable as long as it is open
            return
        _, own, *then = self.identity
        if inode == own and now != then:
            raise ArchiveError(f"'{self.path}' was overwritten while it was open; open it again")

    def _reopened(self) -> netCDF4.Dataset:
        self._check_identity()  # before, too: the library follows what is in a file, and nobody has looked at another one
        file = file_at(self.path)
        try:
            self._check_identity()
        except ArchiveError:
            file.close()
            raise
        return file

    def _check_identity(self) -> None:
        if identity_of(self.path)[1:] != self.identity[1:]:  # a device has another number on another machine
            raise ArchiveError(f"'{self.path}' is another file than the one that was opened; open it again")

    def __del__(self) -> None:
        # in whatever thread, and in the midst of whatever: it must not wait
        if _open is None:  # the interpreter is half gone
            return
        file = _open.pop(id(self), None)
        if file is not None:
            leave(file)

    def __reduce__(self) -> tuple[Any, ...]:
        return Lent, (self.path, self.identity)


@alone
def lent(path: Path, identity: Identity | None = None) -> xr.Dataset:
    """Open an archive as a Dataset whose variables are read when they are used, by any thread.

    Parameters
    ----------
    path : Path
    identity : optional
        Of the file that it has to be, where it was looked at before.

    Raises
    ------
    ArchiveError
        If it is another file, or larger than it can be.
    """
    import xarray as xr

    from xdynamics.archive.values import Store

    one = _settled(path) if identity is None else Lent(path, identity)
    if faults := oversize(path, one.acquire()):
        raise ArchiveError(f"'{path}' is damaged or no run archive:{numbered(faults)}", tuple(faults))
    store = Store(one, mode="r")  # type: ignore[no-untyped-call]
    run = xr.open_dataset(store, decode_times=False, mask_and_scale=False)
    run.encoding["source"] = os.fspath(path)
    run.set_close(_Closing(one))
    return run


def _settled(path: Path) -> Lent:
    """Open a file, anew where another has taken its name in the very moment."""
    for _ in range(MOST_REPLACED):
        one = Lent(path)
        try:
            one.acquire()
        except ArchiveError as error:
            last = error
        else:
            return one
    raise last


class _Closing:
    """Closes an archive; it does not keep it open: when every variable is in memory, nobody needs the file any more."""

    def __init__(self, one: Lent | None) -> None:
        self._one = ref(one) if one is not None else lambda: None

    def __call__(self) -> None:
        one = self._one()
        if one is not None:
            one.close()

    def __reduce__(self) -> tuple[Any, ...]:
        return _Closing, (self._one(),)


def is_lent(path: Path) -> bool:
    """Tell whether variables of a run in this process still have to be read from a file."""
    if not any(_readers(path)):
        return False
    gc.collect()  # runs that nobody can use any more, but that wait to be collected
    return any(_readers(path))


def _readers(path: Path) -> Iterator[Lent]:
    try:
        device, inode, *_ = identity_of(path)
    except OSError:
        return
    yield from (one for one in _all() if one.in_use and one.identity[:2] == (device, inode))


@alone
def _enter(one: Lent) -> None:
    _lent.add(one)


@alone
def _all() -> list[Lent]:
    return list(_lent)


def identity_of(path: Path) -> Identity:
    """Return what tells a file from another under its name."""
    about = path.stat()
    return about.st_dev, about.st_ino, about.st_size, about.st_mtime_ns


@atexit.register
@alone
def _end() -> None:
    """Close what is still open: a file that is collected by an interpreter half gone complains on the terminal."""
    while _open:
        leave(_open.popitem()[1])
    close_left()
