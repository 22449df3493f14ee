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


def store_of(place: Place) -> Store[Any]:
    """Return the store that a place is of; what object stores need is imported with the first of them."""
    if isinstance(place, ObjectName):
        from xdynamics.archive.object_store import OBJECTS

        return OBJECTS
    return FOLDERS


def made_folder(place: Place) -> Any:
    """Return a folder, made if it does not exist."""
    return store_of(place).made_folder(place)


def check_target(place: Place, model: Model | None = None) -> None:
    """Check before any work that a file can be written to a place, and that nothing is lost there; see `Store`."""
    store_of(place).check_target(place, model)


def check_archive(place: Place, model: Model | None = None) -> None:
    """Check the same of an archive, and that its name ends like one.

    Raises
    ------
    InputError
        If the name says that it is a file of another kind.
    """
    check_target(place, model)
    check_suffix(place)


def check_suffix(place: Place) -> None:
    """Refuse to write an archive under a name of another kind of file; what follows a point need not be a suffix.

    Raises
    ------
    InputError
        With a name that would do.
    """
    suffix = place.suffix
    if suffix[1:].isalpha() and suffix.lower() not in ARCHIVES:
        raise InputError(
            f"'{place}' ends in '{suffix}', and an archive is netCDF: name it like '{place.with_suffix('.nc')}'; states"
            " become a table by `xdynamics sample`, a figure by `xdynamics plot`"
        )


def taking_name(place: Place) -> AbstractContextManager[NewFile[Any]]:
    """Lend a temporary file, which takes its name whole when the `with` block is done; see `Store`."""
    return store_of(place).taking_name(place)


def is_same(place: Place, other: Place) -> bool:
    """Whether two places are one file that is there."""
    if isinstance(place, Path) and isinstance(other, Path):
        return place.exists() and place.samefile(other)
    return place == other


def is_folder(place: Place) -> bool:
    """Whether there is a folder at a place."""
    return store_of(place).kind(place) == FOLDER
