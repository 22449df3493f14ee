"""The operations of the laws: how each is written in Python and in LLVM, and how it is evaluated by itself.

All are operations of IEEE 754 or functions of `elementary`, and the same everywhere.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import SETS
from xdynamics.expressions.evaluation import NUMERIC

# operation: sign in Python and how strongly it binds; instruction in LLVM
INFIX = {
    "add": (" + ", 1, "fadd"), "subtract": (" - ", 1, "fsub"), "multiply": ("*", 2, "fmul"), "divide": ("/", 2, "fdiv"),
}  # fmt: skip
COMPARISONS = {
    "less": (" < ", "olt"), "at_most": (" <= ", "ole"), "more": (" > ", "ogt"), "at_least": (" >= ", "oge"),
    "equal": (" == ", "oeq"), "unequal": (" != ", "une"),
}  # fmt: skip
INTRINSICS = {"abs": "fabs", "sqrt": "sqrt"}

# operations composed of several LLVM instructions: lines with {0}, {1} for arguments, {T} for the type of numbers, {B}
# for that of truth values, {a}, {b}, … for intermediate values and {=} for the result
COMPOSED = {
    "negative": ("{=} = fneg {T} {0}",),
    "sign": (
        "{a} = fcmp olt {T} {0}, {zero}", "{b} = select {B} {a}, {T} {minus}, {T} {0}",
        "{c} = fcmp ogt {T} {0}, {zero}", "{=} = select {B} {c}, {T} {one}, {T} {b}",
    ),
    "least": (
        "{a} = fcmp olt {T} {0}, {1}", "{b} = fcmp uno {T} {0}, {0}", "{c} = or {B} {a}, {b}",
        "{=} = select {B} {c}, {T} {0}, {T} {1}",
    ),
    "greatest": (
        "{a} = fcmp ogt {T} {0}, {1}", "{b} = fcmp uno {T} {0}, {0}", "{c} = or {B} {a}, {b}",
        "{=} = select {B} {c}, {T} {0}, {T} {1}",
    ),
    "positive": ("{a} = fcmp ogt {T} {0}, {zero}", "{=} = select {B} {a}, {T} {0}, {T} {nan}"),
}  # fmt: skip


def least(x: float, y: float) -> float:
    """Return the smaller; nan if either is."""
    return x if x < y or x != x else y


def greatest(x: float, y: float) -> float:
    """Return the larger; nan if either is."""
    return x if x > y or x != x else y


def unsound(numbers: NDArray[np.float64]) -> float:
    """Return 0 if all numbers are finite, else nan."""
    return 0.0 if np.isfinite(numbers).all() else math.nan


def _kept(function: Callable[..., float]) -> Callable[..., float]:
    """Make a function return NumPy floats, which divide by zero as IEEE 754 requires, unlike Python's."""

    @wraps(function)
    def wrapped(*arguments: float) -> Any:
        return np.float64(function(*(float(argument) for argument in arguments)))

    return wrapped


# by their names in printed Python, where a model's own names cannot collide with those that have an underscore
PYTHON: dict[str, Any] = {
    name: _kept(function) for name, function in NUMERIC.items() if name not in ("positive", "power")
} | {
    "_positive": _kept(NUMERIC["positive"]),
    "_power": _kept(NUMERIC["power"]),
    "_least": _kept(least),
    "_greatest": _kept(greatest),
    "_unsound": unsound,
}


def python_of_set(math_functions: str) -> dict[str, Any]:
    """Return what printed Python calls, with the elementary functions of a set."""
    functions = {
        f"_{name}" if name == "power" else name: _kept(function) for name, function in SETS[math_functions].items()
    }
    return PYTHON | functions
