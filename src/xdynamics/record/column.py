"""Columns of a record: how each variable is taken from a block of the log, in the record's unit.

Besides the logged quantities there are columns of the rest of a number beside its float (numbers that are sums of two
floats), and of the effort of a step: Newton iterations, and how far lengths of quaternions were off. First-order states
have columns with their rates, or without rates where a controller sets them. Constraints have columns of multipliers,
residuals, rates, rank, and of the correction of each step's result. Located switches have their side at every row, and
smooth switches the number of passages.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.double_double import DoubleDouble, nearest
from xdynamics.elementary.double_double.sums import add, multiply
from xdynamics.expressions import Binary, Compare, Node, dimension_of, text_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import display_text
from xdynamics.kernels import Layout
from xdynamics.kernels.layout import NO_SHARE
from xdynamics.march import LogBlock, March, Tolerances
from xdynamics.march.log import PIECES
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.constraints import conditions, multiplier_dimensions
from xdynamics.model.controllers import controller_states
from xdynamics.model.elementwise import element_blocks, own_mass
from xdynamics.model.kinks import Path
from xdynamics.model.motion import constants
from xdynamics.model.parts import Constraint
from xdynamics.model.reactions import reaction_dimensions
from xdynamics.model.regime_model import watched_by
from xdynamics.model.sliding import REFERENCE, Surface, surfaces
from xdynamics.model.switches import Switch
from xdynamics.reaction_names import (
    JOINT,
    PROJECTION,
    RANK,
    constraint_rate,
    constraint_residual,
    joint_force,
    joint_torque,
)
from xdynamics.record.folding import names_as_words, quantity_of
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import HELD, STEPS, Variable
from xdynamics.shapes import Shapes
from xdynamics.shapes.blocks import Block as Quantity
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import NONE, TIME, Dimension, Scales, Unit, parse_unit, spell

Array = NDArray[Any]


@dataclass(frozen=True)
class Column:
    """A variable of the record and how its values are taken from a block of the log."""

    variable: Variable
    take: Callable[[LogBlock], Array]


@dataclass(frozen=True)
class ColumnContext:
    """The layout, settings and units on which the columns of a march depend.

    Attributes
    ----------
    layout : Layout
    scales : Scales
    tolerances : Tolerances, optional
    samples : bool
        Whether force evaluations are recorded.
    located : bool
        Whether impacts are located; else contacts act over whole steps.
    """

    layout: Layout
    scales: Scales
    tolerances: Tolerances | None
    samples: bool = False
    located: bool = True

    @classmethod
    def for_settings(cls, layout: Layout, settings: Settings, *, samples: bool = False) -> ColumnContext:
        """Return the layout, settings and units for the columns of a march with these settings."""
        return cls(layout, settings.scales, settings.tolerances, samples, settings.method.stepper.locates)

    @property
    def model(self) -> Model:
        """The model that was marched."""
        return self.layout.model

    @property
    def when_forces_act(self) -> str:
        """When the force of a contact in a row acts, as the end of a phrase; nothing where it is that of its state."""
        return "" if self.located else ", mean over the step before the row"

    @cached_property
    def units(self) -> Units:
        """The unit of every quantity of the march."""
        return Units(self)


class Units:
    """The unit that each quantity of a model is reported in, and the factor from internal numbers to it."""

    def __init__(self, about: ColumnContext) -> None:
        self.about = about
        self.scales = about.scales
        self.time = self.scales.si_factor(TIME)
        model, layout = about.model, about.layout
        declared, dimensions, time = model.statement, model.elements.dimensions, model.time_unit
        self.known = {name: state.unit for name, state in declared.states.items()}
        for block in layout.coordinates.blocks:
            name, unit = block.name, declared.coordinates[block.name].unit
            self.known[name], self.known[schema.velocity(name)] = unit, unit.per(time)
            self.known[schema.acceleration(name)] = unit.per(time, 2)
            mass = dimension_of(own_mass(model.elements.mass, layout.coordinates.offset_of(name)), dimensions)
            coordinate_dimension = dimensions[block.first]
            force_unit = spell(mass * coordinate_dimension / time.dimension**2, angle=coordinate_dimension == NONE)
            forces = [(term, part.name) for term, parts in layout.terms.items() for part in parts.blocks]
            self.known |= {
                schema.force(term, part): force_unit for term, part in forces if name in (part, quantity_of(part))
            }
        reacting = reaction_dimensions(model) | multiplier_dimensions(model)
        self.known |= {
            block.name: spell(reacting[block.first], angle=True)  # J would be a torque
            for block in (layout.multipliers + layout.reactions).blocks
        }
        self.known |= {
            name: state.unit.per(time)
            for of, state in declared.states.items()
            for name in (schema.rate(of), *(schema.rate_term(term, of) for term in state.terms))
        }
        self.known |= {name: drive.table.value_unit for name, drive in declared.drives.items()}

    def factor(self, unit: Unit) -> float:
        """Return the factor from internal numbers to a unit."""
        return self.scales.si_factor(unit.dimension) / float(unit.factor)

    def derived(self, block: Quantity) -> Unit:
        """Return the unit of an energy, an observable or a gap."""
        layout, name = self.about.layout, block.name
        if name in schema.ENERGIES:
            return spell(layout.energy_dimension or NONE)
        if name in self.known:  # a term of a rate
            return self.known[name]
        if block.first in layout.gaps:
            return spell(dimension_of(layout.gaps[block.first], self.about.model.elements.dimensions))
        observable = self.about.model.statement.observed.get(name)
        if observable is not None and observable.unit is not None:
            return observable.unit
        # not element by element: a sum may have a million terms
        return spell(dimension_of(self.about.model.statement.observables[name], self._quantity_dimensions))

    @cached_property
    def _quantity_dimensions(self) -> dict[str, Dimension]:
        """The dimension of every name that an observable may read."""
        dimensions, square = self.about.model.elements.dimensions, self.about.model.time_unit.dimension**2
        dimensions_by_name = {block.name: dimensions[block.first] for block in element_blocks(dimensions).blocks}
        coordinate_blocks = self.about.layout.coordinates.blocks
        return dimensions_by_name | {
            schema.acceleration(coordinate.name): dimensions_by_name[coordinate.name] / square
            for coordinate in coordinate_blocks
        }


@dataclass(frozen=True)
class LineOf:
    """Takes a line of one of the log's tables, ``rows`` or ``samples``, by its number; of a quantity with dimensions all."""

    table: str
    index: int
    factor: float
    shape: tuple[int, ...] = ()

    def __call__(self, block: LogBlock) -> Array:
        """Return the quantity in a block: shape (rows,), or (rows, *shape) with dimensions."""
        if not self.shape:
            return np.ascontiguousarray(
                self.lines_in_unit(block, self.index)
            )  # a copy where rows stand one after the other
        lines = self.lines_in_unit(block, slice(self.index, self.index + math.prod(self.shape)))
        return lines.T.reshape(-1, *self.shape)

    def element(self, number: int) -> LineOf:
        """Return the column function of a single element."""
        return LineOf(self.table, self.index + number, self.factor)

    def lines_in_unit(self, block: LogBlock, lines: int | slice) -> Array:
        """Return some lines of a block's table, in the record's unit."""
        values: Array = getattr(block.log, self.table)[lines, : getattr(block, self.table)]
        return multiply_values(values, self.factor)


