"""Impacts of a run checked against the law of its contacts: impulses, rates, friction bounds, energies.

Everything is recomputed from the two recorded states of an impact, with expressions of the model and a mass
matrix evaluated in Python, independently of the march.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.expressions import Node
from xdynamics.expressions.calculus import ZERO
from xdynamics.model import Model
from xdynamics.model.linearisation import mass_matrices
from xdynamics.model.motion import constants, drive_pieces, evaluate_over_states, kinetic_as_written
from xdynamics.model.reactions import DRY, Reaction, rate_dimension, reactions
from xdynamics.reaction_names import contact_gap
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.named_rows import rows_named
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import IMPACT, RESET_KIND, acceleration, velocity
from xdynamics.units import parse_unit, spell, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]

ROUNDINGS = 256.0  # of the terms of a sum, times the condition of the mass matrix
NEAR = 1e-9  # of the largest gap: a contact as near as that may take part in another one's impact
OF_RATES = ("newton", "sequential")


@dataclass(frozen=True)
class Check:
    """One relation over all impacts, at the impact where it is violated most relative to its bound.

    Attributes
    ----------
    name, relation, observable, units : str
    residual, bound : float
        Of that impact; nan if there is nothing to compare.
    where : str
    note : str
        Why there is nothing to compare.
    """

    name: str
    relation: str
    observable: str
    units: str
    residual: float = np.nan
    bound: float = np.nan
    where: str = ""
    note: str = ""


class Impacts:
    """The impacts of a run: one row for each contact that took part in one, in SI units."""

    def __init__(self, run: xr.Dataset, model: Model) -> None:
        self.run, self.model = run, model
        kind, row = run["event_kind"].values, rows_named(run, "event_row_before")
        reset = np.isin(row, row[kind == RESET_KIND])  # velocities that a reset sets do not follow from impulses
        self.events = np.flatnonzero((kind == IMPACT) & ~reset)
        self.rows = row[self.events], rows_named(run, "event_row_after")[self.events]
        self.groups, self.group = np.unique(self.rows[0], return_inverse=True)
        labels = run["event_detector"].attrs["flag_meanings"].split()
        self.owners = [labels[i] for i in run["event_detector"].values[self.events].tolist()]
        self.impulses = np.stack(
            [self._event_column(f"event_impulse_{name}") for name in model.elements.statement.coordinates], axis=1
        )
        self.speeds = [self._coordinate_columns(velocity, rows) for rows in self.rows]
        self.accelerations = [self._coordinate_columns(acceleration, rows) for rows in self.rows]
        self.lost = self._event_column("event_energy_lost")

    def _event_column(self, name: str) -> Floats:
        values: Floats = self.run[name].values[self.events] * float(parse_unit(self.run[name].attrs["units"]).factor)
        return values

    def column(self, name: str, rows: Any) -> Floats:
        """Return a variable in rows of the run."""
        values: Floats = self.run[name].values[rows] * float(parse_unit(self.run[name].attrs["units"]).factor)
        return values

    def _coordinate_columns(self, name_rule: Any, rows: Any) -> Floats:
        return np.stack(
            [self.column(name_rule(name), rows) for name in self.model.elements.statement.coordinates], axis=1
        )

    def state(self, rows: Any) -> dict[str, Floats]:
        """Return time, coordinates, velocities and first-order states in rows of the run."""
        elements = self.model.elements
        names = (
            "time",
            *elements.statement.coordinates,
            *map(velocity, elements.statement.coordinates),
            *elements.statement.states,
        )
        columns = {name: self.column(name, rows) for name in names}
        return {"t": columns.pop("time")} | columns

    @cached_property
    def masses(self) -> Floats:
        """Mass matrix at every impact."""
        states_before = self.state(self.rows[0])
        states = ({name: float(values[i]) for name, values in states_before.items()} for i in range(len(self.events)))
        return np.array(list(mass_matrices(self.model, states)))

    @cached_property
    def conditions(self) -> Floats:
        """Condition of each mass matrix with ones on its diagonal."""
        size = np.sqrt(np.diagonal(self.masses, axis1=1, axis2=2))
        # scaled so, it does not depend on the units of coordinates
        condition: Floats = np.linalg.cond(self.masses / (size[:, :, None] * size[:, None, :]))
        return condition

    @cached_property
    def rounding(self) -> Floats:
        """The rounding error of a sum, as a fraction of its terms."""
        return ROUNDINGS * EPS * self.conditions

    def values(self, tree: Node, side: int) -> Floats:
        """Evaluate an expression of the model before (0) or after (1) every impact."""
        numbers = evaluate_over_states(
            self.model, [tree], self.state(self.rows[side]), constants(self.model), drive_pieces(self.model)
        )[0]
        return np.broadcast_to(np.asarray(numbers, float), (len(self.events),))

    def row_of(self, reaction: Reaction) -> Floats:
        """Return the derivative of a reaction's rate by the velocities at every impact."""
        trees = [reaction.row.get(name, ZERO) for name in self.model.elements.statement.coordinates]
        return np.stack([self.values(tree, 0) for tree in trees], axis=1)

    def members_of(self, name: str) -> NDArray[np.int64]:
        """Return the indices of the impacts of a contact."""
        return np.array([i for i, owner in enumerate(self.owners) if owner == name], np.int64)


