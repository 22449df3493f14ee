"""What a program for intervals reads besides the state: constants, and literals that no float is, at places of their own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from xdynamics.kernels.program import Compute, Line, Load, Operand, Place, StoreTo
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.gradients import NOW, StraightLines, Value, number
from xdynamics.tubes.step_constants import HELD
from xdynamics.tubes.tangents import SEED, with_tangents


class Constants:
    """Places in `p`: rows of derivatives of what is uncertain, then what lines read, and literals that no float is.

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
        self._places: dict[Place | int, Place] = {}
        self._uncertain: list[tuple[int, Floats]] = []
        self._held: list[tuple[int, Floats]] = []

    @property
    def count(self) -> int:
        """How many there are."""
        return self._rows + len(self._values)

    def lines(self) -> Iterator[Load | Compute | StoreTo]:
        """Yield the lines, which read every constant from where it is."""
        for line in self._straight.lines:
            match line:
                case Load() if line.place.array == "y" or line.place == NOW:
                    yield line
                case Load():
                    held = line.place.array == HELD
                    value = line.place if held else self._straight.constants[line.place]
                    yield Load(line.target, self._at(line.place, value))
                case Compute():
                    given: list[Operand] = []
                    for operand in line.arguments:
                        given.append(f"{line.target}.literal{len(given)}")
                        yield from self._literal(given, operand)
                    yield Compute(line.target, line.operation, tuple(given))
                case StoreTo():
                    given = [f"_stored{line.place.offset}"]
                    yield from self._literal(given, line.value)
                    yield StoreTo(line.place, given[0])

    def _literal(self, given: list[Operand], operand: Operand) -> Iterator[Load]:
        """Yield what reads a literal that no float is, to the name that is last; else put the operand there."""
        value = self._straight.literals.get(id(operand)) if isinstance(operand, float) else None
        if value is None:
            given[-1] = operand
        else:
            yield Load(str(given[-1]), self._at(id(operand), value))

    def tangents(self, lines: Iterable[Line], states: int, stored: dict[Place, Place]) -> tuple[Line, ...]:
        """Return lines that compute the derivatives of what lines store, by every number of the start.

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
            self._places[place]: Place("p", (value - self._used) * self._seeds, ((SEED, 1),))
            for place, value in self._straight.constants.items()
            if isinstance(value, int) and place in self._places
        }

        def read(place: Place) -> Place | None:
            if place.array == "y":
                return Place("y", states + place.offset * self._seeds, ((SEED, 1),))
            return uncertain.get(place)

        return with_tangents([*lines], read, stored.__getitem__)

    def _at(self, key: Place | int, value: Value) -> Place:
        if key not in self._places:
            self._places[key] = Place("p", self.count)
            self._values.append(value)
        return self._places[key]

    def fill(self, array: Floats) -> None:
        """Write what is certain, and note where what is not goes."""
        for row in range(self._rows):
            constant, seed = divmod(row, self._seeds)
            array[row, :2] = float(seed == self._used + constant)
        for value, where in zip(self._values, array[self._rows :], strict=True):
            if isinstance(value, Place):
                self._held.append((value.offset, where))
            elif isinstance(value, int):
                self._uncertain.append((value, where))
            else:
                where[:2] = number(value)[:, 0]

    def take(self, start: Box, held: Floats) -> None:
        """Write what is uncertain, and what holds for a step."""
        for i, place in self._uncertain:
            place[:2] = start[:, i]
        for i, place in self._held:
            place[:2] = held[i]
