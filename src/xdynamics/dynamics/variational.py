"""The change of a run with its inputs: its variational equations, through events, impacts and constraints.

With M a = F and x' = r, a small change z of coordinates, velocities and states that comes from inputs p obeys

    M dv' = (dF/dz - (dM/dz) a) z + dF/dp - (dM/dp) a,    dq' = dv,    dx' = (dr/dz) z + dr/dp.

These linear equations are solved on the run's own steps by Gauss's collocation, of an order above that of the run's
method (Hairer, Lubich, Wanner, Geometric Numerical Integration, 2006, II.1.3 and VI.9), about states recomputed
inside the steps. For the effect of an event on a change see `saltation`.

Where constraints hold, multipliers change with the motion, and the start follows where it may. Of R a + bias = 0 and M
a = F + R^T u the changes obey R da = -(dR a + dbias) and M da = dF - dM a + dR^T u + R^T du, which is linear in da and
du (Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed., section VII.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import reaction_names
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.elementary.arrays import apply_elementary, product, solve_systems
from xdynamics.expressions import Name, Node, derivatives
from xdynamics.expressions.calculus import ONE, divide, multiply
from xdynamics.expressions.evaluation import evaluate
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.constraints import conditions, implied_conditions, state_corrections
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.linearisation import force_totals, mass_matrices
from xdynamics.model.motion import constants, drive_pieces, drive_slope, evaluate_over_states, variables
from xdynamics.model.regimes import REGIME_NUMBER
from xdynamics.reaction_names import constraint_force
from xdynamics.schema import acceleration, rate, velocity

if TYPE_CHECKING:
    import xarray as xr

ROW, TURNED, LAG, MULTIPLIER = (f"constraint {word}" for word in ("row", "turned", "lag", "multiplier"))
FOLLOWED = 1e-9  # of the terms of a condition's change: more of it is left by a start that does not follow

Floats = NDArray[np.float64]
Numbers = Mapping[tuple[str, Any, str], Floats]


def independent_conditions(model: Model) -> list[int]:
    """Return the conditions that no others imply at the start."""
    implied = implied_conditions(model)
    return [k for k in range(len(conditions(model))) if k not in implied]


def trees_of_constraints(
    model: Model, differentials: Mapping[str, Mapping[str, Node]]
) -> Iterator[tuple[tuple[str, Any, str], Node]]:
    """Yield rows, multipliers, and derivatives of rows and biases, each keyed by kind, place and variable."""
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
    places = {name: i for i, name in enumerate(model.elements.statement.coordinates)}
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
    elements = model.elements
    n, tied = len(elements.statement.coordinates), [conditions(model)[k] for k in independent_conditions(model)]
    values, corrected_change = {**constants(model), **state}, change.copy()
    of_inputs = {
        name: np.array([float(name == input_name) for input_name in inputs])
        for name in inputs
        if name in elements.statement.parameters
    }
    rows = np.array(
        [[evaluate(c.row[q], values) if q in c.row else 0.0 for q in elements.statement.coordinates] for c in tied]
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
    return {
        f"_shift_{name}": float(move) for name, move in zip(model.elements.statement.coordinates, column, strict=True)
    }


BLOCK = 2048  # steps that are solved together
NEWTON = 8  # steps to a root of a polynomial of Legendre
LARGEST = 96  # numbers in the system of one step: above, differences are cheaper


class NotVariedError(Exception):
    """A run whose changes these equations do not describe; the message names the obstacle."""


def refuse_ticks(model: Model) -> None:
    """Refuse a model with controllers: a tick discards the former values, so that their change has no exponent.

    Raises
    ------
    NotVariedError
    """
    if model.controllers:
        raise NotVariedError(
            f"controller '{next(iter(model.elements.controllers))}' changes what it holds at its ticks"
        )


def refuse_delays(model: Model) -> None:
    """Refuse a model with delayed values: a change of it is a function, and no vector of as many numbers as its state has.

    Raises
    ------
    NotVariedError
    """
    if model.delays:
        raise NotVariedError("its forces read delayed values")


def input_differentials(model: Model, inputs: Sequence[str]) -> dict[str, dict[str, Node]]:
    """Return the names by which expressions are differentiated: time, variables, inputs, and drives by their slopes."""
    differentials: dict[str, dict[str, Node]] = {name: {name: ONE} for name in ("t", *variables(model), *inputs)}
    return differentials | {name: _differentials_of_drive(model, name, differentials) for name in model.elements.drives}


def _differentials_of_drive(
    model: Model, name: str, differentials: Mapping[str, Mapping[str, Node]]
) -> dict[str, Node]:
    """Return the derivatives of a drive; the slope of one in time is by time, whatever its argument."""
    elements = model.elements
    argument, slope_of = elements.expanded(elements.drives[name].argument), Name(drive_slope(name))
    inner = derivatives(argument, differentials)
    if elements.looked_up_at[name] == CLOCK:
        pace = inner.get("t", ONE)
        return {
            variable_name: multiply(slope_of, ONE if variable_name == "t" else divide(rate, pace))
            for variable_name, rate in inner.items()
        }
    return {variable_name: multiply(slope_of, rate) for variable_name, rate in inner.items()}


@dataclass(frozen=True)
class Equations:
    """The linear equations about a run's states.

    Attributes
    ----------
    model : Model
    inputs : tuple of str
        Parameters, then variables whose values at the start are uncertain.
    """

    model: Model
    inputs: tuple[str, ...]

    @property
    def size(self) -> int:
        """Number of variables."""
        return len(variables(self.model))

    def matrices_about(self, state: Mapping[str, Floats]) -> tuple[Floats, Floats]:
        """Return the matrices of z' = A z + B p at k states: shapes (k, n, n) and (k, n, m)."""
        model, columns, trees = self.model, self._columns, _derivative_trees(self.model, self._parameters)
        k, n, keys, width = (
            len(state["t"]),
            len(model.elements.statement.coordinates),
            list(trees),
            self.size + len(self.inputs),
        )
        values = evaluate_over_states(model, [trees[key] for key in keys], state, constants(model), drive_pieces(model))
        numbers = {
            key: np.broadcast_to(np.asarray(entry, float), (k,)) for key, entry in zip(keys, values, strict=True)
        }
        mass, force = np.zeros((k, n, n)), np.zeros((k, n, width))
        rates = np.zeros((k, self.size - 2 * n, width))
        rows = {name: i for i, name in enumerate(model.elements.statement.coordinates)}
        for (kind, entry, input_name), value in numbers.items():
            if kind == MASS:
                mass[:, *entry] = value
            elif kind == FORCE:
                force[:, rows[entry], columns[input_name]] += value
            elif kind == INERTIA:
                force[:, entry[0], columns[input_name]] -= value * numbers[ACCELERATION, list(rows)[entry[1]], ""]
            elif kind == RATE:
                rates[:, list(model.elements.statement.states).index(entry), columns[input_name]] = value
        matrix = np.zeros((k, self.size, width))
        matrix[:, :n, n : 2 * n] = np.eye(n)
        if model.constraints:
            moving = np.stack([numbers[ACCELERATION, name, ""] for name in rows], axis=1)
            matrix[:, n : 2 * n] = bound_changes(model, mass, force, numbers, columns, moving)
        elif n:
            matrix[:, n : 2 * n] = solve_systems(mass, force)
        matrix[:, 2 * n :] = rates
        return matrix[..., : self.size], matrix[..., self.size :]

    @property
    def _parameters(self) -> tuple[str, ...]:
        return tuple(name for name in self.inputs if name in self.model.elements.statement.parameters)

    @property
    def _columns(self) -> dict[str, int]:
        """Column of each name of a derivative: variables, then inputs."""
        names = {name: i for i, name in enumerate(variables(self.model))}
        return names | {name: self.size + self.inputs.index(name) for name in self._parameters}


