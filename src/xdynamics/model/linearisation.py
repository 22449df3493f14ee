"""The motion about one state: exact derivatives of M a = F and of the rates, as trees and as numbers.

Derivatives are by every coordinate, velocity and state. Where constraints hold, the motion is linearised along the
small changes that they allow: conditions g(t, q, x) = 0 leave changes with (dg/dq) dq + (dg/dx) dx = 0, and their rates
the corresponding changes of (q, v, x).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Binary, Name, Node, derivatives, free_names
from xdynamics.expressions.calculus import ONE, ZERO, add, multiply
from xdynamics.expressions.evaluation import Tape, evaluate
from xdynamics.faults import InputError
from xdynamics.model.body_sections import unit_quaternions
from xdynamics.model.constraint_consistency import INDEPENDENT, over_mass
from xdynamics.model.constraints import Assignment, conditions, keep_conditions, solve_mass, subtract_terms
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.model import Model
from xdynamics.model.motion import (
    change_name,
    changes_of_quantities,
    constants,
    drive_pieces,
    drive_slope,
    in_regimes,
    motion,
    motion_inputs,
    moves_by_quantities,
    shapes_of_changes,
    state_quantities,
    variables,
)
from xdynamics.model.parts import Function
from xdynamics.reaction_names import constraint_force
from xdynamics.schema import acceleration, rate
from xdynamics.shapes.blocks import Block
from xdynamics.shapes.evaluation import evaluate_elements
from xdynamics.shapes.extents import Extent


@lru_cache(maxsize=64)
def derivative_assignments(model: Model) -> tuple[Assignment, ...]:
    """Write the derivatives of accelerations and rates, to follow `motion`: M da = dF - dM a.

    Names: ``_dF_x_by`` for the derivative of a force total or rate, ``_s_x_by`` for dF - dM a, ``_da_x_by``.

    Raises
    ------
    InputError
        If a force is written in Python.
    """
    model = model.elements
    forces, masses = force_derivatives(model), mass_derivatives(model)
    assignments = [Assignment(f"_dF_{key}_{variable}", tree) for (key, variable), tree in forces.items()]
    assignments += [Assignment(f"_dM_{i}_{j}_{variable}", tree) for ((i, j), variable), tree in masses.items()]
    for variable, right in _force_changes(model).items():
        assignments += [Assignment(f"_s_{name}_{variable}", tree) for name, tree in right.items()]
        name_format = "_da_{}_{}" if not model.constraints else "_free_da_{}_{}"
        assignments += solve_mass(
            model, {name_format.format(name, variable): Name(f"_s_{name}_{variable}") for name in right}, list(right)
        )
        assignments += _constrained_derivatives(model, variable) if model.constraints else ()
    return tuple(assignments)


def _constrained_derivatives(model: Model, variable: str) -> Iterator[Assignment]:
    """Write the derivatives of accelerations by one variable where conditions hold: of R a + bias = 0, too."""
    free = {name: Name(f"_free_da_{name}_{variable}") for name in _force_changes(model)[variable]}
    lags = [_lag(model, k, variable) for k in range(len(conditions(model)))]
    targets = {name: f"_da_{name}_{variable}" for name in model.elements.statement.coordinates}
    yield from keep_conditions(model, free, lags, targets, [f"_du{k}_{variable}" for k in range(len(lags))])


def _lag(model: Model, k: int, variable: str) -> Node:
    """Return the derivative of a condition's bias, and of its row at these accelerations."""
    bias, rows = _condition_derivatives(model)[k]
    total = bias.get(variable, ZERO)
    for name, entry_slopes in rows.items():
        total = add(total, multiply(entry_slopes.get(variable, ZERO), Name(acceleration(name))))
    return total


@lru_cache(maxsize=16)
def _condition_derivatives(model: Model) -> list[tuple[dict[str, Node], dict[str, dict[str, Node]]]]:
    """Return the derivatives of each condition's bias, and of the entries of its row."""
    return [
        (
            dict(_sorted_derivatives(model, condition.bias)),
            {name: dict(_sorted_derivatives(model, tree)) for name, tree in condition.row.items()},
        )
        for condition in conditions(model)
    ]


