"""Programs written as lines of text, whose names stand for values known where they are written."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from xdynamics.elementary.numbers import greatest, least
from xdynamics.expressions import parse
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.compiling import compiled
from xdynamics.kernels.program import Operand, Place
from xdynamics.kernels.python_text import function_text

larger: Any = compiled(greatest)
smaller: Any = compiled(least)


class Formulas(Assignments):
    """Turns text into instructions; names are values given or computed before, or places in a lane's memory."""

    def __init__(self, places: dict[str, Place], prefix: str, known: dict[str, Operand] | None = None) -> None:
        super().__init__(lambda lines, name: lines.load(places[name]), prefix)
        self.known: dict[str, Operand] = known or {}
        self._given: dict[str, Operand] = {}

    def named(self, name: str) -> Operand:
        """Return the operand of a name."""
        if name in self._given:
            return self._given[name]
        return self.known[name] if name in self.known else super().named(name)

    def of(self, text: str, **given: Operand) -> Operand:
        """Write an expression; return its operand."""
        self._given = given
        operand = self.value(parse(text))
        self._given = {}
        return operand

    def write(self, text: str, **given: Operand) -> None:
        """Write lines; the names that they assign are known from then on."""
        for target, expression in parted(text):
            self.known[target] = self.of(expression, **given)


def parted(text: str) -> list[list[str]]:
    """Return target and expression of every line."""
    return [line.split(" = ") for line in filter(None, text.split("\n"))]


def function_of(text: str, given: str, results: str, constants: Mapping[str, float] | None = None) -> Any:
    """Compile lines as a function of numbers for the engine, inlined where it is called: what programs compute too.

    Parameters
    ----------
    text : str
    given, results : str
        Names of the arguments, and of what is returned.
    constants : mapping of str to float, optional
        Further names.
    """
    lines = Formulas({}, "_", dict(constants or {}) | {name: name for name in given.split()})
    lines.write(text)
    source = function_text("lines", given.split(), lines.lines, [lines.known[name] for name in results.split()])
    scope: dict[str, Any] = {"_greatest": larger, "_least": smaller, "_floor": np.floor, "sqrt": math.sqrt}
    exec(source, scope)  # noqa: S102 - printed from checked trees
    return compiled(scope["lines"])
