"""Expressions of numbers of elements along axes: sums of multiples of indices, and expressions read at other places.

Every axis of an array has a dimension of its own, named by its size and its place from the right, as numpy aligns shapes;
what a sum goes along, or an element is taken from, has one that no axis has.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.traced_grid import Grid
from xdynamics.expressions.tree import (
    Along,
    Binary,
    Call,
    Compare,
    Element,
    Name,
    Negative,
    Node,
    Number,
    every,
    text_of,
)

BOUND = "_s"  # before the number of a dimension that a sum or a taken element has


def axis(grid: Grid, size: int, place: int) -> str:
    """Return the dimension of an axis of a size, at a place from the right."""
    return _declared(grid, f"{grid.name}_{size}_{place}", size)


def bound(grid: Grid, size: int, *nodes: Node) -> str:
    """Return a dimension of a size that expressions do not have yet."""
    taken = {dim for node in nodes for part in every(node) if isinstance(part, Along) for dim in part.dims}
    number = 0
    while f"{grid.name}_{size}{BOUND}{number}" in taken:
        number += 1
    return _declared(grid, f"{grid.name}_{size}{BOUND}{number}", size)


def _declared(grid: Grid, name: str, size: int) -> str:
    grid.extents[name] = size
    return name


def index(dim: str) -> Node:
    """Return the number of an element along a dimension."""
    return Along("index", (), (dim,))


def flat(shape: tuple[int, ...], dims: tuple[str, ...]) -> Node:
    """Return the number of an element of an array whose last axis is the fastest; axes of one element have no dimension."""
    node: Node = Number(0.0)
    stride = 1
    for size, dim in zip(reversed(shape), reversed(dims), strict=True):
        if size > 1:
            node = Binary("+", node, Binary("*", Number(float(stride)), index(dim)))
        stride *= size
    return tidied(node)


def tidied(node: Node) -> Node:
    """Return a sum of multiples of indices, and of other functions of them, with each written once."""
    parts: dict[str, tuple[Node, float]] = {}
    constant = _collect(node, 1.0, parts)
    result: Node | None = None
    for part, factor in parts.values():
        if not factor:
            continue
        term = part if abs(factor) == 1.0 else Binary("*", Number(abs(factor)), part)
        if result is None:
            result = term if factor > 0 else Negative(term)
        else:
            result = Binary("+" if factor > 0 else "-", result, term)
    if result is None:
        return Number(constant) if constant >= 0 else Negative(Number(-constant))
    if not constant:
        return result
    return Binary("+" if constant > 0 else "-", result, Number(abs(constant)))


def _collect(node: Node, factor: float, parts: dict[str, tuple[Node, float]]) -> float:
    match node:
        case Number():
            return factor * node.value
        case Negative():
            return _collect(node.operand, -factor, parts)
        case Binary(operator="+" | "-"):
            sign = 1.0 if node.operator == "+" else -1.0
            return _collect(node.left, factor, parts) + _collect(node.right, sign * factor, parts)
        case Binary("*", Number(value), other) | Binary("*", other, Number(value)):
            return _collect(other, factor * value, parts)
        case Call():
            node = replace(node, arguments=tuple(map(tidied, node.arguments)))
    key = text_of(node)
    parts[key] = node, parts.get(key, (node, 0.0))[1] + factor
    return 0.0


def read_at(node: Node, places: Mapping[str, Node], grid: Grid) -> Node:
    """Return an expression at other places: where the index of a dimension is what another expression says.

    Of a place that is no sum of multiples of indices, the element is taken by its number.
    """
    plain: dict[str, Node] = {}
    taken: list[tuple[str, Node]] = []
    for dim, given in places.items():
        place = tidied(given)
        if any(isinstance(part, Call) for part in every(place)):
            inner = bound(grid, grid.extents[dim], node, *places.values(), *(index(other) for other, _ in taken))
            plain[dim] = index(inner)
            taken.append((inner, place))
        elif place != index(dim):
            plain[dim] = place
    result = replaced(node, plain) if plain else node
    read = {part.dims[0] for part in every(result) if isinstance(part, Along) and part.function == "index"}
    for inner, place in taken:
        if inner in read:
            result = Along("take", (result, place), (inner,))
    return result


def replaced(node: Node, places: Mapping[str, Node]) -> Node:
    """Return an expression with other expressions in the place of indices."""
    kept: dict[int, tuple[Node, Node]] = {}

    def inside(node: Node) -> Node:
        if id(node) not in kept:
            kept[id(node)] = node, _replaced(node)
        return kept[id(node)][1]

    def _replaced(node: Node) -> Node:
        match node:
            case Along(function="index"):
                return places.get(node.dims[0], node)
            case Along(function="take"):
                value, number = map(inside, node.arguments)
                return replace(node, arguments=(value, tidied(number)))
            case Call("where", (Compare() as condition, yes, no)):
                known = inside(condition)
                if isinstance(known, Compare) and not any(
                    isinstance(part, Name | Element | Along) for part in every(known)
                ):
                    return inside(yes if evaluate(known, {}) else no)
                return Call("where", (known, inside(yes), inside(no)))
            case Along() | Call():
                return replace(node, arguments=tuple(map(inside, node.arguments)))
            case Negative():
                return Negative(inside(node.operand))
            case Binary() | Compare():
                return replace(node, left=inside(node.left), right=inside(node.right))
        return node

    return inside(node)


def numbers_along(numbers: NDArray[np.int64], number: Node) -> Node:
    """Return whole numbers by their place: those at even steps together, chosen among by halves."""
    steps, runs, first = np.diff(numbers), [], 0
    while first < len(numbers):
        last = first + 1
        while last < len(numbers) and steps[last - 1] == steps[first]:
            last += 1
        runs.append((first, last))
        first = last

    def among(begin: int, end: int) -> Node:
        if end - begin == 1:
            at, beyond = runs[begin]
            step = int(steps[at]) if beyond - at > 1 else 0
            return tidied(
                Binary(
                    "+",
                    Binary("*", _whole(step), Binary("-", number, Number(float(at)))),
                    _whole(int(numbers[at])),
                )
            )
        middle = (begin + end) // 2
        below = Compare("<", number, Number(float(runs[middle][0])))
        return Call("where", (below, among(begin, middle), among(middle, end)))

    return among(0, len(runs))


def _whole(value: int) -> Node:
    return Number(float(value)) if value >= 0 else Negative(Number(float(-value)))
