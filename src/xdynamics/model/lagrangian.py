"""A model from its kinetic and potential energy: mass matrix and velocity terms by the package's own calculus.

Of T = v.M.v/2 + b.v + T0, all of which may depend on coordinates and time, Lagrange's equations are

    M a = dT/dq - sum_j d2T/dv dq_j v_j - d2T/dv dt - dV/dq,    M = d2T/dv dv

(Goldstein, Classical Mechanics, 3rd ed., sections 1.4 and 2.7).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from xdynamics.expressions import Name, Node, derivative, derivatives, expand, free_names
from xdynamics.expressions.calculus import ONE, ZERO, add, multiply, negative
from xdynamics.faults import InputError
from xdynamics.model.parts import Force
from xdynamics.schema import velocity

INERTIA, POTENTIAL = TERMS = ("inertia", "potential")  # force terms derived from a Lagrangian
SAID = "velocity terms of the kinetic energy, by Lagrange's equations"


@dataclass(frozen=True)
class Lagrangian:
    """The energies from which a model is derived.

    Attributes
    ----------
    kinetic : Node
    potential : Node, optional
    """

    kinetic: Node
    potential: Node | None = None


def motion_of(
    energies: Lagrangian, coordinates: list[str], definitions: Mapping[str, Node], constant_names: set[str]
) -> tuple[tuple[tuple[Node, ...], ...], dict[str, Force]]:
    """Derive the mass matrix and the force terms of a Lagrangian.

    Parameters
    ----------
    energies : Lagrangian
    coordinates : list of str
    definitions : mapping of str to Node
    constant_names : set of str
        Names that are constant: parameters.

    Raises
    ------
    InputError
        If the kinetic energy reads anything but time, the motion and constants, or is not quadratic in velocities.
    """
    kinetic = expand(energies.kinetic, definitions)
    velocities = [velocity(name) for name in coordinates]
    if forbidden := sorted(free_names(kinetic) - {"t", *coordinates, *velocities} - constant_names):
        raise InputError(
            f"kinetic reads '{forbidden[0]}'; a kinetic energy is of coordinates, velocities, t and parameters"
        )
    momenta = [derivative(kinetic, {v: ONE}) for v in velocities]
    mass = [[derivative(momentum, {v: ONE}) for v in velocities] for momentum in momenta]
    for i, row in enumerate(mass):
        for j, entry in enumerate(row):
            if moving := sorted(free_names(entry) & set(velocities)):
                raise InputError(
                    f"kinetic is not quadratic in velocities: its second derivative by {velocities[i]} and"
                    f" {velocities[j]} still reads '{moving[0]}'; write squares, like v_x**2 + v_y**2, in the place of"
                    " roots and absolute values"
                )
    if massless := [name for name, row in zip(coordinates, mass, strict=True) if all(entry == ZERO for entry in row)]:
        raise InputError(
            f"kinetic does not read {velocity(massless[0])}, so that '{massless[0]}' has no inertia; add its term, or"
            " make it a first-order state"
        )
    n = len(coordinates)
    # one tree for both sides of the diagonal: mixed derivatives may be written in another order, and round differently
    matrix = tuple(tuple(mass[min(i, j)][max(i, j)] for j in range(n)) for i in range(n))
    forces = {}
    terms = {
        name: _velocity_terms(kinetic, momentum, coordinates, name)
        for name, momentum in zip(coordinates, momenta, strict=True)
    }
    if acting := {name: v for name, v in terms.items() if v != ZERO}:
        forces[INERTIA] = Force(None, dict(acting), SAID, smooth=True)
    if energies.potential is not None:
        forces[POTENTIAL] = Force(energies.potential)
    return matrix, forces


def _velocity_terms(kinetic: Node, momentum: Node, coordinates: list[str], name: str) -> Node:
    """Return dT/dq minus the rate of change of the momentum at constant velocities."""
    total = derivative(kinetic, {name: ONE})
    changes = derivatives(momentum, {variable: {variable: ONE} for variable in (*coordinates, "t")})
    for variable in (*coordinates, "t"):
        if variable in changes:
            change = changes[variable] if variable == "t" else multiply(changes[variable], Name(velocity(variable)))
            total = add(total, negative(change))
    return total
