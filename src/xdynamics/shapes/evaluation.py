"""Values of expressions with dimensions, for all elements at once, and their rounding errors.

Every element has the bits of its own evaluation. Rounding errors are differences from an evaluation with 31 digits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, chain
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.precise_values import PI, SUMS, PreciseArray, evaluate_precisely
from xdynamics.expressions.tree import every
from xdynamics.shapes.extents import Shapes, taken_numbers
from xdynamics.shapes.trees import OF_CROSS, element_numbers, end_dimension

Array = NDArray[np.float64]

PIECE = 1 << 16  # elements that are evaluated together: they stay in a cache
_VALUE = "_value_{}"  # of a part that goes along dimensions


def evaluate_elements(
    node: Node, dims: tuple[str, ...], values: Mapping[str, Any], shapes: Shapes, extra_dim: str = ""
) -> Array:
    """Return the values of an expression at every element.

    Parameters
    ----------
    node : Node
        As `resolve_min_max` returns it, with dimensions among `dims`, and definitions expanded.
    dims : tuple of str
        The dimensions of the result.
    values : mapping of str to float or ndarray
        A number for every name; of one with dimensions an array along them.
    shapes : Shapes
    extra_dim : str
        A dimension of values of which the expression knows nothing, as of many states: the last of theirs.

    Returns
    -------
    ndarray, shape of `dims`

    Raises
    ------
    InputError
        If a name has no value.
    """
    walk = Walk(values, shapes, extra_dim)
    if extra_dim or not dims or not _by_itself(node):
        return walk.values_along(node, dims).copy()
    sizes = shapes.shape(dims)
    count = max(1, PIECE * sizes[0] // max(1, math.prod(sizes)))
    if count >= sizes[0]:
        return walk.values_along(node, dims).copy()
    element_values = np.empty(sizes)
    for first in range(0, sizes[0], count):  # of a million elements each intermediate result would be as large
        piece = slice(first, min(first + count, sizes[0]))
        element_values[piece] = Walk(values, shapes, extra_dim, {dims[0]: piece}).values_along(node, dims)
    return element_values


def _by_itself(node: Node) -> bool:
    """Whether each element follows from its own numbers alone."""
    return all(part.function in ("index", "size") for part in every(node) if isinstance(part, Along))


class Walk:
    """Evaluates parts as arrays with an axis for each dimension and relation, of length 1 where they do not vary.

    Of some dimensions it may know a part of the elements.
    """

    def __init__(
        self, values: Mapping[str, Any], shapes: Shapes, extra_dim: str, pieces: Mapping[str, slice] | None = None
    ) -> None:
        self.values, self.shapes, self.extra_dim, self.pieces = dict(values), shapes, extra_dim, pieces or {}
        self.axes = (*shapes.relations, *shapes.extents)

    def values_along(self, node: Node, dims: tuple[str, ...]) -> Array:
        """Return the value of an expression along some dimensions."""
        return self.spread(np.asarray(self.value(node), float), dims)

    def spread(self, value: Array, dims: tuple[str, ...]) -> Array:
        """Return values with every axis, or a number, along some dimensions."""
        shape = [self._axis_length(dim) if dim in dims else 1 for dim in self.axes]
        spread = np.broadcast_to(value, shape).reshape(
            [size for dim, size in zip(self.axes, shape, strict=True) if dim in dims]
        )
        order = [dim for dim in self.axes if dim in dims]
        return spread.transpose([order.index(dim) for dim in dims])

    def _axis_length(self, dim: str) -> int:
        piece = self.pieces.get(dim)
        return self.shapes.extent(dim).size if piece is None else piece.stop - piece.start

    def value(self, node: Node) -> Any:
        """Return the value of an expression."""
        return evaluate_many(self.replaced(node), self.values)

    def replaced(self, node: Node) -> Node:
        """Return an expression in which whatever has dimensions by itself is the name of its value."""
        match node:
            case Name() if node.name in self.shapes.dims and node.name in self.values:
                return self._name_value(
                    self._with_all_axes(np.asarray(self.values[node.name]), self.shapes.dims[node.name])
                )
            case Element() if node.name in self.values:
                return self._name_value(self._element_value(node))
            case Negative():
                return replace(node, operand=self.replaced(node.operand))
            case Binary():
                first, links = chain(node)
                tree = self.replaced(first)
                for link in links:
                    right = link.right if link.operator == "**" else self.replaced(link.right)
                    tree = Binary(link.operator, tree, right, link.column)
                return tree
            case Compare():
                return replace(node, left=self.replaced(node.left), right=self.replaced(node.right))
            case Call():
                return replace(node, arguments=tuple(map(self.replaced, node.arguments)))
            case Along():
                return self._name_value(self.value_along_dimensions(node))
        return node

    def _name_value(self, value: Any) -> Name:
        name = _VALUE.format(len(self.values))
        self.values[name] = value
        return Name(name)

    def _element_value(self, node: Element) -> Any:
        """Return the value of one element."""
        dims = self.shapes.dims.get(node.name, ())
        known_dims = tuple(dim for dim in dims if dim != self.extra_dim)
        indices = element_numbers(node, replace(self.shapes, dims={node.name: known_dims}))
        element_values = np.asarray(self.values[node.name])[tuple(indices.values())]
        return element_values if dims == known_dims else self._with_all_axes(element_values, (self.extra_dim,))

    def _with_all_axes(self, values: Any, dims: tuple[str, ...]) -> Any:
        """Return values along some dimensions with every axis."""
        order = sorted(range(len(dims)), key=lambda i: self.axes.index(dims[i]))
        shape = [self._axis_length(dim) if dim in dims else 1 for dim in self.axes]
        known_slices = tuple(self.pieces.get(dim, slice(None)) for dim in dims)
        return values[known_slices].transpose(order).reshape(shape)

    def value_along_dimensions(self, node: Along) -> Any:
        """Return the value of a function along dimensions."""
        dim = node.dims[0]
        extent, axis = self.shapes.extent(dim), self.axes.index(dim)
        match node.function:
            case "size":
                return float(extent.size)
            case "index":
                return self._with_all_axes(np.arange(float(extent.size)), (dim,))
            case "first" | "second":
                relation, operand_values = self.shapes.relations[dim], np.asarray(self.value(node.arguments[0]))
                is_first = node.function == "first"
                end = self.axes.index(relation.source if is_first else relation.target)
                return np.take(operand_values, relation.first if is_first else relation.second, end).swapaxes(end, axis)
            case "shift" | "roll":
                shifted = np.roll(np.asarray(self.value(node.arguments[0])), node.places, axis)
                if node.function == "roll":
                    return shifted
                origin = self._with_all_axes(np.arange(extent.size) - node.places, (dim,))
                return np.where((origin >= 0) & (origin < extent.size), shifted, self.value(node.arguments[1]))
            case "onto":
                return self._link_sums(node, axis)
            case "take":
                return self._taken_elements(node, axis)
            case "cross":
                a, b = (self._full(argument, node.dims) for argument in node.arguments)
                next_, last = ([(k + step) % OF_CROSS for k in range(OF_CROSS)] for step in (1, 2))
                return np.take(a, next_, axis) * np.take(b, last, axis) - np.take(a, last, axis) * np.take(
                    b, next_, axis
                )
        return self._reduction(node)

    def _link_sums(self, node: Along, axis: int) -> Any:
        """Add the values of links to the elements at their ends: of all links at first ends, then at second ends."""
        relation, dim = self.shapes.relations[node.dims[0]], end_dimension(node, self.shapes)
        end = self.axes.index(dim)
        total: Any = 0.0
        for argument, places in zip(node.arguments, (relation.first, relation.second), strict=True):
            if argument != ZERO:
                rows = np.moveaxis(self._full(argument, node.dims).swapaxes(axis, end), end, 0)
                end_sums = np.zeros((self.shapes.extent(dim).size, *rows.shape[1:]))
                np.add.at(end_sums, places, rows)
                total = total + np.moveaxis(end_sums, 0, end)
        return total

    def _taken_elements(self, node: Along, axis: int) -> Any:
        """Return the elements whose numbers are given, wherever they vary."""
        extents = {dim: self.shapes.extent(dim).size for dim in self.axes}
        read = {part.dims[0] for part in every(node.arguments[1]) if isinstance(part, Along)}
        grid = {dim: self._with_all_axes(np.arange(extents[dim]), (dim,)) for dim in read}
        numbers = taken_numbers(node, grid, self.shapes)
        numbers = numbers.reshape(numbers.shape or (1,) * len(self.axes))
        operand_values = np.expand_dims(np.moveaxis(self._full(node.arguments[0], node.dims), axis, -1), axis)
        shape = np.broadcast_shapes(operand_values.shape[:-1], numbers.shape)
        wide, places = (
            np.broadcast_to(operand_values, (*shape, operand_values.shape[-1])),
            np.broadcast_to(numbers, shape),
        )
        return np.take_along_axis(wide, places[..., None], -1)[..., 0]

    def _full(self, node: Node, dims: tuple[str, ...]) -> Any:
        return self.full(np.asarray(self.value(node)), dims)

    def full(self, operand_values: Any, dims: tuple[str, ...]) -> Any:
        """Return a value that has all elements along some dimensions."""
        operand_values = (
            operand_values if operand_values.ndim == len(self.axes) else operand_values.reshape((1,) * len(self.axes))
        )
        sizes = zip(self.axes, operand_values.shape, strict=True)
        return np.broadcast_to(
            operand_values, [self.shapes.extent(dim).size if dim in dims else size for dim, size in sizes]
        )

    def _reduction(self, node: Along) -> Any:
        """Reduce a value along dimensions, the last of them fastest, one element after the other."""
        parts = [self._full(argument, node.dims) for argument in node.arguments]
        with np.errstate(all="ignore"):
            if node.function == "dot":
                parts = [parts[0] * parts[1]]
            elif node.function == "norm":
                parts = [parts[0] * parts[0]]
            axes = [self.axes.index(dim) for dim in node.dims]
            rows = np.moveaxis(parts[0], axes, range(len(axes))).reshape(-1, *self._remaining_sizes(parts[0], axes))
            if node.function in ("min", "max"):
                choice = Call(node.function, (Name("a"), Name("b")))
                total = reduce(lambda a, b: evaluate_many(choice, {"a": a, "b": b}), rows)
            else:
                total = np.add.accumulate(rows, axis=0)[-1]  # ascending, where a sum by numpy goes in pairs
            if node.function == "mean":
                total = total / float(len(rows))
            elif node.function == "norm":
                total = np.sqrt(total)
        return np.expand_dims(total, sorted(axes))

    @staticmethod
    def _remaining_sizes(operand_values: Any, axes: list[int]) -> list[int]:
        return [size for axis, size in enumerate(operand_values.shape) if axis not in axes]


_SUMS_OF_ENDS = "onto"  # of which there is no value with 31 digits: derivatives alone have them


def rounding_errors(
    node: Node,
    dims: tuple[str, ...],
    values: Mapping[str, Any],
    shapes: Shapes,
    rounded_values: Array,
    extra_dim: str = "",
) -> Array:
    """Return the rounding errors of an expression: its values less those with 31 digits, with pi in full.

    Parameters
    ----------
    node, dims, values, shapes, extra_dim
        As for `evaluate_elements`.
    rounded_values : ndarray, shape of `dims`
        What that returned.

    Returns
    -------
    ndarray, shape of `dims`
        0 where values are not finite.

    Raises
    ------
    InputError
        If a name has no value.
    """
    if any(isinstance(part, Along) and part.function == _SUMS_OF_ENDS for part in every(node)):
        return np.zeros(np.shape(rounded_values))
    high, low = _PreciseWalk({**values, "pi": PI}, shapes, extra_dim).precisely_along(node, dims)
    with np.errstate(all="ignore"):
        errors = (rounded_values - high) - low
    return np.where(np.isfinite(errors), errors, 0.0)


class _PreciseWalk(Walk):
    """Evaluates parts as sums of two floats."""

    def precisely_along(self, node: Node, dims: tuple[str, ...]) -> tuple[Array, Array]:
        """Return the value of an expression along some dimensions, in both parts."""
        value = self.value(node)
        parts = (part if part.ndim == len(self.axes) else part.reshape(()) for part in (value.high, value.low))
        high, low = (self.spread(part, dims) for part in parts)
        return high, low

    def value(self, node: Node) -> PreciseArray:
        """Return the value of an expression."""
        return evaluate_precisely(self.replaced(node), self.values)

    def value_along_dimensions(self, node: Along) -> Any:
        """Return the value of a function along dimensions: of one that only moves elements, of both parts."""
        if node.function in ("index", "size"):
            return super().value_along_dimensions(node)
        if node.function in ("first", "second", "shift", "roll", "take"):
            value_count = (
                2 if node.function == "shift" else 1
            )  # arguments that have values; others are numbers of elements
            values = [self.value(argument) for argument in node.arguments[:value_count]]
            return PreciseArray(
                *(self._shifted_value(node, [getattr(value, part) for value in values]) for part in ("high", "low"))
            )
        return self._cross_product(node) if node.function == "cross" else self._reduced_precisely(node)

    def _shifted_value(self, node: Along, values: list[Array]) -> Any:
        names = [f"_part_{i}" for i in range(len(values))]
        arguments = (*map(Name, names), *node.arguments[len(values) :])
        walk = Walk(dict(zip(names, values, strict=True)), self.shapes, self.extra_dim)
        return walk.value_along_dimensions(Along(node.function, arguments, node.dims, node.places, node.column))

    def _full_arguments(self, node: Along) -> list[PreciseArray]:
        """Return the arguments of a function with all elements along its dimensions."""
        return [self.value(argument).of_parts(lambda part: self.full(part, node.dims)) for argument in node.arguments]

    def _cross_product(self, node: Along) -> PreciseArray:
        """Return a cross product: of each element's next in one factor by the last of the three in the other, less its mirror."""
        axis = self.axes.index(node.dims[0])
        (a_next, a_last), (b_next, b_last) = (
            [value.of_parts(lambda part, step=step: np.roll(part, -step, axis)) for step in (1, 2)]  # type: ignore[misc]
            for value in self._full_arguments(node)
        )
        return a_next * b_last + -(a_last * b_next)

    def _reduced_precisely(self, node: Along) -> PreciseArray:
        """Reduce a value along dimensions; with so many digits the order is of no account, and pairs are fast."""
        parts = self._full_arguments(node)
        if node.function in ("dot", "norm"):
            parts = [parts[0] * parts[-1]]
        axes = [self.axes.index(dim) for dim in node.dims]
        total = parts[0].of_parts(lambda part: np.moveaxis(part, axes, range(len(axes))))
        total = total.of_parts(lambda part: part.reshape(-1, *part.shape[len(axes) :]))
        count = len(total.high)
        total = _join_pairwise(total, SUMS.choices.get(node.function, SUMS.operators["+"]))
        total = total.of_parts(lambda part: np.expand_dims(part[0], sorted(axes)))
        if node.function == "mean":
            return SUMS.operators["/"](total, float(count))  # type: ignore[no-any-return]
        return SUMS.functions["sqrt"](total) if node.function == "norm" else total


def _join_pairwise(rows: PreciseArray, join: Callable[..., PreciseArray]) -> PreciseArray:
    """Join the rows of an array two by two until one is left."""
    while (size := len(rows.high)) > 1:
        first, second, left = (
            PreciseArray(rows.high[part], rows.low[part])
            for part in (slice(0, size // 2), slice(size // 2, size // 2 * 2), slice(size // 2 * 2, size))
        )
        joined_rows = join(first, second)
        rows = PreciseArray(np.concatenate([joined_rows.high, left.high]), np.concatenate([joined_rows.low, left.low]))
    return rows
