"""A table as text with any separator and decimal mark: its cells, and the names and units of its columns.

Cells are numbers, titles with units, or words that are units. The columns of a large regular table, in which every line
has the same number of cells, without quotes and gaps, are read at once.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, Ledger, first_names
from xdynamics.runtime.lazy_imports import cached_property
from xdynamics.shapes import Extent
from xdynamics.units import NONE, TIME, Scale, Unit, parse_scale, parse_unit

LEAST = 1 << 12  # characters from which a table is large
_UNUSUAL = ('"', "#", "%", "//", "\n\n")  # quotes, comments, empty lines
_BLANK = re.compile(r"^[^\S\n]*$", re.MULTILINE)
_END = ord("\n")
_LONGEST = 40  # characters of a label


class PlainTable:
    """The lines of a table below its header, all with one number of cells.

    Parameters
    ----------
    content : bytes
        Lines as `from_text` finds them.
    separator : str
    rows : int
        How many lines there are.
    """

    def __init__(self, content: bytes, separator: str, rows: int) -> None:
        self.content, self.separator, self.rows = content, separator, rows

    @classmethod
    def from_text(cls, text: str, separator: str, columns: int) -> PlainTable | None:
        """Return a table; None if it is small, or its lines are not all of one form, and are to be read one by one."""
        if len(text) < LEAST or not text.isascii() or any(mark in text for mark in _UNUSUAL):
            return None
        if separator != "," and "," in text:  # which may be decimal marks
            return None
        text = text.rstrip("\n")
        if (columns == 1 or separator == "\t") and _BLANK.search(text):
            return None
        content = f"{text}\n".encode()
        letters = np.frombuffer(content, np.uint8)
        ends = np.flatnonzero((letters == _END) | (letters == ord(separator)))
        rows, remainder = divmod(ends.size, columns)
        if remainder:
            return None
        is_last = (letters[ends] == _END).reshape(rows, columns)
        longest = int(np.diff(ends[columns - 1 :: columns], prepend=-1).max())
        is_one = is_last[:, -1].all() and not is_last[:, :-1].any() and longest <= csv.field_size_limit()
        return cls(content, separator, rows) if is_one else None

    def columns(self, places: Sequence[int], kind: Any = float) -> NDArray[Any] | None:
        """Return columns as numbers, or as texts of a length, shape (rows, columns); None if a cell is none of that kind."""
        try:
            lines = io.BytesIO(self.content)
            table_columns = np.loadtxt(lines, kind, comments=None, delimiter=self.separator, usecols=places, ndmin=2)
        except ValueError:
            return None
        # loadtxt passes over lines that are blank, and rows would be of other lines
        return table_columns if len(table_columns) == self.rows else None

    def elements(self, column: int, extent: Extent) -> NDArray[np.int64] | None:
        """Return the elements that a column names, by their numbers, or by their labels where they have some."""
        if not extent.labels:
            numbers = None if b"+" in self.content else self.columns([column], np.int64)
            are_elements = numbers is not None and numbers.min() >= 0 and numbers.max() < extent.size
            return numbers[:, 0] if numbers is not None and are_elements else None
        texts = self.columns([column], f"S{_LONGEST + 1}")  # a longer one is no label
        labels, which = (None, None) if texts is None else np.unique(np.char.strip(texts[:, 0]), return_inverse=True)
        if labels is None or which is None or labels.size > extent.size:
            return None
        places = {label.encode(): number for number, label in enumerate(extent.labels)}
        label_numbers = np.array([places.get(label, -1) for label in labels.tolist()], np.int64)
        return label_numbers[which] if label_numbers.min() >= 0 else None


SEPARATORS = {"\t": "tabs", ";": "semicolons", ",": "commas"}  # the first one that occurs in the header
COMMENTS = ("#", "%", "//")
CLOCKS = ("time", "t")
MOST_FAULTS = 20  # of a table, listed in an error
SHOWN = 24  # characters of a cell that an error shows
SKIPPING = ', or leave such lines out with gaps = "skip"'  # which drives and measured data take
LONGEST_HEADER = 100_000  # characters: some thousand columns
OF_UNCERTAINTIES = ("u(", "u_common(")

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
# what loggers and spreadsheets write where there is no number
_GAPS = ("", "na", "n/a", "#n/a", "nan", "null", "none", "missing", "over", "overload", "ol", "#value!", "#div/0!", "?")
_STRUCK = re.compile(r"-+|\*+")
# groups of three digits, where the other mark is the decimal one: 1.000,5 and 1,000.5
_GROUPED = {
    mark: re.compile(rf"\s*[+-]?[0-9]{{1,3}}(?:\{other}[0-9]{{3}})+\{mark}[0-9]+\s*")
    for mark, other in ((",", "."), (".", ","))
}
_DECIMAL_COMMA = re.compile(r"\s*[+-]?[0-9]*,[0-9]+(?:[eE][+-]?[0-9]+)?\s*")


@dataclass(frozen=True)
class Title:
    """The title of a column: ``thrust [N]``; `u(thrust)` and `u_common(thrust)` are uncertainties of `thrust`."""

    name: str
    unit: Unit
    scale: Scale

    def number(self, value: float) -> float:
        """Return a number of the column in its unit; an offset, as of °C, is of values and not of their uncertainties."""
        return (self.scale.difference if self.name.startswith(OF_UNCERTAINTIES) else self.scale.value)(value)


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
    rows : PlainTable, or tuple of (int, list of str)
        What stands below; cells with the number of their line where it is no large table of one form.
    """

    name: str
    separator: str
    decimal: str
    header: tuple[str, ...]
    header_line: int
    rows: PlainTable | tuple[tuple[int, list[str]], ...]

    @classmethod
    def from_text(cls, name: str, text: str) -> Sheet:
        """Split text into lines and cells, and detect separator and decimal mark.

        Raises
        ------
        InputError
            If it is empty, mixes decimal commas and points, or a cell is too long.
        """
        text = normalise_newlines(text)
        lines = _content_lines(text)
        number, first, below = next(lines, (0, "", 0))
        if not first:
            raise InputError(f"table '{name}' is empty; it needs a header like 'time [s],thrust [N]' and rows")
        if len(first) > LONGEST_HEADER:
            raise InputError(
                f"table '{name}', line {number}: the header has {len(first)} characters, {LONGEST_HEADER} at most; shorten"
                " its titles, or leave out columns that are not read"
            )
        separator = next((separator for separator in SEPARATORS if separator in first), ",")
        written = next(csv.reader([first], delimiter=separator))
        header = tuple(written[: 1 + max((k for k, cell in enumerate(written) if cell.strip()), default=-1)])
        if table := PlainTable.from_text(text[below:], separator, len(written)):
            return cls(name, separator, ".", header, number, table)
        rows = tuple((n, _split_cells(name, n, line, separator)) for n, line, _ in lines)
        while len(rows) > 1 and _is_foot(rows[-1][1], rows[0][1]):
            rows = rows[:-1]
        return cls(name, separator, _decimal(name, separator, rows), header, number, rows)

    @cached_property
    def lines(self) -> tuple[tuple[int, list[str]], ...]:
        """Cells with the number of their line."""
        if not isinstance(self.rows, PlainTable):
            return self.rows
        texts = self.rows.content.decode().split("\n")[:-1]
        return tuple((n, line.split(self.separator)) for n, line in enumerate(texts, self.header_line + 1))

    @cached_property
    def layout_text(self) -> str:
        """How the table was read, for messages."""
        is_cut = any(cell.count("[") > cell.count("]") for cell in self.header)  # r[Sun, x] [m]
        quoted = f"; titles with {SEPARATORS[self.separator]} stand in quotes" if is_cut else ""
        return f"separated by {SEPARATORS[self.separator]}, columns {first_names(cell_excerpt(cell) for cell in self.header)}{quoted}"

    @property
    def has_titles(self) -> bool:
        """Whether its first line is one of words; an oscilloscope may write numbers alone."""
        return not all(_is_number_cell(cell) for cell in self.header)

    @cached_property
    def names(self) -> list[str]:
        """Names of the columns, whether they have units or not."""
        return [name_of_title(cell) for cell in self.header]

    def titles(self, places: Sequence[int] | None = None) -> tuple[Title, ...]:
        """Read names and units of some columns, or of all.

        Raises
        ------
        InputError
            With every one of them without a readable unit, and every name that another column has too; with the first
            lines of the file, and the keys that say how it is to be read.
        """
        ledger = Ledger(f"table '{self.name}', line {self.header_line} ({self.layout_text})")
        columns, names = [], self.names
        for k in range(len(self.header)) if places is None else places:
            with ledger.entry(f"column {cell_excerpt(self.header[k])}"):
                columns.append(title(self.header[k]))
                if names.count(columns[-1].name) > 1:
                    raise InputError(f"two columns are called {cell_excerpt(columns[-1].name)}")
        if not self.has_titles:
            example = ", ".join(f'"{word}"' for word in ("t [s]", "x [m]", "y [m]", "z [m]")[: len(self.header)])
            raise InputError(
                f"table '{self.name}' has no titles: line {self.header_line} has numbers alone,"
                f" {cell_excerpt(self.separator.join(self.header))}; give one for each of its {len(self.header)} columns, like"
                f" header = [{example}]"
            )
        if ledger.faults:
            ledger.note(self.first_lines_text)
        ledger.raise_faults()
        return tuple(columns)

    @property
    def first_lines_text(self) -> str:
        """The first lines, cut short, and the keys that say how a file is to be read."""
        first = [self.header, *(cells for _, cells in self.lines[:2])]
        lines = " / ".join(cell_excerpt(self.separator.join(cells)) for cells in first)
        return (
            f"it begins {lines}; how it is to be read is said by skip = 1 (lines before the header), header ="
            ' ["t [s]", "x [m]"], units = { t = "s", x = "m" } or decimal = ","'
        )

    def read_rows(self, columns: Sequence[int], *, skip: bool = False) -> list[tuple[int, tuple[float, ...]]]:
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
        ledger = Ledger(f"table '{self.name}' ({self.layout_text})")
        scales = [self._column_scale(k) for k in columns]
        rows: list[tuple[int, tuple[float, ...]]] = []
        for number, written_cells in self.lines:
            if len(ledger.faults) >= MOST_FAULTS:
                break
            further = any(written_cells[len(self.header) :])
            cells = written_cells if further else written_cells[: len(self.header)]
            if len(cells) != len(self.header):
                ledger.note(
                    f"line {number}, {cell_excerpt(cells[0])} …, has {len(cells)} cells, the header {len(self.header)}"
                )
                continue
            selected = [cells[k] for k in columns]
            gaps = [k for k, cell in zip(columns, selected, strict=True) if is_gap(cell)]
            if gaps and skip:
                continue
            if gaps:
                ledger.note(f"line {number}: column {cell_excerpt(self.header[gaps[0]])} has a gap; fill it{SKIPPING}")
                continue
            parsed = [self._cell_number(cell) for cell in selected]
            if wrong := [cell for cell, value in zip(selected, parsed, strict=True) if value is None]:
                ledger.note(f"line {number}: {cell_excerpt(wrong[0])} is no number")
                continue
            row_values = [value for value in parsed if value is not None]
            if infinite := [cell for cell, value in zip(selected, row_values, strict=True) if not isfinite(value)]:
                ledger.note(f"line {number}: {cell_excerpt(infinite[0])} is not finite")
                continue
            row = tuple(scale(value) for scale, value in zip(scales, row_values, strict=True))
            rows.append((number, row))
        ledger.raise_faults()
        return rows

    def columns(self, column_indices: Sequence[int], *, skip: bool = False) -> NDArray[np.float64]:
        """Read the numbers of some columns, shape (rows, columns): those of a large table at once.

        Parameters
        ----------
        column_indices : sequence of int
        skip : bool
            Whether to leave out lines with a gap.

        Raises
        ------
        InputError
            As `read_rows` does.
        """
        table_columns = self.rows.columns(column_indices) if isinstance(self.rows, PlainTable) else None
        if (
            table_columns is None or not np.isfinite(table_columns).all()
        ):  # which cell it is is told where each is read by itself
            return np.array([row for _, row in self.read_rows(column_indices, skip=skip)], float).reshape(
                -1, len(column_indices)
            )
        for k, column_index in enumerate(column_indices):
            scale = self._column_scale(column_index)
            if (scale(0.0), scale(1.0)) != (0.0, 1.0):  # rounded once, from exact numbers
                table_columns[:, k] = [scale(number) for number in table_columns[:, k].tolist()]
        return table_columns

    def elements(self, column: int, extent: Extent) -> NDArray[np.int64] | None:
        """Return the elements that a column of a large table names; None where they are to be read one by one."""
        return self.rows.elements(column, extent) if isinstance(self.rows, PlainTable) else None

    def _column_scale(self, column: int) -> Callable[[float], float]:
        """Return the value of a column's number in the column's unit; unchanged without a unit."""
        try:
            return title(self.header[column]).number
        except InputError:
            return lambda value: value

    def _cell_number(self, cell: str) -> float | None:
        if "," in cell and _GROUPED[self.decimal].fullmatch(cell):
            cell = cell.replace("." if self.decimal == "," else ",", "")
        return number_in_cell(cell.replace(",", ".") if self.decimal == "," else cell)


