"""The motion about one state: exact derivatives of M a = F and of the rates, as trees and as numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Name, Node, derivative
from xdynamics.expressions.calculus import ONE, ZERO, add
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError
from xdynamics.model.drives import coefficients, looked_up
from xdynamics.model.model import Model
from xdynamics.model.parts import Function
from xdynamics.schema import rate, velocity
from xdynamics.units import CONSTANTS, constant

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Linearisation:
    """A model linearised about one state, in SI units.

    With M a = F(t, q, v, x) and x' = r(t, q, v, x), a small change of the state obeys
    M a = -K q - C v + …; the change of M that goes with a change of the state is in K and C:
    da/dz = M^-1 (dF/dz - (dM/dz) a).

    Attributes
    ----------
    names : tuple of str
        Coordinates, velocities, first-order states: the rows and columns of `jacobian`.
    mass, stiffness, damping : ndarray, shape (n, n)
        M, K = -dF/dq + (dM/dq) a, C = -dF/dv + (dM/dv) a for the n coordinates.
    acceleration : ndarray, shape (n,)
        M^-1 F at the state; zero where it is an equilibrium.
    jacobian : ndarray, shape (2n + m, 2n + m)
        Of d/dt (q, v, x) by (q, v, x).
    """

    names: tuple[str, ...]
    mass: Floats
    stiffness: Floats
    damping: Floats
    acceleration: Floats
    jacobian: Floats


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
    Where a derivative does not exist it is the one of the branch taken; beyond a table it is the table's own answer.
    What is infinite or no number stays so in the matrices: nothing is raised for it. A mass matrix that is singular
    gives nan.

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
    """Linearise a model about one state after the other; its trees are differentiated once."""
    forces, force_by, mass_by = force_totals(model), force_derivatives(model), mass_derivatives(model)
    mass = [[model.expanded(entry) for entry in row] for row in model.mass]
    names, constants, tables = variables(model), _constants(model), _tables(model)
    place = {name: i for i, name in enumerate(names)}
    row_of = {name: i for i, name in enumerate(forces)}
    n = len(model.coordinates)
    for state in states:
        values = constants | _checked(model, state)
        values |= _looked_up(model, tables, values)
        total = np.array([evaluate(tree, values) for tree in forces.values()])
        slopes = np.zeros((len(forces), len(names)))
        for (row, by), tree in force_by.items():
            slopes[row_of[row], place[by]] = evaluate(tree, values)
        matrix = np.array([[evaluate(entry, values) for entry in row] for row in mass]).reshape(n, n)
        a = _solved(matrix, total[:n, None])[:, 0]
        for ((i, j), by), tree in mass_by.items():
            slopes[i, place[by]] -= evaluate(tree, values) * a[j]
        accelerations = _solved(matrix, slopes[:n])
        jacobian = np.vstack([np.eye(n, len(names), n), accelerations, slopes[n:]])
        yield Linearisation(names, matrix, 0.0 - slopes[:n, :n], 0.0 - slopes[:n, n : 2 * n], a, jacobian)


def initial_state(model: Model) -> dict[str, float]:
    """Return a model's initial time and state in SI units."""
    return {name: model.initial[name].si for name in ("t", *variables(model))}


def variables(model: Model) -> tuple[str, ...]:
    """Return what the motion is differentiated by: coordinates, velocities, first-order states."""
    return (*model.coordinates, *(velocity(name) for name in model.coordinates), *model.states)


@lru_cache(maxsize=64)
def force_totals(model: Model) -> dict[str, Node]:
    """Return the whole force of each coordinate as ``force_<coordinate>`` and the rate of each state as ``rate_<state>``.

    Raises
    ------
    InputError
        If a force is written in Python: it has no tree.
    """
    if functions := model.python_forces:
        named = ", ".join(f"'{one.name}'" for one in functions)
        raise InputError(
            f"model '{model.name}' has forces written in Python, {named}, which have no derivative;"
            " write them as expressions to linearise the model"
        )
    totals: dict[str, Node] = {f"force_{name}": ZERO for name in model.coordinates}
    for parts in model.force_components.values():
        for name, one in parts.items():
            if not isinstance(one, Function):
                totals[f"force_{name}"] = add(totals[f"force_{name}"], model.expanded(one))
    return totals | {rate(name): model.expanded(state.rate) for name, state in model.states.items()}


@lru_cache(maxsize=64)
def force_derivatives(model: Model) -> dict[tuple[str, str], Node]:
    """Differentiate every force total and rate by every coordinate, velocity and state.

    Returns
    -------
    dict of (str, str) to Node
        By what is differentiated, ``force_<coordinate>`` or ``rate_<state>``, and by what; zeros are left out. The
        slope of a drive of a coordinate or velocity stands as the name ``_slope_<drive>``; a drive of time has none.

    Raises
    ------
    InputError
        If a force is written in Python.
    """
    return {
        (name, by): found
        for name, tree in force_totals(model).items()
        for by, found in _derivatives(model, tree)
    }  # fmt: skip


@lru_cache(maxsize=64)
def mass_derivatives(model: Model) -> dict[tuple[tuple[int, int], str], Node]:
    """Differentiate every mass entry by every coordinate, velocity and state.

    Returns
    -------
    dict of ((int, int), str) to Node
        By row and column, from 0, and by what; zeros are left out. Slopes of drives are named as in `force_derivatives`.
    """
    return {
        ((i, j), by): found
        for i, row in enumerate(model.mass)
        for j, entry in enumerate(row)
        for by, found in _derivatives(model, model.expanded(entry))
    }


def _derivatives(model: Model, tree: Node) -> Iterator[tuple[str, Node]]:
    """Yield the partial derivatives that are not zero, each with its variable."""
    for by in variables(model):
        slopes: dict[str, Node] = {
            name: Name(f"_slope_{name}") for name, drive in model.drives.items() if drive.argument == by
        }
        found = derivative(tree, {by: ONE} | slopes)
        if found != ZERO:
            yield by, found


def _constants(model: Model) -> dict[str, float]:
    """Return parameters, unit constants and pi as SI numbers."""
    values = {name: one.quantity.si for name, one in model.parameters.items()}
    return values | {name: float(constant(name).factor) for name in CONSTANTS} | {"pi": math.pi}


def _checked(model: Model, state: Mapping[str, float]) -> dict[str, float]:
    needed = ("t", *variables(model))
    if missing := [name for name in needed if name not in state]:
        raise InputError(
            f"state of model '{model.name}' has no {', '.join(missing)}; give SI numbers for {', '.join(needed)}"
        )
    return {name: float(state[name]) for name in needed}


def _tables(model: Model) -> dict[str, tuple[Floats, Floats]]:
    """Return the pieces of every drive, in SI units."""
    return {
        name: coefficients(
            one.table.argument, one.table.value, one.interpolation, one.outside, of_time=one.argument == "t"
        )
        for name, one in model.drives.items()
    }


def _looked_up(
    model: Model, tables: Mapping[str, tuple[Floats, Floats]], values: Mapping[str, float]
) -> dict[str, float]:
    """Return every drive and its slope, from the piece that a march would take at these values."""
    found = {}
    for name, table in tables.items():
        argument = model.drives[name].argument
        found[name], found[f"_slope_{name}"] = looked_up(table, values[argument], of_time=argument == "t")
    return found


def _solved(matrix: Floats, right: Floats) -> Floats:
    """Solve by a mass matrix; nan where it is singular."""
    try:
        solution = np.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:
        solution = np.full_like(right, np.nan)
    return np.asarray(solution, dtype=np.float64)