def checks_of(run: xr.Dataset, model: Model) -> Iterator[Check]:
    """Yield the checks of a run's impacts; none if there are no impacts."""
    if not model.elements.contacts or "event_energy_lost" not in run or not (run["event_kind"].values == IMPACT).any():
        return
    impacts = Impacts(run, model)
    yield from _of_impulses(impacts)
    for name in model.elements.contacts:
        if impacts.members_of(name).size:
            yield from _of_contact(impacts, name)


def _impulse_tolerances(impacts: Impacts) -> Floats:
    """Return how much impulses may differ because events are located to within the time tolerance.

    A contact that comes to rest loses the rate that it may have gained within that time.
    """
    tolerance = float(impacts.run.attrs["solver_time_tolerance"])
    tolerances = [
        entry.time_tolerance.si
        for entry in impacts.model.elements.contacts.values()
        if entry.time_tolerance is not None
    ]
    terms = [np.abs(impacts.masses) @ np.abs(entry)[:, :, None] for entry in impacts.accelerations]
    change: Floats = max([tolerance, *tolerances]) * (terms[0] + terms[1])[:, :, 0]
    return change


def _of_impulses(impacts: Impacts) -> Iterator[Check]:
    """Check impulses against the jump of velocities in the metric of the mass, and energies against impulses."""
    run, (speeds_before, speeds_after) = impacts.run, impacts.speeds
    first = np.unique(impacts.group, return_index=True)[1]
    jump = (impacts.masses @ (speeds_after - speeds_before)[:, :, None])[first, :, 0]
    size = (np.abs(impacts.masses) @ (np.abs(speeds_after) + np.abs(speeds_before))[:, :, None])[first, :, 0]
    total = np.zeros((len(first), speeds_before.shape[1]))
    # several impacts belong to one instant: indexed addition in place would keep the last of them alone
    np.add.at(total, impacts.group, impacts.impulses)
    impulse_tolerances, rounding = _impulse_tolerances(impacts)[first], impacts.rounding[first, None]
    for i, name in enumerate(impacts.model.elements.statement.coordinates):
        units = str(run[f"event_impulse_{name}"].attrs["units"])
        relation = f"sum of event_impulse_{name} = row {name} of M (v after - v before)"
        bound = (rounding * (size + np.abs(total)) + impulse_tolerances)[:, i]
        yield _worst_impact(
            impacts,
            f"impulse_{name}",
            relation,
            f"event_impulse_{name}",
            units,
            np.abs(jump - total)[:, i],
            bound,
            first,
        )
    if "kinetic_energy" not in run or kinetic_as_written(impacts.model) is not None:  # what is driven does work, too
        return
    kinetic = [impacts.column("kinetic_energy", rows)[first] for rows in impacts.rows]
    work = np.sum(total * (speeds_before + speeds_after)[first], axis=1) / 2.0
    scale = np.sum((size + np.abs(total)) * (np.abs(speeds_before) + np.abs(speeds_after))[first], axis=1)
    slack = np.sum(impulse_tolerances * (np.abs(speeds_before) + np.abs(speeds_after))[first], axis=1)
    units = str(run["event_energy_lost"].attrs["units"])
    relation = "kinetic energy after - before = sum of impulses times (v before + v after)/2"
    residual = np.abs(kinetic[1] - kinetic[0] - work)
    yield _worst_impact(
        impacts, "kinetic_energy", relation, "kinetic_energy", units, residual, rounding[:, 0] * scale + slack, first
    )