@lru_cache(maxsize=64)
def _force_changes(model: Model) -> dict[str, dict[str, Node]]:
    """Return dF - dM a by the variable of differentiation and then by coordinate, in their orders.

    With a diagonal mass, zeros are left out; the factors of a full one couple each row to all others.
    """
    inertia_terms: dict[tuple[str, str], list[Node]] = {}
    coordinates = list(model.elements.statement.coordinates)
    for (i, j), variable in mass_derivatives(model):
        term = Binary("*", Name(f"_dM_{i}_{j}_{variable}"), Name(acceleration(coordinates[j])))
        inertia_terms.setdefault((coordinates[i], variable), []).append(term)
    forces: dict[tuple[str, str], Node] = {
        pair: Name(f"_dF_force_{pair[0]}_{pair[1]}") for pair in _acting_pairs(model)
    }
    for condition, (_, rows) in zip(conditions(model), _condition_derivatives(model), strict=True):
        for name, derivatives_of_row in rows.items():
            for variable, row_derivative in derivatives_of_row.items():
                pulled = multiply(row_derivative, Name(constraint_force(condition.name)))
                forces[name, variable] = add(forces.get((name, variable), ZERO), pulled)
    coupled = model.elements.mass_is_full or bool(model.constraints)
    full = ((name, variable) for name in coordinates for variable in variables(model)) if coupled else ()
    ranks = _variable_ranks(model)
    changes: dict[str, dict[str, Node]] = {}
    for name, variable in sorted({*forces, *inertia_terms, *full}, key=lambda pair: (ranks[pair[1]], ranks[pair[0]])):
        changes.setdefault(variable, {})[name] = subtract_terms(
            forces.get((name, variable), ZERO), inertia_terms.get((name, variable), ())
        )
    return changes


def _acting_pairs(model: Model) -> list[tuple[str, str]]:
    """Return the pairs of a coordinate and a variable that its force depends on."""
    owners = {f"force_{name}": name for name in model.elements.statement.coordinates}
    return [(owners[key], variable) for key, variable in force_derivatives(model) if key in owners]


def jacobian_names(model: Model) -> dict[tuple[str, str], str]:
    """Return the name of every derivative of an acceleration or rate that is not identically zero.

    Returns
    -------
    dict of (str, str) to str
        Keyed by a coordinate (for its acceleration) or the rate of a state, and the variable of differentiation.
    """
    model = model.elements
    columns = _variable_ranks(model)
    rows = {name: i for i, name in enumerate((*model.statement.coordinates, *map(rate, model.statement.states)))}
    names = {
        (name, variable): f"_da_{name}_{variable}"
        for variable, right in _force_changes(model).items()
        for name in right
    }
    names |= {(key, variable): f"_dF_{key}_{variable}" for key, variable in force_derivatives(model) if key in rows}
    return {pair: names[pair] for pair in sorted(names, key=lambda pair: (rows[pair[0]], columns[pair[1]]))}


@lru_cache(maxsize=64)
def force_totals(model: Model) -> dict[str, Node]:
    """Return the total force of each coordinate, ``force_<coordinate>``, and the rate of each state, ``rate_<state>``.

    Raises
    ------
    InputError
        If a force is written in Python: it has no tree.
    """
    elements = model.elements
    if functions := model.python_forces:
        function_names = ", ".join(f"'{component.name}'" for component in functions)
        raise InputError(
            f"model '{model.name}' has forces written in Python, {function_names}, which have no derivative;"
            " write them as expressions to linearise the model"
        )
    totals: dict[str, Node] = {f"force_{name}": ZERO for name in elements.statement.coordinates}
    for term, components in elements.force_components.items():
        for name, component in components.items():
            if not isinstance(component, Function):
                tree = in_regimes(model, term, elements.expanded(component))
                totals[f"force_{name}"] = add(totals[f"force_{name}"], tree)
    return totals | {rate(name): elements.expanded(state.rate) for name, state in elements.statement.states.items()}


