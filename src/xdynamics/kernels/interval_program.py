"""The event functions and their time derivatives as a program of intervals: rows of numbers, or lines for lanes.

A row is an operation, the place of its value, and up to three places of operands; `march.events.enclosures` goes
through rows one by one, so that a new model's first run waits for nothing to be compiled. Printed as calls they would
take 0.6 ms a row, 0.3 s of the woodpecker and 1 s of three discs in a box, and would be no faster. In lanes the same
rows are printed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import FUNCTIONS
from xdynamics.elementary.bounds import POLYNOMIALS, on_curve
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.layout import Layout, curve_degree
from xdynamics.kernels.program import INTERVAL, REGIME, Compute, Load, Location, Operand
from xdynamics.model.delays import is_before, slope_before
from xdynamics.model.detectors import GAP, differentiated_reactions, function_bend, function_rate, python_values
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import constant_names, drive_slope
from xdynamics.model.reactions import mode_names
from xdynamics.model.regime_model import switch_inputs
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.schema import acceleration, rate, velocity

# operations of `elementary.intervals` by their number of operands
COMPARED = ("less", "at_most", "more", "at_least", "equal", "unequal")
ARITHMETIC = {
    **dict.fromkeys(("add", "subtract", "multiply", "divide", "least", "greatest", "mod", *COMPARED), 2),
    **dict.fromkeys(("square", "negative", "sqrt", "abs", "sign", "positive", "floor", "ceil", "round"), 1),
    "choose": 3,
}
CALLED = {name: 2 if name in ("hypot", "atan2", "power") else 1 for name in FUNCTIONS}
# variables, each by which of the places of the state that they are enclosed by has the error that counts
VARIABLES = {
    "position": 0,
    "velocity": 1,
    "acceleration": 0,
    "state": 0,
    "rate": 0,
    "velocity_slope": 0,
    "state_slope": 0,
}
# of a rate that the slopes of event functions alone need, which is the slope of the polynomial that a step leaves
SLOPES = {"acceleration": "velocity_slope", "rate": "state_slope"}
OPERANDS = ARITHMETIC | CALLED | {name: 2 if name in ("state", "rate", "state_slope") else 3 for name in VARIABLES}
RULES = tuple(OPERANDS)
OPERATIONS = (*RULES, "number", "constant", "time", "regime", "unknown", "value_at", "slope_at")
VARIABLE, NUMBER, CONSTANT, TIME, PHASE, UNKNOWN, VALUE, SLOPE = (
    OPERATIONS.index(name) for name in ("position", *OPERATIONS[len(RULES) :])
)
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

    @property
    def looked_at(self) -> list[list[int]]:
        """The rows that the functions themselves need."""
        rows: list[list[int]] = self.rows[: self.parts[1]].tolist()
        return rows


@lru_cache(maxsize=64)
def enclosing_rows(layout: Layout) -> Enclosing:
    """Print the event functions of a model, and their derivatives along the motion, as rows."""
    return _IntervalPrinter(layout).printed_rows()


def can_be_watched(layout: Layout) -> bool:
    """Return whether all event functions consist of operations that can be printed: no table, no Python function."""
    return all(row[0] < UNKNOWN for row in enclosing_rows(layout).looked_at)


def write_bounds(
    layout: Layout, width: Operand, begin: Operand, end: Operand, curve: int
) -> tuple[list[Compute | Load], list[tuple[str, str]]]:
    """Write lines that bound the event functions between the state `y` and the state `z`.

    Parameters
    ----------
    layout : Layout
    width, begin, end : operand
        Size of the step, and the times at its ends.
    curve : int
        Where in `w` the coefficients of the step's polynomial begin, if it leaves one.

    Returns
    -------
    list of instruction
    list of (str, str)
        Lower and upper bound of each function.
    """
    program, lines, degree = enclosing_rows(layout), list[Compute | Load](), curve_degree(layout)
    powers = range(degree + 1)

    def load_value(location: Location) -> str:
        lines.append(Load(f"_b{len(lines)}", location))
        return lines[-1].target

    for number, target, *places in program.looked_at:
        name, operands = OPERATIONS[number], tuple[Operand, ...]()
        if number < VARIABLE:
            operands = tuple(f"_i{slot}" for slot in places[: OPERANDS[name]])
        elif name in VARIABLES:
            owned = places[: OPERANDS[name]]
            if degree:
                terms = [power * layout.used.size + owner for owner in owned[: POLYNOMIALS[name]] for power in powers]
                numbers = [
                    *(Location("w", curve + term) for term in terms),
                    *(Location(k, i) for i in owned for k in "yz"),
                ]
                name, operands = on_curve(name), (*map(load_value, numbers), width, 0.0, 0.0, width, 0.0, 1.0)
            else:
                operands = (*(load_value(Location(state, slot)) for state in "yz" for slot in owned), width, 0.0, 0.0)
        elif number == NUMBER:
            name, operands = "point", (float(program.numbers[places[0]]),)
        elif number == TIME:
            name, operands = "between", (begin, end)
        else:
            name, operands = (
                "point",
                (load_value(Location("p", places[0]) if number == CONSTANT else Location("at", REGIME)),),
            )
        lines.append(Compute(f"_i{target}", name, operands, INTERVAL))
    ends = [(f"under{i}", f"over{i}") for i in range(len(program.functions))]
    for names, slot in zip(ends, program.functions, strict=True):
        lines += [
            Compute(name, end, (f"_i{slot}",), INTERVAL) for name, end in zip(names, ("low", "high"), strict=True)
        ]
    return lines, ends


def squared(line: Compute) -> Compute:
    """Return a product of a number with itself as its square.

    A product of intervals takes its factors for independent, and would make [-1, 1] of the square of [-1, 1].
    """
    if line.operation == "multiply" and line.arguments[0] == line.arguments[1]:
        return replace(line, operation="square", arguments=line.arguments[:1])
    return line


class _IntervalPrinter:
    """Gives every value of the assignments a slot, and every assignment a row."""

    def __init__(self, layout: Layout) -> None:
        self._layout = layout
        self._places: dict[Operand, int] = {}
        self._numbers: list[float] = []
        self._first: list[tuple[int, ...]] = []  # of numbers and parameters alone, which a march does not change
        self._constant: set[int] = set()  # the places of their values
        self._rows: list[tuple[int, ...]] = []
        self._constants = constant_names(layout.model)
        # modes and inputs of switches stand last among the constants, and change during a march
        self._fixed = len(self._constants) - len(mode_names(layout.model)) - len(switch_inputs(layout.model))
        variables = self._moving_variables() if layout.watched else {}
        self._moving = {name: slot for slot, name in enumerate(variables)}
        self._computed = [*variables.values()]
        self._inner = {assignment.name: assignment.value for assignment in differentiated_reactions(layout.model)}

    def printed_rows(self) -> Enclosing:
        """Return the rows of all watched functions and of what they read, each an interval operation on earlier rows."""
        model = self._layout.model
        lines = Assignments(self._operand_of_name)
        watched = self._layout.watched
        functions = [self._convert_to_rows(lines, lines.value(detector.looked_at)) for detector in watched]
        middle, curved = len(self._rows), curve_degree(self._layout) > 0
        slopes = [
            self._convert_to_rows(lines, lines.value(function_rate(model, detector)), of_slopes=curved)
            for detector in watched
        ]
        wide = len(self._rows)
        bends = [
            self._convert_to_rows(lines, lines.value(function_bend(model, detector)), of_slopes=curved)
            if detector.role == GAP
            else UNUSED
            for detector in watched
        ]
        count, first = len(self._places), len(self._first)
        rows = np.array([*self._first, *self._rows], np.int64).reshape(-1, WIDTH)
        moving = {*self._layout.used, *self._layout.reactions} if watched else set[str]()
        of_time = tuple(
            not (detector.sampled or model.elements.reads(detector.function) & moving) for detector in watched
        )
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

    def _moving_variables(self) -> Mapping[str, tuple[int, ...]]:
        """Return the operation of each moving name's row, and the indices of the state that it reads."""
        record, moving_variables = (
            self._layout.record,
            dict[str, tuple[int, ...]](t=(TIME,)) | {REGIME_NUMBER: (PHASE,)},
        )
        for first, owners, derivatives in (
            (VARIABLE, self._layout.coordinates, (velocity, acceleration)),
            (VARIABLE + 3, self._layout.states, (rate,)),
        ):
            for owner in owners:
                names = owner, *(derivative(owner) for derivative in derivatives)
                places = tuple(map(record.offset_of, names))
                moving_variables |= {name: (first + k, *places) for k, name in enumerate(names)}
        for name in self._layout.model.elements.rates if self._layout.model.delays else ():
            if is_before(name):
                moving_variables |= dict.fromkeys((name, slope_before(name)), (UNKNOWN,))
        return moving_variables | dict.fromkeys(python_values(self._layout.model), (UNKNOWN,))

    def _operand_of_name(self, lines: Assignments, name: str) -> Operand:
        """Return the operand of a name in an expression."""
        if (slot := self._constants.find_offset(name)) is not None:
            return lines.load(Location("p", slot), name)
        if name in self._moving:
            return lines.load(Location("moving", self._moving[name]), name)
        if name in self._inner:
            return lines.value(self._inner[name])  # type: ignore[arg-type]
        drive = name.removeprefix(drive_slope(""))
        number = self._layout.drives.index(drive)
        return lines.compute(
            "value_at" if drive == name else "slope_at",
            lines.value(self._layout.model.elements.looked_up_at[drive]),
            number,
        )

    def _convert_to_rows(self, lines: Assignments, value: Operand, *, of_slopes: bool = False) -> int:
        """Convert the assignments so far to rows; return the slot of a value."""
        for line in lines.lines:
            if isinstance(line, Load) and line.location.array == "p":
                self._add_row(line.target, CONSTANT, line.location.offset, constant=line.location.offset < self._fixed)
            elif isinstance(line, Load):
                number, *places = self._computed[line.location.offset]
                if of_slopes and OPERATIONS[number] in SLOPES:
                    number = OPERATIONS.index(SLOPES[OPERATIONS[number]])
                self._add_row(line.target, number, *places)
            elif isinstance(line, Compute):
                self._compute_row(line)
        lines.lines.clear()
        return self._slot_of(value)

    def _compute_row(self, line: Compute) -> None:
        if line.operation in ("value_at", "slope_at"):
            argument, drive = line.arguments
            of_time = [*self._layout.model.elements.looked_up_at.values()][int(drive)] == CLOCK
            number = OPERATIONS.index(line.operation)
            self._add_row(line.target, number, self._slot_of(argument), int(drive), int(of_time))
            return
        operation = squared(line)
        places = [self._slot_of(argument) for argument in operation.arguments]
        number = OPERATIONS.index(operation.operation)
        self._add_row(line.target, number, *places, constant=self._constant.issuperset(places))

    def _add_row(self, target: Operand, operation: int, *operands: int, constant: bool = False) -> None:
        slot = self._places.setdefault(target, len(self._places))
        (self._first if constant else self._rows).append((operation, slot, *operands, *[0] * (3 - len(operands))))
        if constant:
            self._constant.add(slot)

    def _slot_of(self, value: Operand) -> int:
        """Return the slot of a value; a number gets one when it first occurs."""
        # as text, since 0.0 and -0.0 would be one key
        key = value if isinstance(value, str) else repr(float(value))
        if key not in self._places:
            self._add_row(key, NUMBER, len(self._numbers), constant=True)
            self._numbers.append(float(value))
        return self._places[key]
