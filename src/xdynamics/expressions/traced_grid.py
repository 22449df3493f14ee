"""The dimension that traced rows are along, and their expressions at other places of it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions.real_numbers import real
from xdynamics.expressions.tracing import node_of
from xdynamics.expressions.tree import Along, Binary, Call, Compare, Element, Name, Negative, Node, Number
from xdynamics.faults import InputError

ZERO = Number(0.0)

Floats = NDArray[np.float64]


class IrregularError(InputError):
    """An array that is no row; its elements are written out."""


class Grid:
    """The dimension that rows are along, and the rows of numbers that expressions mention.

    Parameters
    ----------
    name : str
        The quantity that is unknown; its dimension is named after it.
    size : int
    leaf : Node
        The quantity as functions have it, perhaps divided by its unit.

    Attributes
    ----------
    constants : dict of str to ndarray
        Parameters along the dimension, perhaps along a second one of as many elements.
    extents : dict of str to int
        Sizes of further dimensions: of axes of arrays, and of lists of numbers.
    lists : dict of str to ndarray
        Parameters, each along a dimension of its own.
    """

    def __init__(self, name: str, size: int, leaf: Node) -> None:
        self.name, self.dim, self.other, self.size, self.leaf = name, f"{name}_index", f"{name}_other", size, leaf
        self.constants: dict[str, Floats] = {}
        self.extents: dict[str, int] = {}
        self.lists: dict[str, Floats] = {}

    def constant(self, values: Any, offset: int) -> Node:
        """Return numbers that begin at an element as a parameter, or as one number if they are equal.

        Raises
        ------
        IrregularError
            If a number is not finite.
        """
        numbers = np.asarray(real(values), float)
        if not np.isfinite(numbers).all():
            raise IrregularError("the function makes a row with numbers that are not finite")
        if (numbers == numbers.flat[0]).all():
            return node_of(float(numbers.flat[0]))
        full = numbers
        if numbers.ndim == 1:
            full = np.zeros(self.size)
            full[offset : offset + numbers.size] = numbers
        word = next((known for known, kept in self.constants.items() if np.array_equal(kept, full)), "")
        word = word or f"constant_{len(self.constants)}"
        self.constants[word] = full
        return Name(word)

    def listed(self, numbers: Floats) -> tuple[str, str]:
        """Return numbers as a parameter along a dimension of its own: its name, and that of the dimension."""
        word = next((known for known, kept in self.lists.items() if np.array_equal(kept, numbers)), "")
        word = word or f"numbers_{len(self.lists)}"
        self.lists[word], self.extents[f"{word}_index"] = numbers, numbers.size
        return word, f"{word}_index"


def common(nodes: list[Node], constant: Callable[[list[float]], Node]) -> Node:
    """Return the expression of which those of all elements are cases that differ in numbers alone.

    Parameters
    ----------
    nodes : list of Node
        One for each element.
    constant : callable
        What makes an expression of a number for each.

    Raises
    ------
    IrregularError
        If they differ in more.
    """
    numbers = [value_of(node) for node in nodes]
    if None not in numbers:
        return constant([number for number in numbers if number is not None])
    model = next(node for node, number in zip(nodes, numbers, strict=True) if number is None)
    if all(node == model for node in nodes):
        return model
    parts = [_like(node, model) for node in nodes]
    match model:
        case Negative():
            return Negative(common([part.operand for part in parts], constant))
        case Binary() | Compare():
            left, right = (common([getattr(part, side) for part in parts], constant) for side in ("left", "right"))
            return type(model)(model.operator, left, right)
        case Call():
            return Call(
                model.function,
                tuple(common([part.arguments[i] for part in parts], constant) for i in range(len(model.arguments))),
            )
    raise IrregularError("the function joins a row with elements that have an expression each")


def _like(node: Node, model: Node) -> Any:
    """Return a tree in the form of another one: a product that was left out because a factor is 0 or 1, say."""
    if type(node) is type(model) and [
        getattr(node, word, None) == getattr(model, word, None) for word in ("operator", "function")
    ] == [True, True]:
        return node
    number = value_of(node)
    if isinstance(model, Binary) and model.operator in "*+":
        is_sum, number_first = model.operator == "+", value_of(model.left) is not None
        other = model.right if number_first else model.left
        sides = (Number(0.0), node) if is_sum and number is not None else (node, Number(0.0 if is_sum else 1.0))
        if number == 0.0 and not is_sum:
            sides = (other, Number(0.0))
        return Binary(model.operator, *(sides[::-1] if number_first else sides))
    raise IrregularError("the function joins a row with elements that have an expression each")


def value_of(node: Node) -> float | None:
    """Return the number that a tree is, if it is one."""
    if isinstance(node, Negative) and isinstance(node.operand, Number):
        return -node.operand.value
    return node.value if isinstance(node, Number) else None


def moved(node: Node, places: int, grid: Grid) -> Node:
    """Return an expression whose elements are those some places before; what is beyond the end does not matter."""
    known: dict[int, Node] = {}

    def inside(node: Node) -> Node:
        if id(node) not in known:
            known[id(node)] = _moved(node, places, grid, inside)
        return known[id(node)]

    return inside(node) if places else node


def _moved(node: Node, places: int, grid: Grid, inside: Callable[[Node], Node]) -> Node:
    match node:
        case Name() if node.name == grid.name or node.name in grid.constants:
            return Along("shift", (node, ZERO), (grid.dim,), places)
        case Along(function="shift") if node.dims == (grid.dim,):
            total = node.places + places
            return Along("shift", node.arguments, node.dims, total) if total else node.arguments[0]
        case Along(function="roll"):
            return Along("shift", (node, ZERO), (grid.dim,), places)
        case Along(function="index") if node.dims == (grid.dim,):
            return Binary("-" if places > 0 else "+", node, Number(float(abs(places))))
        case Negative():
            return Negative(inside(node.operand))
        case Binary():
            return Binary(node.operator, inside(node.left), inside(node.right))
        case Compare(left=Binary(operator="+" | "-", left=Along(function="index")) as index, right=Number(value=value)):
            offset = index.right.value if isinstance(index.right, Number) else 0.0
            at = value + places + (offset if index.operator == "-" else -offset)
            return Compare(node.operator, index.left, node_of(at))
        case Compare(left=Along(function="index"), right=Number(value=value)):
            return Compare(node.operator, node.left, node_of(value + places))
        case Compare():
            return Compare(node.operator, inside(node.left), inside(node.right))
        case Call():
            return Call(node.function, tuple(map(inside, node.arguments)))
    return node


def element(node: Node, number: int, grid: Grid) -> Node:
    """Return an expression at one element."""
    known: dict[int, Node] = {}

    def inside(node: Node) -> Node:
        if id(node) not in known:
            known[id(node)] = _element(node, number, grid, inside)
        return known[id(node)]

    return inside(node)


def _element(node: Node, number: int, grid: Grid, inside: Callable[[Node], Node]) -> Node:
    match node:
        case Name() if node.name == grid.name:
            return Element(node.name, (number,))
        case Name() if node.name in grid.constants:
            return node_of(float(grid.constants[node.name][number]))
        case Along(function="index") if node.dims == (grid.dim,):
            return Number(float(number))
        case Along(function="shift") if node.dims == (grid.dim,):
            return element(node.arguments[0], (number - node.places) % grid.size, grid)
        case Along(function="roll"):
            return element(node.arguments[0], (number - node.places) % grid.size, grid)
        case Negative():
            return Negative(inside(node.operand))
        case Binary():
            return Binary(node.operator, inside(node.left), inside(node.right))
        case Compare():
            return Compare(node.operator, inside(node.left), inside(node.right))
        case Call(function="where", arguments=(Compare("<", Along(function="index"), Number(value)), yes, no)):
            return inside(yes if number < value else no)
        case Call():
            return Call(node.function, tuple(map(inside, node.arguments)))
    return node


def varies(node: Node, grid: Grid) -> bool:
    """Whether an expression has the dimension."""
    match node:
        case Name():
            return node.name == grid.name or node.name in grid.constants
        case Along():
            return node.function in ("shift", "roll", "index")
        case Negative():
            return varies(node.operand, grid)
        case Binary() | Compare():
            return varies(node.left, grid) or varies(node.right, grid)
        case Call():
            return any(varies(part, grid) for part in node.arguments)
    return False
