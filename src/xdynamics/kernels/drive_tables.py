"""Measured tables as piecewise polynomials: one flat array, read by compiled laws and by plain ones.

For drive i, ``places[3*i]`` is where its table begins in `tables`, ``places[3*i + 1]`` the number of its pieces, and
``places[3*i + 2]`` the piece that a drive of time is in. A table is the origins of its pieces, then their
coefficients from the cubic one down; `model.drives.piece_coefficients` makes it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import piecewise
from xdynamics.elementary.piecewise import PAST, POLYNOMIALS, Read, width_of
from xdynamics.kernels.compiling import jit_inline

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


def concatenated_tables(tables: Iterable[tuple[Floats, Floats]]) -> tuple[Floats, IntArray]:
    """Concatenate tables; return them and where each begins."""
    # an empty one first, as np.concatenate refuses a list of none
    arrays, places, first = [np.empty(0)], [], 0
    for origin, powers in tables:
        arrays += [origin, powers.ravel()]
        places += [first, origin.size, 0]
        first += origin.size + powers.size
    return np.concatenate(arrays), np.array(places, np.int64)


@jit_inline
def find_piece_of_table(x: float, tables: Floats, first: int, pieces: int) -> int:
    """Return the piece that applies from x on, for the engine: `elementary.piecewise.find_piece`."""
    low, high = 0, pieces - 1
    if x == tables[first + high]:
        return high - 1
    # negated, so that nan is in the first piece, as `piecewise.last_piece_begun` has it
    if not x >= tables[first + 1]:
        return 0
    while low < high:
        middle = (low + high + 1) // 2
        if tables[first + middle] <= x:
            low = middle
        else:
            high = middle - 1
    return low


@jit_inline
def enter_pieces(t: float, tables: Floats, places: IntArray, of_time: IntArray) -> None:
    """Store, for every drive of time, the piece in which a march starting at t begins."""
    for k in range(of_time.shape[0]):
        i = of_time[k]
        first, last = places[3 * i], places[3 * i + 1] - 1
        places[3 * i + 2] = last if t >= tables[first + last] else find_piece_of_table(t, tables, first, last + 1)


def _table_reader(tables: Floats, places: IntArray, drive: int) -> tuple[Read, int]:
    """Return how numbers of a drive's table are read, and how many pieces it has."""
    first, count = int(places[3 * drive]), int(places[3 * drive + 1])
    return lambda row, piece: tables[first + row * count + piece], count


def _find_drive_piece(tables: Floats, places: IntArray, x: float, drive: int) -> int:
    return int(piecewise.find_piece(*_table_reader(tables, places, drive), x))


def _piece_evaluator(polynomial: Callable[[Read, float, int], Any]) -> Callable[..., Any]:
    return lambda tables, places, x, piece, drive: polynomial(_table_reader(tables, places, drive)[0], x, piece)


def _past_evaluator(value: Callable[..., Any]) -> Callable[..., Any]:
    """Return how plain Python reads the past: the pieces that a delay is set to, as many as there are."""

    def evaluate_past(
        tables: Floats, places: IntArray, x: float, slot: int, component: int, components: int, degree: int
    ) -> Any:
        first, count, width = int(places[3 * slot]), int(places[3 * slot + 1]), width_of(components, degree)
        return value(lambda row, piece: tables[first + width * piece + row], count, x, component, components, degree)

    return evaluate_past


# what printed Python calls
PYTHON_TABLES = {
    "_find_piece": _find_drive_piece,
    "_piece_of": lambda _tables, places, drive: int(places[3 * drive + 2]),
    **{f"_{name}": _piece_evaluator(polynomial) for name, polynomial in POLYNOMIALS.items()},
    **{f"_{name}": _past_evaluator(value) for name, value in PAST.items()},
}
