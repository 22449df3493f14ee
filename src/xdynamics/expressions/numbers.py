"""The number of an expression of any length."""

from __future__ import annotations

from collections import ChainMap
from collections.abc import Mapping

from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import Binary, Call, Compare, Name, Negative, Node, chain

LONGEST = 100  # of a chain that is evaluated in one go


def number_of(node: Node, values: Mapping[str, float]) -> float:
    """Return what `evaluate` gives, which goes down a chain by recursion: a long one is evaluated part by part.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> number_of(parse("x" + " + 0.25"*10_000), {"x": 1.0})
    2501.0
    """
    parts: dict[str, float] = {}
    short = _shortened(node, values, parts)
    return evaluate(short, ChainMap(parts, values) if parts else values)  # type: ignore[arg-type]


def _shortened(node: Node, values: Mapping[str, float], parts: dict[str, float]) -> Node:
    """Return an expression of the same number whose chains are short; what they begin with is a part by name."""
    match node:
        case Binary():
            first, links = chain(node)
            found = _shortened(first, values, parts)
            for count, one in enumerate(links, start=1):
                right = _shortened(one.right, values, parts)
                same = found is one.left and right is one.right
                found = one if same else Binary(one.operator, found, right)
                if count % LONGEST == 0:
                    name = f"_part_{len(parts)}"
                    parts[name] = evaluate(found, ChainMap(parts, values))  # type: ignore[arg-type]
                    found = Name(name)
            return found
        case Negative():
            operand = _shortened(node.operand, values, parts)
            return node if operand is node.operand else Negative(operand)
        case Compare():
            return Compare(node.operator, _shortened(node.left, values, parts), _shortened(node.right, values, parts))
        case Call():
            return Call(node.function, tuple(_shortened(one, values, parts) for one in node.arguments))
    return node
