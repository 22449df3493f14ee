"""The motion about one state: exact derivatives of M a = F and of the rates, as trees and as numbers."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError
from xdynamics.model.bodies import unit_quaternions
from xdynamics.model.derivatives import jacobian_names, tape
from xdynamics.model.model import Model
from xdynamics.model.motion import constants, drive_pieces, motion_inputs, variables
from xdynamics.model.tangent_space import displacement_turning, displacements, tangent_space
from xdynamics.model.whole_jacobian import is_densely_linked, quantity_jacobian
from xdynamics.schema import acceleration, rate

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Linearisation:
    """A model linearised about one state, in SI units.

    With M a = F(t, q, v, x) and x' = r(t, q, v, x), a small change of the state obeys
    M a = -K q - C v + …; the change of M with the state is included in K and C (the latter stands in the Jacobian):
    da/dz = M^-1 (dF/dz - (dM/dz) a).

    Attributes
    ----------
    names : tuple of str
        Coordinates, velocities, first-order states: the rows and columns of `jacobian`.
    mass, stiffness : ndarray, shape (n, n)
        M, K = -dF/dq + (dM/dq) a for the n coordinates; attitudes of bodies go with how far these have turned.
    acceleration : ndarray, shape (n,)
        M^-1 F at the state; zero where it is an equilibrium.
    jacobian : ndarray, shape (2n + m, 2n + m)
        Of d/dt (q, v, x) by (q, v, x).
    displacements : ndarray, shape (n, f)
        Independent changes of coordinates, as columns, along which no constraint acts; the unit matrix without any.
    changes : ndarray, shape (2n + m, d)
        Those of (q, v, x) that keep the constraints.
    turning : ndarray, shape (n, f)
        What velocities follow a unit of each displacement by, where constraints turn it as the motion goes on.
    """

    names: tuple[str, ...]
    mass: Floats
    stiffness: Floats
    acceleration: Floats
    jacobian: Floats
    displacements: Floats
    changes: Floats
    turning: Floats

    @property
    def displacement_matrices(self) -> tuple[Floats, Floats]:
        """K and M of the displacements, shapes (f, f)."""
        space, turning_part = self.displacements, self.turning
        if len(space) == space.shape[1]:
            return self.stiffness, self.mass
        return space.T @ self.stiffness @ space - turning_part.T @ self.mass @ turning_part, space.T @ self.mass @ space

    @property
    def reduced(self) -> Floats:
        """The Jacobian of the changes that keep the constraints, shape (d, d)."""
        space, n = self.changes, len(self.mass)
        if len(space) == space.shape[1]:
            return self.jacobian
        left = space.T.copy()  # without what velocities follow by: numbers of unlike units are not added
        follows = np.delete(space, np.s_[n : 2 * n], axis=0).any(axis=0)
        left[follows, n : 2 * n] = 0.0
        reduced_matrix, free = np.asarray(left @ self.jacobian @ space), self.turning.shape[1]
        if self.turning.any():  # see `tangent_space.displacement_turning`, here in the metric of the coordinates
            following = space[n : 2 * n, :free]
            reduced_matrix[free : 2 * free, :free] += following.T @ following
        return reduced_matrix


def linearise(model: Model, state: Mapping[str, float]) -> Linearisation:
    """Linearise a model about a state, by exact derivatives.

    Parameters
    ----------
    model : Model
    state : mapping of str to float
        SI numbers for `t`, every coordinate, velocity and first-order state.

    Raises
    ------
    InputError
        If a force is written in Python, or the state lacks a number.

    Notes
    -----
    Where a derivative does not exist, that of the branch taken is used; beyond a table, what the table gives there.
    Infinite values and nan stay in the matrices without an error. A singular mass matrix gives nan.

    Examples
    --------
    >>> spring = Model(
    ...     name="spring", coordinates={"x": "m"}, parameters={"m": "2 kg", "k": "8 N m-1"}, mass={"x": "m"},
    ...     forces={"spring": {"potential": "k*x**2/2"}}, initial={"x": "1 m", "v_x": "0 m s-1"},
    ... )
    >>> linearise(spring, initial_state(spring)).jacobian.tolist()
    [[0.0, 1.0], [-4.0, 0.0]]
    """
    return next(linearise_each(model, [state]))


def linearise_each(model: Model, states: Iterable[Mapping[str, float]]) -> Iterator[Linearisation]:
    """Linearise a model about several states in turn; its trees are differentiated once.

    Raises
    ------
    InputError
        If a force is written in Python, or a state lacks a number.
    """
    constant_values, tables, names = constants(model), drive_pieces(model), variables(model)
    n, column_of = len(model.statement.coordinates), {name: i for i, name in enumerate(names)}
    mass = {row_column: model.expanded(entry) for row_column, entry in model.statement.mass_entries.items()}
    attitudes = [column_of[part] for parts in unit_quaternions(model.shaped.bodies, model.shapes) for part in parts]
    derived = _derivatives_by_quantity if is_densely_linked(model) else _derivatives_by_element
    for state in states:
        values = motion_inputs(model, _checked_state(model, state), constant_values, tables)
        matrix = np.zeros((n, n))
        a, derivatives, slopes = derived(model, values)
        for row_column, entry in mass.items():
            matrix[row_column] = evaluate(entry, values)
        slopes = np.diagonal(matrix)[:, np.newaxis] * derivatives[:n] if slopes is None else slopes
        full_jacobian = np.vstack([np.eye(n, len(names), n), derivatives])
        stiffness = 0.0 - slopes[:, :n] - slopes[:, attitudes] @ full_jacobian[attitudes, n : 2 * n]
        spaces = displacements(model, values), tangent_space(model, values), displacement_turning(model, values, matrix)
        yield Linearisation(names, matrix, stiffness, a, full_jacobian, *spaces)


def _derivatives_by_quantity(model: Model, values: dict[str, float]) -> tuple[Floats, Floats, None]:
    """Return accelerations and the derivatives of accelerations and rates; those of forces follow, as masses are diagonal."""
    return *quantity_jacobian(model, values), None


def _derivatives_by_element(model: Model, values: dict[str, float]) -> tuple[Floats, Floats, Floats]:
    """Return accelerations, the derivatives of accelerations and rates, and dF - dM a; add all that they follow from."""
    names, n = variables(model), len(model.statement.coordinates)
    column_of = {name: i for i, name in enumerate(names)}
    row_of = {
        name: i
        for i, name in enumerate((*model.statement.coordinates, *(rate(name) for name in model.statement.states)))
    }
    values |= tape(model).evaluate_tape(values)
    derivatives, slopes = np.zeros((len(row_of), len(names))), np.zeros((n, len(names)))
    for (row, variable), name in jacobian_names(model).items():
        row_column = row_of[row], column_of[variable]
        derivatives[row_column] = values[name]
        if row_column[0] < n:
            slopes[row_column] = values[f"_s_{row}_{variable}"]
    return np.array([values[acceleration(name)] for name in model.statement.coordinates]), derivatives, slopes


def mass_matrices(model: Model, states: Iterable[Mapping[str, float]]) -> Iterator[Floats]:
    """Yield the mass matrix at each state, SI units; states as `linearise` takes them.

    Raises
    ------
    InputError
        If a state lacks a number.
    """
    constant_values, tables, n = constants(model), drive_pieces(model), len(model.statement.coordinates)
    entries = {row_column: model.expanded(entry) for row_column, entry in model.statement.mass_entries.items()}
    for state in states:
        values = motion_inputs(model, _checked_state(model, state), constant_values, tables)
        matrix = np.zeros((n, n))
        for row_column, entry in entries.items():
            matrix[row_column] = evaluate(entry, values)
        yield matrix


def initial_state(model: Model) -> dict[str, float]:
    """Return a model's initial time and state in SI units."""
    return {name: model.statement.initial[name].si for name in ("t", *variables(model))}


def _checked_state(model: Model, state: Mapping[str, float]) -> dict[str, float]:
    needed = ("t", *variables(model))
    if missing := [name for name in needed if name not in state]:
        raise InputError(
            f"state of model '{model.name}' has no {', '.join(missing)}; give SI numbers for {', '.join(needed)}"
        )
    return {name: float(state[name]) for name in needed}