def take_row(index: int, factor: float, shape: tuple[int, ...] = ()) -> Callable[[LogBlock], Array]:
    """Return a function from a block to a quantity of its logged rows, shape (rows, *shape)."""
    return LineOf("rows", index, factor, shape)


def take_sample(index: int, factor: float, shape: tuple[int, ...] = ()) -> Callable[[LogBlock], Array]:
    """Return a function from a block to a quantity of its force samples, shape (samples, *shape)."""
    return LineOf("samples", index, factor, shape)


def take_trial_field(name: str, dtype: str, factor: float = 1.0) -> Callable[[LogBlock], Array]:
    """Return a function from a block to a field of its rejected trials, shape (trials,)."""
    return lambda block: multiply_values(block.log.trials[name][: block.trials], factor).astype(dtype)


def take_row_numbers(table: str, name: str) -> Callable[[LogBlock], Array]:
    """Return a function from a block to row numbers in the march, named by a field of ``trials`` or ``events``."""
    return lambda block: block.numbered(getattr(block.log, table)[name][: getattr(block, table)])


def take_event_field(name: str, dtype: str, factor: float = 1.0) -> Callable[[LogBlock], Array]:
    """Return a function from a block to a field of its events, shape (events,)."""
    return lambda block: multiply_values(block.log.events[name][: block.events], factor).astype(dtype)