def _content_lines(text: str) -> Iterator[tuple[int, str, int]]:
    """Yield lines that are neither empty nor comments, with their numbers, and where the next one begins."""
    begin, number = 0, 0
    while begin <= len(text):
        end = text.find("\n", begin)
        end, number = len(text) if end < 0 else end, number + 1
        line, begin = text[begin:end], end + 1
        if line.strip() and not line.lstrip().startswith(COMMENTS):
            yield number, line, begin


def _split_cells(name: str, number: int, line: str, separator: str) -> list[str]:
    """Split one line into cells; a quote that is not closed ends with the line."""
    try:
        return next(csv.reader([line], delimiter=separator))
    except csv.Error:  # the one thing that it refuses
        cell_limit = csv.field_size_limit()
        raise InputError(f"table '{name}', line {number}: a cell has over {cell_limit} characters, the limit") from None


def normalise_newlines(text: str) -> str:
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
    >>> [(title.name, title.unit.text) for title in map(title, ["force [mN]", "Time/ms", "u(x) (mm)"])]
    [('force', 'mN'), ('Time', 'ms'), ('u(x)', 'mm')]
    """
    for pattern in _TITLES:
        if match := pattern.fullmatch(cell):
            scale = parse_scale(match["unit"].strip() or "1")
            return Title(match["name"], scale.unit, scale)
    raise InputError("it has no unit; write it like 'time [s]', of a pure number 'count [1]'")


def is_clock(cell: str) -> bool:
    """Whether the title of a column is that of times: `time` or `t`, in any case, but of `T` a time or pure number alone.

    Examples
    --------
    >>> [is_clock(cell) for cell in ("Time (s)", "t [ms]", "TIME", "T [s]", "T [K]", "clock [s]")]
    [True, True, True, True, False, False]
    """
    name = name_of_title(cell)
    if name != "T":
        return name.lower() in CLOCKS
    with suppress(InputError):
        return title(cell).unit.dimension in (TIME, NONE)
    return True  # without a unit it may be either


def clocks_of(header: Iterable[str]) -> list[str]:
    """Return the names of the columns of times among titles, the likeliest first."""
    names = [name_of_title(cell) for cell in header if is_clock(cell)]
    return sorted(names, key=lambda name: (name == "T", CLOCKS.index(name.lower())))


def name_of_title(cell: str) -> str:
    """Return the name of a column, whether its title has a readable unit or not.

    Examples
    --------
    >>> [name_of_title(cell) for cell in ("u(x) (mm)", "light (lx)", "note", "Time/ms")]
    ['u(x)', 'light', 'note', 'Time']
    """
    return next((match["name"] for pattern in _TITLES if (match := pattern.fullmatch(cell))), cell.strip())


def number_in_cell(cell: str) -> float | None:
    """Return the number that a cell with a decimal point is, None if it is none."""
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if _PLAIN.fullmatch(cell) else None


def is_gap(cell: str) -> bool:
    """Whether a cell says that there is no number: empty, or ``NA``, ``---``, ``***``, ``#N/A``, ``OVER`` and their like."""
    word = cell.strip().lower()
    return word in _GAPS or _STRUCK.fullmatch(word) is not None


