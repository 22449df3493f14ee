"""The Jacobian pattern of an expression with dimensions: the numbers that each element depends on.

The pattern follows from the tree. Pairs of an element and a number are arrays throughout: no tree, name or Python
number stands for a single pair.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Call, Compare, Element, Name, Node
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.shapes.extents import Shapes, is_of_numbers, taken_numbers, with_index_names
from xdynamics.shapes.trees import OF_CROSS, REDUCTIONS, Parts, element_numbers, end_dimension

IntArray = NDArray[np.int64]  # codes; arrays of elements are short, since large models have millions
Int32Array = NDArray[np.int32]
Grid = Mapping[str, Any]  # the number along each dimension, of every element of an expression
_NONE = np.zeros(0, np.int64)
_MAX_INT32 = np.iinfo(np.int32).max


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
        self._codes_by_name: dict[str, IntArray] = {}  # of each quantity, codes: element*count + number, ascending
        self._codes_by_part: dict[int, IntArray] = {}
        for name, begin in first.items():
            elements = np.arange(math.prod(shapes.shape(shapes.dims.get(name, ()))))
            self._codes_by_name[name] = elements * (self._count + 1) + begin

    def pairs(self, tree: Node, dims: tuple[str, ...], name: str = "") -> tuple[Int32Array, Int32Array]:
        """Return the elements of an expression, each with a number that it may depend on; both ascend.

        Parameters
        ----------
        tree : Node
            As `resolve_min_max` returns it, with definitions expanded.
        dims : tuple of str
            Of the elements, the last fastest: those of the expression, and perhaps others.
        name : str, optional
            By which later expressions read it, with these dimensions.
        """
        number = self._parts.number(tree)
        part_dims = self._shapes.ordered(set(self._parts.dims[number]))
        codes = self._codes_on_grid(self._codes_of_part(number), part_dims, self._element_grid(dims))
        if name:
            self._codes_by_name[name] = codes
        pair_numbers = np.empty((2, codes.size), np.int32)
        np.floor_divide(codes, self._count, out=pair_numbers[0], casting="unsafe")  # no array of int64 between
        np.remainder(codes, self._count, out=pair_numbers[1], casting="unsafe")
        return pair_numbers[0], pair_numbers[1]

    def _codes_of_part(self, number: int) -> IntArray:
        """Return the codes of a part; parts that it is made of have theirs already."""
        for k in range(len(self._codes_by_part), number + 1):
            self._codes_by_part[k] = self._codes(k)
        return self._codes_by_part[number]

    def _codes(self, number: int) -> IntArray:
        node, operands = self._parts.nodes[number], self._parts.operands[number]
        match node:
            case Name():
                quantity_dims = self._shapes.dims.get(node.name, ())
                return self._codes_on_grid(
                    self._codes_by_name.get(node.name, _NONE),
                    quantity_dims,
                    self._element_grid(self._shapes.ordered(set(quantity_dims))),
                )
            case Element():
                return self._codes_of_element(node)
            case Compare():
                return _NONE
            case Call(function="where"):
                return self._codes_of_choice(number, node)
            case Along():
                return self._codes_along(number, node)
        grid = self._element_grid(self._part_dims(number))
        return _join_codes([self._operand_codes(operand, grid) for operand in operands])

    def _codes_of_element(self, node: Element) -> IntArray:
        if node.name not in self._codes_by_name:
            return _NONE
        indices = element_numbers(node, self._shapes)
        grid = {dim: np.array([value]) for dim, value in indices.items()}
        return self._codes_on_grid(self._codes_by_name[node.name], tuple(indices), grid)

    def _codes_of_choice(self, number: int, node: Call) -> IntArray:
        """Return the dependences of a choice; where its condition is of element numbers, those of the chosen branch."""
        _, yes, no = self._parts.operands[number]
        grid = self._element_grid(self._part_dims(number))
        branch_codes = [self._operand_codes(branch, grid) for branch in (yes, no)]
        holds = self._condition_holds(node.arguments[0], grid)
        if holds is None:
            return _join_codes(branch_codes)
        return _join_codes([codes[holds[codes // self._count] == (k == 0)] for k, codes in enumerate(branch_codes)])

    def _condition_holds(self, condition: Node, grid: Grid) -> NDArray[np.bool_] | None:
        """Return where a condition holds; None if it is not on numbers of elements alone."""
        if not is_of_numbers(condition):
            return None
        values = {f"index {dim}": numbers.astype(float) for dim, numbers in grid.items()}
        holds = np.asarray(evaluate_many(with_index_names(condition, self._shapes), values), bool)
        return np.broadcast_to(holds, next(iter(grid.values())).shape) if grid else holds.reshape(1)

    # ---------------------------------------------------------------------------------------------- along dimensions

    def _codes_along(self, number: int, node: Along) -> IntArray:
        operands, grid = self._parts.operands[number], self._element_grid(self._part_dims(number))
        match node.function:
            case "index" | "size":
                return _NONE
            case "first" | "second":
                relation = self._shapes.relations[node.dims[0]]
                first = node.function == "first"
                numbers, dim = (relation.first, relation.source) if first else (relation.second, relation.target)
                return self._operand_codes(operands[0], {**grid, dim: numbers[grid[relation.name]]})
            case "shift" | "roll":
                return self._shifted_codes(operands, node, grid)
            case "take":
                numbers = np.broadcast_to(taken_numbers(node, grid, self._shapes), next(iter(grid.values())).shape)
                return self._operand_codes(operands[0], {**grid, node.dims[0]: numbers})
            case "cross":
                dim = node.dims[0]
                rotated_grids = [{**grid, dim: (grid[dim] + k) % OF_CROSS} for k in (1, 2)]
                return _join_codes(
                    [self._operand_codes(operand, next_two) for operand in operands for next_two in rotated_grids]
                )
            case "onto":
                return self._codes_onto_ends(number, node)
        assert node.function in REDUCTIONS  # noqa: S101 - others are above
        dims = self._shapes.ordered(set().union(*(self._parts.dims[operand] for operand in operands)))
        inner = self._element_grid(dims)
        operand_codes = _join_codes([self._operand_codes(operand, inner) for operand in operands])
        return self._renumbered_codes(operand_codes, self._flat_numbers(self._part_dims(number), inner))

    def _shifted_codes(self, operands: tuple[int, ...], node: Along, grid: Grid) -> IntArray:
        dim = node.dims[0]
        size, shifted_numbers = self._shapes.extent(dim).size, grid[dim] - node.places
        if node.function == "roll":
            return self._operand_codes(operands[0], {**grid, dim: shifted_numbers % size})
        in_range = (shifted_numbers >= 0) & (shifted_numbers < size)
        values = self._operand_codes(operands[0], {**grid, dim: shifted_numbers % size})
        fills = self._operand_codes(operands[1], grid)
        return _join_codes([values[in_range[values // self._count]], fills[~in_range[fills // self._count]]])

    def _codes_onto_ends(self, number: int, node: Along) -> IntArray:
        """Return the dependences of elements at the ends of links."""
        relation, part_dims, dim = (
            self._shapes.relations[node.dims[0]],
            self._part_dims(number),
            end_dimension(node, self._shapes),
        )
        grid = self._element_grid(self._shapes.ordered({*part_dims, relation.name} - {dim}))
        end_codes = []
        for operand, numbers in zip(self._parts.operands[number], (relation.first, relation.second), strict=True):
            codes = self._operand_codes(operand, grid)
            if codes.size:
                end_codes.append(
                    self._renumbered_codes(
                        codes, self._flat_numbers(part_dims, {**grid, dim: numbers[grid[relation.name]]})
                    )
                )
        return _join_codes(end_codes)

    # ------------------------------------------------------------------------------------------------------- elements

    def _part_dims(self, number: int) -> tuple[str, ...]:
        return self._shapes.ordered(set(self._parts.dims[number]))

    def _element_grid(self, dims: tuple[str, ...]) -> Grid:
        """Return the number along each dimension of every element, the last dimension fastest."""
        return _FullGrid(dims, self._shapes.shape(dims))

    def _flat_numbers(self, dims: tuple[str, ...], grid: Grid) -> NDArray[Any]:
        """Return the flat element number of an expression with some dimensions at each point of a grid."""
        if not dims:
            return np.zeros(next(iter(grid.values())).size if grid else 1, np.int32)
        flat_numbers, *further_numbers = (grid[dim] for dim in dims)
        if further_numbers and math.prod(self._shapes.shape(dims)) > _MAX_INT32:
            flat_numbers = flat_numbers.astype(np.int64)
        for dim, numbers in zip(dims[1:], further_numbers, strict=True):
            flat_numbers = flat_numbers * self._shapes.extent(dim).size + numbers
        return np.asarray(flat_numbers)

    def _operand_codes(self, number: int, grid: Grid) -> IntArray:
        """Return the codes of a part as it is read at every point of a grid."""
        return self._codes_on_grid(self._codes_by_part[number], self._part_dims(number), grid)

    def _codes_on_grid(self, codes: IntArray, dims: tuple[str, ...], grid: Grid) -> IntArray:
        if not codes.size or (isinstance(grid, _FullGrid) and grid.dims == dims):
            return codes
        read_elements = self._flat_numbers(dims, grid)
        code_counts = np.bincount(codes // self._count, minlength=math.prod(self._shapes.shape(dims)))
        if code_counts.min() == code_counts.max() == 1:  # as elements of a quantity do by themselves
            grid_codes: IntArray = codes[read_elements] % self._count
            grid_codes += np.arange(read_elements.size) * self._count
            return grid_codes
        lengths = code_counts[read_elements]
        places = np.repeat(
            (np.cumsum(code_counts) - code_counts)[read_elements] - (np.cumsum(lengths) - lengths), lengths
        )
        places += np.arange(places.size)
        grid_codes = codes[places]
        del places
        grid_codes %= self._count
        grid_codes += np.repeat(np.arange(read_elements.size) * self._count, lengths)
        return grid_codes

    def _renumbered_codes(self, codes: IntArray, elements: IntArray) -> IntArray:
        """Return codes with their elements renumbered, where several may get one number."""
        renumbered_codes = elements[codes // self._count].astype(np.int64)
        renumbered_codes *= self._count
        renumbered_codes += codes % self._count
        return _sorted_unique_codes(renumbered_codes)


class _FullGrid(Mapping[str, Any]):
    """Every element of an expression with some dimensions; indices along a dimension are made on look-up."""

    def __init__(self, dims: tuple[str, ...], shape: tuple[int, ...]) -> None:
        self.dims, self.shape = dims, shape

    def __getitem__(self, dim: str) -> Int32Array:
        if dim not in self.dims:
            raise KeyError(dim)
        axis = self.dims.index(dim)
        positions = np.arange(self.shape[axis], dtype=np.int32)
        wide = positions.reshape([-1 if i == axis else 1 for i in range(len(self.shape))])
        return np.broadcast_to(wide, self.shape).reshape(-1)

    def __iter__(self) -> Iterator[str]:
        return iter(self.dims)

    def __len__(self) -> int:
        return len(self.dims)


def _join_codes(codes: list[IntArray]) -> IntArray:
    """Join codes; those of one part alone are as they were."""
    nonempty_codes = [code for code in codes if code.size]
    if not nonempty_codes:
        return _NONE
    return nonempty_codes[0] if len(nonempty_codes) == 1 else _sorted_unique_codes(np.concatenate(nonempty_codes))


def _sorted_unique_codes(codes: IntArray) -> IntArray:
    """Sort codes in place, which mostly ascend in stretches, and drop duplicates."""
    codes.sort(kind="stable")
    new = np.concatenate([[True], codes[1:] != codes[:-1]])
    return codes if new.all() else codes[new]
