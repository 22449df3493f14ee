"""Measured tables: CSV text with units in its header, and the piecewise polynomial through its points.

Slopes at the points are computed in a fixed order of arithmetic, which no library's version changes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.piecewise import find_piece, last_piece_begun, slope_at, value_at
from xdynamics.faults import InputError, Ledger
from xdynamics.model.csv_sheet import Sheet, Title, cell_excerpt, clocks_of, normalise_newlines
from xdynamics.units import Unit

Floats = NDArray[np.float64]


def hermite_pieces(x: Floats, y: Floats, slope: Floats) -> Floats:
    """Return the cubic of every piece from the values and slopes at its ends.

    Parameters
    ----------
    x, y, slope : ndarray, shape (n,)

    Returns
    -------
    ndarray, shape (4, n - 1)
        Coefficients of (t - x[k])**3 … **0.
    """
    h = np.diff(x)
    secant = np.diff(y) / h
    bend = (slope[:-1] + slope[1:] - 2.0 * secant) / h
    return np.stack([bend / h, (secant - slope[:-1]) / h - bend, slope[:-1], y[:-1]])


def monotone_slopes(x: Floats, y: Floats) -> Floats:
    """Weighted harmonic means of neighbouring secants, zero where these differ in sign.

    Fritsch and Butland 1984 (SIAM J. Sci. Stat. Comput. 5, 300); the ends by a shape-preserving three-point formula
    (Moler, Numerical Computing with MATLAB, section 3.6).
    """
    h = np.diff(x)
    secant = np.diff(y) / h
    if len(x) == 2:
        return np.repeat(secant, 2)
    w1, w2 = 2.0 * h[1:] + h[:-1], h[1:] + 2.0 * h[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = (w1 / secant[:-1] + w2 / secant[1:]) / (w1 + w2)
        inner = np.where(np.sign(secant[:-1]) * np.sign(secant[1:]) > 0.0, 1.0 / mean, 0.0)
    first, last = _end_slope(h[0], h[1], secant[0], secant[1]), _end_slope(h[-1], h[-2], secant[-1], secant[-2])
    return np.concatenate([[first], inner, [last]])


def _end_slope(h: float, h_next: float, secant: float, next_secant: float) -> float:
    slope = ((2.0 * h + h_next) * secant - h * next_secant) / (h + h_next)
    if np.sign(slope) != np.sign(secant):
        return 0.0
    turns = np.sign(secant) != np.sign(next_secant)
    return 3.0 * secant if turns and abs(slope) > 3.0 * abs(secant) else slope


def spline_slopes(x: Floats, y: Floats) -> Floats:
    """Slopes of the cubic spline with continuous third derivative at the second and last-but-one points (not-a-knot).

    de Boor, A Practical Guide to Splines (1978), chapter IV: a tridiagonal system, eliminated from the first row on,
    whose pivots stay positive. Three points are joined by a parabola, two by a line.
    """
    h = np.diff(x)
    secant = np.diff(y) / h
    if len(x) == 2:
        return np.repeat(secant, 2)
    if len(x) == 3:
        middle = (h[1] * secant[0] + h[0] * secant[1]) / (h[0] + h[1])
        return np.array([2.0 * secant[0] - middle, middle, 2.0 * secant[1] - middle])
    first, last = x[2] - x[0], x[-1] - x[-3]
    lower = np.concatenate([[0.0], h[1:], [last]]).tolist()
    middle = np.concatenate([[h[1]], 2.0 * (h[:-1] + h[1:]), [h[-2]]]).tolist()
    upper = np.concatenate([[first], h[:-1], [0.0]]).tolist()
    inner = 3.0 * (h[1:] * secant[:-1] + h[:-1] * secant[1:])
    at_first = ((h[0] + 2.0 * first) * h[1] * secant[0] + h[0] * h[0] * secant[1]) / first
    at_last = (h[-1] * h[-1] * secant[-2] + (2.0 * last + h[-1]) * h[-2] * secant[-1]) / last
    right = np.concatenate([[at_first], inner, [at_last]]).tolist()
    for i in range(1, len(right)):
        factor = lower[i] / middle[i - 1]
        middle[i] -= factor * upper[i - 1]
        right[i] -= factor * right[i - 1]
    right[-1] /= middle[-1]
    for i in range(len(right) - 2, -1, -1):
        right[i] = (right[i] - upper[i] * right[i + 1]) / middle[i]
    return np.array(right)


INTERPOLATIONS = ("previous", "linear", "pchip", "cubic")
OUTSIDE = ("error", "zero", "hold")
REFUSE, SKIP = GAPS = ("refuse", "skip")
JUMP = "jump"  # two rows of one argument: the value before it, and the value from it on
MOST_LINES = 5  # of a table, named in an error
ARGUMENT, VALUE, DOUBTS = "argument", "value", {"uncertainty": "u({0})", "common": "u_common({0})"}  # and their headers


@dataclass(frozen=True)
class Table:
    """A measured table of two columns, perhaps with columns of uncertainties, and its full text.

    Attributes
    ----------
    name : str
        The file that it was read from.
    text : str
        The CSV text: ``#`` lines, a header ``time [s],thrust [N]``, rows. Line ends are newlines.
    argument_unit, value_unit : Unit
    argument, value : ndarray, shape (n,), SI
        `argument` strictly increases, but at jumps, where two rows have one.
    uncertainty : ndarray, shape (n,), SI, optional
        Standard uncertainty of each value, independent of all others: a column ``u(thrust) [N]``.
    common : ndarray, shape (n,), SI, optional
        Standard uncertainty common to all values, as by a calibration: a column ``u_common(thrust) [N]``.
    column, gaps, duplicates : str
        As passed to `parse`.
    """

    name: str
    text: str
    argument_unit: Unit = field(compare=False)
    value_unit: Unit = field(compare=False)
    argument: Floats = field(compare=False, repr=False)
    value: Floats = field(compare=False, repr=False)
    uncertainty: Floats | None = field(default=None, compare=False, repr=False)
    common: Floats | None = field(default=None, compare=False, repr=False)
    column: str = ""
    gaps: str = "refuse"
    duplicates: str = ""

    @classmethod
    def parse(cls, name: str, text: str, column: str = "", gaps: str = REFUSE, duplicates: str = "") -> Table:
        """Read CSV text: cells separated by commas, semicolons or tabs, with decimal points or commas.

        Parameters
        ----------
        name, text : str
        column : str
            Name, or full header, of the values, where there is more than one column of them.
        gaps : {"refuse", "skip"}
            How lines with a missing number are treated.
        duplicates : {"", "jump"}
            Whether two rows of one argument are a jump; they are refused otherwise.

        Raises
        ------
        InputError
            If the text is faulty; with the line number of every fault, and only the beginning of a cell.
        """
        return cls.from_sheet(Sheet.from_text(name, text), text, column, gaps, duplicates)

    @classmethod
    def from_sheet(cls, sheet: Sheet, text: str, column: str = "", gaps: str = REFUSE, duplicates: str = "") -> Table:
        """Read a column of a sheet, of whose text it is; see `parse`.

        Raises
        ------
        InputError
            As `parse` does.
        """
        places = _value_columns(sheet, column)
        titles = dict(zip(places.values(), sheet.titles([*places.values()]), strict=True))
        _check_doubts(sheet, places, titles)
        rows = sheet.columns([*places.values()], skip=gaps == SKIP)
        if not _increases(rows[:, 0], duplicates) or (rows[:, 2:] < 0).any():
            _refuse_rows(sheet, sheet.read_rows([*places.values()], skip=gaps == SKIP), duplicates)
        units = {word: titles[k].unit for word, k in places.items()}
        numbers = {
            word: unit.all_to_si(np.ascontiguousarray(rows[:, k])) for k, (word, unit) in enumerate(units.items())
        }
        return cls(
            sheet.name,
            normalise_newlines(text),
            units[ARGUMENT],
            units[VALUE],
            **numbers,
            column=column,
            gaps=gaps,
            duplicates=duplicates,
        )

    @property
    def form(self) -> Table:
        """The table without its numbers: the dimensions of its two columns."""
        empty = np.empty(0)
        dimensions = f"{self.argument_unit.dimension}, {self.value_unit.dimension}"
        return Table("", dimensions, self.argument_unit, self.value_unit, empty, empty)


def piece_coefficients(
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
        Whether the argument is time: a march then goes on beyond the last point, which otherwise belongs to the table.

    Returns
    -------
    origin : ndarray, shape (n + 1,)
        Piece k holds from ``origin[k]`` to ``origin[k + 1]``; piece 0 lies before the table, piece n after it.
    powers : ndarray, shape (4, n + 1)
        Coefficients of (x - origin[k])**3 … **0.
    """
    if interpolation == "previous" and not of_time:  # the last value holds at the last point alone
        # just beyond it; the number next to 0 would be too small to divide by
        beyond = max(np.nextafter(argument[-1], np.inf), argument[-1] + 2.0**-52 * (argument[-1] - argument[0]))
        argument, value = np.append(argument, beyond), np.append(value, value[-1])
    ends = {"error": (np.nan, np.nan), "zero": (0.0, 0.0), "hold": (value[0], value[-1])}[outside]
    jumps = np.flatnonzero(np.diff(argument) == 0) + 1
    stretches = zip(np.split(argument, jumps), np.split(value, jumps), strict=True)  # each interpolated by itself
    pieces = np.hstack([_interpolation_pieces(x, y, interpolation) for x, y in stretches if len(x) > 1])
    inner = np.vstack([np.zeros((4 - len(pieces), pieces.shape[1])), pieces])
    piece_before, piece_after = (np.array([[0.0], [0.0], [0.0], [end]]) for end in ends)
    points = np.delete(argument, jumps)
    origin = np.concatenate([points[:1], points])
    return origin, np.ascontiguousarray(np.hstack([piece_before, inner, piece_after]))


