"""Kinetic and potential energy of a model without dimensions, as trees."""

from __future__ import annotations

from collections.abc import Iterable
from functools import reduce

from xdynamics.expressions import Binary, Name, Node, Number
from xdynamics.model.model import Model
from xdynamics.model.motion import in_regimes
from xdynamics.schema import velocity


def energy_trees(model: Model) -> dict[str, Node]:
    """Return kinetic energy and, where a force has a potential, potential and total energy."""
    moving = list(map(velocity, model.statement.coordinates))
    kinetic = _sum_trees(
        Binary("*", Binary("/", model.expanded(entry), Number(2.0)), Binary("*", Name(moving[i]), Name(moving[j])))
        for (i, j), entry in model.statement.mass_entries.items()
    )
    terms = potentials(model)
    if not terms:
        return {"kinetic_energy": kinetic}
    potential = _sum_trees(terms.values())
    total = Binary("+", kinetic, potential)
    return {"kinetic_energy": kinetic, "potential_energy": potential, "total_energy": total}


def potentials(model: Model) -> dict[str, Node]:
    """Return the potential energy of each force term that has one: their sum, in this order, is the potential energy."""
    return {
        name: in_regimes(model, name, model.expanded(force.potential))
        for name, force in model.forces.items()
        if force.potential is not None
    }


def _sum_trees(terms: Iterable[Node]) -> Node:
    return reduce(lambda total, term: Binary("+", total, term), terms)