def cell_excerpt(cell: str) -> str:
    """Show the beginning of a cell: enough to find it, too little to disclose the contents of a file."""
    cell = cell.strip()
    return repr(cell if len(cell) <= SHOWN else cell[:SHOWN] + "…")


def _is_foot(cells: Sequence[str], first_cells: Sequence[str]) -> bool:
    """Whether a line is words below a table of numbers, whose first line is given."""
    of_numbers = all(is_gap(cell) or _is_number_cell(cell) for cell in first_cells)
    is_words = re.search("[A-Za-z]{2}", cells[0]) is not None and not any(map(_is_number_cell, cells))
    return of_numbers and is_words and len(cells) < len(first_cells)


def _is_number_cell(cell: str) -> bool:
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _decimal(name: str, separator: str, rows: Sequence[tuple[int, list[str]]]) -> str:
    """Detect the decimal mark of a table; it is a point if commas separate the cells."""
    if separator == ",":
        return "."
    commas = next((n for n, cells in rows for cell in cells if _DECIMAL_COMMA.fullmatch(cell)), 0)
    points = next((n for n, cells in rows for cell in cells if "." in cell and "," not in cell), 0)
    commas = commas or next((n for n, cells in rows for cell in cells if _GROUPED[","].fullmatch(cell)), 0)
    if commas and points:
        raise InputError(
            f"table '{name}' has decimal commas (line {commas}) and points (line {points}); write one of them"
        )
    return "," if commas else "."


