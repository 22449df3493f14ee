"""Checks of the dimensions of M a = F: masses, forces, potentials, functions in Python."""

from __future__ import annotations

from collections.abc import Mapping

from xdynamics.expressions import Node, Number, dimension_of, expand, free_names, shortened_text, text_of
from xdynamics.faults import InputError, Ledger
from xdynamics.model.parts import Function
from xdynamics.model.statement import Statement
from xdynamics.schema import velocity
from xdynamics.units import Dimension


def check_motion(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check that every entry of M a = F has the unit that its row needs."""
    coordinates, time = list(statement.coordinates), statement.time_unit.dimension
    force_dimensions: dict[str, Dimension] = {}
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
                check_tree_dimension(ledger, f"force '{term}' of '{name}'", node, dimensions, force_dimensions[name])


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
    ledger: Ledger, label: str, node: Node, dimensions: Mapping[str, Dimension], needed: Dimension
) -> None:
    """Check one expression against the unit that is needed."""
    try:
        dimension = dimension_of(node, dimensions)
    except InputError as error:
        ledger.note(f"{label}: {error}")
        return
    if dimension != needed and node != Number(0.0):
        column = getattr(node, "column", 1) or 1
        ledger.note(f"{label} has units '{dimension}', needs '{needed}' (column {column}: {shortened_text(node)})")
