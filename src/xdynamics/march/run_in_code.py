"""A run as numba compiles it: one pointer to a table of its arrays. Imported when the engine is compiled, and only then.

Passed as a tuple of numba's arrays, a run is some 300 numbers at every call, and compiling the loop takes a minute.
Through the table it is one number: ``run.y`` is the place of three words in it, and ``run.y[i]`` reads the array's address
and then the element. The compiler is given facts that hold for these arrays alone: the table never changes
while code runs, nor does a plan, and a write to one kind of array changes no array of another kind.
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
    lower_builtin,
    lower_cast,
    lower_getattr,
    lower_getattr_generic,
    lower_setattr_generic,
    models,
    register_model,
)

from xdynamics.kernels.program import WORDS
from xdynamics.march.run import ARRAYS, KINDS

LAWS, NOTHING = "laws", "nothing"  # what a call reads or writes
SEEN_BY_LAWS = ("Floats", "Whole", "Columns", "LogRows", "Links")  # kinds that programs read or write
CONSTANT = "Plans"  # the kind that nothing writes while code runs

WORD = ir.IntType(64)
POINTER = WORD.as_pointer()


class RunType(types.Type):
    """The type of a run in compiled code."""

    def __init__(self) -> None:
        super().__init__(name="xdynamics.Run")


class ArrayType(types.Type):
    """The type of one of a run's arrays: the place of its three words in the table."""

    def __init__(self, kind: str) -> None:
        super().__init__(name=f"xdynamics.{kind}")
        self.kind = kind
        self.numpy, self.ndim = np.dtype(KINDS[kind].elements), KINDS[kind].dimensions
        self.element = RowType(kind) if self.numpy.names else from_dtype(self.numpy)


class RowType(types.Type):
    """The type of a row with named fields, which is accessed in place."""

    def __init__(self, kind: str) -> None:
        super().__init__(name=f"xdynamics.{kind}.row")
        self.kind = kind
        self.numpy = np.dtype(KINDS[kind].elements)
        self.record = from_dtype(self.numpy)

    def can_convert_to(self, _context: Any, other: Any) -> Any:
        """Allow a row to be written into an array of records that does not belong to a run."""
        return Conversion.safe if other == self.record else None


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
    """Return how many sizes the table has: in place of the last one of an array of either order is a distance."""
    return 1 if KINDS[array.kind].either_order else array.ndim


def _index(array: ArrayType) -> Any:
    return types.intp if array.ndim == 1 else types.UniTuple(types.intp, array.ndim)


@infer_global(operator.getitem)
class _Read(AbstractTemplate):
    def generic(self, given: Any, _names: Any) -> Any:
        array = given[0]
        return signature(array.element, array, _index(array)) if isinstance(array, ArrayType) else None


@infer_global(operator.setitem)
class _Written(AbstractTemplate):
    def generic(self, given: Any, _names: Any) -> Any:
        array = given[0]
        if not isinstance(array, ArrayType):
            return None
        element = array.element.record if isinstance(array.element, RowType) else array.element
        return signature(types.none, array, _index(array), element)


# ------------------------------------------------------------------------------------------------------------ lowering


def word_of(builder: Any, table: Any, number: int) -> Any:
    """Return one of the three words of an array."""
    word = builder.load(cgutils.gep_inbounds(builder, table, number))
    # no compiled code changes the table, so writes elsewhere need not cause it to be read again
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def data_of(builder: Any, table: Any) -> Any:
    """Return the address at which an array begins."""
    return builder.inttoptr(word_of(builder, table, 0), POINTER)


def times_apart(builder: Any, table: Any, index: Any) -> Any:
    """Return how far from the first element another one along the last dimension is, in an array of either order."""
    length, apart = word_of(builder, table, 1), word_of(builder, table, 2)
    by_rows = builder.icmp_signed("==", apart, ir.Constant(WORD, 1))  # also of a single row, which is the first
    return builder.select(by_rows, builder.mul(index, length, flags=["nsw"]), index)


def _place(context: Any, builder: Any, array: ArrayType, table: Any, index: Any) -> Any:
    """Return the address of an element."""
    if array.ndim == 2:
        row, column = cgutils.unpack_tuple(builder, index, 2)
        column = times_apart(builder, table, column) if KINDS[array.kind].either_order else column
        index = builder.add(builder.mul(row, word_of(builder, table, 2), flags=["nsw"]), column, flags=["nsw"])
    if isinstance(array.element, RowType):
        words = ir.Constant(WORD, array.numpy.itemsize // 8)
        return builder.gep(data_of(builder, table), [builder.mul(index, words, flags=["nsw"])], inbounds=True)
    data = builder.bitcast(data_of(builder, table), context.get_data_type(array.element).as_pointer())
    return builder.gep(data, [index], inbounds=True)


@lower_getattr_generic(RunType)
def _array(_context: Any, builder: Any, _kind: Any, table: Any, name: str) -> Any:
    return cgutils.gep_inbounds(builder, table, WORDS * PLACES[name])


@lower_getattr(ArrayType, "shape")
def _shape(context: Any, builder: Any, array: ArrayType, table: Any) -> Any:
    known = _known_sizes(array)
    words = [word_of(builder, table, 1 + k) for k in range(known)]
    return context.make_tuple(builder, types.UniTuple(types.intp, known), words)


@lower_builtin(operator.getitem, ArrayType, types.intp)
@lower_builtin(operator.getitem, ArrayType, types.UniTuple)
def _read(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
    array = kinds.args[0]
    place = _place(context, builder, array, *arguments)
    return place if isinstance(array.element, RowType) else marked(builder, builder.load(place), array.kind)


@lower_builtin(operator.setitem, ArrayType, types.intp, types.Any)
@lower_builtin(operator.setitem, ArrayType, types.UniTuple, types.Any)
def _write(context: Any, builder: Any, kinds: Any, arguments: Any) -> Any:
    array = kinds.args[0]
    place = _place(context, builder, array, *arguments[:2])
    if isinstance(array.element, RowType):
        size = ir.Constant(WORD, array.numpy.itemsize)
        cgutils.raw_memcpy(builder, place, builder.bitcast(arguments[2], POINTER), size, 1)
    else:
        marked(builder, builder.store(arguments[2], place), array.kind)
    return context.get_dummy_value()


def _field(context: Any, builder: Any, row: RowType, place: Any, name: str) -> Any:
    dtype, offset = row.numpy.fields[name][:2]
    words = cgutils.gep_inbounds(builder, place, offset // 8)
    return builder.bitcast(words, context.get_data_type(from_dtype(dtype)).as_pointer())


@lower_getattr_generic(RowType)
def _field_read(context: Any, builder: Any, row: RowType, place: Any, name: str) -> Any:
    return marked(builder, builder.load(_field(context, builder, row, place, name)), row.kind)


@lower_setattr_generic(RowType)
def _field_written(context: Any, builder: Any, kinds: Any, arguments: Any, name: str) -> Any:
    row, place, value = kinds.args[0], arguments[0], arguments[1]
    marked(builder, builder.store(value, _field(context, builder, row, place, name)), row.kind)


@lower_cast(RowType, types.Record)
def _as_record(context: Any, builder: Any, _row: Any, record: Any, place: Any) -> Any:
    return builder.bitcast(place, context.get_value_type(record))