def _interpolation_pieces(argument: Floats, value: Floats, interpolation: str) -> Floats:
    if interpolation == "previous":
        return value[None, :-1]
    if interpolation == "linear":
        return np.vstack([np.diff(value) / np.diff(argument), value[:-1]])
    slopes = monotone_slopes if interpolation == "pchip" else spline_slopes
    return hermite_pieces(argument, value, slopes(argument, value))


def doubts_of(name: str, names: Sequence[str]) -> dict[str, int]:
    """Return the indices of the columns with the uncertainties of a column, independent and common."""
    headers = {word: header.format(name) for word, header in DOUBTS.items()}
    return {word: names.index(header) for word, header in headers.items() if header in names}


def _value_columns(sheet: Sheet, column: str) -> dict[str, int]:
    """Return the column indices of argument, values, and uncertainties if any; other columns may be anything."""
    names = sheet.names
    if column in names[1:] and not column.endswith(")"):  # one of many: the others are not looked at
        values = [names.index(column, 1)]
    else:
        doubts = {header.format(name) for name in names for header in DOUBTS.values()}
        values = [k for k, name in enumerate(names) if k and name and name not in doubts]
        matching = [k for k in values if column.strip() in (names[k], sheet.header[k].strip())]
        if column and not matching:
            raise InputError(
                f"table '{sheet.name}' has no column {cell_excerpt(column)} of values; it is {sheet.layout_text}"
            )
        values = matching[:1] if column else values
    if len(values) != 1:
        problem = (
            f'{len(values)} columns of values: say which with column = "{names[values[0]]}"'
            if values
            else "no column of values beside the first"
        )
        raise InputError(
            f"table '{sheet.name}', line {sheet.header_line}, has {problem}; it is {sheet.layout_text}, and needs two with"
            " units, like 'time [s],thrust [N]', with uncertainties further ones, 'u(thrust) [N]' of each value,"
            f" 'u_common(thrust) [N]' of all together{_argument_remedy(sheet)}; {sheet.first_lines_text}"
        )
    return {ARGUMENT: 0, VALUE: values[0]} | doubts_of(names[values[0]], names)


