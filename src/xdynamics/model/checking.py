"""Names and dimensions of a model: checked before the first update, all faults at once."""

from __future__ import annotations

import keyword
import re
from collections.abc import Iterable, Mapping
from itertools import count, islice
from typing import Any

from xdynamics.expressions import FUNCTIONS, Node, Number, dimension_of, expand, free_names, shown, text_of
from xdynamics.expressions.calculus import MOST_LEVELS
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.model.checking_contacts import check_contacts
from xdynamics.model.parts import Event, Function
from xdynamics.model.spread import NORMAL, matrix_of, root_of
from xdynamics.model.statement import Statement
from xdynamics.model.validating import check_validation
from xdynamics.schema import acceleration, record_names, velocity
from xdynamics.units import CONSTANTS, NONE, Dimension, Quantity, constant, spell

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")
MOST_EVENTS = 100
RESERVED = {"t", "pi", *CONSTANTS, *FUNCTIONS}


def check(statement: Statement) -> dict[str, Dimension]:
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
    ledger, time = Ledger(f"model '{statement.name}'", ModelError), statement.time_unit.dimension
    _check_times(statement, ledger)
    _check_names(statement, ledger)
    ledger.settle()
    known = _declared(statement)
    _define(statement, known, ledger)
    ledger.settle()
    _check_initial(statement, known, ledger)
    if energies := statement.lagrangian:
        joule = constant("joule").dimension
        _needs(ledger, "kinetic energy", energies.kinetic, known, joule)
        if energies.potential is not None:
            _needs(ledger, "potential energy", energies.potential, known, joule)
        ledger.settle()
    _check_motion(statement, known, ledger)
    for name, state in statement.states.items():
        _needs(ledger, f"rate of state '{name}'", state.rate, known, known[name] / time)
    for name, drive in statement.drives.items():
        _check_drive(name, drive, statement, known, ledger)
    for name, event in statement.events.items():
        if isinstance(event.function, Function):
            _check_function(f"event '{name}'", event.function, statement, known, ledger)
            with ledger.entry(f"event '{name}'"):
                _check_place(event.position_tolerance, "function", event.unit.dimension if event.unit else NONE)
        else:
            with ledger.entry(f"event '{name}'"):
                _check_place(event.position_tolerance, "function", dimension_of(event.function, known))
        _check_action(name, event, statement, known, ledger)
    _check_regimes(statement, ledger)
    accelerations = {acceleration(name): known[name] / time**2 for name in statement.coordinates}
    for name, observable in statement.observables.items():
        with ledger.entry(f"observable '{name}'"):
            found, chosen = dimension_of(observable, known | accelerations), statement.observed.get(name)
            spell(found)
            if chosen and chosen.unit and chosen.unit.dimension != found:
                raise InputError(f"has units '{found}', and is to be in '{chosen.unit.text}'")
    _check_pictured(statement, known, ledger)
    check_validation(statement, known, ledger)
    _check_spreads(statement, known | accelerations, ledger)
    ledger.settle()
    with ledger.entry("contacts"):
        check_contacts(statement, known, ledger)
    ledger.settle()
    return known


def _check_times(statement: Statement, ledger: Ledger) -> None:
    """Check that what locates events is a time of the model's."""
    for kind in ("events", "contacts", "frictions"):
        for name, one in getattr(statement, kind).items():
            asked = one.time_tolerance
            if asked is not None and asked.unit.dimension != statement.time_unit.dimension:
                ledger.note(f"{kind.removesuffix('s')} '{name}': time_tolerance is '{asked}', needs a positive time in '{statement.time_unit.text}'")  # fmt: skip


def _check_place(asked: Quantity | None, what: str, dimension: Dimension) -> None:
    """Check that a position tolerance is in the unit of what it is of."""
    if asked is not None and asked.unit.dimension != dimension:
        raise InputError(f"position_tolerance is '{asked}', needs the unit of the {what}, '{dimension}'")


