"""The store of a place."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.folder_store import FOLDERS
from xdynamics.archive.place import ObjectName, Place
from xdynamics.archive.store import FOLDER, NewFile, Store
from xdynamics.faults import InputError

if TYPE_CHECKING:
    from xdynamics.model import Model

ARCHIVES = (".nc", ".nc4", ".netcdf", ".cdf", ".h5", ".hdf5", ".hdf", ".he5")  # ends of names of archives


def store_of(location: Place) -> Store[Any]:
    """Return the store that a place is of; what object stores need is imported with the first of them."""
    if isinstance(location, ObjectName):
        from xdynamics.archive.object_store import OBJECTS

        return OBJECTS
    return FOLDERS


def made_folder(location: Place) -> Any:
    """Return a folder, made if it does not exist."""
    return store_of(location).made_folder(location)


def check_target(location: Place, model: Model | None = None) -> None:
    """Check before any work that a file can be written to a place, and that nothing is lost there; see `Store`."""
    store_of(location).check_target(location, model)


def check_archive(location: Place, model: Model | None = None) -> None:
    """Check the same of an archive, and that its name ends like one.

    Raises
    ------
    InputError
        If the name says that it is a file of another kind.
    """
    check_target(location, model)
    check_suffix(location)


def check_suffix(location: Place) -> None:
    """Refuse to write an archive under a name of another kind of file; what follows a point need not be a suffix.

    Raises
    ------
    InputError
        With a name that would do.
    """
    suffix = location.suffix
    if suffix[1:].isalpha() and suffix.lower() not in ARCHIVES:
        raise InputError(
            f"'{location}' ends in '{suffix}', and an archive is netCDF: name it like '{location.with_suffix('.nc')}'; states"
            " become a table by `xdynamics sample`, a figure by `xdynamics plot`"
        )


def taking_name(location: Place) -> AbstractContextManager[NewFile[Any]]:
    """Lend a temporary file, which takes its name whole when the `with` block is done; see `Store`."""
    return store_of(location).taking_name(location)


def is_same(location: Place, second_location: Place) -> bool:
    """Whether two places are one file that is there."""
    if isinstance(location, Path) and isinstance(second_location, Path):
        return location.exists() and location.samefile(second_location)
    return location == second_location


def is_folder(location: Place) -> bool:
    """Whether there is a folder at a place."""
    return store_of(location).kind(location) == FOLDER
