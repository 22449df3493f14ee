"""Dimensions and relations of a model file: how many elements, what they are called, which of them are linked."""

from __future__ import annotations

import keyword
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, Ledger, brief_repr
from xdynamics.model.csv_sheet import Sheet
from xdynamics.model.kinds import Source
from xdynamics.model.section import Section
from xdynamics.model.table_keys import check_keys
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Extent, Relation, Shapes
from xdynamics.shapes.extents import every_two

MOST_ELEMENTS, MOST_LINKS = 1_000_000, 20_000_000
LABEL = re.compile(r"[A-Za-z0-9_]{1,40}")
FIRST, SECOND = ENDS = ("first", "second")


def read_extent(value: Any, name: str, _: Source) -> Extent:
    """Read a dimension: a number of elements, or their labels.

    Raises
    ------
    InputError
        If it is neither, or has a label twice.
    """
    refuse_word(name)
    value = value.tolist() if hasattr(value, "tolist") else value  # of numpy
    if isinstance(value, int) and not isinstance(value, bool):
        if not 1 <= value <= MOST_ELEMENTS:
            raise InputError(f"has {value} elements, needs 1 to {MOST_ELEMENTS}")
        return Extent(name, value)
    if not isinstance(value, list | tuple) or not value or not all(isinstance(label, str) for label in value):
        raise InputError(f'is {brief_repr(value)}, needs a number of elements, or their labels: ["Sun", "Jupiter"]')
    for label in value:
        if not LABEL.fullmatch(label) or label.isdigit():
            raise InputError(
                f"has the label {label!r}; a label is made of letters, digits and underscores, 40 at most, and is no number"
            )
    if len(set(value)) < len(value):
        seen = set[str]()
        twice = next(label for label in value if label in seen or seen.add(label))  # type: ignore[func-returns-value]
        raise InputError(f"has the label '{twice}' twice; give each element its own")
    return Extent(name, len(value), tuple(value))


def refuse_word(name: str) -> None:
    """Refuse a name that expressions cannot read, before they fail to.

    Raises
    ------
    InputError
        If it is a word of Python.
    """
    if keyword.iskeyword(name):
        raise InputError(f"'{name}' is a word of Python; choose another name, like '{name}_'")


def written_extent(value: Extent, *_: Any) -> Any:
    """Return a dimension as it stands in TOML."""
    return list(value.labels) if value.labels else value.size


# links in use: of a model, of its statement, and of reading that, they are the same million
_MADE: WeakValueDictionary[tuple[Any, ...], Relation] = WeakValueDictionary()


