"""Taylor coefficients of a motion as intervals, with their derivatives by the start.

Coefficients follow from the recurrences of every operation. The program is that of method `taylor`, printed for
intervals; derivatives are series of their own, those of the tangents
of its values, in a loop over the numbers of the start.

Besides the state such a program reads constants, and literals that are no floats, from places of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.kernels.jets.expansion import expansion
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Loop, Operand, Program, StoreTo, T
from xdynamics.tubes.boxes import HELD, Box, Floats
from xdynamics.tubes.gradients import NOW, StraightLines, Undefined, Value, as_number
from xdynamics.tubes.tangents import SEED, EnclosedProgram, with_tangents


class Constants:
    """Places in `p`: derivative rows of uncertain numbers, then constants, then literals that are no floats.

    Parameters
    ----------
    straight : StraightLines
    used : int
        Numbers of a set that move.
    numbers : int
        Of a set: those, then uncertain constants.
    seeds : int
        By how many of them derivatives are taken: all, or none.
    """

    def __init__(self, straight: StraightLines, used: int, numbers: int, seeds: int) -> None:
        self._straight, self._used, self._seeds = straight, used, seeds
        self._rows = (numbers - used) * seeds
        self._values: list[Value] = []
        self._places: dict[Location | int, Location] = {}
        self._uncertain: list[tuple[int, Floats]] = []
        self._step_places: list[tuple[int, Floats]] = []

    @property
    def count(self) -> int:
        """How many there are."""
        return self._rows + len(self._values)

    def lines(self) -> Iterator[Load | Compute | StoreTo]:
        """Yield the lines, which read every constant from where it is."""
        for line in self._straight.lines:
            match line:
                case Load() if line.location.array == "y" or line.location == NOW:
                    yield line
                case Load():
                    is_step_value = line.location.array == HELD
                    value = line.location if is_step_value else self._straight.constants[line.location]
                    yield Load(line.target, self._place_of(line.location, value))
                case Compute():
                    operands: list[Operand] = []
                    for operand in line.arguments:
                        operands.append(f"{line.target}.literal{len(operands)}")
                        yield from self._literal(operands, operand)
                    yield Compute(line.target, line.operation, tuple(operands))
                case StoreTo():
                    operands = [f"_stored{line.location.offset}"]
                    yield from self._literal(operands, line.value)
                    yield StoreTo(line.location, operands[0])

    def _literal(self, operands: list[Operand], operand: Operand) -> Iterator[Load]:
        """Yield the load of a literal that is no float, named by the last operand; else replace that operand."""
        value = self._straight.literals.get(id(operand)) if isinstance(operand, float) else None
        if value is None:
            operands[-1] = operand
        else:
            yield Load(str(operands[-1]), self._place_of(id(operand), value))

    def tangents(self, lines: Iterable[Line], states: int, stored: dict[Location, Location]) -> tuple[Line, ...]:
        """Return lines that compute the derivatives of stored numbers by every number of the start.

        Parameters
        ----------
        lines : iterable of Line
            As `lines` yields them.
        states : int
            Where in `y` the derivatives of the state begin, those of each number in a row.
        stored : mapping of Place to Place
            Where those of what is stored go.
        """
        uncertain = {
            self._places[address]: Location("p", (value - self._used) * self._seeds, ((SEED, 1),))
            for address, value in self._straight.constants.items()
            if isinstance(value, int) and address in self._places
        }

        def tangent_address(address: Location) -> Location | None:
            if address.array == "y":
                return Location("y", states + address.offset * self._seeds, ((SEED, 1),))
            return uncertain.get(address)

        return with_tangents([*lines], tangent_address, stored.__getitem__)

    def _place_of(self, key: Location | int, value: Value) -> Location:
        if key not in self._places:
            self._places[key] = Location("p", self.count)
            self._values.append(value)
        return self._places[key]

    def fill_certain(self, array: Floats) -> None:
        """Write the certain constants, and note the rows of uncertain ones."""
        for row in range(self._rows):
            constant, seed = divmod(row, self._seeds)
            array[row, :2] = float(seed == self._used + constant)
        for value, where in zip(self._values, array[self._rows :], strict=True):
            if isinstance(value, Location):
                self._step_places.append((value.offset, where))
            elif isinstance(value, int):
                self._uncertain.append((value, where))
            else:
                where[:2] = as_number(value)[:, 0]

    def fill_uncertain(self, start: Box, step_values: Floats) -> None:
        """Write the uncertain constants, and the constants of a step."""
        for i, row in self._uncertain:
            row[:2] = start[:, i]
        for i, row in self._step_places:
            row[:2] = step_values[i]


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
        """Return why a coefficient is undefined for some of the states."""
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
