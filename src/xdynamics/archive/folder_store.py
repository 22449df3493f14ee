"""The file system as a store: temporary names, synchronisation, renaming, and locks of the operating system.

A folder is written complete or not at all: it is built under another name, and renamed when every file is on the disk.

`store_of` returns the store of a location: the file system, or what fsspec reaches.
"""

from __future__ import annotations

import errno
import fcntl
import os
import re
import secrets
import shutil
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive import store, target
from xdynamics.archive.shared_handles import identity_of
from xdynamics.archive.store import (
    DIGESTS,
    FOLDER,
    NOTES,
    READABLE,
    ZARR,
    Address,
    LocalFile,
    LockedError,
    NewFile,
    Place,
    Store,
    check_no_backslash,
    check_writable,
)
from xdynamics.archive.target import LONGEST, is_ours, sweep_temporary_files, try_lock
from xdynamics.faults import ArchiveError, InputError
from xdynamics.runtime.files import ask_path, file_above, make_folder, path_kind, read_bounded, synced

if TYPE_CHECKING:
    from xdynamics.archive.target import Batch
    from xdynamics.model import Model

BUILT = ".building"


@contextmanager
def new_folder_at(path: Path) -> Iterator[Path]:
    """Lend a folder beside a path, which takes the path's name, complete, when the `with` block is done.

    Remains of killed processes under the same name are removed. Of two processes the first takes the name.

    Raises
    ------
    InputError
        If something has that name: before anything is done, or in the end if another process was faster.
    ArchiveError
        If it cannot be written.
    """
    target = ask_path(path, Path.resolve)
    check_folder_empty(path)
    make_folder(target.parent)
    try:
        _sweep_dead_folders(target)
        built, handle = _make_locked_folder(target)
        try:
            yield built
            _rename_built_folder(built, target)
        finally:
            os.close(handle)
            shutil.rmtree(built, ignore_errors=True)
    except OSError as error:
        # the rename met what another process put there meanwhile: name that, not the system's word for it
        if error.errno in (errno.ENOTEMPTY, errno.EEXIST, errno.ENOTDIR):
            check_folder_empty(path)
        raise ArchiveError(
            f"'{path}' cannot be written: {error.strerror or error}; nothing is changed there"
        ) from error


def check_folder_empty(path: Path) -> None:
    """Check that a path is an empty folder, or does not exist.

    Raises
    ------
    InputError
        If it is anything else.
    """
    kind = ask_path(path, path_kind)
    if kind not in ("", "a directory"):
        raise InputError(f"'{path}' is {kind or 'a file'}; name a folder")
    if kind and (names := sorted(entry.name for entry in path.iterdir())):
        raise InputError(f"'{path}' holds '{names[0]}' already; name a folder that is empty, or not there")


def _rename_built_folder(built: Path, target: Path) -> None:
    if target.is_dir():
        # the empty folder that is replaced passes on its rights
        shutil.copymode(target, built)
    # files first, then the folder: after a power cut the new name must not stand for files that are not on the disk
    for file in built.iterdir():
        with synced(file):
            pass
    with synced(built):
        pass
    built.rename(target)  # replaces an empty folder, and fails on any other
    # a rename is durable only once the folder that holds the name is
    with synced(target.parent):
        pass


def _make_locked_folder(target: Path) -> tuple[Path, int]:
    """Make a folder beside a path, locked as long as this process lives."""
    while True:
        built = target.with_name(f"{_stem(target)}{secrets.token_hex(4)}{BUILT}")
        built.mkdir()
        with suppress(FileNotFoundError):  # another process may sweep it away before it is locked, or even opened
            handle = os.open(built, os.O_RDONLY | os.O_CLOEXEC)
            if _try_folder_lock(handle) and built.exists():
                return built, handle
            os.close(handle)


def _sweep_dead_folders(target: Path) -> None:
    """Remove unfinished folders that dead processes began for a target."""
    names = re.compile(re.escape(_stem(target)) + r"[0-9a-f]{8}" + re.escape(BUILT))
    for folder in target.parent.iterdir():
        if not names.fullmatch(folder.name) or folder.is_symlink() or not folder.is_dir():
            continue
        with suppress(OSError):
            # O_NOFOLLOW: a link may have taken the name since it was looked at
            handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
            try:
                if _try_folder_lock(handle):
                    shutil.rmtree(folder, ignore_errors=True)
            finally:
                os.close(handle)


