"""The number of a tree at given values, by the operations that compiled code does."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import reduce

from xdynamics.elementary import FUNCTIONS
from xdynamics.expressions.tree import Binary, Call, Compare, Name, Negative, Node, Number, chain, exponent_of
from xdynamics.faults import InputError


def evaluate(node: Node, values: Mapping[str, float]) -> float:
    """Return the number of an expression.

    Parameters
    ----------
    node : Node
        An expression without definitions left in it.
    values : mapping of str to float
        A number for every name, `pi` and unit constants among them, in one system of units.

    Returns
    -------
    float
        What compiled code gives: ``1/0`` is inf, ``sqrt(-1)`` is nan; arithmetic raises nothing.

    Raises
    ------
    InputError
        If a name has no value.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> evaluate(parse("where(x > 1, x**-1.5, 1/0)"), {"x": 4.0})
    0.125
    """
    match node:
        case Number():
            return node.value
        case Name():
            if node.name not in values:
                raise InputError(f"name '{node.name}' has no value; there are {', '.join(values) or 'none'}")
            return values[node.name]
        case Negative():
            return -evaluate(node.operand, values)
        case Binary():
            first, links = chain(node)
            return reduce(lambda left, one: _joined(one, left, values), links, evaluate(first, values))
        case Compare():
            return _OPERATORS[node.operator](evaluate(node.left, values), evaluate(node.right, values))
        case Call(function="where"):
            condition, yes, no = node.arguments
            return evaluate(yes if evaluate(condition, values) else no, values)
        case Call(function="min" | "max"):
            return reduce(_CHOICES[node.function], (evaluate(one, values) for one in node.arguments))
        case Call():
            return NUMERIC[node.function](*(evaluate(one, values) for one in node.arguments))


def _joined(node: Binary, left: float, values: Mapping[str, float]) -> float:
    if node.operator == "**":
        return power(left, exponent_of(node.right) or Fraction(0))
    return _OPERATORS[node.operator](left, evaluate(node.right, values))


def power(base: float, exponent: Fraction) -> float:
    """Raise to a constant power as the language does: by products and square roots where these are enough."""
    if exponent == 0:
        return 1.0
    if exponent < 0:
        return _quotient(1.0, power(base, -exponent))
    whole, rest = divmod(exponent, 1)
    if rest == 0:
        return _product(base, whole)
    if rest == Fraction(1, 2):
        root = NUMERIC["sqrt"](base)
        return _product(base, whole) * root if whole else root
    return NUMERIC["power"](base, exponent)


def _product(base: float, times: int) -> float:
    if times <= 3:
        return math.prod([base] * times)
    half = _product(base, times // 2)
    return half * half * base if times % 2 else half * half


def _quotient(above: float, below: float) -> float:
    if below != 0.0:
        return above / below
    return math.copysign(1.0, below) * above * math.inf


def _of_floats(function: Callable[..., float]) -> Callable[..., float]:
    return lambda *given: function(*map(float, given))


_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": lambda x, y: x + y, "-": lambda x, y: x - y, "*": lambda x, y: x * y, "/": _quotient,
    "<": lambda x, y: x < y, "<=": lambda x, y: x <= y, ">": lambda x, y: x > y, ">=": lambda x, y: x >= y,
    "==": lambda x, y: x == y, "!=": lambda x, y: x != y,
}  # fmt: skip
# like compiled code, a nan on the left wins and one on the right does too: no comparison with it holds
_CHOICES: dict[str, Callable[[float, float], float]] = {
    "min": lambda x, y: x if x < y or math.isnan(x) else y,
    "max": lambda x, y: x if x > y or math.isnan(x) else y,
}
NUMERIC: dict[str, Callable[..., float]] = {
    "abs": abs, "sign": lambda x: 1.0 if x > 0.0 else (-1.0 if x < 0.0 else x),
    "sqrt": lambda x: math.sqrt(x) if x >= 0.0 else math.nan, "positive": lambda x: x if x > 0.0 else math.nan,
    **{name: _of_floats(one) for name, one in FUNCTIONS.items()},
}  # fmt: skip
