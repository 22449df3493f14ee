"""Columns of contacts of many bodies: closed links by row, impacts of links, and links that are written out.

Closed links have the contact, the two bodies and the force of each link that is closed in a row.

Impacts have the link, its two bodies, and the impulse on each of the two.

A few links whose forces are written out one by one are recorded in the words of many. The mode of each such link stands
in flags of a row, its gap and force in the row, so that the closed links of the row are read from these.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.expressions import dimension_of, free_names, text_of
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.march import LogBlock
from xdynamics.march.energy_gains import impact_energy_dimension
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, Assembly, assemblies, impulse_quantities, written_assemblies
from xdynamics.model.detectors import LINKS
from xdynamics.model.reactions import NORMAL, reactions
from xdynamics.reaction_names import contact_force, contact_gap, friction_force
from xdynamics.record.column import Column, ColumnContext, multiply_values
from xdynamics.record.folded_columns import element_at, place_variable
from xdynamics.shapes import Shapes
from xdynamics.units import TIME, Unit, constant, spell

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
        """Return the row number of each closed link of a block."""
        return block.numbered(self.rows(block)[0])

    def row_times(self, factor: float) -> Taking:
        """Return a function from a block to the time of each closed link."""

        def take_row_times(block: LogBlock) -> Array:
            places = self.rows(block)[0].astype(np.int64) - int(block.log.base[0]["rows"])
            return multiply_values(block.log.rows[0, places], factor)

        return take_row_times

    def contact_numbers(self, block: LogBlock) -> Array:
        """Return the contact number of each closed link of a block."""
        numbers = np.searchsorted(self._begins, self.rows(block)[1], side="right")
        return np.asarray(numbers - 1, np.int32)

    def element_numbers(self, dim: str, find: Finding) -> Taking:
        """Return a function from a block to a number of each closed link, for contacts with a dimension."""

        def take_element_numbers(block: LogBlock) -> Array:
            numbers, owners = self.rows(block)[1].astype(np.int64), self.contact_numbers(block)
            numbers_by_link = np.full(numbers.size, schema.NOWHERE, np.int32)
            for c, contact in enumerate(self.contacts):
                if dim in contact.dims:
                    numbers_by_link[owners == c] = find(contact, numbers[owners == c] - self._begins[c])
            return numbers_by_link

        return take_element_numbers

    def numbers_in_units(self, row: int, factors: Sequence[float]) -> Taking:
        """Return a function from a block to a number of each closed link, in the unit of its contact."""
        if len({*factors}) == 1:
            return lambda block: multiply_values(self.rows(block)[row], factors[0])
        return lambda block: self.rows(block)[row] * np.array(factors)[self.contact_numbers(block)]


def closed_link_columns(about: ColumnContext, links: ClosedLinks) -> list[Column]:
    """Return the columns of closed links: row, contact, link, elements, gap and force."""
    words = schema.flag_attributes({c: contact.name for c, contact in enumerate(links.contacts)}, "i4")
    contact = replace(_link_variable("contact", "i4", "1", "contact of the link"), role="flag", more=words)
    collected = [
        Column(
            _link_variable("step", "i8", "1", "step_number of the row in which the link is closed"), links.row_numbers
        ),
        Column(replace(schema.CLOSED_AT, units=about.model.time_unit.text), links.row_times(about.units.time)),
        Column(contact, links.contact_numbers),
    ]
    for name, dim, target_dim, find in link_places(links.contacts, about.model.shapes):
        element_variable = place_variable(name, dim, target_dim, about.model.shapes.extent(target_dim))
        which = element_at(name, dim, target_dim).removesuffix(f" of the {dim}")
        long_name = f"{which} of the closed link, counted from 0; {schema.NOWHERE} where its contact has none"
        role = "contact" if element_variable.role == "event" else element_variable.role
        element_variable = replace(
            element_variable, name=schema.at_closed(name), dims=(schema.CLOSED_LINKS,), long_name=long_name, role=role
        )
        collected.append(Column(element_variable, links.element_numbers(dim, find)))
    if links.iterated and any_rubs(links.contacts):
        friction_words = "whether the link sticks or slips from this state on"
        friction_words = (
            friction_words if about.located else "whether the link stuck or slipped over the step before the row"
        )
        states = schema.flag_attributes(dict(enumerate(schema.LINK_STATES)))
        does = replace(_link_variable(FRICTION_STATE, "i1", "1", friction_words), role="flag", more=states)
        collected.append(Column(does, lambda block: np.asarray(links.rows(block)[6].astype(np.int8))))
    return [*collected, *_number_columns(about, links)]


def _number_columns(about: ColumnContext, links: ClosedLinks) -> Iterator[Column]:
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


def _link_variable(name: str, dtype: str, unit: str, long_name: str) -> schema.Variable:
    return schema.Variable(schema.at_closed(name), (schema.CLOSED_LINKS,), dtype, unit, long_name, "contact")


def link_names(model: Model) -> list[str]:
    """Name the variables that list closed links; none without contacts of many links."""
    every = assemblies(model)
    dims = dict.fromkeys(dim for contact in every for dim in contact.dims)
    names = ["step", "contact", *dims, *([FRICTION_STATE] if any_rubs(every) else [])]
    return [*map(schema.at_closed, names)] if every else []


def any_rubs(every: Sequence[Assembly]) -> bool:
    """Whether any contact has friction."""
    return any(contact.contact.slip is not None for contact in every)


def link_places(every: Sequence[Assembly], shapes: Shapes) -> Iterator[tuple[str, str, str, Finding]]:
    """Yield the variables that identify a link: name, dimension of look-up, its own dimension, look-up function."""
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
    return spell(dimension_of(contact.contact.gap, contact.model.elements.dimensions))


def unit_of_force(contact: Assembly) -> Unit:
    """Return the unit of normal forces of a contact."""
    gap = dimension_of(contact.contact.gap, contact.model.elements.dimensions)
    return spell(impact_energy_dimension(contact.model) / gap, angle=True)


def units_of_friction(every: Sequence[Assembly]) -> list[Unit]:
    """Return the unit of friction forces of each contact; of one without friction that of others, since it has none."""
    model = every[0].model
    power = impact_energy_dimension(model) / model.time_unit.dimension
    slips = [contact.contact.slip for contact in every]
    units = [
        None if slip is None else spell(power / dimension_of(slip, model.elements.dimensions), angle=True)
        for slip in slips
    ]
    shared = next(unit for unit in units if unit is not None)
    return [shared if unit is None else unit for unit in units]


def assembly_columns(about: ColumnContext) -> list[Column]:
    """Return the columns of impacts of many links; none without such contacts."""
    if not about.model.assemblies:
        return []
    links = ClosedLinks(assemblies(about.model), lambda block: block.log.closed_rows, iterated=True)
    return [*_impact_places(about), *_impulses(about), *closed_link_columns(about, links), *_body_columns(about)]


def _body_columns(about: ColumnContext) -> list[Column]:
    """Return gaps and forces of contacts that are of bodies, not of pairs of them: for every body, no force where it is open."""
    model, every = about.model, assemblies(about.model)
    begins = np.cumsum([0, *(assembly.links for assembly in every)])
    collected: list[Column] = []
    for assembly, begin in zip(every, begins.tolist(), strict=False):
        dims, shape = (schema.STEPS, *assembly.dims), model.shapes.shape(assembly.dims)
        if assembly.relation is not None:
            continue
        gap, force = unit_of_gap(assembly), unit_of_force(assembly)
        gap_variable = schema.Variable(
            contact_gap(assembly.name), dims, "f8", gap.text, f"gap of contact {assembly.name}", "gap"
        )
        collected.append(Column(gap_variable, _link_gaps(about, assembly, gap, shape)))
        words = f"normal force of contact {assembly.name}{about.when_forces_act}, positive where it pushes; 0 where it is open"
        pressing = schema.Variable(contact_force(assembly.name), dims, "f8", force.text, words, "reaction")
        collected.append(Column(pressing, _link_values(3, about.units.factor(force), begin, shape)))
        if assembly.contact.slip is not None:
            words = (
                f"friction force of {assembly.name} along positive slip{about.when_forces_act}, against which it acts"
                " while it slips; 0 where it is open"
            )
            (drag,) = units_of_friction([assembly])
            rubbing = schema.Variable(friction_force(assembly.name), dims, "f8", drag.text, words, "reaction")
            collected.append(Column(rubbing, _link_values(5, about.units.factor(drag), begin, shape)))
    return collected


def _link_values(row: int, factor: float, begin: int, shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    """Return a function from a block to numbers of a contact's links, 0 where open; `begin` is its first link."""
    count = int(np.prod(shape, dtype=int))

    def take_links(block: LogBlock) -> Array:
        closed, values = block.log.closed_rows, np.zeros((block.rows, count))
        of_contact = (closed[1] >= begin) & (closed[1] < begin + count)
        # the table holds whole numbers as floats, rows among them, counted over the whole march
        steps = closed[0, of_contact].astype(np.int64) - int(block.log.base[0]["rows"])
        values[steps, closed[1, of_contact].astype(np.int64) - begin] = multiply_values(closed[row, of_contact], factor)
        return values.reshape(block.rows, *shape)

    return take_links


