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
        self._number_by_key: dict[Any, int] = {}
        self._seen: dict[int, tuple[int, Node]] = {}  # numbers of nodes, which live as long as this

    def number(self, node: Node) -> int:
        """Return the number of an expression, after entering its parts."""
        waiting: list[Binary] = []
        while isinstance(node, Binary) and id(node) not in self._seen:  # a sum may have any length
            waiting.append(node)
            node = node.left
        number = self._seen[id(node)][0] if id(node) in self._seen else self._enter_part(node, children(node))
        for link in reversed(waiting):
            number = self._enter_part(link, (link.right,), number)
        return number

    def _enter_part(self, node: Node, inner: Iterable[Node], *left_operands: int) -> int:
        operands = (*left_operands, *map(self.number, inner))
        key = (_heading(node), operands)
        if key not in self._number_by_key:
            self._number_by_key[key] = len(self.nodes)
            self.nodes.append(node)
            self.operands.append(operands)
            self.dims.append(self._node_dims(node, [self.dims[operand] for operand in operands]))
        self._seen[id(node)] = self._number_by_key[key], node
        return self._number_by_key[key]

    def _node_dims(self, node: Node, inner: list[Set[str]]) -> Set[str]:
        if isinstance(node, Along):
            return dims_along(node, inner, self.shapes)
        return set(self.shapes.dims.get(node.name, ())) if isinstance(node, Name) else set[str]().union(*inner)

    def depending(self, names: Collection[str]) -> list[bool]:
        """Return of every part whether it depends on some names."""
        dependent: list[bool] = []
        for node, operands in zip(self.nodes, self.operands, strict=True):
            is_named = isinstance(node, Name | Element) and node.name in names
            dependent.append(
                is_named or (not isinstance(node, Compare) and any(dependent[operand] for operand in operands))
            )
        return dependent

    def dims_of_node(self, node: Node) -> Set[str]:
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
