"""Files of instruments as tables: phones, loggers, video tracking, oscilloscopes, rocket motors.

A file is known by its first lines. A file that is already a table with units in its header is left as it is. The other
formats that are recognised:

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
TOA5       Campbell's loggers: four lines first, of which the second has the names and the third the units.
others     Lines before a header, a header in a comment, and units in a line of their own below the names:
           ``Time,Channel A``, ``(ms),(V)``. So are Tracker's, a line with the name of the track and ``t  x  y``, whose units
           are said by the key `units`.
========== ==========================================================================================================

phyphox writes a table with units already: ``"Time (s)";"Acceleration x (m/s^2)"``, with commas, semicolons or tabs.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from fractions import Fraction
from itertools import groupby
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import (
    COMMENTS,
    LONGEST_HEADER,
    SEPARATORS,
    Cells,
    cell_excerpt,
    cells_of,
    clocks_of,
    first_numbers,
    has_unit,
    is_table,
    name_of_title,
    normalise_newlines,
    number_cells,
    number_in_cell,
    title,
    unit_word,
)
from xdynamics.model.drives import JUMP
from xdynamics.units import SECONDS, parse_quantity, parse_scale

TIME = "time [s]"


RUN = re.compile(r"((?:Data Set|Run) \d+|Latest)\s*:\s*(.*)", re.IGNORECASE)


_CHANNEL = re.compile(r"\s*([A-Za-z]+[0-9]+)\s*:?\s*\(?([A-Za-z]*)\)?\s*")


_START, STEP = (re.compile(rf"{name}\s*=\s*([-+0-9.eE]+)\s*s?", re.IGNORECASE) for name in ("t0", "tInc"))


def rasp(lines: list[str], _: str) -> Cells | None:
    """Read the thrust of a motor as RASP has it; None of another file.

    Raises
    ------
    InputError
        If the file holds several motors, or its last thrust is not zero.
    """
    entries = [line for line in lines if not line.lstrip().startswith(";")]
    words = entries[0].split() if entries else []
    if len(words) < 7 or any(number_in_cell(words[k]) is None for k in (1, 2, 4, 5)) or "," in entries[0]:
        return None
    points = [entry.split(";")[0].split() for entry in entries[1:]]
    if motor := next((point for point in points if len(point) >= 7), None):
        raise InputError(f"holds several motors, {words[0]} and {motor[0]}; keep the lines of one")
    if any(len(point) != 2 or None in map(number_in_cell, point) for point in points):
        return None
    if points and number_in_cell(points[-1][1]) != 0:
        time, thrust = points[-1]
        raise InputError(
            f"ends with a thrust of {thrust} N at {time} s, where RASP has 0 N at burnout: is a part of it missing?"
            f" If not, add a line with the burnout and 0, like '{float(time) + 0.01:g} 0'"
        )
    start = [] if not points or number_in_cell(points[0][0]) == 0 else [("0", "0")]
    rows = (*start, *((time, thrust) for time, thrust in points))
    return Cells(f"thrust of the motor {words[0]} by {' '.join(words[6:])}, as RASP has it", (TIME, "thrust [N]"), rows)


def vernier(lines: list[str], decimal: str) -> Cells | None:
    """Read the first run of a Vernier logger; None of another file."""
    titles = [RUN.fullmatch(cell) for cell in cells_of(lines[0])]
    first = titles[0]
    if first is None:
        return None
    places = [k for k, title in enumerate(titles) if title and title[1] == first[1]]
    rows = [cells_of(line) for line in lines[1:]]
    comma = decimal == "," or (not decimal and ";" in lines[0])
    run_rows = [
        tuple(row[k].replace(",", ".") if comma else row[k] for k in places) for row in rows if len(row) > max(places)
    ]
    kind = f"columns of '{first[1]}', as Vernier's programs export them"
    return Cells(
        kind,
        tuple(title[2] for title in titles if title and title[1] == first[1]),
        tuple(row for row in run_rows if any(row)),
    )


def tds(lines: list[str], _: str) -> Cells | None:
    """Read the record of a Tektronix TDS oscilloscope; None of another file."""
    first = cells_of(lines[0])
    if first[0] != "Record Length" or len(first) < 5 or None in map(number_in_cell, first[3:5]):
        return None
    rows = [cells_of(line) for line in lines]
    settings = {row[0]: row[1] for row in rows if row[0]}
    header = (
        f"time [{_seconds(settings.get('Horizontal Units', ''))}]",
        f"{settings.get('Source') or 'value'} [{settings.get('Vertical Units') or 'V'}]",
    )
    return Cells(
        "a record of a Tektronix TDS", header, tuple((row[3], row[4]) for row in rows if len(row) > 4 and row[4])
    )


def rigol(lines: list[str], decimal: str) -> Cells | None:
    """Read the record of a Rigol oscilloscope; None of another file."""
    cells = [cell for cell in cells_of(lines[0]) if cell]
    if [*map(str.lower, cells[:1]), *map(str.lower, cells[-2:])] == ["x", "start", "increment"] and len(lines) > 1:
        below = cells_of(lines[1])
        count = len(cells) - 3
        start, step = (number_in_cell(cell) for cell in below[count + 1 : count + 3])
        titles = [
            f"{name} [{unit_word(unit) or 'V'}]" for name, unit in zip(cells[1 : count + 1], below[1:], strict=False)
        ]
        rows = [number_cells(line, decimal) for line in lines[2:]]
        return _timed_cells(
            "a record of a Rigol oscilloscope", titles, [row[1 : count + 1] for row in rows], start, step
        )
    start, step = ((match := form.search(lines[0])) and number_in_cell(match[1]) for form in (_START, STEP))
    if start is None or step is None:
        return None
    names = [cell for cell in cells if not (_START.search(cell) or STEP.search(cell))]
    timed = names[0].lower().startswith("time")
    titles = [
        f"{match[1]} [{unit_word(match[2]) or 'V'}]" if (match := _CHANNEL.fullmatch(name)) else name
        for name in names[timed:]
    ]
    rows = [cells_of(line) for line in lines[1:]]
    if timed and rows and number_in_cell(rows[0][0]) is not None:
        return Cells(
            "a record of a Rigol oscilloscope", (TIME, *titles), tuple(tuple(row[: 1 + len(titles)]) for row in rows)
        )
    rows = [row[timed : timed + len(titles)] for row in rows]
    return _timed_cells("a record of a Rigol oscilloscope", titles, rows, start, step)


def _timed_cells(kind: str, titles: Sequence[str], rows: Sequence[Sequence[str]], start: Any, step: Any) -> Cells:
    """Return rows with their times: from a start on, a step apart."""
    if start is None or not step:
        raise InputError(f'is {kind} without its start and increment; give header = ["t [s]", …] and skip')
    # as decimals are written, so that each time is rounded once
    begin, width = Fraction(repr(start)), Fraction(repr(step))
    times = [repr(float(begin + k * width)) for k in range(len(rows))]
    return Cells(kind, (TIME, *titles), tuple((time, *row) for time, row in zip(times, rows, strict=True)))


def preambled(lines: list[str], decimal: str) -> Cells | None:
    """Read lines before a header, units in a line of their own, and the units of oscilloscopes' preambles."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    begin = first_numbers(lines, decimal)
    if begin < 1:
        return None
    count = len(number_cells(lines[begin], decimal))
    header, above = cells_of(lines[begin - 1])[:count], lines[: begin - 1]
    if len(header) < count:
        return None
    preamble = {row[0].lower(): row[1:] for row in map(cells_of, above) if row}
    units = [unit_word(cell) for cell in header]
    if units[0] and "second" in header[0].lower():
        header, units = _channel_titles(units, preamble), [""] * count
    elif all(units) and above and len(names := cells_of(above[-1])[:count]) == count:
        header, units = [f"{name} [{unit}]" for name, unit in zip(names, units, strict=True)], [""] * count
        above = above[:-1]
    elif "vertical units" in preamble:
        header = _preamble_titles(header, preamble)
    elif not above:
        return None
    kind = f"lines before its header left out: {len(above)}" if above else "names and units in two lines"
    return Cells(kind, tuple(header), tuple(_cells_below(lines[begin:], decimal)))


