"""Columns of the impacts of many links: which link, which two bodies, and the impulse on each of the two."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of, free_names, text_of
from xdynamics.expressions.evaluation import evaluate_many
from xdynamics.march import LogBlock
from xdynamics.march.energy_gains import energy_dimension
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, Assembly, assemblies, bodies
from xdynamics.model.detectors import LINKS
from xdynamics.reaction_names import contact_force, contact_gap, friction_force
from xdynamics.record.column import About, Column, times
from xdynamics.record.folded_columns import place_variable
from xdynamics.schema import CLOSED_LINKS, EVENTS, NOWHERE, STEPS, Variable, at_closed, flags, velocity
from xdynamics.units import NONE, TIME, Unit, constant, spell

Array = NDArray[Any]


def assembly_columns(about: About) -> list[Column]:
    """Return what a record has of impacts of many links; nothing without any."""
    if not about.model.assemblies:
        return []
    return [*_places(about), *_impulses(about), *_of_closed(about), *_of_bodies(about)]


def _of_bodies(about: About) -> list[Column]:
    """Return gaps and forces of contacts that are of bodies, not of pairs of them: for every body, no force where it is open."""
    model, every = about.model, assemblies(about.model)
    begins = np.cumsum([0, *(assembly.links for assembly in every)])
    force, drag, collected = _unit_of_force(model), _unit_of_friction(model), []
    for assembly, begin in zip(every, begins.tolist(), strict=False):
        dims, shape = (STEPS, *assembly.dims), model.shapes.shape(assembly.dims)
        if assembly.relation is not None:
            continue
        gap = spell(dimension_of(assembly.contact.gap, model.dimensions))
        apart = Variable(contact_gap(assembly.name), dims, "f8", gap.text, f"gap of contact {assembly.name}", "gap")
        collected.append(Column(apart, _gaps(about, assembly, gap, shape)))
        words = f"normal force of contact {assembly.name}, positive where it pushes; 0 where it is open"
        pressing = Variable(contact_force(assembly.name), dims, "f8", force.text, words, "reaction")
        collected.append(Column(pressing, _spread(3, about.units.factor(force), begin, shape)))
        if assembly.contact.slip is not None:
            words = (
                f"friction force of {assembly.name} along positive slip, against which it acts while it slips; 0 where it"
                " is open"
            )
            rubbing = Variable(friction_force(assembly.name), dims, "f8", drag.text, words, "reaction")
            collected.append(Column(rubbing, _spread(5, about.units.factor(drag), begin, shape)))
    return collected


def _spread(row: int, factor: float, begin: int, shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    """Take numbers of closed links as an array of all links of a contact, which begin at a number among all."""
    count = int(np.prod(shape, dtype=int))

    def take(block: LogBlock) -> Array:
        closed, values = block.log.closed_rows, np.zeros((block.rows, count))
        own = (closed[1] >= begin) & (closed[1] < begin + count)
        steps = closed[0, own].astype(np.int64) - int(block.log.base[0]["rows"])
        values[steps, closed[1, own].astype(np.int64) - begin] = times(closed[row, own], factor)
        return values.reshape(block.rows, *shape)

    return take


def _gaps(about: About, assembly: Assembly, unit: Unit, shape: tuple[int, ...]) -> Callable[[LogBlock], Array]:
    """Take the gaps of all links of a contact, computed from the coordinates of each row."""
    model, links = assembly.model, np.arange(assembly.links)
    tree, own, numbers = model.expanded(assembly.contact.gap), assembly.ends(links), assembly.numbers(links)
    read, leaves = free_names(tree), {leaf.name: leaf for leaf in assembly.leaves}
    elements = {name: assembly.elements(leaf, *own, numbers) for name, leaf in leaves.items() if name in read}
    moving = {leaf.name: leaf.quantity for leaf in assembly.leaves[: assembly.coordinates] if leaf.name in read}
    known: dict[str, Any] = {"pi": math.pi}
    for name in read - {*moving, "t", "pi"}:
        if name in elements:
            every = model.shapes.elements(leaves[name].quantity)
            known[name] = np.array([model.parameters[every[k]].quantity.si for k in elements[name].tolist()])
        else:
            known[name] = (
                model.parameters[name].quantity.si if name in model.parameters else float(constant(name).factor)
            )

    def take(block: LogBlock) -> Array:
        rows, place = block.log.rows[:, : block.rows], about.layout.row.place
        values = known | {"t": times(rows[place("time")], about.scales.of(TIME))[:, None]}
        for name, quantity in moving.items():
            factor = about.scales.of(model.dimensions[name])
            values[name] = times(rows[place(quantity) + elements[name]].T, factor)
        found = np.broadcast_to(evaluate_many(tree, values), (block.rows, assembly.links))
        return times(found, 1.0 / float(unit.factor)).reshape(block.rows, *shape)

    return take


def _unit_of_force(model: Model) -> Unit:
    """Return the unit of normal forces."""
    gap = dimension_of(assemblies(model)[0].contact.gap, model.dimensions)
    return spell(energy_dimension(model) / gap, angle=gap == NONE)


def _unit_of_friction(model: Model) -> Unit:
    """Return the unit of friction forces, or of normal ones where there are none."""
    slips = [assembly.contact.slip for assembly in assemblies(model) if assembly.contact.slip is not None]
    if not slips:
        return _unit_of_force(model)
    power = energy_dimension(model) / model.time_unit.dimension
    return spell(power / dimension_of(slips[0], model.dimensions))


def _of_closed(about: About) -> list[Column]:
    """Return what is closed in each row: the row, the contact, the link, its elements, its gap and its force."""
    model, every = about.model, assemblies(about.model)
    begins = np.cumsum([0, *(assembly.links for assembly in every)])

    def contact(block: LogBlock) -> Array:
        return np.asarray(np.searchsorted(begins, block.log.closed_rows[1], side="right") - 1)

    def along(dim: str, find: Callable[[Assembly, Array], Array]) -> Callable[[LogBlock], Array]:
        def take(block: LogBlock) -> Array:
            numbers, owners = block.log.closed_rows[1].astype(np.int64), contact(block)
            found = np.full(numbers.size, NOWHERE, np.int32)
            for c, assembly in enumerate(every):
                if dim in assembly.dims:
                    found[owners == c] = find(assembly, numbers[owners == c] - begins[c])
            return found

        return take

    def number(row: int, unit: Unit) -> Callable[[LogBlock], Array]:
        return lambda block: times(block.log.closed_rows[row], about.units.factor(unit))

    gap, force = spell(dimension_of(every[0].contact.gap, model.dimensions)), _unit_of_force(model)
    words = flags({c: assembly.name for c, assembly in enumerate(every)}, "i4")
    collected = [
        Column(_variable("step", "i8", "1", "row of `step` in which the link is closed"), _row_of_closed),
        Column(
            replace(_variable("contact", "i4", "1", "contact of the link"), role="flag", more=words),
            lambda block: contact(block).astype(np.int32),
        ),
    ]
    for name, dim, of, find in _found(about):
        at = place_variable(name, about.model.shapes.extent(of))
        long_name = f"{name} of the link, counted from 0; {NOWHERE} where its contact has none"
        role = "contact" if at.role == "event" else at.role
        at = replace(at, name=at_closed(name), dims=(CLOSED_LINKS,), long_name=long_name, role=role)
        collected.append(Column(at, along(dim, find)))
    left = spell(gap.dimension / model.time_unit.dimension**2)
    words_of_force = "normal force of the link, which presses where it is positive"
    words_of_left = (
        "residual of the equations of all forces: the acceleration with which the gap of the link still opens"
    )
    collected += [
        Column(_variable("gap", "f8", gap.text, "gap of the link, which is held at zero"), number(2, gap)),
        Column(_variable("force", "f8", force.text, words_of_force), number(3, force)),
        Column(_variable("force_residual", "f8", left.text, words_of_left), number(4, left)),
    ]
    if any(assembly.contact.slip is not None for assembly in every):
        drag = _unit_of_friction(model)
        long_name = "friction force of the link along its positive slip, against which it acts while it slips"
        collected.append(Column(_variable("friction_force", "f8", drag.text, long_name), number(5, drag)))
    return collected


def _row_of_closed(block: LogBlock) -> Array:
    return np.asarray(block.log.closed_rows[0].astype(np.int64))


def _variable(name: str, dtype: str, unit: str, long_name: str) -> Variable:
    return Variable(at_closed(name), (CLOSED_LINKS,), dtype, unit, long_name, "contact")


def _found(about: About) -> Iterator[tuple[str, str, str, Callable[[Assembly, Array], Array]]]:
    """Yield what says which link it is: its name, the dimension it is found by, that it is of, how it is found."""
    every, shapes = assemblies(about.model), about.model.shapes
    dims = shapes.ordered({dim for assembly in every for dim in assembly.dims})
    relations = [dim for dim in dims if dim in shapes.relations]
    for dim in dims:
        yield dim, dim, dim, _along(dim)
        if dim in shapes.relations:
            relation = shapes.relations[dim]
            for k, (end, of) in enumerate((("first", relation.source), ("second", relation.target))):
                yield end if len(relations) == 1 else f"{dim}_{end}", dim, of, _end(k)


def _places(about: About) -> list[Column]:
    """Return the link of each impact along every dimension, and the elements at its ends."""
    return [
        Column(place_variable(name, about.model.shapes.extent(of)), _looked_up(about, dim, find))
        for name, dim, of, find in _found(about)
    ]


def _along(dim: str) -> Callable[[Assembly, Array], Array]:
    return lambda assembly, links: assembly.numbers(links)[dim]


def _end(k: int) -> Callable[[Assembly, Array], Array]:
    return lambda assembly, links: assembly.ends(links)[k]


def _looked_up(about: About, dim: str, find: Callable[[Assembly, Array], Array]) -> Callable[[LogBlock], Array]:
    """Take a number of the link of each impact whose contact has a dimension."""
    owners = {assembly.name: assembly for assembly in assemblies(about.model) if dim in assembly.dims}
    watched = [(i, owners.get(block.name)) for i, block in enumerate(about.layout.watched) if block.role == LINKS]

    def take(block: LogBlock) -> Array:
        events = block.log.events[: block.events]
        found = np.full(block.events, NOWHERE, np.int32)
        for number, assembly in watched:
            struck = events["detector"] == number
            if assembly is not None:
                found[struck] = find(assembly, events["link"][struck])
        return found

    return take


def _impulses(about: About) -> list[Column]:
    """Return the impulse on the bodies at both ends of the link that was struck, and the energy that was lost."""
    model, units, collected, row = about.model, about.units, list[Column](), 0
    shapes, all_bodies = model.shapes, bodies(about.model)
    width = sum(int(np.prod(_rest(about, name, body)[1], dtype=int)) for name, body in all_bodies.items())
    names = [*model.coordinates]
    seconds = {
        leaf.quantity
        for assembly in assemblies(model)
        for leaf in assembly.leaves[: assembly.coordinates]
        if leaf.end == SECOND
    }
    for name, body in all_bodies.items():
        one = shapes.first(name)
        i = names.index(one)
        dimension = dimension_of(model.mass[i][i], model.dimensions) * model.dimensions[velocity(one)]
        unit, (rest, shape) = spell(dimension), _rest(about, name, body)
        for k, end in enumerate(("first", "second")):
            if k == 0 or name in seconds:
                long_name = f"contact impulse along {name} on the {end} {body} of the link"
                variable = Variable(
                    f"event_impulse_{end}_{name}",
                    (EVENTS, *rest),
                    "f8",
                    unit.text,
                    long_name,
                    "event",
                    impact_laws(model),
                )
                collected.append(Column(variable, _rows(row + k * width, shape, units.factor(unit))))
        row += int(np.prod(shape, dtype=int))
    return [*collected, *_judged(about, 2 * width, unit, model.dimensions[velocity(one)])]


def _judged(about: About, row: int, impulse: Unit, speed: Any) -> list[Column]:
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
            _rows(row, (), about.units.factor(energy)),
        ),
        Column(
            Variable("event_impulse_residual", (EVENTS,), "f8", rate.text, left, "event"),
            _rows(row + 1, (), about.units.factor(rate)),
        ),
    ]


def _rest(about: About, name: str, body: str) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return the dimensions of a quantity of one body, and their lengths."""
    shapes = about.model.shapes
    rest = tuple(dim for dim in shapes.dims[name] if dim != body)
    return rest, shapes.shape(rest)


def _rows(row: int, shape: tuple[int, ...], factor: float) -> Callable[[LogBlock], Array]:
    """Take rows of the log of impulses as an array with further dimensions."""
    count = int(np.prod(shape, dtype=int))

    def take(block: LogBlock) -> Array:
        table = times(block.log.impulses[row : row + count, : block.events], factor)
        return np.ascontiguousarray(table.T).reshape(block.events, *shape)

    return take


def impact_laws(model: Model) -> dict[str, str]:
    """Return the law of impacts, and the order in which they are computed."""
    if not (model.contacts or model.assemblies):
        return {}
    contacts = model.shaped.contacts
    contact = next(iter(contacts.values()))
    restitutions = "; ".join(f"{name}: {text_of(contact.restitution)}" for name, contact in contacts.items())
    return {"impact_law": contact.law, "impact_order": " ".join(contacts), "restitution": restitutions}
