"""The store of a place."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics.archive.folder_store import FOLDERS
from xdynamics.archive.place import ObjectName, Place
from xdynamics.archive.store import FOLDER, NewFile, Store

if TYPE_CHECKING:
    from xdynamics.model import Model


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
