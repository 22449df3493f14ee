"""Checks of bodies, joints and the motion: units, dimensions of M a = F, inertias, attitudes of unit length.

A body must have an inertia that a rigid body can have. Masses, forces, potentials and functions in Python must have the
dimensions of their terms in M a = F.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from math import pi

import numpy as np

from xdynamics.expressions import Name, Node, Number, dimension_of, expand, free_names, shortened_text, text_of
from xdynamics.expressions.dimensions import UnequalUnitsError
from xdynamics.expressions.evaluation import evaluate
from xdynamics.faults import InputError, Ledger
from xdynamics.model.body_sections import AXES, SPACE, Body, position, quasi_coordinate, unit_quaternions
from xdynamics.model.joint_sections import UNIT
from xdynamics.model.parts import Function
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes
from xdynamics.units import NONE, Dimension, constant, parse_unit


def check_motion(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check that every entry of M a = F has the unit that its row needs."""
    coordinates, time = list(statement.coordinates), statement.time_unit.dimension
    force_dimensions: dict[str, Dimension] = {}
    unitless = {
        name: f"; its mass, {text_of(statement.mass[i][i])}, has no unit"
        for i, name in enumerate(coordinates)
        if isinstance(statement.mass[i][i], Number)
    }
    for i, name in enumerate(coordinates):
        with ledger.entry(f"mass of '{name}'"):
            force_dimensions[name] = dimension_of(statement.mass[i][i], dimensions) * dimensions[name] / time**2
    if len(force_dimensions) < len(coordinates):
        return
    for (i, j), entry in statement.mass_entries.items():
        row, column, mirrored = coordinates[i], coordinates[j], statement.mass[j][i]
        if i != j:
            check_tree_dimension(
                ledger,
                f"mass entry ({i + 1}, {j + 1})",
                entry,
                dimensions,
                force_dimensions[row] / dimensions[column] * time**2,
            )
        if entry != mirrored and (i < j or (j, i) not in statement.mass_entries):
            first, second = sorted([(i, j), (j, i)])
            pair = text_of(statement.mass[first[0]][first[1]]), text_of(statement.mass[second[0]][second[1]])
            ledger.note(
                f"mass matrix is not symmetric: entry ({first[0] + 1}, {first[1] + 1}) is '{pair[0]}',"
                f" ({second[0] + 1}, {second[1] + 1}) is '{pair[1]}'"
            )
    for term, force in statement.forces.items():
        if force.potential is not None:
            _check_potential(term, force.potential, statement, dimensions, force_dimensions, ledger)
        for name, node in force.components.items():
            if name not in force_dimensions:
                ledger.note(
                    f"force '{term}' acts on '{name}', which is no coordinate; there are {', '.join(coordinates)}"
                )
            elif isinstance(node, Function):
                check_function(f"force '{term}'", node, statement, dimensions, ledger)
            else:
                label = f"force '{term}' of '{name}'"
                check_tree_dimension(ledger, label, node, dimensions, force_dimensions[name], unitless.get(name, ""))


def _check_potential(
    term: str,
    potential: Node,
    statement: Statement,
    dimensions: Mapping[str, Dimension],
    force_dimensions: Mapping[str, Dimension],
    ledger: Ledger,
) -> None:
    try:
        tree = expand(potential, statement.definitions)
    except InputError as error:
        ledger.note(f"potential of '{term}': {error}")
        return
    used = free_names(tree)
    moving = {*statement.coordinates, *map(velocity, statement.coordinates), *statement.states}
    for drive in used & set(statement.drives):
        argument = statement.drives[drive].argument
        if free_names(expand(argument, statement.definitions)) & moving:
            ledger.note(f"potential of '{term}' uses the drive '{drive}' of '{text_of(argument)}'; write a component")
    if any(name.startswith("v_") and name[2:] in force_dimensions for name in used):
        ledger.note(f"potential of '{term}' depends on a velocity; write a component")
    if not force_dimensions:
        ledger.note(f"potential of '{term}' has no coordinate to act on")
        return
    acted = [name for name in force_dimensions if name in used] or list(force_dimensions)[:1]
    for energy in dict.fromkeys(force_dimensions[name] * dimensions[name] for name in acted):
        check_tree_dimension(ledger, f"potential of '{term}'", potential, dimensions, energy)


