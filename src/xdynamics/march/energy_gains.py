"""Impacts that create energy, as Newton's law of restitution may with Coulomb friction, and the energy gained."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of
from xdynamics.kernels import Layout
from xdynamics.march.log import Log
from xdynamics.march.run import NO_LINK
from xdynamics.model import Model
from xdynamics.model.assemblies import assemblies, slots_of
from xdynamics.schema import IMPACT, velocity
from xdynamics.units import TIME, Dimension, Scales

Floats = NDArray[np.float64]

LEAST = 1e-9  # of the work of an impact's impulses: less may be rounding


class Gains(NamedTuple):
    """How many groups of impacts created energy, and of the largest gain: energy, time, detector, number, link."""

    groups: float = 0.0
    energy: float = 0.0
    time: float = 0.0
    detector: float = 0.0
    event: float = 0.0
    link: float = NO_LINK


class EventEnergies(NamedTuple):
    """The events of a part of a run.

    Attributes
    ----------
    kind, row, detector, link : ndarray of int, shape (k,)
        Kind of each, row of the state before it, its detector, its link in a contact of many.
    time, lost : ndarray, shape (k,)
    work : ndarray, shape (k,)
        Upper bound of the work of its impulses: the size of the terms of `lost`.
    """

    kind: NDArray[Any]
    row: NDArray[Any]
    detector: NDArray[Any]
    link: NDArray[Any]
    time: Floats
    lost: Floats
    work: Floats


def impact_energy_dimension(model: Model) -> Dimension:
    """Return the dimension of the energy that an impact dissipates."""
    elements = model.elements
    name, dimensions = next(iter(elements.statement.coordinates)), elements.dimensions
    return dimension_of(elements.mass[0][0], dimensions) * dimensions[velocity(name)] ** 2


def place_of_loss(layout: Layout) -> int:
    """Return the row of a log of impulses with the energy that impacts took; -1 where there are none."""
    if layout.model.assemblies:
        return 2 * slots_of(layout.model, layout.coordinates)[1]
    return layout.coordinates.size if layout.reactions else -1


def impacts_of(layout: Layout, scales: Scales, log: Log, count: int) -> EventEnergies:
    """Return the first events of a block of a log, in SI units."""
    events, energy, n = (
        log.events[:count],
        scales.si_factor(impact_energy_dimension(layout.model)),
        place_of_loss(layout),
    )
    first = [layout.row.offset_of(velocity(name)) for name in layout.coordinates]
    rows = [events[row] - int(log.base[0]["rows"]) for row in ("row_before", "row_after")]
    speeds_before, speeds_after = (np.abs(log.rows[first][:, np.minimum(row, log.rows.shape[1] - 1)]) for row in rows)
    work = work_of(layout, log.impulses[:n, :count], speeds_before + speeds_after)
    return EventEnergies(
        events["kind"],
        events["row_before"],
        events["detector"],
        events["link"],
        events["time"] * scales.si_factor(TIME),
        log.impulses[n, :count] * energy,
        work * energy,
    )


def work_of(layout: Layout, impulses: Floats, speeds: Floats) -> Floats:
    """Bound the work of each event's impulses, from those along coordinates and the sums of speeds before and after.

    Impulses of many links are those of two bodies: the largest speed of any body along the same coordinate bounds both.
    """
    if layout.model.assemblies:
        slots, width = slots_of(layout.model, layout.coordinates)
        fastest = np.zeros((width, speeds.shape[1]))
        # unbuffered: coordinates share slots, and of equal indices an assignment would keep the last alone
        np.maximum.at(fastest, slots, speeds)
        speeds = np.concatenate([fastest, fastest])
    return np.asarray(np.sum(np.abs(impulses) * speeds, axis=0) / 2.0)


def _groups_of(layout: Layout, impacts: EventEnergies, indices: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the groups of impacts of many links that are at one time and connected by the bodies they act on."""
    group, owners, moved_coordinates = (
        np.arange(indices.size),
        dict[tuple[int, int], int](),
        _coordinates_of(layout, impacts),
    )
    for k, event in enumerate(indices.tolist()):
        for coordinate in moved_coordinates[event]:
            group_number = group[owners.setdefault((int(impacts.row[event]), coordinate), k)]
            if group_number != group[k]:
                group[group == group[k]] = group_number
    return group


def _coordinates_of(layout: Layout, impacts: EventEnergies) -> list[list[int]]:
    """Return the places of the coordinates that the link of each event moves."""
    moved_coordinates: list[list[int]] = [[] for _ in impacts.link]
    names = [detector.name for detector in layout.watched]
    for assembly in assemblies(layout.model):
        event_indices = np.flatnonzero(impacts.detector == names.index(assembly.name))
        links = impacts.link[event_indices].astype(np.int64)
        first, second = assembly.ends(links)
        for leaf in assembly.pattern_inputs[: assembly.coordinates]:
            begin = layout.coordinates.offset_of(layout.model.shapes.first(leaf.quantity))
            places = begin + assembly.elements(leaf, first, second, assembly.numbers(links))
            for event, coordinate in zip(event_indices.tolist(), places.tolist(), strict=True):
                moved_coordinates[event].append(coordinate)
    return moved_coordinates


def add_gains(gains: Gains, layout: Layout, impacts: EventEnergies, first: int) -> Gains:
    """Return the gains up to the end of a further part of a run, whose events are numbered from `first`.

    Impacts at one time are one group, which may share energy; those of bodies that do not touch are several.
    """
    indices = np.flatnonzero(impacts.kind == IMPACT)
    rows = impacts.row[indices]
    if layout.model.assemblies:
        gaining = rows[impacts.lost[indices] < -LEAST * impacts.work[indices]]
        indices = indices[np.isin(rows, gaining)]
        rows = _groups_of(layout, impacts, indices)
    if not indices.size:
        return gains
    groups, group = np.unique(rows, return_inverse=True)
    lost, work = (np.bincount(group, values[indices], len(groups)) for values in (impacts.lost, impacts.work))
    created = np.flatnonzero(lost < -LEAST * work)
    if not created.size:
        return gains
    worst = created[np.argmin(lost[created])]
    gains = gains._replace(groups=gains.groups + created.size)
    if not -lost[worst] > gains.energy:
        return gains
    members = indices[group == worst]
    event = int(members[np.argmin(impacts.lost[members])])
    return gains._replace(
        energy=float(-lost[worst]),
        time=float(impacts.time[event]),
        detector=float(impacts.detector[event]),
        event=float(first + event),
        link=float(impacts.link[event]),
    )
