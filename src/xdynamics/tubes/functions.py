"""Functions of a state over sets of states: observables, energies, events and their rates along the motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from xdynamics.expressions import Node
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import values_of
from xdynamics.kernels.program import Compute, Line, Load, Location, Loop, Program, StoreTo
from xdynamics.tubes import boxes
from xdynamics.tubes.boxes import HELD, UNKNOWN, AffineImage, Box, Floats, stored_bounds, with_pieces
from xdynamics.tubes.flow import Proof
from xdynamics.tubes.interval_problem import IntervalProblem, literals_of
from xdynamics.tubes.series import Inputs, StraightLines
from xdynamics.tubes.tangents import PARTS, SEED, EnclosedProgram


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
        self._inputs = inputs = Inputs(straight, self._used, numbers, numbers)
        lines: list[Line] = [*inputs.lines()]
        tangents = {Location("z", k): Location("z", self.count + k * numbers, ((SEED, 1),)) for k in range(self.count)}
        slopes = Loop(SEED, numbers, inputs.tangents(lines, tangents))
        program = Program("functions", "Functions of a state.", (*lines, slopes))
        self._program = EnclosedProgram(program, inputs.sizes | {"z": self.count * (1 + numbers)})
        inputs.allocate(self._program.arrays)
        results = self._program.arrays["z"]
        self._values = results[: self.count]
        self._slopes = results[self.count :].reshape(self.count, numbers, len(PARTS))

    def enclosures(self, time: Box, states: Box, step_values: Floats) -> tuple[Box, Box]:
        """Return the values over a box, and their derivatives by the numbers of a set; infinite bounds where none is known.

        A function that may jump among the values has no derivatives there either, be it level on either side.

        Returns
        -------
        ndarray, shape (2, count)
        ndarray, shape (2, count, numbers)
        """
        self._inputs.fill(time, states, step_values)
        self._program.run()
        values = stored_bounds(self._values)
        slopes = stored_bounds(self._slopes)
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
