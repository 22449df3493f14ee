"""Expressions on known sides of their switches: smooth, where signs and comparisons become numbers of the march."""

from __future__ import annotations

from collections.abc import Mapping

from xdynamics.expressions import (
    CALLED_ALONE,
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    chain,
)
from xdynamics.expressions.calculus import ONE, TWO, ZERO
from xdynamics.model.kinks import counted, turning


def on_sides(node: Node, sides: Mapping[Node, str]) -> Node:
    """Substitute sides for signs and comparisons."""
    if isinstance(node, Binary):
        first, links = chain(node)
        tree = on_sides(first, sides)
        for child in links:
            tree = Binary(child.operator, tree, on_sides(child.right, sides), child.column)
        return tree
    if isinstance(node, Negative):
        return Negative(on_sides(node.operand, sides), node.column)
    if isinstance(node, Compare):
        return Compare(node.operator, on_sides(node.left, sides), on_sides(node.right, sides), node.column)
    if not isinstance(node, Call):
        return node
    inner = tuple(on_sides(child, sides) for child in node.arguments)
    if node.function in ("abs", "sign") and node.arguments[0] in sides:
        side_name = Name(sides[node.arguments[0]])
        return side_name if node.function == "sign" else Binary("*", side_name, inner[0])
    if node.function in ("min", "max"):
        return _extremum_on_sides(node, inner, sides)
    if node.function in CALLED_ALONE and (name := sides.get(turning(node))) is not None:
        return _whole_on_side(node.function, inner, Name(name))
    if node.function == "where" and isinstance(node.arguments[0], Compare):
        condition = node.arguments[0]
        known_side = sides.get(Binary("-", condition.left, condition.right))
        if known_side is not None:
            return Call("where", (Compare(condition.operator[0], Name(known_side), ZERO), *inner[1:]), node.column)
    return Call(node.function, inner, node.column)


def _whole_on_side(function: str, inner: tuple[Node, ...], side_name: Name) -> Node:
    """Write `floor`, `ceil`, `round` and `mod` for a known side: the even, or odd, whole number that is near."""
    moved = Binary("+", ONE, side_name) if function == "round" else side_name
    halves = Binary("+", Binary("/", counted(function, inner), TWO), Binary("/", moved, Number(4.0)))
    odd = Binary("/", Binary("-", ONE, side_name), TWO)
    whole = Binary("+", Binary("*", TWO, Call("floor", (halves,))), odd)
    if function == "mod":
        return Binary("-", inner[0], Binary("*", inner[1], whole))
    return Negative(whole) if function == "ceil" else whole


def _extremum_on_sides(node: Call, inner: tuple[Node, ...], sides: Mapping[Node, str]) -> Node:
    """Write min and max as `where`, as far as their sides are known."""
    result, others = inner[-1], node.arguments[-1:]
    for i in range(len(inner) - 2, -1, -1):
        best = others[0] if len(others) == 1 else Call(node.function, others)
        side_name = sides.get(Binary("-", node.arguments[i], best))
        if side_name is None:
            result = Call(node.function, (inner[i], result))
        else:
            result = Call(
                "where", (Compare("<" if node.function == "min" else ">", Name(side_name), ZERO), inner[i], result)
            )
        others = (node.arguments[i], *others)
    return result
