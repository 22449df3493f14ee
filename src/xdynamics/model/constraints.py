"""What constraints add to M a = F, as trees: multipliers that are solved for together with the accelerations.

Each condition keeps a rate at zero, R v + … = 0: the time derivative of `holds`, or `rolls` itself. The accelerations
and the multipliers u solve M a = F + R^T u, R a + bias = 0, so R M^-1 R^T u = -(R M^-1 F + bias) (Hairer and Wanner,
Solving Ordinary Differential Equations II, 2nd ed., section VII.1, index 1). That matrix is factored as L D L^T, sparse
where conditions share no coordinate: along a chain of rods the cost grows as the rods do. A small pivot belongs to a
condition that others imply: accelerations do not depend on how its force is shared (see `Sharing`).

Systems M u = right with the mass matrix are solved as trees: by division, or by the factors L D L^T.

Where R M^-1 R^T has no full rank, the motion does not determine how conditions that imply each other share their force:
multipliers u and u + N z accelerate alike, for every z and N of its null space. The share of least norm is taken, each
multiplier weighed by its diagonal entry, which is what it accelerates by itself. So the share does not depend on how a
condition is written, in which unit or times which number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, reduce
from typing import NamedTuple

from xdynamics.expressions import (
    Binary,
    Call,
    Compare,
    Name,
    Negative,
    Node,
    Number,
    derivative,
    derivatives,
    dimension_of,
    expand,
    free_names,
)
from xdynamics.expressions.calculus import ONE, ZERO, add, multiply, negative, sum_of_terms
from xdynamics.model.constraint_consistency import DEPENDENT, implied_at_start
from xdynamics.model.elementwise import own_mass
from xdynamics.model.model import Model
from xdynamics.model.parts import Function
from xdynamics.reaction_names import PROJECTION, RANK, constraint_force
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import acceleration, rate, velocity
from xdynamics.units import Dimension


class Assignment(NamedTuple):
    """``name = value``, along dimensions; the value is an expression without definitions, or a function written in Python."""

    name: str
    value: Node | Function
    dims: tuple[str, ...] = ()

    @property
    def tree(self) -> Node:
        """The value of one that calls no function."""
        assert not isinstance(self.value, Function)  # noqa: S101 - asked before, where there may be some
        return self.value


def mass_factors(model: Model) -> Iterator[Assignment]:
    """Return the assignments that solving with the mass reads: a diagonal, or the factors of a full M = L D L^T."""
    elements = model.elements
    if not elements.mass_is_full:
        # along dimensions a mass is read where it divides: loops over elements keep no array of it
        for i in range(len(model.statement.coordinates)) if not model.shapes.dims else ():
            yield Assignment(f"_m{i}", _positive_mass(model, i))
        return
    mass = [[elements.expanded(entry) for entry in row] for row in elements.mass]
    for i, row in enumerate(mass):
        for j in range(i):
            products = (product_of_names(f"_l{i}_{k}", f"_l{j}_{k}", f"_d{k}") for k in range(j))
            yield Assignment(f"_l{i}_{j}", Binary("/", subtract_terms(row[j], products), Name(f"_d{j}")))
        products = (product_of_names(f"_l{i}_{k}", f"_l{i}_{k}", f"_d{k}") for k in range(i))
        yield Assignment(f"_d{i}", Call("positive", (subtract_terms(row[i], products),)))


def _positive_mass(model: Model, i: int) -> Node:
    """Return the mass of a coordinate by its number; nan where it is not positive."""
    return Call("positive", (model.expanded(own_mass(model.statement.mass, i)),))


def solve_mass(model: Model, rows: Mapping[str, Node], names: Iterable[str] | None = None) -> Iterator[Assignment]:
    """Solve M u = right for the unknowns, by division or forward and back through the factors."""
    unknowns, right = list(rows), list(rows.values())
    if not model.elements.mass_is_full:
        row_of = {name: i for i, name in enumerate(model.statement.coordinates)}
        for name, unknown, tree in zip(row_of if names is None else names, unknowns, right, strict=True):
            i = row_of[name]
            mass = _positive_mass(model, i) if model.shapes.dims else Name(f"_m{i}")
            yield Assignment(unknown, Binary("/", tree, mass))
        return
    n = len(unknowns)
    z = [f"_z{i}_{unknown}" for i, unknown in enumerate(unknowns)]
    for i in range(n):
        yield Assignment(z[i], subtract_terms(right[i], (product_of_names(f"_l{i}_{k}", z[k]) for k in range(i))))
    for i in reversed(range(n)):
        back_products = (product_of_names(f"_l{k}_{i}", unknowns[k]) for k in range(i + 1, n))
        yield Assignment(unknowns[i], subtract_terms(Binary("/", Name(z[i]), Name(f"_d{i}")), back_products))


def product_of_names(*names: str) -> Node:
    """Multiply named numbers, one after the other."""
    operands: list[Node] = [Name(name) for name in names]
    return reduce(lambda left, right: Binary("*", left, right), operands)


def subtract_terms(tree: Node, terms: Iterable[Node]) -> Node:
    """Subtract terms, one after the other."""
    return reduce(lambda left, right: Binary("-", left, right), terms, tree)


Vectors = dict[int, dict[int, Node]]  # of every implied condition: its null vector's entries by condition


@dataclass(frozen=True)
class Sharing:
    """How multipliers are shared, from the factors of R M^-1 R^T = L D L^T.

    Attributes
    ----------
    implied : tuple of int
        The conditions that those before them imply at the start; where their pivots are none at a state, others imply them.
    inverse_pivots : tuple of str
        Of D, zero where a pivot is none.
    factors : mapping of (int, int) to str
        Of L below its diagonal, where it is not zero throughout.
    weights : tuple of Node
        Of each multiplier in norms.
    """

    implied: tuple[int, ...]
    inverse_pivots: tuple[str, ...]
    factors: Mapping[tuple[int, int], str]
    weights: tuple[Node, ...]

    @cached_property
    def _spanned(self) -> tuple[list[Assignment], Vectors]:
        """Vectors that span the null space, each orthogonal to those before it."""
        lines: list[Assignment] = []
        vectors: Vectors = {}
        for p in self.implied:
            raw: dict[int, Node] = {p: Name(f"_implied{p}")}
            lines.append(Assignment(f"_implied{p}", _where_positive(Name(self.inverse_pivots[p]), ZERO, ONE)))
            for i in reversed(range(p)):  # L^T z = 0
                if terms := [multiply(Name(self.factors[j, i]), raw[j]) for j in raw if (j, i) in self.factors]:
                    lines.append(Assignment(f"_null{p}_{i}", negative(sum_of_terms(terms))))
                    raw[i] = Name(f"_null{p}_{i}")
            for q, earlier in vectors.items():
                lines.append(Assignment(f"_along{p}_{q}", self._projection(raw, earlier, q)))
                for i, entry in earlier.items():
                    part = Binary("-", raw.get(i, ZERO), Binary("*", Name(f"_along{p}_{q}"), entry))
                    lines.append(Assignment(f"_null{p}_{i}_{q}", part))
                    raw[i] = Name(f"_null{p}_{i}_{q}")
            vectors[p] = raw
            square = Name(f"_square{p}")
            lines.append(Assignment(square.name, self._weighted_product(raw, raw)))
            lines.append(Assignment(_inverse_square(p), _where_positive(square, Binary("/", ONE, square), ZERO)))
        return lines, vectors

    def null_vectors(self) -> Iterator[Assignment]:
        """Return the assignments of vectors that span the null space."""
        yield from self._spanned[0]

    def least_norm(self, forces: Sequence[str], basic: Sequence[str]) -> Iterator[Assignment]:
        """Write the multipliers of least norm from others that accelerate alike, a basic solution."""
        left: dict[int, Node] = {k: Name(name) for k, name in enumerate(basic)}
        for p, vector in self._spanned[1].items():
            part = Name(f"_part{p}_{forces[p]}")
            yield Assignment(part.name, self._projection(left, vector, p))
            for i, entry in vector.items():
                reduced = Name(f"_less{p}_{forces[i]}")
                yield Assignment(reduced.name, Binary("-", left[i], Binary("*", part, entry)))
                left[i] = reduced
        yield from (Assignment(name, left[k]) for k, name in enumerate(forces))

    def _projection(self, multipliers: Mapping[int, Node], vector: Mapping[int, Node], p: int) -> Node:
        return Binary("*", self._weighted_product(multipliers, vector), Name(_inverse_square(p)))

    def _weighted_product(self, a: Mapping[int, Node], b: Mapping[int, Node]) -> Node:
        shared = sorted(a.keys() & b.keys())
        return sum_of_terms([Binary("*", self.weights[i], Binary("*", a[i], b[i])) for i in shared]) if shared else ZERO


def _where_positive(value: Node, then: Node, otherwise: Node) -> Node:
    return Call("where", (Compare(">", value, ZERO), then, otherwise))


def _inverse_square(p: int) -> str:
    return f"_inverse_square{p}"


MOST_DIFFERENTIATED = 24  # coordinates: the derivatives of all accelerations by all of the state grow as the cube


@dataclass(frozen=True)
class Condition:
    """One condition on the motion.

    Attributes
    ----------
    name : str
        Of the constraint, or its element.
    residual : Node
        What is zero at every position; zero itself where only velocities are bound.
    rate : Node
        What is zero for every velocity.
    row : mapping of str to Node
        The derivative of `rate` by the velocity of each coordinate that it depends on: the multiplier acts along it.
    bias : Node
        The time derivative of `rate` with zero accelerations.
    """

    name: str
    residual: Node
    rate: Node
    row: Mapping[str, Node]
    bias: Node


@lru_cache(maxsize=64)
def conditions(model: Model) -> tuple[Condition, ...]:
    """Return the conditions of a model, in their order."""
    elements = model.elements
    if not model.constraints:
        return ()
    if model.elements is not model:
        return conditions(model.elements)
    made_conditions, rates = [], rates_of_states(model)
    for name, constraint in elements.constraints.items():
        residual = ZERO if constraint.holds is None else elements.expanded(constraint.holds)
        rate = elements.rate_of(residual) if constraint.rolls is None else elements.expanded(constraint.rolls)
        row, bias = rate_row_and_bias(model, expand(rate, rates))
        made_conditions.append(Condition(name, residual, expand(rate, rates), row, expand(bias, rates)))
    return tuple(made_conditions)


def rates_of_states(model: Model) -> dict[str, Node]:
    """Return the rate of each first-order state as it is written: where a condition reads an attitude, say."""
    return {rate(name): model.elements.expanded(state.rate) for name, state in model.elements.statement.states.items()}


def beyond_trees(model: Model) -> bool:
    """Whether constraints couple so many coordinates that derivatives of the accelerations are left to differences."""
    return bool(model.constraints) and len(model.elements.statement.coordinates) > MOST_DIFFERENTIATED


def rate_row_and_bias(model: Model, rate: Node) -> tuple[dict[str, Node], Node]:
    """Return the derivatives of a rate by the velocities, and its time derivative with zero accelerations."""
    rows = {name: derivative(rate, {velocity(name): ONE}) for name in model.elements.statement.coordinates}
    accelerations = {Name(acceleration(name)) for name in rows}
    unaccelerated = {name: tree for name, tree in model.elements.rates.items() if tree not in accelerations}
    return {name: tree for name, tree in rows.items() if tree != ZERO}, derivative(rate, unaccelerated)


def multiplier_dimensions(model: Model) -> dict[str, Dimension]:
    """Return the dimension of each multiplier: power over that of its rate."""
    elements = model.elements
    if not model.constraints:
        return {}
    dimensions, by_condition = elements.dimensions, dict[str, Dimension]()
    row_of = {name: i for i, name in enumerate(elements.statement.coordinates)}
    for condition in conditions(model):
        name = next(iter(condition.row))
        inertia = dimension_of(elements.mass[row_of[name]][row_of[name]], dimensions)
        power = inertia * dimensions[name] / model.time_unit.dimension**2 * dimensions[velocity(name)]
        by_condition[constraint_force(condition.name)] = power / dimension_of(condition.rate, dimensions)
    return by_condition


# ------------------------------------------------------------------------------------------------------- assignments


def multiplier_assignments(model: Model) -> Iterator[Assignment]:
    """Write rows, the effect of a unit of each multiplier on accelerations, and the factors of R M^-1 R^T."""
    tied = conditions(model)
    for k, condition in enumerate(tied):
        yield from (Assignment(_row_name(k, name), tree) for name, tree in condition.row.items())
        reached = _reached_coordinates(model, condition)
        rows = {_reach_name(k, name): Name(_row_name(k, name)) if name in condition.row else ZERO for name in reached}
        yield from solve_mass(model, rows, reached)
    entries: dict[tuple[int, int], Node] = {}
    for i, condition in enumerate(tied):
        for j, earlier_condition in enumerate(tied[: i + 1]):
            if shared := [name for name in condition.row if name in _reached_coordinates(model, earlier_condition)]:
                terms = [Binary("*", Name(_row_name(i, name)), Name(_reach_name(j, name))) for name in shared]
                yield Assignment(_gram_name(i, j), sum_of_terms(terms))
                entries[i, j] = Name(_gram_name(i, j))
    yield from _factored(entries, len(tied))
    yield from _sharing(model).null_vectors()


def _factored(entries: dict[tuple[int, int], Node], n: int) -> Iterator[Assignment]:
    """Factor a symmetric matrix as L D L^T, and count the pivots that are not zero, or too small beside its diagonal."""
    independent: Node = ZERO
    diagonal = [entries.get((p, p), ZERO) for p in range(n)]
    for p in range(n):
        regular = Compare(">", entries.get((p, p), ZERO), multiply(Number(DEPENDENT), diagonal[p]))
        inverse = Call("where", (regular, Binary("/", ONE, entries.get((p, p), ZERO)), ZERO))
        yield Assignment(inverse_pivot(p), inverse)
        independent = add(independent, Call("where", (regular, ONE, ZERO)))
        below = [i for i in range(p + 1, n) if (i, p) in entries]
        for i in below:
            yield Assignment(_factor_name(i, p), Binary("*", entries[i, p], Name(inverse_pivot(p))))
            for j in (j for j in below if j <= i):
                reduced = subtract_terms(
                    entries.get((i, j), ZERO), [Binary("*", Name(_factor_name(i, p)), entries[j, p])]
                )
                yield Assignment(f"_tied{i}_{j}_{p}", reduced)
                entries[i, j] = Name(f"_tied{i}_{j}_{p}")
    yield Assignment(RANK.name, independent)
    yield Assignment(PROJECTION.name, ZERO)  # of a state that nothing has moved


def correction_assignments(model: Model) -> Iterator[Assignment]:
    """Return first-order corrections of residuals, ``_shift_<coordinate>``, and rates, ``_slow_<coordinate>``."""
    model = model.elements
    yield from mass_factors(model)
    yield from multiplier_assignments(model)
    for word, lags in (
        ("shift", [condition.residual for condition in conditions(model)]),
        ("slow", [condition.rate for condition in conditions(model)]),
    ):
        targets = {name: f"_{word}_{name}" for name in model.statement.coordinates}
        yield from keep_conditions(model, {}, lags, targets, [f"_{word}{k}" for k in range(len(lags))])
    for name, tree in state_corrections(model).items():
        yield Assignment(f"_shift_{name}", tree)


def projection_assignments(model: Model) -> Iterator[Assignment]:
    """Return ``_shift_<coordinate>``, which corrects given residuals ``_off0, …`` along the gradients here."""
    model = model.elements
    yield from mass_factors(model)
    yield from multiplier_assignments(model)
    off = [Name(f"_off{k}") for k in range(len(conditions(model)))]
    targets = {name: f"_shift_{name}" for name in model.statement.coordinates}
    yield from keep_conditions(model, {}, off, targets, [f"_kept{k}" for k in range(len(off))])


@lru_cache(maxsize=64)
def state_corrections(model: Model) -> dict[str, Node]:
    """Return how far each state that conditions read goes with the coordinates, by its rate's derivatives by velocities."""
    elements = model.elements
    read = set[str]().union(*(free_names(condition.residual) for condition in conditions(model)))
    seeds = {velocity(name): {name: Name(f"_shift_{name}")} for name in elements.statement.coordinates}
    return {
        name: sum_of_terms(list(derivatives(elements.expanded(state.rate), seeds).values()))
        for name, state in elements.statement.states.items()
        if name in read
    }


