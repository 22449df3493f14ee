"""Which numbers each element of an expression with dimensions depends on: the pattern of its Jacobian, from its tree.

Pairs of an element and a number are arrays throughout: no tree, name or Python number stands for one of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Call, Compare, Element, Name, Node
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.shapes.distinct_parts import Parts
from xdynamics.shapes.extents import Shapes
from xdynamics.shapes.numbers_of_elements import counted, is_of_numbers, taken_numbers
from xdynamics.shapes.trees import OF_CROSS, REDUCTIONS, element_numbers, end_of

Whole = NDArray[np.int64]  # codes; arrays of elements are short, since large models have millions
Short = NDArray[np.int32]
Grid = Mapping[str, Any]  # the number along each dimension, of every element of an expression
_NONE = np.zeros(0, np.int64)
_MOST_SHORT = np.iinfo(np.int32).max


class Dependence:
    """Follows the elements of quantities through expressions.

    Parameters
    ----------
    shapes : Shapes
    first : mapping of str to int
        The number of the first element of every quantity that varies; those of its others follow.
    count : int
        How many numbers there are.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> from xdynamics.shapes.extents import Extent
    >>> shapes = Shapes({"site": Extent("site", 4)}, {}, {"u": ("site",)})
    >>> rows, columns = Dependence(shapes, {"u": 0}, 4).pairs(parse("u*shift(u, site, 1, 0)"), ("site",))
    >>> rows.tolist(), columns.tolist()
    ([0, 1, 1, 2, 2, 3, 3], [0, 0, 1, 1, 2, 2, 3])
    """

    def __init__(self, shapes: Shapes, first: Mapping[str, int], count: int) -> None:
        self._shapes, self._count, self._parts = shapes, max(1, count), Parts(shapes)
        self._named: dict[str, Whole] = {}  # of each quantity, codes: element*count + number, ascending
        self._found: dict[int, Whole] = {}
        for name, begin in first.items():
            elements = np.arange(math.prod(shapes.shape(shapes.dims.get(name, ()))))
            self._named[name] = elements * (self._count + 1) + begin

    def pairs(self, tree: Node, dims: tuple[str, ...], name: str = "") -> tuple[Short, Short]:
        """Return the elements of an expression, each with a number that it may depend on; both ascend.

        Parameters
        ----------
        tree : Node
            As `prepared` returns it, with definitions expanded.
        dims : tuple of str
            Of the elements, the last fastest: those of the expression, and perhaps others.
        name : str, optional
            By which later expressions read it, with these dimensions.
        """
        number = self._parts.number(tree)
        own = self._shapes.ordered(set(self._parts.dims[number]))
        codes = self._read(self._of(number), own, self._grid(dims))
        if name:
            self._named[name] = codes
        found = np.empty((2, codes.size), np.int32)
        np.floor_divide(codes, self._count, out=found[0], casting="unsafe")  # no array of int64 between
        np.remainder(codes, self._count, out=found[1], casting="unsafe")
        return found[0], found[1]

    def _of(self, number: int) -> Whole:
        """Return the codes of a part; parts that it is made of have theirs already."""
        for k in range(len(self._found), number + 1):
            self._found[k] = self._codes(k)
        return self._found[number]

    def _codes(self, number: int) -> Whole:
        node, operands = self._parts.nodes[number], self._parts.operands[number]
        match node:
            case Name():
                own = self._shapes.dims.get(node.name, ())
                return self._read(self._named.get(node.name, _NONE), own, self._grid(self._shapes.ordered(set(own))))
            case Element():
                return self._of_element(node)
            case Compare():
                return _NONE
            case Call(function="where"):
                return self._of_choice(number, node)
            case Along():
                return self._along(number, node)
        grid = self._grid(self._dims(number))
        return _union([self._operand(operand, grid) for operand in operands])

    def _of_element(self, node: Element) -> Whole:
        if node.name not in self._named:
            return _NONE
        place = element_numbers(node, self._shapes)
        grid = {dim: np.array([value]) for dim, value in place.items()}
        return self._read(self._named[node.name], tuple(place), grid)

    def _of_choice(self, number: int, node: Call) -> Whole:
        """Return what a choice depends on; where its condition is on numbers of elements alone, on what it chooses."""
        _, yes, no = self._parts.operands[number]
        grid = self._grid(self._dims(number))
        chosen = [self._operand(branch, grid) for branch in (yes, no)]
        holds = self._known(node.arguments[0], grid)
        if holds is None:
            return _union(chosen)
        return _union([codes[holds[codes // self._count] == (k == 0)] for k, codes in enumerate(chosen)])

    def _known(self, condition: Node, grid: Grid) -> NDArray[np.bool_] | None:
        """Return where a condition holds; None if it is not on numbers of elements alone."""
        if not is_of_numbers(condition):
            return None
        values = {f"index {dim}": numbers.astype(float) for dim, numbers in grid.items()}
        holds = np.asarray(evaluate_many(counted(condition, self._shapes), values), bool)
        return np.broadcast_to(holds, next(iter(grid.values())).shape) if grid else holds.reshape(1)

    # ---------------------------------------------------------------------------------------------- along dimensions

    def _along(self, number: int, node: Along) -> Whole:
        operands, grid = self._parts.operands[number], self._grid(self._dims(number))
        match node.function:
            case "index" | "size":
                return _NONE
            case "first" | "second":
                relation = self._shapes.relations[node.dims[0]]
                first = node.function == "first"
                numbers, dim = (relation.first, relation.source) if first else (relation.second, relation.target)
                return self._operand(operands[0], {**grid, dim: numbers[grid[relation.name]]})
            case "shift" | "roll":
                return self._moved(operands, node, grid)
            case "take":
                numbers = np.broadcast_to(taken_numbers(node, grid, self._shapes), next(iter(grid.values())).shape)
                return self._operand(operands[0], {**grid, node.dims[0]: numbers})
            case "cross":
                dim = node.dims[0]
                turned = [{**grid, dim: (grid[dim] + k) % OF_CROSS} for k in (1, 2)]
                return _union([self._operand(operand, next_two) for operand in operands for next_two in turned])
            case "onto":
                return self._onto(number, node)
        assert node.function in REDUCTIONS  # noqa: S101 - others are above
        dims = self._shapes.ordered(set().union(*(self._parts.dims[operand] for operand in operands)))
        inner = self._grid(dims)
        joined = _union([self._operand(operand, inner) for operand in operands])
        return self._moved_to(joined, self._flat(self._dims(number), inner))

    def _moved(self, operands: tuple[int, ...], node: Along, grid: Grid) -> Whole:
        dim = node.dims[0]
        size, moved = self._shapes.extent(dim).size, grid[dim] - node.places
        if node.function == "roll":
            return self._operand(operands[0], {**grid, dim: moved % size})
        inside = (moved >= 0) & (moved < size)
        values = self._operand(operands[0], {**grid, dim: moved % size})
        fills = self._operand(operands[1], grid)
        return _union([values[inside[values // self._count]], fills[~inside[fills // self._count]]])

    def _onto(self, number: int, node: Along) -> Whole:
        """Return what the elements at the ends of links depend on."""
        relation, own, dim = self._shapes.relations[node.dims[0]], self._dims(number), end_of(node, self._shapes)
        grid = self._grid(self._shapes.ordered({*own, relation.name} - {dim}))
        found = []
        for operand, numbers in zip(self._parts.operands[number], (relation.first, relation.second), strict=True):
            codes = self._operand(operand, grid)
            if codes.size:
                found.append(self._moved_to(codes, self._flat(own, {**grid, dim: numbers[grid[relation.name]]})))
        return _union(found)

    # ------------------------------------------------------------------------------------------------------- elements

    def _dims(self, number: int) -> tuple[str, ...]:
        return self._shapes.ordered(set(self._parts.dims[number]))

    def _grid(self, dims: tuple[str, ...]) -> Grid:
        """Return the number along each dimension of every element, the last dimension fastest."""
        return _Every(dims, self._shapes.shape(dims))

    def _flat(self, dims: tuple[str, ...], grid: Grid) -> NDArray[Any]:
        """Return which element of an expression with some dimensions stands at each place of a grid."""
        if not dims:
            return np.zeros(next(iter(grid.values())).size if grid else 1, np.int32)
        found, *others = (grid[dim] for dim in dims)
        if others and math.prod(self._shapes.shape(dims)) > _MOST_SHORT:
            found = found.astype(np.int64)
        for dim, numbers in zip(dims[1:], others, strict=True):
            found = found * self._shapes.extent(dim).size + numbers
        return np.asarray(found)

    def _operand(self, number: int, grid: Grid) -> Whole:
        """Return the codes of a part as it is read at every place of a grid."""
        return self._read(self._found[number], self._dims(number), grid)

    def _read(self, codes: Whole, dims: tuple[str, ...], grid: Grid) -> Whole:
        if not codes.size or (isinstance(grid, _Every) and grid.dims == dims):
            return codes
        wanted = self._flat(dims, grid)
        every = np.bincount(codes // self._count, minlength=math.prod(self._shapes.shape(dims)))
        if every.min() == every.max() == 1:  # as elements of a quantity do by themselves
            found: Whole = codes[wanted] % self._count
            found += np.arange(wanted.size) * self._count
            return found
        lengths = every[wanted]
        places = np.repeat((np.cumsum(every) - every)[wanted] - (np.cumsum(lengths) - lengths), lengths)
        places += np.arange(places.size)
        found = codes[places]
        del places
        found %= self._count
        found += np.repeat(np.arange(wanted.size) * self._count, lengths)
        return found

    def _moved_to(self, codes: Whole, elements: Whole) -> Whole:
        """Return codes whose elements have other numbers, several of them perhaps the same."""
        found = elements[codes // self._count].astype(np.int64)
        found *= self._count
        found += codes % self._count
        return _ascending(found)


class _Every(Mapping[str, Any]):
    """Every element of an expression with some dimensions; where each stands along them is made when it is asked for."""

    def __init__(self, dims: tuple[str, ...], shape: tuple[int, ...]) -> None:
        self.dims, self.shape = dims, shape

    def __getitem__(self, dim: str) -> Short:
        if dim not in self.dims:
            raise KeyError(dim)
        place = self.dims.index(dim)
        along = np.arange(self.shape[place], dtype=np.int32)
        wide = along.reshape([-1 if i == place else 1 for i in range(len(self.shape))])
        return np.broadcast_to(wide, self.shape).reshape(-1)

    def __iter__(self) -> Iterator[str]:
        return iter(self.dims)

    def __len__(self) -> int:
        return len(self.dims)


def _union(codes: list[Whole]) -> Whole:
    """Join codes; those of one part alone are as they were."""
    some = [code for code in codes if code.size]
    if not some:
        return _NONE
    return some[0] if len(some) == 1 else _ascending(np.concatenate(some))


def _ascending(codes: Whole) -> Whole:
    """Sort codes in their place, which mostly ascend in stretches, and leave out what is there twice."""
    codes.sort(kind="stable")
    new = np.concatenate([[True], codes[1:] != codes[:-1]])
    return codes if new.all() else codes[new]
