"""The distinct parts of expressions with dimensions, each once."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Set
from typing import Any

from xdynamics.expressions import Along, Binary, Call, Compare, Element, Name, Node, Number
from xdynamics.expressions.tree import children
from xdynamics.shapes.extents import Shapes
from xdynamics.shapes.trees import dims_along


class Parts:
    """The distinct parts of expressions, each numbered after those that it is made of, with their dimensions."""

    def __init__(self, shapes: Shapes) -> None:
        self.nodes: list[Node] = []
        self.operands: list[tuple[int, ...]] = []
        self.dims: list[Set[str]] = []
        self.shapes = shapes
        self._known: dict[Any, int] = {}
        self._seen: dict[int, tuple[int, Node]] = {}  # numbers of nodes, which live as long as this

    def number(self, node: Node) -> int:
        """Return the number of an expression, after entering its parts."""
        waiting: list[Binary] = []
        while isinstance(node, Binary) and id(node) not in self._seen:  # a sum may have any length
            waiting.append(node)
            node = node.left
        number = self._seen[id(node)][0] if id(node) in self._seen else self._entered(node, children(node))
        for link in reversed(waiting):
            number = self._entered(link, (link.right,), number)
        return number

    def _entered(self, node: Node, inner: Iterable[Node], *before: int) -> int:
        operands = (*before, *map(self.number, inner))
        key = (_heading(node), operands)
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
            self.operands.append(operands)
            self.dims.append(self._dims(node, [self.dims[operand] for operand in operands]))
        self._seen[id(node)] = self._known[key], node
        return self._known[key]

    def _dims(self, node: Node, inner: list[Set[str]]) -> Set[str]:
        if isinstance(node, Along):
            return dims_along(node, inner, self.shapes)
        return set(self.shapes.dims.get(node.name, ())) if isinstance(node, Name) else set[str]().union(*inner)

    def depending(self, names: Collection[str]) -> list[bool]:
        """Return of every part whether it depends on some names."""
        found: list[bool] = []
        for node, operands in zip(self.nodes, self.operands, strict=True):
            named = isinstance(node, Name | Element) and node.name in names
            found.append(named or (not isinstance(node, Compare) and any(found[operand] for operand in operands)))
        return found

    def of(self, node: Node) -> Set[str]:
        """Return the dimensions of an expression."""
        return self.dims[self.number(node)]


def _heading(node: Node) -> object:
    """Return what tells a node from others with the same operands."""
    match node:
        case Number():
            return repr(node.value)
        case Name():
            return Name, node.name
        case Element():
            return Element, node.name, node.entries
        case Binary() | Compare():
            return type(node), node.operator
        case Call():
            return Call, node.function
        case Along():
            return node.function, node.dims, node.places
    return type(node)