def _try_folder_lock(handle: int) -> bool:
    """Lock a folder, unless another process has it locked; on a file system without locks it counts as this one's."""
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True
    return True


def _stem(target: Path) -> str:
    # 8 digits of the token and 2 points; file systems limit bytes, not letters
    room = LONGEST - len(BUILT) - 8 - 2
    return f".{os.fsdecode(os.fsencode(target.name)[:room])}."


class FolderStore:
    """Folders of the file system; see `Store`."""

    def check_source(self, location: Path) -> None:
        """Check that there is a regular file."""
        store.check_source(location)

    def check_target(self, location: Path, model: Model | None = None) -> None:
        """Check the name, what it leads to, its folder, and that it is no file of the model nor open here."""
        target.check_path_target(location, model)

    def check_no_table(self, location: Path, tables: list[str]) -> None:
        """Compare a file with the tables."""
        target.check_path_no_table(location, tables)

    def kind(self, location: Path) -> str | None:
        """Return the kind of a path's target."""
        return ask_path(location, path_kind)

    def stamp(self, location: Path) -> Any:
        """Return device, inode, size and time of the last change."""
        try:
            return identity_of(location)
        except OSError:
            return None

    def names(self, folder: Path) -> list[Path]:
        """List a folder."""
        if not folder.is_dir():
            return []
        return sorted(entry for entry in folder.iterdir() if not is_ours(entry.name))

    def content(self, location: Path, max_bytes: int) -> bytes:
        """Read a small file."""
        return read_bounded(location, max_bytes)

    def local_file(self, location: Path, *, whole: bool = True) -> LocalFile:  # noqa: ARG002 - it is here whole
        """Return the file itself."""
        return LocalFile(location, location)

    def written_at(self, location: Path) -> Path:
        """Return the path itself."""
        return location

    def taking_name(self, location: Path, batch: Batch | None = None) -> AbstractContextManager[NewFile[Path]]:
        """Lend a temporary name beside it; the file reaches the disk before it is renamed."""
        return target.taking_path_name(location, batch)

    def batch(self, locations: Sequence[Path]) -> target.Batch:  # noqa: ARG002 - what is there is replaced, whatever it is
        """Return a batch of files that reach the disk together."""
        return target.Batch()

    def check_each(self, locations: Sequence[Path]) -> None:
        """Check all targets."""
        for location in locations:
            self.check_target(location)

    def check_empty(self, location: Path) -> None:
        """Check that a path is an empty folder, or does not exist."""
        check_folder_empty(location)

    def taking_folder(self, location: Path) -> AbstractContextManager[Path]:
        """Lend a folder beside it, which is renamed."""
        return new_folder_at(location)

    @contextmanager
    def filled_folder(self, location: Path) -> Iterator[Path]:
        """Lend the folder itself; its files reach the disk in the end."""
        location.mkdir()
        yield location
        target.sync_file_systems([location])

    def made_folder(self, location: Path) -> Path:
        """Make a folder, and those that it is in."""
        return make_folder(location)

    def new_folder(self, location: Path) -> None:
        """Make a folder."""
        location.mkdir()

    @contextmanager
    def locked(self, folder: Path) -> Iterator[None]:
        """Lock a folder by the system's own locks, which end with their process.

        Raises
        ------
        LockedError
            If another process has the folder locked.
        """
        handle = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
        try:
            if not try_lock(handle, needed=False):
                raise LockedError(f"it has the folder '{folder}' locked")
            yield
        finally:
            os.close(handle)

    def move(self, names: Sequence[str], folder: Path, target: Path) -> None:
        """Rename files."""
        for name in names:
            for parent in reversed([*Path(name).parents][:-1]):
                if (target / parent).is_symlink():  # which may lead out of the folder
                    (target / parent).unlink()
                (target / parent).mkdir(exist_ok=True)
            with suppress(FileNotFoundError):
                (folder / name).replace(target / name)

    def remove(self, location: Path) -> None:
        """Remove a file, or an empty folder."""
        if location.is_dir() and not location.is_symlink():
            location.rmdir()
        else:
            location.unlink()

    def remove_folder(self, folder: Path) -> None:
        """Remove a folder with all that is in it."""
        shutil.rmtree(folder, ignore_errors=True)

    def clear(self, folder: Path) -> None:
        """Remove temporary files that nobody has locked."""
        sweep_temporary_files(folder)