def _check_names(statement: Statement, ledger: Ledger) -> None:
    if not statement.coordinates and not statement.states:
        ledger.note("has neither coordinates nor states: there is nothing to march")
    if len(statement.events) > MOST_EVENTS:
        ledger.note(f"has {len(statement.events)} events, {MOST_EVENTS} at most")
    functions = statement.functions
    for name in sorted({one.name for one in functions}):
        if len({one.digest for one in functions if one.name == name}) > 1:
            ledger.note(f"two different functions are named '{name}'; rename one")
    used: dict[str, str] = {}
    sections = ("coordinates", "parameters", "definitions", "drives", "states", "forces", "events", "contacts", "frictions", "regimes", "observables")  # fmt: skip
    for section in sections:
        for name in getattr(statement, section):
            what = f"{section.removesuffix('s')} '{name}'"
            if keyword.iskeyword(name):
                ledger.note(f"{what}: '{name}' is a word of Python; choose another name, like '{name}_'")
            elif not _NAME.fullmatch(str(name)):
                ledger.note(f"{what}: a name is a letter, then letters, digits and underscores, 40 at most")
            elif section == "coordinates" and name in ("description", "potential", "matrix", "smooth", "t"):
                ledger.note(f"{what}: '{name}' is a key of the model file; choose another name")
            elif name in RESERVED and section not in ("forces", "events", "contacts", "frictions", "regimes"):
                ledger.note(f"{what}: the name '{name}' is a word of the expression language")
    for name, owner in record_names(vars(statement)):
        if name in used:
            ledger.note(f"{owner} and {used[name]} both claim the name '{name}'; rename one")
        used.setdefault(name, owner)


def _declared(statement: Statement) -> dict[str, Dimension]:
    known = {"t": statement.time_unit.dimension, "pi": NONE} | {name: constant(name).dimension for name in CONSTANTS}
    known |= {name: one.quantity.unit.dimension for name, one in statement.parameters.items()}
    known |= {name: one.unit.dimension for name, one in statement.states.items()}
    known |= {name: one.table.value_unit.dimension for name, one in statement.drives.items()}
    for name, one in statement.coordinates.items():
        known |= {name: one.unit.dimension, velocity(name): one.unit.dimension / statement.time_unit.dimension}
    return known


def _define(statement: Statement, known: dict[str, Dimension], ledger: Ledger) -> None:
    """Add the definitions' dimensions, each after the ones that it uses."""
    waiting: dict[str, Node] = dict(statement.definitions)
    used = {name: free_names(node) & statement.definitions.keys() for name, node in waiting.items()}
    for levels in count():
        ready = [name for name in waiting if not any(one in waiting for one in used[name])]
        if not waiting:
            return
        if not ready:
            ledger.note(f"definitions {_few(waiting)} are defined by one another")
            return
        if levels > MOST_LEVELS:
            ledger.note(
                f"definitions {_few(waiting)} are nested too deeply, over {MOST_LEVELS} levels; shorten the chain"
            )
            return
        for name in ready:
            node = waiting.pop(name)
            known[name] = NONE
            with ledger.entry(f"definition '{name}'"):
                known[name] = dimension_of(node, known)
                expand(node, statement.definitions)


def _few(names: Iterable[str]) -> str:
    """Name the first of many."""
    first, more = [*islice(names, 10)], len([*names]) - 10
    return ", ".join(first) + (f" and {more} more" if more > 0 else "")


def _check_action(
    name: str, event: Event, statement: Statement, known: Mapping[str, Dimension], ledger: Ledger
) -> None:
    """Check what an event does."""
    if event.to and event.to not in statement.regimes:
        ledger.note(
            f"event '{name}' switches to '{event.to}', which is no regime; there are: {', '.join(statement.regimes) or 'none'}"
        )
    moved = [one for name in statement.coordinates for one in (name, velocity(name))] + list(statement.states)
    for target, node in event.reset.items():
        if target in moved:
            _needs(ledger, f"event '{name}' sets '{target}'", node, known, known[target])
        else:
            ledger.note(f"event '{name}' sets '{target}', which is no coordinate, velocity or state")