def keep_conditions(
    model: Model, free: Mapping[str, Node], lags: Sequence[Node], targets: Mapping[str, str], forces: Sequence[str]
) -> Iterator[Assignment]:
    """Add the effect of multipliers, which satisfy the conditions, to accelerations or other changes of coordinates.

    Parameters
    ----------
    model : Model
    free : mapping of str to Node
        The change of each coordinate without them; zero for those that are not there.
    lags : sequence of Node
        What each condition's row has besides the changes.
    targets : mapping of str to str
        The name of the change of each coordinate.
    forces : sequence of str
        The name of each multiplier.
    """
    tied = conditions(model)
    coupled = _coupled(model)
    basic = [f"_basic_{name}" for name in forces] if _sharing(model).implied else forces
    for k, condition in enumerate(tied):
        products = [multiply(Name(_row_name(k, name)), free[name]) for name in condition.row if name in free]
        right = Negative(sum_of_terms([lags[k], *products]))
        earlier_products = (
            Binary("*", Name(_factor_name(k, p)), Name(f"_part_{forces[p]}")) for p in range(k) if (k, p) in coupled
        )
        yield Assignment(f"_part_{forces[k]}", subtract_terms(right, earlier_products))
    for k in reversed(range(len(tied))):
        behind = (
            Binary("*", Name(_factor_name(i, k)), Name(basic[i])) for i in range(k + 1, len(tied)) if (i, k) in coupled
        )
        yield Assignment(
            basic[k], subtract_terms(Binary("*", Name(f"_part_{forces[k]}"), Name(inverse_pivot(k))), behind)
        )
    if basic is not forces:
        yield from _sharing(model).least_norm(forces, basic)
    for name, target in targets.items():
        terms = [
            Binary("*", Name(_reach_name(k, name)), Name(basic[k]))
            for k, condition in enumerate(tied)
            if name in _reached_coordinates(model, condition)
        ]
        yield Assignment(target, sum_of_terms([free.get(name, ZERO), *terms]))


