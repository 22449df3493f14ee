"""Reading a model file into a statement, collecting every fault."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from xdynamics.expressions import Node, parse
from xdynamics.expressions.calculus import ZERO
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.keywords import FULL, IN_FILES, KEYWORDS, read_log_columns
from xdynamics.model.accelerations import with_accelerations
from xdynamics.model.body_reading import with_bodies
from xdynamics.model.controllers import check_controllers, controller_states
from xdynamics.model.controllers import start_values as first_values
from xdynamics.model.file_access import FileAccess, excess
from xdynamics.model.given_values import Values, is_of_elements, read_values
from xdynamics.model.grammar import HEAD, SECTIONS
from xdynamics.model.kinds import Functions, Source, read_text
from xdynamics.model.lagrangian import TERMS, motion_of
from xdynamics.model.links import related
from xdynamics.model.parts import DIRECTIONS, STRIKE, Coordinate
from xdynamics.model.regimes import with_regimes
from xdynamics.model.section import Section
from xdynamics.model.statement import Statement
from xdynamics.model.table_keys import check_keys, read_choice, suggestion
from xdynamics.model.table_values import is_array
from xdynamics.model.uncertainty import correlations_of
from xdynamics.schema import velocity
from xdynamics.shapes import Shapes, resolve_min_max
from xdynamics.units import NUMBERS, SECONDS, Quantity, Scales, Unit, parse_unit, time_in


def read_statement(statement: Mapping[str, Any], path: Path, functions: Functions, access: FileAccess) -> Statement:
    """Read every section of a statement.

    Raises
    ------
    ModelError
        With every entry that cannot be read.
    """
    name = statement.get("name")
    ledger = Ledger(f"model '{name or path}'", ModelError)
    if not isinstance(name, str) or not name.strip():
        ledger.note('name is missing; write name = "…" first')
    for key in statement:
        if key not in (*(head.name for head in HEAD), *SECTIONS):
            ledger.note(f"[{key}] is no section{suggestion(key, tuple(SECTIONS))}")
    statement = with_bodies(statement, Source(functions, access), ledger)
    tables = {key: _section_table(statement, key, ledger) for key in SECTIONS}
    tables["events"], impacts = _without_impacts(tables["events"], tables["contacts"], ledger)
    start = tables["initial"]
    tables["initial"] = {key: value for key, value in start.items() if key not in ("regime", "consistent")}
    parts: dict[str, Any] = {"name": name, "description": _read_head(name, statement, ledger), "time_unit": SECONDS}
    shapes = Shapes()
    for key, section in SECTIONS.items():
        source = Source(functions, access, parts["time_unit"], shapes)
        if key in _OF_ELEMENTS:
            tables[key], parts[_OF_ELEMENTS[key]] = _split_arrays(key, tables[key], parts, source, ledger)
        if section.entry:
            parts[section.field or key] = _read_entries(section, tables[key], source, ledger)
        elif section.make is not None and tables[key]:
            with ledger.entry(key):
                parts[section.field or key] = section.read(key, tables[key], source)
        if key in ("coordinates", "states") and shapes.extents:
            ledger.raise_faults()  # what follows depends on their dimensions
        if key in ("dimensions", "relations"):
            ledger.raise_faults()
        if key == "relations":
            shapes = related(parts["extents"], parts["relations"], ledger)
            ledger.raise_faults()
    parts["contacts"] |= _read_entries(_IMPACTS, impacts, source, ledger)
    parts["states"] = {name: with_regimes(state, parts["regimes"]) for name, state in parts["states"].items()}
    _add_held_states(parts, ledger)
    parts["observables"] = {entry: part.expression for entry, part in parts["observed"].items()}
    parts |= _read_start(parts, start, ledger)
    with ledger.entry("correlations"):
        parts["correlations"] = correlations_of(tables["correlations"])
    parts["shown_time"] = _read_shown_time(tables["time"].get("unit", SECONDS.text))
    parts["run"] = _read_run_settings(tables["run"], parts["time_unit"], ledger)
    ledger.raise_faults()
    with ledger.entry("lagrangian" if parts.get("lagrangian") else "mass"):
        if parts.get("lagrangian"):
            _check_derived(parts, tables["mass"])
            parts["mass"] = ()
        else:
            parts["mass"] = _read_mass(tables["mass"], parts["coordinates"], source)
    ledger.raise_faults()
    return _with_accelerations(Statement(**parts), ledger)


def _read_shown_time(unit: Any) -> Unit | None:
    """Return the unit that people read times in; None where it is that of the record, or the section has a fault."""
    with suppress(InputError):
        return None if unit in (SECONDS.text, NUMBERS.text) else parse_unit(unit)
    return None


def _with_accelerations(statement: Statement, ledger: Ledger) -> Statement:
    with ledger.entry("states"):
        statement = with_accelerations(statement)
    ledger.raise_faults()
    return statement


def _split_arrays(
    key: str, table: Mapping[str, Any], parts: Mapping[str, Any], source: Source, ledger: Ledger
) -> tuple[dict[str, Any], dict[str, Values]]:
    """Part entries with values for elements, or by expressions, from the others."""
    single_entries, arrays = {}, {}
    moving = parts["coordinates"] | {velocity(name): part for name, part in parts["coordinates"].items()}
    dims = {name: part.dims for name, part in (moving | parts.get("states", {})).items()}
    for name, entry in table.items():
        declared = dims.get(name, ()) if key == "initial" else None
        if declared or (is_of_elements(entry) and (key == "initial" or isinstance(entry, Mapping) or is_array(entry))):
            with ledger.entry(f"{SECTIONS[key].entry} '{name}'"):
                check_keys(entry if isinstance(entry, Mapping) else {}, SECTIONS[key].fixed_keys, ())
                arrays[name] = read_values(entry, name, source, declared)
        else:
            single_entries[name] = entry
    return single_entries, arrays


def _read_entries(section: Section, table: Mapping[str, Any], source: Source, ledger: Ledger) -> dict[str, Any]:
    """Read every entry of a section; faults are noted, and reading continues."""
    entries = {}
    for name, content in table.items():
        with ledger.entry(f"{section.entry} '{name}'"):
            entries[name] = section.read(name, content, source)
    return entries


def _read_head(name: Any, statement: Mapping[str, Any], ledger: Ledger) -> str:
    """Return the description of a model; the characters of its name are checked too."""
    about = ""
    with ledger.entry("description"):
        about = read_text(statement.get("description", ""))
    if isinstance(name, str):
        with ledger.entry("name"):
            read_text(name)
    return about


def _read_start(parts: Mapping[str, Any], section: Mapping[str, Any], ledger: Ledger) -> dict[str, Any]:
    """Return where a motion starts: at time 0, at rest and in the first regime, unless stated otherwise."""
    starts, regimes, time = parts["initial"], list(parts["regimes"]), parts["time_unit"]
    stated_names = {*starts, *parts["starting"]}
    regime = section.get("regime", regimes[0] if regimes else "")
    if "regime" in section and regime not in regimes:
        ledger.note(f"initial regime {regime!r} is none; there are: {', '.join(regimes) or 'none'}")
    consistent = section.get("consistent", False)
    if not isinstance(consistent, bool):
        ledger.note(f"initial: consistent is {consistent!r}, needs true or false")
    if consistent is True and not parts["constraints"]:
        ledger.note("initial: consistent is true, and there are no [constraints] that values could be moved to")
    velocity_units = {velocity(name): about.unit.per(time) for name, about in parts["coordinates"].items()}
    at_rest = {name: Quantity(0.0, unit) for name, unit in velocity_units.items() if name not in stated_names}
    return {
        "regime": str(regime),
        "consistent": consistent is True,
        "initial": {"t": Quantity(0.0, time)}
        | {name: start.quantity for name, start in starts.items()}
        | at_rest
        | first_values(parts["controllers"]),
        "at_rest": tuple(at_rest),
        "starts": {name: start for name, start in starts.items() if start.spread or start.description},
    }


def _add_held_states(parts: dict[str, Any], ledger: Ledger) -> None:
    """Add the outputs and states of controllers to the states of a model."""
    controllers = parts["controllers"]
    with ledger.entry("controllers"):
        check_controllers(controllers)
        states = [name for part in controllers.values() for name in controller_states({"": part}, parts["time_unit"])]
        for name in states:
            if name in parts["states"] or states.count(name) > 1:
                raise InputError(f"'{name}' is held by a controller, and is a state or held once more; rename one")
            if name in parts["initial"] or name in parts["starting"]:
                raise InputError(
                    f"'{name}' is held by a controller: give its first value there, as start, not in [initial]"
                )
        parts["states"] = parts["states"] | controller_states(controllers, parts["time_unit"])


def _section_table(statement: Mapping[str, Any], key: str, ledger: Ledger) -> Mapping[str, Any]:
    section = statement.get(key, {})
    if isinstance(section, Mapping) and (fault := excess(section)):
        ledger.note(f"[{key}] {fault}")
        return {}
    if isinstance(section, Mapping):
        return section
    ledger.note(f"[{key}] must be a table of names, got {section!r}")
    return {}


def _without_impacts(
    events: Mapping[str, Any], contacts: Mapping[str, Any], ledger: Ledger
) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Return the events, and separately those that are contacts."""
    strikes = {
        name: entry for name, entry in events.items() if isinstance(entry, Mapping) and entry.get("action") == STRIKE
    }
    for name in strikes:
        if name in contacts:
            ledger.note(f"event '{name}' and contact '{name}' are both impacts; rename one, or leave it out")
    return {name: entry for name, entry in events.items() if name not in strikes}, strikes


