"""Values of expressions with 31 digits: beside them a float shows what rounding did to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.double_double import FUNCTIONS, nearest
from xdynamics.elementary.double_double.constants import PI as PI_OF_SUMS
from xdynamics.elementary.double_double.operations import CALLED, RULES
from xdynamics.elementary.double_double.sums import DoubleDouble
from xdynamics.expressions.evaluation import Arithmetic, walked
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
    def of(cls, value: Any) -> PreciseArray:
        """Return a number, or an array, as it is."""
        if isinstance(value, cls):
            return value
        if isinstance(value, Fraction):
            return cls(*(np.array([part]) for part in nearest(value)))
        floats = np.atleast_1d(np.asarray(value, float))
        return cls(floats, np.zeros_like(floats))

    def of_parts(self, rule: Callable[[Floats], Floats]) -> PreciseArray:
        """Return what a rule that only moves elements makes of both parts."""
        return PreciseArray(rule(self.high), rule(self.low))

    def __neg__(self) -> PreciseArray:
        return _called(RULES["negative"], self)

    def __add__(self, other: Any) -> PreciseArray:
        return _called(CALLED["add"], self, other)

    def __mul__(self, other: Any) -> PreciseArray:
        return _called(CALLED["multiply"], self, other)

    def __rmul__(self, other: Any) -> PreciseArray:
        return _called(CALLED["multiply"], other, self)


def _called(rule: Callable[..., Any], *values: Any) -> PreciseArray:
    """Return what a rule of double-double arithmetic makes of values."""
    found = rule(*(DoubleDouble(part.high, part.low) for part in map(PreciseArray.of, values)))
    return PreciseArray(*(np.atleast_1d(np.asarray(part, float)) for part in np.broadcast_arrays(*found)))


def _by(name: str) -> Callable[..., PreciseArray]:
    return lambda *values: _called(FUNCTIONS.get(name) or RULES[name], *values)


def _compared(name: str) -> Callable[..., Any]:
    return lambda *values: RULES[name](*(DoubleDouble(part.high, part.low) for part in map(PreciseArray.of, values)))


PI = PreciseArray.of(0.0) + PreciseArray(*(np.array([part]) for part in PI_OF_SUMS))
SUMS = Arithmetic(
    {
        "+": _by("add"),
        "-": _by("subtract"),
        "*": _by("multiply"),
        "/": _by("divide"),
        "<": _compared("less"),
        "<=": _compared("at_most"),
        ">": _compared("more"),
        ">=": _compared("at_least"),
        "==": _compared("equal"),
        "!=": _compared("unequal"),
    },
    {"min": _by("least"), "max": _by("greatest")},
    {name: _by(name) for name in (*FUNCTIONS, "abs", "sign", "sqrt", "positive", "floor", "ceil", "round", "mod")},
    lambda truth, yes, no: _called(lambda one, other: RULES["choose"](truth, one, other), yes(), no()),
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
        return PreciseArray.of(walked(node, values, SUMS))
