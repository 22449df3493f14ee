"""Functions of numpy, of traced rows: each by its own rule."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions.reductions import product, reduced
from xdynamics.expressions.traced_grid import ZERO, IrregularError
from xdynamics.expressions.traced_rows import Line, combined, lines_in, of_ufunc
from xdynamics.expressions.tracing import Traced, called, choice, node_of
from xdynamics.expressions.tree import Along


def joined(parts: Iterable[Any], axis: int = 0) -> Any:
    """Return rows and numbers one after the other.

    Raises
    ------
    IrregularError
        If there are more elements than in the whole, or along another axis.
    """
    values = [*parts]
    known = lines_in(values)[0]
    sizes = [value.size if isinstance(value, Line) else int(np.size(value)) for value in values]
    if axis not in (0, -1, None) or sum(sizes) > known.grid.size:
        raise IrregularError("the function joins rows to more numbers than it was given")
    row = known.of(Traced(ZERO), sum(sizes))
    first = 0
    for value, size in zip(values, sizes, strict=True):
        if isinstance(value, Line) or size == 1:
            row[first : first + size] = value[0] if isinstance(value, list | tuple) else value
        else:
            row[first : first + size] = np.asarray(value, float)
        first += size
    return row


def split(row: Line, count: Any, axis: int = 0) -> list[Line]:
    """Return parts of equal length.

    Raises
    ------
    IrregularError
        If the parts would not be equally long.
    """
    if axis not in (0, -1) or not isinstance(count, int) or row.size % count:
        raise IrregularError("the function splits a row into parts of different lengths")
    n = row.size // count
    return [row[k * n : (k + 1) * n] for k in range(count)]


def rolled(row: Any, places: Any, axis: Any = None) -> Line:
    """Return the elements some places before, the last ones first.

    Raises
    ------
    IrregularError
        If it is no row.
    """
    if not isinstance(row, Line) or axis not in (None, 0, -1) or not isinstance(places, int):
        raise IrregularError("the function rolls an array")
    k = places % row.size
    if not k:
        return row.copy()
    if row.size == row.grid.size and row.value.node == row.grid.leaf:
        node = row.grid.leaf
        rolled_node = Along("roll", (node,), (row.grid.dim,), places)
        return row.of(Traced(rolled_node), row.size)
    result: Line = joined([row[-k:], row[:-k]])
    return result


def _differences(row: Any, n: int = 1, axis: int = -1) -> Any:
    if axis not in (0, -1):
        raise IrregularError("the function takes differences along another axis")
    for _ in range(n):
        row = row[1:] - row[:-1]
    return row


def _gradient(row: Line, *spacing: Any) -> Line:
    h = spacing[0] if spacing else 1.0
    result: Line = joined([(row[1:2] - row[0:1]) / h, (row[2:] - row[:-2]) / (2.0 * h), (row[-1:] - row[-2:-1]) / h])
    return result


def _padded(row: Line, width: Any, mode: str = "constant", **options: Any) -> Any:
    before, after = (width, width) if isinstance(width, int) else width
    ends: dict[str, tuple[Any, Any]] = {"edge": (row[0], row[-1]), "constant": (0.0, 0.0), "wrap": (row[-1], row[0])}
    if mode not in ends or options or max(before, after) > 1:
        raise IrregularError("the function pads a row")
    return joined([*[ends[mode][0]] * before, row, *[ends[mode][1]] * after])


def _filled(value: float) -> Callable[..., Line]:
    return lambda row, *_, **__: row.of(Traced(node_of(value)), row.size)


def _clipped(row: Any, low: Any = None, high: Any = None) -> Any:
    row = row if low is None else combined(partial(of_ufunc, "maximum"), row, low)
    return row if high is None else combined(partial(of_ufunc, "minimum"), row, high)


def _norm(row: Line, ord: Any = None, **options: Any) -> Traced:  # noqa: A002 - numpy's
    if ord not in (None, 2):
        raise IrregularError("the function takes another norm of a row")
    return called("sqrt", reduced("sum", combined(partial(of_ufunc, "multiply"), row, row), **options))


_RULES: dict[Any, Callable[..., Any]] = {
    np.where: lambda condition, yes, no: combined(choice, condition, yes, no),
    np.clip: _clipped,
    np.roll: rolled,
    np.diff: _differences,
    np.gradient: _gradient,
    np.concatenate: joined,
    np.hstack: joined,
    np.append: lambda first, second: joined([first, second]),
    np.pad: _padded,
    np.split: split,
    np.array_split: split,
    np.sum: lambda row, axis=None, **options: reduced("sum", row, axis, **options),
    np.mean: lambda row, axis=None, **options: reduced("sum", row, axis, **options) / row.size,
    np.max: lambda row, axis=None, **options: reduced("max", row, axis, **options),
    np.min: lambda row, axis=None, **options: reduced("min", row, axis, **options),
    np.dot: product,
    np.inner: product,
    np.vdot: product,
    np.linalg.norm: _norm,
    np.zeros_like: _filled(0.0),
    np.empty_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.copy: lambda row: row.copy(),
    np.ravel: lambda row: row.copy(),
    np.shape: lambda row: row.shape,
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
