"""Reading the entries of a model file into the parts of a model, collecting every fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xdynamics.expressions import Node, parse
from xdynamics.expressions.calculus import ZERO
from xdynamics.faults import InputError, Ledger, ModelError
from xdynamics.keywords import FULL, IN_FILES, KEYWORDS, columns_of
from xdynamics.model.closed_forms import validation
from xdynamics.model.contact_reading import contact, friction, impact
from xdynamics.model.drives import GAPS, INTERPOLATIONS, OUTSIDE, REFUSE, Table
from xdynamics.model.event_reading import event, regime
from xdynamics.model.file_access import Reach
from xdynamics.model.grammar import HEAD, SECTIONS, keys_of
from xdynamics.model.lagrangian import TERMS, lagrangian, motion_of
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
from xdynamics.model.python_tables import tabled
from xdynamics.model.statement import Statement
from xdynamics.model.table_keys import choice, described, flag, near
from xdynamics.model.text_limits import excess
from xdynamics.model.uncertainty import Discrepancy, correlations_of, parted, spread_of
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
    parts: dict[str, Any] = {"name": name, "description": _head(name, statement, ledger), "time_unit": SECONDS}
    with ledger.entry("time"):
        parts["time_unit"] = _time(sections["time"])
    reading = _Reading(sections, ledger)
    parts |= reading.motion(functions, reach)
    parts |= reading.events(functions)
    parts |= reading.observation(parts["time_unit"])
    parts |= reading.start(parts)
    parts |= reading.settings(parts["time_unit"])
    ledger.settle()
    if parts["lagrangian"] is not None:
        with ledger.entry("lagrangian"):
            _derive(parts, sections["mass"])
    else:
        with ledger.entry("mass"):
            parts["mass"] = _mass(sections["mass"], list(parts["coordinates"]))
    ledger.settle()
    return Statement(**parts)


@dataclass(frozen=True)
class _Reading:
    """The sections of a statement while they are read: what cannot be read is noted, and reading goes on."""

    sections: dict[str, Mapping[str, Any]]
    ledger: Ledger

    def motion(self, functions: Functions, reach: Reach) -> dict[str, Any]:
        """Read what moves, and what moves it."""
        return {
            "coordinates": self._entries("coordinates", "coordinate", _coordinate),
            "parameters": self._entries("parameters", "parameter", _parameter),
            "definitions": self._entries("definitions", "definition", parse),
            "drives": self._named("drives", "drive", lambda entry, content: _drive(entry, content, reach)),
            "states": self._entries("states", "state", _state),
            "forces": self._entries("forces", "force", lambda content: _force(content, functions)),
        }

    def events(self, functions: Functions) -> dict[str, Any]:
        """Read what a march watches for, and the regimes that it switches between."""
        return {
            "events": self._entries("events", "event", lambda content: event(content, functions)),
            "contacts": self._entries("contacts", "contact", contact) | self._entries("strikes", "event", impact),
            "frictions": self._entries("frictions", "friction", friction),
            "regimes": self._entries("regimes", "regime", regime),
        }

    def observation(self, time: Unit) -> dict[str, Any]:
        """Read what else is recorded, and what it is to be."""
        observables = self._entries("observables", "observable", _observable)
        return {
            "observables": {entry: tree for entry, (tree, _) in observables.items()},
            "observed": {entry: about for entry, (_, about) in observables.items() if about != Observable()},
            "validation": self._named(
                "validation", "validation", lambda entry, content: validation(entry, content, time)
            ),
        }

    def start(self, parts: Mapping[str, Any]) -> dict[str, Any]:
        """Read where the motion starts, from the coordinates and regimes there are."""
        first = _first_regime(self.sections["initial"], list(parts["regimes"]), self.ledger)
        self.sections["initial"] = section = {
            key: value for key, value in self.sections["initial"].items() if key != "regime"
        }
        starts = self._entries("initial", "initial value", _parameter)
        velocities = map(velocity, parts["coordinates"])
        return {
            "regime": first,
            "initial": _initial(starts, parts["coordinates"], section, parts["time_unit"]),
            "at_rest": tuple(name for name in velocities if name not in section),
            "starts": {key: entry for key, entry in starts.items() if entry.spread or entry.description},
        }

    def settings(self, time: Unit) -> dict[str, Any]:
        """Read uncertainties, pictures, the fit, settings of runs, and energies in the place of a mass matrix."""
        parts: dict[str, Any] = {"correlations": {}}
        with self.ledger.entry("correlations"):
            parts["correlations"] = correlations_of(self.sections["correlations"])
        parts["discrepancy"] = self._entries("discrepancy", "discrepancy", _discrepancy)
        with self.ledger.entry("figure"):
            parts["pictured"] = _pictured(self.sections["figure"])
        with self.ledger.entry("fit"):
            parts["fit"] = _fitted(self.sections["fit"]) if self.sections["fit"] else None
        parts["run"] = _run(self.sections["run"], time, self.ledger)
        with self.ledger.entry("lagrangian"):
            parts["lagrangian"] = lagrangian(self.sections["lagrangian"])
        return parts

    def _named(self, key: str, what: str, reader: Callable[[str, Any], Any]) -> dict[str, Any]:
        """Read every entry of a section by its name and content."""
        entries = {}
        for entry, content in self.sections[key].items():
            with self.ledger.entry(f"{what} '{entry}'"):
                entries[entry] = reader(entry, content)
        return entries

    def _entries(self, key: str, what: str, reader: Callable[[Any], Any]) -> dict[str, Any]:
        """Read every entry of a section by its content."""
        return self._named(key, what, lambda _, content: reader(content))


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


def _coordinate(entry: Any) -> Coordinate:
    entry = {"unit": entry} if isinstance(entry, str) else entry
    keys_of("coordinates", entry)
    return Coordinate(parse_unit(entry["unit"]), described(entry))


def _parameter(entry: Any) -> Parameter:
    if pair := parted(entry):
        entry = {"value": pair[0], "uncertainty": pair[1]}
    if not isinstance(entry, Mapping):
        return Parameter(parse_quantity(entry))
    keys_of("parameters", entry)
    quantity = _in_unit(entry["value"], entry.get("unit"))
    return Parameter(quantity, spread_of(entry, quantity), described(entry))


def _pictured(section: Mapping[str, Any]) -> Pictured:
    keys_of("figure", section)
    wrap = section.get("wrap", [])
    if not isinstance(wrap, list | tuple) or not all(isinstance(angle, str) for angle in wrap):
        raise InputError(f'wrap is {wrap!r}, needs a list of angles, like ["theta"]')
    period = parse(section["section"]) if "section" in section else None
    return Pictured(_plane(section["plane"]) if "plane" in section else (), period, tuple(wrap))


def _plane(row: Any) -> tuple[tuple[Node, Node], ...]:
    pairs = [row] if isinstance(row, list | tuple) and all(isinstance(item, str) for item in row) else row
    if (
        not isinstance(pairs, list | tuple)
        or not pairs
        or any(not isinstance(item, list | tuple) or len(item) != 2 for item in pairs)
    ):
        raise InputError(
            f'plane is {row!r}, needs two expressions, ["l*sin(theta)", "-l*cos(theta)"], or a list of such pairs'
        )
    return tuple((parse(across), parse(up)) for across, up in pairs)


def _discrepancy(entry: Any) -> Discrepancy:
    entry = entry if isinstance(entry, Mapping) else {"standard": entry}
    keys_of("discrepancy", entry)
    standard = parse_quantity(entry["standard"])
    if standard.value < 0:
        raise InputError(f"standard {entry['standard']!r} must be non-negative")
    return Discrepancy(standard, described(entry))


def _fitted(section: Any) -> Fitted:
    keys_of("fit", section)
    data, adequate = section.get("data", ""), section.get("adequate", True)
    if not isinstance(data, str) or not isinstance(adequate, bool):
        raise InputError(f"data is {data!r}, needs a text, and adequate {adequate!r}, needs true or false")
    return Fitted(data, adequate, described(section))


def _observable(entry: Any) -> tuple[Node, Observable]:
    entry = entry if isinstance(entry, Mapping) else {"expression": entry}
    keys_of("observables", entry)
    unit = parse_unit(entry["unit"]) if "unit" in entry else None
    return parse(entry["expression"]), Observable(unit, described(entry))


def _state(entry: Any) -> State:
    keys_of("states", entry)
    return State(parse_unit(entry["unit"]), parse(entry["rate"]), described(entry), flag(entry, "smooth"))


def _force(entry: Any, functions: Functions) -> Force:
    if not isinstance(entry, Mapping) or not entry:
        raise InputError(f"{entry!r} needs a potential or a component per coordinate")
    components = {key: value for key, value in entry.items() if key not in SECTIONS["forces"].known}
    if not components and "potential" not in entry:
        raise InputError("needs a potential or a component per coordinate")
    if "potential" in entry:
        if components:
            raise InputError(f"has a potential and the components {', '.join(components)}; write two forces")
        return Force(parse(entry["potential"]), {}, described(entry), flag(entry, "smooth"))
    by_coordinate: dict[str, Node | Function] = {}
    for coordinate, value in components.items():
        by_coordinate[coordinate] = expression_or_function(value, functions)
    return Force(None, by_coordinate, described(entry), flag(entry, "smooth"))


def _drive(owner: str, entry: Any, reach: Reach) -> Drive:
    words = {*entry} if isinstance(entry, Mapping) else None
    if words is None or not (words & {"table", "csv"} or words <= {*SECTIONS["drives"].known}):
        entry = {"table": entry}  # a table from Python in place of an entry
    if "table" in entry and not isinstance(entry["table"], str):
        entry = dict(entry) | {"table": f"{owner}.csv", "csv": tabled(owner, entry["table"])}
    elif "csv" in entry:
        entry = {"table": f"{owner}.csv"} | dict(entry)
    keys_of("drives", entry)
    if "table" not in entry:
        raise InputError("key 'table' is missing; name a CSV file there, or write its text behind csv")
    name = entry["table"]
    if not isinstance(name, str) or not name.isprintable() or not isinstance(entry.get("csv", ""), str):
        raise InputError(f"table {name!r} must be the name of a CSV file")
    column = entry.get("column", "")
    if not isinstance(column, str):
        raise InputError(f"column is {column!r}, needs the name of one")
    text = entry["csv"] if "csv" in entry else reach.text_of(name)
    table = Table.parse(Path(name).name, text, column, choice(entry, "gaps", GAPS, REFUSE))
    return Drive(
        table,
        str(entry.get("argument", "t")),
        choice(entry, "interpolation", INTERPOLATIONS, "linear"),
        choice(entry, "outside", OUTSIDE, "error"),
        described(entry),
    )


def _first_regime(initial: Mapping[str, Any], regimes: list[str], ledger: Ledger) -> str:
    """Read the regime in which a motion begins: by default the first."""
    name = initial.get("regime", regimes[0] if regimes else "")
    if name not in regimes and "regime" in initial:
        ledger.note(f"initial regime {name!r} is none; there are: {', '.join(regimes) or 'none'}")
    return str(name)


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


def _time(section: Mapping[str, Any]) -> Unit:
    keys_of("time", section)
    unit = section.get("unit", "s")
    if unit not in ("s", "1"):
        raise InputError(f"unit is {unit!r}; time is in 's', or a pure number, '1'")
    return SECONDS if unit == "s" else NUMBERS


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


def _in_unit(value: Any, unit: str | None) -> Quantity:
    quantity = parse_quantity(value)
    if unit is None:
        return quantity
    if quantity.unit.text != "1":
        raise InputError(f"{value!r} has a unit already, and '{unit}' stands beside it; write one")
    return parse_quantity(f"{quantity.value!r} {unit}")