FORCE, MASS, INERTIA, RATE, ACCELERATION = ("force", "mass", "inertia", "rate", "acceleration")


@lru_cache(maxsize=16)
def _derivative_trees(model: Model, parameters: tuple[str, ...]) -> dict[tuple[str, Any, str], Node]:
    """Return all derivatives, keyed by kind, place and the variable of differentiation."""
    elements = model.elements
    differentials, states = (
        input_differentials(model, parameters),
        {rate(name): name for name in elements.statement.states},
    )
    trees: dict[tuple[str, Any, str], Node] = {}
    tree_key: Any
    for name, tree in force_totals(model).items():
        kind, tree_key = (RATE, states[name]) if name in states else (FORCE, name.removeprefix("force_"))
        trees |= {
            (kind, tree_key, variable): derivative
            for variable, derivative in derivatives(tree, differentials).items()
            if variable != "t"
        }
    for tree_key, entry in elements.statement.mass_entries.items():
        tree = elements.expanded(entry)
        trees[MASS, tree_key, ""] = tree
        trees |= {
            (INERTIA, tree_key, variable): derivative
            for variable, derivative in derivatives(tree, differentials).items()
            if variable != "t"
        }
    trees |= dict(trees_of_constraints(model, differentials))
    if model.constraints or any(kind == INERTIA for kind, _, _ in trees):
        trees |= {(ACCELERATION, name, ""): Name(acceleration(name)) for name in elements.statement.coordinates}
    return trees