def multiply_values(values: Array, factor: float) -> Array:
    """Return values times a factor; if the factor is 1, the given array without a copy."""
    if factor == 1.0:
        return values
    scaled: Array = values * factor
    return scaled


def rest_column(about: ColumnContext, number_quantity: Quantity, rest_quantity: Quantity) -> Column:
    """Return the column of the rest of a number beside its recorded float."""
    unit, rows = (
        about.units.known[number_quantity.name],
        [about.layout.row.offset_of(quantity.name) for quantity in (number_quantity, rest_quantity)],
    )
    factor = about.units.factor(unit)
    # a sum of two floats: one float would lose what the rest is there to hold
    exact = nearest(1 / Fraction(unit.factor))

    def take_rest(block: LogBlock) -> Array:
        numbers = [take_row(row, 1.0, number_quantity.shape)(block) for row in rows]
        product = multiply(DoubleDouble(*numbers), exact)
        # less the very float that is recorded, rounded the same way, so that column and rest add up to the number
        rests: Array = add(product, DoubleDouble(-multiply_values(numbers[0], factor), 0.0 * numbers[0])).high
        return rests

    long_name = f"what a float does not hold of {number_quantity.name}: the number is {number_quantity.name} + {rest_quantity.name}"
    return Column(
        Variable(rest_quantity.name, (STEPS, *number_quantity.dims), "f8", unit.text, long_name, schema.LEFT_OVER),
        take_rest,
    )


def effort_columns(layout: Layout) -> list[Column]:
    """Return the columns of a step's Newton iterations and of corrections after the step."""
    collected = []
    if layout.deviations:
        collected.append(Column(schema.DEVIATION, take_row(layout.row.offset_of(schema.DEVIATION.name), 1.0)))
    if layout.effort:
        index = layout.row.offset_of(layout.effort[0])
        collected.append(Column(schema.NEWTON, lambda block: block.log.rows[index, : block.rows].astype("i4")))
    return collected


def of_first_order(about: ColumnContext) -> Iterator[tuple[Quantity, str]]:
    """Yield first-order states and their rates with long names; states of controllers have a role and no rate."""
    layout, model = about.layout, about.model
    held_states = controller_states(model.elements.controllers, model.time_unit)
    for state, rate in zip(layout.states.blocks, layout.rates.blocks, strict=True):
        long_name = model.statement.states[state.name].description or f"state {state.name}"
        if state.name in held_states:
            yield state._replace(role=HELD), long_name
        else:
            yield state, long_name
            yield rate, f"rate of {state.name}"
            for term in model.statement.states[state.name].terms:
                block = layout.rate_terms.block(schema.rate_term(term, state.name))
                yield block._replace(role="rate_term"), f"term {term} of the rate of {state.name}"