def _link_gaps(
    about: ColumnContext, assembly: Assembly, unit: Unit, shape: tuple[int, ...]
) -> Callable[[LogBlock], Array]:
    """Return a function from a block to the gaps of a contact's links, computed from the coordinates of each row."""
    model, links = assembly.model, np.arange(assembly.links)
    tree, link_ends, numbers = (
        model.elements.expanded(assembly.contact.gap),
        assembly.ends(links),
        assembly.numbers(links),
    )
    read, leaves = free_names(tree), {leaf.name: leaf for leaf in assembly.pattern_inputs}
    elements = {name: assembly.elements(leaf, *link_ends, numbers) for name, leaf in leaves.items() if name in read}
    moving = {leaf.name: leaf.quantity for leaf in assembly.pattern_inputs[: assembly.coordinates] if leaf.name in read}
    constant_values: dict[str, Any] = {"pi": math.pi}
    for name in read - {*moving, "t", "pi"}:
        if name in elements:
            every = model.shapes.elements(leaves[name].quantity)
            constant_values[name] = np.array(
                [model.elements.statement.parameters[every[k]].quantity.si for k in elements[name].tolist()]
            )
        else:
            constant_values[name] = (
                model.elements.statement.parameters[name].quantity.si
                if name in model.elements.statement.parameters
                else float(constant(name).factor)
            )

    def take_gaps(block: LogBlock) -> Array:
        rows, row_index_of = block.log.rows[:, : block.rows], about.layout.row.offset_of
        values = constant_values | {
            "t": multiply_values(rows[row_index_of("time")], about.scales.si_factor(TIME))[:, None]
        }
        for name, quantity in moving.items():
            factor = about.scales.si_factor(model.elements.dimensions[name])
            values[name] = multiply_values(rows[row_index_of(quantity) + elements[name]].T, factor)
        gap_values = np.broadcast_to(evaluate_many(tree, values), (block.rows, assembly.links))
        return multiply_values(gap_values, 1.0 / float(unit.factor)).reshape(block.rows, *shape)

    return take_gaps


