"""Measured tables: CSV text with units in its header, and the piecewise polynomial through it."""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.faults import InputError, Ledger
from xdynamics.model.splines import hermite_pieces, monotone_slopes, spline_slopes
from xdynamics.units import Unit, parse_unit

INTERPOLATIONS = ("previous", "linear", "pchip", "cubic")
OUTSIDE = ("error", "zero", "hold")
MOST_FAULTS = 20  # of a table that an error tells
SHOWN = 24  # characters of a cell that an error shows

_PLAIN = re.compile(r"[\s0-9.eE+\-a-zA-Z]+", re.ASCII)  # no underscore, no digits of other alphabets
_HEADER = re.compile(r"\s*(?P<name>[^\[\]]*?)\s*\[(?P<unit>[^\[\]]*)\]\s*")

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """A measured table of two columns, and perhaps a third one with uncertainties, kept with its whole text.

    Attributes
    ----------
    name : str
        The file it came from.
    text : str
        The CSV text: ``#`` lines, a header ``time [s],thrust [N]``, rows. Line ends are newlines.
    argument_unit, value_unit : Unit
    argument, value : ndarray, shape (n,), SI
        `argument` strictly increases.
    uncertainty : ndarray, shape (n,), SI, optional
        Standard uncertainty of each value: a column ``u(thrust) [N]``.
    """

    name: str
    text: str
    argument_unit: Unit = field(compare=False)
    value_unit: Unit = field(compare=False)
    argument: Floats = field(compare=False, repr=False)
    value: Floats = field(compare=False, repr=False)
    uncertainty: Floats | None = field(default=None, compare=False, repr=False)

    @classmethod
    def parse(cls, name: str, text: str) -> Table:
        """Read CSV text.

        Raises
        ------
        InputError
            If the text is faulty; every fault with its line number, and no more of a line than a cell's beginning.
        """
        text = text.replace("\r\n", "\n").replace("\r", "\n")
        lines = [(n, line) for n, line in enumerate(text.split("\n"), 1) if line.strip() and not line.startswith("#")]
        if not lines:
            raise InputError(f"table '{name}' is empty; it needs a header like 'time [s],thrust [N]' and rows")
        units = _header(name, *lines[0])
        rows = _rows(name, lines[1:], len(units))
        columns = [np.array([unit.to_si(row[k]) for row in rows]) for k, unit in enumerate(units)]
        return cls(name, text, units[0], units[1], *columns)


def coefficients(
    argument: Floats, value: Floats, interpolation: str, outside: str, *, of_time: bool = True
) -> tuple[Floats, Floats]:
    """Build the piecewise polynomial of a table, with one more piece beyond either end.

    Parameters
    ----------
    argument, value : ndarray, shape (n,)
    interpolation : {"previous", "linear", "pchip", "cubic"}
        Piecewise constant; straight; monotone cubic Hermite (Fritsch and Butland 1984, SIAM J. Sci. Stat.
        Comput. 5, 300); cubic spline with not-a-knot ends (de Boor 1978).
    outside : {"error", "zero", "hold"}
        The value beyond the table: nan (which ends a run), 0, or the last value.
    of_time : bool
        Whether the argument is time, where a march goes on from the last point; else that point is the table's own.

    Returns
    -------
    origin : ndarray, shape (n + 1,)
        Piece k holds from ``origin[k]`` to ``origin[k + 1]``; piece 0 lies before the table, piece n after it.
    powers : ndarray, shape (4, n + 1)
        Coefficients of (x - origin[k])**3 … **0.
    """
    if interpolation == "previous" and not of_time:  # the last value holds at the last point alone
        # next to it; of 0 the next number is too small to divide by
        beyond = max(np.nextafter(argument[-1], np.inf), argument[-1] + 2.0**-52 * (argument[-1] - argument[0]))
        argument, value = np.append(argument, beyond), np.append(value, value[-1])
    pieces = _pieces(argument, value, interpolation)
    inner = np.vstack([np.zeros((4 - len(pieces), pieces.shape[1])), pieces])
    ends = {"error": (np.nan, np.nan), "zero": (0.0, 0.0), "hold": (value[0], value[-1])}[outside]
    before, after = (np.array([[0.0], [0.0], [0.0], [end]]) for end in ends)
    origin = np.concatenate([argument[:1], argument])
    return origin, np.ascontiguousarray(np.hstack([before, inner, after]))


