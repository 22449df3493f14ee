"""Files of instruments as tables: phones, loggers, video tracking, oscilloscopes, rocket motors.

A file that is already a table with units in its header is left as it is. What else is recognised, by its own lines:

========== ==========================================================================================================
Vernier    Titles begin with the run, ``Data Set 1:Time(s)`` or ``Latest: Time (s)`` (exports of Graphical Analysis and
           Logger Pro); the first run is taken.
Tektronix  TDS: five cells a line, of which the first two say how it was recorded (``Record Length``, ``Sample Interval``,
           ``Vertical Units``) and the last two are time and value. MSO, DPO, MDO: such lines first (``Horizontal Units,s``,
           ``Vertical Units,V``), then the header ``TIME,CH1,CH2``.
Siglent    Lines ``Record Length,Analog:7000``, ``Vertical Units,CH1:V``, or ``Source,CH1`` alone, then the units as the
           header, ``Second,Volt``.
Rigol      DS1000Z: ``X,CH1,Start,Increment``, below it ``Sequence,Volt,-1e-3,1e-6``: times are start and increment.
           DS1000E: ``Time,X(CH1)``, ``Second,Volt``. MSO5000, DHO: ``Time(s),CH1(V),t0 = -5e-07s, tInc = 4e-10s``.
RASP       ``.eng``, thrust of a rocket motor: comments from semicolons, seven words on the motor, then seconds and newtons;
           the first point (0, 0) is not written (https://www.thrustcurve.org/info/raspformat.html).
others     Lines before a header, and units in a line of their own below the names: ``Time,Channel A``, ``(ms),(V)``. So are
           Tracker's, a line with the name of the track and ``t  x  y``, whose units are said by the key `units`.
========== ==========================================================================================================

phyphox writes a table with units already: ``"Time (s)";"Acceleration x (m/s^2)"``, with commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import (
    COMMENTS,
    LONGEST_HEADER,
    SEPARATORS,
    name_of_title,
    normal,
    number_of,
    shown,
    title,
)
from xdynamics.units import SECONDS, parse_quantity, parse_scale, parse_unit

KEYS = ("skip", "header", "units", "time_zero", "decimal")
COLUMNS = "columns"  # of `compare` and `fit`; a drive has a name of its own, and `column`
FIRST, TIME = "first", "time [s]"
CLOCKS = ("time", "t")

_RUN = re.compile(r"((?:Data Set|Run) \d+|Latest)\s*:\s*(.*)", re.IGNORECASE)
_CHANNEL = re.compile(r"\s*([A-Za-z]+[0-9]+)\s*:?\s*\(?([A-Za-z]*)\)?\s*")
_START, _STEP = (re.compile(rf"{name}\s*=\s*([-+0-9.eE]+)\s*s?", re.IGNORECASE) for name in ("t0", "tInc"))


@dataclass(frozen=True)
class Reading:
    """How a file is read that does not say it: the keys of a drive, of `compare` and of `fit`.

    Attributes
    ----------
    skip : int
        Lines before the header.
    header : tuple of str
        Titles with units in the place of the file's own, ``("t [s]", "x [mm]")``.
    units : mapping of str to str
        Units of columns whose titles have none, by their names.
    time_zero : str
        What the column of times is counted from: a time, or ``"first"``, its first number.
    decimal : {"", ".", ","}
        Decimal mark; detected if empty.
    columns : mapping of str to str
        Names of the model, by the names that the file has: ``{"x": "Position"}``; `u(x)` follows.
    """

    skip: int = 0
    header: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    time_zero: str = ""
    decimal: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def of(cls, keys: Mapping[str, Any]) -> Reading:
        """Check the keys.

        Raises
        ------
        InputError
            Naming the one that is wrong.
        """
        skip, header, units = keys.get("skip", 0), keys.get("header", ()), keys.get("units", {})
        if unknown := [key for key in keys if key not in (*KEYS, COLUMNS)]:
            raise InputError(f"'{unknown[0]}' does not say how a file is read; there are {', '.join((*KEYS, COLUMNS))}")
        if isinstance(skip, bool) or not isinstance(skip, int) or skip < 0:
            raise InputError(f"skip is {skip!r}, needs the number of lines before the header")
        header = next(csv.reader([header])) if isinstance(header, str) else header
        if not isinstance(header, list | tuple) or not all(isinstance(title, str) for title in header):
            raise InputError(f'header is {header!r}, needs titles with units, ["t [s]", "x [mm]"]')
        if not isinstance(units, Mapping) or not all(isinstance(unit, str) for unit in units.values()):
            raise InputError(f'units is {units!r}, needs a table of units by column, {{ t = "s", x = "mm" }}')
        for name, unit in units.items():
            _checked(f"units: column '{name}'", lambda unit=unit: parse_scale(unit))  # type: ignore[misc]
        zero, decimal = keys.get("time_zero", ""), keys.get("decimal", "")
        if zero and zero != FIRST:
            _checked("time_zero", lambda: parse_quantity(zero))
        if decimal not in ("", ".", ","):
            raise InputError(f"decimal is {decimal!r}, needs '.' or ','")
        columns = keys.get(COLUMNS, {})
        if not isinstance(columns, Mapping) or not all(isinstance(name, str) for name in columns.values()):
            raise InputError(
                f'columns is {columns!r}, needs names of the file by those of the model, {{ x = "Position" }}'
            )
        return cls(skip, tuple(header), dict(units), str(zero), str(decimal), dict(columns))


AS_IT_IS = Reading()


@dataclass(frozen=True)
class Cells:
    """A table in cells: titles, rows of texts, and what kind of file they are from."""

    kind: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]

    def text(self, name: str) -> str:
        """Write it as CSV, with a comment that says where it is from."""
        written = io.StringIO()
        rows = csv.writer(written, lineterminator="\n")
        rows.writerow(self.header)
        rows.writerows(self.rows)
        return f"# {name}, {self.kind}\n{written.getvalue()}"


def as_table(name: str, text: str, reading: Reading = AS_IT_IS) -> str:
    r"""Return the text of a file as that of a table with units in its header; one that is such a table is unchanged.

    Raises
    ------
    InputError
        If the keys do not fit the file; with its first lines.

    Examples
    --------
    >>> print(as_table("c6.eng", "; Estes\nC6 18 70 0-3-5-7 0.0108 0.0231 E\n0.2 14.0\n1.8 0\n"))
    # c6.eng, thrust of the motor C6 by E, as RASP has it
    time [s],thrust [N]
    0,0
    0.2,14.0
    1.8,0
    <BLANKLINE>
    """
    lines = [line for line in normal(text).split("\n")[reading.skip :] if line.strip(" \t,;")]
    if not lines:
        raise InputError(f"table '{name}' has no lines after the first {reading.skip}, which skip leaves out")
    grid: Cells | None = None
    first = next((line for line in lines if not line.lstrip().startswith(COMMENTS)), "")[:LONGEST_HEADER]
    ready = _is_table(first) and not any(form.search(first) for form in (_RUN, _STEP))
    if ready and reading == AS_IT_IS:
        return text
    if reading.header:
        grid = _titled(name, lines, reading)
    elif not ready:
        known: Callable[[list[str], str], Cells | None]
        for known in (_rasp, _vernier, _tds, _rigol, _preambled):
            if (grid := known(lines, reading.decimal)) is not None:
                break
    if reading == AS_IT_IS:
        return text if grid is None else grid.text(name)
    grid = grid or _split(lines, reading)
    return _counted(name, _renamed(name, _with_units(name, grid, reading), reading), reading).text(name)


def _checked(what: str, make: Callable[[], Any]) -> Any:
    try:
        return make()
    except InputError as error:
        raise InputError(f"{what}: {error}") from None


def _cells(line: str) -> list[str]:
    """Split a line by the separator that it has; by spaces where it has none."""
    separator = next((separator for separator in SEPARATORS if separator in line), "")
    try:
        cells = next(csv.reader([line], delimiter=separator)) if separator else line.split()
    except csv.Error:
        raise InputError(
            f"a cell of the line {shown(line)} has over {csv.field_size_limit()} characters, the limit"
        ) from None
    return [cell.strip() for cell in cells]


def _numbers(line: str, decimal: str) -> list[str]:
    """Return the cells of a line of numbers with decimal points, without empty ones at its end; none if it is no such line."""
    cells = _cells(line)
    while cells and not cells[-1]:
        cells.pop()
    comma = decimal == "," or (not decimal and ";" in line) or (not decimal and "\t" in line and "." not in line)
    cells = [cell.replace(",", ".") if comma else cell for cell in cells]
    good = any(cells) and all(not cell or number_of(cell) is not None for cell in cells)
    return cells if good else []


def _first_numbers(lines: Sequence[str], decimal: str) -> int:
    """Return the number of the first line of numbers that another one with as many cells follows."""
    for k in range(min(len(lines) - 1, 200)):
        one, other = _numbers(lines[k], decimal), _numbers(lines[k + 1], decimal)
        if one and len(one) == len(other):
            return k
    return -1


def _is_table(line: str) -> bool:
    """Whether a line is a header with a unit in it already."""
    return any(_has_unit(cell) for cell in _cells(line))


def _has_unit(cell: str) -> bool:
    try:
        title(cell)
    except InputError:
        return False
    return True


def _word(cell: str) -> str:
    """Return the unit that a cell is, as a symbol or a word, ``(ms)``, ``Volt``; empty if it is none."""
    bare = cell.strip().strip("()[]").strip()
    for word in (bare, re.sub("s$", "", bare.lower()) if len(bare) > 2 else bare):
        try:
            return parse_unit(word).text if word else ""
        except InputError:
            continue
    return ""


def _rasp(lines: list[str], _: str) -> Cells | None:
    entries = [line for line in lines if not line.lstrip().startswith(";")]
    words = entries[0].split() if entries else []
    if len(words) < 7 or any(number_of(words[k]) is None for k in (1, 2, 4, 5)) or "," in entries[0]:
        return None
    points = [entry.split(";")[0].split() for entry in entries[1:]]
    if motor := next((point for point in points if len(point) >= 7), None):
        raise InputError(f"holds several motors, {words[0]} and {motor[0]}; keep the lines of one")
    if any(len(point) != 2 or None in map(number_of, point) for point in points):
        return None
    start = [] if not points or number_of(points[0][0]) == 0 else [("0", "0")]
    rows = (*start, *((time, thrust) for time, thrust in points))
    return Cells(f"thrust of the motor {words[0]} by {' '.join(words[6:])}, as RASP has it", (TIME, "thrust [N]"), rows)


def _vernier(lines: list[str], decimal: str) -> Cells | None:
    titles = [_RUN.fullmatch(cell) for cell in _cells(lines[0])]
    first = titles[0]
    if first is None:
        return None
    places = [k for k, title in enumerate(titles) if title and title[1] == first[1]]
    rows = [_cells(line) for line in lines[1:]]
    comma = decimal == "," or (not decimal and ";" in lines[0])
    taken = [
        tuple(row[k].replace(",", ".") if comma else row[k] for k in places) for row in rows if len(row) > max(places)
    ]
    kind = f"columns of '{first[1]}', as Vernier's programs export them"
    return Cells(
        kind,
        tuple(title[2] for title in titles if title and title[1] == first[1]),
        tuple(row for row in taken if any(row)),
    )


def _tds(lines: list[str], _: str) -> Cells | None:
    first = _cells(lines[0])
    if first[0] != "Record Length" or len(first) < 5 or None in map(number_of, first[3:5]):
        return None
    rows = [_cells(line) for line in lines]
    said = {row[0]: row[1] for row in rows if row[0]}
    header = (
        f"time [{said.get('Horizontal Units') or SECONDS.text}]",
        f"{said.get('Source') or 'value'} [{said.get('Vertical Units') or 'V'}]",
    )
    return Cells(
        "a record of a Tektronix TDS", header, tuple((row[3], row[4]) for row in rows if len(row) > 4 and row[4])
    )


def _rigol(lines: list[str], decimal: str) -> Cells | None:
    cells = [cell for cell in _cells(lines[0]) if cell]
    if [*map(str.lower, cells[:1]), *map(str.lower, cells[-2:])] == ["x", "start", "increment"] and len(lines) > 1:
        below = _cells(lines[1])
        count = len(cells) - 3
        start, step = (number_of(cell) for cell in below[count + 1 : count + 3])
        titles = [f"{name} [{_word(unit) or 'V'}]" for name, unit in zip(cells[1 : count + 1], below[1:], strict=False)]
        rows = [_numbers(line, decimal) for line in lines[2:]]
        return _stepped("a record of a Rigol oscilloscope", titles, [row[1 : count + 1] for row in rows], start, step)
    start, step = ((match := form.search(lines[0])) and number_of(match[1]) for form in (_START, _STEP))
    if start is None or step is None:
        return None
    names = [cell for cell in cells if not (_START.search(cell) or _STEP.search(cell))]
    timed = names[0].lower().startswith("time")
    titles = [
        f"{match[1]} [{_word(match[2]) or 'V'}]" if (match := _CHANNEL.fullmatch(name)) else name
        for name in names[timed:]
    ]
    rows = [_cells(line) for line in lines[1:]]
    if timed and rows and number_of(rows[0][0]) is not None:
        return Cells(
            "a record of a Rigol oscilloscope", (TIME, *titles), tuple(tuple(row[: 1 + len(titles)]) for row in rows)
        )
    rows = [row[timed : timed + len(titles)] for row in rows]
    return _stepped("a record of a Rigol oscilloscope", titles, rows, start, step)


def _stepped(kind: str, titles: Sequence[str], rows: Sequence[Sequence[str]], start: Any, step: Any) -> Cells:
    """Return rows with their times: from a start on, a step apart."""
    if start is None or not step:
        raise InputError(f'is {kind} without its start and increment; give header = ["t [s]", …] and skip')
    begin, width = Fraction(repr(start)), Fraction(repr(step))
    times = [repr(float(begin + k * width)) for k in range(len(rows))]
    return Cells(kind, (TIME, *titles), tuple((time, *row) for time, row in zip(times, rows, strict=True)))


def _preambled(lines: list[str], decimal: str) -> Cells | None:
    """Read lines before a header, units in a line of their own, and the units of oscilloscopes' preambles."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    begin = _first_numbers(lines, decimal)
    if begin < 1:
        return None
    count = len(_numbers(lines[begin], decimal))
    header, above = _cells(lines[begin - 1])[:count], lines[: begin - 1]
    if len(header) < count:
        return None
    said = {row[0].lower(): row[1:] for row in map(_cells, above) if row}
    units = [_word(cell) for cell in header]
    if units[0] and "second" in header[0].lower():
        header, units = _of_channels(units, said), [""] * count
    elif all(units) and above and len(names := _cells(above[-1])[:count]) == count:
        header, units = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)], [""] * count
        above = above[:-1]
    elif "vertical units" in said:
        header = _of_preamble(header, said)
    elif not above:
        return None
    kind = f"lines before its header left out: {len(above)}" if above else "names and units in two lines"
    rows = (_numbers(line, decimal) for line in lines[begin:])
    return Cells(kind, tuple(header), tuple(tuple(row) for row in rows if row))