@lru_cache(maxsize=64)
def implied_conditions(model: Model) -> tuple[int, ...]:
    """Return which conditions those before them imply where the motion starts; none where measured values decide it."""
    return implied_at_start(model.elements.statement) if model.elements.statement.constraints else ()


@lru_cache(maxsize=64)
def _sharing(model: Model) -> Sharing:
    """Return how conditions that imply each other share their force."""
    count = range(len(conditions(model)))
    return Sharing(
        implied_conditions(model),
        tuple(map(inverse_pivot, count)),
        {(i, p): _factor_name(i, p) for i, p in _coupled(model)},
        tuple(Name(_gram_name(k, k)) for k in count),
    )


@lru_cache(maxsize=64)
def _coupled(model: Model) -> frozenset[tuple[int, int]]:
    """Return the places of the factor L that are not zero throughout, below its diagonal."""
    tied = conditions(model)
    filled = {
        (i, j)
        for i, condition in enumerate(tied)
        for j, earlier_condition in enumerate(tied[:i])
        if any(name in _reached_coordinates(model, earlier_condition) for name in condition.row)
    }
    for p in range(len(tied)):
        below = [i for i in range(p + 1, len(tied)) if (i, p) in filled]
        filled |= {(i, j) for i in below for j in below if j < i}
    return frozenset(filled)


def _reached_coordinates(model: Model, condition: Condition) -> list[str]:
    """Return the coordinates that a multiplier accelerates by itself: all of them through a full mass."""
    return list(model.elements.statement.coordinates) if model.elements.mass_is_full else list(condition.row)


def _row_name(k: int, name: str) -> str:
    return f"_tie{k}_{name}"


def _reach_name(k: int, name: str) -> str:
    return f"_pull{k}_{name}"


def _gram_name(i: int, j: int) -> str:
    return f"_tied{i}_{j}"


def _factor_name(i: int, p: int) -> str:
    return f"_share{i}_{p}"


def inverse_pivot(p: int) -> str:
    """Name the inverse pivot of a multiplier, which is zero where other conditions imply its own."""
    return f"_slack{p}"
