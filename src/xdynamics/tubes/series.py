"""Taylor coefficients of a motion as intervals, by the recurrences of every operation, with their derivatives by the start.

The program is that of method `taylor`, printed for intervals; derivatives are series of their own, those of the tangents
of its values, in a loop over the numbers of the start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from xdynamics.kernels.jets.expansion import expansion
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.program import AT, Compute, Line, Load, Loop, Operand, Place, Program, StoreTo, T
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.enclosed_programs import EnclosedProgram
from xdynamics.tubes.gradients import NOW, StraightLines, Undefined, Value, number
from xdynamics.tubes.tangents import SEED, with_tangents


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
        constants = _Constants(motions, numbers, self._seeds)
        lines = tuple(_as_states(motions, constants, self._seeds))
        motion = Motion(0, self._used * (1 + self._seeds))
        whole = expansion(Program("forces", "", lines), motion, degree, written_out=False)
        sizes = {"at": len(AT), "y": motion.used, "p": constants.count, "w": whole.memory}
        self._program = EnclosedProgram(whole.program, sizes)
        self._state, self._time = self._program.arrays["y"], self._program.arrays["at"][T]
        self._uncertain = constants.fill(self._program.arrays["p"])
        self._found = self._program.arrays["w"][: (degree + 1) * motion.used].reshape(degree + 1, motion.used, 3)
        for i in range(self._used if self._seeds else 0):
            self._state[self._used + i * self._seeds + i, :2] = 1.0

    def of(self, time: Box, start: Box) -> Box:
        """Return the coefficients.

        Parameters
        ----------
        time : ndarray, shape (2,)
        start : ndarray, shape (2, numbers)

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
        for i, place in self._uncertain:
            place[:2] = start[:, i]
        self._program.run()
        if self._found[..., 2].any() or not np.isfinite(self._found).all():
            raise UndefinedError(self._reason(time, start))
        found = np.empty((2, self._degree + 1, used, 1 + self._seeds))
        for end in range(2):
            found[end, :, :, 0] = self._found[:, :used, end]
            found[end, :, :, 1:] = self._found[:, used:, end].reshape(self._degree + 1, used, self._seeds)
        return found

    def _reason(self, time: Box, start: Box) -> str:
        """Say what is not defined for some of the states."""
        found = self._motions.straight.over(time, start, derivatives=True)
        reasons = [value.reason for value in found.values() if isinstance(value, Undefined)]
        return reasons[0] if reasons else "a number is beyond the range of floats"


class _Constants:
    """Places in `p`: rows of derivatives of what is uncertain, then what lines read, and literals that no float is."""

    def __init__(self, motions: Motions, numbers: int, seeds: int) -> None:
        self._motions, self._seeds = motions, seeds
        self._rows = (numbers - motions.motion.used) * seeds
        self._values: list[Value] = []
        self._places: dict[Place | int, Place] = {}

    @property
    def count(self) -> int:
        """How many there are."""
        return self._rows + len(self._values)

    def of(self, place: Place) -> Place:
        """Return where a constant is."""
        return self._at(place, self._motions.straight.constants[place])

    def literal(self, operand: Operand) -> Place | None:
        """Return where a literal is that no float is; None of another operand."""
        value = self._motions.straight.literals.get(id(operand)) if isinstance(operand, float) else None
        return None if value is None else self._at(id(operand), value)

    def tangents(self, place: Place) -> Place | None:
        """Return where the derivatives of a constant are; None of one that is certain."""
        value = self._motions.straight.constants[place]
        if not isinstance(value, int):
            return None
        return Place("p", (value - self._motions.motion.used) * self._seeds, ((SEED, 1),))

    def _at(self, key: Place | int, value: Value) -> Place:
        if key not in self._places:
            self._places[key] = Place("p", self.count)
            self._values.append(value)
        return self._places[key]

    def fill(self, array: Floats) -> list[tuple[int, Floats]]:
        """Write what is certain; return the numbers of what is not, each with where it goes."""
        for row in range(self._rows):
            constant, seed = divmod(row, self._seeds)
            array[row, :2] = float(seed == self._motions.motion.used + constant)
        uncertain = []
        for value, where in zip(self._values, array[self._rows :], strict=True):
            if isinstance(value, int):
                uncertain.append((value, where))
            else:
                where[:2] = number(value)[:, 0]
        return uncertain


def _as_states(motions: Motions, constants: _Constants, seeds: int) -> Iterator[Line]:
    """Yield the lines of equations of first order, of all numbers of a state and of their derivatives."""
    motion, used = motions.motion, motions.motion.used
    rates = used * (1 + seeds)  # where in `z` they begin
    lines: list[Line] = []
    for i in range(motion.coordinates):
        velocity = f"_velocity{i}"
        lines += [Load(velocity, Place("y", motion.coordinates + i)), StoreTo(Place("z", rates + i), velocity)]
    for line in motions.straight.lines:
        match line:
            case Load() if line.place.array == "y" or line.place == NOW:
                lines.append(line)
            case Load():
                lines.append(Load(line.target, constants.of(line.place)))
            case Compute():
                lines += _with_literals(line, constants)
            case StoreTo():
                value = line.value
                if (place := constants.literal(value)) is not None:
                    value = f"_stored{len(lines)}"
                    lines.append(Load(value, place))
                lines.append(StoreTo(Place("z", rates + motion.raised_by(line.place.offset)), value))
    yield from lines
    if seeds:

        def read(place: Place) -> Place | None:
            if place.array == "y":
                return Place("y", used + place.offset * seeds, ((SEED, 1),))
            return uncertain.get(place)

        uncertain = {constants.of(place): constants.tangents(place) for place in motions.straight.constants}

        def stored(place: Place) -> Place:
            return Place("z", rates + used + (place.offset - rates) * seeds, ((SEED, 1),))

        yield Loop(SEED, seeds, with_tangents(lines, read, stored))


def _with_literals(line: Compute, constants: _Constants) -> Iterator[Line]:
    """Yield a line, after those that read its literals that no float is."""
    given: list[Operand] = []
    for operand in line.arguments:
        if (place := constants.literal(operand)) is None:
            given.append(operand)
        else:
            name = f"{line.target}.literal{len(given)}"
            yield Load(name, place)
            given.append(name)
    yield Compute(line.target, line.operation, tuple(given))