def commented(lines: list[str], decimal: str) -> Cells | None:
    """Read a table whose header is the last comment above its numbers, ``# t [s], F [N]``; None of another file."""
    comments = [line for line in lines if line.lstrip().startswith(COMMENTS)]
    rows = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    header = cells_of(comments[-1].lstrip().lstrip("#%/").strip()) if comments and rows else []
    numbers = number_cells(rows[0], decimal) if header else []
    if not numbers or len(header) != len(numbers) or not any(map(has_unit, header)):
        return None
    return Cells("its header in a comment", tuple(header), tuple(_cells_below(rows, decimal)))


def _cells_below(lines: Sequence[str], decimal: str) -> Iterator[tuple[str, ...]]:
    """Yield the cells of lines below a header; a line that is none of numbers as it is, so that a reader finds it."""
    return (tuple(number_cells(line, decimal) or cells_of(line)) for line in lines)


def toa5(lines: list[str], _: str) -> Cells | None:
    """Read the record of one of Campbell's loggers, a table of TOA5; None of another file."""
    if cells_of(lines[0])[:1] != ["TOA5"] or len(lines) < 6:
        return None
    names, units = cells_of(lines[1]), [cell.replace("Deg C", "°C") for cell in cells_of(lines[2])]
    titles = [
        f"{name} [{unit}]" if has_unit(f"x [{unit}]") and unit else name
        for name, unit in zip(names, units, strict=False)
    ]
    return Cells(
        "a table of a Campbell logger, TOA5", tuple(titles), tuple(tuple(cells_of(line)) for line in lines[4:])
    )


