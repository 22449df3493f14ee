"""Piecewise polynomials of measured tables, evaluated in compiled code; built by `model.drives.coefficients`."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import compiled

Table = tuple[NDArray[np.float64], NDArray[np.float64]]  # origin, powers


@compiled
def find_piece(x: float, table: Table) -> int:
    """Return the piece that holds from x on; the table's last point still belongs to its last inner piece."""
    origin = table[0]
    low, high = 0, origin.shape[0] - 1
    if x == origin[high]:
        return high - 1
    if not x >= origin[1]:
        return 0
    while low < high:
        middle = (low + high + 1) // 2
        if origin[middle] <= x:
            low = middle
        else:
            high = middle - 1
    return low


@compiled
def piece_after(x: float, table: Table) -> int:
    """Return the piece that a march starting at time x goes through."""
    origin = table[0]
    last = origin.shape[0] - 1
    return last if x >= origin[last] else find_piece(x, table)


@compiled
def value_at(x: float, table: Table, piece: int) -> float:
    """Evaluate one piece of the polynomial by Horner's rule."""
    origin, powers = table
    u = x - origin[piece]
    return ((powers[0, piece] * u + powers[1, piece]) * u + powers[2, piece]) * u + powers[3, piece]


@compiled
def slope_at(x: float, table: Table, piece: int) -> float:
    """Evaluate the derivative of one piece."""
    origin, powers = table
    u = x - origin[piece]
    return (3.0 * powers[0, piece] * u + 2.0 * powers[1, piece]) * u + powers[2, piece]
