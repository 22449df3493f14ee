"""Small changes of a state that constraints allow: the motion about a state is linearised along these alone.

Conditions g(t, q, x) = 0 leave changes with (dg/dq) dq + (dg/dx) dx = 0, and their rates the same of (q, v, x).
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Node, derivatives, free_names
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.constraint_consistency import INDEPENDENT, over_mass
from xdynamics.model.constraints import conditions
from xdynamics.model.model import Model
from xdynamics.model.motion import constants, drive_pieces, motion_inputs, variables

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
    n, size, free = len(model.statement.coordinates), len(variables(model)), free_coordinates(model)
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
    """Return changes of (q, v, x): some of those of (q, x), with what velocities follow by, velocities, then the rest."""
    n, count = len(speeds), moves.shape[1] + speeds.shape[1]
    space = np.zeros((n + len(moves), count))
    places = np.r_[0:first, first + speeds.shape[1] : count]
    space[:n, places], space[2 * n :, places] = moves[:n], moves[n:]
    space[n : 2 * n, places] = following
    space[n : 2 * n, first : first + speeds.shape[1]] = speeds
    return space


def displacements(model: Model, values: Mapping[str, float]) -> Floats:
    """Return independent displacements along which no condition acts, as columns, shape (n, n - rank)."""
    n = len(model.statement.coordinates)
    if not model.constraints:
        return np.eye(n)
    return _null_space(_gradients(model, values)[1][:, n : 2 * n], n - independent_counts(model)[0])


def displacement_turning(model: Model, values: Mapping[str, float], mass: Floats) -> Floats:
    """Return the part of the velocities that follows a unit of each displacement, as columns, shape (n, n - rank).

    Displacements Z that stay orthogonal in the metric of the mass turn with the motion by F = Z', so that what is left of
    M d2(Z u)/dt2 along Z is Z^T M Z u'' - F^T M F u. Of rolling, and of attitudes, none is counted.
    """
    n, moves = len(model.statement.coordinates), displacements(model, values)
    if not (model.constraints and free_coordinates(model)):
        return np.zeros_like(moves)
    rates = _gradients(model, values)[1]
    ties, slopes = rates[:, n : 2 * n], rates[:, :n]
    reach = over_mass(mass, ties.T, list(model.statement.coordinates))
    return np.asarray(-reach @ np.linalg.pinv(ties @ reach, rcond=INDEPENDENT) @ slopes @ moves)


def free_coordinates(model: Model) -> int:
    """Return how many coordinates are left to linear equations q' = v; 0 where they are of the first order."""
    tied = conditions(model)
    holonomic = all(c.residual != ZERO and not free_names(c.residual) & model.statement.states.keys() for c in tied)
    return len(model.statement.coordinates) - independent_counts(model)[0] if holonomic else 0


def count_of_changes(model: Model) -> int:
    """Return the number of columns of `tangent_space`."""
    size, free = len(variables(model)), free_coordinates(model)
    return (
        size - 2 * (len(model.statement.coordinates) - free)
        if free or not model.constraints
        else size - independent_counts(model)[1]
    )


@lru_cache(maxsize=64)
def independent_counts(model: Model) -> tuple[int, int]:
    """Return how many gradients of rates by velocities are independent at the start, and of all conditions by the state."""
    if not model.constraints:
        return 0, 0
    state = {name: model.statement.initial[name].si for name in ("t", *variables(model))}
    residuals, rates = _gradients(model, motion_inputs(model, state, constants(model), drive_pieces(model)))
    n = len(model.statement.coordinates)
    return _matrix_rank(rates[:, n : 2 * n]), _matrix_rank(np.vstack([residuals, rates]))


def _matrix_rank(matrix: Floats) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=INDEPENDENT * np.linalg.norm(matrix, 2)))


def _null_space(matrix: Floats, size: int) -> Floats:
    """Return the orthonormal directions, as columns, in which a matrix has its smallest singular values."""
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
