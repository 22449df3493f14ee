"""A run as compiled code sees it: one pointer to a table of its arrays.

Handed over as a tuple of arrays, a run is some 300 numbers at every call, and compiling the loop takes a minute. Through
the table it is one number; ``run.y`` reads where the array begins and how long it is, and nothing is counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import config, from_dtype, types
from numba.core import cgutils
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic, models, register_model
from numba.np.arrayobj import populate_array

from xdynamics.march.run import ARRAYS

WORDS = 3  # of each array in the table: address, length of the first dimension, of the second


class RunType(types.Type):
    """The type of a run in compiled code."""

    def __init__(self) -> None:
        super().__init__(name="xdynamics.Run")


RUN = RunType()
_FIELDS = {name: types.Array(from_dtype(np.dtype(dtype)), dims, "C") for name, (dtype, dims) in ARRAYS.items()}
_PLACES = {name: i for i, name in enumerate(ARRAYS)}


@register_model(RunType)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.IntType(64).as_pointer())


@infer_getattr
class _Attributes(AttributeTemplate):
    key = RunType

    def generic_resolve(self, _run: Any, name: str) -> Any:  # type: ignore[override]
        return _FIELDS.get(name)


@lower_getattr_generic(RunType)
def _array(context: Any, builder: Any, _kind: Any, table: Any, name: str) -> Any:
    """Put an array together from its three words."""
    field, first = _FIELDS[name], WORDS * _PLACES[name]
    words = [builder.load(cgutils.gep_inbounds(builder, table, first + k)) for k in range(1 + field.ndim)]
    for word in words:
        # no compiled code changes the table: what is written elsewhere is no reason to read it again
        word.set_metadata("invariant.load", builder.module.add_metadata([]))
    array = context.make_array(field)(context, builder)
    data = builder.inttoptr(words[0], array.data.type)
    size = context.get_constant(types.intp, context.get_abi_sizeof(context.get_data_type(field.dtype)))
    strides = [size] if field.ndim == 1 else [builder.mul(words[2], size), size]
    populate_array(array, data=data, shape=words[1:], strides=strides, itemsize=size, meminfo=None)
    return array._getvalue()  # noqa: SLF001 - how numba's own intrinsics end


def _run_at(_typing: Any, address: Any) -> Any:
    """Return the run whose table stands at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.IntType(64).as_pointer())

    return RUN(address), generate


def _itself(run: Any) -> Any:
    return run


# where nothing is compiled, entries are called with the run itself
run_at: Any = _itself if config.DISABLE_JIT else intrinsic(_run_at)  # type: ignore[attr-defined]


def _march_by(_typing: Any, march: Any, address: Any, rows: Any) -> Any:
    """Call the compiled march at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [ir.IntType(64), ir.IntType(64)])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return _context.get_dummy_value()

    return types.void(march, address, rows), generate


def _march_by_plainly(march: Any, run: Any, rows: int) -> None:
    march(run, rows)


march_by: Any = _march_by_plainly if config.DISABLE_JIT else intrinsic(_march_by)  # type: ignore[attr-defined]