@dataclass(frozen=True)
class Links:
    """A relation as it is declared; its attributes are the keys of `[relations]`."""

    of: str = ""
    neighbours: int = 0
    ring: bool = False
    source: str = ""
    target: str = ""
    table: str = ""
    csv: str = ""
    description: str = ""

    @property
    def table_columns(self) -> list[str]:
        """The names of the columns of its table; none without one."""
        return [cell.split("[")[0].strip() for cell in Sheet.from_text(self.table, self.csv).header] if self.csv else []

    def relation(self, name: str, extents: Mapping[str, Extent]) -> Relation:
        """Return the links.

        Raises
        ------
        InputError
            If a dimension is unknown, or the links are none, too many, twice, or of an element with itself.
        """
        dims = (self.of, self.of) if self.of else (self.source, self.target)
        between = (name, *(extents[dim] for dim in dims if dim in extents))
        if (self, *between) in _MADE:
            return _MADE[self, *between]
        for dim in dims:
            if dim not in extents:
                raise InputError(f"'{dim}' is no dimension; there are: {', '.join(extents) or 'none'}")
        source, target = extents[dims[0]], extents[dims[1]]
        if self.csv:
            first, second = self._table_pairs(source, target)
        elif self.neighbours:
            first, second = self._neighbour_pairs(source)
        else:
            first, second = self._all_pairs(source, target)
        if not len(first):
            raise InputError(f"has no link, and needs one or more: {self._no_link_cause(source)}")
        of_every_two = bool(self.of) and not self.csv and not self.neighbours
        relation = Relation(name, source.name, target.name, first, second, of_every_two)
        _MADE[self, *between] = self._latest[between] = relation
        return relation

    @cached_property
    def _latest(self) -> dict[tuple[Any, ...], Relation]:
        """The links of relations, cached by their declaration."""
        return {}

    def _no_link_cause(self, source: Extent) -> str:
        """Return why a relation has no links."""
        if self.csv:
            return f"table '{self.table}' has a header and no rows"
        few = "one element" if source.size == 1 else f"{source.size} elements"
        return f"'{source.name}' has {few}; leave the relation out"

    def _all_pairs(self, source: Extent, target: Extent) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return every two elements once, or every element of one dimension with every one of the other."""
        n, m = source.size, target.size
        count = n * (n - 1) // 2 if self.of else n * m
        if count > MOST_LINKS:
            raise InputError(f"has {count} links, {MOST_LINKS} at most; give those that matter as a table")
        if self.of:
            return every_two(n)
        return np.repeat(np.arange(n), m), np.tile(np.arange(m), n)

    def _neighbour_pairs(self, source: Extent) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return each element with the next ones."""
        n, count = source.size, self.neighbours
        if self.ring and n <= 2 * count:
            raise InputError(
                f"neighbours is {count} in a ring of {n} elements, in which links would be there twice; a ring of"
                f" {2 * count + 1} or more has them once"
            )
        if 1 < n <= count:
            raise InputError(f"neighbours is {count}, and '{source.name}' has {n} elements; write {n - 1} at most")
        if n * count > MOST_LINKS:
            raise InputError(
                f"neighbours is {count} of {n} elements, {n * count} links, and {MOST_LINKS} at most are made; write"
                f" {MOST_LINKS // n} at most"
            )
        if count == 1 and not self.ring:
            numbers = np.arange(n, dtype=np.int64)  # of a million, once
            return numbers[:-1], numbers[1:]
        first = np.repeat(np.arange(n, dtype=np.int64), count)
        second = first + np.tile(np.arange(1, count + 1, dtype=np.int64), n)
        in_range = second < n
        return (first, second % n) if self.ring else (first[in_range], second[in_range])

    def _table_pairs(self, source: Extent, target: Extent) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Read the columns `first` and `second` of the table."""
        sheet = Sheet.from_text(self.table, self.csv)
        bare = [cell.split("[")[0].strip() for cell in sheet.header]
        for end in ENDS:
            if end not in bare:
                raise InputError(
                    f"table '{self.table}' has no column '{end}' with an end of each link; it is {sheet.layout_text}"
                )
        first, second = (
            self._column_elements(sheet, bare.index(end), extent)
            for end, extent in zip(ENDS, (source, target), strict=True)
        )
        if source is target and (first == second).any():
            k = int((first == second).argmax())
            raise InputError(
                f"table '{self.table}', line {sheet.lines[k][0]}: links '{source.label(first[k])}' with itself; leave it out"
            )
        low, high = (np.minimum(first, second), np.maximum(first, second)) if self.of else (first, second)
        # each pair as one whole number, so that numbers are sorted and not rows
        _, earliest, number = np.unique(low * target.size + high, return_index=True, return_inverse=True)
        if len(earliest) < len(first):
            k = int((earliest[number] < np.arange(len(first))).argmax())
            line, earlier_line = (sheet.lines[row][0] for row in (k, earliest[number[k]]))
            raise InputError(
                f"table '{self.table}', line {line}: the link of line {earlier_line} is there again; leave it out"
            )
        return first, second

    def _column_elements(self, sheet: Sheet, column: int, extent: Extent) -> NDArray[np.int64]:
        """Read the elements at one end of each link."""
        if (elements := sheet.elements(column, extent)) is not None:
            return elements
        numbers = np.empty(len(sheet.lines), np.int64)
        for k, (line, cells) in enumerate(sheet.lines):
            if len(cells) <= column:
                raise InputError(
                    f"table '{self.table}', line {line}: it has {len(cells)} cells, the header {len(sheet.header)}"
                )
            text = cells[column].strip()
            try:
                numbers[k] = extent.number(int(text) if text.isdecimal() else text)
            except InputError as error:
                raise InputError(f"table '{self.table}', line {line}: {error}") from None
        return numbers


def related(extents: Mapping[str, Extent], relations: Mapping[str, Links], ledger: Ledger) -> Shapes:
    """Return dimensions and relations with their links; a relation that cannot be is noted."""
    made = {}
    for name, relation in relations.items():
        with ledger.entry(f"relation '{name}'"):
            made[name] = relation.relation(name, extents)
    return Shapes(extents, made)


def links_table(entry: Any, section: Section, name: str, source: Source) -> Any:
    """Return a relation's entry with the text of its table.

    Raises
    ------
    InputError
        If keys are missing, or exclude each other.
    """
    refuse_word(name)
    check_keys(entry, section.fixed_keys, ())
    if ("of" in entry) == ("from" in entry or "to" in entry) or ("from" in entry) != ("to" in entry):
        raise InputError('needs the dimension that it is of, of = "body", or two: from = "body" and to = "wall"')
    tabled = "table" in entry or "csv" in entry
    if not tabled and "from" in entry and entry["from"] == entry["to"]:
        raise InputError(
            f"links every element of '{entry['from']}' with itself too; of = \"{entry['from']}\" is every two once"
        )
    if "neighbours" in entry and (tabled or "of" not in entry):
        raise InputError("key 'neighbours' goes with 'of' alone")
    if entry.get("ring") and "neighbours" not in entry:
        raise InputError("key 'ring' needs 'neighbours'")
    if not tabled:
        return entry
    file = str(entry.get("table", f"{name}.csv"))
    return {**entry, "table": file, "csv": str(entry["csv"]) if "csv" in entry else source.access.read_table(file)}


def make_links(**values: Any) -> Links:
    """Make a relation of the values of its keys."""
    ends = {"source": values.pop("from", ""), "target": values.pop("to", "")}
    return Links(**values, **ends)
