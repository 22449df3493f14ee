"""The lines that compute the next coefficient of every value of a program."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from xdynamics.kernels.jets.motion import Motion, UnexpandedError
from xdynamics.kernels.jets.recurrences import CONSTANT, OTHER, RULES
from xdynamics.kernels.jets.series import Order, Series
from xdynamics.kernels.operations import COMPARISONS
from xdynamics.kernels.program import AT, Compute, Line, Load, Location, Operand, Program

Env = dict[str, Series]


class Coefficients(ABC):
    """What both ways of writing share: series by the names of a program's values, and their next coefficients.

    Attributes
    ----------
    lines : list of Line
    memory : int
        Where in `w` what is used ends.
    views, tables : dict
        Parts of `w` with names of their own, and whole numbers, as of a program.
    """

    def __init__(self, forces: Program, motion: Motion, degree: int, first: int, *, fused: bool) -> None:
        self.lines: list[Line] = []
        self.fused = fused
        self.motion, self.degree, self.first = motion, degree, first
        self.memory = first + (degree + 1) * motion.used
        self.local = forces.local
        self.time = Series()
        self.views: dict[str, tuple[str, int, int]] = {}
        self.tables: dict[str, tuple[int, ...]] = {}

    @abstractmethod
    def state(self, location: Location) -> Series:
        """Return the series of a number of the state."""

    def value(self, env: Env, operand: Operand) -> Series:
        """Return the series of an operand."""
        return env[operand] if isinstance(operand, str) else Series(constant=True, terms={0: operand})

    def load(self, order: Order, env: Env, line: Load) -> None:
        """Begin the series of a number that is read."""
        if line.target in env:
            return
        location = line.location
        if location.array == "y":
            env[line.target] = self.state(location)
        elif location.array == "at" and location.offset == AT.index("t"):
            env[line.target] = self.time
        else:
            env[line.target] = series = Series(constant=True)
            order.keep(series, order.read(location))

    def compute(self, order: Order, env: Env, line: Compute) -> None:
        """Write the coefficient of a value."""
        name = line.operation
        tables = name in ("value_at", "slope_at", "find_piece", "piece_of")
        operands = [*line.arguments[:-1]] if tables else [*line.arguments]
        series = [self.value(env, operand) for operand in operands]
        numbers = [*line.arguments[-1:]] if tables else []
        is_begun = line.target in env
        if not is_begun:
            self.begin(order, env, line, series, numbers)
        target = env[line.target]
        if target.constant or not is_begun or order.knows(target):
            return
        order.keep(target, RULES[name].following(order, target, *series, *numbers))

    def begin(
        self, order: Order, env: Env, line: Compute, series: Sequence[Series], numbers: Sequence[Operand]
    ) -> None:
        """Write the value itself, which is the coefficient of order 0.

        Raises
        ------
        UnexpandedError
            If there are no series of what the operation gives.
        """
        name = line.operation
        still = name in CONSTANT or all(entry.constant for entry in series)
        if not still and name not in RULES:
            raise UnexpandedError(name)
        partner = env.get(f"{OTHER[name]} {line.arguments[0]}") if name in OTHER else None
        if partner is not None and not still:
            env[line.target] = order.part(partner, name)
            return
        env[line.target] = target = Series(still, name in COMPARISONS)
        order.keep(target, order.compute(name, *map(order.first, series), *numbers))
        if not still:
            RULES[name].beginning(order, target, *series, *numbers)
            env[f"{name} {line.arguments[0]}"] = target