_DATE = r"(?:(?P<year>[0-9]{4})-(?P<month>[0-9]{2})-(?P<day>[0-9]{2})|(?P<d>[0-9]{1,2})\.(?P<m>[0-9]{1,2})\.(?P<y>[0-9]{4}))"
_CLOCK = r"(?P<hour>[0-9]{1,2}):(?P<minute>[0-9]{2})(?::(?P<second>[0-9]{2}(?:[.,][0-9]+)?))?"
_INSTANT = re.compile(rf"(?:{_DATE}[T ])?{_CLOCK}\s*(?P<zone>Z|[+-][0-9]{{2}}:?[0-9]{{2}})?")
_DAY = 86_400
_QUOTED = ' "'
_AMBIGUOUS = re.compile(
    r"[0-9]{1,4}/[0-9]{1,2}/[0-9]{2,4}\b|[0-9]{1,2}:[0-9]{2}(?::[0-9]{2}(?:\.[0-9]+)?)?\s*[AaPp]\.?[Mm]"
)
_DATE_ALONE, _CLOCK_ALONE = re.compile(_DATE), re.compile(_CLOCK)


def times_of_dates(lines: list[str]) -> tuple[list[str], str]:
    """Return lines whose first cell, a date (ISO 8601) or a clock, is replaced by seconds since that of the first one; and that.

    A clock that goes back by more than half a day has passed midnight. The text is empty where the first cells are none.

    Raises
    ------
    InputError
        If some dates have a time zone and others none, or a date is none of the calendar, or may be read in two ways.
    """
    _refuse_ambiguous_dates(lines)
    lines = _with_dates_joined(lines)
    begin = next((k for k, line in enumerate(lines[:200]) if _INSTANT.fullmatch(line_start(line))), -1)
    if begin < 0:
        return lines, ""
    origin, previous, days = line_start(lines[begin]), Fraction(-_DAY), 0
    zero, zoned = _seconds_of(origin)
    timed_lines = lines[:begin]
    for line in lines[begin:]:
        cell = line_start(line)
        if not _INSTANT.fullmatch(cell):
            timed_lines.append(line)
            continue
        seconds, has_zone = _seconds_of(cell)
        if has_zone != zoned:
            raise InputError(
                f"the time {cell_excerpt(cell)} has {'a' if has_zone else 'no'} time zone, and {origin!r} {'none' if has_zone else 'one'}; write all alike"
            )
        if not _DATE_ALONE.match(cell) and seconds + days * _DAY < previous - _DAY // 2:
            days += 1
        previous = seconds + days * _DAY
        rest = line.lstrip().removeprefix('"')[len(cell) :].removeprefix('"')
        timed_lines.append(f"{float(previous - zero)!r}{rest}")
    return timed_lines, origin


