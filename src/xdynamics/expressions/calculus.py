"""Derivatives by the rules of the textbook, on our own tree.

A derivative becomes arithmetic of a run. A computer-algebra system orders its terms by its own version; these
rules keep the order in which the expression was written, whatever is installed. The tests hold them against one.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from xdynamics.expressions.tree import (
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    children,
    exponent_of,
    text_of,
)
from xdynamics.faults import InputError

ZERO, ONE, TWO = Number(0.0), Number(1.0), Number(2.0)
MOST_EXPANDED = 5000


def expand(node: Node, definitions: Mapping[str, Node]) -> Node:
    """Put definitions, themselves expanded, in the place of their names.

    Raises
    ------
    InputError
        If the result has more than 5,000 nodes.
    """
    try:
        if _expanded_size(node, definitions) <= MOST_EXPANDED:
            return _expand(node, definitions)
    except RecursionError:
        raise InputError(f"definitions of '{text_of(node)[:60]}' are nested too deeply; shorten the chain") from None
    raise InputError(f"definitions expand '{text_of(node)[:60]}' to over {MOST_EXPANDED} nodes; shorten them")


def derivative(node: Node, rates: Mapping[str, Node]) -> Node:
    """Return the derivative by the chain rule.

    Parameters
    ----------
    node : Node
        An expression without definitions left in it.
    rates : mapping of str to Node
        The derivative of each name that varies: ``{"y": Number(1)}`` gives the partial derivative by y,
        ``{"t": Number(1), "y": Name("v_y"), …}`` the one in time. A name not listed is constant.

    Notes
    -----
    At the kink of ``abs``, ``min``, ``max``, ``where`` the derivative is the one of the branch taken; of ``sign``
    it is zero everywhere.
    """
    match node:
        case Name():
            return rates.get(node.name, ZERO)
        case Negative():
            return negative(derivative(node.operand, rates))
        case Binary():
            return _of_binary(node, rates)
        case Call():
            return _of_call(node, rates)
    return ZERO


def _expanded_size(node: Node, definitions: Mapping[str, Node]) -> int:
    sizes: dict[str, int] = {}

    def count(one: Node) -> int:
        if isinstance(one, Name) and one.name in definitions:
            if one.name not in sizes:
                sizes[one.name] = count(definitions[one.name])
            return sizes[one.name]
        return 1 + sum(count(child) for child in children(one))

    return count(node)


def _expand(node: Node, definitions: Mapping[str, Node]) -> Node:
    match node:
        case Name() if node.name in definitions:
            return _expand(definitions[node.name], definitions)
        case Negative():
            return Negative(_expand(node.operand, definitions), node.column)
        case Binary():
            return Binary(node.operator, _expand(node.left, definitions), _expand(node.right, definitions), node.column)
        case Compare():
            return Compare(
                node.operator, _expand(node.left, definitions), _expand(node.right, definitions), node.column
            )
        case Call():
            return Call(node.function, tuple(_expand(one, definitions) for one in node.arguments), node.column)
    return node


def negative(node: Node) -> Node:
    """Return ``-node``; signs cancel and zero stays."""
    if node == ZERO:
        return ZERO
    return node.operand if isinstance(node, Negative) else Negative(node)


def add(left: Node, right: Node) -> Node:
    """Return ``left + right`` without zeros."""
    if left == ZERO:
        return right
    if right == ZERO:
        return left
    return Binary("-", left, right.operand) if isinstance(right, Negative) else Binary("+", left, right)


def multiply(left: Node, right: Node) -> Node:
    """Return ``left*right`` without zeros, ones and inner signs."""
    if ZERO in (left, right):
        return ZERO
    if isinstance(left, Negative):
        return negative(multiply(left.operand, right))
    if isinstance(right, Negative):
        return negative(multiply(left, right.operand))
    if left == ONE:
        return right
    return left if right == ONE else Binary("*", left, right)


def divide(left: Node, right: Node) -> Node:
    """Return ``left/right`` without zeros, ones and an inner sign."""
    if left == ZERO:
        return ZERO
    if isinstance(left, Negative):
        return negative(divide(left.operand, right))
    return left if right == ONE else Binary("/", left, right)


def _of_binary(node: Binary, rates: Mapping[str, Node]) -> Node:
    left, right = node.left, node.right
    left_rate, right_rate = derivative(left, rates), derivative(right, rates)
    match node.operator:
        case "+":
            return add(left_rate, right_rate)
        case "-":
            return add(left_rate, negative(right_rate))
        case "*":
            return add(multiply(left_rate, right), multiply(left, right_rate))
        case "/":
            return add(divide(left_rate, right), negative(divide(multiply(left, right_rate), Binary("**", right, TWO))))
    exponent = exponent_of(right)
    if exponent is None or exponent == 0:
        return ZERO
    lower = exponent - 1
    power = left if lower == 1 else ONE if lower == 0 else Binary("**", left, _literal(float(lower)))
    return multiply(multiply(_literal(float(exponent)), power), left_rate)


def _literal(value: float) -> Node:
    return Number(value) if value >= 0 else Negative(Number(-value))


def _of_call(node: Call, rates: Mapping[str, Node]) -> Node:
    if node.function in ("min", "max"):
        return _of_choice(node, rates)
    inner_rates = [derivative(one, rates) for one in node.arguments]
    if node.function == "where":
        _, yes, no = inner_rates
        return ZERO if yes == no == ZERO else Call("where", (node.arguments[0], yes, no))
    if node.function == "atan2":
        y, x = node.arguments
        above = add(multiply(inner_rates[0], x), negative(multiply(y, inner_rates[1])))
        return divide(above, Binary("+", Binary("**", x, TWO), Binary("**", y, TWO)))
    if node.function == "hypot":
        terms = [multiply(one, rate) for one, rate in zip(node.arguments, inner_rates, strict=True)]
        return divide(add(*terms), node)
    return _OUTER[node.function](node.arguments[0], node, inner_rates[0])


def _of_choice(node: Call, rates: Mapping[str, Node]) -> Node:
    """Differentiate min and max as the chain of `where` that they are."""
    operator = "<=" if node.function == "min" else ">="
    *rest, last = node.arguments
    result = derivative(last, rates)
    for position in range(len(rest) - 1, -1, -1):
        others = node.arguments[position + 1 :]
        best = others[0] if len(others) == 1 else Call(node.function, others)
        rate = derivative(rest[position], rates)
        if not rate == result == ZERO:
            result = Call("where", (Compare(operator, rest[position], best), rate, result))
    return result


# f(u)' by function, from u, f(u) itself and u'
_OUTER: dict[str, Callable[[Node, Node, Node], Node]] = {
    "abs": lambda u, _, rate: multiply(Call("sign", (u,)), rate),
    "sign": lambda _u, _f, _rate: ZERO,
    "sqrt": lambda _, f, rate: divide(rate, Binary("*", TWO, f)),
    "exp": lambda _, f, rate: multiply(f, rate),
    "log": lambda u, _, rate: divide(rate, u),
    "sin": lambda u, _, rate: multiply(Call("cos", (u,)), rate),
    "cos": lambda u, _, rate: negative(multiply(Call("sin", (u,)), rate)),
    "tan": lambda u, _, rate: divide(rate, Binary("**", Call("cos", (u,)), TWO)),
    "asin": lambda u, _, rate: divide(rate, Call("sqrt", (Binary("-", ONE, Binary("**", u, TWO)),))),
    "acos": lambda u, _, rate: negative(divide(rate, Call("sqrt", (Binary("-", ONE, Binary("**", u, TWO)),)))),
    "atan": lambda u, _, rate: divide(rate, Binary("+", ONE, Binary("**", u, TWO))),
    "sinh": lambda u, _, rate: multiply(Call("cosh", (u,)), rate),
    "cosh": lambda u, _, rate: multiply(Call("sinh", (u,)), rate),
    "tanh": lambda u, _, rate: divide(rate, Binary("**", Call("cosh", (u,)), TWO)),
}
