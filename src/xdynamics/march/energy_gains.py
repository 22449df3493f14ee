"""Impacts that create energy, as Newton's law of restitution may with Coulomb friction: which ones, and how much."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import dimension_of
from xdynamics.kernels import Layout
from xdynamics.march.log import Log
from xdynamics.model import Model
from xdynamics.model.assemblies import slots_of
from xdynamics.schema import IMPACT, velocity
from xdynamics.units import TIME, Dimension, Scales

Floats = NDArray[np.float64]

LEAST = 1e-9  # of the work of an impact's impulses: less may be rounding


class Gains(NamedTuple):
    """How many groups of impacts created energy, and of the largest gain: energy, time, detector, event number."""

    groups: float = 0.0
    energy: float = 0.0
    time: float = 0.0
    detector: float = 0.0
    event: float = 0.0


class EventEnergies(NamedTuple):
    """The events of a part of a run.

    Attributes
    ----------
    kind, row, detector : ndarray of int, shape (k,)
        Kind of each, row of the state before it, its detector.
    time, lost : ndarray, shape (k,)
    work : ndarray, shape (k,)
        Upper bound of the work of its impulses: the size of the terms of `lost`.
    """

    kind: NDArray[Any]
    row: NDArray[Any]
    detector: NDArray[Any]
    time: Floats
    lost: Floats
    work: Floats


def energy_dimension(model: Model) -> Dimension:
    """Return the dimension of the energy that an impact dissipates."""
    name, dimensions = next(iter(model.coordinates)), model.dimensions
    return dimension_of(model.mass[0][0], dimensions) * dimensions[velocity(name)] ** 2


def place_of_loss(layout: Layout) -> int:
    """Return the row of a log of impulses with the energy that impacts took; -1 where there are none."""
    if layout.model.assemblies:
        return 2 * slots_of(layout.model, layout.coordinates)[1]
    return layout.coordinates.size if layout.reactions else -1


def impacts_of(layout: Layout, scales: Scales, log: Log, count: int) -> EventEnergies:
    """Return the first events of a block of a log, in SI units."""
    events, energy, n = log.events[:count], scales.of(energy_dimension(layout.model)), place_of_loss(layout)
    first = [layout.row.place(velocity(name)) for name in layout.coordinates]
    rows = [events[row] - int(log.base[0]["rows"]) for row in ("row_before", "row_after")]
    speeds = sum(np.abs(log.rows[first][:, np.minimum(row, log.rows.shape[1] - 1)]) for row in rows)
    if layout.model.assemblies:  # impulses are those of two bodies: of the largest speed, whichever these are
        work = np.sum(np.abs(log.impulses[:n, :count]), axis=0) * np.max(speeds, axis=0) / 2.0
    else:
        work = np.sum(np.abs(log.impulses[:n, :count]) * speeds, axis=0) / 2.0
    return EventEnergies(
        events["kind"],
        events["row_before"],
        events["detector"],
        events["time"] * scales.of(TIME),
        log.impulses[n, :count] * energy,
        work * energy,
    )


def with_more(gains: Gains, impacts: EventEnergies, first: int) -> Gains:
    """Return the gains up to the end of a further part of a run, whose events are numbered from `first`."""
    indices = np.flatnonzero(impacts.kind == IMPACT)
    if not indices.size:
        return gains
    groups, group = np.unique(impacts.row[indices], return_inverse=True)
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
    )