def _refuse_ambiguous_dates(lines: list[str]) -> None:
    """Refuse dates that may be read in two ways, and clocks of twelve hours, where two lines begin with one.

    Raises
    ------
    InputError
        With the spelling that is read.
    """
    found = []
    for line in lines[:200]:
        separator = next((separator for separator in SEPARATORS if separator in line), ",")
        cells = [cell.strip(_QUOTED) for cell in line.split(separator)[:2]]
        found += [cell for cell in cells if _AMBIGUOUS.match(cell)][:1]
        if len(found) > 1:
            raise InputError(
                f"the time {cell_excerpt(found[0])} is not read: write dates as 2024-03-25 or 25.3.2024, clocks as 14:05:00"
            )


def _with_dates_joined(lines: list[str]) -> list[str]:
    """Return lines whose first two cells, a date and a clock, are one; of the titles above them the first is left out."""
    begin, separator = next(
        (
            (k, separator)
            for k, line in enumerate(lines[:200])
            for separator in SEPARATORS
            if _are_date_and_clock(line.split(separator, 2)[:2])
        ),
        (-1, ""),
    )
    if begin < 0:
        return lines
    joined = [*lines[:begin]]
    if begin and separator in joined[-1] and not joined[-1].lstrip().startswith(COMMENTS):
        joined[-1] = joined[-1].split(separator, 1)[1]
    for line in lines[begin:]:
        first, *others = line.split(separator, 1)
        both = _are_date_and_clock([first, *(others or [""])[0].split(separator, 1)[:1]])
        joined.append(f"{first.strip(_QUOTED)} {others[0].lstrip(_QUOTED)}" if both else line)
    return joined


def _are_date_and_clock(cells: Sequence[str]) -> bool:
    if len(cells) < 2:
        return False
    day, clock = (cell.strip(_QUOTED) for cell in cells[:2])
    return bool(_DATE_ALONE.fullmatch(day) and _CLOCK_ALONE.fullmatch(clock))


def line_start(line: str) -> str:
    """Return the first cell of a line, without quotes."""
    separator = next((separator for separator in SEPARATORS if separator in line), ",")
    return line.split(separator, 1)[0].strip().strip('"').strip()


def _seconds_of(cell: str) -> tuple[Fraction, bool]:
    """Return the seconds of a date since that of year 1, or of a clock since midnight, exactly; and whether it has a zone."""
    match = _INSTANT.fullmatch(cell)
    assert match is not None  # noqa: S101 - callers have looked
    parts = match.groupdict()
    seconds = (
        3600 * int(parts["hour"]) + 60 * int(parts["minute"]) + Fraction((parts["second"] or "0").replace(",", "."))
    )
    year, month, day = (parts[word] or parts[word[0]] for word in ("year", "month", "day"))
    if year:
        try:
            seconds += _DAY * date(int(year), int(month), int(day)).toordinal()
        except ValueError:
            raise InputError(f"the date {cell_excerpt(cell)} is none of the calendar") from None
    zone = parts["zone"]
    if zone and zone != "Z":
        shift = 3600 * int(zone[1:3]) + 60 * int(zone[-2:])
        seconds += shift if zone[0] == "-" else -shift
    return seconds, zone is not None


