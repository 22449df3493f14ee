"""Functions of a state over sets of states: observables, energies, events and their rates along the motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from xdynamics.expressions import Node
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import values_of
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Loop, Program, StoreTo, T
from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import HELD, AffineImage, Box, Floats, with_pieces
from xdynamics.tubes.flow import Proof
from xdynamics.tubes.gradients import StraightLines
from xdynamics.tubes.interval_problem import IntervalProblem, literals_of
from xdynamics.tubes.series import Constants
from xdynamics.tubes.tangents import PARTS, SEED, EnclosedProgram

UNKNOWN = np.array([[-np.inf], [np.inf]])


class Functions:
    """Some functions of a state, with their derivatives by every number of the start, as machine code.

    Parameters
    ----------
    problem : IntervalProblem
    layout : Layout
    trees : sequence of Node
    """

    def __init__(self, problem: IntervalProblem, layout: Layout, trees: Sequence[Node]) -> None:
        self.count, self._used, numbers = len(trees), problem.used, problem.start.shape[1]
        if not trees:
            return
        body = [line for line in values_of(layout, trees).body if isinstance(line, Line)]
        stored = tuple(line for line in with_pieces(body) if isinstance(line, Load | Compute | StoreTo))
        straight = StraightLines(stored, problem.motions.straight.constants, literals_of(stored))
        self.reads_tables = any(isinstance(line, Load) and line.location.array == HELD for line in stored)
        self._constants = constants = Constants(straight, self._used, numbers, numbers)
        lines: list[Line] = [*constants.lines()]
        tangents = {Location("z", k): Location("z", self.count + k * numbers, ((SEED, 1),)) for k in range(self.count)}
        slopes = Loop(SEED, numbers, constants.tangents(lines, self._used, tangents))
        program = Program("functions", "Functions of a state.", (*map(_squared, lines), slopes))
        of_state = self._used * (1 + numbers)
        sizes = {"at": len(AT), "y": of_state, "p": constants.count, "z": self.count * (1 + numbers)}
        self._program = EnclosedProgram(program, sizes)
        arrays = self._program.arrays
        constants.fill_certain(arrays["p"])
        self._time, self._state = arrays["at"][T], arrays["y"]
        self._values = arrays["z"][: self.count]
        self._slopes = arrays["z"][self.count :].reshape(self.count, numbers, len(PARTS))
        for i in range(self._used):
            self._state[self._used + i * numbers + i, :2] = 1.0

    def enclosures(self, time: Box, states: Box, step_values: Floats) -> tuple[Box, Box]:
        """Return the values over a box, and their derivatives by the numbers of a set; infinite bounds where none is known.

        A function that may jump among the values has no derivatives there either, be it level on either side.

        Returns
        -------
        ndarray, shape (2, count)
        ndarray, shape (2, count, numbers)
        """
        self._time[:2], self._state[: self._used, :2] = time, states[:, : self._used].T
        self._constants.fill_uncertain(states, step_values)
        self._program.run()
        values = _stored_bounds(self._values)
        slopes = _stored_bounds(self._slopes)
        slopes[:, ~np.isfinite(values).all(axis=0)] = UNKNOWN[..., None]
        return values, slopes

    @np.errstate(all="ignore")
    def bounds_in_step(self, proof: Proof, time: Box) -> Box:
        """Return bounds of the values for all motions at a time within a step, or at any of an interval; shape (2, count).

        Both the values over the box and those in the middle, with what their derivatives add, hold them.
        """
        return self.of_set(time, proof.image_at(time), proof.box_at(time), proof.step_values)

    @np.errstate(all="ignore")
    def of_set(self, time: Box, seen: AffineImage, states: Box, step_values: Floats) -> Box:
        """Return bounds of the values for all motions of a set, given as an affine image and as a box around it."""
        if not self.count:
            return np.zeros((2, 0))
        middle = boxes.point_box(boxes.midpoint(seen.image))
        (box_values, _), (centre, _) = (self.enclosures(time, box, step_values) for box in (states, middle))
        _, slopes = self.enclosures(time, boxes.hull(states, middle), step_values)  # between the middle and any state
        sloped = boxes.add(centre, seen.mean_value_form(slopes))
        # where there is a corner, there is no derivative, and still a value
        smooth = np.isfinite(slopes).all(axis=(0, 2)) & np.isfinite(sloped).all(axis=0)
        return np.where(smooth, boxes.intersection(box_values, sloped), box_values)

    def at_start(self, time: Box, states: Box, step_values: Floats) -> Box:
        """Return bounds of the values over a box."""
        return self.enclosures(time, states, step_values)[0] if self.count else np.zeros((2, 0))


def _squared(line: Line) -> Line:
    """Return a product of a number with itself as its square, which is not negative."""
    if isinstance(line, Compute) and line.operation == "multiply" and line.arguments[0] == line.arguments[1]:
        return replace(line, operation="square", arguments=line.arguments[:1])
    return line


def _stored_bounds(stored_values: Box) -> Box:
    """Return the bounds that a program stored, unbounded where undefined."""
    ends = np.moveaxis(stored_values[..., :2], -1, 0)
    sound = (stored_values[..., 2] == 0.0) & ~np.isnan(ends).any(axis=0)
    return np.where(sound, ends, UNKNOWN.reshape(2, *(1,) * (ends.ndim - 1)))
