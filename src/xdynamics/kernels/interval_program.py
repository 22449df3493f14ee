"""The event functions and their time derivatives as rows of numbers, which `march.events.enclosures` bounds.

The third printed form, besides Python and LLVM text: single assignments in the order written, but of values known only
to lie between two numbers. Nothing is compiled for it, so that a new model's first run does not wait.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.program import Compute, Load, Operand, Place
from xdynamics.model.detectors import GAP, followed, function_bend, function_rate, python_values
from xdynamics.model.motion import REGIME_NUMBER, constants, slope
from xdynamics.model.reactions import modes
from xdynamics.model.switches import told
from xdynamics.schema import acceleration, rate, velocity

# the functions that are called at the ends of an interval, by their place in a run's `functions`
CALLED = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log")
# operations; a row is an operation, the place of its value, and three places or numbers
ARITHMETIC = ("add", "subtract", "multiply", "divide", "negative", "sqrt", "abs", "least", "greatest", "sign")
COMPARED = ("less", "at_most", "more", "at_least", "equal", "unequal")
OPERATIONS = (*ARITHMETIC, "choose", *COMPARED, "hypot", "atan2", "power", "positive", *CALLED)
OPERATION = {name: i for i, name in enumerate(OPERATIONS)}
NUMBER, CONSTANT, TIME, PHASE, COORDINATE, STATE, VALUE, SLOPE, UNKNOWN = range(len(OPERATIONS), len(OPERATIONS) + 9)
UNUSED = -1
WIDTH = 5


@dataclass(frozen=True)
class Enclosing:
    """The rows of a model's event functions.

    Attributes
    ----------
    rows : ndarray of int64, shape (n, 5)
    numbers : ndarray of float64
        The literals.
    parts : (int, int, int, int)
        Where in `rows` these end: numbers, parameters and what follows from them alone; the functions; their
        derivatives; their second derivatives.
    values : int
        Number of places for values.
    functions, slopes, bends : tuple of int
        The place of each event function, of its derivative, and of a gap's second derivative.
    of_time : tuple of bool
        Whether each depends on time alone.
    """

    rows: NDArray[np.int64]
    numbers: NDArray[np.float64]
    parts: tuple[int, int, int, int]
    values: int
    functions: tuple[int, ...]
    slopes: tuple[int, ...]
    bends: tuple[int, ...]
    of_time: tuple[bool, ...]


@lru_cache(maxsize=64)
def enclosing(layout: Layout) -> Enclosing:
    """Print the event functions of a model, and their derivatives along the motion, as rows."""
    return _Printer(layout).printed()


class _Printer:
    """Gives every value of the assignments a place, and every assignment a row."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._places: dict[Operand, int] = {}
        self._numbers: list[float] = []
        self._first: list[tuple[int, ...]] = []  # of numbers and parameters alone, which a march does not change
        self._constant: set[int] = set()  # the places of their values
        self._rows: list[tuple[int, ...]] = []
        self._constants = {name: i for i, name in enumerate(constants(layout.model))}
        self._fixed = len(self._constants) - len(modes(layout.model)) - len(told(layout.model))
        self._python = python_values(layout.model)
        self._moving = self._variables()
        self._inner = {assignment.name: assignment.value for assignment in followed(layout.model)}

    def printed(self) -> Enclosing:
        """Print everything."""
        model = self._layout.model
        lines = Assignments(self._found)
        watched = self._layout.watched
        functions = [self._taken(lines, lines.value(detector.looked_at)) for detector in watched]
        middle = len(self._rows)
        slopes = [self._taken(lines, lines.value(function_rate(model, detector))) for detector in watched]
        wide = len(self._rows)
        bends = [
            self._taken(lines, lines.value(function_bend(model, detector))) if detector.role == GAP else UNUSED
            for detector in watched
        ]
        count, first = len(self._places), len(self._first)
        rows = np.array([*self._first, *self._rows], np.int64).reshape(-1, WIDTH)
        moving = {*self._layout.used, *self._layout.reactions}
        of_time = tuple(not (detector.sampled or model.reads(detector.function) & moving) for detector in watched)
        return Enclosing(
            rows,
            np.array(self._numbers),
            (first, first + middle, first + wide, len(rows)),
            count,
            tuple(functions),
            tuple(slopes),
            tuple(bends),
            of_time,
        )

    def _variables(self) -> Mapping[str, Callable[[int], tuple[int, ...]]]:
        """Return for each moving name a function that makes its row from the place of its value."""
        layout = self._layout
        makers: dict[str, Callable[[int], tuple[int, ...]]] = {"t": lambda at: (TIME, at, 0, 0, 0)}
        makers[REGIME_NUMBER] = lambda at: (PHASE, at, 0, 0, 0)
        for i, name in enumerate(layout.coordinates):
            for order, variable in enumerate((name, velocity(name), acceleration(name))):
                makers[variable] = lambda at, i=i, order=order: (COORDINATE, at, i, order, 0)  # type: ignore[misc]
        for i, name in enumerate(layout.states):
            for order, variable in enumerate((name, rate(name))):
                makers[variable] = lambda at, i=i, order=order: (STATE, at, i, order, 0)  # type: ignore[misc]
        for name in self._python:
            makers[name] = lambda at: (UNKNOWN, at, 0, 0, 0)
        return makers

    def _found(self, lines: Assignments, name: str) -> Operand:
        """Return the operand of a name in an expression."""
        if name in self._constants:
            return lines.load(Place("p", self._constants[name]), name)
        if name in self._moving:
            return lines.load(Place("moving", list(self._moving).index(name)), name)
        if name in self._inner:
            return lines.value(self._inner[name])  # type: ignore[arg-type]
        drive = name.removeprefix(slope(""))
        number = self._layout.drives.index(drive)
        return lines.compute(
            "value_at" if drive == name else "slope_at", lines.named(self._layout.model.drives[drive].argument), number
        )

    def _taken(self, lines: Assignments, value: Operand) -> int:
        """Turn the assignments so far into rows; return the place of a value."""
        for line in lines.lines:
            if isinstance(line, Load):
                self._load(line)
            elif isinstance(line, Compute):
                self._compute(line)
        lines.lines.clear()
        return self._place(value)

    def _load(self, line: Load) -> None:
        at = self._new(line.target)
        if line.place.array == "p":
            row = (CONSTANT, at, line.place.index, 0, 0)
            if line.place.index < self._fixed:
                self._first.append(row)
                self._constant.add(at)
            else:
                self._rows.append(row)
        else:
            self._rows.append(list(self._moving.values())[line.place.index](at))

    def _compute(self, line: Compute) -> None:
        if line.operation in ("value_at", "slope_at"):
            argument, number = line.arguments
            drive = list(self._layout.model.drives.values())[int(number)]
            row = (
                VALUE if line.operation == "value_at" else SLOPE,
                self._new(line.target),
                self._place(argument),
                int(number),
                int(drive.argument == "t"),
            )
            self._rows.append(row)
            return
        places = [self._place(argument) for argument in line.arguments]
        rows = self._first if self._constant.issuperset(places) else self._rows
        target = self._new(line.target)
        rows.append((OPERATION[line.operation], target, *places, *[0] * (3 - len(places))))
        if rows is self._first:
            self._constant.add(target)

    def _place(self, value: Operand) -> int:
        """Return the place of a value; a number gets one when it first occurs."""
        key = value if isinstance(value, str) else repr(float(value))
        if key not in self._places:
            self._first.append((NUMBER, self._new(key), len(self._numbers), 0, 0))
            self._constant.add(self._places[key])
            self._numbers.append(float(value))
        return self._places[key]

    def _new(self, value: Operand) -> int:
        return self._places.setdefault(value, len(self._places))
