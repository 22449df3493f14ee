"""A table as text with any separator and decimal mark, and the names and units of its columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import Any

from xdynamics.faults import InputError, Ledger
from xdynamics.units import Unit, parse_unit

SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas"}  # the first one that occurs in the header
COMMENTS = ("#", "%", "//")
MOST_FAULTS = 20  # of a table, listed in an error
SHOWN = 24  # characters of a cell that an error shows
LONGEST_HEADER = 10_000

# name [unit], name (unit), name / unit; the parentheses of u(name), u_common(name) belong to the name
_TITLES = tuple(
    re.compile(pattern)
    for pattern in (
        r"\s*(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]*)\]\s*",
        r"\s*(?P<name>u(?:_common)?\([^()]*\)|[^()]*[^()/\s])\s*\((?P<unit>[^()]*)\)\s*",
        r"\s*(?P<name>[^/]*?)\s*/\s*\(?(?P<unit>[^/\s(][^()]*?)\)?\s*",
    )
)
_PLAIN = re.compile(r"[\s0-9.eE+\-a-zA-Z]+", re.ASCII)  # no underscore, no digits of other alphabets
_GAPS = ("", "-", "--", "na", "n/a", "nan", "null", "none")
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?\s*")


@dataclass(frozen=True)
class Title:
    """The title of a column: ``thrust [N]``; `u(thrust)` and `u_common(thrust)` are uncertainties of `thrust`."""

    name: str
    unit: Unit


@dataclass(frozen=True)
class Sheet:
    """A table split into cells that are not yet read.

    Attributes
    ----------
    name : str
        Of its file.
    separator : str
    decimal : {".", ","}
    header : tuple of str
        As it was written.
    header_line : int
    lines : tuple of (int, list of str)
        Cells with the number of their line.
    """

    name: str
    separator: str
    decimal: str
    header: tuple[str, ...]
    header_line: int
    lines: tuple[tuple[int, list[str]], ...]

    @classmethod
    def of(cls, name: str, text: str) -> Sheet:
        """Split text into lines and cells, and detect separator and decimal mark.

        Raises
        ------
        InputError
            If it is empty, mixes decimal commas and points, or a cell is too long.
        """
        lines = [
            (n, one)
            for n, one in enumerate(normal(text).split("\n"), 1)
            if one.strip() and not one.lstrip().startswith(COMMENTS)
        ]
        if not lines:
            raise InputError(f"table '{name}' is empty; it needs a header like 'time [s],thrust [N]' and rows")
        number, first = lines[0]
        separator = next((one for one in SEPARATORS if one in first), ",")
        header = tuple(next(csv.reader([first[:LONGEST_HEADER]], delimiter=separator)))
        rows = tuple((n, _cells(name, n, one, separator)) for n, one in lines[1:])
        return cls(name, separator, _decimal(name, separator, rows), header, number, rows)

    @property
    def layout(self) -> str:
        """How the table was read, for messages."""
        return f"separated by {SEPARATORS[self.separator]}, columns {', '.join(shown(cell) for cell in self.header)}"

    def titles(self) -> tuple[Title, ...]:
        """Read names and units of the columns.

        Raises
        ------
        InputError
            With every column without a readable unit, and every name that occurs twice.
        """
        ledger = Ledger(f"table '{self.name}', line {self.header_line} ({self.layout})")
        columns = []
        for cell in self.header:
            with ledger.entry(f"column {shown(cell)}"):
                columns.append(title(cell))
        names = [one.name for one in columns]
        for one in sorted({name for name in names if names.count(name) > 1}):
            ledger.note(f"two columns are called {shown(one)}")
        ledger.raise_faults()
        return tuple(columns)

    def numbers(self, columns: Sequence[int], *, skip: bool = False) -> list[tuple[int, tuple[float, ...]]]:
        """Read the numbers of some columns, with the number of each line.

        Parameters
        ----------
        columns : sequence of int
        skip : bool
            Whether to leave out lines with a gap.

        Raises
        ------
        InputError
            With every line that cannot be read as finite numbers.
        """
        ledger = Ledger(f"table '{self.name}' ({self.layout})")
        rows: list[tuple[int, tuple[float, ...]]] = []
        for number, cells in self.lines:
            if len(ledger.faults) >= MOST_FAULTS:
                break
            if len(cells) != len(self.header):
                ledger.note(
                    f"line {number}, {shown(cells[0])} …, has {len(cells)} cells, the header {len(self.header)}"
                )
                continue
            selected = [cells[k] for k in columns]
            gaps = [k for k, cell in zip(columns, selected, strict=True) if cell.strip().lower() in _GAPS]
            if gaps and skip:
                continue
            if gaps:
                ledger.note(
                    f"line {number}: column {shown(self.header[gaps[0]])} has a gap; fill it, or leave such lines out"
                    ' with gaps = "skip"'
                )
                continue
            parsed = [self._number(cell) for cell in selected]
            if wrong := [cell for cell, value in zip(selected, parsed, strict=True) if value is None]:
                ledger.note(f"line {number}: {shown(wrong[0])} is no number")
                continue
            row = tuple(value for value in parsed if value is not None)
            if infinite := [cell for cell, value in zip(selected, row, strict=True) if not isfinite(value)]:
                ledger.note(f"line {number}: {shown(infinite[0])} is not finite")
                continue
            rows.append((number, row))
        ledger.raise_faults()
        return rows

    def _number(self, cell: str) -> float | None:
        if self.decimal == ",":
            cell = cell.replace(",", ".")
        try:
            value = float(cell)
        except ValueError:
            return None
        return value if _PLAIN.fullmatch(cell) else None


def _cells(name: str, number: int, line: str, separator: str) -> list[str]:
    """Split one line into cells; a quote that is not closed ends with the line."""
    try:
        return next(csv.reader([line], delimiter=separator))
    except csv.Error:  # the one thing that it refuses
        most = csv.field_size_limit()
        raise InputError(f"table '{name}', line {number}: a cell has over {most} characters, the limit") from None


def normal(text: str) -> str:
    """Return a text without a byte-order mark, with newlines as line ends."""
    return text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")


def title(cell: str) -> Title:
    """Read the name and the unit of a column.

    Raises
    ------
    InputError
        If it has no readable unit.

    Examples
    --------
    >>> [(one.name, one.unit.text) for one in map(title, ["force [mN]", "Time/ms", "u(x) (mm)"])]
    [('force', 'mN'), ('Time', 'ms'), ('u(x)', 'mm')]
    """
    for pattern in _TITLES:
        if match := pattern.fullmatch(cell):
            return Title(match["name"], parse_unit(match["unit"].strip() or "1"))
    raise InputError("it has no unit; write it like 'time [s]', of a pure number 'count [1]'")


def shown(cell: str) -> str:
    """Show the beginning of a cell: enough to find it, too little to disclose the contents of a file."""
    cell = cell.strip()
    return repr(cell if len(cell) <= SHOWN else cell[:SHOWN] + "…")


def _decimal(name: str, separator: str, rows: Sequence[tuple[int, list[str]]]) -> str:
    """Detect the decimal mark of a table; it is a point if commas separate the cells."""
    if separator == ",":
        return "."
    commas = next((n for n, cells in rows for cell in cells if _DECIMAL_COMMA.fullmatch(cell)), 0)
    points = next((n for n, cells in rows for cell in cells if "." in cell and "," not in cell), 0)
    if commas and points:
        raise InputError(
            f"table '{name}' has decimal commas (line {commas}) and points (line {points}); write one of them"
        )
    return "," if commas else "."


def written(columns: dict[str, Any]) -> str:
    """Write columns, by their titles, as CSV text that reads back as the same numbers.

    Raises
    ------
    InputError
        If their lengths differ, or they are not numbers.
    """
    import io

    import numpy as np

    try:
        values = {name: np.asarray(value, float).ravel() for name, value in columns.items()}
    except (TypeError, ValueError):
        raise InputError(
            f"columns {', '.join(map(shown, map(str, columns)))} hold something else than numbers"
        ) from None
    sizes = {value.size for value in values.values()}
    if len(sizes) != 1:
        raise InputError(f"columns have {', '.join(f'{value.size} ({name})' for name, value in values.items())} rows")
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(values)
    rows.writerows(
        tuple("" if value != value else repr(value) for value in row)
        for row in zip(*(value.tolist() for value in values.values()), strict=True)
    )
    return text.getvalue()
