"""Reductions along dimensions in loops, and parts that are computed for all elements before loops read them."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from fractions import Fraction

from xdynamics.expressions import Along
from xdynamics.kernels.assignments import CALLED, Assignments
from xdynamics.kernels.nest_indices import Env, Link, LoopIndex, SplitError, known_index
from xdynamics.kernels.nest_loops import NestedLoops
from xdynamics.kernels.program import Location, Operand, Reduction
from xdynamics.shapes import Shapes
from xdynamics.shapes.trees import REDUCTIONS


class Reductions(NestedLoops):
    """Writes reductions of expressions: ascending, in the loop over what is left."""

    def __init__(self, shapes: Shapes, find: Callable[[Assignments, str], Operand]) -> None:
        super().__init__(shapes, find)
        self._arrays: dict[int, Location] = {}
        self._orders: dict[int, tuple[str, ...]] = {}

    @abstractmethod
    def value(self, number: int, env: Env) -> Operand:
        """Write what a part of an expression needs at an element; return its operand."""

    def _reduce_part(self, number: int, node: Along, env: Env) -> Operand:
        if self._is_written_out(node.dims):
            terms = (self._reduction_term(number, node, {**env, **inner}) for inner in self._all_elements(node.dims))
            return self._finish_reduction(node, self._chain_operations(CALLED.get(node.function, "add"), terms))
        if self._depth(number, env):
            return self._load_staged(number, env)
        with self._outside_loops():
            return self._along_all(number, node, env)

    def _along_all(self, number: int, node: Along, env: Env) -> Operand:
        """Write a reduction in loops."""
        operation = CALLED.get(node.function, "add")
        start = {"least": math.inf, "greatest": -math.inf}.get(operation, -0.0)
        total = self._running_total(
            node.dims, env, operation, lambda inner: self._reduction_term(number, node, inner), start
        )
        return self._finish_reduction(node, total)

    def _reduction_term(self, number: int, node: Along, env: Env) -> Operand:
        values = [self.value(operand, env) for operand in self._parts.operands[number]]
        if node.function == "dot":
            return self.compute("multiply", *values)
        return self._power_at_level(values[0], Fraction(2)) if node.function == "norm" else values[0]

    def _finish_reduction(self, node: Along, total: Operand) -> Operand:
        if node.function == "norm":
            return self.compute("sqrt", total)
        if node.function == "mean":
            return self.compute("divide", total, float(math.prod(self.shapes.shape(node.dims))))
        return total

    def _running_total(
        self, dims: tuple[str, ...], env: Env, operation: str, term: Callable[[Env], Operand], total: Operand
    ) -> Operand:
        """Write a total over all elements along dimensions, the last of them fastest, going on from another total."""
        if not dims:
            return self.compute(operation, total, term(env))
        dim, *later_dims = dims
        remaining_dims = tuple(later_dims)
        if dim in self.shapes.relations and self.shapes.relations[dim].is_of_every_two:
            return self._running_pairs(dim, remaining_dims, env, operation, term, total)
        waiting = [(0, self.shapes.extent(dim).size)]
        while waiting:
            first, last = waiting.pop(0)
            if last - first == 1:
                total = self._running_total(remaining_dims, {**env, dim: known_index(first)}, operation, term, total)
                continue
            with self._loop_scope() as level:
                index = LoopIndex(f"_i{next(self._serial)}", first, first, last, level)
                now = self._name_total(level)
                try:
                    new = self._running_total(remaining_dims, {**env, dim: index}, operation, term, now)
                except SplitError as split:
                    if split.index != index.name:
                        raise
                    waiting[:0] = [(first, first + split.count), (first + split.count, last)]
                    continue
                body = tuple(self._scopes[-1].lines)
            total = self._add_reduction(Reduction(index.name, last - first, body, (new,), (now,), "newest", (total,)))[
                0
            ]
        return total

    def _running_pairs(
        self,
        dim: str,
        remaining_dims: tuple[str, ...],
        env: Env,
        operation: str,
        term: Callable[[Env], Operand],
        total: Operand,
    ) -> Operand:
        """Write a total over every two elements: each with those after it."""
        relation = self.shapes.relations[dim]
        size = self.shapes.extent(relation.source).size
        with self._loop_scope() as level:
            i = LoopIndex(f"_i{next(self._serial)}", 0, 0, size, level)
            outer = self._name_total(level)
            with self._loop_scope() as inner_level:
                j = LoopIndex(f"_i{next(self._serial)}", 0, 0, size, inner_level)
                inner = self._name_total(inner_level)
                with self._unsplit_indices(i, j):
                    new = self._running_total(remaining_dims, {**env, dim: Link(i, j)}, operation, term, inner)
                body = tuple(self._scopes[-1].lines)
            (sum_,) = self._add_reduction(
                Reduction(j.name, size, body, (new,), (inner,), "newest", (outer,), above=i.name)
            )
            body = tuple(self._scopes[-1].lines)
        return self._add_reduction(Reduction(i.name, size, body, (sum_,), (outer,), "newest", (total,)))[0]

    def _name_total(self, level: int) -> str:
        """Name a total, as it is in a loop."""
        name = f"_{next(self._serial)}_t"
        self._levels[name] = level
        return name

    def _add_reduction(self, line: Reduction) -> tuple[str, ...]:
        """Add a reduction; return its totals, as they are after it."""
        self._scopes[-1].lines.append(line)
        self._levels |= dict.fromkeys(line.totals, len(self._scopes) - 1)
        return line.totals

    def _staged(self, number: int) -> Location:
        """Compute a part for all its elements before the loops that read it; return the place of the first."""
        if number not in self._arrays:
            array, dims = self._new_array(number), self._part_dims(number)
            with self._outside_loops():
                self._nest(
                    dims,
                    lambda env: self._store_line(
                        self._element_location(array, dims, env), self._write_part(number, env)
                    ),
                )
            self._arrays[number] = array
        return self._arrays[number]

    def _array_dims(self, number: int) -> tuple[str, ...]:
        """Return the dimensions of an array that holds a part, the fastest last."""
        return self._orders.get(number, self._part_dims(number))

    def _write_part(self, number: int, env: Env) -> Operand:
        """Write a part for its array: a reduction in the loop over what is left."""
        node = self._parts.nodes[number]
        reduces = isinstance(node, Along) and node.function in REDUCTIONS and not self._is_written_out(node.dims)
        return self._along_all(number, node, env) if reduces else self.value(number, env)  # type: ignore[arg-type]

    def _load_staged(self, number: int, env: Env) -> Operand:
        location, dims = self._staged(number), self._array_dims(number)
        return self._load_element(self._element_location(location, dims, env), dims, env)
