"""What the growth of tangent vectors reads and writes: laws, rows of a run, coefficients, vectors, sums."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
IntArray = NDArray[np.int64]


class GrowthLaw(NamedTuple):
    """The compiled forces and their derivatives, and the arrays that they read and write.

    Attributes
    ----------
    entry, table, y_at, z_at : int
        Addresses: of the program, of its table of arrays, of `y` and of `z`.
    y, z, e, time_and_regime, p : ndarray
        State, result of its evaluation, derivatives by the state, time and regime, constants; SI.
    places : ndarray of int
        Pieces of tables, as in `kernels.drive_tables`.
    entries : ndarray of int, shape (2, j)
        Row and column of each derivative among the variables.
    weights, sizes, ratios : ndarray, shape (j,), (n,), (coordinates,)
        Factors of the derivatives, the unit of each variable, and that of each velocity over that of its coordinate.
    coordinates : int
        How many of the variables are coordinates; as many velocities follow.
    nudge : float
        Where there are no derivatives, the part of its size by which a variable is moved for a difference; else 0.
    """

    entry: int
    table: int
    y_at: int
    z_at: int
    y: Floats
    z: Floats
    e: Floats
    time_and_regime: Floats
    p: Floats
    places: IntArray
    entries: IntArray
    weights: Floats
    sizes: Floats
    ratios: Floats
    coordinates: int
    nudge: float


class Rows(NamedTuple):
    """Steps of a run, each from one row to the next.

    Attributes
    ----------
    times : ndarray, shape (k + 1,)
    states : ndarray, shape (k + 1, n)
    regimes : ndarray, shape (k,)
    sides : ndarray, shape (k, s)
        The last of the law's constants.
    pieces : ndarray of int, shape (k, d)
        Of each drive's table.
    jumps : ndarray of int, shape (k,)
        Index of the matrix that acts before a step; -1 for none.
    matrices : ndarray, shape (j, n, n)
    parts : ndarray of int, shape (k,)
        Into how many equal parts each step is divided.
    blocks : ndarray of int, shape (k,)
        Block to which the growth of a step's first part is added; the blocks of the others follow.
    """

    times: Floats
    states: Floats
    regimes: Floats
    sides: Floats
    pieces: IntArray
    jumps: IntArray
    matrices: Floats
    parts: IntArray
    blocks: IntArray


class GrowthScheme(NamedTuple):
    """The formula: stages, weights of the end, their times, and weights of its error estimates.

    The tolerance is that of one piece, relative to the vectors; `most_pieces` limits their number.
    """

    a: Floats
    b: Floats
    c: Floats
    fifth: Floats
    third: Floats
    tolerance: float
    most_pieces: int


class Tangent(NamedTuple):
    """The current tangent vectors and their working arrays.

    Attributes
    ----------
    state : ndarray, shape (1 + m, n)
        The run's state, then the vectors.
    end, stage : ndarray, shape (1 + m, n)
    slopes : ndarray, shape (12, 1 + m, n)
    upper, total, product : ndarray, shape (m, m)
        R of the last piece, the product of all since the start over 2**(332*exponents[0]), and room for the next.
    pace : ndarray, shape (1,)
        Length of the next piece.
    exponents, pieces : ndarray of int, shape (1,)
    """

    state: Floats
    end: Floats
    stage: Floats
    slopes: Floats
    upper: Floats
    total: Floats
    product: Floats
    pace: Floats
    exponents: IntArray
    pieces: IntArray


class Grown(NamedTuple):
    """The growth of tangent vectors, along blocks.

    Attributes
    ----------
    factors : ndarray, shape (blocks, m)
        Growth of each vector, over 2**(332*exponents).
    exponents : ndarray of int, shape (blocks, m)
    errors : ndarray, shape (blocks,)
        Sums of the pieces' estimated errors.
    """

    factors: Floats
    exponents: IntArray
    errors: Floats