def _of_channels(units: Sequence[str], said: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the titles of columns whose header is words for units, ``Second,Volt``: channels are named above it."""
    named = [match for cell in said.get("vertical units", ()) if (match := _CHANNEL.fullmatch(cell))]
    sources = [cell for cell in (*said.get("source", ()), *said.get("time", ())) if cell] or [
        title[1] for title in named
    ]
    sources = [match[1] if (match := re.search(r"\((\w+)\)", cell)) else cell for cell in sources]
    titles = [f"time [{units[0]}]"]
    for k, unit in enumerate(units[1:]):
        name = sources[k] if k < len(sources) else "value" if len(units) == 2 else f"value{k + 1}"
        titles.append(f"{name} [{unit or (named[k][2] if k < len(named) else '') or 'V'}]")
    return titles


def _of_preamble(header: Sequence[str], said: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the titles of columns whose units are said in the lines above, the same for all or one for each."""
    vertical = [cell for cell in said["vertical units"] if cell] or ["V"]
    horizontal = next((cell for cell in said.get("horizontal units", ()) if cell), SECONDS.text)
    of = [vertical[min(k, len(vertical) - 1)] for k in range(len(header) - 1)]
    return [f"{name} [{unit}]" for name, unit in zip(header, [horizontal, *of], strict=True)]


def _titled(name: str, lines: list[str], reading: Reading) -> Cells:
    """Read the numbers of a file below the titles that are said."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    begin = _first_numbers(lines, reading.decimal)
    if begin < 0:
        raise InputError(
            f"table '{name}' has no two lines of as many numbers below each other; it begins {shown(lines[0])}"
        )
    rows = tuple(tuple(row) for line in lines[begin:] if (row := _numbers(line, reading.decimal)))
    if len(rows[0]) != len(reading.header):
        raise InputError(
            f"table '{name}' has {len(rows[0])} numbers in a line, {' '.join(map(shown, rows[0][:6]))}, and header has"
            f" {len(reading.header)} titles; name each column, those that are not wanted too"
        )
    return Cells("with titles that were given", reading.header, rows)


def _split(lines: list[str], reading: Reading) -> Cells:
    """Split a file whose first line is its header."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    rows = (_numbers(line, reading.decimal) or _cells(line) for line in lines[1:])
    header = _cells(lines[0])
    while header and not header[-1]:
        header.pop()
    return Cells("read as it was said", tuple(header), tuple(tuple(row) for row in rows))


def _with_units(name: str, grid: Cells, reading: Reading) -> Cells:
    header = list(grid.header)
    names = [name_of_title(title) for title in header]
    for column, unit in reading.units.items():
        if names.count(column) != 1:
            raise InputError(
                f"table '{name}' has no column '{column}', which units names; there are {', '.join(map(shown, names))}"
            )
        k = names.index(column)
        if _has_unit(header[k]):
            raise InputError(
                f"table '{name}': column {shown(header[k])} has a unit already, and units gives '{unit}'; write header to change it"
            )
        header[k] = f"{column} [{unit}]"
    return replace(grid, header=tuple(header))


def _renamed(name: str, grid: Cells, reading: Reading) -> Cells:
    """Give columns, and those of their uncertainties, the names that the model has."""
    header = list(grid.header)
    names = [name_of_title(title) for title in header]
    for ours, theirs in reading.columns.items():
        if names.count(theirs) != 1:
            raise InputError(
                f"table '{name}' has no column '{theirs}', which columns names; there are {', '.join(map(shown, names))}"
            )
        for k, column in enumerate(names):
            if column in (theirs, f"u({theirs})"):
                header[k] = header[k].replace(theirs, ours, 1)
    return replace(grid, header=tuple(header))


def _counted(name: str, grid: Cells, reading: Reading) -> Cells:
    """Count the times from where it is said."""
    if not reading.time_zero:
        return grid
    names = [name_of_title(title).lower() for title in grid.header]
    clocks = [names.index(clock) for clock in CLOCKS if clock in names][:1]
    for k in clocks or [k for k, column in enumerate(names) if column.startswith("event_time_")] or [0]:
        grid = _counted_column(name, grid, reading, k)
    return replace(grid, kind=f"{grid.kind}, time counted from {reading.time_zero}")


def _counted_column(name: str, grid: Cells, reading: Reading, k: int) -> Cells:
    scale = _checked(f"table '{name}', column {shown(grid.header[k])}", lambda: title(grid.header[k])).unit
    if reading.time_zero == FIRST:
        zero = Fraction(grid.rows[0][k]) if number_of(grid.rows[0][k]) is not None else Fraction(0)
    else:
        quantity = parse_quantity(reading.time_zero)
        if quantity.unit.dimension != scale.dimension:
            raise InputError(
                f"time_zero is '{reading.time_zero}', and column {shown(grid.header[k])} is in '{scale.text}'"
            )
        zero = Fraction(repr(quantity.value)) * quantity.unit.factor / scale.factor
    rows = [
        (*row[:k], repr(float(Fraction(row[k]) - zero)), *row[k + 1 :])
        if len(row) > k and number_of(row[k]) is not None
        else row
        for row in grid.rows
    ]
    return replace(grid, rows=tuple(rows))
