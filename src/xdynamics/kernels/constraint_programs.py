"""Projection of a step's result onto constraints: positions by Newton's method, then velocities.

The state is projected along the directions in which the multipliers act, so that nothing else changes and the order of
a method stays (Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., section VII.2).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from xdynamics.expressions import Node
from xdynamics.expressions.tree import summands
from xdynamics.kernels.assignments import Assignments
from xdynamics.kernels.layout import Layout
from xdynamics.kernels.model_programs import write_assignments
from xdynamics.kernels.program import AT, Location, Operand, Program, ProgramCall, StoreTo, While
from xdynamics.model.constraints import (
    Condition,
    conditions,
    correction_assignments,
    inverse_pivot,
    projection_assignments,
    state_corrections,
)
from xdynamics.reaction_names import PROJECTION
from xdynamics.schema import acceleration, velocity
from xdynamics.units import NONE, Dimension

CONSTRAIN, TURN, KEEP = "constrain", "constrain_turn", "keep"
TOLERANCE = 1e-12  # of the terms of a residual
SMALLEST = 1e-15  # of the same: what rounding leaves, so that no energy drifts
MOST_TURNS = 12.0
CLOSE_TURNS = 3.0  # made for the smallest residual; in later ones the tolerance is enough
# numbers of a projection: whether it goes on, turns made, the greatest residual before over its terms
PROGRESS = ("open", "turns", "farthest")
OPEN, TURNS, FARTHEST = range(len(PROGRESS))


def constraint_projection(layout: Layout) -> tuple[Program, ...]:
    """Write the programs that project a state in `z` onto constraints, and evaluate the forces there."""
    if not layout.model.constraints:
        return ()
    progress_array = "held"
    distance_location = Location("z", layout.record.offset_of(PROJECTION.name))
    lines = Assignments(lambda *_: 0.0)
    initial_stores = [StoreTo(Location(progress_array, i), 1.0 if i == OPEN else 0.0) for i in range(len(PROGRESS))]
    lines.store(distance_location, lines.load(Location(progress_array, FARTHEST)))
    body = (
        *initial_stores,
        While(Location(progress_array, OPEN), ProgramCall(TURN, "at", "z", "z", progress_array)),
        ProgramCall("forces", "at", "z", "z"),
        *lines.lines,
    )
    about = "The state where constraints hold, and the forces there."
    constrain_program = Program(
        CONSTRAIN, about, body, local={progress_array: len(PROGRESS)}, sound=(0, layout.state.size)
    )
    return *impulse_programs(layout), _projection_turn(layout), constrain_program


def _projection_turn(layout: Layout) -> Program:
    """Write one turn: positions are moved while a residual is not small, then velocities, once."""
    model, coordinates = layout.model, layout.model.elements.statement.coordinates
    lines = write_assignments(layout, correction_assignments(model))
    is_open, turns, farthest = (lines.load(Location("e", i)) for i in range(len(PROGRESS)))
    far: Operand = 0.0
    fast: Operand = 0.0
    greatest_share: Operand = farthest
    step = lines.compute("abs", lines.load(Location("at", AT.index("h"))))
    # To rounding: near singular positions what is left of a residual is divided by the square of the distance to them.
    close = lines.compute("less", turns, CLOSE_TURNS)
    tolerance = lines.compute("choose", close, SMALLEST, TOLERANCE)
    positions = _largest_by_dimension(lines, layout, {name: name for name in coordinates}, 1.0)
    speeds = _largest_by_dimension(lines, layout, {name: velocity(name) for name in coordinates}, 0.0)
    for k, condition in enumerate(conditions(model)):
        acts = lines.operand_of(inverse_pivot(k))
        coordinate_sizes, reached = (
            _change_sizes(lines, layout, condition),
            _swept_change_sizes(lines, layout, condition, positions),
        )
        far, greatest_share = _ResidualJudge(lines, acts, tolerance)(
            condition.residual, far, greatest_share, coordinate_sizes, reached
        )
        gained = (lines.compute("multiply", step, term) for term in _rate_change_sizes(lines, layout, condition))
        swept_rates = _swept_change_sizes(lines, layout, condition, speeds)
        fast, greatest_share = _ResidualJudge(lines, acts, SMALLEST)(
            condition.rate, fast, greatest_share, gained, swept_rates
        )
    first = lines.compute("less", turns, 0.5)
    far, fast = lines.compute("more", far, 0.0), lines.compute("more", fast, 0.0)
    moves = lines.compute("choose", far, is_open, 0.0)
    slows = lines.compute("choose", far, 0.0, lines.compute("choose", fast, is_open, 0.0))
    made = lines.compute("add", turns, 1.0)
    late = lines.compute("at_least", made, MOST_TURNS)
    goes_on = lines.compute("choose", late, 0.0, moves)
    failed = lines.compute("choose", late, moves, 0.0)
    changes = [(name, moves, f"_shift_{name}") for name in (*coordinates, *state_corrections(model))]
    changes += [(velocity(name), slows, f"_slow_{name}") for name in coordinates]
    for owner, is_applied, change in changes:
        old = lines.operand_of(owner)
        new = lines.compute("add", old, lines.operand_of(change))
        selected_value = lines.compute("choose", lines.compute("more", is_applied, 0.0), new, old)
        lines.store(Location("z", layout.record.offset_of(owner)), selected_value)
    first_share = lines.compute("choose", first, greatest_share, farthest)
    # a program cannot raise: nan goes to PROJECTION in `z`, which `sound` of the calling program covers
    lost = lines.compute("choose", lines.compute("more", failed, 0.0), float("nan"), first_share)
    values = goes_on, made, lost
    for i, value in enumerate(values):
        was_open = lines.compute("more", is_open, 0.0)
        old_value = (is_open, turns, farthest)[i]
        lines.store(Location("e", i), lines.compute("choose", was_open, value, old_value))
    return Program(TURN, "One turn towards where constraints hold.", tuple(lines.lines))


def impulse_programs(layout: Layout) -> tuple[Program, ...]:
    """Write one turn of `methods.lines.ConstraintImpulse`: positions and velocities in `z` along the gradients in `y`; none without any.

    The time of `y` is `t`, that of `z` is `t1`; `e` has whether it goes on, turns made, and how far positions went.
    """
    model = layout.model
    if not model.constraints or layout.scheme is None or not layout.scheme.method.constrained_update:
        return ()
    ahead = write_assignments(layout, (), state="z", time="t1", prefix="_z")
    excess: Operand = 0.0
    for condition in conditions(model):
        sizes = _change_sizes(ahead, layout, condition)
        excess, _ = _ResidualJudge(ahead, 1.0, SMALLEST)(condition.residual, excess, 0.0, sizes)
    off = {f"_off{k}": ahead.value(condition.residual) for k, condition in enumerate(conditions(model))}
    lines = write_assignments(layout, projection_assignments(model), prefix="_y", operands=off)
    is_open, turns, distance = (lines.load(Location("e", i)) for i in range(len(PROGRESS)))
    moves = lines.compute("choose", lines.compute("more", excess, 0.0), is_open, 0.0)
    for name in model.elements.statement.coordinates:
        shift = lines.operand_of(f"_shift_{name}")
        for owner, change in ((name, shift), (velocity(name), lines.compute("divide", shift, distance))):
            location = Location("z", layout.record.offset_of(owner))
            old = lines.load(location)
            new = lines.compute("add", old, change)
            lines.store(location, lines.compute("choose", lines.compute("more", moves, 0.0), new, old))
    made = lines.compute("add", turns, 1.0)
    goes_on = lines.compute("choose", lines.compute("at_least", made, MOST_TURNS), 0.0, moves)
    lines.store(Location("e", OPEN), goes_on)
    lines.store(Location("e", TURNS), made)
    return (Program(KEEP, "One turn of impulses of constraints.", (*ahead.lines, *lines.lines)),)


def _change_sizes(lines: Assignments, layout: Layout, condition: Condition) -> Iterator[Operand]:
    """Yield the sizes of a residual's change by the coordinates as they are, by 1 radian of angles."""
    for name, tree in condition.row.items():
        scale: Operand = 1.0 if layout.model.elements.dimensions[name] == NONE else lines.operand_of(name)
        yield lines.compute("abs", lines.compute("multiply", lines.value(tree), scale))


