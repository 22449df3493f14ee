"""Conditions of choices: comparisons joined by `and` and `or`, and turned round.

The language has comparisons as the first argument of `where` alone; what joins them is written as choices within choices.
"""

from __future__ import annotations

from dataclasses import dataclass

from xdynamics.expressions.tree import Call, Compare, Node, Number
from xdynamics.faults import InputError

OPPOSITE = {"<": ">=", ">=": "<", ">": "<=", "<=": ">", "==": "!=", "!=": "=="}
SIGNS = {"and": "&", "or": "|"}


@dataclass(frozen=True)
class Junction:
    """Two conditions, of which both have to hold, or one."""

    word: str
    left: Condition
    right: Condition


Condition = Compare | Junction


def is_condition(node: Node | Junction) -> bool:
    """Whether a tree holds or does not, rather than being a number."""
    return isinstance(node, Compare | Junction)


def junction(word: str, left: Node | Junction, right: Node | Junction) -> Junction:
    """Join two conditions.

    Raises
    ------
    InputError
        If one is a number.
    """
    if isinstance(left, Compare | Junction) and isinstance(right, Compare | Junction):
        return Junction(word, left, right)
    sign = SIGNS[word]
    raise InputError(
        f"the function joins by {sign} what is no comparison; put each in parentheses: (a > 0) {sign} (b > 0)"
    )


def opposite(node: Node | Junction) -> Condition:
    """Return the condition that holds where another does not.

    Raises
    ------
    InputError
        If it is a number.
    """
    if isinstance(node, Junction):
        return Junction("or" if node.word == "and" else "and", opposite(node.left), opposite(node.right))
    if isinstance(node, Compare):
        return Compare(OPPOSITE[node.operator], node.left, node.right)
    raise InputError("the function takes ~ of what is no comparison; write ~(a > 0)")


def choice_tree(condition: Node | Junction, yes: Node, no: Node) -> Node:
    """Return the tree of a choice."""
    if isinstance(condition, Junction):
        inner_choice = choice_tree(condition.right, yes, no)
        return (
            choice_tree(condition.left, inner_choice, no)
            if condition.word == "and"
            else choice_tree(condition.left, yes, inner_choice)
        )
    return Call("where", (condition, yes, no))


def truth_as_number(node: Node | Junction) -> Node:
    """Return a number as it is, and for a condition 1 where it holds, else 0, as Python counts truths."""
    return choice_tree(node, Number(1.0), Number(0.0)) if isinstance(node, Compare | Junction) else node
