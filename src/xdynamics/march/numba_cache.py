"""Compiled functions of numba as the content of one file.

numba's own cache keeps several files and opens them by name, some time after anything verified them. Here
it is given bytes whose digest was verified.
"""

from __future__ import annotations

import pickle
from typing import Any

from numba import njit
from numba.core.caching import CompileResultCacheImpl, NullCache
from numba.core.ccallback import CFunc
from numba.core.serialize import dumps

from xdynamics.kernels.compiling import OPTIONS

_IMPLEMENTATION: Any = CompileResultCacheImpl
_dumps: Any = dumps


class Kept:
    """Functions by name, as numba serialises them.

    Parameters
    ----------
    content : bytes, optional
        The `content` of another process: every function is loaded from it, and none is compiled.
    """

    def __init__(self, content: bytes | None = None) -> None:
        # numba keeps functions as pickles; these are this process's own, or this user's, and verified
        self._functions: dict[str, bytes] = {} if content is None else pickle.loads(content)  # noqa: S301
        self._complete = content is not None

    @property
    def content(self) -> bytes:
        """All functions, serialised."""
        return pickle.dumps(self._functions)

    def callback(self, function: Any, signature: Any) -> Any:
        """Compile a function that is called by its address, or load it."""
        compiled = _Callback(function, (signature.args, signature.return_type), locals={}, options=dict(OPTIONS))
        compiled.take(_Place(self._functions, function.__name__, complete=self._complete))
        return compiled

    def function(self, function: Any, signature: Any, **options: Any) -> Any:
        """Compile a function that is called from Python, or load it."""
        dispatcher: Any = njit(**OPTIONS, **options)(function)
        dispatcher._cache = _Place(self._functions, function.__name__, complete=self._complete)  # noqa: SLF001 - as its `enable_caching` does
        dispatcher.compile(signature)
        return dispatcher


class _Callback(CFunc):
    def take(self, place: _Place) -> None:
        self._cache = place
        self.compile()


class _Place(NullCache):
    """Where numba loads one function from, and saves it to."""

    def __init__(self, functions: dict[str, bytes], name: str, *, complete: bool) -> None:
        self._functions, self._name, self._complete = functions, name, complete

    def load_overload(self, sig: Any, target_context: Any) -> Any:  # noqa: ARG002
        if not self._complete:
            return None
        target_context.refresh()
        payload = pickle.loads(self._functions[self._name])  # noqa: S301 - see above
        return _IMPLEMENTATION.rebuild(None, target_context, payload)

    def save_overload(self, sig: Any, cres: Any) -> None:  # noqa: ARG002
        if not self._complete:
            self._functions[self._name] = _dumps(_IMPLEMENTATION.reduce(None, cres))
