"""Arrays of any number of axes traced as a whole: one expression of the indices of its axes.

What numpy does with shapes is done with indices: a slice is the expression at an index plus a number, a new axis one of
which nothing depends, a sum one along the dimension of an axis. Numbers that are not known are read by `take`, at a place
that is a sum of multiples of indices, so that bodies are joined with bodies in loops, however many they are.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from functools import partial
from math import prod
from operator import index as whole_number
from typing import Any

import numpy as np

from xdynamics.expressions.real_numbers import real
from xdynamics.expressions.traced_grid import Grid, IrregularError
from xdynamics.expressions.traced_indices import axis, bound, flat, index, numbers_along, read_at, replaced
from xdynamics.expressions.traced_operators import give_operators
from xdynamics.expressions.tracing import Row, Traced, applied, choice, node_of
from xdynamics.expressions.tree import Along, Binary, Call, Name, Node, Number, every
from xdynamics.faults import InputError

MOST_PARTS = 30  # that a function goes through, or fills, one by one

Shape = tuple[int, ...]


class Cube(Row):
    """An array of numbers that are not known.

    Parameters
    ----------
    grid : Grid
    value : Traced
        The expression of an element, by the indices of its axes.
    shape : tuple of int
    view : bool
        Whether it is part of another array, which numpy would change with it.
    """

    __hash__ = None  # type: ignore[assignment]
    dtype = np.dtype(float)

    def __init__(self, grid: Grid, value: Traced, shape: Shape, *, view: bool = False) -> None:
        self.grid, self.value, self.shape, self.view, self.filled = grid, value, shape, view, 0
        self.ndim, self.size = len(shape), prod(shape)

    @property
    def dims(self) -> tuple[str, ...]:
        """The dimension of every axis."""
        return tuple(axis(self.grid, n, self.ndim - 1 - k) for k, n in enumerate(self.shape))

    def at(self, shape: Shape, places: Iterable[Node | None], *, view: bool = False) -> Any:
        """Return an array of another shape, of which each axis here is read at a place; a number, if it has no axes."""
        given = {dim: place for dim, place in zip(self.dims, places, strict=True) if place is not None}
        node = read_at(self.value.node, {**given}, self.grid)
        value = Traced(node, self.value.nodes)
        return Cube(self.grid, value, shape, view=view) if shape else value

    # -------------------------------------------------------------------------------------------------------- numpy's

    def __array_ufunc__(self, ufunc: Any, how: str, *given: Any, **options: Any) -> Any:
        """Apply a function of numpy to every element."""
        if how == "reduce" and ufunc in _REDUCED:
            return self.reduced(_REDUCED[ufunc], **options)
        if ufunc is np.matmul and not options:
            return Cube.rules(ufunc, *given)
        if how != "__call__" or options:
            raise IrregularError(f"the function calls numpy.{ufunc.__name__}.{how} of an array")
        return combined(partial(applied_to, ufunc.__name__), *given)

    def __array_function__(self, function: Any, _types: Any, arguments: Any, options: Any) -> Any:
        """Call a function of numpy."""
        return Cube.rules(function, *arguments, **options)

    def __array__(self, *_: Any, **__: Any) -> Any:
        raise IrregularError("the function makes an array of elements of an array")

    def __getattr__(self, word: str) -> Any:
        raise IrregularError(f"the function takes .{word} of an array")

    rules: Callable[..., Any]  # is `cube_rules.of_cubes`

    def __len__(self) -> int:
        return self.shape[0]

    def __iter__(self) -> Iterator[Any]:
        if len(self) > MOST_PARTS:
            raise IrregularError("the function goes through an array")
        return (self[i] for i in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        shape, picks = self.picked(key)
        dims = [axis(self.grid, n, len(shape) - 1 - k) for k, n in enumerate(shape)]
        places: list[Node] = []
        for first, step, place in picks:
            if isinstance(first, np.ndarray):
                places.append(numbers_along(first, index(dims[place or 0])))
                continue
            number: Node = Number(float(first)) if first >= 0 else -Traced(Number(-float(first))).node
            if place is not None:
                number = Binary("+", number, Binary("*", node_of(float(step)), index(dims[place])))
            places.append(number)
        return self.at(shape, places, view=True)

    def picked(self, key: Any) -> tuple[Shape, list[tuple[Any, int, int | None]]]:
        """Return the shape that a key picks, and of each axis here the first element, the step, and the axis there.

        Of a list, the elements stand in the place of the first.

        Raises
        ------
        IrregularError
            If it is neither made of slices, whole numbers, new axes nor an ellipsis.
        """
        keys = [*key] if isinstance(key, tuple) else [key]
        lists = [isinstance(part, Row | np.ndarray | list) for part in keys]
        if sum(lists) > 1 or (any(lists) and any(isinstance(part, int | np.integer) for part in keys)):
            raise IrregularError("the function picks elements of an array by several lists at once")
        if any(part is Ellipsis for part in keys):
            place = next(i for i, part in enumerate(keys) if part is Ellipsis)
            rest = self.ndim - sum(part is not None and part is not Ellipsis for part in keys)
            keys[place : place + 1] = [slice(None)] * rest
        keys += [slice(None)] * (self.ndim - sum(part is not None for part in keys))
        shape: list[int] = []
        picks: list[tuple[Any, int, int | None]] = []
        for part in keys:
            if part is None:
                shape.append(1)
                continue
            if len(picks) == self.ndim:
                raise IndexError(f"too many indices for array: array is {self.ndim}-dimensional")
            n = self.shape[len(picks)]
            if isinstance(part, Row | np.ndarray | list):
                first, step, count = listed_places(part, n, len(picks))
                picks.append((first, step, len(shape)))
                shape.append(count)
                continue
            if isinstance(part, slice):
                first, last, step = part.indices(n)
                count = len(range(first, last, step))
                if not count:
                    raise IrregularError("the function takes no element of an array")
                picks.append((first, step, len(shape)))
                shape.append(count)
                continue
            try:
                number = whole_number(part)
            except (TypeError, InputError):
                raise IrregularError("the function picks elements of an array by a number that is not known") from None
            if not -n <= number < n:
                raise IndexError(f"index {number} is out of bounds for axis {len(picks)} with size {n}")
            picks.append((number % n, 1, None))
        return tuple(shape), picks

    def __setitem__(self, key: Any, values: Any) -> None:
        self.filled += 1
        if self.view or self.filled > MOST_PARTS:
            raise IrregularError("the function fills an array by elements")
        if isinstance(key, Cube):
            if isinstance(values, Cube) or np.ndim(values):
                raise IrregularError("the function sets chosen elements to those of another array")
            self.value = combined(choice, key, values, self).value
            return
        shape, picks = self.picked(key)
        if any(step != 1 or isinstance(first, np.ndarray) for first, step, _ in picks) or len(shape) > self.ndim:
            raise IrregularError("the function sets elements of an array that are not neighbours")
        part = spread(values, shape, self.grid)
        places: list[Node | None] = [None] * len(shape)
        inside: list[Traced] = []
        for (first, _, place), dim, n in zip(picks, self.dims, self.shape, strict=True):
            here = Traced(index(dim))
            if place is None:
                inside.append(here == first)
                continue
            count = shape[place]
            places[place] = index(dim)
            if count < n:
                places[place] = Call("mod", ((here - first).node, Number(float(count))))
                inside += [here >= first] if first else []
                inside += [here < first + count] if first + count < n else []
        new = part.at(self.shape, places).value if shape else part
        for condition in inside:
            new = choice(condition, new, self.value)
        self.value = new

    # ------------------------------------------------------------------------------------------------- shapes and sums

    @property
    def T(self) -> Any:  # noqa: N802 - numpy's
        """The array with its axes in the opposite order."""
        return self.transpose()

    def transpose(self, *order: Any) -> Any:
        """Return it with its axes in another order."""
        given = order[0] if len(order) == 1 and not isinstance(order[0], int) else order
        axes = [k % self.ndim for k in given] if given else [*reversed(range(self.ndim))]
        shape = tuple(self.shape[k] for k in axes)
        dims = [axis(self.grid, n, self.ndim - 1 - k) for k, n in enumerate(shape)]
        return self.at(shape, [index(dims[axes.index(k)]) for k in range(self.ndim)], view=True)

    def swapaxes(self, one: int, other: int) -> Any:
        """Return it with two axes exchanged."""
        order = [*range(self.ndim)]
        order[one], order[other] = order[other], order[one]
        return self.transpose(*order)

    def copy(self) -> Any:
        """Return an array of its own."""
        return Cube(self.grid, self.value, self.shape)

    def reshape(self, *shape: Any, order: str = "C") -> Any:
        """Return the same numbers in another shape.

        Raises
        ------
        IrregularError
            If neither shape is a row, apart from axes of one element, or the first axis is to be the fastest.
        """
        wanted = [*(shape[0] if len(shape) == 1 and not isinstance(shape[0], int) else shape)]
        if -1 in wanted:
            wanted[wanted.index(-1)] = self.size // -prod(wanted)
        if prod(wanted) != self.size or order != "C":
            raise IrregularError(f"the function makes an array of shape {tuple(wanted)} of {self.size} numbers")
        new = tuple(map(int, wanted))
        dims = tuple(axis(self.grid, n, len(new) - 1 - k) for k, n in enumerate(new))
        old, kept = ([(n, k) for k, n in enumerate(shape) if n > 1] for shape in (self.shape, new))
        places: list[Node] = [Number(0.0)] * self.ndim
        if [n for n, _ in old] == [n for n, _ in kept]:
            for (_, k), (_, to) in zip(old, kept, strict=True):
                places[k] = index(dims[to])
        elif len(old) == 1:
            places[old[0][1]] = flat(new, dims)
        elif len(kept) == 1:
            number, stride = index(dims[kept[0][1]]), self.size
            for n, k in old:
                stride //= n
                quotient = number if stride == 1 else Call("floor", (Binary("/", number, Number(float(stride))),))
                places[k] = quotient if stride * n == self.size else Call("mod", (quotient, Number(float(n))))
        else:
            return self.reshape(-1).reshape(new)
        return self.at(new, places)

    def ravel(self, order: str = "C") -> Any:
        """Return all numbers in a row."""
        return self.reshape(-1, order=order)

    flatten = ravel

    def reduced(self, function: str, axis: Any = None, *, keepdims: bool = False, **options: Any) -> Any:
        """Return sums, or the largest or smallest, along axes.

        Raises
        ------
        IrregularError
            If more is asked for.
        """
        if any(value not in (None, np._NoValue, True) for value in options.values()):  # noqa: SLF001
            raise IrregularError(f"the function takes the {function} of an array with {options}")
        along = range(self.ndim) if axis is None else axis if isinstance(axis, tuple) else (axis,)
        axes = {whole_number(k) % self.ndim for k in along}
        node, dims = self.value.node, self.dims
        read = {part.dims[0] for part in every(node) if isinstance(part, Along) and part.function == "index"}
        for k in sorted(axes, reverse=True):
            if dims[k] in read:
                inner = bound(self.grid, self.shape[k], node)
                node = Along(function, (replaced(node, {dims[k]: index(inner)}),), (inner,))
            elif function == "sum":
                node = Binary("*", Number(float(self.shape[k])), node)
        whole = Cube(
            self.grid,
            Traced(node, self.value.nodes + 1),
            tuple(1 if k in axes else n for k, n in enumerate(self.shape)),
        )
        if keepdims:
            return whole
        return whole[tuple(0 if k in axes else slice(None) for k in range(self.ndim))]

    def sum(self, axis: Any = None, **options: Any) -> Any:
        """Return sums along axes."""
        return self.reduced("sum", axis, **options)

    def max(self, axis: Any = None, **options: Any) -> Any:
        """Return the largest along axes."""
        return self.reduced("max", axis, **options)

    def min(self, axis: Any = None, **options: Any) -> Any:
        """Return the smallest along axes."""
        return self.reduced("min", axis, **options)

    def mean(self, axis: Any = None, **options: Any) -> Any:
        """Return means along axes."""
        total = self.reduced("sum", axis, **options)
        return total / (self.size // (total.size if isinstance(total, Cube) else 1))


def listed_places(key: Any, size: int, axis: int) -> tuple[Any, int, int]:
    """Return the places that a list or a mask picks along an axis: the first and a step, or else all; and how many.

    Raises
    ------
    IrregularError
        If it is a condition, has several axes, or picks nothing.
    IndexError
        Beyond the end, as numpy says it.
    """
    if isinstance(key, Row):
        raise IrregularError("the function picks elements of an array by a condition")
    places = np.asarray(key)
    if places.dtype == bool and places.shape == (size,):
        places = np.flatnonzero(places)
    if places.ndim != 1 or not places.size or places.dtype.kind not in "iu":
        raise IrregularError("the function picks elements of an array by what is no list of whole numbers")
    wrong = places[(places < -size) | (places >= size)]
    if wrong.size:
        raise IndexError(f"index {wrong[0]} is out of bounds for axis {axis} with size {size}")
    places = places % size
    steps = np.unique(np.diff(places))
    if steps.size <= 1:
        return int(places[0]), int(steps[0]) if steps.size else 1, places.size
    return places, 1, places.size


_REDUCED = {np.add: "sum", np.maximum: "max", np.minimum: "min"}


def applied_to(ufunc: str, *values: Any) -> Traced:
    """Apply a function of numpy to single numbers, by its name."""
    result: Traced = applied(ufunc, values)
    return result


def shape_of(value: Any) -> Shape:
    """Return the shape of an array, of a list of numbers, or of a number."""
    return value.shape if isinstance(value, Cube) else () if isinstance(value, Traced) else np.shape(value)


def combined(rule: Callable[..., Traced], *values: Any) -> Any:
    """Apply a rule for single numbers to arrays that broadcast together."""
    grid = next(value.grid for value in values if isinstance(value, Cube))
    shape = np.broadcast_shapes(*map(shape_of, values))
    return Cube(grid, rule(*(element(value, grid) for value in values)), shape)


def element(value: Any, grid: Grid) -> Any:
    """Return the expression of an element of an array, at the indices of its axes from the right.

    Raises
    ------
    IrregularError
        If it is an array of elements that have an expression each, or of numbers that are not finite.
    """
    if isinstance(value, Cube):
        return value.value
    if isinstance(value, Traced | int | float):
        return value
    numbers = np.asarray(value)
    if numbers.dtype == object:
        raise IrregularError("the function joins an array with elements that have an expression each")
    numbers = real(numbers).astype(float)
    if not np.isfinite(numbers).all():
        raise IrregularError("the function makes an array with numbers that are not finite")
    if (numbers == numbers.flat[0]).all():
        return float(numbers.flat[0])
    dims = tuple(axis(grid, n, numbers.ndim - 1 - k) for k, n in enumerate(numbers.shape))
    word, dim = grid.listed(numbers.ravel())
    return Traced(Along("take", (Name(word), flat(numbers.shape, dims)), (dim,)))


def spread(value: Any, shape: Shape, grid: Grid) -> Any:
    """Return an array that has a shape, as numpy broadcasts it; a number where there are no axes.

    Raises
    ------
    ValueError
        If it does not broadcast, as numpy says it.
    """
    own = shape_of(value)
    while len(own) > len(shape) and own[0] == 1:
        value, own = value[0], own[1:]
    if np.broadcast_shapes(own, shape) != shape:
        raise ValueError(f"could not broadcast input array from shape {own} into shape {shape}")
    one = element(value, grid)
    number = one if isinstance(one, Traced) else Traced(node_of(one))
    return Cube(grid, number, shape) if shape else number


def whole_of(grid: Grid) -> Cube:
    """Return the row of all numbers that are not known."""
    dim = axis(grid, grid.size, 0)
    return Cube(grid, Traced(Along("take", (grid.leaf, index(dim)), (grid.dim,))), (grid.size,))


give_operators(Cube, lambda ufunc, *values: combined(partial(applied_to, ufunc), *values))