def _pieces(argument: Floats, value: Floats, interpolation: str) -> Floats:
    if interpolation == "previous":
        return value[None, :-1]
    if interpolation == "linear":
        return np.vstack([np.diff(value) / np.diff(argument), value[:-1]])
    slopes = monotone_slopes if interpolation == "pchip" else spline_slopes
    return hermite_pieces(argument, value, slopes(argument, value))


def _header(name: str, number: int, line: str) -> list[Unit]:
    """Read the units of the columns: argument, value, and where they are told the value's uncertainties."""
    cells = next(csv.reader([line[:1000]]))
    found = [_HEADER.fullmatch(cell) for cell in cells]
    doubted = len(cells) == 3 and all(found) and found[2]["name"] == f"u({found[1]['name']})"  # type: ignore[index]
    if not all(found) or not (len(cells) == 2 or doubted):
        raise InputError(
            f"table '{name}', line {number}: header {_short(line)} needs two columns with units, like 'time [s],thrust [N]',"
            " and may have a third one with uncertainties of the second, like 'u(thrust) [N]'"
        )
    ledger = Ledger(f"table '{name}', line {number}")
    units = []
    for one in found:
        assert one is not None  # noqa: S101
        with ledger.entry(f"column {_short(one['name'])}"):
            units.append(parse_unit(one["unit"]))
    ledger.settle()
    if doubted and units[2].dimension != units[1].dimension:
        raise InputError(
            f"table '{name}', line {number}: uncertainties are in '{units[2].text}', the values in '{units[1].text}'"
        )
    return units


def _rows(name: str, lines: list[tuple[int, str]], columns: int) -> list[tuple[float, ...]]:
    """Read the numbers, gathering faults by line."""
    ledger = Ledger(f"table '{name}'")
    rows: list[tuple[float, ...]] = []
    for number, line in lines:
        if len(ledger.faults) >= MOST_FAULTS:
            break
        cells = line.split(",")
        if len(cells) != columns:
            needed, none = ("a pair", "no pair") if columns == 2 else ("three", "no three")
            many = f"the first of {len(cells)} cells, needs {needed}" if len(cells) > 1 else none
            ledger.note(f"line {number}: {_short(cells[0])} is {many} of numbers")
            continue
        wrong = [cell for cell in cells if not _is_number(cell)]
        if wrong:
            ledger.note(f"line {number}: {_short(wrong[0])} is no number")
            continue
        row = tuple(map(float, cells))
        if infinite := [cell for cell, one in zip(cells, row, strict=True) if not isfinite(one)]:
            ledger.note(f"line {number}: {_short(infinite[0])} is not finite")
        elif rows and row[0] <= rows[-1][0]:
            ledger.note(f"line {number}: argument {row[0]!r} does not increase after {rows[-1][0]!r}")
        elif row[2:] and row[2] < 0:
            ledger.note(f"line {number}: the uncertainty {row[2]!r} is negative")
        else:
            rows.append(row)
    if len(rows) < 2 and not ledger.faults:
        ledger.note(f"has {len(rows)} rows, needs 2 or more")
    ledger.settle()
    return rows


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return _PLAIN.fullmatch(cell) is not None


def _short(cell: str) -> str:
    """Show the beginning of a cell: enough to find it, too little to tell what else is in a file."""
    cell = cell.strip()
    return repr(cell if len(cell) <= SHOWN else cell[:SHOWN] + "…")


def looked_up(table: tuple[Floats, Floats], x: Any, *, of_time: bool) -> tuple[Any, Any]:
    """Return value and slope of a table's piecewise polynomial at a number or many, from the piece that a march would take."""
    origin, powers = table
    last = len(origin) - 1
    piece = np.maximum(np.searchsorted(origin, x, side="right") - 1, 0)
    if not of_time:
        piece = np.where(x == origin[last], last - 1, piece)  # the last point of a table still belongs to it
    u, (cubic, square, slope, value) = x - origin[piece], powers[:, piece]
    return ((cubic * u + square) * u + slope) * u + value, (3.0 * cubic * u + 2.0 * square) * u + slope
