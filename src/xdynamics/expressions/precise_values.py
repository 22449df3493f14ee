"""Values of expressions with 31 digits: beside them a float shows what rounding did to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.double_double import FUNCTIONS, nearest
from xdynamics.elementary.double_double.functions import CALLED, RULES
from xdynamics.elementary.double_double.functions import PI as PI_OF_SUMS
from xdynamics.elementary.double_double.sums import DoubleDouble
from xdynamics.expressions.evaluation import Arithmetic, evaluate_with
from xdynamics.expressions.tree import Node

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PreciseArray:
    """An array of unevaluated sums of two floats, for which operators are written as for floats.

    Attributes
    ----------
    high, low : ndarray
        The nearest floats, and the rests.
    """

    high: Floats
    low: Floats
    __array_ufunc__ = None  # an array on the left leaves its operators to this class

    @classmethod
    def from_value(cls, value: Any) -> PreciseArray:
        """Return a number, or an array, as it is."""
        if isinstance(value, cls):
            return value
        if isinstance(value, Fraction):
            return cls(*(np.array([part]) for part in nearest(value)))
        floats = np.atleast_1d(np.asarray(value, float))
        return cls(floats, np.zeros_like(floats))

    def of_parts(self, rule: Callable[[Floats], Floats]) -> PreciseArray:
        """Return the result of a rule that only moves elements, applied to both parts."""
        return PreciseArray(rule(self.high), rule(self.low))

    def __neg__(self) -> PreciseArray:
        return _apply_rule(RULES["negative"], self)

    def __add__(self, addend: Any) -> PreciseArray:
        return _apply_rule(CALLED["add"], self, addend)

    def __mul__(self, factor: Any) -> PreciseArray:
        return _apply_rule(CALLED["multiply"], self, factor)

    def __rmul__(self, factor: Any) -> PreciseArray:
        return _apply_rule(CALLED["multiply"], factor, self)


def _apply_rule(rule: Callable[..., Any], *values: Any) -> PreciseArray:
    """Return the result of a rule of double-double arithmetic."""
    double_doubles = rule(*(DoubleDouble(part.high, part.low) for part in map(PreciseArray.from_value, values)))
    return PreciseArray(*(np.atleast_1d(np.asarray(part, float)) for part in np.broadcast_arrays(*double_doubles)))


def _named_rule(name: str) -> Callable[..., PreciseArray]:
    return lambda *values: _apply_rule(FUNCTIONS.get(name) or RULES[name], *values)


def _comparison_of_sums(name: str) -> Callable[..., Any]:
    return lambda *values: RULES[name](
        *(DoubleDouble(part.high, part.low) for part in map(PreciseArray.from_value, values))
    )


PI = PreciseArray.from_value(0.0) + PreciseArray(*(np.array([part]) for part in PI_OF_SUMS))
SUMS = Arithmetic(
    {
        "+": _named_rule("add"),
        "-": _named_rule("subtract"),
        "*": _named_rule("multiply"),
        "/": _named_rule("divide"),
        "<": _comparison_of_sums("less"),
        "<=": _comparison_of_sums("at_most"),
        ">": _comparison_of_sums("more"),
        ">=": _comparison_of_sums("at_least"),
        "==": _comparison_of_sums("equal"),
        "!=": _comparison_of_sums("unequal"),
    },
    {"min": _named_rule("least"), "max": _named_rule("greatest")},
    {
        name: _named_rule(name)
        for name in (*FUNCTIONS, "abs", "sign", "sqrt", "positive", "floor", "ceil", "round", "mod")
    },
    lambda truth, yes, no: _apply_rule(
        lambda chosen_sum, rejected_sum: RULES["choose"](truth, chosen_sum, rejected_sum), yes(), no()
    ),
)


def evaluate_precisely(node: Node, values: Mapping[str, Any]) -> PreciseArray:
    """Return the values of an expression with 31 digits, from floats, or sums of two, by name.

    Raises
    ------
    InputError
        If a name has no value.

    Examples
    --------
    >>> from xdynamics.expressions import parse
    >>> found = evaluate_precisely(parse("sin(pi)"), {"pi": 3.141592653589793})
    >>> float(found.high[0]), float(evaluate_precisely(parse("sin(pi)"), {"pi": PI}).high[0]) < 1e-32
    (1.2246467991473532e-16, True)
    """
    with np.errstate(all="ignore"):
        return PreciseArray.from_value(evaluate_with(node, values, SUMS))
