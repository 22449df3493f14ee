"""Values of expressions with dimensions, for all elements at once: the bits that each element has by itself."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, chain
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import every
from xdynamics.shapes.extents import Shapes
from xdynamics.shapes.numbers_of_elements import taken_numbers
from xdynamics.shapes.trees import OF_CROSS, element_numbers, end_of

Array = NDArray[np.float64]

PIECE = 1 << 16  # elements that are evaluated together: they stay in a cache
_VALUE = "_value_{}"  # of a part that goes along dimensions


def evaluate_elements(
    node: Node, dims: tuple[str, ...], values: Mapping[str, Any], shapes: Shapes, beside: str = ""
) -> Array:
    """Return the values of an expression at every element.

    Parameters
    ----------
    node : Node
        As `prepared` returns it, with dimensions among `dims`, and definitions expanded.
    dims : tuple of str
        The dimensions of the result.
    values : mapping of str to float or ndarray
        A number for every name; of one with dimensions an array along them.
    shapes : Shapes
    beside : str
        A dimension of values of which the expression knows nothing, as of many states: the last of theirs.

    Returns
    -------
    ndarray, shape of `dims`

    Raises
    ------
    InputError
        If a name has no value.
    """
    walk = Walk(values, shapes, beside)
    if beside or not dims or not _by_itself(node):
        return walk.along(node, dims).copy()
    sizes = shapes.shape(dims)
    count = max(1, PIECE * sizes[0] // max(1, math.prod(sizes)))
    if count >= sizes[0]:
        return walk.along(node, dims).copy()
    found = np.empty(sizes)
    for first in range(0, sizes[0], count):  # of a million elements each intermediate result would be as large
        piece = slice(first, min(first + count, sizes[0]))
        found[piece] = Walk(values, shapes, beside, {dims[0]: piece}).along(node, dims)
    return found


def _by_itself(node: Node) -> bool:
    """Whether each element follows from its own numbers alone."""
    return all(part.function in ("index", "size") for part in every(node) if isinstance(part, Along))


class Walk:
    """Evaluates parts as arrays with an axis for each dimension and relation, of length 1 where they do not vary.

    Of some dimensions it may know a part of the elements.
    """

    def __init__(
        self, values: Mapping[str, Any], shapes: Shapes, beside: str, pieces: Mapping[str, slice] | None = None
    ) -> None:
        self.values, self.shapes, self.beside, self.pieces = dict(values), shapes, beside, pieces or {}
        self.axes = (*shapes.relations, *shapes.extents)

    def along(self, node: Node, dims: tuple[str, ...]) -> Array:
        """Return the value of an expression along some dimensions."""
        return self.spread(np.asarray(self.value(node), float), dims)

    def spread(self, value: Array, dims: tuple[str, ...]) -> Array:
        """Return values with every axis, or a number, along some dimensions."""
        shape = [self._length(dim) if dim in dims else 1 for dim in self.axes]
        spread = np.broadcast_to(value, shape).reshape(
            [size for dim, size in zip(self.axes, shape, strict=True) if dim in dims]
        )
        order = [dim for dim in self.axes if dim in dims]
        return spread.transpose([order.index(dim) for dim in dims])

    def _length(self, dim: str) -> int:
        piece = self.pieces.get(dim)
        return self.shapes.extent(dim).size if piece is None else piece.stop - piece.start

    def value(self, node: Node) -> Any:
        """Return the value of an expression."""
        return evaluate_many(self.replaced(node), self.values)

    def replaced(self, node: Node) -> Node:
        """Return an expression in which whatever has dimensions by itself is the name of its value."""
        match node:
            case Name() if node.name in self.shapes.dims and node.name in self.values:
                return self._kept(self._placed(np.asarray(self.values[node.name]), self.shapes.dims[node.name]))
            case Element() if node.name in self.values:
                return self._kept(self._element(node))
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
                return self._kept(self.along_dimensions(node))
        return node

    def _kept(self, value: Any) -> Name:
        name = _VALUE.format(len(self.values))
        self.values[name] = value
        return Name(name)

    def _element(self, node: Element) -> Any:
        """Return the value of one element."""
        dims = self.shapes.dims.get(node.name, ())
        known = tuple(dim for dim in dims if dim != self.beside)
        place = element_numbers(node, replace(self.shapes, dims={node.name: known}))
        taken = np.asarray(self.values[node.name])[tuple(place.values())]
        return taken if dims == known else self._placed(taken, (self.beside,))

    def _placed(self, values: Any, dims: tuple[str, ...]) -> Any:
        """Return values along some dimensions with every axis."""
        order = sorted(range(len(dims)), key=lambda i: self.axes.index(dims[i]))
        shape = [self._length(dim) if dim in dims else 1 for dim in self.axes]
        known = tuple(self.pieces.get(dim, slice(None)) for dim in dims)
        return values[known].transpose(order).reshape(shape)

    def along_dimensions(self, node: Along) -> Any:
        """Return the value of a function along dimensions."""
        dim = node.dims[0]
        extent, axis = self.shapes.extent(dim), self.axes.index(dim)
        match node.function:
            case "size":
                return float(extent.size)
            case "index":
                return self._placed(np.arange(float(extent.size)), (dim,))
            case "first" | "second":
                relation, whole = self.shapes.relations[dim], np.asarray(self.value(node.arguments[0]))
                is_first = node.function == "first"
                end = self.axes.index(relation.source if is_first else relation.target)
                return np.take(whole, relation.first if is_first else relation.second, end).swapaxes(end, axis)
            case "shift" | "roll":
                moved = np.roll(np.asarray(self.value(node.arguments[0])), node.places, axis)
                if node.function == "roll":
                    return moved
                origin = self._placed(np.arange(extent.size) - node.places, (dim,))
                return np.where((origin >= 0) & (origin < extent.size), moved, self.value(node.arguments[1]))
            case "onto":
                return self._onto(node, axis)
            case "take":
                return self._taken(node, axis)
            case "cross":
                a, b = (self._full(argument, node.dims) for argument in node.arguments)
                next_, last = ([(k + step) % OF_CROSS for k in range(OF_CROSS)] for step in (1, 2))
                return np.take(a, next_, axis) * np.take(b, last, axis) - np.take(a, last, axis) * np.take(
                    b, next_, axis
                )
        return self._reduced(node)

    def _onto(self, node: Along, axis: int) -> Any:
        """Add what links give to the elements at their ends: of all links at their first ends, then at their second."""
        relation, dim = self.shapes.relations[node.dims[0]], end_of(node, self.shapes)
        end = self.axes.index(dim)
        total: Any = 0.0
        for argument, places in zip(node.arguments, (relation.first, relation.second), strict=True):
            if argument != ZERO:
                rows = np.moveaxis(self._full(argument, node.dims).swapaxes(axis, end), end, 0)
                given = np.zeros((self.shapes.extent(dim).size, *rows.shape[1:]))
                np.add.at(given, places, rows)
                total = total + np.moveaxis(given, 0, end)
        return total

    def _taken(self, node: Along, axis: int) -> Any:
        """Return the elements whose numbers are given, wherever they vary."""
        extents = {dim: self.shapes.extent(dim).size for dim in self.axes}
        read = {part.dims[0] for part in every(node.arguments[1]) if isinstance(part, Along)}
        grid = {dim: self._placed(np.arange(extents[dim]), (dim,)) for dim in read}
        numbers = taken_numbers(node, grid, self.shapes)
        numbers = numbers.reshape(numbers.shape or (1,) * len(self.axes))
        whole = np.expand_dims(np.moveaxis(self._full(node.arguments[0], node.dims), axis, -1), axis)
        shape = np.broadcast_shapes(whole.shape[:-1], numbers.shape)
        wide, places = np.broadcast_to(whole, (*shape, whole.shape[-1])), np.broadcast_to(numbers, shape)
        return np.take_along_axis(wide, places[..., None], -1)[..., 0]

    def _full(self, node: Node, dims: tuple[str, ...]) -> Any:
        return self.full(np.asarray(self.value(node)), dims)

    def full(self, whole: Any, dims: tuple[str, ...]) -> Any:
        """Return a value that has all elements along some dimensions."""
        whole = whole if whole.ndim == len(self.axes) else whole.reshape((1,) * len(self.axes))
        sizes = zip(self.axes, whole.shape, strict=True)
        return np.broadcast_to(whole, [self.shapes.extent(dim).size if dim in dims else size for dim, size in sizes])

    def _reduced(self, node: Along) -> Any:
        """Reduce a value along dimensions, the last of them fastest, one element after the other."""
        parts = [self._full(argument, node.dims) for argument in node.arguments]
        with np.errstate(all="ignore"):
            if node.function == "dot":
                parts = [parts[0] * parts[1]]
            elif node.function == "norm":
                parts = [parts[0] * parts[0]]
            axes = [self.axes.index(dim) for dim in node.dims]
            rows = np.moveaxis(parts[0], axes, range(len(axes))).reshape(-1, *self._others(parts[0], axes))
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
    def _others(whole: Any, axes: list[int]) -> list[int]:
        return [size for axis, size in enumerate(whole.shape) if axis not in axes]
