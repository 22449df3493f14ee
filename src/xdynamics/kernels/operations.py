"""The operations of the laws: each is one function of numbers, and how it is written in Python.

All are operations of IEEE 754 or functions of `elementary`, and the same everywhere: for floats, for arrays and for
numbers that stand for lines of LLVM text.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import SETS
from xdynamics.elementary.double_double.operations import DoubleDoubles
from xdynamics.elementary.fma import fma
from xdynamics.elementary.numbers import (
    absolute,
    binary_power,
    ceiling,
    choose,
    exponent,
    floor,
    maximum_of_two,
    minimum_of_two,
    modulo,
    positive_or_nan,
    round_half_even,
    sign,
    significand,
    sqrt,
)
from xdynamics.expressions import CALLED_ALONE
from xdynamics.expressions.evaluation import NUMERIC

# operation: sign in Python and how strongly it binds
INFIX = {"add": (" + ", 1), "subtract": (" - ", 1), "multiply": ("*", 2), "divide": ("/", 2)}
COMPARISONS = {"less": " < ", "at_most": " <= ", "more": " > ", "at_least": " >= ", "equal": " == ", "unequal": " != "}
RULES: Mapping[str, Callable[..., Any]] = {
    "add": operator.add,
    "subtract": operator.sub,
    "multiply": operator.mul,
    "divide": operator.truediv,
    "less": operator.lt,
    "at_most": operator.le,
    "more": operator.gt,
    "at_least": operator.ge,
    "equal": operator.eq,
    "unequal": operator.ne,
    "negative": operator.neg,
    "abs": absolute,
    "sqrt": sqrt,
    "choose": choose,
    "sign": sign,
    "least": minimum_of_two,
    "greatest": maximum_of_two,
    "positive": positive_or_nan,
    "floor": floor,
    "ceil": ceiling,
    "round": round_half_even,
    "mod": modulo,
    "fma": fma,
    "significand": significand,
    "exponent": exponent,
    "binary_power": binary_power,
    "newest": lambda _, new: new,
}


def unsound(numbers: NDArray[np.float64]) -> float:
    """Return 0 if all numbers are finite, else nan."""
    return 0.0 if np.isfinite(numbers).all() else math.nan


def _as_numpy_float(function: Callable[..., float]) -> Callable[..., float]:
    """Make a function return NumPy floats, which divide by zero as IEEE 754 requires, unlike Python's."""

    @wraps(function)
    def wrapped(*arguments: float) -> Any:
        return np.float64(function(*(float(argument) for argument in arguments)))

    return wrapped


# by their names in printed Python, where a model's own names cannot collide with those that have an underscore
_PRIVATE = ("positive", "power", *CALLED_ALONE)
PYTHON: dict[str, Any] = {
    **{f"_{name}" if name in _PRIVATE else name: _as_numpy_float(function) for name, function in NUMERIC.items()},
    "_least": _as_numpy_float(minimum_of_two),
    "_greatest": _as_numpy_float(maximum_of_two),
    "_fma": _as_numpy_float(fma),
    "_ordinal": np.float64,
    "_unsound": unsound,
}


def python_of_set(math_functions: str) -> dict[str, Any]:
    """Return what printed Python calls, with the elementary functions of a set."""
    functions = {
        f"_{name}" if name == "power" else name: _as_numpy_float(function)
        for name, function in SETS[math_functions].items()
    }
    return PYTHON | functions | {"_double_double": DoubleDoubles()}