def of_constraints(about: ColumnContext) -> Iterator[Column]:
    """Yield the columns of constraints along the steps."""
    layout, units, model = about.layout, about.units, about.model
    computed, first = {block.name: block for block in layout.computed.blocks}, 0
    for multiplier in layout.multipliers.blocks:
        owner = quantity_of(conditions(model)[first].name)
        constraint = model.statement.constraints[owner]
        noun = constraint.description or f"constraint {owner}"
        words = f"multiplier of {noun}: the force on a coordinate is it times the derivative"
        attributes = _constraint_attributes(constraint)
        yield row_column(about, multiplier, units.known[multiplier.name], words, "multiplier", attributes)
        for name, words in (
            (constraint_residual, f"how far positions are from {noun}"),
            (constraint_rate, f"how fast velocities leave {noun}"),
        ):
            if (block := computed.get(name(owner))) is not None:
                unit = spell(dimension_of(layout.constraint_outputs[block.first], model.elements.dimensions))
                yield row_column(about, block, unit, words, "residual", {})
        first += multiplier.size
    yield from _of_joints(about, computed)
    if layout.constraint_diagnostics:
        index = layout.row.offset_of(RANK.name)
        yield Column(RANK, lambda block: block.log.rows[index, : block.rows].astype("i4"))
        yield Column(PROJECTION, take_row(layout.row.offset_of(PROJECTION.name), 1.0))


def _of_joints(about: ColumnContext, computed: Mapping[str, Quantity]) -> Iterator[Column]:
    """Yield the columns of the force and the torque in each joint, along the axes of space."""
    for name, joint in about.model.joints.items():
        first, second = joint.bodies
        where = (
            f"in {joint.description or f'joint {name}'}, on {first} at the point of {second}, along the axes of space"
        )
        more = {"acts_on": first, "acts_from": second}
        for noun, made, unit in (("force", joint_force(name), "N"), ("torque", joint_torque(name), "N m")):
            if made in computed:
                yield row_column(about, computed[made], parse_unit(unit), f"{noun} {where}", JOINT, more)


def row_column(
    about: ColumnContext, quantity: Quantity, unit: Unit, long_name: str, role: str, more: Mapping[str, Any]
) -> Column:
    """Return the column of a quantity of the logged rows."""
    variable = Variable(quantity.name, (STEPS, *quantity.dims), "f8", unit.text, long_name, role, dict(more))
    return Column(
        variable, take_row(about.layout.row.offset_of(quantity.name), about.units.factor(unit), quantity.shape)
    )


def _constraint_attributes(constraint: Constraint) -> dict[str, str]:
    """Return the condition of a constraint as attributes of its multiplier."""
    key, differentiated_by = ("rolls", "velocities") if constraint.holds is None else ("holds", "coordinates")
    return {key: text_of(constraint.condition), "acts_along": f"derivative of {key} by the {differentiated_by}"}


def shapes_with_switches(model: Model) -> Shapes:
    """Return the shapes of a model with those of the switches hidden in its forces, and of their sides."""
    dims = {split_element_name(switch.name)[0]: switch.dims for switch in watched_by(model) if switch.dims}
    sides = {schema.side_of(name): switch_dims for name, switch_dims in dims.items()}
    return replace(model.shapes, dims={**model.shapes.dims, **dims, **sides}) if dims else model.shapes


def side_columns(about: ColumnContext) -> list[Column]:
    """Return the side of each located switch for every row; for the points of a table, the piece between them."""
    # before them in a row's flags stand its kind, its regime and the state of each reaction
    collected, places, flag_row = [], {}, 2 + about.layout.reactions.size
    switches = watched_by(about.model)
    slid = {switches[i].name for surface in surfaces(about.model) for i, _ in surface.switches}
    for switch in switches:
        places[switch.owner, switch.function] = flag_row
        flag_row += 3 if switch.drive else 1
    for switch in switches:
        first = places[switch.owner, switch.function]
        if switch.drive:
            long_name = (
                f"piece of table {switch.drive} that '{switch.owner}' reads: 0 is before its first point, 1 behind it"
            )
            variable = Variable(schema.side_of(switch.name), (STEPS,), "i4", "1", long_name, "switch")
            collected.append(Column(variable, _piece_taker(first)))
            continue
        places_of_owner = {
            function: flag_index for (owner, function), flag_index in places.items() if owner == switch.owner
        }
        sides = {number: word for number, word in schema.SIDES.items() if number or switch.nested or switch.dims}
        if switch.name in slid:
            sides |= {schema.SLIDES: "slides"}
        extra = schema.flag_attributes(sides) | {"function": switch.text}
        long_name = f"side of switch {switch.name}: the sign of its function"
        long_name += "; elsewhere where it decides nothing, inside a where" if switch.nested else ""
        variable = Variable(schema.side_of(switch.name), (STEPS,), "i1", "1", long_name, "flag", extra)
        collected.append(Column(variable, _side_taker(about, switch, first, places_of_owner)))
    return collected


