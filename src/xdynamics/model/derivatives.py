"""Derivatives of M a = F by every coordinate, velocity and state, as trees and at one state."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from xdynamics.expressions import Binary, Name, Node, derivatives
from xdynamics.expressions.calculus import ONE, ZERO, add, multiply
from xdynamics.expressions.tape import Tape
from xdynamics.faults import InputError
from xdynamics.model.constraints import conditions, keep_conditions
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.mass import Assignment, solve_mass, subtract_terms
from xdynamics.model.model import Model
from xdynamics.model.motion import drive_slope, in_regimes, motion, variables
from xdynamics.model.parts import Function
from xdynamics.reaction_names import constraint_force
from xdynamics.schema import acceleration, rate


@lru_cache(maxsize=64)
def derivative_assignments(model: Model) -> tuple[Assignment, ...]:
    """Write the derivatives of accelerations and rates, to follow `motion`: M da = dF - dM a.

    Names: ``_dF_x_by`` for the derivative of a force total or rate, ``_s_x_by`` for dF - dM a, ``_da_x_by``.

    Raises
    ------
    InputError
        If a force is written in Python.
    """
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
    targets = {name: f"_da_{name}_{variable}" for name in model.statement.coordinates}
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
    coordinates = list(model.statement.coordinates)
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
    coupled = model.mass_is_full or bool(model.constraints)
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
    owners = {f"force_{name}": name for name in model.statement.coordinates}
    return [(owners[key], variable) for key, variable in force_derivatives(model) if key in owners]


def jacobian_names(model: Model) -> dict[tuple[str, str], str]:
    """Return the name of every derivative of an acceleration or rate that is not identically zero.

    Returns
    -------
    dict of (str, str) to str
        Keyed by a coordinate (for its acceleration) or the rate of a state, and the variable of differentiation.
    """
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
    if functions := model.python_forces:
        function_names = ", ".join(f"'{component.name}'" for component in functions)
        raise InputError(
            f"model '{model.name}' has forces written in Python, {function_names}, which have no derivative;"
            " write them as expressions to linearise the model"
        )
    totals: dict[str, Node] = {f"force_{name}": ZERO for name in model.statement.coordinates}
    for term, components in model.force_components.items():
        for name, component in components.items():
            if not isinstance(component, Function):
                tree = in_regimes(model, term, model.expanded(component))
                totals[f"force_{name}"] = add(totals[f"force_{name}"], tree)
    return totals | {rate(name): model.expanded(state.rate) for name, state in model.statement.states.items()}


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
        for (i, j), entry in model.statement.mass_entries.items()
        for variable, derivative in _sorted_derivatives(model, model.expanded(entry))
    }


@lru_cache(maxsize=16)
def tape(model: Model) -> Tape:
    """Return the operations of the motion and its derivatives; there may be many thousands of them."""
    return Tape(
        (assignment.name, assignment.value)
        for assignment in (*motion(model), *derivative_assignments(model))
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
        for name, argument in model.looked_up_at.items()
        if argument != CLOCK
    }


def _sorted_derivatives(model: Model, tree: Node) -> list[tuple[str, Node]]:
    """Return the non-zero partial derivatives, each with its variable."""
    return sorted(derivatives(tree, _variable_seeds(model)).items(), key=lambda pair: _variable_ranks(model)[pair[0]])
