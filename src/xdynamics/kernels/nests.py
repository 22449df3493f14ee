"""Expressions with dimensions as lines with loops: what is computed for every element, however many there are.

Bits are those of the expressions that `shapes.at_element` gives for each element: sums are ascending, from -0.0, to
which any number can be added without a change.

Links of a relation in a regular order need no table of their ends. Sums over the links that meet an element are loops.
Elements are taken by number: of numbers that are sums of one addend for each index, each index needs a table at most.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import groupby
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number, exponent_of
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import every
from xdynamics.kernels.assignments import CALLED, OPERATIONS, Assignments
from xdynamics.kernels.nest_loops import Env, Link, LoopIndex, Reductions, SplitError, UnprintedError, known_index
from xdynamics.kernels.program import Gather, Location, Loop, Operand, Ordinal, Reduction
from xdynamics.shapes import Relation, Shapes
from xdynamics.shapes.extents import IntArray, taken_numbers, with_index_names
from xdynamics.shapes.trees import element_numbers, end_dimension

PIECES = 16  # stretches of a relation, in each of which ends follow one another, up to which it has no table of ends
Pattern = tuple[int, tuple[tuple[int, int], ...]]  # links for an element; the ends and how far from it they are


def stretch_starts(numbers: np.ndarray[tuple[int], np.dtype[np.int64]]) -> list[int]:
    """Return where stretches begin in which every number is one more than that before it."""
    return [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist()]


def patterns(relation: Relation, acting: tuple[bool, bool], size: int) -> dict[int, Pattern]:
    """Return stretches of elements with equal links, by the first of each; too many, if links follow no order."""
    ends = [_Meeting.sort_links(numbers, size) for numbers in (relation.first, relation.second)]
    stride = max(1, ends[0].links_of(size // 2).size)
    acts = [meeting for meeting, is_acting in zip(ends, acting, strict=True) if is_acting]
    changes = np.zeros(size, bool)
    changes[:1] = True
    for meeting in acts:
        changes[1:] |= meeting.differs(stride)
    stretch_patterns: dict[int, Pattern] = {}
    # one more than is allowed tells the caller that there are too many
    for element in np.flatnonzero(changes)[: PIECES + 1].tolist():
        links = sorted(
            (link, end)
            for end, meeting in enumerate(ends)
            if acting[end]
            for link in meeting.links_of(element).tolist()
        )
        stretch_patterns[element] = stride, tuple((end, link - stride * element) for link, end in links)
    return stretch_patterns


class _Meeting(NamedTuple):
    """The links at one of their ends: by elements, ascending; and where those of each element begin."""

    links: IntArray
    starts: IntArray

    @classmethod
    def sort_links(cls, numbers: IntArray, size: int) -> _Meeting:
        """Return links in the order of the elements at one end, given the number of that element for each link."""
        starts = np.concatenate([[0], np.cumsum(np.bincount(numbers, minlength=size))])
        return cls(np.argsort(numbers, kind="stable"), starts)

    def links_of(self, element: int) -> IntArray:
        """Return the links of an element."""
        return self.links[self.starts[element] : self.starts[element + 1]]

    def differs(self, stride: int) -> NDArray[np.bool_]:
        """Return of every element but the first whether its links are not those before it, `stride` farther on."""
        counts = np.diff(self.starts)
        differs = counts[1:] != counts[:-1]
        link_ranks = np.arange(self.links.size) - np.repeat(
            self.starts[:-1], counts
        )  # the place of a link at its element
        elements = np.repeat(np.arange(counts.size), counts)
        later = elements > 0
        previous_links = (self.starts[elements - 1] + link_ranks)[later]
        # the place before lies beyond the end only where the numbers of links differ, which is noted above
        is_other = self.links[np.minimum(previous_links, self.links.size - 1)] + stride != self.links[later]
        np.logical_or.at(differs, elements[later][is_other] - 1, True)  # noqa: FBT003 - a number of numpy's
        return differs


LARGEST_TABLE = 200_000


class LinkSums(Reductions):
    """Writes values at the ends of links, and sums of links onto the elements there."""

    def _link_end(self, relation: Relation, function: str, link: LoopIndex | Link) -> LoopIndex:
        """Return the element at an end of a link."""
        if isinstance(link, Link):
            return link.first if function == "first" else link.second
        numbers = relation.first if function == "first" else relation.second
        if not link.name:
            return known_index(int(numbers[link.shift]))
        starts = stretch_starts(numbers)
        if len(starts) <= PIECES and not link.gathered:
            later = [start for start in starts if start > link.first]
            if later and later[0] < link.last:
                raise SplitError(link, later[0])
            far = int(numbers[link.first]) - link.first
            return link._replace(shift=link.shift + far, first=link.first + far, last=link.last + far)
        table = f"{relation.name}_{function}"
        key, memo = (table, link), self._memos[link.level]
        if key not in memo:
            memo[key] = f"_i{next(self._serial)}"
            location = Location(self._add_table(table, numbers.tolist()), link.shift, ((link.name, 1),))
            self._scopes[link.level].lines.append(Gather(str(memo[key]), location))
        dim = relation.source if function == "first" else relation.target
        return LoopIndex(str(memo[key]), 0, 0, self.shapes.extent(dim).size, link.level, gathered=True)

    def _add_table(self, name: str, numbers: list[int]) -> str:
        if len(numbers) > LARGEST_TABLE:
            raise UnprintedError
        self.tables.setdefault(name, tuple(numbers))
        return name

    def _onto_sum(self, number: int, node: Along, env: Env) -> Operand:
        """Write the sum of links onto an element."""
        relation, dim = self.shapes.relations[node.dims[0]], end_dimension(node, self.shapes)
        index = env[dim]
        if isinstance(index, Link):
            raise UnprintedError
        if number not in self._arrays and not relation.is_of_every_two and not index.gathered:
            first, second = (argument != ZERO for argument in node.arguments)
            runs = patterns(relation, (first, second), self.shapes.extent(dim).size)
            if len(runs) <= PIECES:
                return self._sum_of_links(number, runs, index, env)
        if number not in self._arrays:
            if relation.is_of_every_two:
                self._stage_pairs(relation)
            else:
                self._stage_links(number, node, relation)
        return self._load_staged(number, env)

    def _sum_of_links(self, number: int, runs: Mapping[int, Pattern], index: LoopIndex, env: Env) -> Operand:
        """Write the sum of an element's links, whose numbers follow from the element's."""
        later = [start for start in runs if start > index.first]
        if later and later[0] < index.last:
            raise SplitError(index, later[0])
        stride, links = runs[max(start for start in runs if start <= index.first)]
        node = self._parts.nodes[number]
        assert isinstance(node, Along)  # noqa: S101 - it is what links give
        terms = []
        for end, far in links:
            if index.name:
                first, last = (stride * n + far for n in (index.first, index.last - 1))
                link = LoopIndex(index.name, index.shift, first, last + 1, index.level)
            else:
                link = known_index(index.shift * stride + far)
            terms.append(self._link_operand(self._parts.operands[number][end], node.dims[0], link, (stride, far), env))
        return self._chain_operations("add", terms) if terms else 0.0

    def _link_operand(
        self, number: int, dim: str, link: LoopIndex, stride_and_shift: tuple[int, int], env: Env
    ) -> Operand:
        """Read the value of a link, after it was computed for all links."""
        if isinstance(self._parts.nodes[number], Negative):
            return self.compute(
                "negative", self._link_operand(self._parts.operands[number][0], dim, link, stride_and_shift, env)
            )
        if dim not in self._parts.dims[number]:
            return self.value(number, env)
        (stride, far), staged_location = stride_and_shift, self._staged(number)
        dims = self._array_dims(number)
        if not link.name:
            return self._load_element(
                self._element_location(staged_location, dims, {**env, dim: link}), dims, {**env, dim: link}
            )
        element_stride = math.prod(self.shapes.shape(dims[dims.index(dim) + 1 :]))
        location = self._element_location(staged_location, dims, {**env, dim: known_index(link.shift * stride + far)})
        location = Location(location.array, location.offset, (*location.strides, (link.name, stride * element_stride)))
        return self._load_element(location, dims, {**env, dim: link})

    def _stage_pairs(self, relation: Relation) -> None:
        """Write for every element the sum over all others, those before it and then those after it; each pair once."""
        parts, dim = self._parts, relation.source
        inner = self._nested_sums()
        numbers = [
            number
            for number, node in enumerate(parts.nodes)
            if _is_onto(node, relation.name) and number not in self._arrays and number not in inner
        ]
        sums: list[tuple[int, Env]] = []  # an onto and the place of each of its elements along small dimensions
        for number in numbers:
            other_dims = tuple(other_dim for other_dim in self._part_dims(number) if other_dim != dim)
            if not self._is_written_out(other_dims):
                raise UnprintedError
            self._arrays[number], self._orders[number] = self._new_array(number), (*other_dims, dim)
            sums += [(number, env) for env in self._all_elements(other_dims)]
        size = self.shapes.extent(dim).size

        def write_element(env: Env) -> None:
            i = env[dim]
            assert isinstance(i, LoopIndex)  # noqa: S101 - elements, no links
            if not i.name or (i.first, i.last) != (0, size):
                raise UnprintedError
            totals = self._sum_over_pairs(relation, i, sums)
            for (number, inner), total in zip(sums, totals, strict=True):
                self._store_line(
                    self._element_location(self._arrays[number], self._array_dims(number), {**env, **inner}), total
                )

        if size <= 1:
            raise UnprintedError
        with self._outside_loops():
            self._nest((dim,), write_element, unsplit=True)

    def _sum_over_pairs(self, relation: Relation, i: LoopIndex, sums: Sequence[tuple[int, Env]]) -> list[Operand]:
        """Write a row of links to all earlier elements: sum their values as second ends, add those of first ends.

        Elements come in order, so that each has got all sums before it when the next begin to add to it.
        """
        acting = [k for k, (number, _) in enumerate(sums) if self._gives(number, 1)]
        with self._loop_scope() as level:
            j = LoopIndex(f"_i{next(self._serial)}", 0, 0, i.last, level)
            links = {relation.name: Link(j, i)}
            now, new = [self._name_total(level) for _ in acting], []
            with self._unsplit_indices(i, j):
                for name, k in zip(now, acting, strict=True):
                    number, env = sums[k]
                    new.append(self.compute("add", name, self.value(self._parts.operands[number][1], {**env, **links})))
                for number, env in sums:
                    if self._gives(number, 0):
                        dims, pair_env = self._array_dims(number), {**env, relation.source: j}
                        location = self._element_location(self._arrays[number], dims, pair_env)
                        term = self.value(self._parts.operands[number][0], {**env, **links})
                        self._store_line(
                            location, self.compute("add", self._load_element(location, dims, pair_env), term)
                        )
            body = tuple(self._scopes[-1].lines)
        # -0.0 + x is x for every x; 0.0 + -0.0 would be 0.0
        start = (-0.0,) * len(acting)
        line = Reduction(j.name, i.last, body, tuple(map(str, new)), tuple(now), "newest", start, below=i.name)
        totals_by_sum = dict(zip(acting, self._add_reduction(line), strict=True))
        return [totals_by_sum.get(k, -0.0) for k in range(len(sums))]

    def _gives(self, number: int, end: int) -> bool:
        """Whether links give something to the elements at one of their ends."""
        node = self._parts.nodes[number]
        return isinstance(node, Along) and node.arguments[end] != ZERO

    def _stage_links(self, number: int, node: Along, relation: Relation) -> None:
        """Write the values of links, and then add them to the elements at their ends, link by link."""
        array, dims, dim = self._new_array(number), self._part_dims(number), end_dimension(node, self.shapes)
        acting = [end for end in (0, 1) if node.arguments[end] != ZERO]
        other_dims = tuple(other_dim for other_dim in dims if other_dim != dim)
        ends = (relation.first, relation.second)
        touched = np.unique(np.concatenate([ends[end] for end in acting]))
        lonely = np.setdiff1d(np.arange(self.shapes.extent(dim).size), touched).tolist()
        with self._outside_loops():
            values = [self._parts.operands[number][end] for end in acting]
            for value in values:
                if relation.name in self._parts.dims[value]:
                    self._staged(value)
            self._nest(dims, lambda env: self._store_line(self._element_location(array, dims, env), -0.0))
            self._nest((relation.name,), lambda env: self._add_links(number, array, other_dims, env), unsplit=True)
            # a sum of no links is 0.0, and not the -0.0 that all begin with
            if lonely:
                self._nest_lonely(self._add_table(f"{relation.name}_lonely_{number}", lonely), dim, array, dims)
        self._arrays[number] = array

    def _add_links(self, number: int, array: Location, other_dims: tuple[str, ...], env: Env) -> None:
        node, dims = self._parts.nodes[number], self._part_dims(number)
        assert isinstance(node, Along)  # noqa: S101 - it is what links give
        relation = self.shapes.relations[node.dims[0]]
        link, size = env[relation.name], relation.size
        if not isinstance(link, LoopIndex) or (link.first, link.last) != (0, size):
            raise UnprintedError
        if not self._is_written_out(other_dims):
            raise UnprintedError
        dim = end_dimension(node, self.shapes)
        for end, function in enumerate(("first", "second")):
            if node.arguments[end] == ZERO:
                continue
            end_index = self._gathered_end(relation, function, link)
            for inner in self._all_elements(other_dims):
                end_env = {**env, **inner, dim: end_index}
                location = self._element_location(array, dims, end_env)
                part = self._parts.operands[number][end]
                term = self._load_staged(part, end_env) if part in self._arrays else self.value(part, end_env)
                self._store_line(location, self.compute("add", self._load_element(location, dims, end_env), term))

    def _gathered_end(self, relation: Relation, function: str, link: LoopIndex) -> LoopIndex:
        """Return the element at an end, read from a table."""
        numbers = relation.first if function == "first" else relation.second
        name = f"_i{next(self._serial)}"
        table = self._add_table(f"{relation.name}_{function}", numbers.tolist())
        self._scopes[link.level].lines.append(Gather(name, Location(table, link.shift, ((link.name, 1),))))
        dim = relation.source if function == "first" else relation.target
        return LoopIndex(name, 0, 0, self.shapes.extent(dim).size, link.level, gathered=True)

    def _nest_lonely(self, table: str, dim: str, array: Location, dims: tuple[str, ...]) -> None:
        """Set elements without links to 0."""
        other_dims = tuple(other_dim for other_dim in dims if other_dim != dim)
        size = len(self.tables[table])
        with self._loop_scope() as level:
            index, element_name = f"_i{next(self._serial)}", f"_i{next(self._serial)}"
            self._scopes[-1].lines.append(Gather(element_name, Location(table, 0, ((index, 1),))))
            lonely_element = LoopIndex(element_name, 0, 0, size, level, gathered=True)
            for inner in self._all_elements(other_dims):
                self._store_line(self._element_location(array, dims, {**inner, dim: lonely_element}), 0.0)
            body = tuple(self._scopes[-1].lines)
        self._scopes[-1].lines.append(Loop(index, size, body))

    def _nested_sums(self) -> set[int]:
        """Return the parts that depend on sums of links."""
        dependent_parts: set[int] = set()
        for number, operands in enumerate(self._parts.operands):
            if any(operand in dependent_parts or _is_onto(self._parts.nodes[operand]) for operand in operands):
                dependent_parts.add(number)
        return dependent_parts


def _is_onto(node: Node, relation: str = "") -> bool:
    return isinstance(node, Along) and node.function == "onto" and relation in ("", node.dims[0])


Terms = dict[str, IntArray]  # what the index of each dimension adds to a number, for every element


class TakenNumbers(LinkSums):
    """Writes the numbers of elements that `take` takes."""

    def _taken_index(self, node: Along, env: Env) -> LoopIndex:
        """Return the element that is taken, as an index."""
        first, terms = self._index_terms(node)
        strides: list[tuple[str, int]] = []
        level = 0
        for dim, numbers in terms.items():
            index = env[dim]
            if isinstance(index, Link):
                raise UnprintedError
            if not index.name:
                first += int(numbers[index.shift])
                continue
            level, step = max(level, index.level), int(numbers[1] - numbers[0])
            if (np.diff(numbers) == step).all():
                first += int(numbers[0]) + step * index.shift
                strides.append((index.name, step))
            else:
                table = self._add_table(_table_name("taken", numbers), numbers.tolist())
                strides.append((self._read_index(Location(table, index.shift, ((index.name, 1),)), index.level), 1))
        return self._sum_index(node, first, [pair for pair in strides if pair[1]], level, env)

    def _sum_index(self, node: Along, first: int, strides: list[tuple[str, int]], level: int, env: Env) -> LoopIndex:
        """Return a sum of a number and multiples of indices as one index."""
        size = self.shapes.extent(node.dims[0]).size
        if not strides:
            return known_index(first)
        if len(strides) == 1 and strides[0][1] == 1:
            loop_index = next(
                (index for index in env.values() if isinstance(index, LoopIndex) and index.name == strides[0][0]), None
            )
            if loop_index is None or loop_index.gathered:
                return LoopIndex(strides[0][0], first, 0, size, level, gathered=True)
            far = first - loop_index.shift
            return loop_index._replace(shift=first, first=loop_index.first + far, last=loop_index.last + far)
        table = self._add_table(
            f"numbers_to_{size}", list(range(size))
        )  # adds, as a place does, and gives the sum a name
        name = self._read_index(Location(table, first, tuple(strides)), level)
        return LoopIndex(name, 0, 0, size, level, gathered=True)

    def _read_index(self, location: Location, level: int) -> str:
        """Read an index from a table, once in its loop."""
        key, memo = ("taken", location), self._memos[level]
        if key not in memo:
            memo[key] = f"_i{next(self._serial)}"
            self._scopes[level].lines.append(Gather(str(memo[key]), location))
        return str(memo[key])

    def _index_terms(self, node: Along) -> tuple[int, Terms]:
        """Return a constant number, and the addend of each index.

        Raises
        ------
        UnprintedError
            If an index gives something else as another one goes on.
        """
        sizes: dict[str, int] = {}
        for part in every(node.arguments[1]):
            if isinstance(part, Along) and part.function == "index":
                sizes[part.dims[0]] = self.shapes.extent(part.dims[0]).size
        for term in _addends(node.arguments[1]):
            if len({part.dims[0] for part in every(term) if isinstance(part, Along) and part.function == "index"}) > 1:
                raise UnprintedError
        ones = {dim: np.zeros(1, np.int64) for dim in sizes}
        first = int(taken_numbers(node, ones, self.shapes).ravel()[0])
        terms: Terms = {}
        for dim, size in sizes.items():
            values = {f"index {other_dim}": 0.0 for other_dim in sizes} | {f"index {dim}": np.arange(float(size))}
            numbers = np.broadcast_to(evaluate_many(with_index_names(node.arguments[1], self.shapes), values), (size,))
            if (numbers != np.floor(numbers)).any():  # halves, which may make whole ones together, and else are told
                raise UnprintedError
            terms[dim] = numbers.astype(np.int64) - first
        # for its refusal: at the corners stand the least and the greatest of all numbers
        taken_numbers(node, _corners(terms), self.shapes)
        return first, terms


def _addends(node: Node) -> list[Node]:
    """Return the addends of an expression, whatever their signs."""
    if isinstance(node, Negative):
        return _addends(node.operand)
    if not isinstance(node, Binary) or node.operator not in "+-":
        return [node]
    return [*_addends(node.left), *_addends(node.right)]


def _corners(terms: Terms) -> dict[str, IntArray]:
    """Return, of every dimension, the elements that give least and most: an axis of each, of two places."""
    corner_elements = {}
    for k, (dim, numbers) in enumerate(terms.items()):
        shape = [1] * len(terms)
        shape[k] = 2
        corner_elements[dim] = np.array([int(numbers.argmin()), int(numbers.argmax())]).reshape(shape)
    return corner_elements


def _table_name(word: str, numbers: IntArray) -> str:
    """Return a name for a table that depends on its content."""
    return f"{word}_{hashlib.sha256(numbers.tobytes()).hexdigest()[:12]}"


Result = tuple[str, tuple[str, ...], Node, Location]  # a name, its dimensions, what it is, where its first element goes


class Nests(TakenNumbers):
    """Writes loops over the elements of quantities.

    Parameters
    ----------
    shapes : Shapes
    find : callable
        Finds names of single numbers, as `Assignments` does.
    first_location : callable
        Returns the location of the first element of a quantity with dimensions; the last dimension is the fastest.
    """

    def __init__(
        self, shapes: Shapes, find: Callable[[Assignments, str], Operand], first_location: Callable[[str], Location]
    ) -> None:
        super().__init__(shapes, find)
        self._first_location = first_location

    def results(self, results: Iterable[Result]) -> None:
        """Write quantities to their locations; consecutive ones with common dimensions share their loops."""
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
        """Write the lines of an expression's part at an element; return its operand."""
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
