"""Measured tables as piecewise polynomials: one flat array, read by compiled laws and by plain ones.

For drive i, ``places[3*i]`` is where its table begins in `tables`, ``places[3*i + 1]`` the number of its pieces, and
``places[3*i + 2]`` the piece that a drive of time is in. A table is the origins of its pieces, then their
coefficients from the cubic one down; `model.drives.coefficients` makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.numbers import choose, repeated
from xdynamics.kernels.compiling import compiled

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]


def flattened(tables: Iterable[tuple[Floats, Floats]]) -> tuple[Floats, Whole]:
    """Concatenate tables; return them and where each begins."""
    arrays, places, first = [np.empty(0)], [], 0
    for origin, powers in tables:
        arrays += [origin, powers.ravel()]
        places += [first, origin.size, 0]
        first += origin.size + powers.size
    return np.concatenate(arrays), np.array(places, np.int64)


@compiled
def find_piece(x: float, tables: Floats, first: int, pieces: int) -> int:
    """Return the piece that applies from x on; the table's last point still belongs to its last inner piece."""
    low, high = 0, pieces - 1
    if x == tables[first + high]:
        return high - 1
    if not x >= tables[first + 1]:
        return 0
    while low < high:
        middle = (low + high + 1) // 2
        if tables[first + middle] <= x:
            low = middle
        else:
            high = middle - 1
    return low


@compiled
def enter_pieces(t: float, tables: Floats, places: Whole, of_time: Whole) -> None:
    """Store, for every drive of time, the piece in which a march starting at t begins."""
    for k in range(of_time.shape[0]):
        i = of_time[k]
        first, last = places[3 * i], places[3 * i + 1] - 1
        places[3 * i + 2] = last if t >= tables[first + last] else find_piece(t, tables, first, last + 1)


# ------------------------------------------------------------------ what laws look up, as functions of any kind of number

Read = Callable[[Any], Any]  # an element of a table


def piece_at(read: Read, count: Any, x: Any) -> Any:
    """Return the piece that applies from x on, as `find_piece`."""

    def halved(low: Any, high: Any) -> tuple[Any, Any]:
        middle = (low + high + 1) >> 1
        begun = read(middle) <= x
        return choose(begun, middle, low), choose(begun, high, middle - 1)

    last = count - 1
    found, _ = repeated(lambda low, high: low < high, halved, last - last, last)
    return choose(read(last) == x, last - 1, found)


def value_at(read: Read, count: Any, x: Any, piece: Any) -> Any:
    """Return the value of a piece at x."""
    u, cubic, square, slope, value = _piece(read, count, x, piece)
    return ((cubic * u + square) * u + slope) * u + value


def slope_at(read: Read, count: Any, x: Any, piece: Any) -> Any:
    """Return the slope of a piece at x."""
    u, cubic, square, slope, _ = _piece(read, count, x, piece)
    return (cubic * 3.0 * u + square * 2.0) * u + slope


def _piece(read: Read, count: Any, x: Any, piece: Any) -> tuple[Any, ...]:
    return (x - read(piece), *(read(count * row + piece) for row in range(1, 5)))


LOOKED_UP: dict[str, Callable[..., Any]] = {"find_piece": piece_at, "value_at": value_at, "slope_at": slope_at}


def _in_python(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make a function of a table one of all tables and places, for printed Python."""

    def looked_up(tables: Floats, places: Whole, *given: Any) -> Any:
        *arguments, drive = given
        first, count = int(places[3 * drive]), int(places[3 * drive + 1])
        return function(lambda index: tables[first + index], count, *arguments)

    return looked_up


# what printed Python calls
PYTHON_TABLES = {
    **{f"_{name}": _in_python(function) for name, function in LOOKED_UP.items()},
    "_piece_of": lambda _tables, places, drive: int(places[3 * drive + 2]),
}
