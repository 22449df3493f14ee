"""Operators of Python for arrays of traced numbers: each is the function of numpy that an array would call."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

BINARY = {
    "add": "add",
    "sub": "subtract",
    "mul": "multiply",
    "truediv": "divide",
    "pow": "power",
    "mod": "remainder",
    "floordiv": "floor_divide",
    "and": "logical_and",
    "or": "logical_or",
}
COMPARING = {
    "lt": "less",
    "le": "less_equal",
    "gt": "greater",
    "ge": "greater_equal",
    "eq": "equal",
    "ne": "not_equal",
}
UNARY = {"neg": "negative", "pos": "positive", "abs": "absolute", "invert": "logical_not"}


def give_operators(kind: type, applied: Callable[..., Any]) -> None:
    """Give a class the operators of arrays.

    Parameters
    ----------
    kind : type
    applied : callable of (str, *values)
        Applies a function of numpy, by its name, to values of which at least one is of the class.
    """

    def operator(ufunc: str, *, turned: bool = False) -> Callable[..., Any]:
        return lambda *values: applied(ufunc, *(reversed(values) if turned else values))

    for word, ufunc in (BINARY | COMPARING | UNARY).items():
        setattr(kind, f"__{word}__", operator(ufunc))
    for word, ufunc in BINARY.items():
        setattr(kind, f"__r{word}__", operator(ufunc, turned=True))
