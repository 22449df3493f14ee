"""A variable of the record, and how its values are taken from a block of the log, in the record's unit."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import dimension_of
from xdynamics.kernels import Layout
from xdynamics.march import LogBlock, Tolerances
from xdynamics.march.settings import Settings
from xdynamics.model import Model
from xdynamics.model.constraints import multiplier_dimensions
from xdynamics.model.elementwise import element_blocks
from xdynamics.model.lazy_trees import own_mass
from xdynamics.model.reactions import reaction_dimensions
from xdynamics.model.whole import prints_quantities
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import Variable
from xdynamics.shapes.blocks import Block as Quantity
from xdynamics.units import NONE, TIME, Dimension, Scales, Unit, spell

Array = NDArray[Any]


@dataclass(frozen=True)
class Column:
    """A variable of the record and how its values are taken from a block of the log."""

    variable: Variable
    take: Callable[[LogBlock], Array]


@dataclass(frozen=True)
class About:
    """What the columns of a march depend on.

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
    def for_settings(cls, layout: Layout, settings: Settings, *, samples: bool = False) -> About:
        """Return what the columns of a march with these settings depend on."""
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

    def __init__(self, about: About) -> None:
        self.about = about
        self.scales = about.scales
        self.time = self.scales.si_factor(TIME)
        model, layout = about.model, about.layout
        declared, dimensions, time = layout.declared, model.dimensions, model.time_unit
        self.known = {name: state.unit for name, state in declared.states.items()}
        for block in layout.coordinates.blocks:
            name, unit = block.name, declared.coordinates[block.name].unit
            self.known[name], self.known[schema.velocity(name)] = unit, unit.per(time)
            self.known[schema.acceleration(name)] = unit.per(time, 2)
            mass = dimension_of(own_mass(model.mass, layout.coordinates.offset_of(name)), dimensions)
            coordinate_dimension = dimensions[block.first]
            force_unit = spell(mass * coordinate_dimension / time.dimension**2, angle=coordinate_dimension == NONE)
            for term, components in layout.terms.items():
                if name in components:
                    self.known[schema.force(term, name)] = force_unit
        reacting = reaction_dimensions(model) | multiplier_dimensions(model)
        self.known |= {
            name: spell(dimension, angle=True) for name, dimension in reacting.items()
        }  # J would be a torque
        self.known |= {schema.rate(name): state.unit.per(time) for name, state in declared.states.items()}
        self.known |= {name: drive.table.value_unit for name, drive in model.drives.items()}

    def factor(self, unit: Unit) -> float:
        """Return the factor from internal numbers to a unit."""
        return self.scales.si_factor(unit.dimension) / float(unit.factor)

    def derived(self, block: Quantity) -> Unit:
        """Return the unit of an energy, an observable or a gap."""
        layout, name = self.about.layout, block.name
        if name in schema.ENERGIES:
            return spell(layout.energy_dimension or NONE)
        if name in layout.gaps:
            return spell(dimension_of(layout.gaps[name], self.about.model.dimensions))
        observable = layout.declared.observed.get(name)
        if observable is not None and observable.unit is not None:
            return observable.unit
        if prints_quantities(self.about.model):  # not element by element: a sum may have a million terms
            return spell(dimension_of(layout.derived_quantities[name][1], self._quantity_dimensions))
        return spell(dimension_of(self.about.model.observables[block.first], self._element_dimensions))

    @cached_property
    def _element_dimensions(self) -> dict[str, Dimension]:
        """The dimension of every name that an observable may read."""
        model, coordinates = self.about.model, self.about.layout.coordinates
        dimensions, square = model.dimensions, model.time_unit.dimension**2
        return dimensions | {schema.acceleration(name): dimensions[name] / square for name in coordinates}

    @cached_property
    def _quantity_dimensions(self) -> dict[str, Dimension]:
        """The same of every quantity with dimensions, by its own name and not those of its elements."""
        dimensions, square = self.about.model.dimensions, self.about.model.time_unit.dimension**2
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
        """Take it of a block."""
        if not self.shape:
            return np.ascontiguousarray(
                self.lines_in_unit(block, self.index)
            )  # a copy where rows stand one after the other
        lines = self.lines_in_unit(block, slice(self.index, self.index + math.prod(self.shape)))
        return lines.T.reshape(-1, *self.shape)

    def element(self, number: int) -> LineOf:
        """Return what takes one of the lines alone."""
        return LineOf(self.table, self.index + number, self.factor)

    def lines_in_unit(self, block: LogBlock, lines: int | slice) -> Array:
        """Take some lines of a block, in the record's unit."""
        values: Array = getattr(block.log, self.table)[lines, : getattr(block, self.table)]
        return multiply_values(values, self.factor)


def take_row(index: int, factor: float, shape: tuple[int, ...] = ()) -> Callable[[LogBlock], Array]:
    """Take a quantity of the logged rows."""
    return LineOf("rows", index, factor, shape)


def take_sample(index: int, factor: float, shape: tuple[int, ...] = ()) -> Callable[[LogBlock], Array]:
    """Take a quantity of the force samples."""
    return LineOf("samples", index, factor, shape)


def take_trial_field(name: str, dtype: str, factor: float = 1.0) -> Callable[[LogBlock], Array]:
    """Take a field of the rejected trials."""
    return lambda block: multiply_values(block.log.trials[name][: block.trials], factor).astype(dtype)


def take_row_numbers(table: str, name: str) -> Callable[[LogBlock], Array]:
    """Take the numbers of rows in the march that a field of the ``trials`` or ``events`` names."""
    return lambda block: block.numbered(getattr(block.log, table)[name][: getattr(block, table)])


def take_event_field(name: str, dtype: str, factor: float = 1.0) -> Callable[[LogBlock], Array]:
    """Take a field of the events."""
    return lambda block: multiply_values(block.log.events[name][: block.events], factor).astype(dtype)


def multiply_values(values: Array, factor: float) -> Array:
    """Multiply by a factor; return the same array if the factor is 1."""
    if factor == 1.0:
        return values
    scaled: Array = values * factor
    return scaled