def _check_regimes(statement: Statement, ledger: Ledger) -> None:
    """Check that regimes name forces, and every force is in one."""
    for name, regime in statement.regimes.items():
        for one in regime.forces:
            if one not in statement.forces:
                ledger.note(f"regime '{name}' has '{one}', which is no force; there are: {', '.join(statement.forces)}")
    acting = {one for regime in statement.regimes.values() for one in regime.forces}
    for name in statement.forces if statement.regimes else ():
        if name not in acting:
            ledger.note(f"force '{name}' acts in no regime; put it into one, or leave it out")


def _check_initial(statement: Statement, known: Mapping[str, Dimension], ledger: Ledger) -> None:
    coordinates = [name for one in statement.coordinates for name in (one, velocity(one))]
    needed = ["t", *coordinates, *statement.states]
    for name in needed:
        if name not in statement.initial:
            ledger.note(f"initial value of '{name}' is missing, in '{known[name]}'")
        elif statement.initial[name].unit.dimension != known[name]:
            given = statement.initial[name]
            ledger.note(
                f"initial value '{name} = {given}' has units '{given.unit.dimension}', needs '{known[name]}';"
                " write the unit behind the number"
            )
    for name in statement.initial:
        if name not in needed:
            ledger.note(f"initial value of '{name}', which is no coordinate, velocity or state")


