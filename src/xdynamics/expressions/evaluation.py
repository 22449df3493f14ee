"""The value of a tree at one or many states, by the same operations as compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from typing import Any

import numpy as np

from xdynamics.elementary import FUNCTIONS, NAME
from xdynamics.elementary.arrays import applied
from xdynamics.elementary.numbers import ceiling, floor, greatest, least, modulo, nearest, positive, sign
from xdynamics.expressions.tree import Binary, Call, Compare, Name, Negative, Node, Number, chain, exponent_of, shown
from xdynamics.faults import InputError


def evaluate(node: Node, values: Mapping[str, float]) -> float:
    """Return the value of an expression.

    Parameters
    ----------
    node : Node
        An expression with definitions expanded.
    values : mapping of str to float
        A number for every name, including `pi` and unit constants, in one system of units.

    Returns
    -------
    float
        As in compiled code: ``1/0`` is inf, ``sqrt(-1)`` is nan; arithmetic raises nothing.

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
    value: float = walked(node, values, FLOATS)
    return value


def evaluate_many(node: Node, values: Mapping[str, Any], math_functions: str = NAME) -> Any:
    """Return the values of an expression for arrays of one shape, or numbers, by name.

    The elementary functions are those of the set `math_functions`.

    Raises
    ------
    InputError
        If a name has no value.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> evaluate_many(parse("where(x > 1, x**-1.5, 1/0)"), {"x": np.array([4.0, 1.0])}).tolist()
    [0.125, inf]
    """
    with np.errstate(all="ignore"):  # 1/0 is inf, as in compiled code
        return walked(node, values, _of_arrays(math_functions))


@dataclass(frozen=True)
class Arithmetic:
    """The operators and functions for numbers of one kind."""

    operators: Mapping[str, Callable[..., Any]]
    choices: Mapping[str, Callable[..., Any]]
    functions: Mapping[str, Callable[..., Any]]
    where: Callable[..., Any]


def walked(node: Node, values: Mapping[str, Any], by: Arithmetic) -> Any:
    """Return the value of a tree by the operators and functions of one kind of numbers.

    Raises
    ------
    InputError
        If a name has no value, or a value is known along a march alone.
    """
    match node:
        case Number():
            return node.value
        case Name():
            if node.name not in values:
                raise InputError(f"name '{node.name}' has no value; there are {', '.join(values) or 'none'}")
            return values[node.name]
        case Negative():
            return -walked(node.operand, values, by)
        case Binary():
            first, links = chain(node)
            return reduce(lambda left, part: _joined(part, left, values, by), links, walked(first, values, by))
        case Compare():
            return by.operators[node.operator](walked(node.left, values, by), walked(node.right, values, by))
        case Call(function="where"):
            condition, yes, no = node.arguments
            ways = (lambda: walked(yes, values, by), lambda: walked(no, values, by))
            return by.where(walked(condition, values, by), *ways)
        case Call(function="min" | "max"):
            return reduce(by.choices[node.function], (walked(part, values, by) for part in node.arguments))
        case Call(function="delayed"):
            raise InputError(f"'{shown(node)}' is known along a march alone; record it as an observable, and read that")
        case Call():
            return by.functions[node.function](*(walked(part, values, by) for part in node.arguments))


def _joined(node: Binary, left: Any, values: Mapping[str, Any], by: Arithmetic) -> Any:
    if node.operator == "**":
        return power(left, exponent_of(node.right) or Fraction(0), by)
    return by.operators[node.operator](left, walked(node.right, values, by))


def power(base: Any, exponent: Fraction, by: Arithmetic) -> Any:
    """Raise to a constant power as the language does: by products and square roots where these suffice."""
    if exponent == 0:
        return 1.0
    if exponent < 0:
        return by.operators["/"](1.0, power(base, -exponent, by))
    if exponent.denominator == 1:
        return _product(base, exponent.numerator)
    integer, fraction = divmod(exponent, 1)
    if fraction == Fraction(1, 2):
        root = by.functions["sqrt"](base)
        return _product(base, integer) * root if integer else root
    return by.functions["power"](base, exponent)


def _product(base: Any, times: int) -> Any:
    if times <= 3:
        return math.prod([base] * times)
    half = _product(base, times // 2)
    return half * half * base if times % 2 else half * half


def _quotient(numerator: float, denominator: float) -> float:
    if denominator != 0.0:
        return numerator / denominator
    return math.copysign(1.0, denominator) * numerator * math.inf


def _of_floats(function: Callable[..., float]) -> Callable[..., float]:
    return lambda *arguments: function(*map(float, arguments))


_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": _quotient,
    "<": lambda x, y: x < y,
    "<=": lambda x, y: x <= y,
    ">": lambda x, y: x > y,
    ">=": lambda x, y: x >= y,
    "==": lambda x, y: x == y,
    "!=": lambda x, y: x != y,
}
NUMERIC: dict[str, Callable[..., float]] = {
    "abs": abs,
    "sign": sign,
    "sqrt": lambda x: math.sqrt(x) if x >= 0.0 else math.nan,
    "positive": positive,
    "floor": _of_floats(floor),
    "ceil": _of_floats(ceiling),
    "round": _of_floats(nearest),
    "mod": _of_floats(modulo),
    **{name: _of_floats(function) for name, function in FUNCTIONS.items()},
}
FLOATS = Arithmetic(
    _OPERATORS, {"min": least, "max": greatest}, NUMERIC, lambda truth, yes, no: yes() if truth else no()
)


@lru_cache
def _of_arrays(math_functions: str) -> Arithmetic:
    """Return the arithmetic of arrays, with a set of elementary functions."""
    return Arithmetic(
        _OPERATORS | {"/": np.divide},
        {
            "min": lambda x, y: np.where((x < y) | np.isnan(x), x, y),
            "max": lambda x, y: np.where((x > y) | np.isnan(x), x, y),
        },
        {
            "abs": np.abs,
            "sign": lambda x: np.where(x > 0.0, 1.0, np.where(x < 0.0, -1.0, x)),
            "sqrt": np.sqrt,
            "positive": lambda x: np.where(x > 0.0, x, np.nan),
            "floor": np.floor,
            "ceil": np.ceil,
            "round": np.rint,
            "mod": lambda *values: modulo(*(np.asarray(value, float)[()] for value in values)),
            **{name: partial(applied, name, math_functions=math_functions) for name in FUNCTIONS},
        },
        lambda truth, yes, no: np.where(truth, yes(), no()),
    )