def _impact_places(about: ColumnContext) -> list[Column]:
    """Return the link of each impact along every dimension, and the elements at its ends."""
    return [
        Column(
            place_variable(name, dim, target_dim, about.model.shapes.extent(target_dim)),
            _impact_numbers(about, dim, find),
        )
        for name, dim, target_dim, find in link_places(assemblies(about.model), about.model.shapes)
    ]


def _impact_numbers(
    about: ColumnContext, dim: str, find: Callable[[Assembly, Array], Array]
) -> Callable[[LogBlock], Array]:
    """Return a function from a block to a number of each impact's link, for contacts along a dimension."""
    owners = {assembly.name: assembly for assembly in assemblies(about.model) if dim in assembly.dims}
    watched = [(i, owners.get(block.name)) for i, block in enumerate(about.layout.watched) if block.role == LINKS]

    def take_numbers(block: LogBlock) -> Array:
        events = block.log.events[: block.events]
        element_numbers = np.full(block.events, schema.NOWHERE, np.int32)
        for number, assembly in watched:
            struck = events["detector"] == number
            if assembly is not None:
                element_numbers[struck] = find(assembly, events["link"][struck])
        return element_numbers

    return take_numbers


class Impulse(NamedTuple):
    """An impulse on the body at one end of the link that was struck.

    Attributes
    ----------
    quantity : str
    body : str
        The dimension that links are between; empty of a quantity without dimensions.
    end : int
        0 of the first end, 1 of the second.
    shape : tuple of int
        Of the quantity of one body.
    unit : Unit
    variable : Variable
    """

    quantity: str
    body: str
    end: int
    shape: tuple[int, ...]
    unit: Unit
    variable: schema.Variable