def _check_spreads(statement: Statement, known: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check that correlations are of normal numbers and can all be, and discrepancies of quantities in their unit."""
    parts = statement.parameters | statement.starts
    for pair in statement.correlations:
        for name in pair:
            spread = parts[name].spread if name in parts else None
            if spread is None or spread.standard.value == 0:
                ledger.note(f"correlation of '{name}', which is no parameter or initial value with an uncertainty")
            elif spread.distribution != NORMAL:
                ledger.note(
                    f"correlation of '{name}', which is {spread.distribution}; normal numbers alone are correlated here"
                )
    names = list(dict.fromkeys(name for pair in statement.correlations for name in pair))
    with ledger.entry("correlations"):
        root_of(matrix_of(names, statement.correlations))
    for name, one in statement.discrepancy.items():
        with ledger.entry(f"discrepancy '{name}'"):
            if name not in statement.observables and (name not in known or name in statement.parameters):
                raise InputError("is of no coordinate, velocity, state, observable, nor t")
            needed = dimension_of(statement.observables[name], known) if name in statement.observables else known[name]
            if one.standard.unit.dimension != needed:
                raise InputError(f"standard has units '{one.standard.unit.dimension}', needs '{needed}'")


def _check_motion(statement: Statement, known: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check that every entry of M a = F has the unit its row needs."""
    coordinates, time = list(statement.coordinates), statement.time_unit.dimension
    needed: dict[str, Dimension] = {}
    for i, name in enumerate(coordinates):
        with ledger.entry(f"mass of '{name}'"):
            needed[name] = dimension_of(statement.mass[i][i], known) * known[name] / time**2
    if len(needed) < len(coordinates):
        return
    for (i, j), entry in statement.mass_entries.items():
        row, column, other = coordinates[i], coordinates[j], statement.mass[j][i]
        if i != j:
            _needs(ledger, f"mass entry ({i + 1}, {j + 1})", entry, known, needed[row] / known[column] * time**2)
        if entry != other and (i < j or (j, i) not in statement.mass_entries):
            first, second = sorted([(i, j), (j, i)])
            pair = text_of(statement.mass[first[0]][first[1]]), text_of(statement.mass[second[0]][second[1]])
            ledger.note(
                f"mass matrix is not symmetric: entry ({first[0] + 1}, {first[1] + 1}) is '{pair[0]}',"
                f" ({second[0] + 1}, {second[1] + 1}) is '{pair[1]}'"
            )
    for term, force in statement.forces.items():
        if force.potential is not None:
            _check_potential(term, force.potential, statement, known, needed, ledger)
        for name, node in force.components.items():
            if name not in needed:
                ledger.note(
                    f"force '{term}' acts on '{name}', which is no coordinate; there are {', '.join(coordinates)}"
                )
            elif isinstance(node, Function):
                _check_function(f"force '{term}'", node, statement, known, ledger)
            else:
                _needs(ledger, f"force '{term}' of '{name}'", node, known, needed[name])


def _check_potential(
    term: str,
    potential: Node,
    statement: Statement,
    known: Mapping[str, Dimension],
    needed: Mapping[str, Dimension],
    ledger: Ledger,
) -> None:
    try:
        whole = expand(potential, statement.definitions)
    except InputError as error:
        ledger.note(f"potential of '{term}': {error}")
        return
    used = free_names(whole)
    for drive in used & set(statement.drives):
        if statement.drives[drive].argument != "t":
            ledger.note(
                f"potential of '{term}' uses the drive '{drive}' of '{statement.drives[drive].argument}'; write a component"
            )
    if any(name.startswith("v_") and name[2:] in needed for name in used):
        ledger.note(f"potential of '{term}' depends on a velocity; write a component")
    if not needed:
        ledger.note(f"potential of '{term}' has no coordinate to act on")
        return
    acted = [name for name in needed if name in used] or list(needed)[:1]
    for energy in dict.fromkeys(needed[name] * known[name] for name in acted):
        _needs(ledger, f"potential of '{term}'", potential, known, energy)


def _check_function(
    what: str, function: Function, statement: Statement, known: Mapping[str, Dimension], ledger: Ledger
) -> None:
    for name in function.arguments:
        if name in statement.definitions:
            ledger.note(
                f"{what}: function '{function.name}' asks for the definition '{name}'; let it ask for what that is made of"
            )
        elif name not in known:
            ledger.note(f"{what}: function '{function.name}' asks for '{name}', which is not declared")


def _check_drive(name: str, drive: Any, statement: Statement, known: Mapping[str, Dimension], ledger: Ledger) -> None:
    arguments = ["t", *(one for q in statement.coordinates for one in (q, velocity(q)))]
    if drive.argument not in arguments:
        ledger.note(f"drive '{name}' has the argument '{drive.argument}'; it may be one of {', '.join(arguments)}")
    elif drive.table.argument_unit.dimension != known[drive.argument]:
        ledger.note(
            f"drive '{name}': the first column of '{drive.table.name}' is in '{drive.table.argument_unit.text}',"
            f" its argument '{drive.argument}' in '{known[drive.argument]}'"
        )


def _needs(ledger: Ledger, what: str, node: Node, known: Mapping[str, Dimension], needed: Dimension) -> None:
    """Check one expression against the unit that its place needs."""
    try:
        found = dimension_of(node, known)
    except InputError as error:
        ledger.note(f"{what}: {error}")
        return
    if found != needed and node != Number(0.0):
        column = getattr(node, "column", 1) or 1
        ledger.note(f"{what} has units '{found}', needs '{needed}' (column {column}: {shown(node)})")


def _check_pictured(statement: Statement, known: Mapping[str, Dimension], ledger: Ledger) -> None:
    """Check what pictures are to show: places of one unit, a period of parameters, angles."""
    for k, pair in enumerate(statement.pictured.plane, 1):
        with ledger.entry(f"figure: pair {k} of plane"):
            across, up = (dimension_of(one, known) for one in pair)
            if across != up:
                raise InputError(f"is across in '{across}' and up in '{up}'; both need one unit")
            moving = {*statement.states, *statement.drives, *map(velocity, statement.coordinates)}
            read = set().union(*(free_names(expand(one, statement.definitions)) for one in pair))
            if strange := sorted(read & moving):
                raise InputError(f"reads '{strange[0]}'; a place in the plane is of coordinates, t and parameters")
    with ledger.entry("figure: section"):
        if (section := statement.pictured.section) is not None:
            found = dimension_of(section, known)
            if found != statement.time_unit.dimension:
                raise InputError(f"has units '{found}', needs a period in '{statement.time_unit.text}'")
            read = free_names(expand(section, statement.definitions))
            if strange := sorted(read - {*statement.parameters, *CONSTANTS, "pi"}):
                raise InputError(f"reads '{strange[0]}'; a period is of parameters")
    for name in statement.pictured.wrap:
        if name not in statement.coordinates or known[name] != NONE:
            ledger.note(f"figure: wrap has '{name}', which is no angle among the coordinates")