def _piece_taker(first: int) -> Callable[[LogBlock], Array]:
    def take_piece(block: LogBlock) -> Array:
        # a flag is one byte, and a table may have more pieces: their number
        # is kept as three digits to the base `PIECES`
        digits = block.log.flags[first : first + 3, : block.rows].astype(np.int32)
        pieces: Array = digits[0] + PIECES * (digits[1] + PIECES * digits[2])
        return pieces

    return take_piece


def _side_taker(
    about: ColumnContext, switch: Switch, flag_row: int, places: Mapping[Node, int]
) -> Callable[[LogBlock], Array]:
    """Return a function from a block to the side of a switch; 0 where enclosing `where`s select other branches."""
    if not switch.nested:
        return lambda block: block.log.flags[flag_row, : block.rows]
    values = dict(constants(about.model, about.scales))

    def condition_holds(condition: Compare, block: LogBlock) -> Array:
        # the switch of a comparison is left minus right, so the sign of its side says whether it holds
        flag_index = places.get(Binary("-", condition.left, condition.right))
        if flag_index is None:  # it compares constants
            return np.full(block.rows, bool(evaluate(condition, values)))
        side = block.log.flags[flag_index, : block.rows]
        return side < 0 if condition.operator[0] == "<" else side > 0

    def path_holds(path: Path, block: LogBlock) -> Array:
        holding = np.ones(block.rows, bool)
        for condition, expected_truth in path:
            holding &= condition_holds(condition, block) == expected_truth
        return holding

    def take_side(block: LogBlock) -> Array:
        decides = np.any([path_holds(path, block) for path in switch.paths], axis=0)
        return np.where(decides, block.log.flags[flag_row, : block.rows], np.int8(0))

    return take_side


def share_column(about: ColumnContext, surface: Surface) -> Column:
    """Return the share of a switch that the motion may slide along."""
    model, name = about.model, schema.share_of(surface.name)
    take = take_row(about.layout.row.offset_of(name), 1.0)

    def take_share(block: LogBlock) -> Array:
        share = take(block)
        return np.where(share == NO_SHARE, np.nan, share)

    owner, borders = "the positive side", [f"switch {watched_by(model)[i].name}" for i, _ in surface.switches]
    if surface.regimes:
        negative, positive = ([*model.regimes][i] for i in surface.regimes)
        owner, borders = f"regime {positive}", [f"the border of regimes {negative} and {positive}", *borders]
    long_name = (
        f"share of the forces of {owner}, where the motion slides along {' and '.join(borders)}; nan where it does not"
    )
    more = {"function": display_text(text_of(surface.function)), "reference": REFERENCE}
    return Column(Variable(name, (STEPS,), "f8", "1", long_name, "switch", more), take_share)


def smooth_switch_passes(march: March) -> list[tuple[Variable, Array]]:
    """Return how often each switch that was declared smooth was passed, and when first; empty without such switches."""
    smooth = march.layout.smooth
    if not smooth:
        return []
    counts, times = march.passed
    more = {"names": names_as_words(switch.name for switch in smooth)}
    return [
        (replace(schema.PASSED, more=more), counts),
        (
            replace(schema.with_time_unit(schema.FIRST_PASSED, march.model.time_unit), more=more),
            times * march.settings.scales.si_factor(TIME),
        ),
    ]
