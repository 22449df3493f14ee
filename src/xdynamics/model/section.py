"""A section of a model file, declared once: its keys, how an entry is read and written, and the help on it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from xdynamics.model.kinds import TEXT, Kind, Source
from xdynamics.model.table_keys import check_keys
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.units import Dimension, Unit, parse_unit

NEEDED = "needed"
_OF_KIND = object()


@dataclass(frozen=True)
class Key:
    """One key of a section's entries, or of the section itself.

    Attributes
    ----------
    name : str
        In angle brackets if it stands for any name of that kind.
    kind : Kind
        Of its value: how that is read and written, and what the help says of it.
    about : str
    default : str
        What applies if the key is absent; `NEEDED` if it is required.
    field : str
        The attribute of the part that it is written from, if that has another name.
    omitted : object
        The value that is not written, if that is another than the kind's.
    is_rewritten : bool
        Whether it is written again; of a key that says how a file is read, the text that was read is.
    """

    name: str
    kind: Kind
    about: str
    default: str = ""
    field: str = ""
    omitted: Any = _OF_KIND
    is_rewritten: bool = True

    @property
    def takes(self) -> str:
        """How its value is described in the help."""
        return self.kind.takes

    @cached_property
    def value_of(self) -> Callable[[Any], Any]:
        """The attribute of a part that it is written from, as a function."""
        return attrgetter(self.field or self.name)

    @cached_property
    def is_open(self) -> bool:
        """Whether it stands for any name."""
        return self.name.startswith("<")

    def must_write(self, value: Any) -> bool:
        """Whether a value is to be written."""
        omitted = self.kind.omitted if self.omitted is _OF_KIND else self.omitted
        return self.default == NEEDED or not bool(value == omitted)


DESCRIPTION = Key("description", TEXT, "what it is, for people; it goes into the record", "none")


@dataclass(frozen=True)
class Section:
    """One section of a model file.

    Attributes
    ----------
    about : str
    entry : str
        What an entry is called, in a section of named entries; empty if the section itself has the keys.
    keys : tuple of Key
        In the order in which they are written.
    example : str
        TOML that uses every key.
    short : str
        What may be written instead of an entry's table.
    make : callable, optional
        The part of a model that an entry is, or a function that returns one, from the values of its keys. A section
        without it is read and written as a whole, by `reading` and `toml`.
    field : str
        The attribute of the statement that holds what was read, if that has another name than the section.
    brief : str
        The key whose value that is.
    full : callable of (entry, Section, name, Source), optional
        Returns the table that an entry stands for, if it is one in another form.
    short_form : callable of one part, optional
        Returns what stands in the place of an entry's table; None if nothing does.
    own_tables : bool
        Whether every entry is written as a table of its own.
    """

    about: str
    entry: str
    keys: tuple[Key, ...]
    example: str
    short: str = ""
    make: Callable[..., Any] | None = None
    field: str = ""
    brief: str = ""
    full: Callable[[Any, Section, str, Source], Any] | None = None
    short_form: Callable[[Any], Any] | None = None
    own_tables: bool = False

    @cached_property
    def fixed_keys(self) -> tuple[str, ...]:
        """The keys with a fixed name."""
        return tuple(key.name for key in self.keys if not key.is_open)

    @cached_property
    def required_keys(self) -> tuple[str, ...]:
        """The keys that are required."""
        return tuple(key.name for key in self.keys if key.default == NEEDED and not key.is_open)

    def dimension(self, key: str) -> Dimension:
        """Return the dimension that the values of a key have, which is declared with one unit."""
        kind = next(entry.kind for entry in self.keys if entry.name == key)
        return parse_unit(kind.unit).dimension

    @cached_property
    def value_kind(self) -> Kind | None:
        """The kind of entries that have no keys, but are a value each."""
        return self.keys[0].kind if len(self.keys) == 1 and self.keys[0].is_open else None

    def read(self, name: str, entry: Any, source: Source) -> Any:
        """Read an entry, or the section itself.

        Raises
        ------
        InputError
            Naming the key that is wrong.
        """
        if self.value_kind is not None:
            return self.value_kind.read(entry, name, source)
        if self.full is not None:
            entry = self.full(entry, self, name, source)
        elif self.brief and not isinstance(entry, Mapping):
            entry = {self.brief: entry}
        open_key = next((key for key in self.keys if key.is_open), None)
        if open_key is None or not isinstance(entry, Mapping):
            check_keys(entry, self.fixed_keys, self.required_keys)
        values = {key.name: key.kind.read(entry[key.name], key.name, source) for key in self.keys if key.name in entry}
        if open_key is not None:
            open_entries = {key: value for key, value in entry.items() if key not in self.fixed_keys}
            values[open_key.field or open_key.name] = {
                key: open_key.kind.read(value, key, source) for key, value in open_entries.items()
            }
        return values if self.make is None else self.make(**values)

    def write(self, part: Any, time: Unit) -> Any:
        """Return the keys of an entry with their values as in TOML, or its short form."""
        if self.value_kind is not None:
            return self.value_kind.write(part, time)
        if self.short_form is not None and (brief := self.short_form(part)) is not None:
            return brief
        body: dict[str, Any] = {}
        for key in self.keys:
            if not key.is_rewritten:
                continue
            value = key.value_of(part)
            if key.is_open:
                body |= {name: key.kind.write(item, time) for name, item in value.items()}
            elif key.must_write(value):
                body[key.name] = key.kind.write(value, time)
        return body
