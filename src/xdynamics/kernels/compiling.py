"""How every compiled function of this package is compiled: IEEE arithmetic in the order written."""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import config, njit
from numba.extending import intrinsic

# fastmath stays off and "numpy" makes 1/0 an infinity instead of an exception: the march judges it
OPTIONS: Any = {"error_model": "numpy", "fastmath": False, "nogil": True}

# called from compiled code only: without a way in from Python it compiles twice as fast
_INNER: Any = {"forceinline": True, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
compiled: Any = njit(**_INNER, **OPTIONS)
# large and called from several places: one copy, not one at every place
shared: Any = njit(**{**_INNER, "forceinline": False}, **OPTIONS)
entry: Any = njit(cache=True, **OPTIONS)
entry_in_memory: Any = njit(**OPTIONS)


def _borrowed(_typing: Any, array: Any) -> Any:
    """Return an array without its reference count, for loops that would count it up and down at every step.

    The caller of the compiled code holds the array; nothing inside keeps it.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        view = context.make_array(signature.return_type)(context, builder, arguments[0])
        for counted in ("meminfo", "parent"):
            setattr(view, counted, ir.Constant(getattr(view, counted).type, None))
        return view._getvalue()  # noqa: SLF001 - how numba's own intrinsics end

    return array(array), generate


def _itself(array: Any) -> Any:
    return array


# without numba's compiler, as NUMBA_DISABLE_JIT asks for, a march is plain Python and an array is an array
borrowed: Any = _itself if config.DISABLE_JIT else intrinsic(_borrowed)  # type: ignore[attr-defined]
