"""Columns of closed links: what is held together in each row, by which contact, with which force."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of
from xdynamics.march import LogBlock
from xdynamics.march.energy_gains import impact_energy_dimension
from xdynamics.model import Model
from xdynamics.model.assemblies import Assembly, assemblies
from xdynamics.record.column import About, Column, multiply_values
from xdynamics.record.folded_columns import element_at, place_variable
from xdynamics.schema import CLOSED_AT, CLOSED_LINKS, LINK_STATES, NOWHERE, Variable, at_closed, flag_attributes
from xdynamics.shapes import Shapes
from xdynamics.units import Unit, spell

Array = NDArray[Any]
Taking = Callable[[LogBlock], Array]
Finding = Callable[[Assembly, Array], Array]
FRICTION_STATE = "friction_state"


@dataclass(frozen=True)
class ClosedLinks:
    """Closed links of contacts, and how they are taken from a block.

    Attributes
    ----------
    contacts : sequence of Assembly
    rows : callable
        From a block to an array with a column for each closed link of each row: the row, the number of the link among
        those of all contacts, its gap, its force, what is left of its acceleration, its friction force; where forces are
        found by iteration also what it does along its slip.
    iterated : bool
        Whether forces are found by iteration, which leaves something.
    """

    contacts: Sequence[Assembly]
    rows: Taking
    iterated: bool

    @property
    def _begins(self) -> Array:
        return np.asarray(np.cumsum([0, *(contact.links for contact in self.contacts)]))

    def row_numbers(self, block: LogBlock) -> Array:
        """Take the number of the row of each closed link."""
        return block.numbered(self.rows(block)[0])

    def row_times(self, factor: float) -> Taking:
        """Return what takes the time of each closed link."""

        def take_row_times(block: LogBlock) -> Array:
            places = self.rows(block)[0].astype(np.int64) - int(block.log.base[0]["rows"])
            return multiply_values(block.log.rows[0, places], factor)

        return take_row_times

    def contact_numbers(self, block: LogBlock) -> Array:
        """Take the contact of each closed link."""
        numbers = np.searchsorted(self._begins, self.rows(block)[1], side="right")
        return np.asarray(numbers - 1, np.int32)

    def element_numbers(self, dim: str, find: Finding) -> Taking:
        """Return what takes a number of each closed link whose contact has a dimension."""

        def take_element_numbers(block: LogBlock) -> Array:
            numbers, owners = self.rows(block)[1].astype(np.int64), self.contact_numbers(block)
            numbers_by_link = np.full(numbers.size, NOWHERE, np.int32)
            for c, contact in enumerate(self.contacts):
                if dim in contact.dims:
                    numbers_by_link[owners == c] = find(contact, numbers[owners == c] - self._begins[c])
            return numbers_by_link

        return take_element_numbers

    def numbers_in_units(self, row: int, factors: Sequence[float]) -> Taking:
        """Return what takes a number of each closed link in the unit of its contact."""
        if len({*factors}) == 1:
            return lambda block: multiply_values(self.rows(block)[row], factors[0])
        return lambda block: self.rows(block)[row] * np.array(factors)[self.contact_numbers(block)]


def closed_link_columns(about: About, links: ClosedLinks) -> list[Column]:
    """Return what is closed in each row: the row, the contact, the link, its elements, its gap and its force."""
    words = flag_attributes({c: contact.name for c, contact in enumerate(links.contacts)}, "i4")
    contact = replace(_link_variable("contact", "i4", "1", "contact of the link"), role="flag", more=words)
    collected = [
        Column(
            _link_variable("step", "i8", "1", "step_number of the row in which the link is closed"), links.row_numbers
        ),
        Column(replace(CLOSED_AT, units=about.model.time_unit.text), links.row_times(about.units.time)),
        Column(contact, links.contact_numbers),
    ]
    for name, dim, target_dim, find in link_places(links.contacts, about.model.shapes):
        element_variable = place_variable(name, dim, target_dim, about.model.shapes.extent(target_dim))
        which = element_at(name, dim, target_dim).removesuffix(f" of the {dim}")
        long_name = f"{which} of the closed link, counted from 0; {NOWHERE} where its contact has none"
        role = "contact" if element_variable.role == "event" else element_variable.role
        element_variable = replace(
            element_variable, name=at_closed(name), dims=(CLOSED_LINKS,), long_name=long_name, role=role
        )
        collected.append(Column(element_variable, links.element_numbers(dim, find)))
    if links.iterated and any_rubs(links.contacts):
        friction_words = "whether the link sticks or slips from this state on"
        friction_words = (
            friction_words if about.located else "whether the link stuck or slipped over the step before the row"
        )
        states = flag_attributes(dict(enumerate(LINK_STATES)))
        does = replace(_link_variable(FRICTION_STATE, "i1", "1", friction_words), role="flag", more=states)
        collected.append(Column(does, lambda block: np.asarray(links.rows(block)[6].astype(np.int8))))
    return [*collected, *_number_columns(about, links)]


def _number_columns(about: About, links: ClosedLinks) -> Iterator[Column]:
    """Yield the gaps and forces of closed links; where units differ, with that of each contact."""
    every, when = links.contacts, about.when_forces_act
    gap_words = (
        "which is held at zero" if about.located else "negative where it overlaps: its rate is held at zero, not it"
    )
    gaps = [unit_of_gap(contact) for contact in every]
    numbers = [
        ("gap", 2, gaps, f"gap of the link, {gap_words}"),
        ("force", 3, [*map(unit_of_force, every)], f"normal force of the link{when}, positive where it pushes"),
    ]
    if links.iterated:
        left = [spell(gap.dimension / about.model.time_unit.dimension**2) for gap in gaps]
        left_over = "acceleration of the gap that the computed forces leave, zero for an exact solution"
        if not about.located:
            left_over = (
                "difference between the rate of the gap after the step and that of the impact law, over the step"
            )
        words = f"residual of the contact equations: {left_over}"
        numbers.append(("force_residual", 4, left, words))
    if any_rubs(every):
        words = (
            f"friction force of the link{when}, positive along positive slip; while the link slips it opposes the slip"
        )
        numbers.append(("friction_force", 5, units_of_friction(every), words))
    for name, row, units, words in numbers:
        texts = [unit.text for unit in units]
        units_by_contact = ", ".join(f"{contact.name} {text}" for contact, text in zip(every, texts, strict=True))
        same_unit = len({*texts}) == 1
        more = {} if same_unit else {"comment": f"unit by contact: {units_by_contact}"}
        variable = replace(_link_variable(name, "f8", texts[0] if same_unit else "1", words), more=more)
        yield Column(variable, links.numbers_in_units(row, [*map(about.units.factor, units)]))


def _link_variable(name: str, dtype: str, unit: str, long_name: str) -> Variable:
    return Variable(at_closed(name), (CLOSED_LINKS,), dtype, unit, long_name, "contact")


def link_names(model: Model) -> list[str]:
    """Name the variables that tell which links of many are closed, and how; none without such contacts."""
    every = assemblies(model)
    dims = dict.fromkeys(dim for contact in every for dim in contact.dims)
    names = ["step", "contact", *dims, *([FRICTION_STATE] if any_rubs(every) else [])]
    return [*map(at_closed, names)] if every else []


def any_rubs(every: Sequence[Assembly]) -> bool:
    """Whether any contact has friction."""
    return any(contact.contact.slip is not None for contact in every)


def link_places(every: Sequence[Assembly], shapes: Shapes) -> Iterator[tuple[str, str, str, Finding]]:
    """Yield what says which link it is: its name, the dimension it is found by, that it is of, how it is found."""
    dims = shapes.ordered({dim for contact in every for dim in contact.dims})
    relations = [dim for dim in dims if dim in shapes.relations]
    for dim in dims:
        yield dim, dim, dim, _find_along(dim)
        if dim in shapes.relations:
            relation = shapes.relations[dim]
            for k, (end, target_dim) in enumerate((("first", relation.source), ("second", relation.target))):
                yield end if len(relations) == 1 else f"{dim}_{end}", dim, target_dim, _find_end(k)


def _find_along(dim: str) -> Finding:
    return lambda contact, links: contact.numbers(links)[dim]


def _find_end(k: int) -> Finding:
    return lambda contact, links: contact.ends(links)[k]


def unit_of_gap(contact: Assembly) -> Unit:
    """Return the unit of the gaps of a contact."""
    return spell(dimension_of(contact.contact.gap, contact.model.dimensions))


def unit_of_force(contact: Assembly) -> Unit:
    """Return the unit of normal forces of a contact."""
    gap = dimension_of(contact.contact.gap, contact.model.dimensions)
    return spell(impact_energy_dimension(contact.model) / gap, angle=True)


def units_of_friction(every: Sequence[Assembly]) -> list[Unit]:
    """Return the unit of friction forces of each contact; of one without friction that of others, since it has none."""
    model = every[0].model
    power = impact_energy_dimension(model) / model.time_unit.dimension
    slips = [contact.contact.slip for contact in every]
    units = [
        None if slip is None else spell(power / dimension_of(slip, model.dimensions), angle=True) for slip in slips
    ]
    shared = next(unit for unit in units if unit is not None)
    return [shared if unit is None else unit for unit in units]
