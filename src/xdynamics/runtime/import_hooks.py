"""What follows the import of a library by whoever imports it: done at once where that is loaded already."""

from __future__ import annotations

import sys
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any, cast

if TYPE_CHECKING:
    from importlib.abc import Loader
    from importlib.machinery import ModuleSpec


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
        """Return what other finders find, followed by the function."""
        follower = self.waiting.pop(name, None)
        if follower is None:
            return None
        spec = find_spec(name)
        if spec is not None and spec.loader is not None:
            spec.loader = cast("Loader", _Loader(spec.loader, follower))  # it has all that the other has
        return spec


class _Loader:
    """A loader, and what follows it."""

    def __init__(self, loader: Any, follower: tuple[str, str]) -> None:
        self._loader, self._follower = loader, follower

    def __getattr__(self, name: str) -> Any:
        return getattr(self._loader, name)

    def create_module(self, spec: ModuleSpec) -> Any:
        """Create a module as the loader itself does."""
        return self._loader.create_module(spec)

    def exec_module(self, module: Any) -> None:
        """Load the module, then call the function."""
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
