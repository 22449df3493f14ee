"""Columns of the impacts of many links: which link, which two bodies, and the impulse on each of the two."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of, text_of
from xdynamics.march import LogBlock
from xdynamics.model import Model
from xdynamics.model.assemblies import SECOND, Assembly, assemblies, bodies
from xdynamics.model.detectors import LINKS
from xdynamics.record.column import About, Column, times
from xdynamics.record.folded_columns import place_variable
from xdynamics.schema import EVENTS, NOWHERE, Variable, velocity
from xdynamics.units import Unit, spell

Array = NDArray[Any]


def assembly_columns(about: About) -> list[Column]:
    """Return what a record has of impacts of many links; nothing without any."""
    if not about.model.assemblies:
        return []
    return [*_places(about), *_impulses(about)]


def _places(about: About) -> list[Column]:
    """Return the link of each impact along every dimension, and the elements at its ends."""
    every, shapes = assemblies(about.model), about.model.shapes
    dims = shapes.ordered({dim for assembly in every for dim in assembly.dims})
    relations = [dim for dim in dims if dim in shapes.relations]
    collected = []
    for dim in dims:
        collected.append(Column(place_variable(dim, shapes.extent(dim)), _looked_up(about, dim, _along(dim))))
        if dim in shapes.relations:
            relation = shapes.relations[dim]
            for k, (end, of) in enumerate((("first", relation.source), ("second", relation.target))):
                name = end if len(relations) == 1 else f"{dim}_{end}"
                variable = place_variable(name, shapes.extent(of))
                collected.append(Column(variable, _looked_up(about, dim, _end(k))))
    return collected


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
    lost = "energy that the motion lost in the impact, relative to a surface that moves"
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