def _rate_change_sizes(lines: Assignments, layout: Layout, condition: Condition) -> Iterator[Operand]:
    """Yield the sizes of the terms of a rate's change, the measure of a rate at rest."""
    for name, tree in condition.row.items():
        acceleration_value = lines.load(Location("y", layout.record.offset_of(acceleration(name))))
        yield lines.compute("abs", lines.compute("multiply", lines.value(tree), acceleration_value))


def _largest_by_dimension(
    lines: Assignments, layout: Layout, variables: Mapping[str, str], least_angle: float
) -> dict[Dimension, Operand]:
    """Return the largest coordinate, or velocity, of each kind; of angles `least_angle` where that is not zero."""
    largest: dict[Dimension, Operand] = {}
    for name, variable in variables.items():
        kind = layout.model.elements.dimensions[name]
        size: Operand = (
            least_angle if least_angle > 0.0 and kind == NONE else lines.compute("abs", lines.operand_of(variable))
        )
        largest[kind] = lines.compute("greatest", largest[kind], size) if kind in largest else size
    return largest


def _swept_change_sizes(
    lines: Assignments, layout: Layout, condition: Condition, largest: Mapping[Dimension, Operand]
) -> Iterator[Operand]:
    """Yield the sizes of a condition's change by the largest of the kind: its own terms may be rounding of those.

    The height of a piston on a level guide is, or the rate of a body that spins about its axis.
    """
    for name, tree in condition.row.items():
        reach = largest[layout.model.elements.dimensions[name]]
        yield lines.compute("abs", lines.compute("multiply", lines.value(tree), reach))


@dataclass(frozen=True)
class _ResidualJudge:
    """Compares residuals of a condition with the sizes of their terms; of one that others imply, it asks nothing.

    Attributes
    ----------
    lines : Assignments
    acts : Operand
        Zero where the condition is one that others imply.
    tolerance : Operand
        How large a residual may be, over its terms.
    """

    lines: Assignments
    acts: Operand
    tolerance: Operand

    def __call__(
        self,
        tree: Node,
        excess: Operand,
        greatest_share: Operand,
        further: Iterable[Operand] = (),
        swept: Iterable[Operand] = (),
    ) -> tuple[Operand, Operand]:
        """Return the greatest residual beyond rounding, and the greatest residual relative to its size."""
        lines = self.lines
        value = lines.compute("abs", lines.value(tree))
        size: Operand = 0.0
        for term in (*(lines.compute("abs", lines.value(term)) for term in summands(tree)), *further):
            size = lines.compute("add", size, term)
        surplus = lines.compute("subtract", value, lines.compute("multiply", self.tolerance, size))
        for term in swept:
            size = lines.compute("add", size, term)
            surplus = lines.compute("subtract", surplus, lines.compute("multiply", SMALLEST, term))
        surplus = lines.compute("choose", lines.compute("equal", self.acts, 0.0), 0.0, surplus)
        share = lines.compute("choose", lines.compute("more", size, 0.0), lines.compute("divide", value, size), 0.0)
        return lines.compute("greatest", excess, surplus), lines.compute("greatest", greatest_share, share)