def _argument_remedy(sheet: Sheet) -> str:
    """Return how to say that values are measured over another column than the first, if there is one of times."""
    clocks = [name for name in clocks_of(sheet.header) if name != sheet.names[0]]
    return (
        f"; they are measured over the first column, {cell_excerpt(sheet.names[0])}; where that is another one:"
        f' argument_column = "{clocks[0]}"'
        if clocks
        else ""
    )


def _check_doubts(sheet: Sheet, places: Mapping[str, int], titles: Mapping[int, Title]) -> None:
    """Refuse uncertainties in another kind of unit than the values."""
    unit = titles[places[VALUE]].unit
    for word, column_index in places.items():
        if word in DOUBTS and titles[column_index].unit.dimension != unit.dimension:
            raise InputError(
                f"table '{sheet.name}', line {sheet.header_line}: uncertainties are in '{titles[column_index].unit.text}', the"
                f" values in '{unit.text}'"
            )


def _increases(argument: Floats, duplicates: str) -> bool:
    """Whether a table has two arguments, and they increase, two at a jump being equal."""
    steps = np.diff(argument)
    if duplicates != JUMP:
        return len(steps) > 0 and bool((steps > 0).all())
    return bool((steps > 0).any() and (steps >= 0).all() and (argument[2:] > argument[:-2]).all())