@dataclass(frozen=True)
class TickMaps:
    """The maps of changes at the ticks of a run: z -> matrix z + added, shapes (k,), (k, n, n) and (k, n, m)."""

    rows: NDArray[np.int64]
    matrices: Floats
    added: Floats

    def followed_by_ticks(self, rows: NDArray[np.int64], matrix: Floats, added: Floats) -> tuple[Floats, Floats]:
        """Return maps of steps, each followed by the tick at the row that it ends with, if there is one."""
        places = np.minimum(np.searchsorted(self.rows, rows), self.rows.size - 1)
        ends = np.flatnonzero(self.rows[places] == rows)
        tick, step_matrices, total = places[ends], matrix.copy(), added.copy()
        step_matrices[ends] = product(self.matrices[tick], matrix[ends])
        total[ends] = product(self.matrices[tick], added[ends]) + self.added[tick]
        return step_matrices, total


@dataclass(frozen=True)
class Variations:
    """The changes of one run along its steps.

    Attributes
    ----------
    run : xarray.Dataset
    equations : Equations
    order : int
        Of the run's method.
    ticks : TickMaps, optional
        Of a run with controllers.
    """

    run: xr.Dataset
    equations: Equations
    order: int
    ticks: TickMaps | None = None

    def from_start(self, change: Floats) -> Floats:
        """Return a change at the start as it is behind the tick there, if there is one."""
        if self.ticks is None:
            return change
        _, added = self.ticks.followed_by_ticks(np.zeros(1, np.int64), np.eye(self.equations.size)[None], change[None])
        return np.asarray(added[0])

    def carried_change(self, change: Floats, first: int, last: int, end: float | None = None) -> Floats:
        """Carry a change from one row to another, and on to a time in the step after it.

        Parameters
        ----------
        change : ndarray, shape (n, m), SI
            Change of every variable with every input.
        """
        time = np.asarray(self.run["time"])[first : last + 1].astype(float)
        time = np.append(time, end) if end is not None else time
        starts, sizes, rows = time[:-1], np.diff(time), first + np.arange(len(time) - 1)
        moving = np.flatnonzero(sizes > 0.0)
        for k in range(0, len(moving), BLOCK):
            block = moving[k : k + BLOCK]
            reached = np.where(rows[block] < last, rows[block] + 1, -1)  # a part of a step ends at no row
            matrix, added = self._maps_of_steps(rows[block], starts[block], sizes[block], reached)
            change = product(matrix, change) + added
        return change

    def _maps_of_steps(
        self, rows: NDArray[np.int64], starts: Floats, sizes: Floats, reached: NDArray[np.int64]
    ) -> tuple[Floats, Floats]:
        """Return the effect of consecutive steps on a change: matrix and added term, with a leading axis of steps."""
        nodes, weights, ends = gauss(self.order // 2 + 2)
        times = (starts[:, None] + sizes[:, None] * nodes).ravel()
        states = self.states(times, np.repeat(rows, len(nodes)))
        shape = len(starts), len(nodes)
        by_state, by_input = (
            matrices.reshape(*shape, *matrices.shape[1:]) for matrices in self.equations.matrices_about(states)
        )
        s, n, h = len(nodes), self.equations.size, sizes[:, None, None]
        inner = (weights[:, None, :, None] * by_state[:, :, :, None, :]).reshape(len(starts), s * n, s * n)
        right = np.concatenate([by_state, by_input], axis=-1).reshape(len(starts), s * n, -1)
        rates = solve_systems(np.eye(s * n) - h * inner, right).reshape(*shape, n, -1)
        increments = h * np.sum(ends[:, None, None] * rates, axis=1)
        step_matrices, added = np.eye(n) + increments[..., :n], increments[..., n:]
        return compose_maps(
            *(
                (step_matrices, added)
                if self.ticks is None
                else self.ticks.followed_by_ticks(reached, step_matrices, added)
            )
        )

    def states(self, times: Floats, rows: NDArray[np.int64]) -> dict[str, Floats]:
        """Return the run's states inside its steps, in SI units, with their regime."""
        model = self.equations.model
        samples = sample_in_steps(self.run, times, after_event=True, rule=REINTEGRATE, functions=model.functions)
        states = {name: samples[name].values * float(unit.factor) for name, unit in model.elements.units.items()}
        regime = self.run["regime"].values[rows] if "regime" in self.run else np.zeros(rows.size)
        return states | {"t": times, REGIME_NUMBER: regime.astype(float)}

    def row(self, rows: NDArray[np.int64]) -> dict[str, Floats]:
        """Return the states of rows, SI, with their regimes, shape (k,)."""
        model, run = self.equations.model, self.run
        values = {name: np.asarray(run[name])[rows] * float(unit.factor) for name, unit in model.elements.units.items()}
        regime = np.asarray(run["regime"])[rows] if "regime" in run else np.zeros(len(rows))
        return values | {"t": np.asarray(run["time"])[rows], REGIME_NUMBER: regime.astype(float)}

    def rates(self, rows: NDArray[np.int64]) -> dict[str, Floats]:
        """Return the recorded rates of time and every variable at rows, SI, shape (k, 1)."""
        model, run = self.equations.model, self.run
        rates: dict[str, Floats] = {"t": np.ones((len(rows), 1))}
        for name, coordinate in model.elements.statement.coordinates.items():
            factor = float(coordinate.unit.factor)
            rates[name] = np.asarray(run[velocity(name)])[rows, None] * factor
            rates[velocity(name)] = np.asarray(run[acceleration(name)])[rows, None] * factor
        for name, state in model.elements.statement.states.items():
            rates[name] = np.zeros((len(rows), 1))
            if rate(name) in run:  # else a controller holds it
                rates[name] = np.asarray(run[rate(name)])[rows, None] * float(state.unit.factor)
        return rates


def compose_maps(matrices: Floats, added: Floats) -> tuple[Floats, Floats]:
    """Compose k maps z -> A z + b in sequence, pairwise: matrices A and added terms b, along the first axis."""
    while len(matrices) > 1:
        if len(matrices) % 2:
            matrices = np.concatenate([matrices, np.eye(matrices.shape[-1])[None]])
            added = np.concatenate([added, np.zeros_like(added[:1])])
        # pairwise, so that half of all products are made in one call
        matrices, added = product(matrices[1::2], matrices[::2]), product(matrices[1::2], added[::2]) + added[1::2]
    return matrices[0], added[0]


@lru_cache
def gauss(stages: int) -> tuple[Floats, Floats, Floats]:
    """Return nodes, weights of the stages, and weights of the end of Gauss's collocation on [0, 1], of order 2 s.

    Of shapes (s,), (s, s) and (s,) for s stages. Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I,
    1993, II.7.
    """
    from numpy.polynomial import legendre

    steepness = legendre.legder([0.0] * stages + [1.0])
    # close enough to each root for Newton's method to reach that one and no other
    roots = apply_elementary("cos", np.pi * (np.arange(stages, 0, -1) - 0.25) / (stages + 0.5))
    for _ in range(NEWTON):
        roots = roots - legendre.legvander(roots, stages)[:, -1] / legendre.legval(roots, steepness)
    weights = 2.0 / ((1.0 - roots**2) * legendre.legval(roots, steepness) ** 2)
    at_roots: Floats = legendre.legvander(roots, stages).astype(float)
    degrees = np.arange(1, stages)
    integrals = np.empty((stages, stages))  # of Legendre's polynomials from 0 to each node
    integrals[:, 0] = (roots + 1.0) / 2.0
    # a Legendre polynomial has the difference of its neighbours over 2 n + 1 as integral; [0, 1] is half as long
    integrals[:, 1:] = (at_roots[:, 2:] - at_roots[:, :-2]) / (2.0 * (2.0 * degrees + 1.0))
    return (roots + 1.0) / 2.0, solve_systems(at_roots[:, :-1].T, integrals.T).T, weights / 2.0


def first_contact_rows(run: xr.Dataset) -> dict[str, int]:
    """Return the first row at which each contact or friction element holds or slips, without those that never do."""
    first_rows: dict[str, int] = {}
    for name in map(str, run.data_vars):
        if name.startswith((reaction_names.contact_state(""), reaction_names.friction_state(""))):
            rows = np.flatnonzero(np.asarray(run[name]))
            first_rows |= {name: int(rows[0])} if rows.size else {}
    return first_rows
