"""A run as compiled code sees it: one pointer to a table of its arrays.

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
from numba import config, from_dtype, types
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

from xdynamics.kernels.compiling import PLAIN
from xdynamics.kernels.program import WORDS
from xdynamics.march.run import ARRAYS, KINDS

LAWS, NOTHING = "laws", "nothing"  # what a call reads or writes
SEEN_BY_LAWS = ("Floats", "Whole", "Columns", "Links")  # kinds that programs read or write
CONSTANT = "Plans"  # the kind that nothing writes while code runs

_WORD = ir.IntType(64)
_POINTER = _WORD.as_pointer()


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
_KINDS = {kind: ArrayType(kind) for kind in KINDS}
_ARRAYS = {name: _KINDS[array.kind.name] for name, array in ARRAYS.items()}
_PLACES = {name: i for i, name in enumerate(ARRAYS)}


@register_model(RunType)
@register_model(ArrayType)
@register_model(RowType)
class _Pointer(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _POINTER)


def marked(builder: Any, line: Any, kind: str) -> Any:
    """Mark which kind of array an instruction reads or writes (type-based alias analysis)."""
    add = builder.module.add_metadata
    root = add([ir.MetaDataString(builder.module, "xdynamics")])
    zero = ir.Constant(_WORD, 0)
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
        return types.UniTuple(types.intp, array.ndim)


@infer_getattr
class _OfRow(AttributeTemplate):
    key = RowType

    def generic_resolve(self, row: RowType, name: str) -> Any:  # type: ignore[override]
        return from_dtype(row.numpy.fields[name][0]) if name in row.numpy.fields else None


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


def _word(builder: Any, table: Any, number: int) -> Any:
    word = builder.load(cgutils.gep_inbounds(builder, table, number))
    # no compiled code changes the table, so writes elsewhere need not cause it to be read again
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


def data_of(builder: Any, table: Any) -> Any:
    """Return the address at which an array begins."""
    return builder.inttoptr(_word(builder, table, 0), _POINTER)


def _place(context: Any, builder: Any, array: ArrayType, table: Any, index: Any) -> Any:
    """Return the address of an element."""
    if array.ndim == 2:
        row, column = cgutils.unpack_tuple(builder, index, 2)
        index = builder.add(builder.mul(row, _word(builder, table, 2), flags=["nsw"]), column, flags=["nsw"])
    if isinstance(array.element, RowType):
        words = ir.Constant(_WORD, array.numpy.itemsize // 8)
        return builder.gep(data_of(builder, table), [builder.mul(index, words, flags=["nsw"])], inbounds=True)
    data = builder.bitcast(data_of(builder, table), context.get_data_type(array.element).as_pointer())
    return builder.gep(data, [index], inbounds=True)


@lower_getattr_generic(RunType)
def _array(_context: Any, builder: Any, _kind: Any, table: Any, name: str) -> Any:
    return cgutils.gep_inbounds(builder, table, WORDS * _PLACES[name])


@lower_getattr(ArrayType, "shape")
def _shape(context: Any, builder: Any, array: ArrayType, table: Any) -> Any:
    words = [_word(builder, table, 1 + k) for k in range(array.ndim)]
    return context.make_tuple(builder, types.UniTuple(types.intp, array.ndim), words)


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
        size = ir.Constant(_WORD, array.numpy.itemsize)
        cgutils.raw_memcpy(builder, place, builder.bitcast(arguments[2], _POINTER), size, 1)
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


# ------------------------------------------------------------------------------------------- runs and laws by address


def _run_at(_typing: Any, address: Any) -> Any:
    """Return the run whose table stands at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], _POINTER)

    return RUN(address), generate


def _floats_at(_typing: Any, address: Any) -> Any:
    """Return the array of numbers whose table entry stands at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], _POINTER)

    return _KINDS["Floats"](address), generate


def _stepped_by(_typing: Any, step: Any, run: Any, t: Any, t1: Any, h: Any, y: Any, z: Any, sample: Any) -> Any:
    """Call the compiled step at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        step, run, t, t1, h, y, z, sample = arguments
        run, y, z = (builder.ptrtoint(pointer, _WORD) for pointer in (run, y, z))
        double = ir.DoubleType()
        kind = ir.FunctionType(ir.VoidType(), [_WORD, double, double, double, _WORD, _WORD, _WORD])
        builder.call(builder.inttoptr(step, kind.as_pointer()), [run, t, t1, h, y, z, sample])
        return context.get_dummy_value()

    return types.void(step, run, t, t1, h, y, z, sample), generate


def _enclosed_by(_typing: Any, entry: Any, run: Any, y: Any, z: Any, first: Any, last: Any, whose: Any) -> Any:
    """Call the compiled enclosure at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        entry, run, y, z, first, last, whose = arguments
        run, y, z = (builder.ptrtoint(pointer, _WORD) for pointer in (run, y, z))
        kind = ir.FunctionType(ir.VoidType(), [_WORD] * 6)
        builder.call(builder.inttoptr(entry, kind.as_pointer()), [run, y, z, first, last, whose])
        return context.get_dummy_value()

    return types.void(entry, run, y, z, first, last, whose), generate


def _row_by(_typing: Any, entry: Any, run: Any, y: Any, z: Any, row: Any) -> Any:
    """Call the operation on intervals at an address, with where a row of the run's begins."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        entry, run, y, z, row = arguments
        rows = cgutils.gep_inbounds(builder, run, WORDS * _PLACES["rows"])
        row = builder.gep(data_of(builder, rows), [builder.mul(row, _word(builder, rows, 2))])
        given = [run, data_of(builder, y), data_of(builder, z), row]
        builder.call(builder.inttoptr(entry, _LAW.as_pointer()), given)
        return context.get_dummy_value()

    return types.void(entry, run, y, z, row), generate