def _refuse_rows(sheet: Sheet, rows: list[tuple[int, tuple[float, ...]]], duplicates: str) -> None:
    """Name the lines of arguments that do not increase and of negative uncertainties, and too few points."""
    ledger = Ledger(f"table '{sheet.name}'")
    before, previous, allowed = -inf, -inf, duplicates == JUMP
    for number, (argument, _, *doubts) in rows:
        if argument == previous and (not allowed or argument == before):
            remedy = " the value before it and the value after it" if allowed else ""
            same = (
                f"; a jump is two lines,{remedy}"
                if allowed
                else f', of which duplicates = "first", "last" or "mean" takes one, and duplicates = "{JUMP}" both'
            )
            ledger.note(f"line {number}: argument {argument!r} does not increase after {previous!r}{same}")
        elif argument < previous:
            ledger.note(f"line {number}: argument {argument!r} does not increase after {previous!r}")
        elif doubts and min(doubts) < 0:
            ledger.note(f"line {number}: the uncertainty {min(doubts)!r} is negative")
        before, previous = previous, max(previous, argument)
        if len(ledger.faults) >= MOST_LINES:
            ledger.note("and perhaps further lines below these")
            break
    if len({argument for _, (argument, *_) in rows}) < 2:
        ledger.note(f"has {len(rows)} rows, needs 2 or more" + (" of different arguments" if allowed else ""))
    ledger.raise_faults()


def value_and_slope(table: tuple[Floats, Floats], x: Any, *, of_time: bool) -> tuple[Any, Any]:
    """Return value and slope of a table's piecewise polynomial at one or many arguments, as a march computes them.

    A march that ends with a table of time has its last value there.
    """
    origin, powers = table
    count = len(origin)

    def read_coefficient(row: int, piece: Any) -> Any:
        return powers[row - 1, piece] if row else origin[piece]

    goes_on = of_time and np.isfinite(powers[3, -1])
    piece = (last_piece_begun if goes_on else find_piece)(read_coefficient, count, x)
    return value_at(read_coefficient, x, piece), slope_at(read_coefficient, x, piece)
