"""Checks of a model's names and dimensions before the first update; all faults are reported at once."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from itertools import count
from typing import Any

from xdynamics.expressions import Call, Node, dimension_of, expand, free_names, text_of
from xdynamics.expressions.calculus import MOST_LEVELS
from xdynamics.expressions.tree import every
from xdynamics.faults import InputError, Ledger, ModelError, first_names
from xdynamics.model.body_consistency import (
    check_bodies,
    check_constants,
    check_function,
    check_motion,
    check_tree_dimension,
)
from xdynamics.model.constraint_consistency import check_constraints, check_contacts, check_delays
from xdynamics.model.controllers import EVERY, start_values
from xdynamics.model.given_values import unit_of_values
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.kinks import SWITCHING
from xdynamics.model.name_consistency import check_names
from xdynamics.model.parts import ORIGIN, Controller, Event, Function
from xdynamics.model.statement import Statement, check_validation
from xdynamics.model.uncertainty import NORMAL, cholesky_factor, correlation_matrix
from xdynamics.schema import acceleration, velocity
from xdynamics.shapes.naming import quantity_name
from xdynamics.units import CALENDAR, CONSTANTS, NONE, Dimension, Quantity, constant, spell

_ARGUMENTS = "an argument is of t, coordinates, velocities, states and parameters, like x or v*t"


def _declared_unit(statement: Statement, name: str) -> str:
    """Return the unit in which a coordinate, a state or the time is declared."""
    part = statement.coordinates.get(name) or statement.states.get(name)
    return part.unit.text if part else statement.time_unit.text


def check_statement(statement: Statement) -> dict[str, Dimension]:
    """Check names, initial values and the dimension of every term.

    Returns
    -------
    dict of str to Dimension
        The dimension of every name an expression of the model may use.

    Raises
    ------
    ModelError
        With every fault.
    """
    dimensions = check_written(statement)
    check_made(statement, dimensions)
    return dimensions


def check_written(statement: Statement) -> dict[str, Dimension]:
    """Check a statement as written, with or without dimensions; as `check_statement`.

    Raises
    ------
    ModelError
        With every fault.
    """
    ledger, time = Ledger(f"model '{statement.name}'", ModelError), statement.time_unit.dimension
    _check_time_tolerances(statement, ledger)
    check_names(statement, ledger)
    ledger.raise_faults()
    dimensions = _declared_dimensions(statement, ledger)
    ledger.raise_faults()
    check_constants(statement, dimensions, ledger)
    ledger.raise_faults()
    _define_dimensions(statement, dimensions, ledger)
    ledger.raise_faults()
    check_bodies(statement, dimensions, ledger)
    ledger.raise_faults()
    _check_initial(statement, dimensions, ledger)
    if energies := statement.lagrangian:
        for key, energy in (("kinetic", energies.kinetic), ("potential", energies.potential)):
            if energy is not None:
                check_tree_dimension(ledger, f"{key} energy", energy, dimensions, SECTIONS["lagrangian"].dimension(key))
        ledger.raise_faults()
    if statement.mass or not statement.lagrangian:
        check_motion(statement, dimensions, ledger)
    _check_rates(statement, dimensions, time, ledger)
    for name, drive in statement.drives.items():
        _check_drive(name, drive, statement, dimensions, ledger)
    for name, event in statement.events.items():
        _check_event(name, event, statement, dimensions, ledger)
        _check_action(name, event, statement, dimensions, ledger)
    for name, controller in statement.controllers.items():
        _check_controller(name, controller, statement, dimensions, ledger)
    _check_regimes(statement, ledger)
    accelerations = _accelerations(statement, dimensions)
    for name, observable in statement.observables.items():
        with ledger.entry(f"observable '{name}'"):
            dimension, observable_entry = (
                dimension_of(observable, dimensions | accelerations),
                statement.observed.get(name),
            )
            spell(dimension)
            if observable_entry and observable_entry.unit and observable_entry.unit.dimension != dimension:
                raise InputError(f"has units '{dimension}', and is to be in '{observable_entry.unit.text}'")
    _check_pictured(statement, dimensions, ledger)
    check_validation(statement, dimensions, ledger)
    ledger.raise_faults()
    if statement.delayed or statement.history:
        check_delays(statement, dimensions, ledger)
        ledger.raise_faults()
    return dimensions


def check_made(statement: Statement, dimensions: dict[str, Dimension], *, motion: bool = False) -> None:
    """Check uncertainties and contacts, perhaps the motion, of a statement of single numbers; as `check_statement`."""
    ledger = Ledger(f"model '{statement.name}'", ModelError)
    if motion:
        check_motion(statement, dimensions, ledger)
    known_dimensions = dimensions | _accelerations(statement, dimensions) if statement.discrepancy else dimensions
    _check_spreads(statement, known_dimensions, ledger)
    ledger.raise_faults()
    with ledger.entry("contacts"):
        check_contacts(statement, dimensions, ledger)
    check_constraints(statement, dimensions, ledger)
    ledger.raise_faults()


def _accelerations(statement: Statement, dimensions: Mapping[str, Dimension]) -> dict[str, Dimension]:
    square = statement.time_unit.dimension**2
    acceleration_dimensions = {
        dimension: dimension / square for dimension in {dimensions[name] for name in statement.coordinates}
    }
    return {acceleration(name): acceleration_dimensions[dimensions[name]] for name in statement.coordinates}


def _check_event(
    name: str, event: Event, statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger
) -> None:
    """Check the function of an event, and that a position tolerance is in its unit."""
    if isinstance(event.function, Function):
        check_function(f"event '{name}'", event.function, statement, dimensions, ledger)
    for key in ("every", "phase"):
        value = getattr(event, key)
        if value is not None and value.unit.dimension != statement.time_unit.dimension:
            ledger.note(f"event '{name}': {key} is '{value}', needs a time in '{statement.time_unit.text}'")
    with ledger.entry(f"event '{name}'"):
        if isinstance(event.function, Function):
            dimension = event.unit.dimension if event.unit else NONE
        else:
            dimension = dimension_of(event.function, dimensions)
        _check_position_tolerance(event.position_tolerance, "function", dimension)


def _check_time_tolerances(statement: Statement, ledger: Ledger) -> None:
    """Check that time tolerances are in the model's unit of time."""
    for kind in ("events", "contacts", "frictions"):
        for name, part in getattr(statement, kind).items():
            tolerance = part.time_tolerance
            if tolerance is not None and tolerance.unit.dimension != statement.time_unit.dimension:
                ledger.note(
                    f"{kind.removesuffix('s')} '{name}': time_tolerance is '{tolerance}', needs a positive time in"
                    f" '{statement.time_unit.text}'"
                )


