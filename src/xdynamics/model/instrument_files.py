"""Files as loggers, oscilloscopes and makers of motors write them, known by their first lines."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from xdynamics.faults import InputError
from xdynamics.model.csv_sheet import COMMENTS, number_in_cell
from xdynamics.model.text_cells import Cells, cells_of, first_numbers, number_cells, unit_word
from xdynamics.units import SECONDS

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
    rows = (number_cells(line, decimal) for line in lines[begin:])
    return Cells(kind, tuple(header), tuple(tuple(row) for row in rows if row))


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
    """Return the titles of columns whose units are said in the lines above, the same for all or one for each."""
    vertical = [cell for cell in preamble["vertical units"] if cell] or ["V"]
    horizontal = _seconds(next((cell for cell in preamble.get("horizontal units", ()) if cell), ""))
    vertical_units = [vertical[min(k, len(vertical) - 1)] for k in range(len(header) - 1)]
    return [f"{name} [{unit}]" for name, unit in zip(header, [horizontal, *vertical_units], strict=True)]
