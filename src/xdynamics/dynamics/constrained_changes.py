"""Small changes of a motion that constraints keep: multipliers change with it, and the start follows where it may.

Of R a + bias = 0 and M a = F + R^T u the changes obey R da = -(dR a + dbias) and M da = dF - dM a + dR^T u + R^T du, which is
linear in da and du (Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., section VII.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.arrays import product, solve_systems
from xdynamics.expressions import Name, Node, derivatives
from xdynamics.expressions.calculus import ONE
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model import Model
from xdynamics.model.constraint_consistency import implied_at_start
from xdynamics.model.constraints import conditions, state_corrections
from xdynamics.model.linearisation import mass_matrices
from xdynamics.model.motion import constants, variables
from xdynamics.reaction_names import constraint_force

ROW, TURNED, LAG, MULTIPLIER = (f"constraint {word}" for word in ("row", "turned", "lag", "multiplier"))
FOLLOWED = 1e-9  # of the terms of a condition's change: more of it is left by a start that does not follow

Floats = NDArray[np.float64]
Numbers = Mapping[tuple[str, Any, str], Floats]


def independent_conditions(model: Model) -> list[int]:
    """Return the conditions that no others imply at the start."""
    implied = implied_at_start(model.statement)
    return [k for k in range(len(conditions(model))) if k not in implied]


def trees_of_constraints(
    model: Model, differentials: Mapping[str, Mapping[str, Node]]
) -> Iterator[tuple[tuple[str, Any, str], Node]]:
    """Yield rows, multipliers, and the derivatives of rows and biases, by kind, place, and what they are taken by."""
    for k, condition in enumerate(conditions(model)):
        yield (MULTIPLIER, k, ""), Name(constraint_force(condition.name))
        for name, tree in condition.row.items():
            yield (ROW, (k, name), ""), tree
            yield from (
                ((TURNED, (k, name), by_name), slope) for by_name, slope in derivatives(tree, differentials).items()
            )
        yield from (((LAG, k, by_name), slope) for by_name, slope in derivatives(condition.bias, differentials).items())


def bound_changes(
    model: Model, mass: Floats, force: Floats, numbers: Numbers, columns: Mapping[str, int], accelerations: Floats
) -> Floats:
    """Return the derivatives of accelerations that keep the constraints.

    Parameters
    ----------
    model : Model
    mass : ndarray, shape (k, n, n)
        M at k states.
    force : ndarray, shape (k, n, w)
        dF - dM a by w names.
    numbers : mapping
        Values of `trees_of_constraints`.
    columns : mapping of str to int
        The column of each name.
    accelerations : ndarray, shape (k, n)
    """
    condition_indices, width = independent_conditions(model), force.shape[2]
    places = {name: i for i, name in enumerate(model.statement.coordinates)}
    rows, lag = (
        np.zeros((len(force), len(condition_indices), force.shape[1])),
        np.zeros((len(force), len(condition_indices), width)),
    )
    loads = force.copy()
    for (kind, entry, input_name), value in numbers.items():
        if input_name and input_name not in columns:
            continue
        if kind == ROW and entry[0] in condition_indices:
            rows[:, condition_indices.index(entry[0]), places[entry[1]]] = value
        elif kind == TURNED:
            loads[:, places[entry[1]], columns[input_name]] += value * numbers[MULTIPLIER, entry[0], ""]
            if entry[0] in condition_indices:
                lag[:, condition_indices.index(entry[0]), columns[input_name]] += (
                    value * accelerations[:, places[entry[1]]]
                )
        elif kind == LAG and entry in condition_indices:
            lag[:, condition_indices.index(entry), columns[input_name]] += value
    reached = solve_systems(mass, np.concatenate([loads, np.swapaxes(rows, 1, 2)], axis=2))
    free, reach = reached[..., :width], reached[..., width:]
    return np.asarray(free - product(reach, solve_systems(product(rows, reach), product(rows, free) + lag)))


def followed_start(model: Model, inputs: Sequence[str], state: Mapping[str, float], change: Floats) -> Floats | None:
    """Return a change of the start as it is where the start follows constraints; None where it leaves them.

    Parameters
    ----------
    model : Model
        With `[initial] consistent = true`, or constraints that the change keeps.
    inputs : sequence of str
        By which the columns of the change are.
    state : mapping of str to float
        SI numbers at the start, where constraints hold.
    change : ndarray, shape (2n + m, len(inputs))
        Of coordinates, velocities and states.
    """
    n, tied = len(model.statement.coordinates), [conditions(model)[k] for k in independent_conditions(model)]
    values, corrected_change = {**constants(model), **state}, change.copy()
    of_inputs = {
        name: np.array([float(name == input_name) for input_name in inputs])
        for name in inputs
        if name in model.statement.parameters
    }
    rows = np.array(
        [[evaluate(c.row[q], values) if q in c.row else 0.0 for q in model.statement.coordinates] for c in tied]
    )
    reach = solve_systems(next(iter(mass_matrices(model, [state])))[None], rows.T[None])[0]
    for first, trees in ((0, [c.residual for c in tied]), (n, [c.rate for c in tied])):
        changes: dict[str, Floats] = {**dict(zip(variables(model), corrected_change, strict=True)), **of_inputs}
        terms = [_change_terms(tree, changes, values) for tree in trees]
        off = np.array([term.sum(axis=0) for term in terms])
        left = any((abs(term.sum(axis=0)) > FOLLOWED * abs(term).sum(axis=0)).any() for term in terms)
        if left and not model.consistent:
            return None
        shift = -product(reach, solve_systems(product(rows, reach)[None], off[None])[0])
        corrected_change[first : first + n] += shift
        for name, tree in state_corrections(model).items() if first == 0 else ():
            variable_index = list(variables(model)).index(name)
            corrected_change[variable_index] += [
                evaluate(tree, values | _shift_values(model, column)) for column in shift.T
            ]
    return corrected_change


def _change_terms(tree: Node, changes: Mapping[str, Floats], values: Mapping[str, float]) -> Floats:
    """Return the parts of a condition's change, shape (k, inputs); one of zeros where it does not change."""
    slopes = derivatives(tree, {name: {name: ONE} for name in changes})
    width = len(next(iter(changes.values())))
    return np.array([evaluate(slope, values) * changes[name] for name, slope in slopes.items()]).reshape(-1, width)


def _shift_values(model: Model, column: Floats) -> dict[str, float]:
    return {f"_shift_{name}": float(move) for name, move in zip(model.statement.coordinates, column, strict=True)}
