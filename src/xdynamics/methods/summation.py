"""The sums of a method's lines that lead from the old state to the new one, for compensated summation."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from xdynamics.expressions import Binary, Name, Negative, Node
from xdynamics.methods.lines import VectorStatement
from xdynamics.methods.method import Method

PLAIN, COMPENSATED = SUMMATIONS = ("plain", "compensated")


@dataclass(frozen=True)
class Update:
    """``v3 = v2 + 3/4*h*a2`` split into the vector before and the increment."""

    start_vector: str
    increment: Node


@cache
def updates(method: Method) -> dict[str, Update]:
    """Return the sums by which q, v and x become q1, v1 and x1, keyed by their targets; none unless all do so."""
    sums = {line.target: _split_sum(line) for line in method.statements if isinstance(line, VectorStatement)}
    by_target = {}
    for letter in "qvx":
        target = f"{letter}1"
        while target != letter:
            update = sums.get(target)
            if update is None or update.start_vector[0] != letter:
                return {}
            by_target[target] = update
            target = update.start_vector
    return by_target


def _split_sum(line: VectorStatement) -> Update | None:
    """Split a sum; None if a line does not begin with a single vector."""
    terms: list[tuple[str, Node]] = []
    node = line.expression
    while isinstance(node, Binary) and node.operator in "+-":
        terms.insert(0, (node.operator, node.right))
        node = node.left
    if not isinstance(node, Name) or not terms:
        return None
    sign, added = terms[0]
    added = added if sign == "+" else Negative(added)
    for sign, term in terms[1:]:
        added = Binary(sign, added, term)
    return Update(node.name, added)
