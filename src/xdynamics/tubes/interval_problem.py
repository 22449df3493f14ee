"""The interval problem of a model: its equations of motion, and the set of its starts and constants."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from xdynamics.expressions import text_of
from xdynamics.faults import InputError
from xdynamics.kernels.jets.motion import Motion, needed_lines
from xdynamics.kernels.layout import layout_of
from xdynamics.kernels.model_programs import forces_by_elements
from xdynamics.kernels.program import Compute, Instruction, Location
from xdynamics.model import Model
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import constants, first_regime
from xdynamics.model.parts import Parameter
from xdynamics.tubes.boxes import Box, StepConstants, enclosed, hull, point_box, with_pieces
from xdynamics.tubes.series import Motions, StraightLines, Value
from xdynamics.units import CONSTANTS, Quantity, constant
from xdynamics.units.unit import exact_value

# cut off after 50 digits: no float lies between this and pi, so the floats on either side hold both
PI = enclosed(Fraction("3.14159265358979323846264338327950288419716939937510"))


@dataclass(frozen=True)
class IntervalProblem:
    """The motions of a model.

    Attributes
    ----------
    motions : Motions
    names : tuple of str
        Of the numbers of a set: coordinates, velocities, states, then constants that are uncertain.
    begin : float, s
    start : ndarray, shape (2, numbers)
    constants : StepConstants
    regime : int
        At the start.
    """

    motions: Motions
    names: tuple[str, ...]
    begin: float
    start: Box
    constants: StepConstants
    regime: int

    @property
    def used(self) -> int:
        """How many numbers move."""
        return self.motions.motion.used

    @property
    def time(self) -> Box:
        """The time of the start, shape (2,)."""
        return self.time_of(self.begin)

    def time_of(self, time: float) -> Box:
        """Return an interval that holds a time: as it is written, or of tables, whose points are floats, the float."""
        return point_box(float(time)) if self.constants.tables else time_box(time)


def interval_problem_of(model: Model) -> IntervalProblem:
    """Return the interval programs of a model, and refuse a model that cannot be enclosed.

    Raises
    ------
    InputError
        If it has what no bounds are proven of; with each fault and what to do about it.
    """
    elements = model.elements
    if faults := list(_enclosure_faults(model)):
        raise InputError(f"model '{model.name}' cannot be enclosed: " + "; ".join(faults))
    layout = layout_of(model)
    motion = Motion(layout.coordinates.size, layout.states.size)
    lines = tuple(with_pieces(needed_lines(forces_by_elements(layout).body, motion)))
    used, uncertain = tuple(layout.used), list[str]()
    start = [_enclose_quantity(elements.statement.initial[name], elements.starts.get(name)) for name in used]
    places: dict[Location, Value] = {}
    for i, (name, value) in enumerate(_enclosed_constants(model).items()):
        if name in elements.statement.parameters and _half_width(elements.statement.parameters[name]) > 0:
            places[Location("p", i)] = len(used) + len(uncertain)
            uncertain.append(name)
            start.append(value)
        else:
            places[Location("p", i)] = value if value[0] < value[1] else float(value[0])
    motions = Motions(StraightLines(lines, places, literals_of(lines)), motion)
    start_box, names = np.stack(start, axis=1), (*used, *uncertain)
    return IntervalProblem(
        motions, names, model.statement.initial["t"].si, start_box, StepConstants.of_model(model), first_regime(model)
    )


def literals_of(lines: Iterable[Instruction]) -> dict[int, Box]:
    """Return intervals of the numbers in a program that no float is, by their identity."""
    # the lines that are kept hold these numbers alive, so that no identity is taken twice
    return {
        id(number): enclosed(exact_value(number))
        for line in lines
        if isinstance(line, Compute)
        for number in line.arguments
        if isinstance(number, float) and exact_value(number) != Fraction(number)
    }


def time_box(time: float) -> Box:
    """Return an interval that holds a time as it is written, and the float that it is recorded as."""
    return hull(enclosed(exact_value(time)), point_box(float(time)))


def _enclosed_constants(model: Model) -> Mapping[str, Box]:
    """Return the constants of a law, as they are written."""
    constant_boxes: dict[str, Box] = {}
    for name, value in constants(model).items():
        if name in model.elements.statement.parameters:
            part = model.elements.statement.parameters[name]
            constant_boxes[name] = _enclose_quantity(part.quantity, part)
        elif name == "pi":
            constant_boxes[name] = PI
        elif name in CONSTANTS or name in model.statement.calendar:
            constant_boxes[name] = enclosed(constant(name).factor)
        else:
            constant_boxes[name] = point_box(value)
    return constant_boxes


def _half_width(part: Parameter | None) -> Fraction:
    """Return how far a number may be from its value, in SI units; 0 where no bounds are given."""
    if part is None or part.spread is None or not part.spread.bounded:
        return Fraction(0)
    return exact_value(part.spread.size.value) * part.spread.size.unit.factor


def _enclose_quantity(quantity: Quantity, part: Parameter | None) -> Box:
    return enclosed(exact_value(quantity.value) * quantity.unit.factor, _half_width(part))


def interval_names(model: Model) -> list[str]:
    """Name the values at the start and the parameters that are intervals."""
    return [
        name
        for name, part in (model.elements.statement.parameters | model.elements.starts).items()
        if _half_width(part) > 0
    ]


def unbounded(model: Model) -> list[str]:
    """Name the quantities with a standard uncertainty, which has no bounds, so that their value alone counts."""
    return [name for name, part in model.uncertain.items() if part.spread is not None and not part.spread.bounded]


def _enclosure_faults(model: Model) -> Iterator[str]:
    """Yield the parts of a model that prevent proven bounds, with a remedy."""
    elements = model.elements
    if functions := model.python_functions:
        function_names = ", ".join(function.name for function in functions)
        yield f"nothing is known of the Python function {function_names} between two of its values; write it as an expression"
    if model.delays:
        yield "nothing is proven of delayed values; leave them out, or compare runs by refine"
    for kind, names in (("contact", model.statement.contacts), ("friction", model.statement.frictions)):
        if names:
            yield f"{kind} '{next(iter(names))}' ends the smooth motion; enclose a model without it, from one impact to the next"
    for name, event in model.statement.events.items():
        if event.every is not None:
            yield f"event '{name}' is periodic; give the times at which bounds are wanted as at"
            break
        if read := {"t", *elements.drives} & set[str]().union(*map(elements.reads, event.reset.values())):
            yield f"what event '{name}' sets reads {min(read)}; write it in coordinates, velocities and states"
            break
    if model.controllers:
        name = next(iter(elements.controllers))
        yield f"controller '{name}' changes at its ticks what it holds; enclose a model with that as a parameter, from tick to tick"
    if model.constraints:
        name = next(iter(elements.constraints))
        yield f"constraint '{name}' is kept by projections, which no bound follows; write the motion in free coordinates"
    yield from _faulty_numbers(model)


def _faulty_numbers(model: Model) -> Iterator[str]:
    """Yield which tables, and which numbers that others follow from, no bounds are proven of."""
    elements = model.elements
    for name, argument in elements.looked_up_at.items():
        if argument != CLOCK:
            yield (
                f"drive '{name}' is a table of '{text_of(elements.drives[name].argument)}', whose points are met at times that are not known"
                " before; write it as an expression"
            )
            break
    if wide := [name for name in sorted(model.read_by_points) if _half_width(elements.statement.parameters.get(name))]:
        yield f"the times of a table's points depend on '{wide[0]}', which has a half_width; write it as a number"
    if "t" in elements.starts and _half_width(elements.starts["t"]):
        yield "the time of the start has a half_width; give it to the state there"
    if wide := [name for name in sorted(model.read_at_start) if _half_width(elements.statement.parameters.get(name))]:
        yield f"values at the start are expressions of '{wide[0]}', which has a half_width; write them as numbers"
