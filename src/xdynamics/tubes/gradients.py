"""Numbers with their derivatives by the start: intervals of both, and every operation of a program on them.

A number is a box of shape (2, 1 + n): its value, and its derivatives by n numbers of the start. One of shape (2, 1) does not
depend on them. What an operation cannot be sure of is `Undefined`, and so is all that is computed from it, unless a choice
leaves it out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.bounds import BREAKS, SMOOTH, Interval
from xdynamics.elementary.intervals import Intervals
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Operand, StoreTo
from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import HELD, Box, Floats

NOW = Location("at", AT.index("t"))
_INTERVALS = Intervals(FUNCTIONS)


@dataclass(frozen=True)
class Undefined:
    """A number that may have no value, or more than one branch.

    Attributes
    ----------
    reason : str
        What was computed, and of which values.
    """

    reason: str


Value = Any  # a float, which is exact; a truth; a number with derivatives; or Undefined


def as_number(value: Value) -> Box:
    """Return an exact float as a number that depends on nothing."""
    return np.full((2, 1), float(value)) if isinstance(value, float | int) else value


def apply_operation(operation: str, *operands: Value) -> Value:
    """Return the result of an operation."""
    if operation == "choose":
        return _choose_branch(*operands)
    for operand in operands:
        if type(operand) is Undefined:
            return operand
    return OPERATIONS[operation](*operands)


def _choose_branch(truth: Value, yes: Value, no: Value) -> Value:
    return truth if isinstance(truth, Undefined) else yes if truth else no


def seed(value: Box, index: int, derivatives: int) -> Box:
    """Return a number of the start: its derivative by itself is 1."""
    seed = np.zeros((2, 1 + derivatives))
    seed[:, 0] = value
    if derivatives:
        seed[:, 1 + index] = 1.0
    return seed


@dataclass(frozen=True)
class StraightLines:
    """Straight lines of a program, and the constants that they read besides the state.

    Attributes
    ----------
    lines : sequence of Line
    constants : mapping of Place to Value
        What is read and never changes: a float, an interval, or the number of what is uncertain in it.
    literals : mapping of int to Value
        The exact values of the operands that are numbers and no floats, by their identity.
    """

    lines: Sequence[Line]
    constants: Mapping[Location, Value]
    literals: Mapping[int, Value]

    @np.errstate(all="ignore")
    def stored_over(
        self, time: Box, states: Box, step_values: Floats, *, derivatives: bool = False
    ) -> dict[Location, Value]:
        """Return the stored values over a box, perhaps with the derivatives by the numbers of a set."""
        numbers = states.shape[1]
        variables = [seed(states[:, i], i, numbers if derivatives else 0) for i in range(numbers)]
        env, stored = dict[str, Value](), dict[Location, Value]()

        def read_address(address: Location) -> Value:
            if address.array == "y":
                return variables[address.offset]
            if address == NOW:
                return time.reshape(2, 1)
            if address.array == HELD:
                return float(step_values[address.offset])
            value = self.constants[address]
            return variables[value] if isinstance(value, int) else value

        def operand(name: Operand) -> Value:
            return env[name] if isinstance(name, str) else self.literals.get(id(name), name)

        for line in self.lines:
            if isinstance(line, Load):
                env[line.target] = read_address(line.location)
            elif isinstance(line, Compute):
                env[line.target] = apply_operation(line.operation, *map(operand, line.arguments))
            elif isinstance(line, StoreTo):
                stored[line.location] = operand(line.value)
        return stored


# ---------------------------------------------------------------------------------------------------------- arithmetic


def _with_longer_slopes(a: Box, b: Box, values: Box) -> Box:
    """Return a sum by its value where one of two numbers alone has derivatives."""
    longer = a if a.shape[1] > b.shape[1] else b
    return np.concatenate([values, longer[:, 1:]], axis=1)


def add(a: Value, b: Value) -> Value:
    """Add."""
    a, b = as_number(a), as_number(b)
    if a.shape == b.shape:
        return boxes.add(a, b)
    return _with_longer_slopes(a, b, boxes.add(a[:, :1], b[:, :1]))


def negative(a: Value) -> Value:
    """Change the sign."""
    return -a if isinstance(a, float) else boxes.negative(a)


def subtract(a: Value, b: Value) -> Value:
    """Subtract."""
    a, b = as_number(a), as_number(b)
    if a.shape == b.shape:
        return boxes.subtract(a, b)
    return add(a, boxes.negative(b))


def multiply(a: Value, b: Value) -> Value:
    """Multiply."""
    # interval products know of no dependence: of one value with itself they would reach below zero
    if a is b:
        return square(as_number(a))
    if isinstance(a, float):
        return boxes.scaled(as_number(b), a)
    if isinstance(b, float):
        return boxes.scaled(a, b)
    products = boxes.multiply(a, b if b.shape[1] == 1 or a.shape[1] == 1 else b[:, :1])
    if a.shape[1] > 1 and b.shape[1] > 1:
        products[:, 1:] = boxes.add(products[:, 1:], boxes.multiply(a[:, :1], b[:, 1:]))
    return products


def square(a: Box) -> Box:
    """Multiply by itself."""
    value = boxes.square(a[:, :1])
    if a.shape[1] == 1:
        return value
    # doubling is exact, and needs no rounding outward
    return np.concatenate([value, 2.0 * boxes.multiply(a[:, :1], a[:, 1:])], axis=1)


def divide(a: Value, b: Value) -> Value:
    """Divide."""
    if isinstance(b, float) and b != 0.0:
        return boxes.divided_by(as_number(a), b)
    a, b = as_number(a), as_number(b)
    divisor = b[:, :1]
    if boxes.has_zero(divisor):
        return Undefined(f"a divisor may be zero: it lies {_range_words(divisor)}")
    if b.shape[1] == 1:
        return boxes.divide(a, divisor)
    value = boxes.divide(a[:, :1], divisor)
    correction = boxes.multiply(value, b[:, 1:])
    numerator = boxes.subtract(a[:, 1:], correction) if a.shape[1] > 1 else boxes.negative(correction)
    return np.concatenate([value, boxes.divide(numerator, divisor)], axis=1)


# ------------------------------------------------------------------------------------------------- elementary functions


def _valued(name: str, *operands: Value) -> Value:
    """Return the value of a function alone."""
    intervals = [Interval(float(a[0, 0]), float(a[1, 0])) for a in map(as_number, operands)]
    bounds = _INTERVALS.of(name, *intervals)
    if bounds.flaw != SMOOTH:
        fault = "jumps" if bounds.flaw == BREAKS else "is not defined, or not finite,"
        return Undefined(f"{name} {fault} for some of the values {_ranges_words(operands)}")
    return np.array([[bounds.low], [bounds.high]])


def _with_chain_rule(value: Value, *parts: tuple[Value, Callable[[], Value]]) -> Value:
    """Join a value with the derivatives of its arguments, each times the derivative by that argument."""
    if isinstance(value, Undefined):
        return value
    slopes = None
    for argument, slope_rule in parts:
        if isinstance(argument, float) or argument.shape[1] == 1:
            continue
        factor = slope_rule()
        if isinstance(factor, Undefined):
            return factor
        term = boxes.multiply(as_number(factor), argument[:, 1:])
        slopes = term if slopes is None else boxes.add(slopes, term)
    return value if slopes is None else np.concatenate([value, slopes], axis=1)


def _value_part(a: Value) -> Box:
    return as_number(a)[:, :1]


def _by_value(name: str, derivative: Callable[[Box, Box], Value]) -> Callable[..., Value]:
    """Return a function of one number from its derivative, which takes the argument and the value."""

    def function(a: Value) -> Value:
        value = _valued(name, a)
        return _with_chain_rule(value, (a, lambda: derivative(_value_part(a), value)))

    return function


def _one_and(sign: float, a: Box) -> Box:
    return boxes.add(as_number(1.0), boxes.scaled(boxes.square(a), sign))


def _arc_slope(sign: float) -> Callable[[Box, Box], Value]:
    def derivative(a: Box, _: Box) -> Value:
        # (1 - a)*(1 + a) has the digits that 1 - a**2 loses near 1
        product = boxes.multiply(boxes.subtract(as_number(1.0), a), boxes.add(as_number(1.0), a))
        return apply_operation("divide", sign, _valued("sqrt", product))

    return derivative


def _power_with_slopes(a: Value, exponent: Value) -> Value:
    value = _valued("power", a, exponent)
    return _with_chain_rule(
        value, (a, lambda: apply_operation("divide", multiply(as_number(exponent), value), _value_part(a)))
    )


def _hypot_with_slopes(a: Value, b: Value) -> Value:
    value = _valued("hypot", a, b)
    return _with_chain_rule(
        value,
        (a, lambda: apply_operation("divide", _value_part(a), value)),
        (b, lambda: apply_operation("divide", _value_part(b), value)),
    )


def _atan2_with_slopes(y: Value, x: Value) -> Value:
    value = _valued("atan2", y, x)
    squares = boxes.add(boxes.square(_value_part(y)), boxes.square(_value_part(x)))
    return _with_chain_rule(
        value,
        (y, lambda: apply_operation("divide", _value_part(x), squares)),
        (x, lambda: apply_operation("divide", boxes.negative(_value_part(y)), squares)),
    )


# ----------------------------------------------------------------------------------- comparisons, corners and jumps


def _comparison_rule(name: str) -> Callable[..., Value]:
    def function(a: Value, b: Value) -> Value:
        if isinstance(a, float) and isinstance(b, float):
            a, b = as_number(a), as_number(b)
        low, high, _ = _INTERVALS.of(name, *(Interval(*map(float, as_number(x)[:, 0])) for x in (a, b)))
        if low == high:
            return bool(low)
        return Undefined(f"a comparison is not decided for values {_ranges_words((a, b))}")

    return function


def _abs_with_slopes(a: Value) -> Value:
    a = as_number(a)
    if not boxes.has_zero(a[:, :1]):
        return boxes.negative(a) if a[1, 0] < 0.0 else a
    if a.shape[1] == 1:
        return _valued("abs", a)
    return Undefined(f"abs has a corner among the values {_ranges_words((a,))}")


def _extreme_rule(name: str) -> Callable[..., Value]:
    def function(a: Value, b: Value) -> Value:
        a, b = as_number(a), as_number(b)
        for first, second in ((a, b), (b, a)):
            if (first[1, 0] < second[0, 0]) if name == "least" else (first[0, 0] > second[1, 0]):
                return first
        if a.shape[1] == b.shape[1] == 1:
            return _valued(name, a, b)
        return Undefined(f"{'min' if name == 'least' else 'max'} is not decided for values {_ranges_words((a, b))}")

    return function


def _step_function_rule(name: str) -> Callable[..., Value]:
    return lambda a: _valued(name, a)


def _mod(a: Value, b: Value) -> Value:
    turns = apply_operation("floor", apply_operation("divide", _value_part(a), _value_part(b)))
    return apply_operation("subtract", a, apply_operation("multiply", turns, b))


def _positive_value(a: Value) -> Value:
    a = as_number(a)
    return a if a[0, 0] > 0.0 else Undefined(f"what must be positive lies {_range_words(a)}")


def _range_words(a: Box) -> str:
    return f"between {a[0, 0]:.4g} and {a[1, 0]:.4g}"


def _ranges_words(operands: tuple[Value, ...]) -> str:
    return " and ".join(_range_words(as_number(a)) for a in operands)


OPERATIONS: Mapping[str, Callable[..., Value]] = {
    "add": add,
    "subtract": subtract,
    "multiply": multiply,
    "divide": divide,
    "negative": negative,
    "sqrt": _by_value("sqrt", lambda _, s: apply_operation("divide", 0.5, s)),
    "exp": _by_value("exp", lambda _, e: e),
    "log": _by_value("log", lambda a, _: apply_operation("divide", 1.0, a)),
    "sin": _by_value("sin", lambda a, _: _valued("cos", a)),
    "cos": _by_value("cos", lambda a, _: apply_operation("negative", _valued("sin", a))),
    "tan": _by_value("tan", lambda _, t: _one_and(1.0, t)),
    "asin": _by_value("asin", _arc_slope(1.0)),
    "acos": _by_value("acos", _arc_slope(-1.0)),
    "atan": _by_value("atan", lambda a, _: apply_operation("divide", 1.0, _one_and(1.0, a))),
    "sinh": _by_value("sinh", lambda a, _: _valued("cosh", a)),
    "cosh": _by_value("cosh", lambda a, _: _valued("sinh", a)),
    "tanh": _by_value("tanh", lambda _, t: _one_and(-1.0, t)),
    "power": _power_with_slopes,
    "hypot": _hypot_with_slopes,
    "atan2": _atan2_with_slopes,
    "abs": _abs_with_slopes,
    "least": _extreme_rule("least"),
    "greatest": _extreme_rule("greatest"),
    "mod": _mod,
    "positive": _positive_value,
    **{name: _step_function_rule(name) for name in ("sign", "floor", "ceil", "round")},
    **{name: _comparison_rule(name) for name in ("less", "at_most", "more", "at_least", "equal", "unequal")},
}
