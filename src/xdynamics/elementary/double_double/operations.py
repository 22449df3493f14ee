"""The operations of programs, of sums of two floats, by the names that they have of floats."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from xdynamics.elementary.double_double import sums
from xdynamics.elementary.double_double.functions import FUNCTIONS
from xdynamics.elementary.double_double.sums import DoubleDouble
from xdynamics.elementary.numbers import Number, Truth, exact_sum

RULES: Mapping[str, Callable[..., Any]] = {
    "add": sums.add,
    "subtract": sums.subtract,
    "multiply": sums.multiply,
    "divide": sums.divide,
    "less": sums.is_less,
    "at_most": sums.at_most,
    "more": lambda x, y: sums.is_less(y, x),
    "at_least": lambda x, y: sums.at_most(y, x),
    "equal": sums.equal,
    "unequal": lambda x, y: (x.high != y.high) | (x.low != y.low),
    "negative": sums.negated,
    "abs": sums.absolute_value,
    "sqrt": sums.sqrt,
    "choose": sums.choose_sum,
    "sign": sums.sign_of_sum,
    "least": sums.minimum_of_sums,
    "greatest": sums.maximum_of_sums,
    "positive": sums.positive_sum,
    "floor": sums.floor_of_sum,
    "ceil": sums.ceiling_of_sum,
    "round": sums.nearest_integer,
    "mod": sums.modulo_of_sums,
    "newest": lambda _, new: new,
    # between sums and floats
    "joined": DoubleDouble,
    "exact": sums.exact,
    "added": lambda x, y: DoubleDouble(*exact_sum(x, y)),
    "high": lambda x: x.high,
    "low": lambda x: x.low,
}

# operations that programs of sums call; written out, one of ten lines would be one of two hundred
CALLED = {
    name: RULES[name] for name in ("add", "subtract", "multiply", "divide", "sqrt", "floor", "ceil", "round", "mod")
}


@dataclass(frozen=True)
class DoubleDoubles:
    """The operations.

    Parameters
    ----------
    functions : mapping of str to callable
        The elementary functions; where programs are written, calls of them and of what is long of `RULES`.
    """

    functions: Mapping[str, Callable[..., DoubleDouble]] = field(default_factory=lambda: FUNCTIONS)

    def of(self, operation: str, *arguments: DoubleDouble | Number | Truth) -> Any:
        """Return the result of an operation."""
        return (self.functions.get(operation) or RULES[operation])(*arguments)
