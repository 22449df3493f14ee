"""The walk through a method's lines; subclasses that run, print or analyse them define what each kind of line does."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable

from xdynamics.methods.lines import ConstraintImpulse, Evaluation, Line, Solve, TaylorSeries, VectorStatement


class Walker(ABC):
    """Handles each kind of line of a method."""

    def walk(self, lines: Iterable[Line]) -> None:
        """Go through lines in order."""
        for line in lines:
            if isinstance(line, Evaluation):
                self.evaluate(line)
            elif isinstance(line, Solve):
                self.solve(line)
            elif isinstance(line, TaylorSeries):
                self.expand(line)
            elif isinstance(line, ConstraintImpulse):
                self.keep(line)
            else:
                self.assign(line)

    @abstractmethod
    def assign(self, line: VectorStatement) -> None:
        """Handle one vector from vectors of the same length."""

    @abstractmethod
    def evaluate(self, line: Evaluation) -> None:
        """Handle accelerations and rates at one time and state."""

    @abstractmethod
    def expand(self, line: TaylorSeries) -> None:
        """Handle the coefficients of the motion from the start of the step on."""

    @abstractmethod
    def keep(self, line: ConstraintImpulse) -> None:
        """Handle impulses of constraints."""

    @abstractmethod
    def solve(self, line: Solve) -> None:
        """Handle simultaneous equations."""
