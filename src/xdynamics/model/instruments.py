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
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import (
    COMMENTS,
    LONGEST_HEADER,
    cell_excerpt,
    clocks_of,
    name_of_title,
    normalise_newlines,
    number_in_cell,
    title,
)
from xdynamics.model.instrument_files import RUN, STEP, preambled, rasp, rigol, tds, vernier
from xdynamics.model.text_cells import Cells, cells_of, first_numbers, has_unit, is_table, number_cells
from xdynamics.units import parse_quantity, parse_scale

KEYS = ("skip", "header", "units", "time_zero", "decimal")
FIRST = "first"  # of `time_zero`: times are counted from the first
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
        return cls(skip, tuple(header), dict(units), str(zero), str(decimal), dict(columns))


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
    grid: Cells | None = None
    first = next((line for line in lines if not line.lstrip().startswith(COMMENTS)), "")[:LONGEST_HEADER]
    ready = is_table(first) and not any(form.search(first) for form in (RUN, STEP))
    if ready and reading == AS_IT_IS:
        return text
    if reading.header:
        grid = _cells_below_titles(name, lines, reading)
    elif not ready:
        read_known_file: Callable[[list[str], str], Cells | None]
        for read_known_file in (rasp, vernier, tds, rigol, preambled):
            if (grid := read_known_file(lines, reading.decimal)) is not None:
                break
    if reading == AS_IT_IS:
        return text if grid is None else grid.text(name)
    grid = grid or _split(lines, reading)
    return _count_times(name, _renamed(name, _with_column_units(name, grid, reading), reading), reading).text(name)


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
    rows = tuple(tuple(row) for line in lines[begin:] if (row := number_cells(line, reading.decimal)))
    if len(rows[0]) != len(reading.header):
        raise InputError(
            f"table '{name}' has {len(rows[0])} numbers in a line, {' '.join(map(cell_excerpt, rows[0][:6]))}, and header has"
            f" {len(reading.header)} titles; name each column, those that are not wanted too"
        )
    return Cells("with titles that were given", reading.header, rows)


def _split(lines: list[str], reading: Reading) -> Cells:
    """Split a file whose first line is its header."""
    lines = [line for line in lines if not line.lstrip().startswith(COMMENTS)]
    rows = (number_cells(line, reading.decimal) or cells_of(line) for line in lines[1:])
    header = cells_of(lines[0])
    while header and not header[-1]:
        header.pop()
    return Cells("read as it was said", tuple(header), tuple(tuple(row) for row in rows))


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


def _count_times(name: str, grid: Cells, reading: Reading) -> Cells:
    """Count the times from where it is said."""
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
