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
from xdynamics.record.column import About, Column, multiply_values
from xdynamics.schema import OPEN

Array = NDArray[Any]

FLAGS_BEFORE = 2  # of a row: its kind and its regime


def written_link_columns(about: About) -> list[Column]:
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


def _closed_link_taker(about: About, every: Sequence[Assembly]) -> Callable[[LogBlock], Array]:
    """Take the closed links of each row: row, link, gap, force, nothing, friction force."""
    links = [name for contact in every for name in _link_names(contact)]
    number = {reaction.owner: k for k, reaction in enumerate(reactions(about.model)) if reaction.sort == NORMAL}
    flags = [FLAGS_BEFORE + number[name] for name in links]
    row, rubbing = about.layout.row, {*about.layout.reactions}
    gaps, forces = (
        [row.offset_of(column_name(name)) for name in links] for column_name in (contact_gap, contact_force)
    )
    pulls = [row.offset_of(friction_force(name)) if friction_force(name) in rubbing else -1 for name in links]

    def take_links(block: LogBlock) -> Array:
        rows, closed = block.log.rows, block.log.flags[flags, : block.rows].T != OPEN
        steps, link_indices = np.nonzero(closed)
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


def _body_impulse_taker(about: About, every: Sequence[Assembly], impulse: Impulse) -> Callable[[LogBlock], Array]:
    """Take the impulse on the body at one end of the link of each event."""
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
        return np.where((body >= 0).reshape(-1, *(1 for _ in impulse.shape)), of_body, 0.0)

    return take_impulse


def _bodies_of_detectors(about: About, every: Sequence[Assembly], impulse: Impulse) -> Array:
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
