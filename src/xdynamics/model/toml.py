"""A model as complete TOML text, measured tables included."""

from __future__ import annotations

import json
from numbers import Integral, Real
from typing import Any

from xdynamics.expressions import text_of
from xdynamics.model.drives import REFUSE
from xdynamics.model.lagrangian import TERMS
from xdynamics.model.parts import Contact, Event, Friction, Function, Pictured, Validation
from xdynamics.model.statement import Statement
from xdynamics.model.uncertainty import NORMAL, RECTANGULAR
from xdynamics.units import Quantity, Unit, behind


def write(statement: Statement) -> str:
    """Return TOML that reads back as the same model."""
    lines = [f"name = {_value(statement.name)}"]
    if statement.description:
        lines.append(f"description = {_value(statement.description)}")
    _section(lines, "time", {"unit": statement.time_unit.text} if statement.time_unit.text != "s" else {})
    _section(
        lines,
        "coordinates",
        {name: _described({"unit": part.unit.text}, part) for name, part in statement.coordinates.items()},
    )
    _section(lines, "parameters", {name: _parameter(part) for name, part in statement.parameters.items()})
    energies = statement.lagrangian
    _section(lines, "mass", {} if energies else _mass(statement))
    if energies:
        potential = {} if energies.potential is None else {"potential": text_of(energies.potential)}
        _section(lines, "lagrangian", {"kinetic": text_of(energies.kinetic)} | potential)
    _section(lines, "definitions", {name: text_of(node) for name, node in statement.definitions.items()})
    _forces(lines, statement)
    starts = statement.starts
    initial: dict[str, Any] = {
        name: _parameter(starts[name]) if name in starts else str(quantity)
        for name, quantity in statement.initial.items()
        if name not in statement.at_rest
    }
    _section(lines, "initial", initial | ({"regime": statement.regime} if statement.regime else {}))
    _events(lines, statement)
    _section(lines, "observables", {name: _observable(statement, name) for name in statement.observables})
    for name, part in statement.validation.items():
        _section(lines, f"validation.{name}", _described(_validation(part, statement.time_unit), part))
    _section(lines, "correlations", _correlations(statement))
    discrepancy = {
        name: _described({"standard": str(part.standard)}, part) for name, part in statement.discrepancy.items()
    }
    _section(lines, "discrepancy", discrepancy)
    if (fit := statement.fit) is not None:
        _section(lines, "fit", _described({"data": fit.data, "adequate": fit.adequate}, fit))
    _section(lines, "figure", _pictured(statement.pictured))
    _section(lines, "run", statement.run)
    return "\n".join(lines) + "\n"


def _forces(lines: list[str], statement: Statement) -> None:
    """Write what moves the coordinates: forces, drives, first-order states."""
    for name, force in statement.forces.items():
        if statement.lagrangian and name in TERMS:
            continue
        body: dict[str, Any] = {} if force.potential is None else {"potential": text_of(force.potential)}
        body |= {key: _component(part) for key, part in force.components.items()}
        body |= {"smooth": True} if force.smooth else {}
        _section(lines, f"forces.{name}", _described(body, force))
    for name, drive in statement.drives.items():
        body = {"table": drive.table.name, "argument": drive.argument, "interpolation": drive.interpolation}
        body |= {"outside": drive.outside} | ({"column": drive.table.column} if drive.table.column else {})
        body |= ({"gaps": drive.table.gaps} if drive.table.gaps != REFUSE else {}) | {"csv": drive.table.text}
        _section(lines, f"drives.{name}", _described(body, drive))
    for name, state in statement.states.items():
        body = {"unit": state.unit.text, "rate": text_of(state.rate)} | ({"smooth": True} if state.smooth else {})
        _section(lines, f"states.{name}", _described(body, state))


def _events(lines: list[str], statement: Statement) -> None:
    """Write events, contacts, friction elements and regimes."""
    for name, event in statement.events.items():
        body = {"function": _component(event.function), "direction": event.direction, "action": event.action}
        body |= ({"to": event.to} if event.to else {}) | ({"count": event.count} if event.count > 1 else {})
        body |= {"root_state": event.root_state} if event.root_state != "reintegrate" else {}
        body |= {} if event.unit is None else {"unit": event.unit.text}
        body |= {"set": {key: text_of(part) for key, part in event.reset.items()}} if event.reset else {}
        _section(lines, f"events.{name}", _described(body | _tolerance(event) | _place(event), event))
    for name, contact in statement.contacts.items():
        _section(lines, f"contacts.{name}", _described(_contact(contact), contact))
    for name, friction in statement.frictions.items():
        body = {key: text_of(getattr(friction, key)) for key in ("slip", "kinetic", "static")}
        _section(lines, f"frictions.{name}", _described(body | _tolerance(friction), friction))
    for name, regime in statement.regimes.items():
        _section(lines, f"regimes.{name}", _described({"forces": list(regime.forces)}, regime))