def _check_position_tolerance(tolerance: Quantity | None, function_label: str, dimension: Dimension) -> None:
    """Check that a position tolerance is in the unit of its function."""
    if tolerance is not None and tolerance.unit.dimension != dimension:
        raise InputError(f"position_tolerance is '{tolerance}', needs the unit of the {function_label}, '{dimension}'")


def _declared_dimensions(statement: Statement, ledger: Ledger) -> dict[str, Dimension]:
    dimensions = {"t": statement.time_unit.dimension, "pi": NONE} | {
        name: constant(name).dimension for name in (*CONSTANTS, *CALENDAR)
    }
    dimensions |= {name: part.quantity.unit.dimension for name, part in statement.parameters.items()}
    for name, values in statement.arrays.items():
        with ledger.entry(f"parameter '{name}'"):
            dimensions[name] = unit_of_values(values).dimension
    dimensions |= {name: part.unit.dimension for name, part in statement.states.items()}
    dimensions |= {name: part.table.value_unit.dimension for name, part in statement.drives.items()}
    for name, part in statement.coordinates.items():
        dimensions |= {name: part.unit.dimension, velocity(name): part.unit.dimension / statement.time_unit.dimension}
    return dimensions


def _define_dimensions(statement: Statement, dimensions: dict[str, Dimension], ledger: Ledger) -> None:
    """Add the dimensions of definitions, each after those that it uses."""
    waiting: dict[str, Node] = dict(statement.definitions)
    uses = {name: free_names(node) & statement.definitions.keys() for name, node in waiting.items()}
    for levels in count():
        names = {*waiting}
        ready = [name for name in waiting if uses[name].isdisjoint(names)]
        if not waiting:
            return
        if not ready:
            ledger.note(f"definitions {first_names(waiting)} are defined by one another")
            return
        if levels > MOST_LEVELS:
            ledger.note(
                f"definitions {first_names(waiting)} are nested too deeply, over {MOST_LEVELS} levels; shorten the chain"
            )
            return
        for name in ready:
            node = waiting.pop(name)
            dimensions[name] = NONE
            with ledger.entry(f"definition '{name}'"):
                dimensions[name] = dimension_of(node, dimensions)
                expand(node, statement.definitions)


