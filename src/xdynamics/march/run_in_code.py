"""A run as numba compiles it: one pointer to a table of its arrays, and calls by address in compiled code.

The module is imported when the engine is compiled, and only then. Passed as a tuple of numba's arrays, a run is some
300 numbers at every call, and compiling the loop takes a minute. Through the table it is one number: ``run.y`` is the
place of three words in it, and ``run.y[i]`` reads the array's address and then the element. The compiler is given facts
that hold for these arrays alone: the table never changes while code runs, nor does a plan, and a write to one kind of
array changes no array of another kind.

Calls by addresses, and runs behind addresses, are compiled here under the names of `march.calls`.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numba.core import cgutils
from numba.core.typeconv import Conversion  # type: ignore[attr-defined]
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import (
    infer_getattr,
    intrinsic,
    lower_builtin,
    lower_cast,
    lower_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
)

from xdynamics.kernels.entry_points import FLAG, FLOAT, NOTHING, Signature
from xdynamics.kernels.program import WORDS
from xdynamics.march.run import ARRAYS, KINDS

LAWS, NO_ARRAY = "laws", "nothing"  # what a call reads or writes
SEEN_BY_LAWS = ("Floats", "Whole", "Columns", "LogRows", "Links")  # kinds that programs read or write
CONSTANT = "Plans"  # the kind that nothing writes while code runs

WORD = ir.IntType(64)
POINTER = WORD.as_pointer()


class RunType(types.Type):
    """The type of a run in compiled code."""

    def __init__(self) -> None:
        super().__init__(name="xdynamics.Run")


class ArrayType(types.Type):
    """The type of one of a run's arrays: the index of its three words in the table."""

    def __init__(self, kind: str) -> None:
        super().__init__(name=f"xdynamics.{kind}")
        self.kind = kind
        self.numpy, self.ndim = np.dtype(KINDS[kind].elements), KINDS[kind].dimensions
        self.element = RowType(kind) if self.numpy.names else from_dtype(self.numpy)


class RowType(types.Type):
    """The type of a row with named fields, accessed without a copy."""

    def __init__(self, kind: str) -> None:
        super().__init__(name=f"xdynamics.{kind}.row")
        self.kind = kind
        self.numpy = np.dtype(KINDS[kind].elements)
        self.record = from_dtype(self.numpy)

    def can_convert_to(self, _context: Any, target_type: Any) -> Any:
        """Allow a row to be written into an array of records that does not belong to a run."""
        return Conversion.safe if target_type == self.record else None


RUN = RunType()
RUN_ARRAYS = {kind: ArrayType(kind) for kind in KINDS}
_ARRAYS = {name: RUN_ARRAYS[array.kind.name] for name, array in ARRAYS.items()}
PLACES = {name: i for i, name in enumerate(ARRAYS)}


@register_model(RunType)
@register_model(ArrayType)
@register_model(RowType)
class _Pointer(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, POINTER)


def marked(builder: Any, line: Any, kind: str) -> Any:
    """Mark which kind of array an instruction reads or writes (type-based alias analysis)."""
    add = builder.module.add_metadata
    root = add([ir.MetaDataString(builder.module, "xdynamics")])
    zero = ir.Constant(WORD, 0)
    # a tag may alias its ancestors: a call of a law so all kinds that programs read or write, and no other
    laws = add([ir.MetaDataString(builder.module, LAWS), root, zero])
    parent = laws if kind in SEEN_BY_LAWS else root
    tag = laws if kind == LAWS else add([ir.MetaDataString(builder.module, kind), parent, zero])
    line.set_metadata("tbaa", add([tag, tag, zero]))
    if kind == CONSTANT:
        line.set_metadata("invariant.load", add([]))
    return line


# --------------------------------------------------------------------------------------------------------------- typing


@infer_getattr
class _OfRun(AttributeTemplate):
    key = RunType

    def generic_resolve(self, _run: Any, name: str) -> Any:  # type: ignore[override]
        return _ARRAYS.get(name)


