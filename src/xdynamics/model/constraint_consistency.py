"""Checks of constraints, contacts, dry friction and delays, made before the first update.

Constraints: the quantities that they may read, and that the motion starts where they are satisfied.

Contacts and dry friction: their names and dimensions.

Delayed values: where they may stand, what is delayed, by how much, and the values before the start.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields
from math import isfinite, pi

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.expressions import (
    CALLED_ALONE,
    Call,
    Name,
    Node,
    derivative,
    derivatives,
    dimension_of,
    expand,
    free_names,
    shortened_text,
    text_of,
)
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every, summands
from xdynamics.faults import InputError, Ledger, display_text
from xdynamics.model.body_sections import AXES, quasi_coordinate, scalar_part, vector_part
from xdynamics.model.delays import has_delays
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.parts import APPROACH, MOST_REACTIONS, Constraint, Contact, Function
from xdynamics.model.statement import Statement, trees_in
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.schema import velocity
from xdynamics.shapes.naming import join_element_name, split_element_name
from xdynamics.units import NONE, Dimension, constant, spell

ROUNDING = 64 * EPS  # of the terms of a gap
KINKS = {"abs", "sign", "min", "max", "where", *CALLED_ALONE}

Dimensions = Mapping[str, Dimension]


def check_contacts(statement: Statement, dimensions: Dimensions, ledger: Ledger) -> None:
    """Check every contact and friction element."""
    contacts, frictions = statement.contacts | statement.assemblies, statement.frictions
    if not contacts and not frictions:
        return
    count = sum(2 if part.slip else 1 for part in statement.contacts.values()) + len(frictions)
    if count > MOST_REACTIONS:
        ledger.note(
            f"has {count} forces of contacts and friction, {MOST_REACTIONS} at most; {_remedy_for_many(statement)}"
        )
    if statement.assemblies:
        _check_assemblies(statement, dimensions, ledger)
    if APPROACH in dimensions:
        ledger.note(f"'{APPROACH}' is what contacts call the speed at which a gap closes; choose another name")
    if len({part.law for part in contacts.values()}) > 1:
        laws = ", ".join(f"'{name}': {part.law}" for name, part in contacts.items())
        ledger.note(f"contacts have several laws ({laws}); several of them at once need one, so give all the same")
    for term, force in statement.forces.items():
        if any(isinstance(part, Function) for part in force.components.values()):
            ledger.note(
                f"force '{term}' is written in Python, and contacts and friction need forces that can be"
                " differentiated; write it as an expression"
            )
    power = one_power(statement, dimensions)
    for name, contact in contacts.items():
        with ledger.entry(f"contact '{name}'"):
            _check_contact(contact, statement, dimensions)
            if name in statement.contacts:  # of many links, the march finds those that overlap
                _check_gap_at_start(expand(contact.gap, statement.definitions), statement)
    for name, friction in frictions.items():
        with ledger.entry(f"friction '{name}'"):
            slip = _check_slip(friction.slip, statement, dimensions)
            for key in ("kinetic", "static"):
                _check_needed_unit(key, getattr(friction, key), statement, dimensions, power / slip)
            _check_strengths("kinetic", friction.kinetic, friction.static, statement)


def _remedy_for_many(statement: Statement) -> str:
    """Return how to declare more forces than can be written out one by one."""
    if not statement.frictions:
        return "many contacts are those of a dimension or a relation"
    counts = Counter(split_element_name(name)[0] for name in statement.frictions)
    name, largest_count = counts.most_common(1)[0]
    return (
        f"friction '{name}' has {largest_count} of them; write friction of many elements as [contacts.{name}] with gap, restitution, slip, friction and"
        " tangential = 'coulomb', the normal force being solved for, or as a smooth force, like -kinetic*tanh(slip/slow)"
        " with a low speed slow"
    )


def _check_assemblies(statement: Statement, dimensions: Dimensions, ledger: Ledger) -> None:
    """Refuse keys that contacts of many links cannot have."""
    many = f"contacts have more than {MOST_REACTIONS} links together, and then"
    for name, contact in statement.assemblies.items():
        for key in ("slip", "friction", "static"):
            tree = getattr(contact, key)
            read = set() if tree is None else free_names(expand(tree, statement.definitions))
            for quantity in sorted(read & {*statement.states, *statement.drives}):
                ledger.note(
                    f"{many} {key} of contact '{name}' may read coordinates, velocities, time and parameters, not"
                    f" '{quantity}'"
                )
    units: dict[str, Dimension] = {}
    for name, contact in statement.assemblies.items():
        with suppress(InputError):  # what is wrong with a gap is said with its contact
            units[name] = dimension_of(contact.gap, dimensions)
    slips: dict[str, Dimension] = {}
    for name, contact in statement.assemblies.items():
        with suppress(InputError):
            slips |= {name: dimension_of(contact.slip, dimensions)} if contact.slip is not None else {}
    if len({*slips.values()}) > 1:
        units_text = ", ".join(f"'{name}': {unit}" for name, unit in slips.items())
        ledger.note(f"{many} their slips are of one unit ({units_text}); write each slip as a velocity, say")
    if len({*units.values()}) > 1:
        units_text = ", ".join(f"'{name}': {unit}" for name, unit in units.items())
        ledger.note(f"{many} their gaps are of one unit ({units_text}); write each gap as a length, say")
    if statement.frictions:
        ledger.note(f"{many} there are no friction elements: remove '{next(iter(statement.frictions))}'")
    if statement.mass_is_full or statement.lagrangian:
        ledger.note(f"{many} the mass is diagonal: write [mass] with one entry for each coordinate")


def _is_settled(call: Call, moving: set[str]) -> bool:
    """Whether it is a choice by a condition that never changes."""
    return call.function == "where" and not free_names(call.arguments[0]) & moving


def _check_contact(contact: Contact, statement: Statement, dimensions: Dimensions) -> None:
    gap = dimension_of(contact.gap, dimensions)
    tree = expand(contact.gap, statement.definitions)
    for kind, names in (
        ("state", statement.states),
        ("drive", statement.drives),
        ("velocity", map(velocity, statement.coordinates)),
    ):
        for name in sorted(free_names(tree) & set(names)):
            raise InputError(f"gap reads the {kind} '{name}', and may read coordinates, time and parameters")
    moving = {*statement.coordinates, "t"}  # what reads constants and numbers of elements alone has no kink in motion
    calls = [node for node in every(tree) if isinstance(node, Call) and free_names(node) & moving]
    if kinks := sorted({node.function for node in calls if not _is_settled(node, moving)} & KINKS):
        raise InputError(
            f"gap has a kink or a jump, {', '.join(kinks)}; where all of its smooth parts hold at once write a contact for"
            " each, as '1*metre - x' and '1*metre + x' for '1*metre - abs(x)'; else an event of this function with action"
            " = 'reset' and set = { v_x = '-0.9*v_x' }: it may have kinks"
        )
    if all(derivative(tree, {name: ONE}) == ZERO for name in statement.coordinates):
        raise InputError("gap depends on no coordinate: nothing could be pushed away")
    _check_needed_unit(
        "restitution",
        contact.restitution,
        statement,
        {**dimensions, APPROACH: gap / statement.time_unit.dimension},
        SECTIONS["contacts"].dimension("restitution"),
    )
    size = _constant_value(contact.restitution, statement)
    if size is not None and not 0.0 <= size <= 1.0:
        raise InputError(f"{_value_text('restitution', contact.restitution, size)}, needs to be from 0 to 1")
    if contact.position_tolerance is not None and contact.position_tolerance.unit.dimension != gap:
        raise InputError(f"position_tolerance is '{contact.position_tolerance}', needs the unit of the gap, '{gap}'")
    if contact.rest_height is not None and contact.rest_height.unit.dimension != gap:
        raise InputError(f"rest_height is '{contact.rest_height}', needs the unit of the gap, '{gap}'")
    if contact.slip is not None and contact.friction is not None and contact.static is not None:
        slip = _check_slip(contact.slip, statement, dimensions)
        for key, node in (("friction", contact.friction), ("static", contact.static)):
            _check_needed_unit(key, node, statement, dimensions, gap / statement.time_unit.dimension / slip)
        _check_strengths("friction", contact.friction, contact.static, statement)


def _check_gap_at_start(gap: Node, statement: Statement) -> None:
    """Refuse a motion that starts with one body inside another, by more than rounding."""
    values = parameter_values(statement) | {name: quantity.si for name, quantity in statement.initial.items()}
    if free_names(gap) - set(values):
        return  # a missing value has been reported already
    distance = evaluate(gap, values)
    terms = (evaluate(derivative(gap, {name: ONE}), values) * values[name] for name in statement.coordinates)
    if distance < -ROUNDING * sum(map(abs, terms)):
        raise InputError(
            f"gap is {distance:.6g} (SI units) at the start: one body is inside the other; begin where gaps are not"
            " negative"
        )


def _check_strengths(key: str, slipping: Node, sticking: Node, statement: Statement) -> None:
    """Refuse negative friction, and static below kinetic friction, where both are known before the start."""
    size, static_value = _constant_value(slipping, statement), _constant_value(sticking, statement)
    if size is not None and not size >= 0.0:
        raise InputError(f"{_value_text(key, slipping, size)}, needs to be non-negative")
    if size is not None and static_value is not None and not static_value >= size:
        raise InputError(
            f"{_value_text('static', sticking, static_value)}, needs to be at least {_value_text(key, slipping, size)}"
        )


def _value_text(key: str, node: Node, size: float) -> str:
    """Describe a value and the expression it comes from."""
    return f"{key} is {size:.6g}" if not free_names(node) else f"{key}, {text_of(node)}, is {size:.6g} (SI units)"


def _constant_value(node: Node, statement: Statement) -> float | None:
    """Return the value of an expression of parameters alone; None if it reads anything else."""
    tree, values = expand(node, statement.definitions), parameter_values(statement)
    return None if free_names(tree) - set(values) else evaluate(tree, values)


def parameter_values(statement: Statement) -> dict[str, float]:
    """Return parameters and constants in SI units."""
    constants = {name: float(constant(name).factor) for name in statement.unit_constants} | {"pi": math.pi}
    return constants | {name: parameter.quantity.si for name, parameter in statement.parameters.items()}


def _check_slip(slip: Node, statement: Statement, dimensions: Dimensions) -> Dimension:
    """Check that a slip is linear in velocities, and return its dimension."""
    dimension = dimension_of(slip, dimensions)
    tree = expand(slip, statement.definitions)
    check_velocity("slip", tree, statement)
    for input_name in sorted(free_names(tree) & set(statement.states)):
        raise InputError(
            f"slip reads the state '{input_name}', and may read coordinates, velocities, time and parameters"
        )
    for input_name in sorted(free_names(tree) & set(statement.drives)):
        drive = statement.drives[input_name]
        if (drive.argument, drive.interpolation, drive.table.duplicates) != (Name("t"), "linear", ""):
            raise InputError(
                f"slip reads the drive '{input_name}', {drive.interpolation} in {text_of(drive.argument)}; it may be one of t"
                " that is linear"
            )
    return dimension


def check_velocity(label: str, tree: Node, statement: Statement) -> None:
    """Check that an expression is linear in velocities.

    Raises
    ------
    InputError
        Naming what it is, and the velocity in which it is not.
    """
    velocities = set(map(velocity, statement.coordinates))
    if not free_names(tree) & velocities:
        raise InputError(f"{label} depends on no velocity; there are {', '.join(sorted(velocities)) or 'none'}")
    if all(derivative(tree, {name: ONE}) == ZERO for name in velocities):
        raise InputError(f"{label} depends on no velocity: no factor of one is other than zero")
    for name in sorted(velocities):
        if free_names(derivative(tree, {name: ONE})) & velocities:
            raise InputError(f"{label} is not linear in {name}; write the relative velocity itself")


def _check_needed_unit(label: str, node: Node, statement: Statement, dimensions: Dimensions, needed: Dimension) -> None:
    expand(node, statement.definitions)
    dimension = dimension_of(node, dimensions)
    if dimension != needed:
        raise InputError(f"{label} has units '{dimension}', needs '{needed}'")


def one_power(statement: Statement, dimensions: Dimensions, who: str = "contacts and friction") -> Dimension:
    """Return the dimension of a force times a velocity, which all coordinates share.

    Raises
    ------
    InputError
        If they do not, naming who needs it.
    """
    powers = {
        dimension_of(statement.mass[i][i], dimensions)
        * dimensions[name]
        * dimensions[name]
        / statement.time_unit.dimension**3
        for i, name in enumerate(statement.coordinates)
    }
    if len(powers) != 1:
        raise InputError(f"{who} need coordinates whose energies share one unit")
    return powers.pop()


_SECTIONS = ("definitions", "forces", "states", "events", "controllers", "observables", "observed")
_TITLES = {"pictured": "figure", "starting": "initial", "arrays": "parameters"}
_PLACES = "components of forces, rates of states, events, controllers, observables and definitions of these"


def check_delays(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check everything that is delayed, and the history of each."""
    if statement.delayed and statement.extents:
        ledger.note("delayed values are of single numbers, and the model has [dimensions]; write its elements out")
        return
    moving = {*statement.coordinates, *map(velocity, statement.coordinates), *statement.states}
    constants = {*statement.parameters, *statement.unit_constants, "pi"}
    read = set[str]()
    for call in statement.delayed:
        with ledger.entry(f"'{shortened_text(call)}'"):
            delayed_tree, delay_tree = (expand(part, statement.definitions) for part in call.arguments)
            read |= free_names(delayed_tree)
            _check_delay(delay_tree, constants, statement)
            _check_delayed(delayed_tree, moving, statement)
    for label, tree in _elsewhere(statement):
        if has_delays(expand(tree, statement.definitions)):
            ledger.note(f"{label} has a delayed value, which stands in {_PLACES} alone")
    for name, tree in statement.history.items():
        with ledger.entry(f"history of '{name}'"):
            if name not in moving:
                raise InputError(f"is of no coordinate, velocity or state; there are {', '.join(sorted(moving))}")
            if name not in read:
                raise InputError(f"is read nowhere: no expression has delayed({name}, …)")
            if dimension_of(tree, dimensions) != dimensions[name]:
                raise InputError(f"has units '{dimension_of(tree, dimensions)}', needs '{dimensions[name]}'")
            if wrong := sorted(free_names(expand(tree, statement.definitions)) - constants - {"t"}):
                raise InputError(f"reads '{wrong[0]}'; what was before the start is of t and parameters")