@lru_cache(maxsize=64)
def force_derivatives(model: Model) -> dict[tuple[str, str], Node]:
    """Differentiate every force total and rate by every coordinate, velocity and state.

    Returns
    -------
    dict of (str, str) to Node
        Keyed by the function, ``force_<coordinate>`` or ``rate_<state>``, and the variable; zeros are left out. The
        slope of a drive of a coordinate or velocity appears as the name ``_slope_<drive>``; a drive of time has none.

    Raises
    ------
    InputError
        If a force is written in Python.
    """
    return {
        (name, variable): derivative
        for name, tree in force_totals(model).items()
        for variable, derivative in _sorted_derivatives(model, tree)
    }


@lru_cache(maxsize=64)
def mass_derivatives(model: Model) -> dict[tuple[tuple[int, int], str], Node]:
    """Differentiate every mass entry by every coordinate, velocity and state.

    Returns
    -------
    dict of ((int, int), str) to Node
        Keyed by row and column, from 0, and variable; zeros are left out. Slopes of drives as in `force_derivatives`.
    """
    return {
        ((i, j), variable): derivative
        for (i, j), entry in model.elements.statement.mass_entries.items()
        for variable, derivative in _sorted_derivatives(model, model.elements.expanded(entry))
    }


@lru_cache(maxsize=16)
def tape(model: Model) -> Tape:
    """Return the operations of the motion and its derivatives; there may be many thousands of them."""
    return Tape(
        (assignment.name, assignment.value)
        for assignment in (*motion(model.elements), *derivative_assignments(model))
        if not isinstance(assignment.value, Function)
    )


@lru_cache(maxsize=64)
def _variable_ranks(model: Model) -> dict[str, int]:
    """Number the variables of the motion; the number of a coordinate is its row of the mass too."""
    return {name: i for i, name in enumerate(variables(model))}


@lru_cache(maxsize=64)
def _variable_seeds(model: Model) -> dict[str, dict[str, Node]]:
    """Return the derivative of each variable, and of each drive of one, by that variable."""
    seeds: dict[str, dict[str, Node]] = {name: {name: ONE} for name in variables(model)}
    return seeds | {
        name: {
            variable: multiply(Name(drive_slope(name)), rate) for variable, rate in derivatives(argument, seeds).items()
        }
        for name, argument in model.elements.looked_up_at.items()
        if argument != CLOCK
    }


def _sorted_derivatives(model: Model, tree: Node) -> list[tuple[str, Node]]:
    """Return the non-zero partial derivatives, each with its variable."""
    return sorted(derivatives(tree, _variable_seeds(model)).items(), key=lambda pair: _variable_ranks(model)[pair[0]])


Floats = NDArray[np.float64]


def tangent_space(model: Model, values: Mapping[str, float]) -> Floats:
    """Return independent changes of (q, v, x) that keep the constraints, as columns.

    Parameters
    ----------
    model : Model
    values : mapping of str to float
        SI numbers of all names at the state.

    Returns
    -------
    ndarray, shape (2n + m, d)
        Where no condition reads a state and none rolls, d is 2f + m with f = `free_coordinates`: changes of coordinates,
        with what velocities change by them, then of velocities, then of states. Otherwise changes of (q, x) together, with
        what velocities change by them, then of velocities. Apart from what follows, either are orthonormal.
    """
    n, size, free = len(model.elements.statement.coordinates), len(variables(model)), free_coordinates(model)
    if not model.constraints:
        return np.eye(size)
    residuals, rates = _gradients(model, values)
    ties, position_columns = rates[:, n : 2 * n], np.r_[0:n, 2 * n : size]
    speeds = _null_space(ties, free or n - independent_counts(model)[0])
    if free:
        moves = np.zeros((size - n, free + size - 2 * n))
        moves[:n, :free], moves[n:, free:] = speeds, np.eye(size - 2 * n)
    else:
        moves = _null_space(residuals[:, position_columns], size - independent_counts(model)[1] - speeds.shape[1])
    following = -np.linalg.pinv(ties, rcond=INDEPENDENT) @ rates[:, position_columns] @ moves
    return _in_order(moves, following, speeds, free or moves.shape[1])


