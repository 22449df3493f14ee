"""Declarations of the engine's functions, which are given to numba when a text is to be made.

In a process that finds machine code, which is nearly every one, numba is never imported: that would take a third of the
time of a first run. Declared functions stay as they are written, and are called from Python only where compiling is
switched off (NUMBA_DISABLE_JIT). Before numba compiles any of them, `install_numba_functions` puts numba's in their
places.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from itertools import count
from types import FunctionType
from typing import Any

# without numba's compiler the engine is plain Python, and entries are given the run itself
PLAINLY = os.environ.get("NUMBA_DISABLE_JIT", "").strip() not in ("", "0")

# IEEE arithmetic in the order written: fastmath stays off, and "numpy" makes 1/0 an infinity instead of an exception,
# which the march judges
OPTIONS: Any = {"error_model": "numpy", "fastmath": False, "nogil": True}

# called from compiled code only: without an entry point from Python it compiles twice as fast
_INNER: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, **OPTIONS}
# for functions that take many arrays at every call: the callers own them, and no references are counted. Counting takes
# atomic instructions, of which there were 140 for each step that the lanes leave to the single march
UNCOUNTED: Any = {"_nrt": False, **_INNER}

_WAITING: dict[Any, Callable[[], Any]] = {}  # declared functions, and what makes numba's of each
_IN_CODE: dict[Any, Any] = {}  # those that numba has


def declare(function: Any, made: Callable[[], Any]) -> Any:
    """Register how numba compiles a function, which is returned unchanged."""
    _WAITING[function] = made
    return function


def is_declared(function: Any) -> bool:
    """Whether it is a function that numba compiles."""
    return isinstance(function, FunctionType) and (function in _WAITING or function in _IN_CODE)


def jit_inline(function: Any) -> Any:
    """Declare a phase of every step: inlined into the loop before type inference, which takes the least time in all."""
    function = _own_copy(function)
    return declare(function, lambda: _by_numba(function, inline="always", **_INNER))


def jit_separate(function: Any) -> Any:
    """Declare a function that is rare, or called from several places: compiled as one separate copy."""
    function = _own_copy(function)
    return declare(function, lambda: _by_numba(function, **_INNER))


def jit_uncounted(function: Any) -> Any:
    """Declare a function that takes many arrays at every call, compiled without counting their references."""
    return declare(function, lambda: _by_numba(function, **UNCOUNTED))


def noinline(function: Any) -> Any:
    """Return a phase of every step as one separate copy, for calls that are not part of every step."""
    return jit_separate(_copy_function(getattr(function, "py_func", function)))


def in_code(plain: Any, name: str, made: Callable[[str], Any]) -> Any:
    """Declare a function that compiled code replaces by an instruction, and Python calls as it is.

    Parameters
    ----------
    plain : callable
    name : str
        Of the instruction.
    made : callable of str
        Returns it, as `numba.extending.intrinsic` does.
    """
    return declare(_copy_function(plain), lambda: made(name))


def _own_copy(function: Any) -> Any:
    """Return a function that is being defined, or a copy of one that stands in its module, where Python calls it."""
    return _copy_function(function) if function.__globals__.get(function.__name__) is function else function


def _copy_function(function: Any) -> Any:
    return FunctionType(function.__code__, function.__globals__, function.__name__, function.__defaults__)


def _by_numba(function: Any, **options: Any) -> Any:
    """Return numba's function, of which a call with a constant compiles no copy of its own.

    A third of all compiled functions were such copies; where a constant matters for speed, LLVM inlines.
    """
    from numba import njit, types

    dispatcher: Any = njit(**options)(function)
    template = dispatcher.get_call_template
    without_value: Callable[[Any], Any] = types.unliteral

    def of_kinds(arguments: Any, keywords: Any) -> Any:
        kinds = {name: without_value(kind) for name, kind in keywords.items()}
        return template(tuple(map(without_value, arguments)), kinds)

    dispatcher.get_call_template = of_kinds
    return dispatcher


def install_numba_functions() -> None:
    """Replace declared functions by numba's, in every module that looks one of them up."""
    scopes = {id(function.__globals__): function.__globals__ for function in (*_WAITING, *_IN_CODE)}
    for function in [*_WAITING]:
        _IN_CODE[function] = _WAITING[function]()
        del _WAITING[function]
    for scope in scopes.values():
        declared_names = [
            name for name, value in scope.items() if isinstance(value, FunctionType) and value in _IN_CODE
        ]
        scope.update({name: _IN_CODE[scope[name]] for name in declared_names})


# where nothing is compiled, an address is a key of this mapping
UNCOMPILED: dict[int, Any] = {}
_KEYS = count(1)


def keys_of(functions: Iterable[Any]) -> list[int]:
    """Return new keys of `UNCOMPILED` for functions, which stand for their addresses."""
    keyed = {next(_KEYS): function for function in functions}
    UNCOMPILED.update(keyed)
    return list(keyed)