FOLDERS = FolderStore()


ARCHIVES = (".nc", ".nc4", ".netcdf", ".cdf", ".h5", ".hdf5", ".hdf", ".he5", ZARR)  # ends of names of archives


def store_of(location: Place) -> Store[Any]:
    """Return the store of a location; the modules of fsspec are imported with the first address."""
    if isinstance(location, Address):
        from xdynamics.archive.address_store import ADDRESSES

        return ADDRESSES
    return FOLDERS


def made_folder(location: Place) -> Any:
    """Return a folder, made if it does not exist."""
    return store_of(location).made_folder(location)


def check_target(location: Place, model: Model | None = None) -> None:
    """Check before any work that an archive, a figure or a table can be written to a location without loss; see `Store`."""
    if location.suffix == ZARR:
        check_zarr_target(location)
        return
    store_of(location).check_target(location, model)


def check_archive(location: Place, model: Model | None = None) -> None:
    """Check before any work that an archive can be written to a location, and that its suffix is one of archives.

    Raises
    ------
    InputError
        If the name says that it is a file of another kind.
    """
    check_target(location, model)
    check_suffix(location)


def check_suffix(location: Place) -> None:
    """Refuse an archive's name with another kind's suffix; letters after a point need not be a suffix.

    Raises
    ------
    InputError
        With a name that would do.
    """
    suffix = location.suffix
    if suffix[1:].isalpha() and suffix.lower() not in ARCHIVES:
        raise InputError(
            f"'{location}' ends in '{suffix}', and an archive is netCDF or Zarr: name it like '{location.with_suffix('.nc')}'; states"
            " become a table by `xdynamics sample`, a figure by `xdynamics plot`"
        )


def taking_name(location: Place) -> AbstractContextManager[NewFile[Any]]:
    """Lend a temporary file, which takes its name, complete, when the `with` block is done; see `Store`."""
    return store_of(location).taking_name(location)


def is_same(location: Place, second_location: Place) -> bool:
    """Whether two places are one file that is there."""
    if isinstance(location, Path) and isinstance(second_location, Path):
        return location.exists() and location.samefile(second_location)
    return location == second_location


def is_folder(location: Place) -> bool:
    """Whether a location is an existing folder."""
    return store_of(location).kind(location) == FOLDER


def is_zarr(location: Place) -> bool:
    """Whether a location has the suffix of a Zarr store, and is not a file of another form."""
    if location.suffix != ZARR:
        return False
    if isinstance(location, Address) and location.scheme in READABLE:  # web servers have no folders
        return store_of(location).kind(location / NOTES / DIGESTS) is None
    return store_of(location).kind(location) is not None


def has_archive(location: Place) -> bool:
    """Whether there is a file, or a Zarr store with digests, under a name."""
    store = store_of(location)
    if not is_zarr(location):
        return store.kind(location) is None
    notes = location / NOTES
    # the second ones are of files that are still to be moved into the store
    return any(store.kind(folder / DIGESTS) is None for folder in (notes, *store.names(notes)))


def zarr_package() -> Any:
    """Return the package zarr.

    Raises
    ------
    InputError
        If it is missing.
    """
    try:
        import zarr
    except ImportError:
        raise InputError("Zarr stores need the package zarr: pip install 'xdynamics[zarr]'") from None
    return zarr


def check_zarr_target(location: Place) -> None:
    """Check before any work that a store can be written to a location: it is free, or a store of a record.

    Raises
    ------
    InputError
    """
    zarr_package()
    if isinstance(location, Address):
        check_writable(location)
    else:
        check_no_backslash(location)
        if not ask_path(location.parent, Path.is_dir):
            why = file_above(location) or f"the folder '{location.parent}' does not exist"
            raise InputError(f"'{location}' cannot be written: {why}")
    store, kind = store_of(location), store_of(location).kind(location)
    if kind is None or kind not in ("", "a directory"):
        raise InputError(f"'{location}' is {kind or 'a file'}, and a Zarr store is a folder; name another place")
    foreign = [entry.name for entry in store.names(location) if entry.name != NOTES]
    if foreign and not is_folder(location / NOTES):
        raise InputError(f"'{location}' holds '{min(foreign)}', and no record of xdynamics; name another place")
