"""Entries of a model file that are more than their keys: what keys need, exclude and mean together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from xdynamics.expressions import Node, text_of
from xdynamics.expressions.calculus import sum_of_terms
from xdynamics.faults import InputError, first_names
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.drives import JUMP, REFUSE, Table
from xdynamics.model.given_values import dims_key, is_expression
from xdynamics.model.instruments import KEYS as READING_KEYS
from xdynamics.model.instruments import Reading, as_table
from xdynamics.model.kinds import Source
from xdynamics.model.parts import (
    DIRECTIONS,
    Constraint,
    Contact,
    Controller,
    Drive,
    Event,
    Friction,
    Function,
    Observable,
    Output,
    Parameter,
    State,
    Validation,
)
from xdynamics.model.section import Section
from xdynamics.model.table_keys import check_keys
from xdynamics.model.table_values import table_text
from xdynamics.model.uncertainty import NORMAL, RECTANGULAR, read_spread, split_uncertainty
from xdynamics.shapes import Shapes
from xdynamics.units import NUMBERS, SECONDS, Quantity, Unit, parse_quantity, parse_scale

COULOMB = "coulomb"
_OF_COULOMB = ("slip", "friction", "static")
_OF_ROLLING = ("friction", "mu", "load", "slip", "kinetic", "static")  # which limit what a constraint does without
_OF_SEARCHES = ("function", "direction", "root_state", "unit", "time_tolerance", "position_tolerance")
_OF_ACTIONS = {"to": "switch", "set": "reset"}  # keys that one action needs and no other takes


def parameter_table(entry: Any, *_: Any) -> Any:
    """Return the table that a quantity stands for, perhaps with its standard uncertainty after a sign."""
    if pair := split_uncertainty(entry):
        return {"value": pair[0], "uncertainty": pair[1]}
    return entry if isinstance(entry, Mapping) else {"value": entry}


def make_parameter(value: Any, unit: str | None = None, description: str = "", **spread: Any) -> Parameter:
    """Make a parameter, or a value at the start, from a quantity or from a number beside a unit.

    Raises
    ------
    InputError
        If the value has a unit already.
    """
    if isinstance(value, list | tuple):
        raise InputError(
            f'value is a list of {len(value)}, needs the dimensions that it is along: {{ dims = ["…"], value = […] }}'
        )
    if is_expression(value):
        raise InputError(
            f"{value!r} is an expression, needs a number with a unit, like '0.145 kg'; what follows from parameters is a"
            " definition"
        )
    quantity = parse_quantity(value)
    if unit is not None and quantity.unit.text != "1":
        raise InputError(f"{value!r} has a unit already, and '{unit}' stands beside it; write one")
    if unit is not None:
        quantity = parse_quantity(f"{quantity.value!r} {unit}")
    return Parameter(quantity, read_spread(spread, quantity, None if unit is None else parse_scale(unit)), description)


def written_parameter(part: Parameter) -> str | dict[str, Any]:
    """Write a parameter: its value alone, or a table where more is known of it."""
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
    return body | ({"description": part.description} if part.description else {})


def written_observable(part: Observable) -> str | None:
    """Write an observable of which no more than the expression is known; None if it needs a table."""
    return text_of(part.expression) if part == Observable(part.expression) else None


def force_table(entry: Any, section: Section, *_: Any) -> Any:
    """Return the entry of a force term, which has a potential or components.

    Raises
    ------
    InputError
        If it has neither, or both.
    """
    if not isinstance(entry, Mapping) or not entry:
        example = f", like {{ x = {entry!r} }} along x" if isinstance(entry, str) else ""
        raise InputError(f"{entry!r} needs a potential or a component per coordinate{example}")
    components = [key for key in entry if key not in section.fixed_keys]
    if components and "potential" in entry:
        raise InputError(f"has a potential and the components {', '.join(components)}; write two forces")
    if not components and "potential" not in entry:
        raise InputError("needs a potential or a component per coordinate")
    return entry


def drive_table(entry: Any, section: Section, name: str, source: Source) -> Any:
    """Return a drive's entry with the text of its table: written there, in a file, or made in Python.

    Raises
    ------
    InputError
        If it has neither a table nor its text, or the name is no file's.
    """
    says = isinstance(entry, Mapping) and all(isinstance(value, str) for value in entry.values())
    if not isinstance(entry, Mapping) or not (says or {*entry} & {"table", "csv"} or {*entry} <= {*section.fixed_keys}):
        entry = {"table": entry}  # a table from Python in place of an entry
    check_keys(entry, section.fixed_keys, ())
    if "table" not in entry and "csv" not in entry:
        raise InputError("key 'table' is missing; name a CSV file there, or give its text as csv")
    columns: list[str] = []
    if entry.get("dims"):
        columns = columns_of_drive(name, dims_key(entry["dims"], "dims", source), source.shapes)
        entry = {**entry, "column": columns[0]}
    read = _drive_text(entry, name, source)
    _check_drive_columns(Sheet.from_text(read["table"], read["csv"]) if columns else None, columns)
    return read


def _drive_text(entry: Mapping[str, Any], name: str, source: Source) -> dict[str, Any]:
    file = entry.get("table", f"{name}.csv")
    if not isinstance(file, str):
        entry, file = {**entry, "csv": table_text(name, file)}, f"{name}.csv"
    if not file.isprintable() or not isinstance(entry.get("csv", ""), str):
        raise InputError(f"table {file!r} must be the name of a CSV file")
    text = entry["csv"] if "csv" in entry else source.access.read_table(file)
    reading_keys = {key: value for key, value in entry.items() if key in READING_KEYS}
    drive_keys = {key: value for key, value in entry.items() if key not in READING_KEYS}
    if reading_keys.get("duplicates") == JUMP:  # what the numbers mean is of the drive, not of its file
        drive_keys["duplicates"] = JUMP
    return {**drive_keys, "table": file, "csv": as_table(file, text, Reading.from_keys(reading_keys))}


def _check_drive_columns(sheet: Sheet | None, columns: Sequence[str]) -> None:
    """Refuse a table that lacks a column of an element, or has them in different kinds of units."""
    if sheet is None:
        return
    names = sheet.names
    if lacking := [column for column in columns if column not in names]:
        more = f" and {len(lacking) - 1} more" if lacking[1:] else ""
        raise InputError(
            f"table '{sheet.name}' has no column '{lacking[0]}'{more}, and needs one for each element: "
            f"{first_names(columns)}; it is {sheet.layout_text}"
        )
    first, *later_titles = (sheet.titles([names.index(column)])[0] for column in columns)
    for later_title in later_titles:
        if later_title.unit.dimension != first.unit.dimension:
            raise InputError(
                f"table '{sheet.name}' has '{later_title.name}' in '{later_title.unit.text}' beside '{first.name}' in"
                f" '{first.unit.text}'; elements of one quantity need one kind of unit"
            )


def columns_of_drive(name: str, dims: tuple[str, ...], shapes: Shapes) -> list[str]:
    """Return the column of each element of a drive: its label, or the drive's name with its number, ``pull_0``.

    Raises
    ------
    InputError
        If it has several dimensions.
    """
    if len(dims) != 1:
        raise InputError(f"dims names {len(dims)} dimensions; a drive has one, along which its columns are")
    extent = shapes.extent(dims[0])
    return [extent.label(i) if extent.labels else f"{name}_{i}" for i in range(extent.size)]


def make_drive(
    table: str, csv: str, column: str = "", gaps: str = REFUSE, duplicates: str = "", **drive_settings: Any
) -> Drive:
    """Make a drive from the text of its table."""
    return Drive(Table.parse(Path(table).name, csv, column, gaps, duplicates), **drive_settings)


def make_event(**values: Any) -> Event:
    """Make an event whose keys go with its action.

    Raises
    ------
    InputError
        If the action lacks a key that it needs, or has one that it does not take.
    """
    action = values.get("action", "record")
    for key, needed in _OF_ACTIONS.items():
        if action == needed and key not in values:
            raise InputError(f"action '{action}' needs the key '{key}'")
        if action != needed and key in values:
            raise InputError(f"key '{key}' is for action '{needed}': '{action}' does not take it")
    if "every" in values:
        if wrong := [key for key in _OF_SEARCHES if values.get(key, DIRECTIONS[-1]) != DIRECTIONS[-1]]:
            raise InputError(
                f"every and {wrong[0]} are both given; an event is periodic, or a function's zero is located"
            )
    elif "function" not in values:
        raise InputError("key 'function' is missing; give an expression whose zeros are located, or every = \"10 ms\"")
    elif "phase" in values:
        raise InputError("key 'phase' is for a periodic event; give every too")
    if "unit" in values and not isinstance(values["function"], Function):
        raise InputError("key 'unit' is for a function written in Python: an expression has its own")
    if action == "record" and values.get("count", 1) > 1:
        raise InputError(f"count is {values['count']}, and action 'record' does nothing that could wait for it")
    return Event(reset=values.pop("set", {}), **values)


def make_state(unit: Unit, rate: Node | None = None, terms: Mapping[str, Node] | None = None, **others: Any) -> State:
    """Make a first-order state, whose rate is the sum of its terms and of what stands beside them.

    Raises
    ------
    InputError
        If it has neither.
    """
    if not terms:
        if rate is None:
            raise InputError(
                'key \'rate\' is missing; write how fast it changes, or terms = { heater = "…", loss = "…" }'
            )
        return State(unit, rate, **others)
    total = sum_of_terms([*([] if rate is None else [rate]), *terms.values()])
    return State(unit, total, terms=dict(terms), own_rate=rate, **others)


def make_controller(every: Quantity, outputs: dict[str, Output], **controller_settings: Any) -> Controller:
    """Make a controller, which puts something out; only that is delayed.

    Raises
    ------
    InputError
        If it has no outputs.
    """
    if not outputs:
        raise InputError("outputs is empty; a controller needs one: give its unit, start and value")
    return Controller(every, outputs, **controller_settings)


def make_contact(**values: Any) -> Contact:
    """Make a contact; one with friction needs a slip and a coefficient, which also holds while it sticks unless `static` is given.

    Raises
    ------
    InputError
        If a key of friction is missing, or stands without friction.
    """
    if values.get("tangential") == COULOMB:
        if missing := [key for key in _OF_COULOMB[:2] if key not in values]:
            raise InputError(f"tangential '{COULOMB}' needs {' and '.join(missing)}")
        values = {"static": values["friction"], **values}
    elif unused := [key for key in _OF_COULOMB if key in values]:
        raise InputError(f"{', '.join(unused)} is for tangential = '{COULOMB}', and this contact is frictionless")
    return Contact(**values)


def constraint_table(entry: Any, *_: Any) -> Any:
    """Return the table that a constraint is; one with friction belongs to another section.

    Raises
    ------
    InputError
        Of rolling that a force of friction limits, with what to write.
    """
    if not isinstance(entry, Mapping):
        return {"holds": entry}
    if limits := [key for key in _OF_ROLLING if key in entry]:
        slip = entry.get("rolls", "v_x - R*v_theta/radian")
        raise InputError(
            f"{limits[0]} is no key of it: what rolls and may slip is dry friction, whose sticking is this constraint;"
            f" write it in [frictions], with slip = '{slip}' and kinetic = 'mu*load'"
        )
    return entry


def make_constraint(**values: Any) -> Constraint:
    """Make a constraint, of positions or of velocities.

    Raises
    ------
    InputError
        If it is neither, or both.
    """
    if ("holds" in values) == ("rolls" in values):
        fault = "both are given" if "holds" in values else "neither is given"
        raise InputError(
            f"it needs 'holds', zero at every position, or 'rolls', a velocity that is zero, and {fault}; write one"
        )
    return Constraint(**values)


def make_friction(kinetic: Node, **friction_settings: Any) -> Friction:
    """Make a friction element; its static force is the kinetic one unless it has its own."""
    return Friction(kinetic=kinetic, **{"static": kinetic, **friction_settings})


def closed_form_table(entry: Any, _: Section, name: str, *__: Any) -> Any:
    """Return the entry of a closed form, whose name is the quantity unless it names another."""
    if isinstance(entry, str):
        return {"quantity": name, "expression": entry}
    return {"quantity": name, **entry} if isinstance(entry, Mapping) else entry


def make_closed_form(
    times: tuple[float, ...] = (), event: str = "", occurrence: int = 1, **form_settings: Any
) -> Validation:
    """Make a closed form, compared at times or at an occurrence of an event.

    Raises
    ------
    InputError
        If both are given.
    """
    if event and times:
        raise InputError("event and times are both given; a value is compared at one or the other")
    return Validation(times=times, event=event, occurrence=occurrence if event else 0, **form_settings)


def make_time_unit(unit: str = SECONDS.text) -> Unit:
    """Return the unit of a model's time: seconds, whatever it is shown in, or none."""
    return NUMBERS if unit == NUMBERS.text else SECONDS
