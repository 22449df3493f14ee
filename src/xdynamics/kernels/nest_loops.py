"""Loops over elements with what is computed in each: scopes, places of elements, and what is known already."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from itertools import count, product

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.nest_indices import Env, Link, LoopIndex, SplitError, UnprintedError, known_index
from xdynamics.kernels.program import Line, Location, Loop, Operand, StoreTo
from xdynamics.shapes import Shapes
from xdynamics.shapes.distinct_parts import Parts

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
        """Writes what is computed outside all loops."""
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
        """Return the place of an element of an array."""
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
                    waiting[:0] = [(first, first + split.count), (first + split.count, last)]
                    continue
                body = tuple(self._scopes[-1].lines)
            self._scopes[-1].lines.append(Loop(index.name, last - first, body))

    @contextmanager
    def _unsplit_indices(self, *indices: LoopIndex) -> Iterator[None]:
        """Give up where an index of these would have to be split."""
        try:
            yield
        except SplitError as split:
            if split.index in {index.name for index in indices}:
                raise UnprintedError from None
            raise

    @contextmanager
    def _loop_scope(self) -> Iterator[int]:
        """Write what is in a loop; yield how many loops are around it."""
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
