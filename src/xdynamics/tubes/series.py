"""Taylor coefficients of a motion as intervals, with their derivatives by the start.

Coefficients follow from the recurrences of every operation. The program is that of method `taylor`, printed for
intervals; derivatives are series of their own, those of the tangents
of its values, in a loop over the numbers of the start.

Besides the state such a program reads constants, and literals that are no floats, from places of their own.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from xdynamics.elementary.bounds import Interval
from xdynamics.kernels.jets.expansion import expansion
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Loop, Operand, Program, StoreTo, T
from xdynamics.tubes.boxes import HELD, Box, Floats
from xdynamics.tubes.tangents import SEED, EnclosedProgram, with_tangents
from xdynamics.tubes.undefined import undefined_reason

NOW = Location("at", T)
Value = float | Box | int | Location  # exact, an interval, the number of what is uncertain in a set, or where in `HELD`


@dataclass(frozen=True)
class StraightLines:
    """Straight lines of a program, and the constants that they read besides the state.

    Attributes
    ----------
    lines : sequence of Line
    constants : mapping of Location to Value
        What is read and never changes: a float, an interval, or the number of what is uncertain in it.
    literals : mapping of int to ndarray, shape (2,)
        Intervals of the operands that are numbers and no floats, by their identity.
    """

    lines: Sequence[Line]
    constants: Mapping[Location, Value]
    literals: Mapping[int, Box]


class Inputs:
    """What a program reads of a set: the time in `at`, the state and its derivatives in `y`, constants in `p`.

    In `p` are derivative rows of uncertain numbers, then constants, then literals that are no floats.

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
    def sizes(self) -> dict[str, int]:
        """How many intervals each array has, once all lines are written."""
        return {"at": len(AT), "y": self._used * (1 + self._seeds), "p": self._rows + len(self._values)}

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

    def tangents(self, lines: Iterable[Line], stored: dict[Location, Location]) -> tuple[Line, ...]:
        """Return lines that compute the derivatives of stored numbers by every number of the start.

        Parameters
        ----------
        lines : iterable of Line
            As `lines` yields them.
        stored : mapping of Location to Location
            Where those of what is stored go.
        """

        def tangent_address(address: Location) -> Location | None:
            if address.array == "y":
                return Location("y", self._used + address.offset * self._seeds, ((SEED, 1),))
            if (number := self._uncertain_at(address)) is not None:
                return Location("p", (number - self._used) * self._seeds, ((SEED, 1),))
            return None

        return with_tangents([*lines], tangent_address, stored.__getitem__)

    def varies(self, address: Location) -> bool:
        """Whether a number that `lines` read depends on the start or on time."""
        return address.array == "y" or address == NOW or self._uncertain_at(address) is not None

    def _uncertain_at(self, address: Location) -> int | None:
        """Return which number of a set is the constant at a place in `p`; None of a certain one."""
        value = self._values[address.offset - self._rows] if address.array == "p" else None
        return value if isinstance(value, int) else None

    def _place_of(self, key: Location | int, value: Value) -> Location:
        if key not in self._places:
            self._places[key] = Location("p", self._rows + len(self._values))
            self._values.append(value)
        return self._places[key]

    def allocate(self, arrays: Mapping[str, Floats]) -> None:
        """Take a program's arrays, and write what is the same of every set: certain constants, and seeds."""
        self._time, self._state, constants = arrays["at"][T], arrays["y"], arrays["p"]
        for row in range(self._rows):
            constant, seed = divmod(row, self._seeds)
            constants[row, :2] = float(seed == self._used + constant)
        for value, where in zip(self._values, constants[self._rows :], strict=True):
            if isinstance(value, Location):
                self._step_places.append((value.offset, where))
            elif isinstance(value, int):
                self._uncertain.append((value, where))
            else:
                where[:2] = value
        for i in range(self._used if self._seeds else 0):
            self._state[self._used + i * self._seeds + i, :2] = 1.0

    def fill(self, time: Box, states: Box, step_values: Floats) -> None:
        """Write a set: its times, states and uncertain constants, and the constants of a step."""
        self._time[:2], self._state[: self._used, :2] = time, states[:, : self._used].T
        for i, row in self._uncertain:
            row[:2] = states[:, i]
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
        self._degree = degree
        self._used, self._seeds = motions.motion.used, numbers if derivatives else 0
        self._inputs = inputs = Inputs(motions.straight, self._used, numbers, self._seeds)
        lines = tuple(_as_states(motions, inputs, self._seeds))
        motion = Motion(0, self._used * (1 + self._seeds))
        series_program = expansion(Program("forces", "", lines), motion, degree, written_out=False)
        self._program = EnclosedProgram(series_program.program, inputs.sizes | {"w": series_program.memory})
        inputs.allocate(self._program.arrays)
        self._coefficients = self._program.arrays["w"][: (degree + 1) * motion.used].reshape(degree + 1, motion.used, 3)

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
        self._inputs.fill(time, start, step_values)
        self._program.run()
        if self._coefficients[..., 2].any() or not np.isfinite(self._coefficients).all():
            raise UndefinedError(self._reason())
        coefficients = np.empty((2, self._degree + 1, used, 1 + self._seeds))
        for end in range(2):
            coefficients[end, :, :, 0] = self._coefficients[:, :used, end]
            coefficients[end, :, :, 1:] = self._coefficients[:, used:, end].reshape(self._degree + 1, used, self._seeds)
        return coefficients

    def _reason(self) -> str:
        """Return why a coefficient is undefined for some of the states that the program has been run for."""
        arrays = self._program.arrays

        def read(location: Location) -> Interval:
            low, high = arrays[location.array][location.offset, :2].tolist()
            return Interval(low, high)

        reason = undefined_reason([*self._inputs.lines()], read, self._inputs.varies)
        return reason or "a number is beyond the range of floats"


def _as_states(motions: Motions, inputs: Inputs, seeds: int) -> Iterator[Line]:
    """Yield the lines of equations of first order, of all numbers of a state and of their derivatives."""
    motion, used = motions.motion, motions.motion.used
    rates = used * (1 + seeds)  # where in `z` they begin
    lines: list[Line] = []
    for i in range(motion.coordinates):
        velocity = f"_velocity{i}"
        lines += [Load(velocity, Location("y", motion.coordinates + i)), StoreTo(Location("z", rates + i), velocity)]
    for line in inputs.lines():
        if isinstance(line, StoreTo):
            line = replace(line, location=Location("z", rates + motion.raised_by(line.location.offset)))  # noqa: PLW2901
        lines.append(line)
    yield from lines
    if seeds:
        tangents = {
            Location("z", rates + i): Location("z", rates + used + i * seeds, ((SEED, 1),)) for i in range(used)
        }
        yield Loop(SEED, seeds, inputs.tangents(lines, tangents))
