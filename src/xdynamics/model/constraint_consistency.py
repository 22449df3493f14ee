"""Constraints, checked before the first update: what they may read, and that the motion starts where they hold."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Call, Name, Node, derivative, derivatives, dimension_of, expand, free_names, text_of
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every, summands
from xdynamics.faults import InputError, Ledger, display_text
from xdynamics.model.bodies import quasi_coordinate, scalar_part, vector_part
from xdynamics.model.body_sections import AXES
from xdynamics.model.contact_consistency import KINKS, check_velocity, one_power, parameter_values
from xdynamics.model.parts import Constraint
from xdynamics.model.statement import Statement
from xdynamics.runtime.cached_properties import cached_property
from xdynamics.schema import velocity
from xdynamics.shapes.naming import join_element_name, split_element_name
from xdynamics.units import NONE, Dimension, spell

CONSISTENT = 1e-9  # a residual at the start, over its terms: what digits of initial values leave
MOST_TURNS = 50
# A gradient of which less is left beside the others, squared, is one that these imply. Near a singular position what is left
# of a residual is divided by this number, and what is dropped is missed for as long as its root: 1e-7 weighs the two.
DEPENDENT = 1e-7
INDEPENDENT = 1e-9  # of the largest singular value of gradients: less belongs to one that others imply

Floats = NDArray[np.float64]


def check_constraints(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check what every constraint reads, then where the motion starts."""
    if not statement.constraints:
        return
    if statement.assemblies:
        contact_name = next(iter(statement.assemblies))
        ledger.note(
            f"constraints do not go with contacts of more links than are written out: contact '{contact_name}' has them; write"
            " rods as stiff springs there, or fewer contacts"
        )
    with ledger.entry("constraints"):
        one_power(statement, dimensions, "constraints")
    for name, constraint in statement.constraints.items():
        with ledger.entry(f"constraint '{display_text(name)}'"):
            dimension_of(constraint.condition, dimensions)
            _check_reads(constraint, statement)
    ledger.raise_faults()
    start = _ConditionsAtStart(statement)
    if start.names_read <= start.values.keys():  # a missing value has been reported already
        _check_conditions_at_start(start, dimensions, ledger)


def _check_reads(constraint: Constraint, statement: Statement) -> None:
    """Refuse what cannot be kept: a condition of nothing that moves, of velocities, with kinks, of measured drives."""
    tree = expand(constraint.condition, statement.definitions)
    if constraint.holds is None:
        check_velocity("rolls", tree, statement)
        return
    velocities = set(map(velocity, statement.coordinates))
    if fault := sorted(free_names(tree) & velocities):
        raise InputError(
            f"holds reads the velocity '{display_text(fault[0])}'; a condition on velocities that is linear in them is rolls ="
            f" '{text_of(constraint.condition)}'"
        )
    if fault := sorted(free_names(tree) & {*statement.drives}):
        raise InputError(
            f"holds reads the drive '{fault[0]}', whose second derivative jumps; write its motion as an expression of t"
        )
    moving = {*statement.coordinates, *statement.states, "t"}
    calls = [node.function for node in every(tree) if isinstance(node, Call) and free_names(node) & moving]
    if kinks := sorted({*calls} & KINKS):
        raise InputError(
            f"holds has a kink or a jump, {', '.join(kinks)}; write a smooth condition, as x**2 - l**2 for abs(x) - l"
        )


