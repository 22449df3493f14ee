"""Functions of numpy, of arrays of any number of axes that are traced as a whole: each by its own rule."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np

from xdynamics.expressions.traced_cubes import Cube, applied_to, combined, shape_of
from xdynamics.expressions.traced_grid import Grid, IrregularError
from xdynamics.expressions.traced_indices import index
from xdynamics.expressions.traced_products import PRODUCTS
from xdynamics.expressions.tracing import Traced, choice, node_of
from xdynamics.expressions.tree import Call, Number


def cubes_in(values: Iterable[Any]) -> list[Cube]:
    """Return the arrays among some values and in lists of them."""
    found: list[Cube] = []
    for value in values:
        if isinstance(value, Cube):
            found.append(value)
        elif isinstance(value, list | tuple):
            found += cubes_in(value)
    return found


def blank(grid: Grid, shape: Any, value: float = 0.0) -> Cube:
    """Return an array with one number everywhere."""
    sizes = (shape,) if isinstance(shape, int | np.integer) else shape
    return Cube(grid, Traced(node_of(value)), tuple(map(int, sizes)))


def joined(parts: Iterable[Any], axis: Any = 0) -> Cube:
    """Return arrays one after the other along an axis; all in a row where there is none.

    Raises
    ------
    ValueError
        If their shapes do not fit, as numpy says it.
    """
    values = [*parts]
    if axis is None:
        values, axis = [value.ravel() if isinstance(value, Cube) else np.ravel(value) for value in values], 0
    shapes, grid = [shape_of(value) for value in values], cubes_in(values)[0].grid
    axis %= len(shapes[0])
    if len({(*shape[:axis], *shape[axis + 1 :]) for shape in shapes}) > 1:
        raise ValueError(f"all the input array dimensions except for the concatenation axis must match: {shapes}")
    total = sum(shape[axis] for shape in shapes)
    whole, first = blank(grid, (*shapes[0][:axis], total, *shapes[0][axis + 1 :])), 0
    for value, shape in zip(values, shapes, strict=True):
        whole[(*(slice(None),) * axis, slice(first, first + shape[axis]))] = value
        first += shape[axis]
    return whole.copy()  # type: ignore[no-any-return]


def stacked(parts: Iterable[Any], axis: int = 0) -> Any:
    """Return arrays, or numbers, along a new axis."""
    values = [*parts]
    ndim = len(shape_of(values[0])) + 1
    key = tuple(None if k == axis % ndim else slice(None) for k in range(ndim))
    return joined([_row(value) if not shape_of(value) else value[key] for value in values], axis)


def _row(value: Any) -> Any:
    """Return a number as an array of one, which is joined with others."""
    return (
        value
        if isinstance(value, Cube)
        else np.array([value], object)
        if isinstance(value, Traced)
        else np.array([value])
    )


def rolled(array: Cube, places: Any, axis: Any = None) -> Any:
    """Return the elements some places before, the last ones first."""
    if axis is None:
        return rolled(array.ravel(), places, 0).reshape(array.shape)
    if isinstance(axis, tuple):
        for k, one in zip(places if isinstance(places, tuple) else (places,) * len(axis), axis, strict=True):
            array = rolled(array, k, one)
        return array
    along = axis % array.ndim
    number = Traced(index(array.dims[along])) - int(places) % array.shape[along]
    picks: list[Any] = [None] * array.ndim
    picks[along] = Call("mod", (number.node, Number(float(array.shape[along]))))
    return array.at(array.shape, picks)


def _norm(array: Cube, ord: Any = None, axis: Any = None, keepdims: bool = False) -> Any:  # noqa: A002, FBT001, FBT002
    if ord not in (None, 2) or (ord == 2 and array.ndim > 1 and axis is None):
        raise IrregularError("the function takes another norm of an array")
    total = combined(partial(applied_to, "multiply"), array, array).sum(axis, keepdims=keepdims)
    return combined(partial(applied_to, "sqrt"), total) if isinstance(total, Cube) else applied_to("sqrt", total)


def _clipped(array: Any, low: Any = None, high: Any = None) -> Any:
    array = array if low is None else combined(partial(applied_to, "maximum"), array, low)
    return array if high is None else combined(partial(applied_to, "minimum"), array, high)


def _differences(array: Any, n: int = 1, axis: int = -1) -> Any:
    for _ in range(n):
        before = (slice(None),) * (axis % array.ndim)
        array = array[(*before, slice(1, None))] - array[(*before, slice(None, -1))]
    return array


def _expanded(array: Cube, axis: int) -> Any:
    return array[(*(slice(None),) * (axis % (array.ndim + 1)), None)]


def _stacked_along(axis: int) -> Callable[..., Any]:
    """Return the rule for arrays beside, or above, one another."""

    def beside(parts: Iterable[Any]) -> Any:
        values = [*parts]
        rows = all(len(shape_of(value)) == 1 for value in values)
        if rows:
            return joined(values) if axis == 1 else stacked(values)
        return joined([value[None] if len(shape_of(value)) == 1 else value for value in values], axis)

    return beside


def _columns(parts: Iterable[Any]) -> Any:
    return joined([value[:, None] if len(shape_of(value)) == 1 else value for value in parts], 1)


def _like(value: float) -> Callable[..., Cube]:
    return lambda array, *_, **__: blank(array.grid, array.shape, value)


def _taken(array: Any, places: Any, axis: int | None = None) -> Any:
    whole = array.ravel() if axis is None else array
    return whole[(*(slice(None),) * ((axis or 0) % whole.ndim), places)]


_RULES: dict[Any, Callable[..., Any]] = PRODUCTS | {
    np.take: _taken,
    np.where: lambda condition, yes, no: combined(choice, condition, yes, no),
    np.clip: _clipped,
    np.roll: rolled,
    np.diff: _differences,
    np.concatenate: joined,
    np.stack: stacked,
    np.hstack: _stacked_along(1),
    np.vstack: _stacked_along(0),
    np.column_stack: _columns,
    np.append: lambda first, second, axis=None: joined([first, second], axis),
    np.sum: lambda array, axis=None, **options: array.reduced("sum", axis, **options),
    np.mean: lambda array, axis=None, **options: array.mean(axis, **options),
    np.max: lambda array, axis=None, **options: array.reduced("max", axis, **options),
    np.min: lambda array, axis=None, **options: array.reduced("min", axis, **options),
    np.linalg.norm: _norm,
    np.expand_dims: _expanded,
    np.squeeze: lambda array: array[tuple(0 if n == 1 else slice(None) for n in array.shape)],
    np.zeros_like: _like(0.0),
    np.empty_like: _like(0.0),
    np.ones_like: _like(1.0),
    np.copy: lambda array: array.copy(),
    np.ravel: lambda array, **options: array.ravel(**options),
    np.reshape: lambda array, shape, **options: array.reshape(shape, **options),
    np.transpose: lambda array, axes=None: array.transpose(*(axes or ())),
    np.swapaxes: lambda array, one, other: array.swapaxes(one, other),
    np.shape: lambda array: array.shape,
    np.ndim: lambda array: array.ndim,
    np.size: lambda array: array.size,
}


def of_cubes(function: Any, *arguments: Any, **options: Any) -> Any:
    """Call a function of numpy with arrays among its arguments.

    Raises
    ------
    IrregularError
        If it is none of those that are known.
    """
    if isinstance(function, np.ufunc) and function not in _RULES and not options:
        return combined(partial(applied_to, function.__name__), *arguments)
    if function not in _RULES:
        raise IrregularError(f"the function calls numpy.{function.__name__} of an array of several axes")
    return _RULES[function](*arguments, **options)


Cube.rules = staticmethod(of_cubes)
