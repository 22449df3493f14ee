"""Expressions with dimensions as lines with loops: what is computed for every element, however many there are.

Bits are those of the expressions that `shapes.at_element` gives for each element: sums are ascending, from -0.0, to which any
number can be added without a change.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from fractions import Fraction
from itertools import groupby

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, exponent_of
from xdynamics.kernels.assignments import CALLED, OPERATIONS, Assignments
from xdynamics.kernels.nest_indices import Env, Link, LoopIndex, SplitError, UnprintedError, known_index
from xdynamics.kernels.nest_numbers import TakenNumbers
from xdynamics.kernels.program import Location, Operand, Ordinal
from xdynamics.shapes import Shapes
from xdynamics.shapes.trees import element_numbers

Result = tuple[str, tuple[str, ...], Node, Location]  # a name, its dimensions, what it is, where its first element goes


class Nests(TakenNumbers):
    """Writes loops over the elements of quantities.

    Parameters
    ----------
    shapes : Shapes
    find : callable
        Finds names of single numbers, as `Assignments` does.
    place : callable
        Returns the place of the first element of a quantity with dimensions; the last dimension is the fastest.
    """

    def __init__(
        self, shapes: Shapes, find: Callable[[Assignments, str], Operand], first_location: Callable[[str], Location]
    ) -> None:
        super().__init__(shapes, find)
        self._first_location = first_location

    def results(self, results: Iterable[Result]) -> None:
        """Write quantities to their places; those of the same dimensions, one after the other, share their loops."""
        numbered = [(name, dims, self._parts.number(tree), location) for name, dims, tree, location in results]
        for dims, group in groupby(numbered, key=lambda result: result[1]):
            together = list(group)

            def write_group(env: Env, together: list[tuple[str, tuple[str, ...], int, Location]] = together) -> None:
                for name, dims, number, location in together:
                    value = self.value(number, env)
                    self._store_line(self._element_location(location, dims, env), value)
                    self._memos[-1][name, self._index_key(dims, env)] = value

            self._nest(dims, write_group)

    def value(self, number: int, env: Env) -> Operand:
        """Write what a part of an expression needs at an element; return its operand."""
        nodes, operands, links = self._parts.nodes, self._parts.operands, []
        while (
            isinstance(nodes[number], Binary) and self._known_operand(number, env) is None
        ):  # a sum may have any length
            links.append(number)
            number = operands[number][0]
        operand = self._known_operand(number, env)
        if operand is None:
            operand = self._remember(number, env, self._operand_of_part(number, env))
        for link in reversed(links):
            node = nodes[link]
            assert isinstance(node, Binary)  # noqa: S101 - all links are
            if node.operator == "**":
                operand = self._power_at_level(operand, exponent_of(node.right) or Fraction(0))
            else:
                operand = self.compute(OPERATIONS[node.operator], operand, self.value(operands[link][1], env))
            self._remember(link, env, operand)
        return operand

    def _operand_of_part(self, number: int, env: Env) -> Operand:
        node, operands = self._parts.nodes[number], self._parts.operands[number]
        match node:
            case Number():
                return node.value
            case Name():
                return self._operand_of_name(node.name, env)
            case Element():
                name = self.shapes.element_at(node.name, element_numbers(node, self.shapes))
                return self._scopes[0].operand_of(name)
            case Along():
                return self._operand_along(number, node, env)
        values = [self.value(operand, env) for operand in operands]
        match node:
            case Negative():
                return self.compute("negative", *values)
            case Compare():
                return self.compute(OPERATIONS[node.operator], *values)
            case Call(function="min" | "max"):
                return self._chain_operations(CALLED[node.function], values)
        assert isinstance(node, Call)  # noqa: S101 - all others are above
        return self.compute(CALLED.get(node.function, node.function), *values)

    def _operand_of_name(self, name: str, env: Env) -> Operand:
        dims = self.shapes.dims.get(name, ())
        key = name, self._index_key(dims, env)
        for memo in self._memos:
            if key in memo:
                return memo[key]
        if not dims:
            return self._scopes[0].operand_of(name)
        return self._load_element(self._element_location(self._first_location(name), dims, env), dims, env)

    def _operand_along(self, number: int, node: Along, env: Env) -> Operand:
        match node.function:
            case "index":
                return self._index_ordinal(env[node.dims[0]])
            case "size":
                return float(self.shapes.extent(node.dims[0]).size)
            case "first" | "second":
                relation = self.shapes.relations[node.dims[0]]
                dim = relation.source if node.function == "first" else relation.target
                end = self._link_end(relation, node.function, env[relation.name])
                return self.value(self._parts.operands[number][0], {**env, dim: end})
            case "shift" | "roll":
                return self._shifted_operand(number, node, env)
            case "take":
                return self.value(self._parts.operands[number][0], {**env, node.dims[0]: self._taken_index(node, env)})
            case "cross":
                return self._cross_product(number, node, env)
            case "onto":
                return self._onto_sum(number, node, env)
        return self._reduce_part(number, node, env)

    def _index_ordinal(self, index: LoopIndex | Link) -> Operand:
        if isinstance(index, Link):
            raise UnprintedError
        if not index.name:
            return float(index.shift)
        memo, key = self._memos[index.level], ("ordinal", index.name)
        if key not in memo:
            target = f"_{next(self._serial)}_o"
            self._scopes[index.level].lines.append(Ordinal(target, index.name))
            memo[key] = self._note_level(index.level, target)
        return self.compute("add", memo[key], float(index.shift)) if index.shift else memo[key]

    def _shifted_operand(self, number: int, node: Along, env: Env) -> Operand:
        """Write the value some places before; values beyond an end are apart."""
        dim, n, operands = node.dims[0], node.places, self._parts.operands[number]
        size, index = self.shapes.extent(dim).size, env[dim]
        if isinstance(index, Link) or index.gathered:
            raise UnprintedError
        turns, last = (index.first - n) // size, (index.last - 1 - n) // size
        if turns != last:
            raise SplitError(index, n + size * (turns + 1))
        if turns and node.function == "shift":
            return self.value(operands[1], env)
        far = -n - turns * size
        shifted_index = index._replace(shift=index.shift + far, first=index.first + far, last=index.last + far)
        return self.value(operands[0], {**env, dim: shifted_index})

    def _cross_product(self, number: int, node: Along, env: Env) -> Operand:
        dim, (a, b) = node.dims[0], self._parts.operands[number]
        index = env[dim]
        assert isinstance(index, LoopIndex)  # noqa: S101 - no relation of every two has three links and a cross product
        if index.name:
            raise SplitError(index, index.first + 1)
        i, j = (known_index((index.shift + k) % 3) for k in (1, 2))
        plus, minus = (
            self.compute("multiply", self.value(a, {**env, dim: of_a}), self.value(b, {**env, dim: of_b}))
            for of_a, of_b in ((i, j), (j, i))
        )
        return self.compute("subtract", plus, minus)