def _check_delay(delay_tree: Node, constants: set[str], statement: Statement) -> None:
    """Refuse a delay that changes, or is no positive time."""
    if wrong := sorted(free_names(delay_tree) - constants):
        raise InputError(
            f"has the delay '{text_of(delay_tree)}', which reads '{wrong[0]}'; a delay is of parameters and does not change"
        )
    constant_values = {name: part.quantity.si for name, part in statement.parameters.items()}
    constant_values |= {name: float(constant(name).factor) for name in statement.unit_constants}
    delay = evaluate(delay_tree, constant_values | {"pi": pi})
    if not (isfinite(delay) and delay > 0.0):
        raise InputError(
            f"has the delay '{text_of(delay_tree)}' = {delay!r} {statement.time_unit.text}, needs a positive time"
        )


def _check_delayed(delayed_tree: Node, moving: set[str], statement: Statement) -> None:
    """Refuse delays of constants, of their own values, and of tables with jumps, or with kinks at unknown times."""
    names = free_names(delayed_tree)
    if has_delays(delayed_tree):
        raise InputError("reads a definition with another delayed value; write one delay, the sum of both")
    if not names & {"t", *moving, *statement.drives}:
        raise InputError("delays what never changes; leave out delayed")
    for name in sorted(names & {*statement.drives}):
        drive = statement.drives[name]
        timed = not free_names(expand(drive.argument, statement.definitions)) & moving
        if drive.jumps or (drive.interpolation == "linear" and not timed):
            raise InputError(
                f"delays the drive '{name}', whose table has jumps, or kinks along a motion; give it interpolation ="
                ' "pchip" and outside = "hold", or write a second drive with the argument t - delay'
            )


