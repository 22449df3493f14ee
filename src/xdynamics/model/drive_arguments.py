"""Arguments of measured tables: what a drive is looked up at, and the points of those that run evenly with time."""

from __future__ import annotations

from collections.abc import Container

import numpy as np
from numpy.typing import NDArray

from xdynamics.expressions import Name, Node, derivative, free_names
from xdynamics.expressions.calculus import ONE

Floats = NDArray[np.float64]
Table = tuple[Floats, Floats]
CLOCK = Name("t")


def lookup_argument(argument: Node, moving: Container[str]) -> Node:
    """Return the argument of a table's look-up: time if its argument is linear in time alone, else the argument.

    The points of ``v*t`` are times that are known before the march, which lands on them.

    Parameters
    ----------
    argument : Node
        With definitions expanded.
    moving : container of str
        What changes along a motion besides time.
    """
    varies = any(name in moving for name in free_names(argument))
    linear = not varies and "t" not in free_names(derivative(argument, {"t": ONE}))
    return CLOCK if linear else argument


def table_in_time(table: Table, rate: float, offset: float) -> Table:
    """Return the pieces of a table of ``rate*t + offset`` as pieces in time.

    Parameters
    ----------
    table : tuple of ndarray
        As `drives.piece_coefficients` makes it.
    rate, offset : float
        With a negative rate the table is passed from its end to its beginning; without one it stands still.
    """
    origin, powers = table
    if rate == 0.0:
        still = np.array([[0.0, 0.0]] * 3 + [[value_at_rest(table, offset)] * 2])
        return np.zeros(2), still
    if rate < 0.0:
        origin, powers = reversed_table(table)
    return (origin - offset) / rate, powers * rate ** np.array([[3], [2], [1], [0]])


def value_at_rest(table: Table, x: float) -> float:
    """Return the value of a table at one argument; at its last point that of the piece before it."""
    origin, powers = table
    inner = origin[1:]
    piece = len(inner) - 1 if x == inner[-1] else int(np.searchsorted(inner, x, side="right"))
    return float(np.polyval(powers[:, piece], x - origin[piece]))


def reversed_table(table: Table) -> Table:
    """Return the pieces of a table from its last to its first, each in powers of the distance from its end."""
    origin, powers = table
    width = np.append(np.diff(origin[1:]), 0.0)
    c3, c2, c1, c0 = (np.append(row[1:-1], row[-1]) for row in powers)
    ends = np.stack(
        [
            c3,
            3.0 * c3 * width + c2,
            (3.0 * c3 * width + 2.0 * c2) * width + c1,
            ((c3 * width + c2) * width + c1) * width + c0,
        ]
    )
    backwards = np.hstack([ends[:, ::-1], powers[:, :1]])
    points = origin[:0:-1]
    return np.concatenate([points[:1], points]), np.ascontiguousarray(backwards)