@dataclass(frozen=True)
class _ContactImpacts:
    """The impacts of one contact: rates before and after, impulses, and their rounding errors.

    Attributes
    ----------
    name : str
    parts : list of Reaction
        Normal, then tangential; n of them.
    members : ndarray of int, shape (k,)
        Which impacts these are.
    rows : ndarray, shape (k, coordinates, n)
        The directions in which each part acts.
    impulse : ndarray, shape (k, coordinates)
    strength : ndarray, shape (k, n)
        Of each part, by least squares.
    rates_before, rates_after, noise : ndarray, shape (k, n)
        Rates of the parts at both sides, and their roundoff.
    rounding : ndarray, shape (k, 1)
    """

    name: str
    parts: list[Reaction]
    members: NDArray[np.int64]
    rows: Floats
    impulse: Floats
    strength: Floats
    rates_before: Floats
    rates_after: Floats
    noise: Floats
    rounding: Floats

    @classmethod
    def of(cls, impacts: Impacts, name: str) -> _ContactImpacts:
        """Collect the impacts of a contact."""
        members = impacts.members_of(name)
        parts = [reaction for reaction in reactions(impacts.model) if reaction.owner == name and reaction.sort != DRY]
        rows = np.stack([impacts.row_of(reaction)[members] for reaction in parts], axis=2)
        impulse, rounding = impacts.impulses[members], impacts.rounding[members]
        strength = np.stack(
            [np.linalg.lstsq(row, reaction, rcond=None)[0] for row, reaction in zip(rows, impulse, strict=True)]
        )
        rates_before, rates_after = (
            np.stack([impacts.values(reaction.rate, side)[members] for reaction in parts], axis=1) for side in (0, 1)
        )
        speeds = np.abs(impacts.speeds[0][members]) + np.abs(impacts.speeds[1][members])
        size = np.sum(np.abs(rows) * speeds[:, :, None], axis=1) + np.abs(rates_before) + np.abs(rates_after)
        noise = rounding[:, None] * size + _rate_tolerances(impacts, parts)[members]
        return cls(name, parts, members, rows, impulse, strength, rates_before, rates_after, noise, rounding)


def _of_contact(impacts: Impacts, name: str) -> Iterator[Check]:
    """Check the impulses of one contact against its directions and friction, its rates and energy against its law."""
    struck = _ContactImpacts.of(impacts, name)
    deviation = np.linalg.norm(
        struck.impulse - np.einsum("kij,kj->ki", struck.rows, struck.strength), axis=1
    ) / np.linalg.norm(struck.impulse, axis=1)
    relation = "impulse is along the gradient of the gap, and the slip's"
    yield _worst_impact(
        impacts, f"{name}.direction", relation, "event_impulse", "1", deviation, struck.rounding, struck.members
    )
    yield _restitution_check(impacts, struck)
    if len(struck.parts) > 1:
        yield _friction_check(impacts, struck)
    yield _energy_check(impacts, struck)


def _restitution_check(impacts: Impacts, struck: _ContactImpacts) -> Check:
    """Check the rate after an impact against the law of restitution."""
    name, members, normal = struck.name, struck.members, struck.parts[0]
    law = impacts.model.elements.contacts[name].law
    unit, observable = spell(rate_dimension(impacts.model, normal)).text, f"rates of contact {name}"
    relation = (
        "rate after = -e times rate before; where others are struck too, at least that by newton, else at least 0"
    )
    if len(struck.parts) > 1 and law not in OF_RATES:
        why = f"law = '{law}' with friction relates impulses, or work, within an impact, and not the rates at its ends"
        return Check(f"{name}.restitution", relation, observable, unit, note=why)
    mismatch = struck.rates_after[:, 0] + impacts.values(normal.size, 0)[members] * np.minimum(
        struck.rates_before[:, 0], 0.0
    )
    checked_rates = mismatch if law == "newton" else struck.rates_after[:, 0]
    residual = np.where(_single_contact_impacts(impacts)[members], np.abs(mismatch), np.maximum(0.0, -checked_rates))
    return _worst_impact(
        impacts, f"{name}.restitution", relation, observable, unit, residual, struck.noise[:, 0], members
    )