def csv_text(columns: dict[str, Any], labels: Collection[str] = ()) -> str:
    """Write columns, by their titles, as CSV text that reads back as equal numbers; labels are written as texts.

    Raises
    ------
    InputError
        If their lengths differ, or they are not numbers.
    """
    import io

    try:
        values = {name: np.asarray(value, str if name in labels else float).ravel() for name, value in columns.items()}
    except (TypeError, ValueError):
        raise InputError(
            f"columns {', '.join(map(cell_excerpt, map(str, columns)))} hold something else than numbers"
        ) from None
    sizes = {value.size for value in values.values()}
    if len(sizes) != 1:
        raise InputError(f"columns have {', '.join(f'{value.size} ({name})' for name, value in values.items())} rows")
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(values)
    rows.writerows(
        # repr is the shortest text that reads back as the same float; nan, not equal to itself, is an empty cell
        tuple(value if isinstance(value, str) else "" if value != value else repr(value) for value in row)
        for row in zip(*(value.tolist() for value in values.values()), strict=True)
    )
    return text.getvalue()


@dataclass(frozen=True)
class Cells:
    """A table in cells: titles, rows of texts, and the kind of its file."""

    kind: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self, name: str) -> str:
        """Write the cells as CSV, with a comment that states their file and instrument."""
        buffer = io.StringIO()
        rows = csv.writer(buffer, lineterminator="\n")
        rows.writerow(self.header)
        rows.writerows(self.rows)
        return f"# {name}, {self.kind}\n{buffer.getvalue()}"


