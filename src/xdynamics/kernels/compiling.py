"""How the engine is compiled: IEEE arithmetic in the order written, and calls of laws by their addresses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import config, njit, types
from numba.extending import intrinsic

from xdynamics.kernels.program import ARRAYS

# fastmath stays off and "numpy" makes 1/0 an infinity instead of an exception: the march judges it
OPTIONS: Any = {"error_model": "numpy", "fastmath": False, "nogil": True}

# called from compiled code only: without a way in from Python it compiles twice as fast
_INNER: Any = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
# a phase of every step: it becomes part of the loop before types are known, which costs the least time in all
compiled: Any = njit(inline="always", **_INNER, **OPTIONS)
# rare, or called from several places: one copy of its own
shared: Any = njit(**_INNER, **OPTIONS)


def apart(function: Any) -> Any:
    """Return a phase of every step as one copy of its own, for the places that are not in every step."""
    return shared(getattr(function, "py_func", function))


entry: Any = njit(**OPTIONS)

PLAIN: dict[int, Callable[..., None]] = {}  # where nothing is compiled, an address is a key of these


def _called(_typing: Any, address: Any, at: Any, y: Any, p: Any, tables: Any, pieces: Any, z: Any, e: Any, samples: Any, first: Any, w: Any) -> Any:  # fmt: skip
    """Call the program at an address with pointers to arrays; `first` is how far into `samples` it may write."""
    signature = types.void(address, at, y, p, tables, pieces, z, e, samples, first, w)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = ir.IntType(8).as_pointer()
        data = []
        for kind, one in zip(signature.args[1:], arguments[1:], strict=True):
            if isinstance(kind, types.Array):
                data.append(context.make_array(kind)(context, builder, one).data)
            else:
                data[-1] = builder.gep(data[-1], [one])
        data = [builder.bitcast(one, pointer) for one in data]
        kind = ir.FunctionType(ir.VoidType(), [pointer] * len(ARRAYS))
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), data)
        return context.get_dummy_value()

    return signature, generate


def _called_plainly(address: int, at: Any, y: Any, p: Any, tables: Any, pieces: Any, z: Any, e: Any, samples: Any, first: int, w: Any) -> None:  # fmt: skip
    """Call the Python function that stands for an address where nothing is compiled."""
    PLAIN[int(address)](at, y, p, tables, pieces, z, e, samples[first:], w)


# without numba's compiler, as NUMBA_DISABLE_JIT asks for, the engine is plain Python
called: Any = _called_plainly if config.DISABLE_JIT else intrinsic(_called)  # type: ignore[attr-defined]