def _friction_check(impacts: Impacts, struck: _ContactImpacts) -> Check:
    """Check the tangential impulse against Coulomb's law."""
    friction = impacts.values(struck.parts[1].size, 0)[struck.members]
    excess = np.maximum(0.0, np.abs(struck.strength[:, 1]) / np.abs(struck.strength[:, 0]) - friction)
    relation = "|tangential impulse| <= friction times normal impulse"
    bound = struck.rounding * (1.0 + friction) * np.linalg.cond(struck.rows)
    return _worst_impact(
        impacts, f"{struck.name}.friction", relation, "event_impulse", "1", excess, bound, struck.members
    )


def _energy_check(impacts: Impacts, struck: _ContactImpacts) -> Check:
    """Check the energy that an impact took against the work of its impulses."""
    members, law = struck.members, impacts.model.elements.contacts[struck.name].law
    loss = -np.sum(struck.strength * (struck.rates_before + struck.rates_after), axis=1) / 2.0
    relation = "energy lost = -(impulses times (rates before + after)/2)"
    number, unit = f"{struck.name}.energy_lost", str(impacts.run["event_energy_lost"].attrs["units"])
    bound = np.sum(np.abs(struck.strength) * struck.noise, axis=1)
    deviation = np.abs(impacts.lost[members] - loss)
    ends = _single_contact_impacts(impacts)[members] | (
        law != "sequential"
    )  # strikes one contact after the other, at rates in between
    if not ends.any():
        why = (
            "law = 'sequential' takes energy strike by strike, where others are struck too, and not by the rates at the"
            " ends"
        )
        return Check(number, relation, "event_energy_lost", unit, note=why)
    return _worst_impact(
        impacts, number, relation, "event_energy_lost", unit, deviation[ends], bound[ends], members[ends]
    )


def _single_contact_impacts(impacts: Impacts) -> NDArray[np.bool_]:
    """Tell which impacts are of a single contact, with no other one near enough to take part."""
    is_single: NDArray[np.bool_] = np.bincount(impacts.group)[impacts.group] == 1
    for name, contact in impacts.model.elements.contacts.items():
        near = np.abs(impacts.values(impacts.model.elements.expanded(contact.gap), 0)) <= NEAR * _largest_gap(
            impacts, name
        )
        is_single &= ~near | np.array([owner == name for owner in impacts.owners])
    return is_single


def _largest_gap(impacts: Impacts, name: str) -> float:
    gap = impacts.run[contact_gap(name)]
    return float(np.max(np.abs(gap.values))) * float(parse_unit(gap.attrs["units"]).factor)


def _rate_tolerances(impacts: Impacts, parts: list[Reaction]) -> Floats:
    """Return by how much the rates of a contact may change within the time tolerance."""
    tolerance, changes = float(impacts.run.attrs["solver_time_tolerance"]), []
    tolerances = [
        part.time_tolerance.si for part in impacts.model.elements.contacts.values() if part.time_tolerance is not None
    ]
    for part in parts:
        row, bias = np.abs(impacts.row_of(part)), np.abs(impacts.values(part.bias, 0))
        changes.append(bias + sum(np.sum(row * np.abs(speed_rate), axis=1) for speed_rate in impacts.accelerations))
    return max([tolerance, *tolerances]) * np.stack(changes, axis=1)


def _worst_impact(
    impacts: Impacts,
    name: str,
    relation: str,
    observable: str,
    units: str,
    residual: Floats,
    bound: Floats,
    members: Any,
) -> Check:
    """Return the impact at which a relation is violated most."""
    k = int(np.argmax(residual / np.maximum(bound, np.finfo(float).tiny)))
    event = int(impacts.events[members[k]])
    where = f"{len(residual)} impacts, worst at event {event}, t = {float(impacts.run['event_time'][event]):.6g}"
    where += unit_suffix(time_unit_of(impacts.run))
    return Check(name, relation, observable, units, float(residual[k]), float(bound[k]), where)
