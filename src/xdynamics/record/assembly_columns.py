"""Columns of the impacts of many links: which link, which two bodies, and the impulse on each of the two."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of, free_names, text_of
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.march import LogBlock
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, Assembly, assemblies, impulse_quantities
from xdynamics.model.detectors import LINKS
from xdynamics.reaction_names import contact_force, contact_gap, friction_force
from xdynamics.record.closed_link_columns import (
    ClosedLinks,
    closed_link_columns,
    link_places,
    unit_of_force,
    unit_of_gap,
    units_of_friction,
)
from xdynamics.record.column import About, Column, multiply_values
from xdynamics.record.folded_columns import place_variable
from xdynamics.schema import EVENTS, NOWHERE, STEPS, Variable, velocity
from xdynamics.units import TIME, Unit, constant, spell

Array = NDArray[Any]


def assembly_columns(about: About) -> list[Column]:
    """Return what a record has of impacts of many links; nothing without any."""
    if not about.model.assemblies:
        return []
    links = ClosedLinks(assemblies(about.model), lambda block: block.log.closed_rows, iterated=True)
    return [*_impact_places(about), *_impulses(about), *closed_link_columns(about, links), *_body_columns(about)]


def _body_columns(about: About) -> list[Column]:
    """Return gaps and forces of contacts that are of bodies, not of pairs of them: for every body, no force where it is open."""
    model, every = about.model, assemblies(about.model)
    begins = np.cumsum([0, *(assembly.links for assembly in every)])
    collected: list[Column] = []
    for assembly, begin in zip(every, begins.tolist(), strict=False):
        dims, shape = (STEPS, *assembly.dims), model.shapes.shape(assembly.dims)
        if assembly.relation is not None:
            continue
        gap, force = unit_of_gap(assembly), unit_of_force(assembly)
        gap_variable = Variable(
            contact_gap(assembly.name), dims, "f8", gap.text, f"gap of contact {assembly.name}", "gap"
        )
        collected.append(Column(gap_variable, _link_gaps(about, assembly, gap, shape)))
        words = f"normal force of contact {assembly.name}{about.when_forces_act}, positive where it pushes; 0 where it is open"
        pressing = Variable(contact_force(assembly.name), dims, "f8", force.text, words, "reaction")
        collected.append(Column(pressing, _link_values(3, about.units.factor(force), begin, shape)))
        if assembly.contact.slip is not None:
            words = (
                f"friction force of {assembly.name} along positive slip{about.when_forces_act}, against which it acts"
                " while it slips; 0 where it is open"
            )
            (drag,) = units_of_friction([assembly])
            rubbing = Variable(friction_force(assembly.name), dims, "f8", drag.text, words, "reaction")
            collected.append(Column(rubbing, _link_values(5, about.units.factor(drag), begin, shape)))
    return collected


def _link_values(row: int, factor: float, begin: int, shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    """Take numbers of closed links as an array of all links of a contact, which begin at a number among all."""
    count = int(np.prod(shape, dtype=int))

    def take_links(block: LogBlock) -> Array:
        closed, values = block.log.closed_rows, np.zeros((block.rows, count))
        of_contact = (closed[1] >= begin) & (closed[1] < begin + count)
        steps = closed[0, of_contact].astype(np.int64) - int(block.log.base[0]["rows"])
        values[steps, closed[1, of_contact].astype(np.int64) - begin] = multiply_values(closed[row, of_contact], factor)
        return values.reshape(block.rows, *shape)

    return take_links


def _link_gaps(about: About, assembly: Assembly, unit: Unit, shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    """Take the gaps of all links of a contact, computed from the coordinates of each row."""
    model, links = assembly.model, np.arange(assembly.links)
    tree, link_ends, numbers = model.expanded(assembly.contact.gap), assembly.ends(links), assembly.numbers(links)
    read, leaves = free_names(tree), {leaf.name: leaf for leaf in assembly.pattern_inputs}
    elements = {name: assembly.elements(leaf, *link_ends, numbers) for name, leaf in leaves.items() if name in read}
    moving = {leaf.name: leaf.quantity for leaf in assembly.pattern_inputs[: assembly.coordinates] if leaf.name in read}
    constant_values: dict[str, Any] = {"pi": math.pi}
    for name in read - {*moving, "t", "pi"}:
        if name in elements:
            every = model.shapes.elements(leaves[name].quantity)
            constant_values[name] = np.array(
                [model.statement.parameters[every[k]].quantity.si for k in elements[name].tolist()]
            )
        else:
            constant_values[name] = (
                model.statement.parameters[name].quantity.si
                if name in model.statement.parameters
                else float(constant(name).factor)
            )

    def take_gaps(block: LogBlock) -> Array:
        rows, row_index_of = block.log.rows[:, : block.rows], about.layout.row.offset_of
        values = constant_values | {
            "t": multiply_values(rows[row_index_of("time")], about.scales.si_factor(TIME))[:, None]
        }
        for name, quantity in moving.items():
            factor = about.scales.si_factor(model.dimensions[name])
            values[name] = multiply_values(rows[row_index_of(quantity) + elements[name]].T, factor)
        gap_values = np.broadcast_to(evaluate_many(tree, values), (block.rows, assembly.links))
        return multiply_values(gap_values, 1.0 / float(unit.factor)).reshape(block.rows, *shape)

    return take_gaps


def _impact_places(about: About) -> list[Column]:
    """Return the link of each impact along every dimension, and the elements at its ends."""
    return [
        Column(
            place_variable(name, dim, target_dim, about.model.shapes.extent(target_dim)),
            _impact_numbers(about, dim, find),
        )
        for name, dim, target_dim, find in link_places(assemblies(about.model), about.model.shapes)
    ]


def _impact_numbers(about: About, dim: str, find: Callable[[Assembly, Array], Array]) -> Callable[[LogBlock], Array]:
    """Take a number of the link of each impact whose contact has a dimension."""
    owners = {assembly.name: assembly for assembly in assemblies(about.model) if dim in assembly.dims}
    watched = [(i, owners.get(block.name)) for i, block in enumerate(about.layout.watched) if block.role == LINKS]

    def take_numbers(block: LogBlock) -> Array:
        events = block.log.events[: block.events]
        element_numbers = np.full(block.events, NOWHERE, np.int32)
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
    variable: Variable


def impulses_of(every: Sequence[Assembly]) -> Iterator[Impulse]:
    """Yield the impulses on the bodies at both ends of a link."""
    model = every[0].model
    shapes, names = model.shapes, [*model.statement.coordinates]
    moving = [leaf for contact in every for leaf in contact.pattern_inputs[: contact.coordinates]]
    seconds = {leaf.quantity for leaf in moving if leaf.end == SECOND}
    for name, body in impulse_quantities(every).items():
        first_element = shapes.first(name)
        i = names.index(first_element)
        unit = spell(dimension_of(model.mass[i][i], model.dimensions) * model.dimensions[velocity(first_element)])
        further_dims = tuple(dim for dim in shapes.dims.get(name, ()) if dim != body)
        for k, end in enumerate(("first", "second")):
            if k == 0 or name in seconds:
                of_body = f" on the {end} {body} of the link" if body else ""
                variable = Variable(
                    f"event_impulse_{end}_{name}",
                    (EVENTS, *further_dims),
                    "f8",
                    unit.text,
                    f"contact impulse along {name}{of_body}",
                    "event",
                    impact_laws(model),
                )
                yield Impulse(name, body, k, shapes.shape(further_dims), unit, variable)


def _impulses(about: About) -> list[Column]:
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
    speed = about.model.dimensions[velocity(about.model.shapes.first(last.quantity))]
    return [*collected, *_impact_losses(about, 2 * width, last.unit, speed)]


def _impact_losses(about: About, row: int, impulse: Unit, speed: Any) -> list[Column]:
    """Return the energy that impacts took, and the residual of the equations of those that were at one time."""
    energy = spell(impulse.dimension * speed)
    first = next(iter(about.model.assemblies.values()))
    rate = spell(dimension_of(first.gap, about.model.dimensions) / about.model.time_unit.dimension)
    rubs = any(assembly.contact.slip is not None for assembly in assemblies(about.model))
    stopped = ", or as slow motions of a heap were stopped" if rubs else ""
    lost = f"energy that the motion lost in the impact{stopped}, relative to a surface that moves"
    left = (
        "residual of the complementarity problem of all impulses at the time: the largest rate by which a gap still"
        " closes, or opens though it is pressed"
    )
    return [
        Column(
            Variable("event_energy_lost", (EVENTS,), "f8", energy.text, lost, "event"),
            _impulse_rows(row, (), about.units.factor(energy)),
        ),
        Column(
            Variable("event_impulse_residual", (EVENTS,), "f8", rate.text, left, "event"),
            _impulse_rows(row + 1, (), about.units.factor(rate)),
        ),
    ]


def _impulse_rows(row: int, shape: tuple[int, ...], factor: float) -> Callable[[LogBlock], Array]:
    """Take rows of the log of impulses as an array with further dimensions."""
    count = int(np.prod(shape, dtype=int))

    def take_rows(block: LogBlock) -> Array:
        table = multiply_values(block.log.impulses[row : row + count, : block.events], factor)
        return np.ascontiguousarray(table.T).reshape(block.events, *shape)

    return take_rows


def impact_laws(model: Model) -> dict[str, str]:
    """Return the law of impacts, and the order in which they are computed."""
    if not (model.contacts or model.assemblies):
        return {}
    contacts = model.shaped.contacts
    contact = next(iter(contacts.values()))
    restitutions = "; ".join(f"{name}: {text_of(contact.restitution)}" for name, contact in contacts.items())
    return {"impact_law": contact.law, "impact_order": " ".join(contacts), "restitution": restitutions}
