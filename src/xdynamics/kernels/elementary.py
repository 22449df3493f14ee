"""The operations of the laws, in one room: how each is written in Python and in LLVM, and what it is by itself.

`sqrt`, `hypot` and the choices are IEEE operations and the same everywhere. The others are the C library's until a
portable set takes their place; a run says so in `math_functions`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions.evaluation import NUMERIC

MATH_FUNCTIONS = "libm"

# operation: sign in Python and how strongly it binds; instruction in LLVM
INFIX = {
    "add": (" + ", 1, "fadd"), "subtract": (" - ", 1, "fsub"), "multiply": ("*", 2, "fmul"), "divide": ("/", 2, "fdiv"),
}  # fmt: skip
COMPARISONS = {
    "less": (" < ", "olt"), "at_most": (" <= ", "ole"), "more": (" > ", "ogt"), "at_least": (" >= ", "oge"),
    "equal": (" == ", "oeq"), "unequal": (" != ", "une"),
}  # fmt: skip
INTRINSICS = {"abs": "fabs", "sqrt": "sqrt"}
# LLVM knows these four by name and merges a sine and a cosine of one angle; of the others it knows nothing
LIBRARY_INTRINSICS = {"sin": "sin", "cos": "cos", "exp": "exp", "log": "log", "power": "pow"}
LIBRARY = ("tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh")

# what is composed of other LLVM instructions: lines with {0}, {1} for arguments, {T} for the type of numbers, {B} of truths
# {a}, {b}, … for values of its own and {=} for the result
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


def power(x: float, exponent: float) -> float:
    """x**exponent where the exponent is no multiple of 1/2; nan below zero, inf beyond the numbers."""
    try:
        return math.pow(x, exponent)
    except OverflowError:
        return math.inf
    except ValueError:
        return math.nan


def least(x: float, y: float) -> float:
    """Return the smaller; nan if either is."""
    return x if x < y or x != x else y


def greatest(x: float, y: float) -> float:
    """Return the larger; nan if either is."""
    return x if x > y or x != x else y


def unsound(numbers: NDArray[np.float64]) -> float:
    """0 where all numbers are finite, else nan."""
    return 0.0 if np.isfinite(numbers).all() else math.nan


def _kept(function: Callable[..., float]) -> Callable[..., float]:
    """Give numpy's kind of float back, which divides by zero as IEEE 754 asks and not as Python does."""

    @wraps(function)
    def wrapped(*arguments: float) -> Any:
        return np.float64(function(*(float(one) for one in arguments)))

    return wrapped


# by the names of printed Python, where a model's own names cannot meet those with an underscore
PYTHON: dict[str, Any] = {name: _kept(one) for name, one in NUMERIC.items() if name != "positive"} | {
    "_positive": _kept(NUMERIC["positive"]),
    "_power": _kept(power),
    "_least": _kept(least),
    "_greatest": _kept(greatest),
    "_unsound": unsound,
}
