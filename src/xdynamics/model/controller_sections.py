"""What stands inside a controller of a model file: its outputs and its states, each with keys of their own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from xdynamics.faults import InputError, brief_repr
from xdynamics.model.kinds import EXPRESSION, LIMIT, QUANTITY, UNIT, Kind, Source
from xdynamics.model.parts import ControllerState, Output
from xdynamics.model.section import DESCRIPTION, NEEDED, Key, Section
from xdynamics.units import Unit

OUTPUT = Section(
    "what a controller puts out: it holds between ticks",
    "output",
    (
        Key("unit", UNIT, "of the output", NEEDED),
        Key("start", QUANTITY, "what holds before the first tick takes effect", NEEDED),
        Key(
            "value",
            EXPRESSION.with_unit("that unit"),
            "what it is set to at a tick, from what holds just before",
            NEEDED,
        ),
        Key("minimum", LIMIT.with_unit("that unit"), "what it is limited to from below", "none"),
        Key("maximum", LIMIT.with_unit("that unit"), "what it is limited to from above", "none"),
        DESCRIPTION,
    ),
    "",
    make=Output,
)
MEMORY = Section(
    "what a controller remembers from tick to tick",
    "state",
    (
        Key("unit", UNIT, "of the state", NEEDED),
        Key("start", QUANTITY, "what holds before the first tick", NEEDED),
        Key(
            "next",
            EXPRESSION.with_unit("that unit"),
            "what it is set to at a tick, from what holds just before",
            NEEDED,
        ),
        DESCRIPTION,
    ),
    "",
    make=ControllerState,
)


def entries_of(section: Section) -> Kind:
    """Return the kind of values that are a table of entries, each with the keys of a section."""
    keys_text = ", ".join(f"{key.name}{'' if key.default == NEEDED else ' (optional)'}" for key in section.keys)

    def read_entries(value: Any, key: str, source: Source) -> dict[str, Any]:
        if not isinstance(value, Mapping):
            raise InputError(f"{key} is {brief_repr(value)}, needs a table of names, each with {keys_text}")
        entries = {}
        for name, entry in value.items():
            try:
                entries[str(name)] = section.read(str(name), entry, source)
            except InputError as error:
                raise InputError(f"{section.entry} '{name}': {error}") from None
        return entries

    def write_entries(parts: Mapping[str, Any], time: Unit) -> dict[str, Any]:
        return {name: section.write(part, time) for name, part in parts.items()}

    return Kind(f"table of {section.entry}s, each with {keys_text}", read_entries, write_entries, {})
