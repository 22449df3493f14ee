"""Taylor coefficients of a motion as intervals, by the recurrences of every operation, with their derivatives by the start.

The recurrences are those of method `taylor`, which write programs; here the values that they are told of are numbers.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from xdynamics.kernels.jets.coefficients import Coefficients, Env
from xdynamics.kernels.jets.motion import Motion
from xdynamics.kernels.jets.series import Series
from xdynamics.kernels.program import Compute, Line, Load, Operand, Place, Program, StoreTo
from xdynamics.tubes import boxes, gradients
from xdynamics.tubes.boxes import Box
from xdynamics.tubes.gradients import Undefined, Value


class UndefinedError(Exception):
    """A coefficient is not known to exist for all states of a set."""


@dataclass(frozen=True)
class Motions:
    """The lines of a program that a motion follows from, and what they read besides the state.

    Attributes
    ----------
    lines : sequence of Line
    motion : Motion
    constants : mapping of Place to Value
        What is read and does not change: a float, an interval, or the number of what is uncertain in it.
    literals : mapping of int to Value
        The exact values of the operands that are numbers, by their identity.
    """

    lines: Sequence[Line]
    motion: Motion
    constants: Mapping[Place, Value]
    literals: Mapping[int, Value]


class _Order:
    """One order of series whose coefficients are numbers; see `kernels.jets.series.Order`."""

    def __init__(self, rows: dict[int, Box], degree: int, derivatives: int) -> None:
        self.k = 0
        self.rows, self._shape = rows, (2, degree + 1, 1 + derivatives)
        self._lacking: dict[int, Undefined] = {}  # why a series has no further coefficients
        self.constants: Mapping[Place, Value] = {}

    @property
    def number(self) -> float:
        """The order as a number."""
        return float(self.k)

    def compute(self, operation: str, *arguments: Value) -> Value:
        """Compute one operation, unless what it gives is known: of zeros that series have beyond their ends."""
        if len(arguments) == 2 and (float in (type(arguments[0]), type(arguments[1]))):
            known = _known(operation, *arguments)
            if known is not None:
                return known
        return gradients.of(operation, *arguments)

    def first(self, series: Series) -> Value:
        """Return the coefficient of order 0."""
        return series.terms[0]

    def second(self, series: Series) -> Value:
        """Return the coefficient of order 1."""
        return self._term(series, 1)

    def now(self, series: Series) -> Value:
        """Return the coefficient of this order."""
        return self._term(series, self.k)

    def _term(self, series: Series, k: int) -> Value:
        return series.terms.get(k, 0.0) if series.constant else series.terms[k]

    def convolution(self, a: Series, b: Series, *, skip: int = 0) -> Value:
        """Sum the products, ascending; those of a series with itself in pairs."""
        k = self.k
        first, last = min(skip, 1), k - (skip == 2)
        if last < first:
            return 0.0
        for series in (a, b):
            if (lacking := self._lacking.get(id(series))) is not None:
                return lacking
        if a.constant or b.constant or first == last == 0:
            j = 0 if a.constant else k
            return self.compute("multiply", self._term(a, j), self._term(b, k - j)) if first <= j <= last else 0.0
        if a is b and first == k - last:
            return self._square(a, first)
        return _sum_of_products(self.rows[id(a)][:, first : last + 1], self.rows[id(b)][:, k - last : k - first + 1])

    def _square(self, a: Series, first: int) -> Value:
        k, row = self.k, self.rows[id(a)]
        half = (k + 1) // 2
        found: Value = 0.0
        if half > first:
            found = 2.0 * _sum_of_products(row[:, first:half], row[:, k - half + 1 : k - first + 1])
        return found if k % 2 else self.compute("add", found, gradients.square(row[:, k // 2]))

    def part(self, owner: Series, name: str) -> Series:
        """Return a series that is computed along with another."""
        return owner.parts.setdefault(name, Series())

    def keep(self, series: Series, value: Value) -> None:
        """Let a value be the coefficient of this order."""
        series.terms[self.k] = value
        if isinstance(value, Undefined):
            self._lacking.setdefault(id(series), value)
        elif not series.constant and not isinstance(value, bool):
            row = self.rows.get(id(series))
            if row is None:
                row = self.rows[id(series)] = np.zeros(self._shape)
            if isinstance(value, float):
                row[:, self.k, 0] = value
            else:
                row[:, self.k, : value.shape[1]] = value

    def knows(self, series: Series) -> bool:
        """Whether the coefficient of this order is computed."""
        return self.k in series.terms

    def read(self, place: Place) -> Value:
        """Return a number that does not change."""
        return self.constants[place]


def _known(operation: str, a: Value, b: Value) -> Value | None:
    """Return what an operation with a zero or a one gives; None of others."""
    of_a, of_b = type(a) is float, type(b) is float
    match operation:
        case "add" if of_a and a == 0.0:
            return b
        case "add" | "subtract" if of_b and b == 0.0:
            return a
        case "subtract" if of_a and a == 0.0:
            return gradients.of("negative", b)
        case "multiply" | "divide" if of_b and b == 1.0:
            return a
        case "multiply" if of_a and a == 1.0:
            return b
        case "multiply" if of_a and a == 0.0 and not isinstance(b, Undefined):
            return 0.0
        case "multiply" if of_b and b == 0.0 and not isinstance(a, Undefined):
            return 0.0
        case "divide" if of_a and of_b and a == 0.0 and b != 0.0:
            return 0.0
    return None


def _sum_of_products(a: Box, b: Box) -> Box:
    """Sum the products of the numbers of one row with those of another, which runs backwards."""
    b = b[:, ::-1]
    found = boxes.total(boxes.multiply(a[:, :, :1], b))
    if a.shape[2] > 1:
        found[:, 1:] = boxes.add(found[:, 1:], boxes.total(boxes.multiply(b[:, :, :1], a[:, :, 1:])))
    return found


class _Numbers(Coefficients):
    """Series of a program's values, whose coefficients are numbers."""

    def __init__(self, motions: Motions, degree: int, states: Sequence[Series], time: Series) -> None:
        super().__init__(Program("", "", ()), motions.motion, degree, 0)
        self._literals, self._states, self.time = motions.literals, states, time

    def state(self, place: Place) -> Series:
        """Return the series of a number of the state."""
        return self._states[place.offset]

    def value(self, env: Env, operand: Operand) -> Series:
        """Return the series of an operand."""
        if isinstance(operand, str):
            return env[operand]
        return Series(constant=True, terms={0: self._literals.get(id(operand), operand)})


