"""Elements that are taken by number in loops: numbers that are sums of what each index gives need a table for each at most."""

from __future__ import annotations

import hashlib

import numpy as np

from xdynamics.expressions import Along, Binary, Negative, Node
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.expressions.tree import every
from xdynamics.kernels.nest_indices import Env, Link, LoopIndex, UnprintedError, known_index
from xdynamics.kernels.nest_links import LinkSums
from xdynamics.kernels.program import Gather, Location
from xdynamics.shapes.numbers_of_elements import IntArray, taken_numbers, with_index_names

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
        """Return a number, and what each index adds to it.

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
        taken_numbers(node, _corners(terms), self.shapes)
        return first, terms


def _addends(node: Node) -> list[Node]:
    """Return what is added in an expression, whatever its sign."""
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
    """Return a name for a table that says what is in it."""
    return f"{word}_{hashlib.sha256(numbers.tobytes()).hexdigest()[:12]}"