def check_function(
    label: str, function: Function, statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger
) -> None:
    """Check that a function in Python asks for names that are declared."""
    for name in function.arguments:
        if name in statement.definitions:
            ledger.note(
                f"{label}: function '{function.name}' asks for the definition '{name}'; let it ask for what that is"
                " made of"
            )
        elif name not in dimensions:
            ledger.note(f"{label}: function '{function.name}' asks for '{name}', which is not declared")


def check_tree_dimension(
    ledger: Ledger, label: str, node: Node, dimensions: Mapping[str, Dimension], needed: Dimension, reason: str = ""
) -> None:
    """Check one expression against the unit that is needed, for a reason that is stated."""
    try:
        dimension = dimension_of(node, dimensions)
    except InputError as error:
        ledger.note(f"{label}: {error}{_of_no_unit(node, dimensions) if isinstance(error, UnequalUnitsError) else ''}")
        return
    if dimension != needed and node != Number(0.0):
        column = getattr(node, "column", 1) or 1
        hint = reason or _of_no_unit(node, dimensions)
        ledger.note(
            f"{label} has units '{dimension}', needs '{needed}' (column {column}: {shortened_text(node)}){hint}"
        )


def _of_no_unit(node: Node, dimensions: Mapping[str, Dimension]) -> str:
    """Name what an expression reads that has no unit, if it is little."""
    pure = sorted(name for name in free_names(node) if dimensions.get(name) == NONE)
    has = "has" if len(pure) == 1 else "have"
    return f"; {', '.join(map(repr, pure))} {has} no unit" if 0 < len(pure) <= MOST_NAMED else ""


MOST_NAMED = 3  # names without units, in a message on units
ROUNDING = 1e-12  # of the largest moment
Part = tuple[str, Node, str]  # what it is, its expression, the unit that it needs


def _axis_parts(label: str, trees: Iterable[Node], unit: str) -> Iterator[Part]:
    for axis, tree in zip(AXES, trees, strict=False):
        yield f"{label}, {axis}", tree, unit


def _constant_parts(name: str, body: Body) -> Iterator[Part]:
    """Yield the constant quantities of a body."""
    if body.mass is not None:
        yield f"mass of body '{name}'", body.mass, "kg"
    for row in body.inertia:
        yield from _axis_parts(f"inertia of body '{name}'", row, "kg m2")
    yield from _axis_parts(f"pivot of body '{name}'", body.pivot or (), "m")
    for key, point in body.points.items():
        yield from _axis_parts(f"point '{key}' of body '{name}'", point, "m")


def _acting_parts(name: str, body: Body) -> Iterator[Part]:
    """Yield the forces and torques on a body, with their points."""
    for key, push in body.forces.items():
        yield from _axis_parts(f"force '{key}' of body '{name}'", push.force, "N")
        if isinstance(push.at, tuple):
            yield from _axis_parts(f"force '{key}' of body '{name}': at", push.at, "m")
    for key, torque in body.torques.items():
        yield from _axis_parts(f"torque '{key}' of body '{name}'", torque.torque, "N m")


