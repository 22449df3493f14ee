"""Reading a model file into a statement, collecting every fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from xdynamics.expressions import Node, parse
from xdynamics.expressions.calculus import ZERO
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.keywords import FULL, IN_FILES, KEYWORDS, columns_of
from xdynamics.model.file_access import FileAccess
from xdynamics.model.grammar import HEAD, SECTIONS
from xdynamics.model.kinds import Source, description
from xdynamics.model.lagrangian import TERMS, motion_of
from xdynamics.model.parts import DIRECTIONS, STRIKE
from xdynamics.model.python import Functions
from xdynamics.model.section import Section
from xdynamics.model.statement import Statement
from xdynamics.model.table_keys import choice, keys, near
from xdynamics.model.text_limits import excess
from xdynamics.model.uncertainty import correlations_of
from xdynamics.schema import velocity
from xdynamics.units import CONSTANTS, SECONDS, Quantity, Scales, Unit, time_in


def read(statement: Mapping[str, Any], path: Path, functions: Functions, access: FileAccess) -> Statement:
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
            ledger.note(f"[{key}] is no section{near(key, tuple(SECTIONS))}")
    tables = {key: _table(statement, key, ledger) for key in SECTIONS}
    tables["events"], impacts = _without_impacts(tables["events"], tables["contacts"], ledger)
    start = tables["initial"]
    tables["initial"] = {key: value for key, value in start.items() if key != "regime"}
    parts: dict[str, Any] = {"name": name, "description": _head(name, statement, ledger), "time_unit": SECONDS}
    for key, section in SECTIONS.items():
        source = Source(functions, access, parts["time_unit"])
        if section.entry:
            parts[section.field or key] = _entries(section, tables[key], source, ledger)
        elif section.make is not None and tables[key]:
            with ledger.entry(key):
                parts[section.field or key] = section.read(key, tables[key], source)
    parts["contacts"] |= _entries(_IMPACTS, impacts, source, ledger)
    parts["observables"] = {entry: part.expression for entry, part in parts["observed"].items()}
    parts |= _start(parts, start, ledger)
    with ledger.entry("correlations"):
        parts["correlations"] = correlations_of(tables["correlations"])
    parts["run"] = _run(tables["run"], parts["time_unit"], ledger)
    ledger.raise_faults()
    with ledger.entry("lagrangian" if parts.get("lagrangian") else "mass"):
        if parts.get("lagrangian"):
            _derive(parts, tables["mass"])
        else:
            parts["mass"] = _mass(tables["mass"], list(parts["coordinates"]))
    ledger.raise_faults()
    return Statement(**parts)


def _entries(section: Section, table: Mapping[str, Any], source: Source, ledger: Ledger) -> dict[str, Any]:
    """Read every entry of a section; what cannot be read is noted, and reading goes on."""
    entries = {}
    for name, content in table.items():
        with ledger.entry(f"{section.entry} '{name}'"):
            entries[name] = section.read(name, content, source)
    return entries


def _head(name: Any, statement: Mapping[str, Any], ledger: Ledger) -> str:
    """Return the description of a model; the characters of its name are checked too."""
    about = ""
    with ledger.entry("description"):
        about = description(statement.get("description", ""))
    if isinstance(name, str):
        with ledger.entry("name"):
            description(name)
    return about


def _start(parts: Mapping[str, Any], section: Mapping[str, Any], ledger: Ledger) -> dict[str, Any]:
    """Return where a motion starts: at time 0, at rest and in the first regime, unless stated otherwise."""
    starts, regimes, time = parts["initial"], list(parts["regimes"]), parts["time_unit"]
    regime = section.get("regime", regimes[0] if regimes else "")
    if "regime" in section and regime not in regimes:
        ledger.note(f"initial regime {regime!r} is none; there are: {', '.join(regimes) or 'none'}")
    rest = {velocity(name): about.unit.per(time) for name, about in parts["coordinates"].items()}
    at_rest = {name: Quantity(0.0, unit) for name, unit in rest.items() if name not in starts}
    return {
        "regime": str(regime),
        "initial": {"t": Quantity(0.0, time)} | {name: start.quantity for name, start in starts.items()} | at_rest,
        "at_rest": tuple(at_rest),
        "starts": {name: start for name, start in starts.items() if start.spread or start.description},
    }


def _table(statement: Mapping[str, Any], key: str, ledger: Ledger) -> Mapping[str, Any]:
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
    own = tuple(key for key in section.known if key != "gap")
    keys(entry, ("function", "direction", "action", *own), needed=("function", "restitution"))
    direction = choice(entry.get("direction", "falling"), "direction", DIRECTIONS[:2])
    parse(entry["function"])
    gap = entry["function"] if direction == "falling" else f"-({entry['function']})"
    return {"gap": gap} | {key: value for key, value in entry.items() if key in own}


_IMPACTS = replace(SECTIONS["contacts"], entry="event", full=_impact_table)


def _mass(section: Mapping[str, Any], coordinates: list[str]) -> tuple[tuple[Node, ...], ...]:
    """Read the mass matrix as rows, whether it is written by coordinate or as a matrix."""
    if "matrix" in section and "matrix" not in coordinates:
        rows = section["matrix"]
        n = len(coordinates)
        square = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
        if len(section) > 1 or not square or [len(row) for row in rows] != [n] * n:
            raise InputError(
                f"matrix needs {n} rows of {n} entries, one for each of {', '.join(coordinates)}, and no other key"
            )
        return tuple(tuple(parse(str(entry)) for entry in row) for row in rows)
    missing = [name for name in coordinates if name not in section]
    unknown = [name for name in section if name not in coordinates]
    if missing or unknown:
        faults = [f"of coordinate '{name}' is missing" for name in missing]
        raise InputError("; ".join(faults + [f"of '{name}', which is no coordinate" for name in unknown]))
    diagonal, n = [parse(str(section[name])) for name in coordinates], len(coordinates)
    return tuple((*[ZERO] * i, element, *[ZERO] * (n - 1 - i)) for i, element in enumerate(diagonal))


def _derive(parts: dict[str, Any], mass: Mapping[str, Any]) -> None:
    """Add the mass matrix and the forces of a Lagrangian to the parts of a model."""
    if mass:
        raise InputError("stands beside [mass], which follows from it; leave one out")
    if clashing := [name for name in TERMS if name in parts["forces"]]:
        raise InputError(f"makes a force '{clashing[0]}', and [forces] has one of that name; rename it")
    matrix, forces = motion_of(
        parts["lagrangian"], list(parts["coordinates"]), parts["definitions"], {*parts["parameters"], *CONSTANTS, "pi"}
    )
    parts["mass"], parts["forces"] = matrix, forces | parts["forces"]


def _run(section: Mapping[str, Any], time: Unit, ledger: Ledger) -> dict[str, Any]:
    for key in section:
        if key not in IN_FILES:
            ledger.note(f"[run] has no setting '{key}'{near(key, IN_FILES)}")
    with ledger.entry("[run]"):
        every = section.get("keep_every", 1)
        if isinstance(every, bool) or not isinstance(every, int) or every < 1:
            raise InputError(f"keep_every is {every!r}, needs a whole number from 1, every row")
        for key in filter(IN_FILES.__contains__, section):
            KEYWORDS[key].read(section[key], time)
        if "step" in section:
            time_in(time, section["step"], "step")
        Scales.parse(section.get("scales"))
        columns_of(section.get("log", FULL))
    return dict(section)