def _check_action(
    name: str, event: Event, statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger
) -> None:
    """Check the action of an event: the regime that it switches to, the values that it sets."""
    if event.to and event.to not in statement.regimes:
        ledger.note(
            f"event '{name}' switches to '{event.to}', which is no regime; there are:"
            f" {', '.join(statement.regimes) or 'none'}"
        )
    variables = [variable for name in statement.coordinates for variable in (name, velocity(name))] + list(
        statement.states
    )
    for target, node in event.reset.items():
        quantity = quantity_name(target)
        if quantity in variables and (statement.extents or quantity == target):
            check_tree_dimension(ledger, f"event '{name}' sets '{target}'", node, dimensions, dimensions[quantity])
        else:
            ledger.note(f"event '{name}' sets '{target}', which is no coordinate, velocity or state")


def _check_controller(
    name: str, controller: Controller, statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger
) -> None:
    """Check the times of a controller, and the dimensions of its outputs and states."""
    time, label = statement.time_unit, f"controller '{name}'"
    for key in ("every", "phase", "delay"):
        value = getattr(controller, key)
        if value is not None and value.unit.dimension != time.dimension:
            ledger.note(f"{label}: {key} is '{value}', needs a time in '{time.text}'")
    known_dimensions = {**dimensions, EVERY: time.dimension}
    for target, output in controller.outputs.items():
        for key in ("value", "minimum", "maximum"):
            if (tree := getattr(output, key)) is not None:
                check_tree_dimension(
                    ledger, f"{label}: {key} of '{target}'", tree, known_dimensions, output.unit.dimension
                )
    for target, memory in controller.states.items():
        check_tree_dimension(
            ledger, f"{label}: next of '{target}'", memory.next, known_dimensions, memory.unit.dimension
        )
    units = {target: part.unit for target, part in controller.outputs.items()}
    units |= {target: part.unit for target, part in controller.states.items()}
    for target, start in start_values({name: controller}).items():
        if target in units and start.unit.dimension != units[target].dimension:
            ledger.note(f"{label}: start of '{target}' is '{start}', needs the unit '{units[target].text}'")


def _check_rates(statement: Statement, dimensions: Mapping[str, Dimension], time: Dimension, ledger: Ledger) -> None:
    """Check the rate of each state, and its terms."""
    written_otherwise = any(state.own_rate is not None or state.terms for state in statement.states.values())
    known = {**dimensions, **_accelerations(statement, dimensions)} if written_otherwise else dimensions
    for name, state in statement.states.items():
        trees = {"rate": state.written_rate} | {f"term '{term}'": tree for term, tree in state.terms.items()}
        for label, tree in trees.items():
            if tree is not None:
                check_tree_dimension(ledger, f"{label} of state '{name}'", tree, known, dimensions[name] / time)