def _elsewhere(statement: Statement) -> Iterator[tuple[str, Node]]:
    """Yield the expressions that cannot have delayed values, with their descriptions."""
    for name, force in statement.forces.items():
        if force.potential is not None:
            yield f"potential of '{name}'", force.potential
    for part in fields(statement):
        if part.name not in _SECTIONS:
            yield from (
                (f"[{_TITLES.get(part.name, part.name)}]", tree) for tree in trees_in(getattr(statement, part.name))
            )


CONSISTENT = 1e-9  # a residual at the start, over its terms: what digits of initial values leave
MOST_TURNS = 50
# A gradient of which less is left beside the others, squared, is one that these imply. Near a singular position what is left
# of a residual is divided by this number, and what is dropped is missed for as long as its root: 1e-7 weighs the two.
DEPENDENT = 1e-7
INDEPENDENT = 1e-9  # of the largest singular value of gradients: less belongs to one that others imply

Floats = NDArray[np.float64]


def check_constraints(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check the expressions of every constraint, then the start of the motion."""
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
    """Refuse conditions of constants alone, of velocities, with kinks, or of measured drives."""
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
        """Return the nearest state that satisfies all conditions, in the metric of the mass; None without one."""
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
    """Return the accelerations by forces, the solution of M a = F.

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
        # negated, so that a pivot of nan is left out too
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