def _in_order(moves: Floats, following: Floats, speeds: Floats, first: int) -> Floats:
    """Return changes ordered as (q, v, x): coordinates with their velocities' response, velocities, then states."""
    n, count = len(speeds), moves.shape[1] + speeds.shape[1]
    space = np.zeros((n + len(moves), count))
    places = np.r_[0:first, first + speeds.shape[1] : count]
    space[:n, places], space[2 * n :, places] = moves[:n], moves[n:]
    space[n : 2 * n, places] = following
    space[n : 2 * n, first : first + speeds.shape[1]] = speeds
    return space


def displacements(model: Model, values: Mapping[str, float]) -> Floats:
    """Return independent displacements along which no condition acts, as columns, shape (n, n - rank)."""
    n = len(model.elements.statement.coordinates)
    if not model.constraints:
        return np.eye(n)
    return _null_space(_gradients(model, values)[1][:, n : 2 * n], n - independent_counts(model)[0])


def displacement_turning(model: Model, values: Mapping[str, float], mass: Floats) -> Floats:
    """Return the part of the velocities that follows a unit of each displacement, as columns, shape (n, n - rank).

    Displacements Z that stay orthogonal in the metric of the mass turn with the motion by F = Z', so that what is left of
    M d2(Z u)/dt2 along Z is Z^T M Z u'' - F^T M F u. Of rolling, and of attitudes, none is counted.
    """
    n, moves = len(model.elements.statement.coordinates), displacements(model, values)
    if not (model.constraints and free_coordinates(model)):
        return np.zeros_like(moves)
    rates = _gradients(model, values)[1]
    ties, slopes = rates[:, n : 2 * n], rates[:, :n]
    reach = over_mass(mass, ties.T, list(model.elements.statement.coordinates))
    return np.asarray(-reach @ np.linalg.pinv(ties @ reach, rcond=INDEPENDENT) @ slopes @ moves)


def free_coordinates(model: Model) -> int:
    """Return how many coordinates are left to linear equations q' = v; 0 where they are of the first order."""
    tied = conditions(model)
    holonomic = all(
        c.residual != ZERO and not free_names(c.residual) & model.elements.statement.states.keys() for c in tied
    )
    return len(model.elements.statement.coordinates) - independent_counts(model)[0] if holonomic else 0


def count_of_changes(model: Model) -> int:
    """Return the number of columns of `tangent_space`."""
    size, free = len(variables(model)), free_coordinates(model)
    return (
        size - 2 * (len(model.elements.statement.coordinates) - free)
        if free or not model.constraints
        else size - independent_counts(model)[1]
    )


@lru_cache(maxsize=64)
def independent_counts(model: Model) -> tuple[int, int]:
    """Return how many gradients of rates by velocities are independent at the start, and of all conditions by the state."""
    if not model.constraints:
        return 0, 0
    state = {name: model.elements.statement.initial[name].si for name in ("t", *variables(model))}
    residuals, rates = _gradients(model, motion_inputs(model, state, constants(model), drive_pieces(model)))
    n = len(model.elements.statement.coordinates)
    return _matrix_rank(rates[:, n : 2 * n]), _matrix_rank(np.vstack([residuals, rates]))


def _matrix_rank(matrix: Floats) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=INDEPENDENT * np.linalg.norm(matrix, 2)))


def _null_space(matrix: Floats, size: int) -> Floats:
    """Return the orthonormal directions, as columns, in which a matrix has its smallest singular values."""
    # singular values descend, so that the directions of the smallest come last
    return np.linalg.svd(matrix)[2][matrix.shape[1] - size :].T


def _gradients(model: Model, values: Mapping[str, float]) -> tuple[Floats, Floats]:
    """Return the derivatives of residuals and of rates by (q, v, x); none of a residual that is none."""
    columns = {name: i for i, name in enumerate(variables(model))}
    rows_by_kind: tuple[list[Floats], list[Floats]] = [], []
    for slopes in _condition_slopes(model):
        for rows, trees in zip(rows_by_kind, slopes, strict=True):
            row = np.zeros(len(columns))
            for name, tree in trees.items():
                row[columns[name]] = evaluate(tree, values)
            if trees:
                rows.append(row)
    return tuple(np.array(rows).reshape(-1, len(columns)) for rows in rows_by_kind)  # type: ignore[return-value]


