"""The one walk through a method's lines: whoever runs, prints or analyses them says what each kind of line does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

from xdynamics.methods.method import Evaluation, Line, Solve, Statement


class Walker(ABC):
    """What is done with each kind of line."""

    def walk(self, lines: Iterable[Line]) -> None:
        """Go through lines in their order."""
        for line in lines:
            if isinstance(line, Evaluation):
                self.evaluate(line)
            elif isinstance(line, Solve):
                self.solve(line)
            else:
                self.assign(line)

    @abstractmethod
    def assign(self, line: Statement) -> None:
        """One vector from vectors of its length."""

    @abstractmethod
    def evaluate(self, line: Evaluation) -> None:
        """Forces and rates at one time and state."""

    @abstractmethod
    def solve(self, line: Solve) -> None:
        """Equations that hold together."""
