"""What stands at the ends of links, and sums over the links that meet an element, in loops."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from xdynamics.expressions import Along, Negative, Node
from xdynamics.expressions.calculus import ZERO
from xdynamics.kernels.link_patterns import PIECES, Pattern, patterns, stretch_starts
from xdynamics.kernels.nest_indices import Env, Link, LoopIndex, SplitError, UnprintedError, known_index
from xdynamics.kernels.nest_reductions import Reductions
from xdynamics.kernels.program import Gather, Location, Loop, Operand, Reduction
from xdynamics.shapes import Relation
from xdynamics.shapes.trees import end_dimension

LARGEST_TABLE = 200_000


class LinkSums(Reductions):
    """Writes values at the ends of links, and what links give to the elements there."""

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
        """Write the sum of what links give to an element."""
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
        """Write what an element's links give, whose numbers follow from the element's."""
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
        """Read what a link gives, after that was computed for all links."""
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
        """Write the links to all elements before one: sums of what they give to it, as their second; add to the others.

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
        start = (-0.0,) * len(acting)
        line = Reduction(j.name, i.last, body, tuple(map(str, new)), tuple(now), "newest", start, below=i.name)
        totals_by_sum = dict(zip(acting, self._add_reduction(line), strict=True))
        return [totals_by_sum.get(k, -0.0) for k in range(len(sums))]

    def _gives(self, number: int, end: int) -> bool:
        """Whether links give something to the elements at one of their ends."""
        node = self._parts.nodes[number]
        return isinstance(node, Along) and node.arguments[end] != ZERO

    def _stage_links(self, number: int, node: Along, relation: Relation) -> None:
        """Write what links give, and then add it to the elements at their ends, link by link."""
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
        """Return the parts that depend on what links give."""
        dependent_parts: set[int] = set()
        for number, operands in enumerate(self._parts.operands):
            if any(operand in dependent_parts or _is_onto(self._parts.nodes[operand]) for operand in operands):
                dependent_parts.add(number)
        return dependent_parts


def _is_onto(node: Node, relation: str = "") -> bool:
    return isinstance(node, Along) and node.function == "onto" and relation in ("", node.dims[0])
