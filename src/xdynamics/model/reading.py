"""Reading the entries of a model file into the parts of a model, collecting every fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from xdynamics.expressions import Node, parse
from xdynamics.expressions.calculus import ZERO
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.keywords import FULL, IN_FILES, KEYWORDS, columns_of
from xdynamics.model.bounding import excess
from xdynamics.model.drives import GAPS, INTERPOLATIONS, OUTSIDE, REFUSE, Table
from xdynamics.model.grammar import HEAD, SECTIONS, keys_of
from xdynamics.model.lagrangian import TERMS, lagrangian, motion_of
from xdynamics.model.measuring import tabled
from xdynamics.model.parts import (
    STRIKE,
    Coordinate,
    Drive,
    Fitted,
    Force,
    Function,
    Observable,
    Parameter,
    Pictured,
    State,
)
from xdynamics.model.python import Functions, expression_or_function
from xdynamics.model.reach import Reach
from xdynamics.model.spread import Discrepancy, correlations_of, parted, spread_of
from xdynamics.model.statement import Statement
from xdynamics.model.switching import event, regime
from xdynamics.model.touching import contact, friction, impact
from xdynamics.model.validating import validation
from xdynamics.model.words import choice, described, flag, near
from xdynamics.schema import velocity
from xdynamics.units import CONSTANTS, NUMBERS, SECONDS, Quantity, Scales, Unit, parse_quantity, parse_unit, time_in

HEAD_KEYS = tuple(key.name for key in HEAD)


def read(statement: Mapping[str, Any], path: Path, functions: Functions, reach: Reach) -> Statement:
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
        if key not in (*HEAD_KEYS, *SECTIONS):
            ledger.note(f"[{key}] is no section{near(key, tuple(SECTIONS))}")
    sections = {key: _table(statement, key, ledger) for key in SECTIONS}
    sections["events"], sections["strikes"] = _told_apart(sections["events"], sections["contacts"], ledger)
    parts: dict[str, Any] = {"name": name, "description": _head(name, statement, ledger)}

    def named(key: str, what: str, reader: Callable[[str, Any], Any]) -> dict[str, Any]:
        results = {}
        for entry, content in sections[key].items():
            with ledger.entry(f"{what} '{entry}'"):
                results[entry] = reader(entry, content)
        return results

    def entries(key: str, what: str, reader: Callable[[Any], Any]) -> dict[str, Any]:
        return named(key, what, lambda _, content: reader(content))

    parts["time_unit"] = SECONDS
    with ledger.entry("time"):
        parts["time_unit"] = _time(sections["time"])
    parts["coordinates"] = entries("coordinates", "coordinate", _coordinate)
    parts["parameters"] = entries("parameters", "parameter", _parameter)
    parts["definitions"] = entries("definitions", "definition", parse)
    parts["drives"] = named("drives", "drive", lambda entry, content: _drive(entry, content, reach))
    parts["states"] = entries("states", "state", _state)
    parts["forces"] = entries("forces", "force", lambda content: _force(content, functions))
    parts["events"] = entries("events", "event", lambda content: event(content, functions))
    parts["contacts"] = entries("contacts", "contact", contact) | entries("strikes", "event", impact)
    parts["frictions"] = entries("frictions", "friction", friction)
    parts["regimes"] = entries("regimes", "regime", regime)
    observables = entries("observables", "observable", _observable)
    parts["observables"] = {entry: tree for entry, (tree, _) in observables.items()}
    parts["observed"] = {entry: about for entry, (_, about) in observables.items() if about != Observable()}
    parts["validation"] = named(
        "validation", "validation", lambda entry, content: validation(entry, content, parts["time_unit"])
    )
    parts["regime"] = _first_regime(sections["initial"], list(parts["regimes"]), ledger)
    sections["initial"] = {key: value for key, value in sections["initial"].items() if key != "regime"}
    starts = entries("initial", "initial value", _parameter)
    parts["initial"] = _initial(starts, parts["coordinates"], sections["initial"], parts["time_unit"])
    parts["at_rest"] = tuple(
        velocity(entry) for entry in parts["coordinates"] if velocity(entry) not in sections["initial"]
    )
    parts["starts"] = {key: entry for key, entry in starts.items() if entry.spread or entry.description}
    parts["correlations"] = {}
    with ledger.entry("correlations"):
        parts["correlations"] = correlations_of(sections["correlations"])
    parts["discrepancy"] = entries("discrepancy", "discrepancy", _discrepancy)
    with ledger.entry("figure"):
        parts["pictured"] = _pictured(sections["figure"])
    with ledger.entry("fit"):
        parts["fit"] = _fitted(sections["fit"]) if sections["fit"] else None
    parts["run"] = _run(sections["run"], parts["time_unit"], ledger)
    with ledger.entry("lagrangian"):
        parts["lagrangian"] = lagrangian(sections["lagrangian"])
    ledger.settle()
    if parts["lagrangian"] is not None:
        with ledger.entry("lagrangian"):
            _derive(parts, sections["mass"])
    else:
        with ledger.entry("mass"):
            parts["mass"] = _mass(sections["mass"], list(parts["coordinates"]))
    ledger.settle()
    return Statement(**parts)


def _head(name: Any, statement: Mapping[str, Any], ledger: Ledger) -> str:
    """Return the description of a model; the characters of its name are checked too."""
    description = ""
    with ledger.entry("description"):
        description = described(statement)
    if isinstance(name, str):
        with ledger.entry("name"):
            described({"description": name})
    return description


def _initial(
    starts: Mapping[str, Parameter], coordinates: Mapping[str, Coordinate], section: Mapping[str, Any], time: Unit
) -> dict[str, Quantity]:
    """Return where a motion starts: at time 0 and at rest, unless stated otherwise."""
    at_rest = {velocity(entry): Quantity(0.0, about.unit.per(time)) for entry, about in coordinates.items()}
    initial = {"t": Quantity(0.0, time)} | {key: entry.quantity for key, entry in starts.items()}
    return initial | {key: entry for key, entry in at_rest.items() if key not in section}


def _table(statement: Mapping[str, Any], key: str, ledger: Ledger) -> Mapping[str, Any]:
    section = statement.get(key, {})
    if isinstance(section, Mapping) and (fault := excess(section)):
        ledger.note(f"[{key}] {fault}")
        return {}
    if isinstance(section, Mapping):
        return section
    ledger.note(f"[{key}] must be a table of names, got {section!r}")
    return {}


def _told_apart(
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


def _coordinate(given: Any) -> Coordinate:
    given = {"unit": given} if isinstance(given, str) else given
    keys_of("coordinates", given)
    return Coordinate(parse_unit(given["unit"]), described(given))


def _parameter(given: Any) -> Parameter:
    if both := parted(given):
        given = {"value": both[0], "uncertainty": both[1]}
    if not isinstance(given, Mapping):
        return Parameter(parse_quantity(given))
    keys_of("parameters", given)
    quantity = _in_unit(given["value"], given.get("unit"))
    return Parameter(quantity, spread_of(given, quantity), described(given))


def _pictured(given: Mapping[str, Any]) -> Pictured:
    keys_of("figure", given)
    wrap = given.get("wrap", [])
    if not isinstance(wrap, list | tuple) or not all(isinstance(angle, str) for angle in wrap):
        raise InputError(f'wrap is {wrap!r}, needs a list of angles, like ["theta"]')
    section = parse(given["section"]) if "section" in given else None
    return Pictured(_plane(given["plane"]) if "plane" in given else (), section, tuple(wrap))


def _plane(row: Any) -> tuple[tuple[Node, Node], ...]:
    pairs = [row] if isinstance(row, list | tuple) and all(isinstance(item, str) for item in row) else row
    if not isinstance(pairs, list | tuple) or not pairs or any(not isinstance(item, list | tuple) or len(item) != 2 for item in pairs):  # fmt: skip
        raise InputError(f'plane is {row!r}, needs two expressions, ["l*sin(theta)", "-l*cos(theta)"], or a list of such pairs')  # fmt: skip
    return tuple((parse(across), parse(up)) for across, up in pairs)


def _discrepancy(given: Any) -> Discrepancy:
    given = given if isinstance(given, Mapping) else {"standard": given}
    keys_of("discrepancy", given)
    standard = parse_quantity(given["standard"])
    if standard.value < 0:
        raise InputError(f"standard {given['standard']!r} must be non-negative")
    return Discrepancy(standard, described(given))


def _fitted(given: Any) -> Fitted:
    keys_of("fit", given)
    data, adequate = given.get("data", ""), given.get("adequate", True)
    if not isinstance(data, str) or not isinstance(adequate, bool):
        raise InputError(f"data is {data!r}, needs a text, and adequate {adequate!r}, needs true or false")
    return Fitted(data, adequate, described(given))


def _observable(given: Any) -> tuple[Node, Observable]:
    given = given if isinstance(given, Mapping) else {"expression": given}
    keys_of("observables", given)
    unit = parse_unit(given["unit"]) if "unit" in given else None
    return parse(given["expression"]), Observable(unit, described(given))


def _state(given: Any) -> State:
    keys_of("states", given)
    return State(parse_unit(given["unit"]), parse(given["rate"]), described(given), flag(given, "smooth"))


def _force(given: Any, functions: Functions) -> Force:
    if not isinstance(given, Mapping) or not given:
        raise InputError(f"{given!r} needs a potential or a component per coordinate")
    components = {key: value for key, value in given.items() if key not in SECTIONS["forces"].known}
    if not components and "potential" not in given:
        raise InputError("needs a potential or a component per coordinate")
    if "potential" in given:
        if components:
            raise InputError(f"has a potential and the components {', '.join(components)}; write two forces")
        return Force(parse(given["potential"]), {}, described(given), flag(given, "smooth"))
    by_coordinate: dict[str, Node | Function] = {}
    for coordinate, value in components.items():
        by_coordinate[coordinate] = expression_or_function(value, functions)
    return Force(None, by_coordinate, described(given), flag(given, "smooth"))


def _drive(owner: str, given: Any, reach: Reach) -> Drive:
    words = {*given} if isinstance(given, Mapping) else None
    if words is None or not (words & {"table", "csv"} or words <= {*SECTIONS["drives"].known}):
        given = {"table": given}  # a table from Python in place of an entry
    if "table" in given and not isinstance(given["table"], str):
        given = dict(given) | {"table": f"{owner}.csv", "csv": tabled(owner, given["table"])}
    elif "csv" in given:
        given = {"table": f"{owner}.csv"} | dict(given)
    keys_of("drives", given)
    if "table" not in given:
        raise InputError("key 'table' is missing; name a CSV file there, or write its text behind csv")
    name = given["table"]
    if not isinstance(name, str) or not name.isprintable() or not isinstance(given.get("csv", ""), str):
        raise InputError(f"table {name!r} must be the name of a CSV file")
    column = given.get("column", "")
    if not isinstance(column, str):
        raise InputError(f"column is {column!r}, needs the name of one")
    text = given["csv"] if "csv" in given else reach.text_of(name)
    table = Table.parse(Path(name).name, text, column, choice(given, "gaps", GAPS, REFUSE))
    return Drive(
        table,
        str(given.get("argument", "t")),
        choice(given, "interpolation", INTERPOLATIONS, "linear"),
        choice(given, "outside", OUTSIDE, "error"),
        described(given),
    )


def _first_regime(initial: Mapping[str, Any], regimes: list[str], ledger: Ledger) -> str:
    """Read the regime in which a motion begins: by default the first."""
    given = initial.get("regime", regimes[0] if regimes else "")
    if given not in regimes and "regime" in initial:
        ledger.note(f"initial regime {given!r} is none; there are: {', '.join(regimes) or 'none'}")
    return str(given)


def _mass(given: Mapping[str, Any], coordinates: list[str]) -> tuple[tuple[Node, ...], ...]:
    """Read the mass matrix as rows, whether it is written by coordinate or as a matrix."""
    if "matrix" in given and "matrix" not in coordinates:
        rows = given["matrix"]
        n = len(coordinates)
        square = isinstance(rows, list) and all(isinstance(row, list) for row in rows)
        if len(given) > 1 or not square or [len(row) for row in rows] != [n] * n:
            raise InputError(
                f"matrix needs {n} rows of {n} entries, one for each of {', '.join(coordinates)}, and no other key"
            )
        return tuple(tuple(parse(str(entry)) for entry in row) for row in rows)
    missing = [name for name in coordinates if name not in given]
    unknown = [name for name in given if name not in coordinates]
    if missing or unknown:
        faults = [f"of coordinate '{name}' is missing" for name in missing]
        raise InputError("; ".join(faults + [f"of '{name}', which is no coordinate" for name in unknown]))
    diagonal, n = [parse(str(given[name])) for name in coordinates], len(coordinates)
    return tuple((*[ZERO] * i, element, *[ZERO] * (n - 1 - i)) for i, element in enumerate(diagonal))


def _derive(parts: dict[str, Any], mass: Mapping[str, Any]) -> None:
    """Add the mass matrix and the forces of a Lagrangian to the parts of a model."""
    if mass:
        raise InputError("stands beside [mass], which follows from it; leave one out")
    if taken := [name for name in TERMS if name in parts["forces"]]:
        raise InputError(f"makes a force '{taken[0]}', and [forces] has one of that name; rename it")
    matrix, forces = motion_of(parts["lagrangian"], list(parts["coordinates"]), parts["definitions"], {*parts["parameters"], *CONSTANTS, "pi"})  # fmt: skip
    parts["mass"], parts["forces"] = matrix, forces | parts["forces"]


def _time(given: Mapping[str, Any]) -> Unit:
    keys_of("time", given)
    unit = given.get("unit", "s")
    if unit not in ("s", "1"):
        raise InputError(f"unit is {unit!r}; time is in 's', or a pure number, '1'")
    return SECONDS if unit == "s" else NUMBERS


def _run(given: Mapping[str, Any], time: Unit, ledger: Ledger) -> dict[str, Any]:
    for key in given:
        if key not in IN_FILES:
            ledger.note(f"[run] has no setting '{key}'{near(key, IN_FILES)}")
    with ledger.entry("[run]"):
        for key in filter(IN_FILES.__contains__, given):
            KEYWORDS[key].read(given[key], time)
        if "step" in given:
            time_in(time, given["step"], "step")
        Scales.parse(given.get("scales"))
        columns_of(given.get("log", FULL))
    return dict(given)


def _in_unit(value: Any, unit: str | None) -> Quantity:
    quantity = parse_quantity(value)
    if unit is None:
        return quantity
    if quantity.unit.text != "1":
        raise InputError(f"{value!r} has a unit already, and '{unit}' stands beside it; write one")
    return parse_quantity(f"{quantity.value!r} {unit}")
