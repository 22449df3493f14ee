"""How every compiled function of this package is compiled: IEEE arithmetic in the order written."""

from __future__ import annotations

from numba import njit

# fastmath stays off and "numpy" makes 1/0 an infinity instead of an exception: the march judges it
OPTIONS = {"error_model": "numpy", "fastmath": False, "nogil": True}

# called from compiled code only: without a way in from Python it compiles twice as fast
compiled = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, **OPTIONS)
entry = njit(cache=True, **OPTIONS)
entry_in_memory = njit(**OPTIONS)
