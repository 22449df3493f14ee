"""How functions that numba compiled are called in machine code: numbers as in C, arrays through a table of words.

A function of numbers alone has these as its arguments, so that compiled code can call it by its address. One that takes
arrays, or named tuples of them, has one argument: the address of a table of words of eight bytes. A number is one word,
an array is the address of its first element and then its shape. Both sides of this convention stand here: the LLVM text
that reads the table, and the Python that fills it.
"""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import as_dtype

from xdynamics.kernels.machine import Code, address_of

_WORD = ir.IntType(64)
_TUPLE: Any = types.BaseTuple
# called where a compiled function raises an exception, and provided nowhere: an optimised text that still calls it is
# one that could raise
EXCEPTION = "xdynamics_exception"


def by_table(signature: Any) -> bool:
    """Return whether a function is called with the address of a table."""
    return any(isinstance(kind, (types.Array, _TUPLE)) for kind in signature.args)


# ------------------------------------------------------------------------------------------------------------ LLVM text


def entry_text(context: Any, function: Any, signature: Any, name: str) -> str:
    """Return the LLVM text of an entry that calls a compiled function.

    Parameters
    ----------
    context : numba.core.cpu.CPUContext
    function : numba.core.funcdesc.FunctionDescriptor
    signature : numba.core.typing.Signature
        With types of arrays in C order.
    name : str
        Of the entry.
    """
    module = context.create_module(name)
    convention = context.call_conv
    kind = convention.get_function_type(function.restype, function.argtypes)
    callee = ir.Function(module, kind, function.llvm_func_name)
    given = [_WORD.as_pointer()] if by_table(signature) else [context.get_value_type(of) for of in signature.args]
    nothing = function.restype == types.none
    entry = ir.Function(module, ir.FunctionType(ir.VoidType() if nothing else _WORD, given), name)
    builder = ir.IRBuilder(entry.append_basic_block("entry"))
    arguments = list(entry.args)
    if by_table(signature):
        words = _words_of_table(builder, entry.args[0])
        arguments = [_value(context, builder, of, words) for of in signature.args]
    status, result = convention.call_function(builder, callee, function.restype, function.argtypes, arguments)
    with builder.if_then(status.is_error, likely=False):
        builder.call(ir.Function(module, ir.FunctionType(ir.VoidType(), []), EXCEPTION), [])
    if nothing:
        builder.ret_void()
    else:
        builder.ret(builder.zext(result, _WORD))
    return str(module)


def _words_of_table(builder: Any, table: Any) -> Iterator[Any]:
    place = 0
    while True:
        yield builder.load(builder.gep(table, [ir.Constant(_WORD, place)]))
        place += 1


def _value(context: Any, builder: Any, kind: Any, words: Iterator[Any]) -> Any:
    """Return an argument as numba's functions take it."""
    if isinstance(kind, types.Array):
        return _array(context, builder, kind, words)
    if isinstance(kind, _TUPLE):
        return context.make_tuple(builder, kind, [_value(context, builder, of, words) for of in kind])
    word = next(words)
    if isinstance(kind, types.Float):
        return builder.bitcast(word, ir.DoubleType())
    return builder.trunc(word, ir.IntType(1)) if kind == types.boolean else word


def _array(context: Any, builder: Any, kind: Any, words: Iterator[Any]) -> Any:
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


# --------------------------------------------------------------------------------------------------------------- Python


class Entry:
    """Machine code of a function, to be called from Python.

    Parameters
    ----------
    code : Code
        Stays in memory as long as the entry.
    name : str
    signature : numba.core.typing.Signature
        Of what was compiled.
    """

    def __init__(self, code: Code, name: str, signature: Any) -> None:
        self.code, self.address = code, code.addresses[name]
        self._kinds = [_kind_of(kind) for kind in signature.args]
        result = None if signature.return_type == types.none else ctypes.c_int64
        c_types = [ctypes.c_void_p] if by_table(signature) else [_C_TYPES[kind] for kind in signature.args]
        # the interpreter is free while the function runs
        self.call: Callable[..., Any] = ctypes.CFUNCTYPE(result, *c_types)(self.address)

    def __call__(self, *arguments: Any) -> Any:
        """Call the function with a table of its arguments.

        Raises
        ------
        TypeError
            If an array is not what the function was compiled for, which it would read as something else.
        """
        words = [word for of, argument in zip(self._kinds, arguments, strict=True) for word in _words(of, argument)]
        return self.call((ctypes.c_int64 * len(words))(*words))


_C_TYPES = {types.int64: ctypes.c_int64, types.float64: ctypes.c_double}


def _kind_of(kind: Any) -> Any:
    """Return what an argument has to be: type and number of dimensions of an array, a list for a tuple, or a type."""
    if isinstance(kind, types.Array):
        return as_dtype(kind.dtype), kind.ndim
    if isinstance(kind, _TUPLE):
        return [_kind_of(of) for of in kind]
    return float if isinstance(kind, types.Float) else int


def _words(kind: Any, argument: Any) -> Iterator[int]:
    """Yield the words of an argument."""
    if isinstance(kind, tuple):
        dtype, dims = kind
        if argument.dtype != dtype or argument.ndim != dims or not argument.flags.c_contiguous:
            raise TypeError(
                f"an array of {argument.dtype} with {argument.ndim} dimensions, C order"
                f" {argument.flags.c_contiguous}; needed are {dtype} with {dims} in C order"
            )
        yield address_of(argument)
        yield from argument.shape
    elif isinstance(kind, list):
        for of, part in zip(kind, argument, strict=True):
            yield from _words(of, part)
    elif kind is float:
        yield struct.unpack("=q", struct.pack("=d", argument))[0]
    else:
        yield int(argument)


def array(dtype: Any, dims: int) -> Any:
    """Return numba's type of an array in C order."""
    return types.Array(from_dtype(np.dtype(dtype)), dims, "C")
