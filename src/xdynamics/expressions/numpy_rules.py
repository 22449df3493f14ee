"""Functions of numpy, of traced rows: each by its own rule."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions.real_numbers import real
from xdynamics.expressions.reductions import product, reduced
from xdynamics.expressions.traced_grid import ZERO, IrregularError
from xdynamics.expressions.traced_rows import Line, combined, lines_in, of_ufunc, slice_of
from xdynamics.expressions.tracing import Row, Traced, called, choice, node_of
from xdynamics.expressions.tree import Along


def join_rows(parts: Iterable[Any], axis: int = 0) -> Any:
    """Return rows and numbers one after the other.

    Raises
    ------
    IrregularError
        If there are more elements than in the whole, or along another axis.
    """
    values = [*parts]
    first_row = lines_in(values)[0]
    sizes = [value.size if isinstance(value, Line) else int(np.size(value)) for value in values]
    if axis not in (0, -1, None) or any(part.ndim > 1 for part in lines_in(values)) or sum(sizes) > first_row.grid.size:
        raise IrregularError("the function joins rows to more numbers than it was given")
    row = first_row.of(Traced(ZERO), sum(sizes))
    first = 0
    for value, size in zip(values, sizes, strict=True):
        if isinstance(value, Line) or size == 1:
            row[first : first + size] = value[0] if isinstance(value, list | tuple) else value
        else:
            row[first : first + size] = np.asarray(real(value), float)
        first += size
    return row


def join_blocks(parts: Iterable[Any], axis: int) -> Any:
    """Return arrays of two axes, or columns, beside one another.

    Raises
    ------
    IrregularError
        If there are more elements than in the whole, or none has two axes.
    """
    values = [*parts]
    first_plane: Any = next((part for part in lines_in(values) if hasattr(part, "window")), None)
    if first_plane is None or len(lines_in(values)) < len(values) or axis not in (-2, -1, 0, 1):
        raise IrregularError("the function puts arrays beside one another")
    axis %= 2
    counts = [value.shape[axis] if value.ndim > 1 else 1 for value in values]
    size = first_plane.shape[1 - axis] if first_plane.ndim > 1 else first_plane.size
    block = first_plane.blank((sum(counts), size) if axis == 0 else (size, sum(counts)))
    first = 0
    for value, count in zip(values, counts, strict=True):
        part = slice(first, first + count) if value.ndim > 1 else first
        block[part if axis == 0 else (slice(None), part)] = value
        first += count
    return block


def _stack_rule(axis: int) -> Callable[..., Any]:
    """Return the rule for arrays beside one another: rows become one row."""

    def stack_rows(parts: Iterable[Any]) -> Any:
        values = [*parts]
        is_row = axis == 1 and all(value.ndim == 1 for value in lines_in(values))
        return join_rows(values) if is_row else join_blocks(values, axis)

    return stack_rows


def _concatenated(parts: Iterable[Any], axis: int = 0) -> Any:
    values = [*parts]
    return join_blocks(values, axis) if any(value.ndim > 1 for value in lines_in(values)) else join_rows(values, axis)


def split_row(row: Line, count: Any, axis: int = 0) -> list[Line]:
    """Return parts of equal length.

    Raises
    ------
    IrregularError
        If the parts would not be equally long.
    """
    if axis not in (0, -1) or not isinstance(count, int) or row.size % count or row.ndim > 1:
        raise IrregularError("the function splits a row into parts of different lengths")
    n = row.size // count
    return [row[k * n : (k + 1) * n] for k in range(count)]


def roll_array(row: Any, places: Any, axis: Any = None) -> Line:
    """Return the elements some places before, the last ones first; along several axes one after the other.

    Raises
    ------
    IrregularError
        If it is no array that is traced as a whole.
    """
    if isinstance(axis, tuple):
        shifts = places if isinstance(places, tuple) else (places,) * len(axis)
        for k, roll_axis in zip(shifts, axis, strict=True):
            row = roll_array(row, k, roll_axis)
        result: Line = row
        return result
    if not isinstance(row, Line) or not isinstance(places, int | np.integer):
        raise IrregularError("the function rolls an array")
    if axis is None and row.ndim > 1:
        return roll_array(row.ravel(), places).reshape(row.shape)  # type: ignore[attr-defined, no-any-return]
    axis = 0 if axis is None else axis % row.ndim
    k = int(places) % row.shape[axis]
    if not k:
        return row.copy()
    pitch = row.pitch(axis)
    if pitch * row.shape[axis] == row.grid.size and row.value.node == row.grid.leaf:
        return row.alike(Traced(Along("roll", (row.grid.leaf,), (row.grid.dim,), int(places) * pitch)))
    return row.alike(row.displaced(k, axis))


def _difference_rows(row: Any, n: int = 1, axis: int = -1) -> Any:
    for _ in range(n):
        leading_slices = (slice(None),) * (axis % row.ndim)
        row = row[(*leading_slices, slice(1, None))] - row[(*leading_slices, slice(None, -1))]
    return row


def _row_gradient(array: Line, *spacing: Any, axis: Any = None) -> Any:
    axes = [*range(array.ndim)] if axis is None else [axis % array.ndim]
    steps = spacing if len(spacing) == len(axes) else (*spacing, 1.0)[:1] * len(axes)
    slopes = []
    for gradient_axis, h in zip(axes, steps, strict=True):
        result: Any = _filled_like(0.0)(array)
        for to, ahead, behind in ((slice(1, -1), slice(2, None), slice(-2)), (0, 1, 0), (-1, -1, -2)):
            to_key, ahead_key, behind_key = ((*[slice(None)] * gradient_axis, part) for part in (to, ahead, behind))
            result[to_key] = (array[ahead_key] - array[behind_key]) / (h * (2.0 if isinstance(to, slice) else 1.0))
        slopes.append(result)
    return slopes if len(slopes) > 1 else slopes[0]


class Padded(Row):
    """An array with more elements at its ends, of which windows as large as it was are taken."""

    def __init__(self, array: Line, widths: list[tuple[int, int]], mode: str) -> None:
        self.array, self.widths, self.mode, self.ndim = array, widths, mode, array.ndim
        self.shape = tuple(
            n + pad_before + pad_after for n, (pad_before, pad_after) in zip(array.shape, widths, strict=True)
        )

    def __getitem__(self, key: Any) -> Any:
        keys, part = key if isinstance(key, tuple) else (key,), self.array
        keys += (slice(None),) * (self.ndim - len(keys))
        for axis, (axis_key, size, (pad_before, _)) in enumerate(zip(keys, self.shape, self.widths, strict=True)):
            first, count = slice_of(axis_key, size) if isinstance(axis_key, slice) else (0, 0)
            if count != part.shape[axis]:
                raise IrregularError("the function pads an array and takes another part than one of its old shape")
            part = self._shift_elements(part, first - pad_before, axis)
        return part

    def _shift_elements(self, array: Line, places: int, axis: int) -> Line:
        """Return the elements some places after along an axis."""
        if not places:
            return array
        result: Any = roll_array(array, -places, axis)
        leading_slices = (slice(None),) * axis
        beyond, end = (slice(-places, None), -1) if places > 0 else (slice(0, -places), 0)
        if self.mode == "constant":
            result[(*leading_slices, beyond)] = 0.0
        elif self.mode == "edge":
            for k in range(abs(places)):
                result[(*leading_slices, end - k if places > 0 else k)] = array[(*leading_slices, end)]
        return result  # type: ignore[no-any-return]


def _pad_array(array: Line, width: Any, mode: str = "constant", **options: Any) -> Any:
    widths = np.broadcast_to(np.asarray(width), (array.ndim, 2)).tolist()
    if mode not in ("constant", "edge", "wrap") or options.get("constant_values", 0) != 0 or len(options) > 1:
        raise IrregularError("the function pads an array otherwise than by zeros, its ends, or all around")
    pad_before, pad_after = widths[0]
    if array.ndim == 1 and array.size + pad_before + pad_after <= array.grid.size and max(pad_before, pad_after) <= 1:
        row: Any = array
        ends = {"edge": (row[0], row[-1]), "constant": (0.0, 0.0), "wrap": (row[-1], row[0])}[mode]
        return join_rows([*[ends[0]] * pad_before, row, *[ends[1]] * pad_after])
    return Padded(array, widths, mode)


def _filled_like(value: float) -> Callable[..., Line]:
    return lambda row, *_, **__: row.alike(Traced(node_of(value)))


def _clip_rows(row: Any, low: Any = None, high: Any = None) -> Any:
    row = row if low is None else combined(partial(of_ufunc, "maximum"), row, low)
    return row if high is None else combined(partial(of_ufunc, "minimum"), row, high)


def _variance(row: Line, axis: Any = None, *, ddof: int = 0, **options: Any) -> Any:
    """Return the mean square of what elements differ by from their mean."""
    deviations = row - reduced("sum", row, axis, **options) / row.size
    return reduced("sum", deviations * deviations, axis, **options) / (row.size - ddof)


def _row_norm(row: Line, ord: Any = None, **options: Any) -> Traced:  # noqa: A002 - numpy's
    if ord not in (None, 2):
        raise IrregularError("the function takes another norm of a row")
    return called("sqrt", reduced("sum", combined(partial(of_ufunc, "multiply"), row, row), **options))


_RULES: dict[Any, Callable[..., Any]] = {
    np.where: lambda condition, yes, no: combined(choice, condition, yes, no),
    np.clip: _clip_rows,
    np.roll: roll_array,
    np.diff: _difference_rows,
    np.gradient: _row_gradient,
    np.concatenate: _concatenated,
    np.hstack: _stack_rule(1),
    np.vstack: _stack_rule(0),
    np.column_stack: lambda parts: join_blocks(parts, 1),
    np.stack: lambda parts, axis=0: join_rows([part.ravel() for part in parts], axis),
    np.append: lambda first, second: join_rows([first, second]),
    np.pad: _pad_array,
    np.split: split_row,
    np.array_split: split_row,
    np.sum: lambda row, axis=None, **options: reduced("sum", row, axis, **options),
    np.mean: lambda row, axis=None, **options: reduced("sum", row, axis, **options) / row.size,
    np.var: _variance,
    np.std: lambda row, axis=None, **options: called("sqrt", _variance(row, axis, **options)),
    np.ptp: lambda row, axis=None, **options: (
        reduced("max", row, axis, **options) - reduced("min", row, axis, **options)
    ),
    np.max: lambda row, axis=None, **options: reduced("max", row, axis, **options),
    np.min: lambda row, axis=None, **options: reduced("min", row, axis, **options),
    np.dot: product,
    np.inner: product,
    np.vdot: product,
    np.linalg.norm: _row_norm,
    np.zeros_like: _filled_like(0.0),
    np.empty_like: _filled_like(0.0),
    np.ones_like: _filled_like(1.0),
    np.copy: lambda row: row.copy(),
    np.ravel: lambda row, order="C": row.ravel(order) if order != "C" else row.ravel(),
    np.reshape: lambda row, shape, **options: row.reshape(shape, **options),
    np.transpose: lambda row: row.T,
    np.shape: lambda row: row.shape,
    np.ndim: lambda row: row.ndim,
    np.size: lambda row: row.size,
}


def of_rows(function: Any, *arguments: Any, **options: Any) -> Any:
    """Call a function of numpy with rows among its arguments.

    Raises
    ------
    IrregularError
        If it is none of those that are known.
    """
    if isinstance(function, np.ufunc):
        return (
            product(*arguments) if function is np.matmul else combined(partial(of_ufunc, function.__name__), *arguments)
        )
    if function not in _RULES:
        raise IrregularError(f"the function calls numpy.{function.__name__} of a row")
    return _RULES[function](*arguments, **options)
