"""`floor`, `ceil`, `round` and `mod` at ticks, where what is a whole number to rounding counts as whole.

A tick at 60 us is three periods of 20 us, and 60e-6/20e-6 is 2.9999999999999996. In forces the switches of these
functions have the same margin (`kinks.jump_function`). What they give is compared with the same margin: ``mod(t, T) < T/2``
is not so at a tick in the middle of a period.
"""

from __future__ import annotations

from dataclasses import replace

from xdynamics.expressions import CALLED_ALONE, Along, Binary, Call, Compare, Negative, Node, Number, chain
from xdynamics.expressions.calculus import ONE, TWO, ZERO
from xdynamics.expressions.tree import every
from xdynamics.model.kinks import rounded_argument

ROUNDING = Number(1e-15)  # of the sizes of what is added up


def with_whole_numbers(node: Node) -> Node:
    """Return an expression in which `floor`, `ceil`, `round` and `mod` take numbers that are nearly whole for whole."""
    match node:
        case Negative():
            return Negative(with_whole_numbers(node.operand), node.column)
        case Binary():
            first, links = chain(node)
            tree = with_whole_numbers(first)
            for part in links:
                tree = Binary(part.operator, tree, with_whole_numbers(part.right), part.column)
            return tree
        case Compare():
            inner = replace(node, left=with_whole_numbers(node.left), right=with_whole_numbers(node.right))
            return _compare_rounded(inner, node) if _counts_whole_numbers(node) else inner
        case Call() | Along():
            call = replace(node, arguments=tuple(map(with_whole_numbers, node.arguments)))
            if not isinstance(call, Call) or not isinstance(node, Call):
                return call
            if call.function == "sign" and _counts_whole_numbers(node):
                near = Compare("<=", Call("abs", call.arguments), _margin(node.arguments[0]))
                return Call("where", (near, ZERO, call))
            return _settle_call(call, node) if call.function in CALLED_ALONE else call
    return node


def _counts_whole_numbers(node: Node) -> bool:
    """Whether whole numbers are counted anywhere in an expression."""
    return any(isinstance(part, Call) and part.function in CALLED_ALONE for part in every(node))


def _compare_rounded(inner: Compare, node: Compare) -> Compare:
    """Return a comparison in which both sides are equal if they are so to rounding."""
    difference, margin = Binary("-", inner.left, inner.right), _margin(Binary("-", node.left, node.right))
    match node.operator:
        case "<" | ">=":
            return Compare(node.operator, difference, Negative(margin))
        case "==" | "!=":
            return Compare("<=" if node.operator == "==" else ">", Call("abs", (difference,)), margin)
    return Compare(node.operator, difference, margin)


def _settle_call(call: Call, node: Call) -> Node:
    """Return a call that is decided where its argument is nearly whole; for `round` where it is nearly half of one."""
    u, plain = rounded_argument(call.function, call.arguments), rounded_argument(node.function, node.arguments)
    number, margin = (
        (Binary("*", TWO, u), Binary("*", TWO, _margin(plain))) if call.function == "round" else (u, _margin(plain))
    )
    nearest = Call("round", (number,))
    near = Compare("<=", Call("abs", (Binary("-", number, nearest),)), margin)
    settled_value: Node = nearest
    if call.function == "mod":
        settled_value = Binary("*", ZERO, call.arguments[1])
    elif call.function == "round":  # the even one of two equally near ones
        settled_value = Call("round", (Binary("/", nearest, TWO),))
    elif call.function == "ceil":
        settled_value = Negative(nearest)
    return Call("where", (near, settled_value, call))


def _margin(node: Node) -> Node:
    """Return how far rounding may have moved an expression."""
    return Binary("*", ROUNDING, _size_of_terms(node))


def _size_of_terms(node: Node) -> Node:
    """Return the sum of the sizes of what an expression is added up from, before whole numbers are taken off."""
    match node:
        case Negative():
            return _size_of_terms(node.operand)
        case Binary(operator="+" | "-"):
            return Binary("+", _size_of_terms(node.left), _size_of_terms(node.right))
        case Binary(operator="*"):
            return Binary("*", _size_of_terms(node.left), _size_of_terms(node.right))
        case Binary(operator="/"):
            return Binary("/", _size_of_terms(node.left), Call("abs", (node.right,)))
        case Call(function="mod"):
            return Binary("+", _size_of_terms(node.arguments[0]), Call("abs", (node.arguments[1],)))
        case Call(function="floor" | "ceil" | "round"):
            return Binary("+", _size_of_terms(node.arguments[0]), ONE)
    return Call("abs", (node,))
