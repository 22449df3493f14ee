"""The motion in a program of forces: the places of its numbers, and the lines that its coefficients need."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from xdynamics.kernels.jets.recurrences import CONSTANT, OTHER, RULES, Order, Series
from xdynamics.kernels.program import (
    AT,
    Compute,
    Gather,
    Instruction,
    Line,
    Load,
    Location,
    Loop,
    Operand,
    Ordinal,
    Program,
    Reduction,
    StoreTo,
)
from xdynamics.kernels.python_text import COMPARISONS

# operations up to which every coefficient is a value of the text: beyond, a step's code is more than what a processor
# keeps of code beside it (32 KB), and is read again in every step
WRITTEN_OUT = 1750
# the same where operations are not fused, counted by themselves: archives of 31 digits have their program by this
PLAIN_WRITTEN_OUT = 6000
LINEAR = frozenset(("add", "subtract", "negative", "choose", "least", "greatest", "abs", "positive", *CONSTANT))


class UnexpandedError(Exception):
    """A program whose values have no series: a function in Python, a call of the engine, the greatest of elements in loops."""


@dataclass(frozen=True)
class Motion:
    """Where a program of forces has its numbers.

    Attributes
    ----------
    coordinates, states : int
        How many there are: a state is coordinates, velocities and states, and results follow it in `z`: accelerations
        and rates.
    """

    coordinates: int
    states: int

    @property
    def used(self) -> int:
        """Numbers of a state."""
        return 2 * self.coordinates + self.states

    @property
    def slopes(self) -> range:
        """Places in `z` of accelerations and rates."""
        return range(self.used, self.used + self.coordinates + self.states)

    def has_slope(self, location: Location) -> bool:
        """Whether a location holds accelerations or rates, in a loop over all of them."""
        return location.array == "z" and location.offset in self.slopes

    def raised_by(self, slope_index: int) -> int:
        """Return the index of the number of the state whose derivative has an index of `z`."""
        return slope_index - self.used + self.coordinates


def needed_lines(body: Iterable[Instruction], motion: Motion) -> tuple[Line, ...]:
    """Return the lines that accelerations and rates follow from.

    Raises
    ------
    UnexpandedError
        If a line is a call, whose results have no series.
    """
    lines: list[Line] = []
    for line in body:
        if not isinstance(line, Line):
            raise UnexpandedError(type(line).__name__)
        lines.append(line)
    return _lines_leading_to(lines, motion, set(), set())


def _lines_leading_to(body: Sequence[Line], motion: Motion, names: set[str], arrays: set[str]) -> tuple[Line, ...]:
    """Return the lines that some names, and some arrays, follow from; both are added to."""
    kept_lines: list[Line] = []
    # from the end, so that what a line gives is known to be needed before the line is met
    for line in reversed(body):
        kept_line: Line = line
        match line:
            case Load() | Ordinal() | Compute():
                is_needed = line.target in names
            case StoreTo():
                is_needed = line.location.array in arrays or motion.has_slope(line.location)
            case Gather():
                is_needed = True
            case Loop():
                inner = _lines_leading_to(line.body, motion, names, arrays)
                is_needed, kept_line = any(not isinstance(part, Gather) for part in inner), replace(line, body=inner)
            case Reduction():
                is_needed = not names.isdisjoint(line.totals)
                if is_needed:
                    names |= {name for name in (*line.terms, *line.starts, line.where) if isinstance(name, str)}
                    kept_line = replace(line, body=_lines_leading_to(line.body, motion, names, arrays))
        if not is_needed:
            continue
        kept_lines.append(kept_line)
        if isinstance(line, Compute):
            names |= {name for name in line.arguments if isinstance(name, str)}
        elif isinstance(line, StoreTo) and isinstance(line.value, str):
            names.add(line.value)
        elif isinstance(line, Load):
            arrays.add(line.location.array)
    return tuple(kept_lines[::-1])


def is_small(body: Sequence[Line], degree: int, *, fused: bool) -> bool:
    """Whether the coefficients of all values are few enough to be written out."""
    if any(isinstance(line, Loop | Reduction) for line in body):
        return False
    if not fused:
        operation_counts = Counter(line.operation for line in body if isinstance(line, Compute))
        plain = sum(operation_counts[name] for name in ("add", "subtract", "negative", *CONSTANT))
        return plain * degree + (operation_counts.total() - plain) * degree * degree <= PLAIN_WRITTEN_OUT
    convolution, operations, still = (degree * degree / 2 + degree), 0.0, set[Operand]()
    for line in body:
        match line:
            case Load() if line.location.array == "p":
                still.add(line.target)
            case Compute():
                changing = [entry for entry in line.arguments if isinstance(entry, str) and entry not in still]
                operations += convolution * _convolutions(line.operation, changing)
                if not changing:
                    still.add(line.target)
    return operations <= WRITTEN_OUT


def _convolutions(operation: str, changing: Sequence[Operand]) -> float:
    """Return how many sums of products a coefficient is made of; sums of multiples are hardly more operations."""
    if operation in LINEAR or not changing:
        return 0.0
    match operation, changing:
        case "multiply", (_,):
            return 0.0
        case "multiply", (a, b):
            return 0.5 if a == b else 1.0
        case "sqrt", _:
            return 0.5
        case "divide", _:
            return 1.0
        case (("exp" | "sin" | "cos"), _):
            return 1.4  # with the slope of the argument
    return 2.0


Env = dict[str, Series]


class Coefficients(ABC):
    """The common part of both ways of writing: series by the names of values, and their next coefficients.

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
