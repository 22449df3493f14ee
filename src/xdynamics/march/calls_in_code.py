"""What `march.calls` names, as numba compiles it: calls by addresses, and runs behind them.

Imported when the engine is compiled, and only then.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from xdynamics.kernels.program import WORDS
from xdynamics.march.run_in_code import (
    LAWS,
    NOTHING,
    PLACES,
    POINTER,
    RUN,
    RUN_ARRAYS,
    WORD,
    array_data,
    column_offset,
    marked,
    word_of,
)


def instruction_named(name: str) -> Any:
    """Return the instruction of a name."""
    return intrinsic(_DEFINED[name])


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


def _call_phase(_typing: Any, entry: Any, run: Any, number: Any, count: Any) -> Any:
    """Call an entry of the engine at an address, with a float and an integer."""

    def generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        entry, run, number, count = arguments
        kind = ir.FunctionType(ir.VoidType(), [WORD, ir.DoubleType(), WORD])
        builder.call(builder.inttoptr(entry, kind.as_pointer()), [builder.ptrtoint(run, WORD), number, count])
        return context.get_dummy_value()

    return types.void(entry, run, number, count), generate


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
        return marked(builder, builder.call(function, arguments[1:]), NOTHING)

    return types.float64(address, types.float64), generate


_DEFINED = {
    "run_at": _run_at,
    "floats_at": _floats_at,
    "stepped_by": _stepped_by,
    "enclosed_by": _enclosed_by,
    "row_by": _row_by,
    "entered_by": _call_phase,
    "march_by": _march_by,
    "strode_by": _strode_by,
    "applied": _apply_function,
    "called": _call_law,
    "noted": _call_row_writer,
}
