"""Columns of a few links whose forces are written out one by one, in the words of those of many.

What each link does stands in flags of a row, and its gap and force in the row, so that its closed links are found there.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.march import LogBlock
from xdynamics.model.assemblies import Assembly, written_assemblies
from xdynamics.model.reactions import NORMAL, reactions
from xdynamics.reaction_names import contact_force, contact_gap, friction_force
from xdynamics.record.assembly_columns import Impulse, impulses_of
from xdynamics.record.closed_link_columns import ClosedLinks, closed_link_columns
from xdynamics.record.column import About, Column, times
from xdynamics.schema import OPEN

Array = NDArray[Any]

FLAGS_BEFORE = 2  # of a row: its kind and its regime


def written_link_columns(about: About) -> list[Column]:
    """Return impulses on both bodies of links, and the links that are closed, of a model with a contact over a relation."""
    every = written_assemblies(about.model)
    if not every:
        return []
    impulses = [Column(one.variable, _impulse(about, every, one)) for one in impulses_of(every)]
    return [*impulses, *closed_link_columns(about, ClosedLinks(every, _closed(about, every), iterated=False))]


def _names(contact: Assembly) -> list[str]:
    """Return the names of all links of a contact."""
    return contact.model.shapes.elements(contact.name)


def _closed(about: About, every: Sequence[Assembly]) -> Callable[[LogBlock], Array]:
    """Take the closed links of each row: row, link, gap, force, nothing, friction force."""
    links = [name for contact in every for name in _names(contact)]
    number = {one.owner: k for k, one in enumerate(reactions(about.model)) if one.sort == NORMAL}
    flags = [FLAGS_BEFORE + number[name] for name in links]
    row, rubbing = about.layout.row, {*about.layout.reactions}
    gaps, forces = ([row.place(named(name)) for name in links] for named in (contact_gap, contact_force))
    pulls = [row.place(friction_force(name)) if friction_force(name) in rubbing else -1 for name in links]

    def take(block: LogBlock) -> Array:
        rows, closed = block.log.rows, block.log.flags[flags, : block.rows].T != OPEN
        steps, own = np.nonzero(closed)
        drags = np.where(np.array(pulls)[own] < 0, 0.0, rows[np.array(pulls)[own], steps])
        first = int(block.log.base[0]["rows"])
        return np.stack(
            [first + steps, own, rows[np.array(gaps)[own], steps], rows[np.array(forces)[own], steps], 0.0 * own, drags]
        )

    return take


def _impulse(about: About, every: Sequence[Assembly], one: Impulse) -> Callable[[LogBlock], Array]:
    """Take the impulse on the body at one end of the link of each event."""
    shapes = about.model.shapes
    dims = shapes.dims.get(one.quantity, ())
    first, shape = about.layout.coordinates.place(one.quantity), shapes.shape(dims)
    axis, factor = 1 + dims.index(one.body) if dims else 0, about.units.factor(one.unit)
    bodies = _bodies(about, every, one)

    def take(block: LogBlock) -> Array:
        size = int(np.prod(shape, dtype=int))
        on_all = times(block.log.impulses[first : first + size, : block.events], factor).T.reshape(-1, *shape)
        if not dims:
            return on_all
        body = bodies[block.log.events["detector"][: block.events]]
        of_body = np.moveaxis(on_all, axis, 1)[np.arange(block.events), body]
        return np.where((body >= 0).reshape(-1, *(1 for _ in one.shape)), of_body, 0.0)

    return take


def _bodies(about: About, every: Sequence[Assembly], one: Impulse) -> Array:
    """Return the body at one end of the link of each detector, -1 where it is of none."""
    found: dict[str, int] = {}
    for contact in every:
        links = np.arange(contact.links)
        leaves = [leaf for leaf in contact.leaves[: contact.coordinates] if leaf.quantity == one.quantity]
        for leaf in leaves:
            if int(leaf.end == "second") == one.end and one.body:
                elements = contact.elements(leaf, *contact.ends(links), contact.numbers(links))
                dims = about.model.shapes.dims[one.quantity]
                places = np.unravel_index(elements, about.model.shapes.shape(dims))[dims.index(one.body)]
                found |= dict(zip(_names(contact), places.tolist(), strict=True))
    return np.array([found.get(detector.name, -1) for detector in about.layout.watched] or [-1])
