"""The value of a tree at one or many states, by the same operations as compiled code.

A tape is the list of operations of several expressions in the order of evaluation, with common subexpressions computed
once. It serves long expressions that are evaluated many times without being compiled: derivatives of forces by many
coordinates share most of their parts. Every value has the bits that `evaluate` gives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, reduce
from typing import Any

import numpy as np

from xdynamics.elementary import FUNCTIONS, NAME
from xdynamics.elementary.arrays import apply_elementary
from xdynamics.elementary.numbers import (
    ceiling,
    floor,
    maximum_of_two,
    minimum_of_two,
    modulo,
    positive_or_nan,
    round_half_even,
    sign,
)
from xdynamics.expressions.tree import (
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    chain,
    exponent_of,
    shortened_text,
)
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
    value: float = evaluate_with(node, values, FLOATS)
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
        return evaluate_with(node, values, _array_arithmetic(math_functions))


@dataclass(frozen=True)
class Arithmetic:
    """The operators and functions for numbers of one kind."""

    operators: Mapping[str, Callable[..., Any]]
    choices: Mapping[str, Callable[..., Any]]
    functions: Mapping[str, Callable[..., Any]]
    where: Callable[..., Any]


def evaluate_with(node: Node, values: Mapping[str, Any], arithmetic: Arithmetic) -> Any:
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
            return -evaluate_with(node.operand, values, arithmetic)
        case Binary():
            first, links = chain(node)
            return reduce(
                lambda left, part: _apply_link(part, left, values, arithmetic),
                links,
                evaluate_with(first, values, arithmetic),
            )
        case Compare():
            return arithmetic.operators[node.operator](
                evaluate_with(node.left, values, arithmetic), evaluate_with(node.right, values, arithmetic)
            )
        case Call(function="where"):
            condition, yes, no = node.arguments
            branches = (lambda: evaluate_with(yes, values, arithmetic), lambda: evaluate_with(no, values, arithmetic))
            return arithmetic.where(evaluate_with(condition, values, arithmetic), *branches)
        case Call(function="min" | "max"):
            return reduce(
                arithmetic.choices[node.function], (evaluate_with(part, values, arithmetic) for part in node.arguments)
            )
        case Call(function="delayed"):
            raise InputError(
                f"'{shortened_text(node)}' is known along a run alone; record it as an observable, and read that"
            )
        case Call():
            return arithmetic.functions[node.function](
                *(evaluate_with(part, values, arithmetic) for part in node.arguments)
            )


def _apply_link(node: Binary, left: Any, values: Mapping[str, Any], arithmetic: Arithmetic) -> Any:
    if node.operator == "**":
        return rational_power(left, exponent_of(node.right) or Fraction(0), arithmetic)
    return arithmetic.operators[node.operator](left, evaluate_with(node.right, values, arithmetic))


def rational_power(base: Any, exponent: Fraction, arithmetic: Arithmetic) -> Any:
    """Raise to a constant power as the language does: by products and square roots where these suffice."""
    if exponent == 0:
        return 1.0
    if exponent < 0:
        return arithmetic.operators["/"](1.0, rational_power(base, -exponent, arithmetic))
    if exponent.denominator == 1:
        return _repeated_product(base, exponent.numerator)
    integer, fraction = divmod(exponent, 1)
    if fraction == Fraction(1, 2):
        root = arithmetic.functions["sqrt"](base)
        return _repeated_product(base, integer) * root if integer else root
    return arithmetic.functions["power"](base, exponent)


def _repeated_product(base: Any, times: int) -> Any:
    if times <= 3:
        return math.prod([base] * times)
    half = _repeated_product(base, times // 2)
    return half * half * base if times % 2 else half * half


def _ieee_quotient(numerator: float, denominator: float) -> float:
    if denominator != 0.0:
        return numerator / denominator
    # 0*inf is nan, as 0/0 is
    return math.copysign(1.0, denominator) * numerator * math.inf


def _with_float_arguments(function: Callable[..., float]) -> Callable[..., float]:
    return lambda *arguments: function(*map(float, arguments))


_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": lambda x, y: x + y,
    "-": lambda x, y: x - y,
    "*": lambda x, y: x * y,
    "/": _ieee_quotient,
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
    "positive": positive_or_nan,
    "floor": _with_float_arguments(floor),
    "ceil": _with_float_arguments(ceiling),
    "round": _with_float_arguments(round_half_even),
    "mod": _with_float_arguments(modulo),
    **{name: _with_float_arguments(function) for name, function in FUNCTIONS.items()},
}
FLOATS = Arithmetic(
    _OPERATORS, {"min": minimum_of_two, "max": maximum_of_two}, NUMERIC, lambda truth, yes, no: yes() if truth else no()
)


@lru_cache
def _array_arithmetic(math_functions: str) -> Arithmetic:
    """Return the arithmetic of arrays, with a set of elementary functions."""
    return Arithmetic(
        _OPERATORS | {"/": np.divide},
        {
            # nan if either is: a nan in y fails the comparison and is chosen
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
            # [()] makes a float of an array without dimensions, as functions of any kind of number expect
            "mod": lambda *values: modulo(*(np.asarray(value, float)[()] for value in values)),
            **{name: partial(apply_elementary, name, math_functions=math_functions) for name in FUNCTIONS},
        },
        lambda truth, yes, no: np.where(truth, yes(), no()),
    )


Operation = Callable[..., Any]


class Tape:
    """The operations of some expressions, each of which may use the names of those before it.

    Parameters
    ----------
    expressions : iterable of (str, Node)
        Names and what they stand for, with definitions expanded.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> tape = Tape([("r", parse("sqrt(x**2 + y**2)")), ("f", parse("x/r**3"))])
    >>> tape.evaluate_tape({"x": 3.0, "y": 4.0})
    {'r': 5.0, 'f': 0.024}
    """

    def __init__(self, expressions: Iterable[tuple[str, Node]]) -> None:
        self._inputs: dict[str, int] = {}  # names that need a value, and their places
        self._numbers: dict[int, float] = {}
        self._steps: list[tuple[Operation, int, tuple[int, ...]]] = []
        self._size = 0
        self._known: dict[Any, int] = {}  # places of equal operations
        self._seen: dict[int, tuple[int, Node]] = {}  # places of nodes, which live as long as this
        self._named: dict[str, int] = {}
        for name, tree in expressions:
            slot = self._slot_of(tree)
            if name in self._inputs or name in self._named:
                self._seen.clear()  # from here on the name means something else
            self._named[name] = slot
        self._seen.clear()
        self._known.clear()

    def evaluate_tape(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the value of each expression by its name.

        Raises
        ------
        InputError
            If a name has no value.
        """
        if missing := [name for name in self._inputs if name not in values]:
            raise InputError(f"name '{missing[0]}' has no value; there are {', '.join(values) or 'none'}")
        results: list[Any] = [0.0] * self._size
        for slot, number in self._numbers.items():
            results[slot] = number
        for name, slot in self._inputs.items():
            results[slot] = values[name]
        for operation, slot, operands in self._steps:
            results[slot] = operation(*[results[operand] for operand in operands])
        return {name: results[slot] for name, slot in self._named.items()}

    def _slot_of(self, node: Node) -> int:
        """Return the slot of a node's value, after adding the operations that compute it."""
        links = []
        while isinstance(node, Binary) and id(node) not in self._seen:  # a sum may have any length
            links.append(node)
            node = node.left
        slot = self._seen[id(node)][0] if id(node) in self._seen else self._leaf_slot(node)
        for link in reversed(links):
            slot = self._link_slot(link, slot)
            self._seen[id(link)] = slot, link
        return slot

    def _leaf_slot(self, node: Node) -> int:
        """Return the slot of the value of a node that is not binary."""
        slot = self._computed_slot(node)
        self._seen[id(node)] = slot, node
        return slot

    def _computed_slot(self, node: Node) -> int:
        match node:
            case Number():
                return self._number_slot(node.value)
            case Name():
                return self._named[node.name] if node.name in self._named else self._name_slot(node.name)
            case Negative():
                return self._operation_slot("negative", _negative, self._slot_of(node.operand))
            case Compare():
                operation = FLOATS.operators[node.operator]
                return self._operation_slot(
                    node.operator, operation, self._slot_of(node.left), self._slot_of(node.right)
                )
            case Call(function="where"):
                return self._operation_slot("where", _choose_branch, *map(self._slot_of, node.arguments))
            case Call(function="min" | "max"):
                first, *further_slots = map(self._slot_of, node.arguments)
                for next_slot in further_slots:
                    first = self._operation_slot(node.function, FLOATS.choices[node.function], first, next_slot)
                return first
            case Call():
                return self._operation_slot(
                    node.function, FLOATS.functions[node.function], *map(self._slot_of, node.arguments)
                )
        raise InputError(f"'{node}' is no expression")

    def _link_slot(self, node: Binary, left: int) -> int:
        if node.operator == "**":
            exponent = exponent_of(node.right) or Fraction(0)
            return self._operation_slot(exponent, _raised(exponent), left)
        return self._operation_slot(node.operator, FLOATS.operators[node.operator], left, self._slot_of(node.right))

    def _operation_slot(self, key: object, operation: Operation, *operands: int) -> int:
        signature = (key, *operands)
        if signature not in self._known:
            self._known[signature] = self._new_slot()
            self._steps.append((operation, self._known[signature], operands))
        return self._known[signature]

    def _number_slot(self, value: float) -> int:
        key = ("number", repr(value))  # 0.0 and -0.0 are equal
        if key not in self._known:
            self._known[key] = self._new_slot()
            self._numbers[self._known[key]] = value
        return self._known[key]

    def _name_slot(self, name: str) -> int:
        if name not in self._inputs:
            self._inputs[name] = self._new_slot()
        return self._inputs[name]

    def _new_slot(self) -> int:
        self._size += 1
        return self._size - 1


def _negative(value: float) -> float:
    return -value


def _choose_branch(truth: bool, yes: float, no: float) -> float:  # noqa: FBT001 - an operand like the others
    return yes if truth else no


@lru_cache(maxsize=256)
def _raised(exponent: Fraction) -> Operation:
    """Return the operation of a power; for the exponents of nearly all forces it avoids arithmetic of fractions."""
    if exponent < 0:
        above, quotient = _raised(-exponent), FLOATS.operators["/"]
        return lambda base: quotient(1.0, above(base))
    if exponent == 2:
        return lambda base: base * base
    if exponent == 3:
        return lambda base: base * base * base
    if exponent == Fraction(3, 2):
        root = FLOATS.functions["sqrt"]
        return lambda base: base * root(base)
    if exponent == Fraction(1, 2):
        return FLOATS.functions["sqrt"]
    return lambda base: rational_power(base, exponent, FLOATS)