@lru_cache(maxsize=16)
def _condition_slopes(model: Model) -> list[tuple[dict[str, Node], dict[str, Node]]]:
    seeds = {name: {name: ONE} for name in variables(model)}
    return [(derivatives(c.residual, seeds), derivatives(c.rate, seeds)) for c in conditions(model)]


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


DIRECTIONS = "directions of the state"  # no name of a model's
LINKS_OF_EACH = 4  # links for each element, from which derivatives are found of whole quantities
MAX_TOGETHER = 2_000_000  # numbers of a part of an expression for all directions that are taken together


def is_densely_linked(model: Model) -> bool:
    """Whether links far outnumber the elements they join, and derivatives of forces are known by quantity."""
    if not moves_by_quantities(model) or model.assemblies or model.drives or model.statement.bodies:
        return False
    sizes = ((links.first.size, model.shapes.extent(links.source).size) for links in model.shapes.relations.values())
    return any(count > LINKS_OF_EACH * elements for count, elements in sizes)


def quantity_jacobian(model: Model, values: Mapping[str, float]) -> tuple[Floats, Floats]:
    """Return accelerations, and the derivatives of accelerations and rates by the state, of a model that is dense.

    Parameters
    ----------
    model : Model
    values : mapping of str to float
        SI numbers for all that the motion reads, by the names of elements.

    Returns
    -------
    accelerations : ndarray, shape (coordinates,)
    jacobian : ndarray, shape (coordinates + states, 2*coordinates + states)
    """
    shapes, motion_of, changes = shapes_of_changes(model), motion(model), changes_of_quantities(model)
    derived_names = {change_name(name) for name in state_quantities(model)} | {
        item.name for item in (*motion_of, *changes)
    }
    read = set[str]().union(*(free_names(item.tree) for item in (*motion_of, *changes))) - derived_names
    known_values: dict[str, Any] = {}
    for name in read:
        block = Block.from_shapes(name, "", shapes)
        known_values[name] = np.array([values[element] for element in block.elements()]).reshape(block.shape)
    for item in motion_of:
        known_values[item.name] = evaluate_elements(item.tree, item.dims, known_values, shapes)
    rows = [*map(acceleration, model.statement.coordinates), *map(rate, model.statement.states)]
    state = [Block.from_shapes(name, "", shapes) for name in state_quantities(model)]
    count = sum(block.size for block in state)
    widest = max(links.first.size for links in shapes.relations.values())
    jacobian, chunk_size = (
        np.empty((sum(known_values[name].size for name in rows), count)),
        max(1, MAX_TOGETHER // widest),
    )
    for begin in range(0, count, chunk_size):
        end = min(begin + chunk_size, count)
        directions, first = np.eye(count, end - begin, -begin), 0
        dims_with_direction = {
            name: (*shapes.dims.get(name, ()), DIRECTIONS)
            for name in map(change_name, [*state_quantities(model), *rows])
        }
        dims_with_direction |= {name: (*dims, DIRECTIONS) for name, _, dims in changes}
        extents = {**shapes.extents, DIRECTIONS: Extent(DIRECTIONS, end - begin)}
        direction_shapes = replace(shapes, extents=extents, dims={**shapes.dims, **dims_with_direction})
        moved_values = dict(known_values)
        for block in state:
            part = directions[first : first + block.size]
            moved_values[change_name(block.name)], first = part.reshape(*block.shape, -1), first + block.size
        for item in changes:
            moved_values[item.name] = evaluate_elements(
                item.tree, (*item.dims, DIRECTIONS), moved_values, direction_shapes, DIRECTIONS
            )
        jacobian[:, begin:end] = np.concatenate(
            [moved_values[change_name(name)].reshape(-1, end - begin) for name in rows]
        )
    accelerations = [known_values[acceleration(name)].ravel() for name in model.statement.coordinates]
    return np.concatenate(accelerations), jacobian


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
    elements = model.elements
    constant_values, tables, names = constants(model), drive_pieces(model), variables(model)
    n, column_of = len(elements.statement.coordinates), {name: i for i, name in enumerate(names)}
    mass = {row_column: elements.expanded(entry) for row_column, entry in elements.statement.mass_entries.items()}
    attitudes = [column_of[part] for parts in unit_quaternions(model.statement.bodies, model.shapes) for part in parts]
    derived = _derivatives_by_quantity if is_densely_linked(model) else _derivatives_by_element
    for state in states:
        values = motion_inputs(model, _checked_state(model, state), constant_values, tables)
        matrix = np.zeros((n, n))
        a, derivatives, slopes = derived(model, values)
        for row_column, entry in mass.items():
            matrix[row_column] = evaluate(entry, values)
        slopes = np.diagonal(matrix)[:, np.newaxis] * derivatives[:n] if slopes is None else slopes
        full_jacobian = np.vstack([np.eye(n, len(names), n), derivatives])
        # subtracted from 0.0, so that a slope of zero gives 0.0 and not -0.0
        stiffness = 0.0 - slopes[:, :n] - slopes[:, attitudes] @ full_jacobian[attitudes, n : 2 * n]
        spaces = displacements(model, values), tangent_space(model, values), displacement_turning(model, values, matrix)
        yield Linearisation(names, matrix, stiffness, a, full_jacobian, *spaces)


def _derivatives_by_quantity(model: Model, values: dict[str, float]) -> tuple[Floats, Floats, None]:
    """Return accelerations and the derivatives of accelerations and rates; those of forces follow, as masses are diagonal."""
    return *quantity_jacobian(model, values), None


def _derivatives_by_element(model: Model, values: dict[str, float]) -> tuple[Floats, Floats, Floats]:
    """Return accelerations, the derivatives of accelerations and rates, and dF - dM a; add all that they follow from."""
    elements = model.elements
    names, n = variables(model), len(elements.statement.coordinates)
    column_of = {name: i for i, name in enumerate(names)}
    row_of = {
        name: i
        for i, name in enumerate((*elements.statement.coordinates, *(rate(name) for name in elements.statement.states)))
    }
    values |= tape(model).evaluate_tape(values)
    derivatives, slopes = np.zeros((len(row_of), len(names))), np.zeros((n, len(names)))
    for (row, variable), name in jacobian_names(model).items():
        row_column = row_of[row], column_of[variable]
        derivatives[row_column] = values[name]
        if row_column[0] < n:
            slopes[row_column] = values[f"_s_{row}_{variable}"]
    return np.array([values[acceleration(name)] for name in elements.statement.coordinates]), derivatives, slopes


def mass_matrices(model: Model, states: Iterable[Mapping[str, float]]) -> Iterator[Floats]:
    """Yield the mass matrix at each state, SI units; states as `linearise` takes them.

    Raises
    ------
    InputError
        If a state lacks a number.
    """
    elements = model.elements
    constant_values, tables, n = constants(model), drive_pieces(model), len(elements.statement.coordinates)
    entries = {row_column: elements.expanded(entry) for row_column, entry in elements.statement.mass_entries.items()}
    for state in states:
        values = motion_inputs(model, _checked_state(model, state), constant_values, tables)
        matrix = np.zeros((n, n))
        for row_column, entry in entries.items():
            matrix[row_column] = evaluate(entry, values)
        yield matrix


def initial_state(model: Model) -> dict[str, float]:
    """Return a model's initial time and state in SI units."""
    return {name: model.elements.statement.initial[name].si for name in ("t", *variables(model))}


def _checked_state(model: Model, state: Mapping[str, float]) -> dict[str, float]:
    needed = ("t", *variables(model))
    if missing := [name for name in needed if name not in state]:
        raise InputError(
            f"state of model '{model.name}' has no {', '.join(missing)}; give SI numbers for {', '.join(needed)}"
        )
    return {name: float(state[name]) for name in needed}
