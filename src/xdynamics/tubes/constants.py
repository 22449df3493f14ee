"""What a program for intervals reads besides the state: constants, and literals that no float is, at places of their own."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from xdynamics.kernels.program import Compute, Line, Load, Location, Operand, StoreTo
from xdynamics.tubes.boxes import Box, Floats
from xdynamics.tubes.gradients import NOW, StraightLines, Value, as_number
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
        """Yield what reads a literal that no float is, to the name that is last; else put the operand there."""
        value = self._straight.literals.get(id(operand)) if isinstance(operand, float) else None
        if value is None:
            operands[-1] = operand
        else:
            yield Load(str(operands[-1]), self._place_of(id(operand), value))

    def tangents(self, lines: Iterable[Line], states: int, stored: dict[Location, Location]) -> tuple[Line, ...]:
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
        """Write what is certain, and note where what is not goes."""
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
        """Write what is uncertain, and what holds for a step."""
        for i, row in self._uncertain:
            row[:2] = start[:, i]
        for i, row in self._step_places:
            row[:2] = step_values[i]
