"""Names of a package that stand in rooms of it, each entered when its name is first used."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def entrance(package: str, rooms: Mapping[str, str]) -> Callable[[str], Any]:
    """Return what a package has for its `__getattr__` (PEP 562).

    Parameters
    ----------
    package : str
    rooms : mapping of str to str
        Of a name, the module below the package in which it stands.
    """

    def found(name: str) -> Any:
        if name not in rooms:
            raise AttributeError(f"module '{package}' has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{rooms[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return found