def impulses_of(every: Sequence[Assembly]) -> Iterator[Impulse]:
    """Yield the impulses on the bodies at both ends of a link."""
    model = every[0].model
    shapes, names = model.shapes, [*model.elements.statement.coordinates]
    moving = [leaf for contact in every for leaf in contact.pattern_inputs[: contact.coordinates]]
    seconds = {leaf.quantity for leaf in moving if leaf.end == SECOND}
    for name, body in impulse_quantities(every).items():
        first_element = shapes.first(name)
        i = names.index(first_element)
        unit = spell(
            dimension_of(model.elements.mass[i][i], model.elements.dimensions)
            * model.elements.dimensions[schema.velocity(first_element)]
        )
        further_dims = tuple(dim for dim in shapes.dims.get(name, ()) if dim != body)
        for k, end in enumerate(("first", "second")):
            if k == 0 or name in seconds:
                of_body = f" on the {end} {body} of the link" if body else ""
                variable = schema.Variable(
                    f"event_impulse_{end}_{name}",
                    (schema.EVENTS, *further_dims),
                    "f8",
                    unit.text,
                    f"contact impulse along {name}{of_body}",
                    "event",
                    impact_laws(model),
                )
                yield Impulse(name, body, k, shapes.shape(further_dims), unit, variable)


def _impulses(about: ColumnContext) -> list[Column]:
    """Return the impulse on the bodies at both ends of the link that was struck, and the energy that was lost."""
    collected, impulses = list[Column](), [*impulses_of(assemblies(about.model))]
    sizes = {impulse.quantity: int(np.prod(impulse.shape, dtype=int)) for impulse in impulses}
    ends = np.cumsum([*sizes.values()])
    first_rows, width = dict(zip(sizes, (ends - [*sizes.values()]).tolist(), strict=True)), int(ends[-1])
    for impulse in impulses:
        take_impulse = _impulse_rows(
            first_rows[impulse.quantity] + impulse.end * width, impulse.shape, about.units.factor(impulse.unit)
        )
        collected.append(Column(impulse.variable, take_impulse))
    last = impulses[-1]
    speed = about.model.elements.dimensions[schema.velocity(about.model.shapes.first(last.quantity))]
    return [*collected, *_impact_losses(about, 2 * width, last.unit, speed)]


def _impact_losses(about: ColumnContext, row: int, impulse: Unit, speed: Any) -> list[Column]:
    """Return the energy that impacts took, and the residual of the equations of those that were at one time."""
    energy = spell(impulse.dimension * speed)
    first = next(iter(about.model.assemblies.values()))
    rate = spell(dimension_of(first.gap, about.model.elements.dimensions) / about.model.time_unit.dimension)
    rubs = any(assembly.contact.slip is not None for assembly in assemblies(about.model))
    stopped = ", or as slow motions of a heap were stopped" if rubs else ""
    lost = f"energy that the motion lost in the impact{stopped}, relative to a surface that moves"
    left = (
        "residual of the complementarity problem of all impulses at the time: the largest rate by which a gap still"
        " closes, or opens though it is pressed"
    )
    return [
        Column(
            schema.Variable("event_energy_lost", (schema.EVENTS,), "f8", energy.text, lost, "event"),
            _impulse_rows(row, (), about.units.factor(energy)),
        ),
        Column(
            schema.Variable("event_impulse_residual", (schema.EVENTS,), "f8", rate.text, left, "event"),
            _impulse_rows(row + 1, (), about.units.factor(rate)),
        ),
    ]


def _impulse_rows(row: int, shape: tuple[int, ...], factor: float) -> Callable[[LogBlock], Array]:
    """Return a function from a block to rows of the log of impulses, shape (events, *shape)."""
    count = int(np.prod(shape, dtype=int))

    def take_rows(block: LogBlock) -> Array:
        table = multiply_values(block.log.impulses[row : row + count, : block.events], factor)
        return np.ascontiguousarray(table.T).reshape(block.events, *shape)

    return take_rows


def impact_laws(model: Model) -> dict[str, str]:
    """Return the law of impacts, and the order in which they are computed."""
    if not (model.elements.contacts or model.assemblies):
        return {}
    contacts = model.statement.contacts
    contact = next(iter(contacts.values()))
    restitutions = "; ".join(f"{name}: {text_of(contact.restitution)}" for name, contact in contacts.items())
    return {"impact_law": contact.law, "impact_order": " ".join(contacts), "restitution": restitutions}


