"""Programs written as lines of text, whose names stand for values known where they are written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.elementary.numbers import maximum_of_two, minimum_of_two
from xdynamics.expressions import parse
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.compiling import jit_inline
from xdynamics.kernels.program import Location, Operand
from xdynamics.kernels.python_text import function_text

larger: Any = jit_inline(maximum_of_two)
smaller: Any = jit_inline(minimum_of_two)


class Formulas(Assignments):
    """Turns text into instructions; names are values given or computed before, or places in a lane's memory."""

    def __init__(self, places: dict[str, Location], prefix: str, operands: dict[str, Operand] | None = None) -> None:
        super().__init__(lambda lines, name: lines.load(places[name]), prefix)
        self.known: dict[str, Operand] = operands or {}
        self._given: dict[str, Operand] = {}

    def operand_of(self, name: str) -> Operand:
        """Return the operand of a name."""
        if name in self._given:
            return self._given[name]
        return self.known[name] if name in self.known else super().operand_of(name)

    def formula(self, text: str, **operands: Operand) -> Operand:
        """Write an expression; return its operand."""
        self._given = operands
        operand = self.value(parse(text))
        self._given = {}
        return operand

    def write(self, text: str, **operands: Operand) -> None:
        """Write lines; the names that they assign are known from then on."""
        for target, expression in split_assignments(text):
            self.known[target] = self.formula(expression, **operands)


def split_assignments(text: str) -> list[list[str]]:
    """Return target and expression of every line."""
    return [line.split(" = ") for line in filter(None, text.split("\n"))]


def compiled_function_of(
    text: str, argument_names: str, results: str, constants: Mapping[str, float] | None = None
) -> Any:
    """Compile lines as a function of numbers for the engine, inlined where it is called: what programs compute too.

    Parameters
    ----------
    text : str
    argument_names, results : str
        Names of the arguments, and of what is returned.
    constants : mapping of str to float, optional
        Further names.
    """
    lines = Formulas({}, "_", dict(constants or {}) | {name: name for name in argument_names.split()})
    lines.write(text)
    source = function_text(
        "lines", argument_names.split(), lines.lines, [lines.known[name] for name in results.split()]
    )
    scope: dict[str, Any] = {"_greatest": larger, "_least": smaller, "_floor": np.floor, "sqrt": math.sqrt}
    exec(source, scope)  # noqa: S102 - printed from checked trees
    return jit_inline(scope["lines"])
