"""Derivatives of M a = F by every coordinate, velocity and state, as trees and at one state."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

from xdynamics.expressions import Binary, Name, Node, derivatives
from xdynamics.expressions.calculus import ONE, ZERO, add, multiply
from xdynamics.expressions.tape import Tape
from xdynamics.faults import InputError
from xdynamics.model.constraints import bound, conditions
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.mass import Assignment, less, solved
from xdynamics.model.model import Model
from xdynamics.model.motion import in_regimes, motion, slope, variables
from xdynamics.model.parts import Function
from xdynamics.reaction_names import constraint_force
from xdynamics.schema import acceleration, rate


@lru_cache(maxsize=64)
def slopes(model: Model) -> tuple[Assignment, ...]:
    """Write the derivatives of accelerations and rates, to follow `motion`: M da = dF - dM a.

    Names: ``_dF_x_by`` for the derivative of a force total or rate, ``_s_x_by`` for dF - dM a, ``_da_x_by``.

    Raises
    ------
    InputError
        If a force is written in Python.
    """
    forces, masses = force_derivatives(model), mass_derivatives(model)
    assignments = [Assignment(f"_dF_{key}_{by}", tree) for (key, by), tree in forces.items()]
    assignments += [Assignment(f"_dM_{i}_{j}_{by}", tree) for ((i, j), by), tree in masses.items()]
    for by, right in _changes(model).items():
        assignments += [Assignment(f"_s_{name}_{by}", tree) for name, tree in right.items()]
        named = "_da_{}_{}" if not model.constraints else "_free_da_{}_{}"
        assignments += solved(model, {named.format(name, by): Name(f"_s_{name}_{by}") for name in right}, list(right))
        assignments += _bound(model, by) if model.constraints else ()
    return tuple(assignments)


def _bound(model: Model, by: str) -> Iterator[Assignment]:
    """Write the derivatives of accelerations by one variable where conditions hold: of R a + bias = 0, too."""
    free = {name: Name(f"_free_da_{name}_{by}") for name in _changes(model)[by]}
    lags = [_lag(model, k, by) for k in range(len(conditions(model)))]
    targets = {name: f"_da_{name}_{by}" for name in model.statement.coordinates}
    yield from bound(model, free, lags, targets, [f"_du{k}_{by}" for k in range(len(lags))])


def _lag(model: Model, k: int, by: str) -> Node:
    """Return the derivative of a condition's bias, and of its row at these accelerations."""
    bias, rows = _turned(model)[k]
    total = bias.get(by, ZERO)
    for name, turned in rows.items():
        total = add(total, multiply(turned.get(by, ZERO), Name(acceleration(name))))
    return total


@lru_cache(maxsize=16)
def _turned(model: Model) -> list[tuple[dict[str, Node], dict[str, dict[str, Node]]]]:
    """Return the derivatives of each condition's bias, and of the entries of its row."""
    return [
        (
            dict(_derivatives(model, condition.bias)),
            {name: dict(_derivatives(model, tree)) for name, tree in condition.row.items()},
        )
        for condition in conditions(model)
    ]


@lru_cache(maxsize=64)
def _changes(model: Model) -> dict[str, dict[str, Node]]:
    """Return dF - dM a by the variable of differentiation and then by coordinate, in their orders.

    With a diagonal mass, zeros are left out; the factors of a full one couple each row to all others.
    """
    inertia_terms: dict[tuple[str, str], list[Node]] = {}
    coordinates = list(model.statement.coordinates)
    for (i, j), by in mass_derivatives(model):
        term = Binary("*", Name(f"_dM_{i}_{j}_{by}"), Name(acceleration(coordinates[j])))
        inertia_terms.setdefault((coordinates[i], by), []).append(term)
    forces: dict[tuple[str, str], Node] = {pair: Name(f"_dF_force_{pair[0]}_{pair[1]}") for pair in _acting(model)}
    for condition, (_, rows) in zip(conditions(model), _turned(model), strict=True):
        for name, derivatives_of_row in rows.items():
            for by, turned in derivatives_of_row.items():
                pulled = multiply(turned, Name(constraint_force(condition.name)))
                forces[name, by] = add(forces.get((name, by), ZERO), pulled)
    coupled = model.mass_is_full or bool(model.constraints)
    full = ((name, by) for name in coordinates for by in variables(model)) if coupled else ()
    place = _places(model)
    changes: dict[str, dict[str, Node]] = {}
    for name, by in sorted({*forces, *inertia_terms, *full}, key=lambda pair: (place[pair[1]], place[pair[0]])):
        changes.setdefault(by, {})[name] = less(forces.get((name, by), ZERO), inertia_terms.get((name, by), ()))
    return changes


def _acting(model: Model) -> list[tuple[str, str]]:
    """Return the pairs of a coordinate and a variable that its force depends on."""
    owners = {f"force_{name}": name for name in model.statement.coordinates}
    return [(owners[key], by) for key, by in force_derivatives(model) if key in owners]


def jacobian(model: Model) -> dict[tuple[str, str], str]:
    """Return the name of every derivative of an acceleration or rate that is not identically zero.

    Returns
    -------
    dict of (str, str) to str
        Keyed by a coordinate (for its acceleration) or the rate of a state, and the variable of differentiation.
    """
    columns = _places(model)
    rows = {name: i for i, name in enumerate((*model.statement.coordinates, *map(rate, model.statement.states)))}
    names = {(name, by): f"_da_{name}_{by}" for by, right in _changes(model).items() for name in right}
    names |= {(key, by): f"_dF_{key}_{by}" for key, by in force_derivatives(model) if key in rows}
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
        named = ", ".join(f"'{component.name}'" for component in functions)
        raise InputError(
            f"model '{model.name}' has forces written in Python, {named}, which have no derivative;"
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
        (name, by): derivative
        for name, tree in force_totals(model).items()
        for by, derivative in _derivatives(model, tree)
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
        ((i, j), by): derivative
        for (i, j), entry in model.statement.mass_entries.items()
        for by, derivative in _derivatives(model, model.expanded(entry))
    }


@lru_cache(maxsize=16)
def tape(model: Model) -> Tape:
    """Return the operations of the motion and its derivatives; there may be many thousands of them."""
    return Tape(
        (assignment.name, assignment.value)
        for assignment in (*motion(model), *slopes(model))
        if not isinstance(assignment.value, Function)
    )


@lru_cache(maxsize=64)
def _places(model: Model) -> dict[str, int]:
    """Number the variables of the motion; the number of a coordinate is its row of the mass too."""
    return {name: i for i, name in enumerate(variables(model))}


@lru_cache(maxsize=64)
def _varying(model: Model) -> dict[str, dict[str, Node]]:
    """Return the derivative of each variable, and of each drive of one, by that variable."""
    own: dict[str, dict[str, Node]] = {name: {name: ONE} for name in variables(model)}
    return own | {
        name: {by: multiply(Name(slope(name)), rate) for by, rate in derivatives(at, own).items()}
        for name, at in model.looked_up_at.items()
        if at != CLOCK
    }


def _derivatives(model: Model, tree: Node) -> list[tuple[str, Node]]:
    """Return the non-zero partial derivatives, each with its variable."""
    return sorted(derivatives(tree, _varying(model)).items(), key=lambda pair: _places(model)[pair[0]])
