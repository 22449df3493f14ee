"""Constant delays: values of the motion before now, as names that a march finds in its own past.

``delayed(x, tau)`` is an expression at ``t - tau``: each name in it that moves is one of a value at that time. Before the
start values are those of `[history]`, or those at the start.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from xdynamics.expressions import Along, Binary, Call, Compare, Name, Negative, Node, chain, expand, free_names
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.tree import DELAYED, every
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity


def has_delays(tree: Node) -> bool:
    """Whether a tree has delayed values, as they are written."""
    return any(isinstance(node, Call) and node.function == DELAYED for node in every(tree))


def value_before(delay: int, name: str) -> str:
    """Name the value of something at the time of a delay; that of `t` is this time itself."""
    return f"_delayed_{delay}_{name}"


def is_before(name: str) -> bool:
    """Whether a name stands for a delayed value."""
    return name.startswith("_delayed_")


def slope_before(value: str) -> str:
    """Name the time derivative of a delayed value, by its name."""
    return f"_slope_{value}"


def in_history(delay: int) -> str:
    """Name the number that is 1 while the time of a delay lies before the start, else 0."""
    return f"_in_history_{delay}"


def value_at_start(name: str) -> str:
    """Name the value at the start, which holds before it unless there is a history."""
    return f"_start_{name}"


def argument_before(argument: Node, moving: Iterable[str], delay: int) -> Node:
    """Return the argument of a drive's table at the time of a delay."""
    return expand(argument, {name: Name(value_before(delay, name)) for name in ("t", *moving)})


def delays_of(statement: Statement) -> tuple[Node, ...]:
    """Return the different delays of a statement, in the order of its sections, with definitions expanded."""
    return tuple(dict.fromkeys(expand(call.arguments[1], statement.definitions) for call in statement.delayed))


def with_delayed_names(tree: Node, delays: tuple[Node, ...], moving: frozenset[str]) -> Node:
    """Return a tree, with definitions expanded, in which names stand for delayed values; `moving` has drives, too."""
    if not has_delays(tree):
        return tree

    def replace_call(call: Call) -> Node:
        delayed_tree, delay_tree = call.arguments
        delay = delays.index(delay_tree)
        names = free_names(delayed_tree) & (moving | {"t"})
        return expand(delayed_tree, {name: Name(value_before(delay, name)) for name in names})

    return _replace_delayed(tree, replace_call)


def delayed_rates(delay: int, coordinates: Iterable[str], states: Iterable[str]) -> dict[str, Node]:
    """Return the time derivatives of delayed values, by their names."""
    rates: dict[str, Node] = {value_before(delay, "t"): ONE}
    for name in coordinates:
        past_value, speed = value_before(delay, name), value_before(delay, velocity(name))
        rates |= {past_value: Name(speed), speed: Name(slope_before(speed))}
    return rates | {
        past_value: Name(slope_before(past_value)) for past_value in (value_before(delay, name) for name in states)
    }


def _replace_delayed(tree: Node, replace_call: Callable[[Call], Node]) -> Node:
    """Return a tree in which delayed values are replaced by other trees."""
    match tree:
        case Call(function="delayed"):
            return replace_call(tree)
        case Negative():
            return Negative(_replace_delayed(tree.operand, replace_call), tree.column)
        case Binary():
            first, links = chain(tree)
            rebuilt = _replace_delayed(first, replace_call)
            for link in links:
                rebuilt = Binary(link.operator, rebuilt, _replace_delayed(link.right, replace_call), link.column)
            return rebuilt
        case Compare():
            return Compare(
                tree.operator,
                _replace_delayed(tree.left, replace_call),
                _replace_delayed(tree.right, replace_call),
                tree.column,
            )
        case Call() | Along():
            return replace(tree, arguments=tuple(_replace_delayed(part, replace_call) for part in tree.arguments))
    return tree
