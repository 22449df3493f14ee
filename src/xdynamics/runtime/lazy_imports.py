"""Late imports: names of a package that live in its modules, and libraries that must be loaded whole."""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from inspect import isfunction
from typing import Any


def load_dask_whole() -> None:
    """Load dask where there are other threads, before xarray does so by its parts.

    Many operations of xarray import `dask.base` to ask whether an array is lazy, and others `dask.array`; where two
    threads begin with different ones, Python hands out modules that are half made. `dask.array` imports xarray too: where
    another thread does so at that moment, as one of a new worker that unpickles a task, each would wait for the other.
    """
    if threading.active_count() > 1 and "dask.array" not in sys.modules:
        import_module("xarray")
        import_module("dask.array")


def _importing_after(verb: Callable[..., Any], module: str) -> Callable[..., Any]:
    """Load a module after the call of a verb, which may be the first to import xarray."""

    @wraps(verb)
    def following_call(*arguments: Any, **keywords: Any) -> Any:
        result = verb(*arguments, **keywords)
        if "xarray" in sys.modules:
            import_module(module)
        return result

    return following_call


def entrance(
    package: str,
    rooms: Mapping[str, str],
    companion_module: str = "",
    through: Mapping[str, tuple[str, ...]] | None = None,
) -> Callable[[str], Any]:
    """Return the `__getattr__` of a package (PEP 562).

    Parameters
    ----------
    package : str
    rooms : mapping of str to str
        Of a name, the module below the package in which it stands.
    companion_module : str
        A module that is loaded too, once a room has brought xarray: what is registered with it.
    through : mapping of str to tuple of str, optional
        Of functions ``module.name``, the names that come through them, from the inmost to the outmost.
    """

    def load_name(name: str) -> Any:
        if name not in rooms:
            raise AttributeError(f"module '{package}' has no attribute {name!r}")
        value = getattr(import_module(f"{package}.{rooms[name]}"), name)
        for module, _, gate in (
            gate_path.rpartition(".") for gate_path, names in (through or {}).items() if name in names
        ):
            value = getattr(import_module(f"{package}.{module}"), gate)(value)
        if companion_module and "xarray" in sys.modules:
            import_module(f"{package}.{companion_module}")
        elif companion_module and isfunction(value):
            value = _importing_after(value, f"{package}.{companion_module}")
        setattr(sys.modules[package], name, value)
        return value

    return load_name