@infer_getattr
class _OfArray(AttributeTemplate):
    key = ArrayType

    def resolve_shape(self, array: ArrayType) -> Any:
        return types.UniTuple(types.intp, _known_sizes(array))


@infer_getattr
class _OfRow(AttributeTemplate):
    key = RowType

    def generic_resolve(self, row: RowType, name: str) -> Any:  # type: ignore[override]
        return from_dtype(row.numpy.fields[name][0]) if name in row.numpy.fields else None


def _known_sizes(array: ArrayType) -> int:
    """Return how many sizes the table has; of an array of either order a stride replaces the last size."""
    return 1 if KINDS[array.kind].either_order else array.ndim


def _index_type(array: ArrayType) -> Any:
    return types.intp if array.ndim == 1 else types.UniTuple(types.intp, array.ndim)


@infer_global(operator.getitem)
class _Read(AbstractTemplate):
    def generic(self, arguments: Any, _names: Any) -> Any:
        array = arguments[0]
        return signature(array.element, array, _index_type(array)) if isinstance(array, ArrayType) else None


@infer_global(operator.setitem)
class _Written(AbstractTemplate):
    def generic(self, arguments: Any, _names: Any) -> Any:
        array = arguments[0]
        if not isinstance(array, ArrayType):
            return None
        element = array.element.record if isinstance(array.element, RowType) else array.element
        return signature(types.none, array, _index_type(array), element)


# ------------------------------------------------------------------------------------------------------------ lowering


def word_of(builder: Any, table: Any, number: int) -> Any:
    """Return one of the three words of an array."""
    word = builder.load(cgutils.gep_inbounds(builder, table, number))
    # no compiled code changes the table, so writes elsewhere need not cause it to be read again
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def array_data(builder: Any, table: Any) -> Any:
    """Return the address at which an array begins."""
    return builder.inttoptr(word_of(builder, table, 0), POINTER)


def column_offset(builder: Any, table: Any, index: Any) -> Any:
    """Return how far from the first element another one along the last dimension is, in an array of either order."""
    length, row_distance = word_of(builder, table, 1), word_of(builder, table, 2)
    by_rows = builder.icmp_signed("==", row_distance, ir.Constant(WORD, 1))  # also of a single row, which is the first
    return builder.select(by_rows, builder.mul(index, length, flags=["nsw"]), index)


