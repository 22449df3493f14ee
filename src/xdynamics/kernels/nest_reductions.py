"""Reductions along dimensions in loops, and parts that are computed for all elements before loops read them."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from fractions import Fraction

from xdynamics.expressions import Along
from xdynamics.kernels.assignments import CALLED, Assignments
from xdynamics.kernels.nest_indices import Env, Link, LoopIndex, SplitError, known_number
from xdynamics.kernels.nest_loops import NestedLoops
from xdynamics.kernels.program import Operand, Place, Reduction
from xdynamics.shapes import Shapes
from xdynamics.shapes.trees import REDUCTIONS


class Reductions(NestedLoops):
    """Writes reductions of expressions: ascending, in the loop over what is left."""

    def __init__(self, shapes: Shapes, find: Callable[[Assignments, str], Operand]) -> None:
        super().__init__(shapes, find)
        self._arrays: dict[int, Place] = {}
        self._orders: dict[int, tuple[str, ...]] = {}

    @abstractmethod
    def value(self, number: int, env: Env) -> Operand:
        """Write what a part of an expression needs at an element; return its operand."""

    def _reduced(self, number: int, node: Along, env: Env) -> Operand:
        if self._written_out(node.dims):
            terms = (self._term(number, node, {**env, **inner}) for inner in self._all(node.dims))
            return self._finished(node, self._chained(CALLED.get(node.function, "add"), terms))
        if self._depth(number, env):
            return self._load_staged(number, env)
        with self._outside():
            return self._along_all(number, node, env)

    def _along_all(self, number: int, node: Along, env: Env) -> Operand:
        """Write a reduction in loops."""
        operation = CALLED.get(node.function, "add")
        start = {"least": math.inf, "greatest": -math.inf}.get(operation, -0.0)
        total = self._running(node.dims, env, operation, lambda inner: self._term(number, node, inner), start)
        return self._finished(node, total)

    def _term(self, number: int, node: Along, env: Env) -> Operand:
        values = [self.value(operand, env) for operand in self._parts.operands[number]]
        if node.function == "dot":
            return self.compute("multiply", *values)
        return self._power(values[0], Fraction(2)) if node.function == "norm" else values[0]

    def _finished(self, node: Along, total: Operand) -> Operand:
        if node.function == "norm":
            return self.compute("sqrt", total)
        if node.function == "mean":
            return self.compute("divide", total, float(math.prod(self.shapes.shape(node.dims))))
        return total

    def _running(
        self, dims: tuple[str, ...], env: Env, operation: str, term: Callable[[Env], Operand], total: Operand
    ) -> Operand:
        """Write a total over all elements along dimensions, the last of them fastest, going on from another total."""
        if not dims:
            return self.compute(operation, total, term(env))
        dim, *others = dims
        rest = tuple(others)
        if dim in self.shapes.relations and self.shapes.relations[dim].is_of_every_two:
            return self._running_pairs(dim, rest, env, operation, term, total)
        waiting = [(0, self.shapes.extent(dim).size)]
        while waiting:
            first, last = waiting.pop(0)
            if last - first == 1:
                total = self._running(rest, {**env, dim: known_number(first)}, operation, term, total)
                continue
            with self._scope() as level:
                index = LoopIndex(f"_i{next(self._serial)}", first, first, last, level)
                now = self._total(level)
                try:
                    new = self._running(rest, {**env, dim: index}, operation, term, now)
                except SplitError as split:
                    if split.index != index.name:
                        raise
                    waiting[:0] = [(first, first + split.count), (first + split.count, last)]
                    continue
                body = tuple(self._scopes[-1].lines)
            total = self._joined(Reduction(index.name, last - first, body, (new,), (now,), "newest", (total,)))[0]
        return total

    def _running_pairs(
        self,
        dim: str,
        rest: tuple[str, ...],
        env: Env,
        operation: str,
        term: Callable[[Env], Operand],
        total: Operand,
    ) -> Operand:
        """Write a total over every two elements: each with those after it."""
        relation = self.shapes.relations[dim]
        size = self.shapes.extent(relation.source).size
        with self._scope() as level:
            i = LoopIndex(f"_i{next(self._serial)}", 0, 0, size, level)
            outer = self._total(level)
            with self._scope() as inner_level:
                j = LoopIndex(f"_i{next(self._serial)}", 0, 0, size, inner_level)
                inner = self._total(inner_level)
                with self._whole(i, j):
                    new = self._running(rest, {**env, dim: Link(i, j)}, operation, term, inner)
                body = tuple(self._scopes[-1].lines)
            (sum_,) = self._joined(Reduction(j.name, size, body, (new,), (inner,), "newest", (outer,), above=i.name))
            body = tuple(self._scopes[-1].lines)
        return self._joined(Reduction(i.name, size, body, (sum_,), (outer,), "newest", (total,)))[0]

    def _total(self, level: int) -> str:
        """Name a total, as it is in a loop."""
        name = f"_{next(self._serial)}_t"
        self._levels[name] = level
        return name

    def _joined(self, line: Reduction) -> tuple[str, ...]:
        """Add a reduction; return its totals, as they are after it."""
        self._scopes[-1].lines.append(line)
        self._levels |= dict.fromkeys(line.totals, len(self._scopes) - 1)
        return line.totals

    def _staged(self, number: int) -> Place:
        """Compute a part for all its elements before the loops that read it; return the place of the first."""
        if number not in self._arrays:
            array, dims = self._new_array(number), self._dims(number)
            with self._outside():
                self._nest(dims, lambda env: self._store(self._at(array, dims, env), self._direct(number, env)))
            self._arrays[number] = array
        return self._arrays[number]

    def _order(self, number: int) -> tuple[str, ...]:
        """Return the dimensions of an array that holds a part, the fastest last."""
        return self._orders.get(number, self._dims(number))

    def _direct(self, number: int, env: Env) -> Operand:
        """Write a part for its array: a reduction in the loop over what is left."""
        node = self._parts.nodes[number]
        reduces = isinstance(node, Along) and node.function in REDUCTIONS and not self._written_out(node.dims)
        return self._along_all(number, node, env) if reduces else self.value(number, env)  # type: ignore[arg-type]

    def _load_staged(self, number: int, env: Env) -> Operand:
        place, dims = self._staged(number), self._order(number)
        return self._load(self._at(place, dims, env), dims, env)
