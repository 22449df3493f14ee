"""Other entries in some sections of a model: new numbers of parameters and of the start, new tables, new forces."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from xdynamics.expressions import parse
from xdynamics.faults import DOT, InputError, Ledger, ModelError, display_text, first_names, internal_text
from xdynamics.keywords import merge_settings
from xdynamics.model.controllers import check_in_effect
from xdynamics.model.element_numbers import with_starts
from xdynamics.model.file_access import ANYWHERE, FileAccess
from xdynamics.model.given_values import Values, is_expression, unit_of_values
from xdynamics.model.grammar import SECTIONS
from xdynamics.model.kinds import Functions, Source
from xdynamics.model.parts import Parameter
from xdynamics.model.reading import read_statement
from xdynamics.model.statement import Statement
from xdynamics.model.toml import section_tables
from xdynamics.model.uncertainty import SIZES, split_uncertainty
from xdynamics.units import NONE, Unit, parse_quantity, parse_unit

# sections that take new entries; a new parameter or start would be a misspelt one
_GROWING = (
    *("forces", "events", "contacts", "frictions", "constraints", "controllers", "regimes", "joints"),
    *("definitions", "drives", "observables", "validation", "run"),
)
_TEXTS = ("name", "description")
OF_SPREAD = (*SIZES, "distribution", "degrees_of_freedom")  # keys that say how uncertain a value is
NO_UNIT = "1"
_ONE_BY_ONE = ("parameters", "initial", "drives")  # sections whose entries nothing else is read from
_OUTSIDE = FileAccess(Path(), ANYWHERE)


def replace_entries(statement: Statement, sections: Mapping[str, Any], functions: Functions) -> Statement:
    """Return a statement with some entries of some sections replaced, added, or taken away by None; read but not checked.

    Raises
    ------
    ModelError
        If an entry does not exist or cannot be read.
    """
    single = not (statement.extents or statement.starting)
    sections = {title: _on_scales(statement, title, entries) for title, entries in sections.items()}
    if (
        single
        and all(title in _ONE_BY_ONE and not _dropped(entries) for title, entries in sections.items())
        and not {"regime", "consistent"} & {*sections.get("initial", ())}
    ):
        ledger = Ledger(f"model '{statement.name}'", ModelError)
        for title, entries in sections.items():
            statement = _with_parts(statement, title, entries, ledger, Source(functions, _OUTSIDE, statement.time_unit))
        ledger.raise_faults()
        return statement
    tables = section_tables(statement)
    for title, entries in sections.items():
        if title in _TEXTS:
            if not isinstance(entries, str):
                raise ModelError(f"{title} is {entries!r}, which is no text; write it in quotes")
            tables[title] = entries
            continue
        shaped = {"parameters": statement.arrays, "initial": statement.starting}.get(title, {})
        old, dropped = tables.get(title, {}), _dropped(entries)
        new = _new_entries(title, old, entries, shaped)
        merged = merge_settings(old, new) if title == "run" else old | new
        tables[title] = {name: entry for name, entry in merged.items() if name not in dropped}
    return read_statement(tables, Path(), functions, _OUTSIDE)


def _on_scales(statement: Statement, title: str, entries: Any) -> Any:
    """Give bare numbers the scale on which the file states the quantity: where it has 20 °C, 25 is 25 °C."""
    if title not in ("parameters", "initial") or not isinstance(entries, Mapping):
        return entries
    scaled = dict(entries)
    for name, value in entries.items():
        entry = getattr(statement, title).get(name)
        quantity = getattr(entry, "quantity", entry)
        number = _without_array(value)
        if quantity is not None and quantity.scale and isinstance(number, int | float) and not isinstance(number, bool):
            scaled[name] = f"{number!r} {quantity.scale.text}"
    return scaled


def changes_numbers_alone(old: Statement, new: Statement) -> bool:
    """Whether two statements differ in numbers of parameters and of the start alone, and no check depends on these."""
    names = ("parameters", "arrays", "initial", "starting", "starts", "at_rest")
    numbers: dict[str, Any] = {name: getattr(old, name) for name in names}
    same_otherwise = replace(new, **numbers) == old and _statement_units(new) == _statement_units(old)
    are_known = _are_trees_known(old.arrays, new.arrays) and _are_trees_known(old.starting, new.starting)
    return (
        same_otherwise
        and are_known
        and not (old.contacts or old.assemblies or old.frictions or old.constraints or old.correlations or old.bodies)
    )


def _statement_units(statement: Statement) -> tuple[Any, ...]:
    """Return what of the numbers expressions depend on: units, dimensions, and what is said of them."""
    return (
        {name: (entry.quantity.unit, entry.description) for name, entry in statement.parameters.items()},
        {name: (item.dims, unit_of_values(item), item.description) for name, item in statement.arrays.items()},
        {name: start.unit for name, start in statement.initial.items()},
        {name: item.dims for name, item in statement.starting.items()},
    )


def _are_trees_known(old: Mapping[str, Values], new: Mapping[str, Values]) -> bool:
    """Whether values are numbers, or the expressions that they were."""
    return all(item.tree is None or (name in old and item.tree == old[name].tree) for name, item in new.items())


def read_parts(
    statement: Statement, sections: Mapping[str, Any], functions: Functions
) -> dict[str, dict[str, Parameter]]:
    """Return the new parameters and values at the start of a statement of single numbers.

    Raises
    ------
    ModelError
        If an entry does not exist or cannot be read.
    """
    ledger = Ledger(f"model '{statement.name}'", ModelError)
    source = Source(functions, _OUTSIDE, statement.time_unit)
    parts: dict[str, dict[str, Parameter]] = {"parameters": {}, "initial": {}}
    for title, entries in sections.items():
        parts[title] = _read_parts(statement, title, _on_scales(statement, title, entries), ledger, source)
    ledger.raise_faults()
    return parts


def _read_parts(
    statement: Statement, title: str, entries: Mapping[str, Any], ledger: Ledger, source: Source
) -> dict[str, Any]:
    """Return the parts of a section that new entries give."""
    section, old = SECTIONS[title], getattr(statement, title)
    changed = {name: old[name] for name in entries if name in old} if isinstance(entries, Mapping) else {}
    if title == "initial":
        changed = {name: statement.starts.get(name, Parameter(quantity)) for name, quantity in changed.items()}
    old_entries = {name: section.write(part, source.time) for name, part in changed.items()}
    parts = {}
    for name, value in _new_entries(title, {**dict.fromkeys(old), **old_entries}, entries).items():
        with ledger.entry(f"{section.entry} '{name}'"):
            check_in_effect(name, statement.controllers if title == "initial" else {})
            part = parts[name] = section.read(name, value, source)
            old_quantity = getattr(changed.get(name), "quantity", None)
            if old_quantity is not None and part.quantity.unit.dimension != old_quantity.unit.dimension:
                raise InputError(f"has units '{part.quantity.unit.dimension}', needs '{old_quantity.unit.dimension}'")
    return parts


def _with_parts(
    statement: Statement, title: str, entries: Mapping[str, Any], ledger: Ledger, source: Source
) -> Statement:
    parts = _read_parts(statement, title, entries, ledger, source)
    if title != "initial":
        changed: dict[str, Any] = {title: getattr(statement, title) | parts}
        return replace(statement, **changed)
    return with_starts(statement, parts)


def _new_entries(title: str, old: Any, entries: Any, shaped: Mapping[str, Values] | None = None) -> dict[str, Any]:
    """Return the new entries of a section as they stand in a file; some may have values for elements."""
    if not isinstance(old, dict) or not isinstance(entries, Mapping):
        raise ModelError(f"{title} has no entries to replace")
    for key, entry in entries.items():
        if key not in old and (title not in _GROWING or entry is None):
            quantity, dot, _ = internal_text(str(key)).partition(DOT)
            elements = [display_text(entry) for entry in old if dot and entry.startswith(quantity + DOT)]
            known_names = elements or dict.fromkeys(entry.partition(DOT)[0] for entry in old)
            remedy = "" if title in _GROWING else "; a new one is written into the model itself"
            raise ModelError(
                f"{title} has no entry '{display_text(str(key))}'; there are: {first_names([*known_names]) or 'none'}{remedy}"
            )
    new = {}
    for key, value in entries.items():
        if key not in old or value is None or title == "run":
            new[key] = value
        else:
            new[key] = (
                _replace_array_value(key, old[key], shaped[key], value)
                if shaped and key in shaped
                else _replace_value(key, old[key], value)
            )
    return new


def _dropped(entries: Any) -> set[str]:
    """Return the names of entries that are taken away: those that are None."""
    return {name for name, entry in entries.items() if entry is None} if isinstance(entries, Mapping) else set()


def _replace_array_value(entry: str, old: Any, values: Values, value: Any) -> Any:
    """Return the entry of a quantity with dimensions with other values, in its unit unless they have one."""
    kept_names = ("dims", "description", *(() if split_uncertainty(value) else OF_SPREAD))
    kept_keys = {key: item for key, item in old.items() if key in kept_names} if isinstance(old, Mapping) else {}
    value = {"value": value} if hasattr(value, "dims") else value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, Mapping):
        return {**value, **({"dims": kept_keys["dims"]} if "dims" in kept_keys else {})}
    if "dims" not in kept_keys and (values.tree is not None or is_expression(value)):  # at the start, of parameters
        return value
    unit = unit_of_values(values)
    if is_expression(value):
        try:
            dimension = unit_of_values(Values(values.dims, tree=parse(value))).dimension
        except InputError as error:
            raise ModelError(f"parameter '{entry}': {error}") from None
        if dimension == unit.dimension != NONE:
            return kept_keys | {"value": value}
        if dimension != NONE:
            raise ModelError(f"{entry} = {value!r} has units '{dimension}', needs '{unit.dimension}', or none")
    return kept_keys | {"value": value, "unit": unit.text if values.scale is None else values.scale.text}


def _without_array(value: Any) -> Any:
    """Return what an array of one number holds, as a text where the array says its unit; anything else as it is."""
    if getattr(value, "ndim", None) != 0:
        return value
    number, unit_text = value.item(), getattr(value, "attrs", {}).get("units")
    # the repr of a numpy or xarray scalar includes its type
    return number if unit_text is None else f"{number!r} {unit_text}"


def _unit_of_entry(old: Any) -> Unit:
    """Return the unit of an entry of a file; an `InputError` where it is an expression."""
    if isinstance(old, Mapping):
        return parse_unit(old["unit"]) if "unit" in old else parse_quantity(old.get("value")).unit
    return parse_quantity(old).unit


def _in_unit_of(old: Any, value: str) -> str:
    """Return a quantity in the unit of an entry, where it has none itself."""
    try:
        quantity, unit = parse_quantity(value), _unit_of_entry(old)
    except InputError:
        return value
    return f"{quantity.value!r} {unit.text}" if quantity.unit.text == NO_UNIT else value


def _replace_value(entry: str, old: Any, value: Any) -> Any:
    """Replace the value of an entry; a bare number keeps the entry's unit, a quantity must have its dimension."""
    text = old.get("value") if isinstance(old, Mapping) else old
    value = _without_array(value)
    try:
        pair = split_uncertainty(value)
    except InputError as error:
        raise ModelError(f"{entry} = {value!r}: {error}") from None
    if pair:
        kept_keys = (
            {key: item for key, item in old.items() if key not in ("unit", *SIZES)} if isinstance(old, Mapping) else {}
        )
        return kept_keys | {"value": _in_unit_of(old, pair[0]), "uncertainty": pair[1]}
    if not isinstance(text, str | int | float) or isinstance(text, bool) or not isinstance(value, str | int | float):
        return value
    try:
        unit = _unit_of_entry(old)
    except InputError:
        return value  # an expression, not a quantity
    if isinstance(value, str):
        try:
            quantity = parse_quantity(value)
        except InputError as error:
            raise ModelError(f"{entry}: {error}") from None
        if quantity.unit.dimension != unit.dimension:
            raise ModelError(f"{entry} = {value!r} has units '{quantity.unit.dimension}', needs '{unit.dimension}'")
    value_text = value if isinstance(value, str) else f"{value!r} {unit.text}"
    if not isinstance(old, Mapping):
        return value_text
    kept_keys = {key: item for key, item in old.items() if key != "unit"}
    kept_keys |= {key: f"{size!r} {unit.text}" for key in SIZES if isinstance(size := kept_keys.get(key), int | float)}
    return kept_keys | {"value": value_text}