def _channel_titles(units: Sequence[str], preamble: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the titles of columns whose header is words for units, ``Second,Volt``: channels are named above it."""
    channel_matches = [match for cell in preamble.get("vertical units", ()) if (match := _CHANNEL.fullmatch(cell))]
    sources = [cell for cell in (*preamble.get("source", ()), *preamble.get("time", ())) if cell] or [
        title[1] for title in channel_matches
    ]
    sources = [match[1] if (match := re.search(r"\((\w+)\)", cell)) else cell for cell in sources]
    titles = [f"time [{units[0]}]"]
    for k, unit in enumerate(units[1:]):
        name = sources[k] if k < len(sources) else "value" if len(units) == 2 else f"value{k + 1}"
        titles.append(f"{name} [{unit or (channel_matches[k][2] if k < len(channel_matches) else '') or 'V'}]")
    return titles


def _seconds(unit: str) -> str:
    """Return the unit of an oscilloscope's times: some write seconds as ``S``, and none measures against siemens."""
    return SECONDS.text if unit in ("", "S") else unit


def _preamble_titles(header: Sequence[str], preamble: Mapping[str, Sequence[str]]) -> list[str]:
    """Return titles of columns with the units of the preamble: one unit for all columns, or one for each."""
    vertical = [cell for cell in preamble["vertical units"] if cell] or ["V"]
    horizontal = _seconds(next((cell for cell in preamble.get("horizontal units", ()) if cell), ""))
    vertical_units = [vertical[min(k, len(vertical) - 1)] for k in range(len(header) - 1)]
    return [f"{name} [{unit}]" for name, unit in zip(header, [horizontal, *vertical_units], strict=True)]


KEYS = ("skip", "header", "units", "argument_column", "duplicates", "time_zero", "decimal")
FIRST = "first"  # of `time_zero`: times are counted from the first
DUPLICATES = ("first", "last", "mean", JUMP)  # what is taken of lines of one argument
COLUMNS = "columns"  # of `compare` and `fit`; a drive has a name of its own, and `column`


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
    argument_column : str
        The column that values are measured over, where it is not the first.
    duplicates : {"", "first", "last", "mean", "jump"}
        Which value is taken where lines in a row have one argument: both at a jump; refused if empty.
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
    argument_column: str = ""
    duplicates: str = ""
    time_zero: str = ""
    decimal: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def from_keys(cls, keys: Mapping[str, Any]) -> Reading:
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
            _make_labelled(f"units: column '{name}'", lambda unit=unit: parse_scale(unit))  # type: ignore[misc]
        argument, duplicates = keys.get("argument_column", ""), keys.get("duplicates", "")
        if not isinstance(argument, str):
            raise InputError(f"argument_column is {argument!r}, needs the name of a column of the file")
        if duplicates not in ("", *DUPLICATES):
            raise InputError(f"duplicates is {duplicates!r}, needs {', '.join(map(repr, DUPLICATES))}")
        zero, decimal = keys.get("time_zero", ""), keys.get("decimal", "")
        if zero and zero != FIRST:
            _make_labelled("time_zero", lambda: parse_quantity(zero))
        if decimal not in ("", ".", ","):
            raise InputError(f"decimal is {decimal!r}, needs '.' or ','")
        columns = keys.get(COLUMNS, {})
        if not isinstance(columns, Mapping) or not all(isinstance(name, str) for name in columns.values()):
            raise InputError(
                f'columns is {columns!r}, needs names of the file by those of the model, {{ x = "Position" }}'
            )
        return cls(skip, tuple(header), dict(units), argument, str(duplicates), str(zero), str(decimal), dict(columns))


AS_IT_IS = Reading()


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
    lines = [line for line in normalise_newlines(text).split("\n")[reading.skip :] if line.strip(" \t,;")]
    if not lines:
        if reading.skip and text.strip():
            raise InputError(f"table '{name}' has no lines after the first {reading.skip}, which skip leaves out")
        raise InputError(f"table '{name}' is empty")
    lines, origin = times_of_dates(lines)
    grid: Cells | None = None
    first = next((line for line in lines if not line.lstrip().startswith(COMMENTS)), "")[:LONGEST_HEADER]
    ready = is_table(first) and not any(form.search(first) for form in (RUN, STEP))
    titled = not ready or cells_of(first)[0] != ""  # a first column without a title is an index of lines
    if (
        ready
        and titled
        and not origin
        and replace(reading, duplicates=reading.duplicates.removeprefix(JUMP)) == AS_IT_IS
    ):
        return text
    if reading.header:
        grid = _cells_below_titles(name, lines, reading)
    elif not ready:
        read_known_file: Callable[[list[str], str], Cells | None]
        for read_known_file in (rasp, vernier, tds, rigol, toa5, commented, preambled):
            if (grid := read_known_file(lines, reading.decimal)) is not None:
                break
    if reading == AS_IT_IS and grid is None and titled and not origin:
        return text
    grid = grid or _split(lines, reading)
    if not titled:
        grid = Cells(f"{grid.kind}, without its first column", grid.header[1:], tuple(row[1:] for row in grid.rows))
    if origin:
        grid = replace(grid, kind=f"{grid.kind}, time counted from {origin}", header=(TIME, *grid.header[1:]))
    for change in (_with_column_units, _renamed, _with_argument_first, _without_duplicates, _count_times):
        grid = change(name, grid, reading)
    return grid.text(name)


def _make_labelled(label: str, make: Callable[[], Any]) -> Any:
    try:
        return make()
    except InputError as error:
        raise InputError(f"{label}: {error}") from None


def _cells_below_titles(name: str, lines: list[str], reading: Reading) -> Cells:
    """Read the numbers of a file below the titles that are said."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    begin = first_numbers(lines, reading.decimal)
    if begin < 0:
        raise InputError(
            f"table '{name}' has no two lines of as many numbers below each other; it begins {cell_excerpt(lines[0])}"
        )
    rows = tuple(_cells_below(lines[begin:], reading.decimal))
    if len(rows[0]) != len(reading.header):
        raise InputError(
            f"table '{name}' has {len(rows[0])} numbers in a line, {' '.join(map(cell_excerpt, rows[0][:6]))}, and header has"
            f" {len(reading.header)} titles; name each column, those that are not wanted too"
        )
    return Cells("with titles that were given", reading.header, rows)


def _split(lines: list[str], reading: Reading) -> Cells:
    """Split a file whose first line is its header."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    header = cells_of(lines[0])
    while header and not header[-1]:
        header.pop()
    return Cells(
        "read as a table" if reading == AS_IT_IS else "read as it was said",
        tuple(header),
        tuple(_cells_below(lines[1:], reading.decimal)),
    )


def _with_column_units(name: str, grid: Cells, reading: Reading) -> Cells:
    header = list(grid.header)
    names = [name_of_title(title) for title in header]
    for column, unit in reading.units.items():
        if names.count(column) != 1:
            raise InputError(
                f"table '{name}' has no column '{column}', which units names; there are {', '.join(map(cell_excerpt, names))}"
            )
        k = names.index(column)
        if has_unit(header[k]):
            raise InputError(
                f"table '{name}': column {cell_excerpt(header[k])} has a unit already, and units gives '{unit}'; write header to change it"
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
                f"table '{name}' has no column '{theirs}', which columns names; there are {', '.join(map(cell_excerpt, names))}"
            )
        for k, column in enumerate(names):
            if column in (theirs, f"u({theirs})"):
                header[k] = header[k].replace(theirs, ours, 1)
    return replace(grid, header=tuple(header))


def _with_argument_first(name: str, grid: Cells, reading: Reading) -> Cells:
    """Put the column that values are measured over before the others."""
    if not reading.argument_column:
        return grid
    names = [name_of_title(title) for title in grid.header]
    wanted = reading.argument_column.strip()
    matching = [k for k, title in enumerate(grid.header) if wanted in (names[k], title.strip())]
    if len(matching) != 1:
        raise InputError(
            f"table '{name}' has {'several columns' if matching else 'no column'} '{wanted}', which argument_column names;"
            f" there are {', '.join(map(cell_excerpt, grid.header))}"
        )
    k = matching[0]
    rows = tuple((row[k], *row[:k], *row[k + 1 :]) if len(row) > k else row for row in grid.rows)
    return replace(grid, header=(grid.header[k], *grid.header[:k], *grid.header[k + 1 :]), rows=rows)


def _without_duplicates(_name: str, grid: Cells, reading: Reading) -> Cells:
    """Take one line of those in a row that have the same argument."""
    if reading.duplicates in ("", JUMP):
        return grid
    rows: list[tuple[str, ...]] = []
    arguments = (number_in_cell(row[0]) if row else None for row in grid.rows)
    keys = [object() if argument is None else argument for argument in arguments]  # a gap is none of another line's
    for _, numbered in groupby(enumerate(grid.rows), key=lambda item: keys[item[0]]):
        group = [row for _, row in numbered]
        rows.append(
            _mean_row(group) if reading.duplicates == "mean" else group[0 if reading.duplicates == "first" else -1]
        )
    left_out = len(grid.rows) - len(rows)
    kind = f"{grid.kind}, lines left out whose argument another one has: {left_out}, the {reading.duplicates} is taken"
    return replace(grid, kind=kind if left_out else grid.kind, rows=tuple(rows))


def _mean_row(group: list[tuple[str, ...]]) -> tuple[str, ...]:
    """Return a line of the means of lines; a gap where one of them has one."""
    if len(group) == 1:
        return group[0]
    columns = zip(*group, strict=False)
    numbers = ([number_in_cell(cell) for cell in column] for column in columns)
    return tuple(
        "" if None in column else repr(float(sum(Fraction(repr(number)) for number in column) / len(column)))
        for column in numbers
    )


def _count_times(name: str, grid: Cells, reading: Reading) -> Cells:
    """Count the times from the origin that the reading states."""
    if not reading.time_zero:
        return grid
    names = [name_of_title(title) for title in grid.header]
    clocks = [names.index(clock) for clock in clocks_of(grid.header)][:1]
    for k in clocks or [k for k, column in enumerate(names) if column.startswith("event_time_")] or [0]:
        grid = _count_column(name, grid, reading, k)
    return replace(grid, kind=f"{grid.kind}, time counted from {reading.time_zero}")


def _count_column(name: str, grid: Cells, reading: Reading, k: int) -> Cells:
    scale = _make_labelled(f"table '{name}', column {cell_excerpt(grid.header[k])}", lambda: title(grid.header[k])).unit
    if reading.time_zero == FIRST:
        zero = Fraction(grid.rows[0][k]) if number_in_cell(grid.rows[0][k]) is not None else Fraction(0)
    else:
        quantity = parse_quantity(reading.time_zero)
        if quantity.unit.dimension != scale.dimension:
            raise InputError(
                f"time_zero is '{reading.time_zero}', and column {cell_excerpt(grid.header[k])} is in '{scale.text}'"
            )
        zero = Fraction(repr(quantity.value)) * quantity.unit.factor / scale.factor
    rows = [
        (*row[:k], repr(float(Fraction(row[k]) - zero)), *row[k + 1 :])
        if len(row) > k and number_in_cell(row[k]) is not None
        else row
        for row in grid.rows
    ]
    return replace(grid, rows=tuple(rows))
