"""Taylor coefficients of a motion as intervals, by the recurrences of every operation, with their derivatives by the start.

The program is that of method `taylor`, printed for intervals; derivatives are series of their own, those of the tangents
of its values, in a loop over the numbers of the start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.kernels.jets.expansion import expansion
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.program import AT, Line, Load, Location, Loop, Program, StoreTo, T
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.constants import Constants
from xdynamics.tubes.enclosed_programs import EnclosedProgram
from xdynamics.tubes.gradients import StraightLines, Undefined
from xdynamics.tubes.tangents import SEED


class UndefinedError(Exception):
    """A coefficient is not known to exist for all states of a set."""


@dataclass(frozen=True)
class Motions:
    """The lines of a program that a motion follows from, and where it has its numbers."""

    straight: StraightLines
    motion: Motion


class MotionSeries:
    """Computes coefficients of motions from every state of a set.

    Parameters
    ----------
    motions : Motions
    numbers : int
        Of a set: coordinates, velocities, states, then uncertain constants, which do not change.
    degree : int
    derivatives : bool
        Whether to add the derivatives by every number of the start.
    """

    def __init__(self, motions: Motions, numbers: int, degree: int, *, derivatives: bool = False) -> None:
        self._motions, self._degree = motions, degree
        self._used, self._seeds = motions.motion.used, numbers if derivatives else 0
        self._constants = constants = Constants(motions.straight, self._used, numbers, self._seeds)
        lines = tuple(_as_states(motions, constants, self._seeds))
        motion = Motion(0, self._used * (1 + self._seeds))
        series_program = expansion(Program("forces", "", lines), motion, degree, written_out=False)
        sizes = {"at": len(AT), "y": motion.used, "p": constants.count, "w": series_program.memory}
        self._program = EnclosedProgram(series_program.program, sizes)
        self._state, self._time = self._program.arrays["y"], self._program.arrays["at"][T]
        constants.fill_certain(self._program.arrays["p"])
        self._coefficients = self._program.arrays["w"][: (degree + 1) * motion.used].reshape(degree + 1, motion.used, 3)
        for i in range(self._used if self._seeds else 0):
            self._state[self._used + i * self._seeds + i, :2] = 1.0

    def coefficients_of(self, time: Box, start: Box, step_values: Floats) -> Box:
        """Return the coefficients.

        Parameters
        ----------
        time : ndarray, shape (2,)
        start : ndarray, shape (2, numbers)
        step_values : ndarray
            What holds for a step: `StepConstants.values_from`.

        Returns
        -------
        ndarray, shape (2, degree + 1, numbers of the state, 1 or 1 + numbers)

        Raises
        ------
        UndefinedError
            If one of them may not exist, or is beyond the range of floats.
        """
        used = self._used
        self._time[:2], self._state[:used, :2] = time, start[:, :used].T
        self._constants.fill_uncertain(start, step_values)
        self._program.run()
        if self._coefficients[..., 2].any() or not np.isfinite(self._coefficients).all():
            raise UndefinedError(self._reason(time, start, step_values))
        coefficients = np.empty((2, self._degree + 1, used, 1 + self._seeds))
        for end in range(2):
            coefficients[end, :, :, 0] = self._coefficients[:, :used, end]
            coefficients[end, :, :, 1:] = self._coefficients[:, used:, end].reshape(self._degree + 1, used, self._seeds)
        return coefficients

    def _reason(self, time: Box, start: Box, step_values: Floats) -> str:
        """Say what is not defined for some of the states."""
        stored_values = self._motions.straight.stored_over(time, start, step_values, derivatives=True)
        reasons = [value.reason for value in stored_values.values() if isinstance(value, Undefined)]
        return reasons[0] if reasons else "a number is beyond the range of floats"


def _as_states(motions: Motions, constants: Constants, seeds: int) -> Iterator[Line]:
    """Yield the lines of equations of first order, of all numbers of a state and of their derivatives."""
    motion, used = motions.motion, motions.motion.used
    rates = used * (1 + seeds)  # where in `z` they begin
    lines: list[Line] = []
    for i in range(motion.coordinates):
        velocity = f"_velocity{i}"
        lines += [Load(velocity, Location("y", motion.coordinates + i)), StoreTo(Location("z", rates + i), velocity)]
    for line in constants.lines():
        if isinstance(line, StoreTo):
            line = replace(line, location=Location("z", rates + motion.raised_by(line.location.offset)))  # noqa: PLW2901
        lines.append(line)
    yield from lines
    if seeds:
        tangents = {
            Location("z", rates + i): Location("z", rates + used + i * seeds, ((SEED, 1),)) for i in range(used)
        }
        yield Loop(SEED, seeds, constants.tangents(lines, used, tangents))