@np.errstate(all="ignore")  # what overflows is found at the end
def coefficients(motions: Motions, time: Box, start: Box, degree: int, *, derivatives: bool = False) -> Box:
    """Return the Taylor coefficients of the motions from every state of a set.

    Parameters
    ----------
    motions : Motions
    time : ndarray, shape (2,)
    start : ndarray, shape (2, numbers)
        Coordinates, velocities, states, then uncertain constants, which do not change.
    degree : int
    derivatives : bool
        Whether to add the derivatives by every number of the start.

    Returns
    -------
    ndarray, shape (2, degree + 1, numbers of the state, 1 or 1 + numbers)

    Raises
    ------
    UndefinedError
        If one of them may not exist, or is beyond the range of floats.
    """
    numbers, used = start.shape[1], motions.motion.used
    n = numbers if derivatives else 0
    given = [seed(start[:, i], i, n) for i in range(numbers)]
    order = _Order({}, degree, n)
    order.constants = {
        place: given[value] if isinstance(value, int) else value for place, value in motions.constants.items()
    }
    clock, states = Series(), [Series() for _ in range(used)]
    for order.k in range(degree + 1):
        order.keep(clock, time.reshape(2, 1) if order.k == 0 else float(order.k == 1))
    order.k = 0
    for series, value in zip(states, given, strict=False):
        order.keep(series, value)
    write, env = _Numbers(motions, degree, states, clock), Env()
    for k in range(degree):
        order.k = k
        raised = _raised(write, order, env, motions)
        order.k = k + 1
        for series, slope in zip(states, raised, strict=True):
            if isinstance(slope, Undefined):
                raise UndefinedError(slope.reason)
            order.keep(series, order.compute("divide", slope, order.number))
    found = np.stack([order.rows[id(series)] for series in states], axis=2)
    if not np.isfinite(found).all():
        raise UndefinedError("a number is beyond the range of floats")
    return found


def seed(value: Box, place: int, derivatives: int) -> Box:
    """Return a number of the start: its derivative by itself is 1."""
    seed = np.zeros((2, 1 + derivatives))
    seed[:, 0] = value
    if derivatives:
        seed[:, 1 + place] = 1.0
    return seed


def _raised(write: _Numbers, order: _Order, env: Env, motions: Motions) -> list[Value]:
    """Compute what every number of the state rises by at one order."""
    motion = motions.motion
    n = motion.coordinates
    raised: list[Value] = [order.now(write.state(Place("y", n + i))) for i in range(n)]
    raised += [0.0] * (n + motion.states)
    for line in motions.lines:
        match line:
            case Load():
                write.load(order, env, line)
            case Compute():
                write.compute(order, env, line)
            case StoreTo():
                raised[motion.raised_by(line.place.offset)] = order.now(write.value(env, line.value))
    return raised
