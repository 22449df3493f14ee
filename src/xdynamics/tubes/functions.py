"""Functions of a state over sets of states: observables, energies, events and their rates along the motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xdynamics.expressions import Node
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import values_of
from xdynamics.kernels.program import Compute, Load, Place, StoreTo
from xdynamics.tubes import boxes, gradients
from xdynamics.tubes.boxes import Box
from xdynamics.tubes.flow import Proof
from xdynamics.tubes.gradients import StraightLines, Undefined, Value
from xdynamics.tubes.interval_problem import IntervalProblem, literals_of

UNKNOWN = np.array([-np.inf, np.inf])


class Functions:
    """Some functions of a state.

    Parameters
    ----------
    problem : IntervalProblem
    layout : Layout
    trees : sequence of Node
    """

    def __init__(self, problem: IntervalProblem, layout: Layout, trees: Sequence[Node]) -> None:
        lines = tuple(line for line in values_of(layout, trees).body if isinstance(line, Load | Compute | StoreTo))
        self._straight = StraightLines(lines, problem.motions.straight.constants, literals_of(lines))
        self.count = len(trees)

    def over(self, time: Box, states: Box, *, derivatives: bool = False) -> list[Value]:
        """Return the values over a box, perhaps with their derivatives by the numbers of a set."""
        found = self._straight.over(time, states, derivatives=derivatives)
        return [found[Place("z", k)] for k in range(self.count)]

    @np.errstate(all="ignore")
    def within(self, proof: Proof, time: Box) -> Box:
        """Return bounds of the values for all motions at a time within a step, or at any of an interval; shape (2, count).

        Both the values over the box and those in the middle, with what their derivatives add, hold them.
        """
        seen, states = proof.seen(time), proof.at(time)
        middle = boxes.point(boxes.middle(seen.image))
        between = boxes.hull(states, middle)  # of the middle and any state
        sloped, centre = self.over(time, between, derivatives=True), self.over(time, middle)
        # where there is a corner, there is no derivative, and still a value
        plain = self.over(time, states) if any(isinstance(value, Undefined) for value in sloped) else sloped
        found = []
        for value, near, slope in zip(plain, centre, sloped, strict=True):
            bounds = _bounds(value)
            if not isinstance(slope, Undefined | float | bool) and slope.shape[1] > 1:
                bounds = boxes.common(bounds, boxes.add(_bounds(near), seen.along(slope[:, None, 1:])[:, 0]))
            found.append(bounds)
        return np.stack(found, axis=1) if found else np.zeros((2, 0))

    def at_start(self, time: Box, states: Box) -> Box:
        """Return bounds of the values over a box."""
        found = [_bounds(value) for value in self.over(time, states)]
        return np.stack(found, axis=1) if found else np.zeros((2, 0))


def _bounds(value: Value) -> Box:
    """Return the bounds of a value; infinite ones of what is undefined."""
    if isinstance(value, Undefined):
        return UNKNOWN
    bounds = gradients.number(value)[:, 0]
    return UNKNOWN if np.isnan(bounds).any() else bounds