def _impact_table(entry: Mapping[str, Any], section: Section, *_: Any) -> dict[str, Any]:
    """Return the contact that an event with the action ``impact`` is, with the event's function as its gap."""
    contact_keys = tuple(key for key in section.fixed_keys if key != "gap")
    check_keys(entry, ("function", "direction", "action", *contact_keys), needed=("function", "restitution"))
    direction = read_choice(entry.get("direction", "falling"), "direction", DIRECTIONS[:2])
    parse(entry["function"])
    gap = entry["function"] if direction == "falling" else f"-({entry['function']})"
    return {"gap": gap} | {key: value for key, value in entry.items() if key in contact_keys}


# sections with entries that have values for elements, and the attribute of the statement that holds those
_OF_ELEMENTS = {"parameters": "arrays", "initial": "starting"}
_IMPACTS = replace(SECTIONS["contacts"], entry="event", full=_impact_table)


def _read_mass(
    section: Mapping[str, Any], coordinates: Mapping[str, Coordinate], source: Source
) -> tuple[tuple[Node, ...], ...]:
    """Read the mass matrix as rows, whether it is written by coordinate or as a matrix of those without an entry."""
    names = list(coordinates)

    def read_entry(entry: Any) -> Node:
        return resolve_min_max(parse(str(entry)), source.shapes)

    square: list[str] = []
    if "matrix" in section and "matrix" not in coordinates:
        rows, square = section["matrix"], [name for name in names if name not in section]
        n = len(square)
        is_matrix = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
        if not is_matrix or [len(row) for row in rows] != [n] * n:
            raise InputError(
                f"matrix needs {n} rows of {n} entries, one for each of {', '.join(square)}, which have no other entry"
            )
    missing = [name for name in names if name not in section and name not in square]
    unknown = [name for name in section if name not in coordinates and not (name == "matrix" and square)]
    if missing or unknown:
        faults = [f"of coordinate '{name}' is missing" for name in missing]
        raise InputError("; ".join(faults + [f"of '{name}', which is no coordinate" for name in unknown]))
    entries = {(name, name): read_entry(section[name]) for name in names if name not in square}
    for name, row in zip(square, section["matrix"] if square else (), strict=True):
        entries |= {(name, column_name): read_entry(entry) for column_name, entry in zip(square, row, strict=True)}
    return tuple(tuple(entries.get((name, column_name), ZERO) for column_name in names) for name in names)


