"""Late imports: names of a package that live in its modules, and libraries that must be loaded completely.

`cached_property` computes a property once for each object, without a lock that all objects of a class share.
`when_imported` runs a function after the import of a library by any module, or at once where the library is loaded.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Mapping
from functools import wraps
from importlib import import_module
from importlib.util import find_spec
from inspect import isfunction
from typing import TYPE_CHECKING, Any, Generic, TypeVar, cast, overload

if TYPE_CHECKING:
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec

Value = TypeVar("Value")


class cached_property(Generic[Value]):  # noqa: N801 - as in functools
    """A property computed once per object without a shared lock, as `functools.cached_property` from Python 3.12 on.

    Before, it holds one lock for the class while a value is computed: a process that is forked just then finds it taken
    for ever, for every object. Two threads may compute a value at once here; all get the first that is there.
    """

    def __init__(self, function: Callable[[Any], Value]) -> None:
        self.function, self.name = function, function.__name__
        self.__doc__ = function.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self.name = name

    @overload
    def __get__(self, instance: None, owner: type) -> cached_property[Value]: ...

    @overload
    def __get__(self, instance: object, owner: type) -> Value: ...

    def __get__(self, instance: object | None, owner: type) -> cached_property[Value] | Value:
        if instance is None:
            return self
        # without __set__ this is no data descriptor: from now on the instance's own entry is found first
        value: Value = instance.__dict__.setdefault(self.name, self.function(instance))
        return value


class _Following:
    """A finder that finds nothing by itself, and lets a function follow the import of some modules.

    Attributes
    ----------
    waiting : dict of str to (str, str)
        The module and the name of the function, by the library.
    """

    def __init__(self) -> None:
        self.waiting: dict[str, tuple[str, str]] = {}

    def find_spec(self, name: str, _path: Any = None, _target: Any = None) -> ModuleSpec | None:
        """Return the spec of other finders, with a loader that runs the waiting function after the import."""
        # removed first: `find_spec` below asks all finders again, this one among them
        follower = self.waiting.pop(name, None)
        if follower is None:
            return None
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            spec.loader = cast("Loader", _Loader(spec.loader, follower))  # it has all that the other has
        return spec


class _Loader:
    """A loader, and the function that runs after it."""

    def __init__(self, loader: Any, follower: tuple[str, str]) -> None:
        self._loader, self._follower = loader, follower

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> Any:
        """Create a module as the loader itself does."""
        return self._loader.create_module(spec)

    def exec_module(self, module: Any) -> None:
        """Load the module, then call the function."""
        # the module shows its real loader, which whoever asks for its source or data needs
        module.__spec__.loader = module.__loader__ = self._loader
        self._loader.exec_module(module)
        _call_follower(*self._follower)


_following = _Following()


def when_imported(library: str, module: str, function: str) -> None:
    """Call a function once a library is loaded: now, if it is, else right after whoever imports it.

    Parameters
    ----------
    library : str
    module, function : str
        Where the function stands, which is imported then.
    """
    if library in sys.modules:
        _call_follower(module, function)
        return
    _following.waiting[library] = module, function
    if _following not in sys.meta_path:
        sys.meta_path.insert(0, _following)


def _call_follower(module: str, function: str) -> None:
    getattr(import_module(module), function)()


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
    other_words: Mapping[str, str] | None = None,
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
    other_words : mapping of str to str, optional
        Names of other libraries, and those that they stand for here.
    """

    def load_name(name: str) -> Any:
        if name not in rooms:
            meant = (other_words or {}).get(name, "")
            hint = f"; did you mean '{meant}'?" if meant else ""
            raise AttributeError(f"module '{package}' has no attribute {name!r}{hint}")
        value = getattr(import_module(f"{package}.{rooms[name]}"), name)
        for module, _, gate in (
            gate_path.rpartition(".") for gate_path, names in (through or {}).items() if name in names
        ):
            value = getattr(import_module(f"{package}.{module}"), gate)(value)
        if companion_module and "xarray" in sys.modules:
            import_module(f"{package}.{companion_module}")
        elif companion_module and isfunction(value):
            value = _importing_after(value, f"{package}.{companion_module}")
        # the next access finds the name itself, and comes here no more
        setattr(sys.modules[package], name, value)
        return value

    return load_name