def _section(lines: list[str], title: str, body: dict[str, Any]) -> None:
    if body:
        lines += ["", f"[{title}]", *(f"{key} = {_value(value)}" for key, value in body.items())]


def _described(body: dict[str, Any], part: Any) -> dict[str, Any]:
    return body | ({"description": part.description} if part.description else {})


def _parameter(part: Any) -> str | dict[str, Any]:
    if part.spread is None and not part.description:
        return str(part.quantity)
    body: dict[str, Any] = {"value": part.quantity.value, "unit": part.quantity.unit.text}
    if part.spread is not None:
        size, bounded = part.spread.size, part.spread.bounded
        same = size.unit.text == part.quantity.unit.text
        body["half_width" if bounded else "uncertainty"] = size.value if same else str(size)
        if part.spread.distribution != (RECTANGULAR if bounded else NORMAL):
            body["distribution"] = part.spread.distribution
        if part.spread.degrees_of_freedom is not None:
            body["degrees_of_freedom"] = part.spread.degrees_of_freedom
    return _described(body, part)


def _observable(statement: Statement, name: str) -> str | dict[str, Any]:
    text, about = text_of(statement.observables[name]), statement.observed.get(name)
    if about is None:
        return text
    return _described({"expression": text} | ({"unit": about.unit.text} if about.unit else {}), about)


def _pictured(pictured: Pictured) -> dict[str, Any]:
    body: dict[str, Any] = (
        {"plane": [[text_of(expression) for expression in pair] for pair in pictured.plane]} if pictured.plane else {}
    )
    body |= {} if pictured.section is None else {"section": text_of(pictured.section)}
    return body | ({"wrap": list(pictured.wrap)} if pictured.wrap else {})


def _correlations(statement: Statement) -> dict[str, dict[str, float]]:
    tables: dict[str, dict[str, float]] = {}
    for (name, other), value in statement.correlations.items():
        tables.setdefault(name, {})[other] = value
    return tables


def _mass(statement: Statement) -> dict[str, Any]:
    if statement.mass_is_full:
        return {"matrix": [[text_of(entry) for entry in row] for row in statement.mass]}
    return {name: text_of(statement.mass[i][i]) for i, name in enumerate(statement.coordinates)}


def _contact(part: Contact) -> dict[str, Any]:
    trees = {key: getattr(part, key) for key in ("gap", "restitution", "slip", "friction", "static")}
    body = {key: text_of(tree) for key, tree in trees.items() if tree is not None}
    body |= {"tangential": part.tangential, "law": part.law, **_tolerance(part), **_place(part)}
    return body | ({} if part.rest_height is None else {"rest_height": str(part.rest_height)})


def _validation(part: Validation, time: Unit) -> dict[str, Any]:
    body = {"quantity": part.quantity, "expression": text_of(part.expression), "bound": str(part.bound)}
    if part.event:
        return body | {"event": part.event, "occurrence": part.occurrence}
    return body | ({"times": [f"{instant!r}{behind(time)}" for instant in part.times]} if part.times else {})


def _tolerance(part: Event | Contact | Friction) -> dict[str, str]:
    return {} if part.time_tolerance is None else {"time_tolerance": str(part.time_tolerance)}


def _place(part: Event | Contact) -> dict[str, str]:
    return {} if part.position_tolerance is None else {"position_tolerance": str(part.position_tolerance)}


def _component(component: Any) -> Any:
    if not isinstance(component, Function):
        return text_of(component)
    return {
        "function": component.name,
        "arguments": list(component.arguments),
        "digest": component.digest,
        "source": component.source,
    }


def _value(value: Any) -> str:
    """Print one TOML value; a text of several lines is kept as it is, in a literal block."""
    if isinstance(value, str):
        printable = all(" " <= item != "\x7f" or item in "\n\t" for item in value)
        if "\n" in value and "'''" not in value and not value.endswith("'") and printable:
            return f"'''\n{value}'''"
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Quantity):
        return _value(str(value))
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, list | tuple):
        return f"[{', '.join(_value(item) for item in value)}]"
    if isinstance(value, dict):
        return f"{{ {', '.join(f'{json.dumps(key)} = {_value(item)}' for key, item in value.items())} }}"
    if isinstance(value, Integral):
        return str(int(value))
    return repr(float(value)) if isinstance(value, Real) else _value(str(value))
