"""How the engine is compiled: IEEE arithmetic in the order written."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import count
from typing import Any

from numba import njit
from numba.extending import overload

from xdynamics.elementary import numbers

# fastmath stays off and "numpy" makes 1/0 an infinity instead of an exception: the march judges it
OPTIONS: Any = {"error_model": "numpy", "fastmath": False, "nogil": True}

# called from compiled code only: without an entry point from Python it compiles twice as fast
_INNER: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# a phase of every step: inlined into the loop before type inference, which takes the least time in all
compiled: Any = njit(inline="always", **_INNER, **OPTIONS)
# rare, or called from several places: compiled as one separate copy
shared: Any = njit(**_INNER, **OPTIONS)
# the same for functions that take many arrays at every call: the callers own them, and no references are counted.
# Counting takes atomic instructions, of which there were 140 for each step that the lanes leave to the single march
UNCOUNTED: Any = {"_nrt": False}
borrowing: Any = njit(**UNCOUNTED, **_INNER, **OPTIONS)


def apart(function: Any) -> Any:
    """Return a phase of every step as one separate copy, for calls that are not part of every step."""
    return shared(getattr(function, "py_func", function))


entry: Any = njit(**OPTIONS)
# what functions of any kind of number call is compiled for floats as it is meant
overload(numbers.choose)(lambda truth, yes, no: lambda truth, yes, no: yes if truth else no)  # noqa: ARG005
overload(numbers.absolute)(lambda x: lambda x: abs(x))  # noqa: ARG005, PLW0108

# where nothing is compiled, an address is a key of this mapping
UNCOMPILED: dict[int, Any] = {}
_KEYS = count(1)


def keys_of(functions: Iterable[Any]) -> list[int]:
    """Return keys of `UNCOMPILED` that no other function has, in the place of addresses."""
    keyed = {next(_KEYS): function for function in functions}
    UNCOMPILED.update(keyed)
    return list(keyed)