def _entered_by(_typing: Any, entry: Any, run: Any, number: Any, count: Any) -> Any:
    """Call an entry of the engine at an address, with a float and an integer."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        entry, run, number, count = arguments
        kind = ir.FunctionType(ir.VoidType(), [_WORD, ir.DoubleType(), _WORD])
        builder.call(builder.inttoptr(entry, kind.as_pointer()), [builder.ptrtoint(run, _WORD), number, count])
        return context.get_dummy_value()

    return types.void(entry, run, number, count), generate


def _march_by(_typing: Any, march: Any, address: Any, rows: Any) -> Any:
    """Call the compiled march at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [_WORD, _WORD])
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(march, address, rows), generate


def _strode_by(_typing: Any, stride: Any, table: Any, y: Any, z: Any, samples: Any) -> Any:
    """Call the program of lanes at an address."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.VoidType(), [_WORD] * 4)
        builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])
        return context.get_dummy_value()

    return types.void(stride, table, y, z, samples), generate


_LAW = ir.FunctionType(ir.VoidType(), [_POINTER] * 4)  # a run, and where y, z and the samples begin


def _call(builder: Any, address: Any, arguments: list[Any]) -> None:
    line = builder.call(builder.inttoptr(address, _LAW.as_pointer()), arguments)
    marked(builder, line, LAWS)


def _called(_typing: Any, address: Any, run: Any, y: Any, z: Any, sample: Any) -> Any:
    """Call the program at an address; `sample` is the offset in the run's samples at which it writes."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        address, run, y, z, sample = arguments
        samples = data_of(builder, cgutils.gep_inbounds(builder, run, WORDS * _PLACES["samples"]))
        samples = builder.gep(samples, [sample])
        _call(builder, address, [run, data_of(builder, y), data_of(builder, z), samples])
        return context.get_dummy_value()

    return types.void(address, run, y, z, sample), generate


def _noted(_typing: Any, address: Any, run: Any, y: Any, row: Any) -> Any:
    """Call the program at an address to fill a row of the log."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        address, run, y, row = arguments
        rows = data_of(builder, cgutils.gep_inbounds(builder, run, WORDS * _PLACES["log_rows"]))
        _call(builder, address, [run, data_of(builder, y), builder.gep(rows, [row]), rows])
        return context.get_dummy_value()

    return types.void(address, run, y, row), generate


_FUNCTION = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()])


def _applied(_typing: Any, address: Any, _x: Any) -> Any:
    """Call the function of one number at an address."""

    def generate(_context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        function = builder.inttoptr(arguments[0], _FUNCTION.as_pointer())
        return marked(builder, builder.call(function, arguments[1:]), NOTHING)

    return types.float64(address, types.float64), generate


def _itself(run: Any) -> Any:
    return run


def _march_by_plainly(march: Any, run: Any, rows: int) -> None:
    march(run, rows)


def _by_key(entry: int, *arguments: Any) -> None:
    PLAIN[int(entry)](*arguments)


def called_plainly(address: int, run: Any, y: Any, z: Any, sample: int) -> None:
    """Call the Python function that stands for an address where nothing is compiled."""
    PLAIN[int(address)](run.at, y, run.p, run.tables, run.places, z, run.e, run.samples[sample:], run.w)


def applied_plainly(address: int, x: float) -> Any:
    """Call the function of one number that stands for an address where nothing is compiled."""
    return np.float64(PLAIN[int(address)](float(x)))


def noted_plainly(address: int, run: Any, y: Any, row: int) -> None:
    """Call the Python function that fills a row of the log where nothing is compiled."""
    called_plainly(address, run, y, run.log_rows[:, row], 0)


# without numba's compiler (NUMBA_DISABLE_JIT) the engine is plain Python, and entries are given the run itself
_PLAINLY = bool(config.DISABLE_JIT)  # type: ignore[attr-defined]
run_at: Any = _itself if _PLAINLY else intrinsic(_run_at)
floats_at: Any = _itself if _PLAINLY else intrinsic(_floats_at)
stepped_by: Any = _by_key if _PLAINLY else intrinsic(_stepped_by)
enclosed_by: Any = _by_key if _PLAINLY else intrinsic(_enclosed_by)
row_by: Any = _by_key if _PLAINLY else intrinsic(_row_by)
entered_by: Any = _by_key if _PLAINLY else intrinsic(_entered_by)
march_by: Any = _march_by_plainly if _PLAINLY else intrinsic(_march_by)
strode_by: Any = _by_key if _PLAINLY else intrinsic(_strode_by)  # without a compiler there are no lanes
applied: Any = applied_plainly if _PLAINLY else intrinsic(_applied)
called: Any = called_plainly if _PLAINLY else intrinsic(_called)
noted: Any = noted_plainly if _PLAINLY else intrinsic(_noted)
