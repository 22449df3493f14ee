"""A model as complete TOML text, measured tables included."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from numbers import Integral, Real
from operator import attrgetter
from typing import Any

from xdynamics.expressions import text_of
from xdynamics.model.body_reading import body_entries
from xdynamics.model.controllers import controller_states, starting_from
from xdynamics.model.entries import written_parameter
from xdynamics.model.given_values import Values, written_values
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.joints import made_by_joints
from xdynamics.model.lagrangian import TERMS
from xdynamics.model.parts import Parameter
from xdynamics.model.section import Section
from xdynamics.model.statement import Statement
from xdynamics.units.unit import decimal_text

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def model_toml(statement: Statement) -> str:
    """Return TOML that reads back as an equal model, without its authorship."""
    tables, lines = section_tables(statement), []
    tables.pop("about", None)  # a record has it among its attributes, where it can be changed
    for title, body in tables.items():
        if not isinstance(body, dict):
            lines.append(f"{title} = {_toml_value(body)}")
            continue
        tables_by_heading = (
            {f"{title}.{_toml_key(name)}": table for name, table in body.items()}
            if SECTIONS[title].own_tables
            else {title: body}
        )
        for heading, table in tables_by_heading.items():
            lines += ["", f"[{heading}]", *(f"{_toml_key(key)} = {_toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def section_tables(statement: Statement) -> dict[str, Any]:
    """Return what the sections of a model file are, as they are read: the head, then every section with entries."""
    tables: dict[str, Any] = {"name": statement.name}
    if statement.description:
        tables["description"] = statement.description
    for title, section in SECTIONS.items():
        if body := _WHOLE[title](statement) if title in _WHOLE else _body(section, title, statement):
            tables[title] = body
    return tables


def _body(section: Section, title: str, statement: Statement) -> dict[str, Any]:
    """Return a section as it stands in TOML: its entries, or its own keys."""
    part = getattr(statement, section.field or title)
    if not section.entry:
        return {} if part is None else section.write(part, statement.time_unit)
    if statement.bodies and (made := body_entries(statement.bodies, title) | made_by_joints(statement.joints, title)):
        part = {name: entry for name, entry in part.items() if name not in made}
    if title == "parameters":
        part = part | statement.arrays
    if any(isinstance(entry, Values) for entry in part.values()):
        return {
            name: _values_entry(statement, entry, declared=False)
            if isinstance(entry, Values)
            else section.write(entry, statement.time_unit)
            for name, entry in part.items()
        }
    derived = TERMS if title == "forces" and statement.lagrangian else ()
    return {name: section.write(entry, statement.time_unit) for name, entry in part.items() if name not in derived}


def _time_table(statement: Statement) -> dict[str, str]:
    if statement.shown_time is not None:
        return {"unit": statement.shown_time.text}
    return _body(SECTIONS["time"], "time", statement)


def _initial(statement: Statement) -> dict[str, Any]:
    starts = {name: statement.starts.get(name, Parameter(quantity)) for name, quantity in statement.initial.items()}
    elsewhere = {*statement.at_rest, *controller_states(statement.controllers, statement.time_unit)}
    body: dict[str, Any] = {name: written_parameter(start) for name, start in starts.items() if name not in elsewhere}
    body |= {name: _values_entry(statement, values, declared=True) for name, values in statement.starting.items()}
    body |= {"regime": statement.regime} if statement.regime else {}
    return body | ({"consistent": True} if statement.consistent else {})


def _state_tables(statement: Statement) -> dict[str, Any]:
    made_elsewhere = {
        *controller_states(statement.controllers, statement.time_unit),
        *body_entries(statement.bodies, "states"),
    }
    section = SECTIONS["states"]
    return {
        name: section.write(part, statement.time_unit)
        for name, part in statement.states.items()
        if name not in made_elsewhere
    }


def _controllers(statement: Statement) -> dict[str, Any]:
    """Return controllers with the values that the motion starts from."""
    section = SECTIONS["controllers"]
    return {
        name: section.write(starting_from(part, statement.initial), statement.time_unit)
        for name, part in statement.controllers.items()
    }


def _values_entry(statement: Statement, values: Values, *, declared: bool) -> Any:
    return written_values(values, statement.bare_shapes, declared=declared)


def _correlations(statement: Statement) -> dict[str, dict[str, float]]:
    tables: dict[str, dict[str, float]] = {}
    for (name, second_name), value in statement.correlations.items():
        tables.setdefault(name, {})[second_name] = value
    return tables


def _mass_table(statement: Statement) -> dict[str, Any]:
    if statement.lagrangian:
        return {}
    of_bodies = body_entries(statement.bodies, "mass")
    written_coordinates = {i: name for i, name in enumerate(statement.coordinates) if name not in of_bodies}
    coupled = (
        {i for pair in statement.mass_entries if pair[0] != pair[1] for i in pair} if statement.mass_is_full else set()
    )
    diagonal_only = {
        i
        for i, name in written_coordinates.items()
        if i not in coupled and (not coupled or statement.coordinates[name].dims)
    }
    square = [i for i in written_coordinates if i not in diagonal_only]
    matrix = {"matrix": [[text_of(statement.mass[i][j]) for j in square] for i in square]} if square else {}
    return matrix | {
        name: text_of(statement.mass[i][i]) for i, name in written_coordinates.items() if i in diagonal_only
    }


_WHOLE: dict[str, Callable[[Statement], dict[str, Any]]] = {  # sections that are not written entry by entry, key by key
    "time": _time_table,
    "mass": _mass_table,
    "states": _state_tables,
    "controllers": _controllers,
    "initial": _initial,
    "correlations": _correlations,
    "run": attrgetter("run"),
}


def _toml_key(key: str) -> str:
    """Print a key: as it is where TOML allows, as of a quantity; else in quotes, as of an element."""
    return key if _BARE.fullmatch(key) else json.dumps(key, ensure_ascii=False)


def _toml_value(value: Any) -> str:
    """Print one TOML value; a text of several lines stays as it is, in a literal block."""
    if type(value) is float:  # first of all: of those there may be very many
        return decimal_text(value)
    if isinstance(value, str):
        printable = all(" " <= item != "\x7f" or item in "\n\t" for item in value)
        if "\n" in value and "'''" not in value and not value.endswith("'") and printable:
            return f"'''\n{value}'''"
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_toml_value(item) for item in value)}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{json.dumps(key)} = {_toml_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, Integral):
        return str(int(value))
    return (
        decimal_text(value if isinstance(value, float) else float(value))
        if isinstance(value, Real)
        else _toml_value(str(value))
    )