def check_constants(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check that constants of bodies are constant, and units of quantities that read no definition."""
    constants = {*statement.parameters, *statement.arrays, *statement.unit_constants, "pi"}
    _check_joints(statement, dimensions, ledger)
    for name, body in statement.bodies.items():
        for label, tree, unit in _constant_parts(name, body):
            read = free_names(tree)
            if moving := sorted(read & dimensions.keys() - constants):
                ledger.note(f"{label} reads '{moving[0]}'; a rigid body's is of parameters alone")
            elif not read & statement.definitions.keys():
                check_tree_dimension(ledger, label, tree, dimensions, parse_unit(unit).dimension)


def _check_joints(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check that points of joints are lengths, and fixed in their body; those of space may move."""
    constants = {*statement.parameters, *statement.arrays, *statement.unit_constants, "pi"}
    joint_points = (
        (f"joint '{name}': at in {body}", body, joint_point)
        for name, joint in statement.joints.items()
        for body, joint_point in zip(joint.bodies, joint.at, strict=True)
        if not isinstance(joint_point, Name)
    )
    for about, body, joint_point in joint_points:
        for label, tree, unit in _axis_parts(about, joint_point, "m"):
            fixed = constants | ({"t"} if body == SPACE else set())
            if moving := sorted(free_names(expand(tree, statement.definitions)) & dimensions.keys() - fixed):
                ledger.note(
                    f"{label} reads '{moving[0]}'; a point of a body is of parameters alone, one of space of t too"
                )
            elif not free_names(tree) & statement.definitions.keys():
                check_tree_dimension(ledger, label, tree, dimensions, parse_unit(unit).dimension)


def check_bodies(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check the units of forces and torques on bodies as written, and of quantities that read definitions."""
    constants = {*statement.parameters, *statement.arrays, *statement.unit_constants, "pi"}
    for name, body in statement.bodies.items():
        for label, tree, unit in _acting_parts(name, body):
            check_tree_dimension(ledger, label, tree, dimensions, parse_unit(unit).dimension)
        for label, tree, unit in _constant_parts(name, body):
            if free_names(tree) & statement.definitions.keys():
                check_tree_dimension(ledger, label, tree, dimensions, parse_unit(unit).dimension)
                if moving := sorted(free_names(expand(tree, statement.definitions)) - constants):
                    ledger.note(f"{label} reads '{moving[0]}' by a definition; a rigid body's is of parameters alone")


def check_bodies_made(statement: Statement, shapes: Shapes, ledger: Ledger) -> None:
    """Check the numbers of bodies, on a statement of single numbers: mass, inertia, attitude."""
    if not statement.bodies:
        return
    constant_values = {name: part.quantity.si for name, part in statement.parameters.items()}
    constant_values |= {name: float(constant(name).factor) for name in statement.unit_constants} | {"pi": pi}
    rows = {name: i for i, name in enumerate(statement.coordinates)}

    def mass_between(row_name: str, column_name: str) -> float:
        return evaluate(
            expand(statement.mass[rows[row_name]][rows[column_name]], statement.definitions), constant_values
        )

    for name, body in statement.bodies.items():
        with ledger.entry(f"body '{name}'"):
            for element in shapes.elements(position(name))[:: len(AXES)] if body.mass is not None else ():
                if not mass_between(element, element) > 0.0:
                    raise InputError(f"mass is {mass_between(element, element)!r} kg, needs to be positive")
            turns = shapes.elements(quasi_coordinate(name))
            for first in range(0, len(turns), len(AXES)):
                axes = turns[first : first + len(AXES)]
                _check_inertia(
                    np.array([[mass_between(row_name, column_name) for column_name in axes] for row_name in axes])
                )
            for parts in unit_quaternions({name: body}, shapes):
                _check_attitude([statement.initial[part].si for part in parts])


def _check_inertia(matrix: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> None:
    """Refuse an inertia that no distribution of mass has."""
    if not np.isfinite(matrix).all():
        raise InputError(f"inertia is {matrix.tolist()} kg m2, needs finite numbers")
    smallest, middle, largest = sorted(np.linalg.eigvalsh(matrix).tolist())
    moments_text = ", ".join(f"{moment:.6g}" for moment in (smallest, middle, largest))
    if not smallest > 0.0:
        raise InputError(f"inertia has the principal moments {moments_text} kg m2, needs positive ones")
    if largest > (smallest + middle) * (1.0 + ROUNDING):
        raise InputError(
            f"inertia has the principal moments {moments_text} kg m2, and none is larger than the sum of the others: of a flat"
            " body it is that sum"
        )


def _check_attitude(quaternion: list[float]) -> None:
    length = float(np.sqrt(np.sum(np.square(quaternion))))
    if not length > 0.0:
        raise InputError(f"attitude is {quaternion} at the start, of length 0; without a turn it is [1, 0, 0, 0]")
    if abs(length - 1.0) > UNIT:
        unit = [part / length for part in quaternion]
        raise InputError(f"attitude is {quaternion} at the start, of length {length!r}, needs length 1: write {unit}")