def cells_of(line: str) -> list[str]:
    """Split a line by the separator that it has; by spaces where it has none.

    Raises
    ------
    InputError
        If a cell is longer than the limit.
    """
    separator = next((separator for separator in SEPARATORS if separator in line), "")
    try:
        cells = next(csv.reader([line], delimiter=separator)) if separator else line.split()
    except csv.Error:
        raise InputError(
            f"a cell of the line {cell_excerpt(line)} has over {csv.field_size_limit()} characters, the limit"
        ) from None
    return [cell.strip() for cell in cells]


def number_cells(line: str, decimal: str) -> list[str]:
    """Return the cells of a line of numbers with decimal points, without empty ones at its end; none if it is no such line."""
    cells = cells_of(line)
    while cells and not cells[-1]:
        cells.pop()
    comma = decimal == "," or (not decimal and ";" in line) or (not decimal and "\t" in line and "." not in line)
    cells = [cell.replace(",", ".") if comma else cell for cell in cells]
    good = any(cells) and all(is_gap(cell) or number_in_cell(cell) is not None for cell in cells)
    good = good and not all(map(is_gap, cells))
    return cells if good else []


def first_numbers(lines: Sequence[str], decimal: str) -> int:
    """Return the number of the first line of numbers that another one with as many cells follows."""
    for k in range(min(len(lines) - 1, 200)):
        cells, next_cells = number_cells(lines[k], decimal), number_cells(lines[k + 1], decimal)
        if cells and len(cells) == len(next_cells):
            return k
    return -1


def is_table(line: str) -> bool:
    """Whether a line is a header with a unit in it already."""
    return any(has_unit(cell) for cell in cells_of(line))


def has_unit(cell: str) -> bool:
    """Whether a cell is a title with a unit."""
    try:
        title(cell)
    except InputError:
        return False
    return True


def unit_word(cell: str) -> str:
    """Return the unit that a cell is, as a symbol or a word, ``(ms)``, ``Volt``; empty if it is none."""
    bare = cell.strip().strip("()[]").strip()
    for word in (bare, re.sub("s$", "", bare.lower()) if len(bare) > 2 else bare):
        try:
            return parse_unit(word).text if word else ""
        except InputError:
            continue
    return ""
