"""Functions that numba compiles, and the entries by which they are called, as one LLVM text that stands alone.

numba translates them for a plain processor and makes no machine code. The text calls neither Python nor numba's
runtime: what could raise an exception or count references is optimised away, or the text is refused. An entry is called
as `kernels.entry_points` says, by compiled code or Python.
"""

from __future__ import annotations

import gc
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import llvmlite.binding as llvm
from llvmlite import ir
from numba import from_dtype, njit, types
from numba.core.codegen import AOTCodeLibrary, AOTCPUCodegen
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.extending import overload
from numba.np.arrayobj import populate_array
from numba.np.numpy_support import as_dtype

from xdynamics.elementary import numbers
from xdynamics.kernels import machine
from xdynamics.kernels.compiling import UNCOUNTED, install_numba_functions
from xdynamics.kernels.entry_points import ArrayElements, Fields, Handle, Kind, Signature
from xdynamics.runtime.fork_safety import waited_for

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
    if isinstance(kind, Handle):
        return kind.type_in_code()
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


waited_for(getattr(global_compiler_lock, "_lock"))  # noqa: B009 - numba's own, which a child needs to compile
# what functions of any kind of number call is compiled for floats as it is meant
overload(numbers.choose)(lambda truth, yes, no: lambda truth, yes, no: yes if truth else no)  # noqa: ARG005
overload(numbers.absolute)(lambda x: lambda x: abs(x))  # noqa: ARG005, PLW0108

# IEEE 754 has one square root: the processor's, in place of the C library's, which tells errors apart
_SQUARE_ROOT = """
declare double @llvm.sqrt.f64(double)
define double @sqrt(double %x) alwaysinline {
    %root = call double @llvm.sqrt.f64(double %x)
    ret double %root
}
"""


def text_of(functions: Sequence[tuple[Any, Signature]]) -> str:
    """Compile functions to LLVM text.

    Parameters
    ----------
    functions : sequence of (function, Signature)
        Each is an entry of the text, by its name, called as `kernels.entry_points` says.

    Raises
    ------
    RuntimeError
        If the text needs a symbol that is not provided.
    """
    # in LLVM's context of the whole process, as numba's own modules, which its lock keeps to one thread
    with global_compiler_lock, _without_collection():
        install_numba_functions()
        module = _link_functions(functions)
        entries = {function.__name__ for function, _ in functions}
        for symbol in (*module.functions, *module.global_variables):
            if not symbol.is_declaration and symbol.name not in entries:
                symbol.linkage = "internal"
        for level in (3, 1):  # then once more, since that an exception cannot occur is found from the inside outward
            machine.optimise(module, machine.plain_machine(), level)
        _check_symbols(module)
        return str(module)


@contextmanager
def _without_collection() -> Iterator[None]:
    """Search for no garbage meanwhile: numba makes millions of objects that live until its end, a quarter of its time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _link_functions(functions: Sequence[tuple[Any, Signature]]) -> Any:
    """Return a module of all functions, their entries, and their callees."""
    module = llvm.parse_assembly(_SQUARE_ROOT)
    with _plain_processor() as context:
        for function, signature in functions:
            numba_signature = in_numba(signature)
            dispatcher: Any = njit(**UNCOUNTED)(function)
            dispatcher.compile(numba_signature)
            compiled = dispatcher.overloads[numba_signature.args]
            _, _, bitcode = compiled.library.serialize_using_bitcode()
            module.link_in(llvm.parse_bitcode(bitcode))
            entry = entry_text(context, compiled.fndesc, signature, function.__name__)
            module.link_in(llvm.parse_assembly(entry))
    return module


def _check_symbols(module: Any) -> None:
    needed = {
        symbol.name
        for symbol in (*module.functions, *module.global_variables)
        if symbol.is_declaration and not symbol.name.startswith("llvm.")
    }
    if missing := needed - {*machine.HELPERS}:
        raise RuntimeError(f"the engine's LLVM text needs {', '.join(sorted(missing))}, which nothing provides")


class _Library(AOTCodeLibrary):
    """Compiled functions that are linked without optimisation: the complete text is optimised once, at the end."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = str(self._codegen.target_data)

    def _optimize_final_module(self) -> None:
        pass

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002
        """Return that there is no machine code."""
        return 0


class _Codegen(AOTCPUCodegen):
    """Code for a plain processor, of which none is executed."""

    _library_class = _Library

    def set_env(self, env_name: str, env: Any) -> None:
        """Ignore the Python names that functions could look up: they look up none."""


@contextmanager
def _plain_processor() -> Iterator[Any]:
    """Let numba compile for a plain processor; under its lock, no other thread compiles meanwhile."""
    context: Any = cpu_target.target_context
    original_codegen = context._internal_codegen  # noqa: SLF001 - nested functions are compiled for this context alone
    context._internal_codegen = _Codegen("xdynamics")  # noqa: SLF001
    try:
        yield context
    finally:
        context._internal_codegen = original_codegen  # noqa: SLF001
