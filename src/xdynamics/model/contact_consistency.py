"""Names and dimensions of contacts and dry friction, checked before the first update."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.expressions import CALLED_ALONE, Call, Name, Node, derivative, dimension_of, expand, free_names, text_of
from xdynamics.expressions.calculus import ONE, ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError, Ledger
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.parts import APPROACH, MOST_REACTIONS, Contact, Function
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity
from xdynamics.shapes.naming import split_element_name
from xdynamics.units import Dimension, constant

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
    """Say what to write for more forces than are written out."""
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
    """Refuse what contacts of many links cannot have."""
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
        if (drive.argument, drive.interpolation) != (Name("t"), "linear"):
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
