"""Expressions with dimensions as lines with loops: what is computed for every element, however many there are.

Bits are those of the expressions that `shapes.at` gives for each element: sums are ascending, from -0.0, to which any
number can be added without a change.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from fractions import Fraction
from itertools import count, groupby, product
from typing import NamedTuple

import numpy as np

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, exponent_of
from xdynamics.expressions.calculus import ZERO
from xdynamics.kernels.assignments import CALLED, OPERATIONS, Assignments
from xdynamics.kernels.program import Gather, Line, Loop, Operand, Ordinal, Place, Reduction, Store
from xdynamics.shapes import Relation, Shapes
from xdynamics.shapes.parts import Parts
from xdynamics.shapes.trees import REDUCTIONS, element_numbers, end_of

SMALL = 4  # elements up to which a dimension is written out
PIECES = 16  # stretches of a relation, in each of which ends follow one another, up to which it has no table of ends
LARGEST_TABLE = 200_000
LARGEST_LOCAL = 500_000  # numbers on the stack


class UnprintedError(Exception):
    """An expression that has no loops; its elements are written out."""


class _SplitError(Exception):
    """An index whose values are not all treated alike: those before a number, and those from there on."""

    def __init__(self, index: str, at: int) -> None:
        self.index, self.at = index, at


class Index(NamedTuple):
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

    first: Index
    second: Index

    @property
    def level(self) -> int:
        """How many loops are around it."""
        return max(self.first.level, self.second.level)


Env = Mapping[str, Index | Link]
Result = tuple[str, tuple[str, ...], Node, Place]  # a name, its dimensions, what it is, where its first element goes


def known_number(number: int) -> Index:
    """Return the index of a known element."""
    return Index("", number, number, number + 1)


class Nests:
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
        self, shapes: Shapes, find: Callable[[Assignments, str], Operand], place: Callable[[str], Place]
    ) -> None:
        self.shapes = shapes
        self.local: dict[str, int] = {}
        self.tables: dict[str, tuple[int, ...]] = {}
        self._find, self._place = find, place
        self._parts = Parts(shapes)
        self._serial = count(1)
        self._scopes = [Assignments(find)]
        self._memos: list[dict[object, Operand]] = [{}]
        self._levels: dict[str, int] = {}
        self._arrays: dict[int, Place] = {}

    @property
    def lines(self) -> list[Line]:
        """All lines written so far."""
        return self._scopes[0].lines

    @property
    def outermost(self) -> Assignments:
        """Writes what is computed outside all loops."""
        return self._scopes[0]

    def results(self, results: Iterable[Result]) -> None:
        """Write quantities to their places; those of the same dimensions, one after the other, share their loops."""
        numbered = [(name, dims, self._parts.number(tree), place) for name, dims, tree, place in results]
        for dims, group in groupby(numbered, key=lambda result: result[1]):
            together = list(group)

            def write(env: Env, together: list[tuple[str, tuple[str, ...], int, Place]] = together) -> None:
                for name, dims, number, place in together:
                    value = self.value(number, env)
                    self._store(self._at(place, dims, env), value)
                    self._memos[-1][name, self._key(dims, env)] = value

            self._nest(dims, write)

    # ------------------------------------------------------------------------------------------------------ expressions

    def value(self, number: int, env: Env) -> Operand:
        """Write what a part of an expression needs at an element; return its operand."""
        nodes, operands, links = self._parts.nodes, self._parts.operands, []
        while isinstance(nodes[number], Binary) and self._known(number, env) is None:  # a sum may have any length
            links.append(number)
            number = operands[number][0]
        found = self._known(number, env)
        if found is None:
            found = self._remember(number, env, self._of(number, env))
        for link in reversed(links):
            node = nodes[link]
            assert isinstance(node, Binary)  # noqa: S101 - all links are
            if node.operator == "**":
                found = self._power(found, exponent_of(node.right) or Fraction(0))
            else:
                found = self.compute(OPERATIONS[node.operator], found, self.value(operands[link][1], env))
            self._remember(link, env, found)
        return found

    def compute(self, operation: str, *arguments: Operand) -> Operand:
        """Write an operation in the innermost loop that its operands depend on."""
        level = max((self._level(argument) for argument in arguments), default=0)
        return self._of_level(level, self._scopes[level].compute(operation, *arguments))

    def _power(self, base: Operand, exponent: Fraction) -> Operand:
        level = self._level(base)
        return self._of_level(level, self._scopes[level].power(base, exponent))

    def _of(self, number: int, env: Env) -> Operand:
        node, operands = self._parts.nodes[number], self._parts.operands[number]
        match node:
            case Number():
                return node.value
            case Name():
                return self._named(node.name, env)
            case Element():
                name = self.shapes.element(node.name, element_numbers(node, self.shapes))
                return self._scopes[0].named(name)
            case Along():
                return self._along(number, node, env)
        values = [self.value(operand, env) for operand in operands]
        match node:
            case Negative():
                return self.compute("negative", *values)
            case Compare():
                return self.compute(OPERATIONS[node.operator], *values)
            case Call(function="min" | "max"):
                return self._chained(CALLED[node.function], values)
        assert isinstance(node, Call)  # noqa: S101 - all others are above
        return self.compute(CALLED.get(node.function, node.function), *values)

    def _chained(self, operation: str, values: Iterable[Operand]) -> Operand:
        first, *others = values
        for value in others:
            first = self.compute(operation, first, value)
        return first

    def _named(self, name: str, env: Env) -> Operand:
        dims = self.shapes.dims.get(name, ())
        key = name, self._key(dims, env)
        for memo in self._memos:
            if key in memo:
                return memo[key]
        if not dims:
            return self._scopes[0].named(name)
        return self._load(self._at(self._place(name), dims, env), dims, env)

    def _along(self, number: int, node: Along, env: Env) -> Operand:
        match node.function:
            case "index":
                return self._ordinal(env[node.dims[0]])
            case "size":
                return float(self.shapes.extent(node.dims[0]).size)
            case "first" | "second":
                relation = self.shapes.relations[node.dims[0]]
                dim = relation.source if node.function == "first" else relation.target
                end = self._end(relation, node.function, env[relation.name])
                return self.value(self._parts.operands[number][0], {**env, dim: end})
            case "shift" | "roll":
                return self._moved(number, node, env)
            case "cross":
                return self._crossed(number, node, env)
            case "onto":
                return self._onto(number, node, env)
        return self._reduced(number, node, env)

    def _ordinal(self, index: Index | Link) -> Operand:
        if isinstance(index, Link):
            raise UnprintedError
        if not index.name:
            return float(index.shift)
        memo, key = self._memos[index.level], ("ordinal", index.name)
        if key not in memo:
            target = f"_{next(self._serial)}_o"
            self._scopes[index.level].lines.append(Ordinal(target, index.name))
            memo[key] = self._of_level(index.level, target)
        return self.compute("add", memo[key], float(index.shift)) if index.shift else memo[key]

    def _moved(self, number: int, node: Along, env: Env) -> Operand:
        """Write the value some places before; values beyond an end are apart."""
        dim, n, operands = node.dims[0], node.places, self._parts.operands[number]
        size, index = self.shapes.extent(dim).size, env[dim]
        if isinstance(index, Link) or index.gathered:
            raise UnprintedError
        turns, last = (index.first - n) // size, (index.last - 1 - n) // size
        if turns != last:
            raise _SplitError(index.name, n + size * (turns + 1))
        if turns and node.function == "shift":
            return self.value(operands[1], env)
        far = -n - turns * size
        moved = index._replace(shift=index.shift + far, first=index.first + far, last=index.last + far)
        return self.value(operands[0], {**env, dim: moved})

    def _crossed(self, number: int, node: Along, env: Env) -> Operand:
        dim, (a, b) = node.dims[0], self._parts.operands[number]
        index = env[dim]
        assert isinstance(index, Index)  # noqa: S101 - no relation of every two has three links and a cross product
        if index.name:
            raise _SplitError(index.name, index.first + 1)
        i, j = (known_number((index.shift + k) % 3) for k in (1, 2))
        plus, minus = (
            self.compute("multiply", self.value(a, {**env, dim: one}), self.value(b, {**env, dim: other}))
            for one, other in ((i, j), (j, i))
        )
        return self.compute("subtract", plus, minus)

    # -------------------------------------------------------------------------------------------------------- reductions

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
        if dim in self.shapes.relations and of_every_two(self.shapes.relations[dim]):
            return self._running_pairs(dim, rest, env, operation, term, total)
        waiting = [(0, self.shapes.extent(dim).size)]
        while waiting:
            first, last = waiting.pop(0)
            if last - first == 1:
                total = self._running(rest, {**env, dim: known_number(first)}, operation, term, total)
                continue
            with self._scope() as level:
                index = Index(f"_i{next(self._serial)}", first, first, last, level)
                now = self._total(level)
                try:
                    new = self._running(rest, {**env, dim: index}, operation, term, now)
                except _SplitError as split:
                    if split.index != index.name:
                        raise
                    waiting[:0] = [(first, split.at), (split.at, last)]
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
            i = Index(f"_i{next(self._serial)}", 0, 0, size, level)
            outer = self._total(level)
            with self._scope() as inner_level:
                j = Index(f"_i{next(self._serial)}", 0, 0, size, inner_level)
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

    # --------------------------------------------------------------------------------------------------------- relations

    def _end(self, relation: Relation, function: str, link: Index | Link) -> Index:
        """Return the element at an end of a link."""
        if isinstance(link, Link):
            return link.first if function == "first" else link.second
        numbers = relation.first if function == "first" else relation.second
        if not link.name:
            return known_number(int(numbers[link.shift]))
        starts = stretches(numbers)
        if len(starts) <= PIECES and not link.gathered:
            later = [start for start in starts if start > link.first]
            if later and later[0] < link.last:
                raise _SplitError(link.name, later[0])
            far = int(numbers[link.first]) - link.first
            return link._replace(shift=link.shift + far, first=link.first + far, last=link.last + far)
        table = f"{relation.name}_{function}"
        key, memo = (table, link), self._memos[link.level]
        if key not in memo:
            memo[key] = f"_i{next(self._serial)}"
            place = Place(self._table(table, numbers.tolist()), link.shift, ((link.name, 1),))
            self._scopes[link.level].lines.append(Gather(str(memo[key]), place))
        dim = relation.source if function == "first" else relation.target
        return Index(str(memo[key]), 0, 0, self.shapes.extent(dim).size, link.level, gathered=True)

    def _table(self, name: str, numbers: list[int]) -> str:
        if len(numbers) > LARGEST_TABLE:
            raise UnprintedError
        self.tables.setdefault(name, tuple(numbers))
        return name

    def _onto(self, number: int, node: Along, env: Env) -> Operand:
        """Write the sum of what links give to an element."""
        relation, dim = self.shapes.relations[node.dims[0]], end_of(node, self.shapes)
        index = env[dim]
        if isinstance(index, Link):
            raise UnprintedError
        if number not in self._arrays and not of_every_two(relation) and not index.gathered:
            first, second = (one != ZERO for one in node.arguments)
            runs = patterns(relation, (first, second), self.shapes.extent(dim).size)
            if len(runs) <= PIECES:
                return self._sum_of_links(number, runs, index, env)
        if number not in self._arrays:
            if of_every_two(relation):
                self._stage_pairs(relation)
            else:
                self._stage_links(number, node, relation)
        return self._load_staged(number, env)

    def _sum_of_links(self, number: int, runs: Mapping[int, Pattern], index: Index, env: Env) -> Operand:
        """Write what an element's links give, whose numbers follow from the element's."""
        later = [start for start in runs if start > index.first]
        if later and later[0] < index.last:
            raise _SplitError(index.name, later[0])
        stride, links = runs[max(start for start in runs if start <= index.first)]
        node = self._parts.nodes[number]
        assert isinstance(node, Along)  # noqa: S101 - it is what links give
        terms = []
        for end, far in links:
            if index.name:
                first, last = (stride * n + far for n in (index.first, index.last - 1))
                link = Index(index.name, index.shift, first, last + 1, index.level)
            else:
                link = known_number(index.shift * stride + far)
            terms.append(self._of_link(self._parts.operands[number][end], node.dims[0], link, (stride, far), env))
        return self._chained("add", terms) if terms else 0.0

    def _of_link(self, number: int, dim: str, link: Index, by: tuple[int, int], env: Env) -> Operand:
        """Read what a link gives, after that was computed for all links."""
        if isinstance(self._parts.nodes[number], Negative):
            return self.compute("negative", self._of_link(self._parts.operands[number][0], dim, link, by, env))
        if dim not in self._parts.dims[number]:
            return self.value(number, env)
        dims, (stride, far) = self.shapes.ordered(set(self._parts.dims[number])), by
        place = self._staged(number)
        if not link.name:
            return self._load(self._at(place, dims, {**env, dim: link}), dims, {**env, dim: link})
        apart = math.prod(self.shapes.shape(dims[dims.index(dim) + 1 :]))
        at = self._at(place, dims, {**env, dim: known_number(link.shift * stride + far)})
        at = Place(at.array, at.offset, (*at.strides, (link.name, stride * apart)))
        return self._load(at, dims, {**env, dim: link})

    def _stage_pairs(self, relation: Relation) -> None:
        """Write for every element the sum over all others: those before it, then those after it."""
        parts, dim = self._parts, relation.source
        inner = self._nested_sums()
        numbers = [
            number
            for number, node in enumerate(parts.nodes)
            if _is_onto(node, relation.name) and number not in self._arrays and number not in inner
        ]
        sums: list[tuple[int, Env]] = []  # an onto and the place of each of its elements along small dimensions
        for number in numbers:
            others = tuple(one for one in self._dims(number) if one != dim)
            if not self._written_out(others):
                raise UnprintedError
            self._arrays[number] = self._new_array(number)
            sums += [(number, env) for env in self._all(others)]
        size = self.shapes.extent(dim).size

        def write(env: Env) -> None:
            i = env[dim]
            assert isinstance(i, Index)  # noqa: S101 - elements, no links
            if not i.name or (i.first, i.last) != (0, size):
                raise UnprintedError
            totals: list[Operand] = [-0.0] * len(sums)
            for end in (1, 0):
                totals = self._over_others(relation, end, i, sums, totals)
            for (number, inner), total in zip(sums, totals, strict=True):
                self._store(self._at(self._arrays[number], self._dims(number), {**env, **inner}), total)

        if size <= 1:
            raise UnprintedError
        with self._outside():
            self._nest((dim,), write, whole=True)

    def _over_others(
        self, relation: Relation, end: int, i: Index, sums: Sequence[tuple[int, Env]], totals: list[Operand]
    ) -> list[Operand]:
        """Write the sums over all elements before one, to whose links it is second, or over all after it."""
        size = i.last
        acting = [k for k, (number, _) in enumerate(sums) if self._gives(number, end)]
        if not acting:
            return totals
        with self._scope() as level:
            j = Index(f"_i{next(self._serial)}", 0, 0, size, level)
            link = Link(j, i) if end else Link(i, j)
            now, new = [self._total(level) for _ in acting], []
            with self._whole(i, j):
                for name, k in zip(now, acting, strict=True):
                    number, env = sums[k]
                    term = self.value(self._parts.operands[number][end], {**env, relation.name: link})
                    new.append(self.compute("add", name, term))
            body = tuple(self._scopes[-1].lines)
        start = tuple(totals[k] for k in acting)
        bounds = {"below" if end else "above": i.name}
        line = Reduction(j.name, size, body, tuple(map(str, new)), tuple(now), "newest", start, **bounds)
        joined = dict(zip(acting, self._joined(line), strict=True))
        return [joined.get(k, total) for k, total in enumerate(totals)]

    def _gives(self, number: int, end: int) -> bool:
        """Whether links give something to the elements at one of their ends."""
        node = self._parts.nodes[number]
        return isinstance(node, Along) and node.arguments[end] != ZERO

    def _stage_links(self, number: int, node: Along, relation: Relation) -> None:
        """Write what links give, and then add it to the elements at their ends, link by link."""
        array, dims, dim = self._new_array(number), self._dims(number), end_of(node, self.shapes)
        acting = [end for end in (0, 1) if node.arguments[end] != ZERO]
        others = tuple(one for one in dims if one != dim)
        ends = (relation.first, relation.second)
        touched = np.unique(np.concatenate([ends[end] for end in acting]))
        lonely = np.setdiff1d(np.arange(self.shapes.extent(dim).size), touched).tolist()
        with self._outside():
            values = [self._parts.operands[number][end] for end in acting]
            for value in values:
                if relation.name in self._parts.dims[value]:
                    self._staged(value)
            self._nest(dims, lambda env: self._store(self._at(array, dims, env), -0.0))
            self._nest((relation.name,), lambda env: self._add_links(number, array, others, env), whole=True)
            if lonely:
                self._nest_lonely(self._table(f"{relation.name}_lonely_{number}", lonely), dim, array, dims)
        self._arrays[number] = array

    def _add_links(self, number: int, array: Place, others: tuple[str, ...], env: Env) -> None:
        node, dims = self._parts.nodes[number], self._dims(number)
        assert isinstance(node, Along)  # noqa: S101 - it is what links give
        relation = self.shapes.relations[node.dims[0]]
        link, size = env[relation.name], relation.size
        if not isinstance(link, Index) or (link.first, link.last) != (0, size):
            raise UnprintedError
        if not self._written_out(others):
            raise UnprintedError
        dim = end_of(node, self.shapes)
        for end, function in enumerate(("first", "second")):
            if node.arguments[end] == ZERO:
                continue
            at = self._gathered(relation, function, link)
            for inner in self._all(others):
                here = {**env, **inner, dim: at}
                place = self._at(array, dims, here)
                part = self._parts.operands[number][end]
                term = self._load_staged(part, here) if part in self._arrays else self.value(part, here)
                self._store(place, self.compute("add", self._load(place, dims, here), term))

    def _gathered(self, relation: Relation, function: str, link: Index) -> Index:
        """Return the element at an end, read from a table."""
        numbers = relation.first if function == "first" else relation.second
        name = f"_i{next(self._serial)}"
        table = self._table(f"{relation.name}_{function}", numbers.tolist())
        self._scopes[link.level].lines.append(Gather(name, Place(table, link.shift, ((link.name, 1),))))
        dim = relation.source if function == "first" else relation.target
        return Index(name, 0, 0, self.shapes.extent(dim).size, link.level, gathered=True)

    def _nest_lonely(self, table: str, dim: str, array: Place, dims: tuple[str, ...]) -> None:
        """Set elements without links to 0."""
        others = tuple(one for one in dims if one != dim)
        size = len(self.tables[table])
        with self._scope() as level:
            index, at = f"_i{next(self._serial)}", f"_i{next(self._serial)}"
            self._scopes[-1].lines.append(Gather(at, Place(table, 0, ((index, 1),))))
            here = Index(at, 0, 0, size, level, gathered=True)
            for inner in self._all(others):
                self._store(self._at(array, dims, {**inner, dim: here}), 0.0)
            body = tuple(self._scopes[-1].lines)
        self._scopes[-1].lines.append(Loop(index, size, body))

    def _nested_sums(self) -> set[int]:
        """Return the parts that depend on what links give."""
        found: set[int] = set()
        for number, operands in enumerate(self._parts.operands):
            if any(one in found or _is_onto(self._parts.nodes[one]) for one in operands):
                found.add(number)
        return found

    # ------------------------------------------------------------------------------------------------------------ arrays

    def _staged(self, number: int) -> Place:
        """Compute a part for all its elements before the loops that read it; return the place of the first."""
        if number not in self._arrays:
            array, dims = self._new_array(number), self._dims(number)
            with self._outside():
                self._nest(dims, lambda env: self._store(self._at(array, dims, env), self._direct(number, env)))
            self._arrays[number] = array
        return self._arrays[number]

    def _direct(self, number: int, env: Env) -> Operand:
        """Write a part for its array: a reduction in the loop over what is left."""
        node = self._parts.nodes[number]
        reduces = isinstance(node, Along) and node.function in REDUCTIONS and not self._written_out(node.dims)
        return self._along_all(number, node, env) if reduces else self.value(number, env)  # type: ignore[arg-type]

    def _load_staged(self, number: int, env: Env) -> Operand:
        place, dims = self._staged(number), self._dims(number)
        return self._load(self._at(place, dims, env), dims, env)

    def _new_array(self, number: int) -> Place:
        size = math.prod(self.shapes.shape(self._dims(number)))
        if sum(self.local.values()) + size > LARGEST_LOCAL:
            raise UnprintedError
        name = f"part{number}_"
        self.local[name] = size
        return Place(name)

    def _dims(self, number: int) -> tuple[str, ...]:
        return self.shapes.ordered(set(self._parts.dims[number]))

    def _at(self, place: Place, dims: tuple[str, ...], env: Env) -> Place:
        """Return the place of an element of an array."""
        offset, strides, stride = place.offset, [], 1
        for dim in reversed(dims):
            index = env[dim]
            if isinstance(index, Link):
                raise UnprintedError
            offset += index.shift * stride
            if index.name:
                strides.append((index.name, stride))
            stride *= self.shapes.extent(dim).size
        return Place(place.array, offset, tuple(reversed(strides)))

    def _load(self, place: Place, dims: tuple[str, ...], env: Env) -> Operand:
        level = max((env[dim].level for dim in dims), default=0)
        return self._of_level(level, self._scopes[level].load(place))

    def _store(self, place: Place, value: Operand) -> None:
        self._scopes[-1].lines.append(Store(place, value))

    # ------------------------------------------------------------------------------------------------------------- loops

    def _nest(self, dims: tuple[str, ...], write: Callable[[Env], None], *, whole: bool = False) -> None:
        """Write loops over dimensions; small ones are written out.

        Of others the last, whose elements are next to one another, is the outermost, so that it goes side by side.
        """
        large = [dim for dim in dims if whole or not self._written_out((dim,))]
        small = tuple(dim for dim in dims if dim not in large)

        def inside(env: Env, waiting: list[str]) -> None:
            if waiting:
                self._looped(waiting[0], env, lambda inner: inside(inner, waiting[1:]), whole=whole)
            else:
                for further in self._all(small):
                    write({**env, **further})

        inside({}, [*large[-1:], *large[:-1]])

    def _looped(self, dim: str, env: Env, inside: Callable[[Env], None], *, whole: bool) -> None:
        waiting = [(0, self.shapes.extent(dim).size)]
        while waiting:
            first, last = waiting.pop(0)
            if last - first == 1 and not whole:
                inside({**env, dim: known_number(first)})
                continue
            with self._scope() as level:
                index = Index(f"_i{next(self._serial)}", first, first, last, level)
                try:
                    inside({**env, dim: index})
                except _SplitError as split:
                    if split.index != index.name:
                        raise
                    if whole:
                        raise UnprintedError from None
                    waiting[:0] = [(first, split.at), (split.at, last)]
                    continue
                body = tuple(self._scopes[-1].lines)
            self._scopes[-1].lines.append(Loop(index.name, last - first, body))

    @contextmanager
    def _whole(self, *indices: Index) -> Iterator[None]:
        """Give up where an index of these would have to be split."""
        try:
            yield
        except _SplitError as split:
            if split.index in {index.name for index in indices}:
                raise UnprintedError from None
            raise

    @contextmanager
    def _scope(self) -> Iterator[int]:
        """Write what is in a loop; yield how many loops are around it."""
        self._scopes.append(Assignments(self._find, f"_{next(self._serial)}_"))
        self._memos.append({})
        try:
            yield len(self._scopes) - 1
        finally:
            self._scopes.pop()
            self._memos.pop()

    @contextmanager
    def _outside(self) -> Iterator[None]:
        """Write outside all loops, before those that are being written."""
        inner = self._scopes[1:], self._memos[1:]
        del self._scopes[1:], self._memos[1:]
        try:
            yield
        finally:
            self._scopes += inner[0]
            self._memos += inner[1]

    def _written_out(self, dims: Iterable[str]) -> bool:
        return all(self.shapes.extent(dim).size <= SMALL for dim in dims)

    def _all(self, dims: tuple[str, ...]) -> Iterator[dict[str, Index]]:
        for numbers in product(*map(range, self.shapes.shape(dims))):
            yield dict(zip(dims, map(known_number, numbers), strict=True))

    # ------------------------------------------------------------------------------------------------------------ memory

    def _key(self, dims: Iterable[str], env: Env) -> tuple[Index | Link, ...]:
        return tuple(env[dim] for dim in dims)

    def _depth(self, number: int, env: Env) -> int:
        return max((env[dim].level for dim in self._parts.dims[number]), default=0)

    def _known(self, number: int, env: Env) -> Operand | None:
        return self._memos[self._depth(number, env)].get((number, self._key(self._dims(number), env)))

    def _remember(self, number: int, env: Env, value: Operand) -> Operand:
        self._memos[self._depth(number, env)][number, self._key(self._dims(number), env)] = value
        return value

    def _level(self, operand: Operand) -> int:
        return self._levels.get(operand, 0) if isinstance(operand, str) else 0

    def _of_level(self, level: int, operand: Operand) -> Operand:
        if isinstance(operand, str):
            self._levels.setdefault(operand, level)
        return operand


Pattern = tuple[int, tuple[tuple[int, int], ...]]  # links for an element; the ends and how far from it they are


def of_every_two(relation: Relation) -> bool:
    """Whether a relation has every two elements of a dimension, in their order."""
    n = round((1 + math.sqrt(1 + 8 * relation.size)) / 2)
    if relation.source != relation.target or n * (n - 1) // 2 != relation.size or n < 3:
        return False
    first, second = np.triu_indices(n, 1)
    return bool((relation.first == first).all() and (relation.second == second).all())


def stretches(numbers: np.ndarray[tuple[int], np.dtype[np.int64]]) -> list[int]:
    """Return where stretches begin in which every number is one more than that before it."""
    return [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist()]


def patterns(relation: Relation, acting: tuple[bool, bool], size: int) -> dict[int, Pattern]:
    """Return stretches of elements with equal links, by the first of each; too many, if links follow no order."""
    meeting = relation.meeting
    stride = max(1, len(meeting[0].get(size // 2, ())))
    found: dict[int, Pattern] = {}
    previous = None
    for element in range(size):
        links = sorted((link, end) for end in (0, 1) if acting[end] for link in meeting[end].get(element, ()))
        pattern = stride, tuple((end, link - stride * element) for link, end in links)
        if pattern != previous:
            found[element] = previous = pattern
            if len(found) > PIECES:
                break
    return found


def _is_onto(node: Node, relation: str = "") -> bool:
    return isinstance(node, Along) and node.function == "onto" and relation in ("", node.dims[0])
