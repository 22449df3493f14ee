"""Where each number of a march stands: in the state, in a force evaluation, in a row of the log."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from xdynamics import schema
from xdynamics.expressions import Binary, Name, Node, Number
from xdynamics.model import Model
from xdynamics.units import Dimension


@dataclass(frozen=True)
class Layout:
    """The order of names in the tuples and blocks of a compiled march.

    A state is one tuple: coordinates, velocities, first-order states, then what the force evaluation at that state
    gave: accelerations, rates, force components. It is all that the next step needs.
    """

    model: Model

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Names of the coordinates."""
        return tuple(self.model.coordinates)

    @cached_property
    def velocities(self) -> tuple[str, ...]:
        """Names of the velocities."""
        return tuple(schema.velocity(name) for name in self.coordinates)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the first-order states."""
        return tuple(self.model.states)

    @cached_property
    def accelerations(self) -> tuple[str, ...]:
        """Names of the accelerations."""
        return tuple(schema.acceleration(name) for name in self.coordinates)

    @cached_property
    def rates(self) -> tuple[str, ...]:
        """Names of the first-order states' rates."""
        return tuple(schema.rate(name) for name in self.states)

    @cached_property
    def forces(self) -> tuple[str, ...]:
        """Names of the force components, term by term."""
        terms = self.model.force_components
        return tuple(schema.force(term, name) for term, parts in terms.items() for name in parts)

    @property
    def drives(self) -> tuple[str, ...]:
        """Names of the drives."""
        return tuple(self.model.drives)

    @property
    def used(self) -> tuple[str, ...]:
        """What a force evaluation uses besides time."""
        return self.coordinates + self.velocities + self.states

    @property
    def state(self) -> tuple[str, ...]:
        """Everything in a state tuple."""
        return self.used + self.accelerations + self.rates + self.forces

    @property
    def evaluation(self) -> tuple[str, ...]:
        """What a force evaluation returns."""
        return self.accelerations + self.rates + self.forces + self.drives

    @cached_property
    def derived(self) -> dict[str, Node]:
        """Energies and observables, computed when a row is noted."""
        return self._energies() | {name: self.model.expanded(node) for name, node in self.model.observables.items()}

    @property
    def row(self) -> tuple[str, ...]:
        """The float columns of a logged row."""
        return ("time", "step_size", *self.state, *self.derived)

    @property
    def sample(self) -> tuple[str, ...]:
        """The float columns of a logged force sample."""
        return ("time", "step", "stage", *self.used, *self.forces, *self.drives)

    @property
    def time_drives(self) -> tuple[str, ...]:
        """Drives of time; each has its own piece index, that stays the same throughout a step."""
        return tuple(name for name, drive in self.model.drives.items() if drive.argument == "t")

    @property
    def energy_dimension(self) -> Dimension | None:
        """The dimension of kinetic energy, if the terms of all coordinates share one."""
        from xdynamics.expressions import dimension_of

        known = self.model.dimensions
        found = {
            dimension_of(self.model.mass[i][i], known) * known[schema.velocity(name)] ** 2
            for i, name in enumerate(self.coordinates)
        }
        return found.pop() if len(found) == 1 else None

    def _energies(self) -> dict[str, Node]:
        """Kinetic energy, and where a potential is known potential and total energy."""
        if self.energy_dimension is None:
            return {}
        half_square = [
            Binary(
                "*",
                Binary("/", self.model.expanded(entry), Number(2.0)),
                Binary("*", Name(self.velocities[i]), Name(self.velocities[j])),
            )
            for i, row in enumerate(self.model.mass)
            for j, entry in enumerate(row)
            if entry != Number(0.0)
        ]
        kinetic = _sum(half_square)
        terms = [
            self.model.expanded(force.potential) for force in self.model.forces.values() if force.potential is not None
        ]
        if not terms:
            return {"kinetic_energy": kinetic}
        potential = _sum(terms)
        return {
            "kinetic_energy": kinetic,
            "potential_energy": potential,
            "total_energy": Binary("+", kinetic, potential),
        }


def _sum(terms: Sequence[Node]) -> Node:
    total = terms[0]
    for term in terms[1:]:
        total = Binary("+", total, term)
    return total