FLAGS_BEFORE = 2  # of a row: its kind and its regime


def written_link_columns(about: ColumnContext) -> list[Column]:
    """Return impulses on both bodies of links, and the links that are closed, of a model with a contact over a relation."""
    every = written_assemblies(about.model)
    if not every:
        return []
    impulses = [Column(impulse.variable, _body_impulse_taker(about, every, impulse)) for impulse in impulses_of(every)]
    return [
        *impulses,
        *closed_link_columns(about, ClosedLinks(every, _closed_link_taker(about, every), iterated=False)),
    ]


def _link_names(contact: Assembly) -> list[str]:
    """Return the names of all links of a contact."""
    return contact.model.shapes.elements(contact.name)


def _closed_link_taker(about: ColumnContext, every: Sequence[Assembly]) -> Callable[[LogBlock], Array]:
    """Return a function from a block to closed links: row, link, gap, force, an unused line, friction force."""
    links = [name for contact in every for name in _link_names(contact)]
    number = {reaction.owner: k for k, reaction in enumerate(reactions(about.model)) if reaction.sort == NORMAL}
    flags = [FLAGS_BEFORE + number[name] for name in links]
    row, rubbing = about.layout.row, {*about.layout.reactions}
    gaps, forces = (
        [row.offset_of(column_name(name)) for name in links] for column_name in (contact_gap, contact_force)
    )
    pulls = [row.offset_of(friction_force(name)) if friction_force(name) in rubbing else -1 for name in links]

    def take_links(block: LogBlock) -> Array:
        rows, closed = block.log.rows, block.log.flags[flags, : block.rows].T != schema.OPEN
        steps, link_indices = np.nonzero(closed)
        # a link without friction has -1, which reads some other row, discarded here
        drags = np.where(np.array(pulls)[link_indices] < 0, 0.0, rows[np.array(pulls)[link_indices], steps])
        first = int(block.log.base[0]["rows"])
        return np.stack(
            [
                first + steps,
                link_indices,
                rows[np.array(gaps)[link_indices], steps],
                rows[np.array(forces)[link_indices], steps],
                0.0 * link_indices,
                drags,
            ]
        )

    return take_links


def _body_impulse_taker(
    about: ColumnContext, every: Sequence[Assembly], impulse: Impulse
) -> Callable[[LogBlock], Array]:
    """Return a function from a block to the impulse on the body at one end of each event's link."""
    shapes = about.model.shapes
    dims = shapes.dims.get(impulse.quantity, ())
    first, shape = about.layout.coordinates.offset_of(impulse.quantity), shapes.shape(dims)
    axis, factor = 1 + dims.index(impulse.body) if dims else 0, about.units.factor(impulse.unit)
    bodies = _bodies_of_detectors(about, every, impulse)

    def take_impulse(block: LogBlock) -> Array:
        size = int(np.prod(shape, dtype=int))
        on_all = multiply_values(block.log.impulses[first : first + size, : block.events], factor).T.reshape(-1, *shape)
        if not dims:
            return on_all
        body = bodies[block.log.events["detector"][: block.events]]
        of_body = np.moveaxis(on_all, axis, 1)[np.arange(block.events), body]
        # -1, of a detector of no link, took the last body, which is put right here
        return np.where((body >= 0).reshape(-1, *(1 for _ in impulse.shape)), of_body, 0.0)

    return take_impulse


def _bodies_of_detectors(about: ColumnContext, every: Sequence[Assembly], impulse: Impulse) -> Array:
    """Return the body at one end of the link of each detector, -1 where it is of none."""
    body_by_detector: dict[str, int] = {}
    for contact in every:
        links = np.arange(contact.links)
        leaves = [leaf for leaf in contact.pattern_inputs[: contact.coordinates] if leaf.quantity == impulse.quantity]
        for leaf in leaves:
            if int(leaf.end == "second") == impulse.end and impulse.body:
                elements = contact.elements(leaf, *contact.ends(links), contact.numbers(links))
                dims = about.model.shapes.dims[impulse.quantity]
                places = np.unravel_index(elements, about.model.shapes.shape(dims))[dims.index(impulse.body)]
                body_by_detector |= dict(zip(_link_names(contact), places.tolist(), strict=True))
    return np.array([body_by_detector.get(detector.name, -1) for detector in about.layout.watched] or [-1])