def _check_derived(parts: dict[str, Any], mass: Mapping[str, Any]) -> None:
    """Check that nothing stands beside a Lagrangian that it gives itself."""
    if mass:
        raise InputError("stands beside [mass], which follows from it; leave one out")
    if clashing := [name for name in TERMS if name in parts["forces"]]:
        raise InputError(f"makes a force '{clashing[0]}', and [forces] has one of that name; rename it")


def derive_motion(statement: Statement) -> Statement:
    """Return a statement of single numbers with the mass matrix and the forces of its Lagrangian.

    Raises
    ------
    ModelError
        If its kinetic energy is no quadratic form of velocities.
    """
    if statement.lagrangian is None:
        return statement
    ledger = Ledger(f"model '{statement.name}'", ModelError)
    with ledger.entry("lagrangian"):
        constant_names = {*statement.parameters, *statement.unit_constants, "pi"}
        matrix, forces = motion_of(
            statement.lagrangian, list(statement.coordinates), statement.definitions, constant_names
        )
        statement = replace(statement, mass=matrix, forces=forces | statement.forces)
    ledger.raise_faults()
    return statement


def _read_run_settings(section: Mapping[str, Any], time: Unit, ledger: Ledger) -> dict[str, Any]:
    for key in section:
        if key not in IN_FILES:
            ledger.note(f"[run] has no setting '{key}'{suggestion(key, IN_FILES)}")
    with ledger.entry("[run]"):
        every = section.get("keep_every", 1)
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            raise InputError(f"keep_every is {every!r}, needs a whole number from 1, every row")
        for key in filter(IN_FILES.__contains__, section):
            KEYWORDS[key].read(section[key], time)
        if "step" in section:
            time_in(time, section["step"], "step")
        Scales.parse(section.get("scales"))
        read_log_columns(section.get("log", FULL))
    return dict(section)
