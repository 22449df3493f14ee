"""Programs written as lines of text, whose names stand for values known where they are written."""

from __future__ import annotations

from xdynamics.expressions import parse
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.program import Operand, Place


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
        for line in filter(None, text.split("\n")):
            target, expression = line.split(" = ")
            self.known[target] = self.of(expression, **given)