def _element_address(context: Any, builder: Any, array: ArrayType, table: Any, index: Any) -> Any:
    """Return the address of an element."""
    if array.ndim == 2:
        row, column = cgutils.unpack_tuple(builder, index, 2)
        column = column_offset(builder, table, column) if KINDS[array.kind].either_order else column
        index = builder.add(builder.mul(row, word_of(builder, table, 2), flags=["nsw"]), column, flags=["nsw"])
    if isinstance(array.element, RowType):
        words = ir.Constant(WORD, array.numpy.itemsize // 8)
        return builder.gep(array_data(builder, table), [builder.mul(index, words, flags=["nsw"])], inbounds=True)
    data = builder.bitcast(array_data(builder, table), context.get_data_type(array.element).as_pointer())
    return builder.gep(data, [index], inbounds=True)


@lower_getattr_generic(RunType)
def _lower_array(_context: Any, builder: Any, _kind: Any, table: Any, name: str) -> Any:
    return cgutils.gep_inbounds(builder, table, WORDS * PLACES[name])


@lower_getattr(ArrayType, "shape")
def _lower_shape(context: Any, builder: Any, array: ArrayType, table: Any) -> Any:
    size_count = _known_sizes(array)
    words = [word_of(builder, table, 1 + k) for k in range(size_count)]
    return context.make_tuple(builder, types.UniTuple(types.intp, size_count), words)


@lower_builtin(operator.getitem, ArrayType, types.intp)
@lower_builtin(operator.getitem, ArrayType, types.UniTuple)
def _lower_read(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
    array = kinds.args[0]
    address = _element_address(context, builder, array, *arguments)
    return address if isinstance(array.element, RowType) else marked(builder, builder.load(address), array.kind)


@lower_builtin(operator.setitem, ArrayType, types.intp, types.Any)
@lower_builtin(operator.setitem, ArrayType, types.UniTuple, types.Any)
def _lower_write(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
    array = kinds.args[0]
    address = _element_address(context, builder, array, *arguments[:2])
    if isinstance(array.element, RowType):
        size = ir.Constant(WORD, array.numpy.itemsize)
        cgutils.raw_memcpy(builder, address, builder.bitcast(arguments[2], POINTER), size, 1)
    else:
        marked(builder, builder.store(arguments[2], address), array.kind)
    return context.get_dummy_value()


def _field_address(context: Any, builder: Any, row: RowType, row_address: Any, name: str) -> Any:
    dtype, offset = row.numpy.fields[name][:2]
    words = cgutils.gep_inbounds(builder, row_address, offset // 8)
    return builder.bitcast(words, context.get_data_type(from_dtype(dtype)).as_pointer())


@lower_getattr_generic(RowType)
def _lower_field_read(context: Any, builder: Any, row: RowType, row_address: Any, name: str) -> Any:
    return marked(builder, builder.load(_field_address(context, builder, row, row_address, name)), row.kind)


@lower_setattr_generic(RowType)
def _lower_field_write(context: Any, builder: Any, kinds: Any, arguments: Any, name: str) -> Any:
    row, row_address, value = kinds.args[0], arguments[0], arguments[1]
    marked(builder, builder.store(value, _field_address(context, builder, row, row_address, name)), row.kind)


@lower_cast(RowType, types.Record)
def _as_record(context: Any, builder: Any, _row: Any, record: Any, row_address: Any) -> Any:
    return builder.bitcast(row_address, context.get_value_type(record))


def instruction_named(name: str) -> Any:
    """Return the instruction of a name."""
    return intrinsic(_DEFINED[name])


def phase_instruction(name: str, number: int, phase: Signature) -> Any:
    """Return the instruction that calls the phase of a name, whose address has a number in `run.phases`."""
    further = [types.float64 if kind is FLOAT else types.int64 for kind in phase.arguments[1:]]  # besides the run
    words = [ir.DoubleType() if kind == types.float64 else WORD for kind in further]
    result_type: Any = getattr(types, phase.result.value)
    result_word = ir.VoidType() if phase.result is NOTHING else WORD
    called = ir.FunctionType(result_word, [POINTER, *words])

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        addresses = array_data(builder, cgutils.gep_inbounds(builder, arguments[0], WORDS * PLACES["phases"]))
        address = builder.load(cgutils.gep_inbounds(builder, addresses, number))
        address.set_metadata("invariant.load", builder.module.add_metadata([]))  # as the table's words
        result = builder.call(builder.inttoptr(address, called.as_pointer()), arguments)
        if phase.result is NOTHING:
            return context.get_dummy_value()
        return builder.trunc(result, ir.IntType(1)) if phase.result is FLAG else result

    # numba wants to see how many there are
    def of_run(_typing: Any, _run: Any) -> Any:
        return result_type(RUN), generate

    def of_run_and_number(_typing: Any, _run: Any, _number: Any) -> Any:
        return result_type(RUN, *further), generate

    instruction: Any = of_run_and_number if further else of_run
    instruction.__name__ = name  # as numba's messages call it
    return intrinsic(instruction)


def _run_at(_typing: Any, address: Any) -> Any:
    """Return the run whose table stands at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], POINTER)

    return RUN(address), generate


def _floats_at(_typing: Any, address: Any) -> Any:
    """Return the array of numbers whose table entry stands at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], POINTER)

    return RUN_ARRAYS["Floats"](address), generate


def _stepped_by(_typing: Any, step: Any, run: Any, t: Any, t1: Any, h: Any, y: Any, z: Any, sample: Any) -> Any:
    """Call the compiled step at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        step, run, t, t1, h, y, z, sample = arguments
        run, y, z = (builder.ptrtoint(pointer, WORD) for pointer in (run, y, z))
        double = ir.DoubleType()
        kind = ir.FunctionType(ir.VoidType(), [WORD, double, double, double, WORD, WORD, WORD])
        builder.call(builder.inttoptr(step, kind.as_pointer()), [run, t, t1, h, y, z, sample])
        return context.get_dummy_value()

    return types.void(step, run, t, t1, h, y, z, sample), generate


def _enclosed_by(_typing: Any, entry: Any, run: Any, y: Any, z: Any, first: Any, last: Any, whose: Any) -> Any:
    """Call the compiled enclosure at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        entry, run, y, z, first, last, whose = arguments
        run, y, z = (builder.ptrtoint(pointer, WORD) for pointer in (run, y, z))
        kind = ir.FunctionType(ir.VoidType(), [WORD] * 6)
        builder.call(builder.inttoptr(entry, kind.as_pointer()), [run, y, z, first, last, whose])
        return context.get_dummy_value()

    return types.void(entry, run, y, z, first, last, whose), generate


def _row_by(_typing: Any, entry: Any, run: Any, y: Any, z: Any, row: Any) -> Any:
    """Call the operation on intervals at an address, with where a row of the run's begins."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        entry, run, y, z, row = arguments
        rows = cgutils.gep_inbounds(builder, run, WORDS * PLACES["rows"])
        row = builder.gep(array_data(builder, rows), [builder.mul(row, word_of(builder, rows, 2))])
        call_arguments = [run, array_data(builder, y), array_data(builder, z), row]
        builder.call(builder.inttoptr(entry, _LAW.as_pointer()), call_arguments)
        return context.get_dummy_value()

    return types.void(entry, run, y, z, row), generate


def _march_by(_typing: Any, march: Any, address: Any, rows: Any) -> Any:
    """Call the compiled march at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [WORD, WORD])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(march, address, rows), generate


def _strode_by(_typing: Any, stride: Any, table: Any, y: Any, z: Any, samples: Any) -> Any:
    """Call the program of lanes at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [WORD] * 4)
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(stride, table, y, z, samples), generate


_LAW = ir.FunctionType(ir.VoidType(), [POINTER] * 4)  # a run, and where y, z and the samples begin


def _call_program(builder: Any, address: Any, arguments: list[Any]) -> None:
    line = builder.call(builder.inttoptr(address, _LAW.as_pointer()), arguments)
    marked(builder, line, LAWS)


def _call_law(_typing: Any, address: Any, run: Any, y: Any, z: Any, sample: Any) -> Any:
    """Call the program at an address; `sample` is the offset in the run's samples at which it writes."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        address, run, y, z, sample = arguments
        samples = array_data(builder, cgutils.gep_inbounds(builder, run, WORDS * PLACES["samples"]))
        samples = builder.gep(samples, [sample])
        _call_program(builder, address, [run, array_data(builder, y), array_data(builder, z), samples])
        return context.get_dummy_value()

    return types.void(address, run, y, z, sample), generate


def _call_row_writer(_typing: Any, address: Any, run: Any, y: Any, row: Any) -> Any:
    """Call the program at an address to fill a row of the log."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        address, run, y, row = arguments
        table = cgutils.gep_inbounds(builder, run, WORDS * PLACES["log_rows"])
        rows = array_data(builder, table)
        row_address = builder.gep(rows, [column_offset(builder, table, row)])
        _call_program(builder, address, [run, array_data(builder, y), row_address, rows])
        return context.get_dummy_value()

    return types.void(address, run, y, row), generate


_FUNCTION = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()])


def _apply_function(_typing: Any, address: Any, _x: Any) -> Any:
    """Call the function of one number at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        function = builder.inttoptr(arguments[0], _FUNCTION.as_pointer())
        return marked(builder, builder.call(function, arguments[1:]), NO_ARRAY)

    return types.float64(address, types.float64), generate


_DEFINED = {
    "run_at": _run_at,
    "floats_at": _floats_at,
    "stepped_by": _stepped_by,
    "enclosed_by": _enclosed_by,
    "row_by": _row_by,
    "march_by": _march_by,
    "strode_by": _strode_by,
    "applied": _apply_function,
    "called": _call_law,
    "noted": _call_row_writer,
}
