"""Loops over elements with the values computed in each: indices, scopes, places of elements, and reductions.

Values that are already computed in an enclosing scope are read there. Parts that loops read are computed for all
elements before these loops. Loops that cannot be written as they stand raise an error.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction
from itertools import count, product
from typing import NamedTuple

from xdynamics.expressions import Along
from xdynamics.kernels.assignments import CALLED, Assignments
from xdynamics.kernels.program import Line, Location, Loop, Operand, Reduction, StoreTo
from xdynamics.shapes import Shapes
from xdynamics.shapes.trees import REDUCTIONS, Parts


class UnprintedError(Exception):
    """An expression that has no loops; its elements are written out."""


class LoopIndex(NamedTuple):
    """The number of an element: that of a loop's index and a shift, or a known one.

    Attributes
    ----------
    name : str
        Of the index; empty where the number is known.
    shift : int
        What is added to it; the known number.
    first, last : int
        The numbers that it may have, from `first` to before `last`.
    level : int
        How many loops are around it.
    gathered : bool
        Whether the index is read from a table.
    """

    name: str
    shift: int
    first: int
    last: int
    level: int = 0
    gathered: bool = False


class Link(NamedTuple):
    """A link of a relation of every two, by its ends."""

    first: LoopIndex
    second: LoopIndex

    @property
    def level(self) -> int:
        """How many loops are around it."""
        return max(self.first.level, self.second.level)


class SplitError(Exception):
    """An index whose numbers are not all treated alike: those before a number, and those from there on.

    Attributes
    ----------
    index : str
        Of the loop.
    count : int
        How many of its passes come before. The index may be another one than the loop's own: shifted, by one shift within
        another.
    """

    def __init__(self, index: LoopIndex, number: int) -> None:
        self.index, self.count = index.name, number - index.first


Env = Mapping[str, LoopIndex | Link]


def known_index(number: int) -> LoopIndex:
    """Return the index of a known element."""
    return LoopIndex("", number, number, number + 1)


SMALL = 4  # elements up to which a dimension is written out
LARGEST_LOCAL = 20_000_000  # numbers of all arrays of a program


class NestedLoops:
    """Loops around loops, each with its lines; a line goes to the innermost loop that it depends on.

    Parameters
    ----------
    shapes : Shapes
    find : callable
        Finds names of single numbers, as `Assignments` does.
    """

    def __init__(self, shapes: Shapes, find: Callable[[Assignments, str], Operand]) -> None:
        self.shapes = shapes
        self.local: dict[str, int] = {}
        self.tables: dict[str, tuple[int, ...]] = {}
        self._find = find
        self._parts = Parts(shapes)
        self._serial = count(1)
        self._scopes = [Assignments(find)]
        self._memos: list[dict[object, Operand]] = [{}]
        self._levels: dict[str, int] = {}

    @property
    def lines(self) -> list[Line]:
        """All lines written so far."""
        return self._scopes[0].lines

    @property
    def outermost(self) -> Assignments:
        """The assignments outside all loops."""
        return self._scopes[0]

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write an operation in the innermost loop that its operands depend on."""
        level = max((self._level(argument) for argument in arguments), default=0)
        return self._note_level(level, self._scopes[level].compute(operation, *arguments))

    def _power_at_level(self, base: Operand, exponent: Fraction) -> Operand:
        level = self._level(base)
        return self._note_level(level, self._scopes[level].power(base, exponent))

    def _chain_operations(self, operation: str, values: Iterable[Operand]) -> Operand:
        first, *later_values = values
        for value in later_values:
            first = self.compute(operation, first, value)
        return first

    # ------------------------------------------------------------------------------------------------------------ arrays

    def _new_array(self, number: int) -> Location:
        size = math.prod(self.shapes.shape(self._part_dims(number)))
        if sum(self.local.values()) + size > LARGEST_LOCAL:
            raise UnprintedError
        name = f"part{number}_"
        self.local[name] = size
        return Location(name)

    def _part_dims(self, number: int) -> tuple[str, ...]:
        return self.shapes.ordered(set(self._parts.dims[number]))

    def _element_location(self, location: Location, dims: tuple[str, ...], env: Env) -> Location:
        """Return the location of an element of an array."""
        offset, strides, stride = location.offset, [], 1
        for dim in reversed(dims):
            index = env[dim]
            if isinstance(index, Link):
                raise UnprintedError
            offset += index.shift * stride
            if index.name:
                strides.append((index.name, stride))
            stride *= self.shapes.extent(dim).size
        return Location(location.array, offset, tuple(reversed(strides)))

    def _load_element(self, location: Location, dims: tuple[str, ...], env: Env) -> Operand:
        level = max((env[dim].level for dim in dims), default=0)
        return self._note_level(level, self._scopes[level].load(location))

    def _store_line(self, location: Location, value: Operand) -> None:
        self._scopes[-1].lines.append(StoreTo(location, value))

    # ------------------------------------------------------------------------------------------------------------- loops

    def _nest(self, dims: tuple[str, ...], write: Callable[[Env], None], *, unsplit: bool = False) -> None:
        """Write loops over dimensions; small ones are written out.

        Of others the last, whose elements are next to one another, is the outermost, so that it goes side by side.
        """
        large = [dim for dim in dims if unsplit or not self._is_written_out((dim,))]
        small = tuple(dim for dim in dims if dim not in large)

        def nest_remaining(env: Env, waiting: list[str]) -> None:
            if waiting:
                self._write_loop(waiting[0], env, lambda inner: nest_remaining(inner, waiting[1:]), unsplit=unsplit)
            else:
                for further in self._all_elements(small):
                    write({**env, **further})

        nest_remaining({}, [*large[-1:], *large[:-1]])

    def _write_loop(self, dim: str, env: Env, write_body: Callable[[Env], None], *, unsplit: bool) -> None:
        waiting = [(0, self.shapes.extent(dim).size)]
        while waiting:
            first, last = waiting.pop(0)
            if last - first == 1 and not unsplit:
                write_body({**env, dim: known_index(first)})
                continue
            with self._loop_scope() as level:
                index = LoopIndex(f"_i{next(self._serial)}", first, first, last, level)
                try:
                    write_body({**env, dim: index})
                except SplitError as split:
                    if split.index != index.name:
                        raise
                    if unsplit:
                        raise UnprintedError from None
                    # the lines of this attempt are dropped with their scope; both parts are written anew
                    waiting[:0] = [(first, first + split.count), (first + split.count, last)]
                    continue
                body = tuple(self._scopes[-1].lines)
            self._scopes[-1].lines.append(Loop(index.name, last - first, body))

    @contextmanager
    def _unsplit_indices(self, *indices: LoopIndex) -> Iterator[None]:
        """Raise if one of some indices would have to be split."""
        try:
            yield
        except SplitError as split:
            if split.index in {index.name for index in indices}:
                raise UnprintedError from None
            raise

    @contextmanager
    def _loop_scope(self) -> Iterator[int]:
        """Open a scope for the lines of a loop; yield its depth."""
        self._scopes.append(Assignments(self._find, f"_{next(self._serial)}_"))
        self._memos.append({})
        try:
            yield len(self._scopes) - 1
        finally:
            self._scopes.pop()
            self._memos.pop()

    @contextmanager
    def _outside_loops(self) -> Iterator[None]:
        """Write outside all loops, before those that are being written."""
        inner = self._scopes[1:], self._memos[1:]
        del self._scopes[1:], self._memos[1:]
        try:
            yield
        finally:
            self._scopes += inner[0]
            self._memos += inner[1]

    def _is_written_out(self, dims: Iterable[str]) -> bool:
        return all(self.shapes.extent(dim).size <= SMALL for dim in dims)

    def _all_elements(self, dims: tuple[str, ...]) -> Iterator[dict[str, LoopIndex]]:
        for numbers in product(*map(range, self.shapes.shape(dims))):
            yield dict(zip(dims, map(known_index, numbers), strict=True))

    # ------------------------------------------------------------------------------------------------------------ memory

    def _index_key(self, dims: Iterable[str], env: Env) -> tuple[LoopIndex | Link, ...]:
        return tuple(env[dim] for dim in dims)

    def _depth(self, number: int, env: Env) -> int:
        return max((env[dim].level for dim in self._parts.dims[number]), default=0)

    def _known_operand(self, number: int, env: Env) -> Operand | None:
        return self._memos[self._depth(number, env)].get((number, self._index_key(self._part_dims(number), env)))

    def _remember(self, number: int, env: Env, value: Operand) -> Operand:
        self._memos[self._depth(number, env)][number, self._index_key(self._part_dims(number), env)] = value
        return value

    def _level(self, operand: Operand) -> int:
        return self._levels.get(operand, 0) if isinstance(operand, str) else 0

    def _note_level(self, level: int, operand: Operand) -> Operand:
        if isinstance(operand, str):
            self._levels.setdefault(operand, level)
        return operand


class Reductions(NestedLoops):
    """Writes reductions of expressions: ascending, in loops over the remaining dimensions."""

    def __init__(self, shapes: Shapes, find: Callable[[Assignments, str], Operand]) -> None:
        super().__init__(shapes, find)
        self._arrays: dict[int, Location] = {}
        self._orders: dict[int, tuple[str, ...]] = {}

    @abstractmethod
    def value(self, number: int, env: Env) -> Operand:
        """Write the lines of an expression's part at an element; return its operand."""

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
        # -0.0, not 0.0: it is the one number that changes no other in a sum, -0.0 among them
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
        """Compute a part for all its elements before the loops that read it; return its first location."""
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
        """Write a part for its array: a reduction in the loop over the remaining dimensions."""
        node = self._parts.nodes[number]
        reduces = isinstance(node, Along) and node.function in REDUCTIONS and not self._is_written_out(node.dims)
        return self._along_all(number, node, env) if reduces else self.value(number, env)  # type: ignore[arg-type]

    def _load_staged(self, number: int, env: Env) -> Operand:
        location, dims = self._staged(number), self._array_dims(number)
        return self._load_element(self._element_location(location, dims, env), dims, env)