@dataclass(frozen=True)
class _ConditionsAtStart:
    """The conditions of a statement at its start, in SI units."""

    statement: Statement

    @cached_property
    def values(self) -> dict[str, float]:
        """Parameters, constants and the state."""
        return parameter_values(self.statement) | {name: part.si for name, part in self.statement.initial.items()}

    @property
    def names_read(self) -> set[str]:
        """Every name that conditions read."""
        return set[str]().union(*(free_names(tree) for pair in self.trees for tree in pair))

    @cached_property
    def trees(self) -> list[tuple[Node, Node]]:
        """The residual and the rate of each condition; a rolling one has no residual."""
        old = self.statement
        rates: dict[str, Node] = {"t": ONE}
        rates |= {name: Name(velocity(name)) for name in old.coordinates}
        rates |= {name: expand(state.rate, old.definitions) for name, state in old.states.items()}
        trees = [(part, expand(part.condition, old.definitions)) for part in old.constraints.values()]
        return [(tree, derivative(tree, rates)) if part.rolls is None else (ZERO, tree) for part, tree in trees]

    @cached_property
    def rate_slopes(self) -> list[dict[str, Node]]:
        """The derivatives of each rate by the velocities."""
        seeds = {velocity(name): {velocity(name): ONE} for name in self.statement.coordinates}
        return [derivatives(rate, seeds) for _, rate in self.trees]

    def residuals_or_rates(self, which: int, values: Mapping[str, float]) -> Floats:
        """Return residuals (0) or rates (1) at a state."""
        return np.array([evaluate(pair[which], values) for pair in self.trees])

    def term_sizes(self, which: int, values: Mapping[str, float]) -> Floats:
        """Return the sizes of their terms, and of what coordinates or velocities as large as any of the kind could change.

        Positions are told from 1 radian, too. Terms alone may cancel: of a body that spins about its axis, say.
        """
        terms = [sum(abs(evaluate(term, values)) for term in summands(pair[which])) for pair in self.trees]
        coordinates = self.statement.coordinates
        largest = dict[Dimension, float]()
        for name, part in coordinates.items():
            kind, size = part.unit.dimension, abs(values[name if which == 0 else velocity(name)])
            lower_bound = 1.0 if which == 0 and kind == NONE else 0.0
            largest[kind] = max(largest.get(kind, lower_bound), size if lower_bound == 0.0 else lower_bound)
        reach = [largest[part.unit.dimension] for part in coordinates.values()]
        sizes: Floats = np.array(terms) + abs(self.gradients(values)) @ reach
        return sizes

    def gradients(self, values: Mapping[str, float]) -> Floats:
        """Return the derivatives of the rates by the velocities."""
        columns = {velocity(name): i for i, name in enumerate(self.statement.coordinates)}
        matrix = np.zeros((len(self.trees), len(columns)))
        for k, slopes in enumerate(self.rate_slopes):
            for name, tree in slopes.items():
                matrix[k, columns[name]] = evaluate(tree, values)
        return matrix

    def mass_matrix(self, values: Mapping[str, float]) -> Floats:
        """Return the mass matrix at a state."""
        matrix = np.zeros((len(self.statement.coordinates),) * 2)
        for row_column, entry in self.statement.mass_entries.items():
            matrix[row_column] = evaluate(expand(entry, self.statement.definitions), values)
        return matrix

    @property
    def implied(self) -> tuple[int, ...]:
        """The conditions that those before them imply here."""
        gradients, mass = self.gradients(self.values), self.mass_matrix(self.values)
        return _implied(gradients @ over_mass(mass, gradients.T, list(self.statement.coordinates)))

    def carried_states(self, values: Mapping[str, float], moves: Floats) -> dict[str, float]:
        """Return where states that conditions read go with the coordinates: attitudes of bodies, say."""
        old = self.statement
        seeds = {velocity(name): {name: ONE} for name in old.coordinates}
        move_by_name = dict(zip(old.coordinates, moves.tolist(), strict=True))
        return {
            name: values[name] + sum(evaluate(tree, values) * move_by_name[owner] for owner, tree in slopes.items())
            for name, state in old.states.items()
            if name in self.names_read and (slopes := derivatives(expand(state.rate, old.definitions), seeds))
        }

    @cached_property
    def attitude_names(self) -> list[tuple[str, ...]]:
        """The names of the four parts of every quaternion."""
        scalars = {scalar_part(body): vector_part(body) for body in self.statement.bodies}
        states = ((split_element_name(name), name) for name in self.statement.states)
        return [
            (name, *(join_element_name(scalars[quantity], (*labels, axis)) for axis in AXES))
            for (quantity, labels), name in states
            if quantity in scalars
        ]

    def _of_unit_length(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the quaternions of attitudes, brought back to unit length."""
        lengths = ((parts, float(np.linalg.norm([values[part] for part in parts]))) for parts in self.attitude_names)
        return {part: values[part] / length for parts, length in lengths for part in parts}

    def nearest_state(self) -> dict[str, float] | None:
        """Return the nearest state where all conditions hold, in the metric of the mass; None if none is found."""
        names, values = list(self.statement.coordinates), dict(self.values)
        for which, owners in ((0, names), (1, [velocity(name) for name in names])):
            for _ in range(MOST_TURNS):
                off = self.residuals_or_rates(which, values)
                if (abs(off) <= 1e-14 * self.term_sizes(which, values)).all():
                    break
                gradients = self.gradients(values)
                reach = over_mass(self.mass_matrix(values), gradients.T, names)
                moves = -reach @ np.linalg.lstsq(gradients @ reach, off, rcond=INDEPENDENT)[0]
                if not np.isfinite(moves).all():
                    return None
                values |= self.carried_states(values, moves) if which == 0 else {}
                values |= {owner: values[owner] + move for owner, move in zip(owners, moves.tolist(), strict=True)}
                values |= self._of_unit_length(values) if which == 0 else {}
        good = (
            abs(self.residuals_or_rates(which, values)) <= CONSISTENT * self.term_sizes(which, values)
            for which in (0, 1)
        )
        return values if all(part.all() for part in good) else None


def over_mass(mass: Floats, forces: Floats, names: Sequence[str]) -> Floats:
    """Return what forces accelerate.

    Raises
    ------
    InputError
        If the mass matrix has no inverse, with what is without a mass.
    """
    try:
        return np.asarray(np.linalg.solve(mass, forces))
    except np.linalg.LinAlgError:
        bare = [display_text(name) for name, row in zip(names, mass, strict=True) if not row.any()]
        subject = f"'{bare[0]}' has no mass" if bare else "its mass matrix is singular"
        raise InputError(
            f"{subject} at the start, and constraints act by what masses resist them: give {'it' if bare else 'it all'} a mass,"
            " or leave out a coordinate that the others and a constraint give"
        ) from None


def _implied(matrix: Floats) -> tuple[int, ...]:
    """Return which conditions those before them imply: pivots of a symmetric matrix that elimination leaves no share of.

    Parameters
    ----------
    matrix : ndarray, shape (n, n)
        R M^-1 R^T.
    """
    left, diagonal = matrix.copy(), matrix.diagonal()
    implied_rows = []
    for p in range(len(left)):
        if not left[p, p] > DEPENDENT * diagonal[p]:
            implied_rows.append(p)
            continue
        left[p + 1 :, p + 1 :] -= np.outer(left[p + 1 :, p], left[p, p + 1 :]) / left[p, p]
    return tuple(implied_rows)


def implied_at_start(statement: Statement) -> tuple[int, ...]:
    """Return which conditions those before them imply where the motion starts; none where measured values decide it."""
    start = _ConditionsAtStart(statement)
    masses = (expand(entry, statement.definitions) for entry in statement.mass_entries.values())
    read = start.names_read.union(*map(free_names, masses))
    return start.implied if read <= start.values.keys() else ()


def _check_conditions_at_start(start: _ConditionsAtStart, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Refuse a start where a condition does not hold, a gradient that is zero, and conditions that leave nothing to move."""
    statement, values = start.statement, start.values
    names = list(statement.constraints)
    gradients = start.gradients(values)
    for name, row in zip(names, gradients, strict=True):
        if not np.isfinite(row).all():
            ledger.note(
                f"constraint '{display_text(name)}' has no gradient at the start: its derivatives divide by zero there"
            )
        elif not row.any():
            ledger.note(
                f"constraint '{display_text(name)}' has a zero gradient at the start: no force could keep it; write another form"
                " of it, as sqrt(x**2 + y**2) - l, or start elsewhere"
            )
    ledger.raise_faults()
    timed = any("t" in free_names(tree) for pair in start.trees for tree in pair)
    rank = np.linalg.matrix_rank(gradients, tol=INDEPENDENT * np.linalg.norm(gradients, 2))
    if rank == len(statement.coordinates) and not timed:
        ledger.note(
            f"{len(names)} constraints leave {len(statement.coordinates)} coordinates no freedom to move: as many of them are"
            " independent; remove one"
        )
    off = [
        abs(start.residuals_or_rates(which, values)) > CONSISTENT * start.term_sizes(which, values) for which in (0, 1)
    ]
    if any(part.any() for part in off):
        nearest = start.nearest_state()
        if nearest is None:
            ledger.note(
                "constraints contradict each other: no state near the start satisfies "
                + ", ".join(f"'{display_text(name)}'" for name in names)
            )
        elif not statement.consistent:
            which = 0 if off[0].any() else 1
            k = int(np.argmax(off[which]))
            dimension = dimension_of(start.trees[k][which], dimensions)
            value = start.residuals_or_rates(which, values)[k]
            unit = "" if dimension == NONE else f" {spell(dimension).text}"
            verb = "is" if which == 0 else "changes by"
            ledger.note(
                f"constraint '{display_text(names[k])}' {verb} {value:.6g}{unit} at the start, and needs 0; the"
                f" nearest state where it holds is {_spelled(start, nearest)}; write it, or [initial] consistent = true"
            )
    ledger.raise_faults()


def _spelled(start: _ConditionsAtStart, nearest: Mapping[str, float]) -> str:
    """Return the values that differ, in their units; of bodies that turn, their attitudes and angular velocities."""
    statement, time = start.statement, start.statement.time_unit
    turns = {*map(quasi_coordinate, statement.bodies)}
    units = {
        name: part.unit for name, part in statement.coordinates.items() if split_element_name(name)[0] not in turns
    }
    units |= {velocity(name): part.unit.per(time) for name, part in statement.coordinates.items()}
    units |= {part: statement.states[part].unit for parts in start.attitude_names for part in parts}
    parts = [
        f"{display_text(name)} = {nearest[name] / float(unit.factor):.15g} {unit.text}".removesuffix(" 1")
        for name, unit in units.items()
        if nearest[name] != start.values[name]
    ]
    return ", ".join(parts[:8]) + (", …" if len(parts) > 8 else "")