def _check_regimes(statement: Statement, ledger: Ledger) -> None:
    """Check that regimes list forces and terms of the model, and that every force acts in one of them."""
    terms = [*dict.fromkeys(term for state in statement.states.values() for term in state.terms)]
    for name, regime in statement.regimes.items():
        for term in regime.terms:
            if term not in terms:
                ledger.note(
                    f"regime '{name}' has '{term}', which is no term of a rate; there are: {', '.join(terms) or 'none'}"
                )
        for force in regime.forces:
            if force not in statement.forces:
                remedy = f"; it is a term of a rate: terms = ['{force}']" if force in terms else ""
                ledger.note(
                    f"regime '{name}' has '{force}', which is no force; there are: {', '.join(statement.forces) or 'none'}{remedy}"
                )
    acting = {force for regime in statement.regimes.values() for force in regime.forces}
    for name in statement.forces if statement.regimes else ():
        if name not in acting:
            ledger.note(f"force '{name}' acts in no regime; put it into one, or leave it out")


def _check_initial(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    coordinates = [name for coordinate in statement.coordinates for name in (coordinate, velocity(coordinate))]
    needed = ["t", *coordinates, *statement.states]
    for name in needed:
        if (values := statement.starting.get(name)) is not None and values.tree is not None:
            check_tree_dimension(ledger, f"initial value of '{name}'", values.tree, dimensions, dimensions[name])
        elif values is not None and values.unit is not None:
            if values.unit.dimension != dimensions[name]:
                ledger.note(
                    f"initial value of '{name}' has units '{values.unit.text}', needs '{dimensions[name]}'; write"
                    ' unit = "…" beside the values'
                )
        elif name not in statement.initial:
            ledger.note(
                f"initial value of '{name}' is missing; write [initial] {name} = \"0 {_declared_unit(statement, name)}\", or what it is"
            )
        elif statement.initial[name].unit.dimension != dimensions[name]:
            start = statement.initial[name]
            ledger.note(
                f"initial value '{name} = {start}' has units '{start.unit.dimension}', needs '{dimensions[name]}';"
                " write the unit after the number"
            )
    for name in (*statement.initial, *statement.starting):
        if name not in needed:
            quantity = name.partition("[")[0]
            problem = (
                f"an element; give '{quantity}' as a whole"
                if quantity in needed
                else f"no coordinate, velocity or state{_meant_start(name, needed)}"
            )
            ledger.note(f"initial value of '{name}', which is {problem}")


def _meant_start(name: str, needed: Collection[str]) -> str:
    """Return the velocity that a name may have been meant as: vx, v, x_dot, dx."""
    bare = name.removesuffix("_dot").removesuffix("dot").removeprefix("d").removeprefix("v").strip("_0")
    speeds = [word for word in needed if word.startswith("v_")]
    meant = velocity(bare) if velocity(bare) in needed else speeds[0] if not bare and len(speeds) == 1 else ""
    return f"; did you mean '{meant}'?" if meant else ""


def _check_spreads(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check correlations (between normal inputs, jointly possible) and discrepancies (of a quantity, in its unit)."""
    inputs = statement.parameters | statement.starts
    for pair in statement.correlations:
        for name in pair:
            spread = inputs[name].spread if name in inputs else None
            if spread is None or spread.standard.value == 0:
                ledger.note(f"correlation of '{name}', which is no parameter or initial value with an uncertainty")
            elif spread.distribution != NORMAL:
                ledger.note(
                    f"correlation of '{name}', which is {spread.distribution}; normal numbers alone are correlated here"
                )
    names = list(dict.fromkeys(name for pair in statement.correlations for name in pair))
    with ledger.entry("correlations"):
        cholesky_factor(correlation_matrix(names, statement.correlations))
    for name, discrepancy in statement.discrepancy.items():
        with ledger.entry(f"discrepancy '{name}'"):
            if name not in statement.observables and (name not in dimensions or name in statement.parameters):
                raise InputError("is of no coordinate, velocity, state, observable, nor t")
            needed = (
                dimension_of(statement.observables[name], dimensions)
                if name in statement.observables
                else dimensions[name]
            )
            if discrepancy.standard.unit.dimension != needed:
                raise InputError(f"standard has units '{discrepancy.standard.unit.dimension}', needs '{needed}'")


def _check_drive(
    name: str, drive: Any, statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger
) -> None:
    """Check a table's argument: a smooth expression of moving quantities, in the unit of the first column."""
    with ledger.entry(f"drive '{name}'"):
        argument, moving = expand(drive.argument, statement.definitions), _moving_names(statement)
        text, read = text_of(drive.argument), free_names(argument)
        if wrong := sorted(read & {*statement.drives}):
            raise InputError(f"has the argument '{text}', which reads the drive '{wrong[0]}'; {_ARGUMENTS}")
        if not read & {"t", *moving}:
            raise InputError(f"has the argument '{text}', which never changes; {_ARGUMENTS}")
        if bent := [node.function for node in every(argument) if isinstance(node, Call) and node.function in SWITCHING]:
            raise InputError(
                f"has the argument '{text}', and '{bent[0]}' has a kink or a jump there, which is not located; write the"
                " table over what is inside, beyond its kink too"
            )
        dimension = dimension_of(drive.argument, dimensions)
        if drive.table.argument_unit.dimension != dimension:
            raise InputError(
                f"the first column of '{drive.table.name}' is in '{drive.table.argument_unit.text}', its argument"
                f" '{text}' in '{dimension}'; where it is another column, say which: argument_column = \"…\""
            )


def _moving_names(statement: Statement) -> set[str]:
    """Return the names that change along a motion besides time."""
    return {*statement.coordinates, *map(velocity, statement.coordinates), *statement.states}


def _check_pictured(statement: Statement, dimensions: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check the quantities in figures: places in a plane, a period computed from parameters, angles."""
    first: tuple[Dimension, ...] = ()
    for k, pair in enumerate(statement.pictured.plane, 1):
        with ledger.entry(f"figure: pair {k} of plane"):
            both = tuple(dimension_of(expression, dimensions) for expression in pair)
            first = first or both
            if both != first:
                raise InputError(
                    f"is across in '{both[0]}' and up in '{both[1]}', the first in '{first[0]}', '{first[1]}'"
                )
            names = set().union(*(free_names(expand(expression, statement.definitions)) for expression in pair))
            if forbidden := sorted(names & {*statement.drives}):
                raise InputError(
                    f"reads the drive '{forbidden[0]}'; a place in the plane is of coordinates, velocities, states, t and"
                    " parameters"
                )
    pictured = statement.pictured
    if pictured.bodies and not statement.extents and len(pictured.bodies) != len(pictured.plane):
        ledger.note(f"figure: bodies names {len(pictured.bodies)}, plane has {len(pictured.plane)} pairs")
    for kind in ("links", "springs", "threads"):
        for end in (end for pair in getattr(pictured, kind) for end in pair):
            if end not in (*pictured.bodies, ORIGIN):
                known_ends = ", ".join((*pictured.bodies, ORIGIN))
                ledger.note(f"figure: {kind} has '{end}'; there are {known_ends}, and others are named by bodies")
    with ledger.entry("figure: section"):
        if (section := statement.pictured.section) is not None:
            dimension = dimension_of(section, dimensions)
            if dimension != statement.time_unit.dimension:
                raise InputError(f"has units '{dimension}', needs a period in '{statement.time_unit.text}'")
            names = free_names(expand(section, statement.definitions))
            if forbidden := sorted(names - {*statement.parameters, *statement.unit_constants, "pi"}):
                raise InputError(f"reads '{forbidden[0]}'; a period is of parameters")
    for name in statement.pictured.wrap:
        if name not in statement.coordinates or dimensions[name] != NONE:
            ledger.note(f"figure: wrap has '{name}', which is no angle among the coordinates")
