"""The LLVM text of an entry that compiled code or Python calls, as `kernels.entry_points` says; made with numba."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from llvmlite import ir
from numba import from_dtype, types
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import as_dtype

from xdynamics.kernels.entry_points import ArrayElements, Fields, Kind, Signature

_WORD = ir.IntType(64)
_TUPLE: Any = types.BaseTuple
# called where a compiled function raises an exception, and provided nowhere: an optimised text that still calls it is
# one that could raise
EXCEPTION = "xdynamics_exception"


def in_numba(signature: Signature) -> Any:
    """Return numba's signature."""
    result: Any = getattr(types, signature.result.value)
    return result(*map(_type_of, signature.arguments))


def _type_of(kind: Kind) -> Any:
    if isinstance(kind, ArrayElements):
        return types.Array(from_dtype(kind.dtype), kind.dims, "C")
    if isinstance(kind, Fields):
        return types.NamedTuple(tuple(map(_type_of, kind.kinds)), kind.tuple_type)
    return getattr(types, kind.value)


def entry_text(context: Any, function: Any, signature: Signature, name: str) -> str:
    """Return the LLVM text of an entry that calls a compiled function.

    Parameters
    ----------
    context : numba.core.cpu.CPUContext
    function : numba.core.funcdesc.FunctionDescriptor
    signature : Signature
    name : str
        Of the entry.
    """
    module = context.create_module(name)
    convention = context.call_conv
    kind = convention.get_function_type(function.restype, function.argtypes)
    callee = ir.Function(module, kind, function.llvm_func_name)
    kinds = in_numba(signature).args
    parameter_types = (
        [_WORD.as_pointer()]
        if signature.by_table
        else [context.get_value_type(argument_type) for argument_type in kinds]
    )
    nothing = function.restype == types.none
    entry = ir.Function(module, ir.FunctionType(ir.VoidType() if nothing else _WORD, parameter_types), name)
    builder = ir.IRBuilder(entry.append_basic_block("entry"))
    arguments = list(entry.args)
    if signature.by_table:
        words = _words_of_table(builder, entry.args[0])
        arguments = [_argument_value(context, builder, argument_type, words) for argument_type in kinds]
    status, result = convention.call_function(builder, callee, function.restype, function.argtypes, arguments)
    with builder.if_then(status.is_error, likely=False):
        builder.call(ir.Function(module, ir.FunctionType(ir.VoidType(), []), EXCEPTION), [])
    if nothing:
        builder.ret_void()
    else:
        builder.ret(builder.zext(result, _WORD))
    return str(module)


def _words_of_table(builder: Any, table: Any) -> Iterator[Any]:
    word_index = 0
    while True:
        yield builder.load(builder.gep(table, [ir.Constant(_WORD, word_index)]))
        word_index += 1


def _argument_value(context: Any, builder: Any, kind: Any, words: Iterator[Any]) -> Any:
    """Return an argument as numba's functions take it."""
    if isinstance(kind, types.Array):
        return _array_argument(context, builder, kind, words)
    if isinstance(kind, _TUPLE):
        return context.make_tuple(
            builder, kind, [_argument_value(context, builder, field_type, words) for field_type in kind]
        )
    word = next(words)
    if isinstance(kind, types.Float):
        return builder.bitcast(word, ir.DoubleType())
    return builder.trunc(word, ir.IntType(1)) if kind == types.boolean else word


def _array_argument(context: Any, builder: Any, kind: Any, words: Iterator[Any]) -> Any:
    array = context.make_array(kind)(context, builder)
    data = builder.inttoptr(next(words), array.data.type)
    shape = [next(words) for _ in range(kind.ndim)]
    item = step = context.get_constant(types.intp, as_dtype(kind.dtype).itemsize)
    strides: list[Any] = []
    for extent in reversed(shape):
        strides.insert(0, step)
        step = builder.mul(step, extent)
    # no owner: nothing counts references
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=item, meminfo=None)
    return array._getvalue()  # noqa: SLF001 - numba's name for it
