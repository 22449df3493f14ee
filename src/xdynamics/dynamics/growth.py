"""Tangent vectors along the steps of a run, orthonormalised after each: compiled, a block of rows per call.

Benettin, Galgani, Giorgilli, Strelcyn 1980, Meccanica 15, 9 and 21. From each row, the state and m tangent vectors are
integrated together by the twelve stages of `dop853` until the next row, in pieces as short as its error estimate
requires; an event multiplies tangent vectors by a matrix. After every piece the vectors are factorised as Q R
(Gram-Schmidt, modified): the logarithm of R's diagonal is how much each has grown. Vectors are in units of `Law.sizes`.

The arguments of compiled code are `GrowthLaw`, `Rows`, `GrowthScheme`, `Tangent` and `Grown`: laws, rows of a run,
coefficients, vectors, sums.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.kernels.compiling import jit_inline, jit_separate
from xdynamics.kernels.engine_part import EnginePart
from xdynamics.kernels.entry_points import FLOAT, INTEGER, Fields, array_kind, signature_of
from xdynamics.kernels.program import REGIME, T
from xdynamics.march.calls import strode_by

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


STAGES = 12
LARGE = 2.0**332  # products are kept below this, and above its inverse; scaling by powers of two is exact
DEPENDENT = 1e-13  # least part of a vector outside those before it; an event that forgets a direction leaves none
SPARE = 1e-3  # of the tolerance; after a smaller error the next piece is twice as long
DONE, STIFF, LOST = range(3)  # outcome of a block: complete, too many pieces, numbers that are not finite


@jit_separate
def differences_at(law: GrowthLaw, state: Floats, slopes: Floats) -> None:
    """Compute the slopes of tangent vectors by central differences along each, without derivatives of the law."""
    n, first = state.shape[1], law.coordinates
    for c in range(1, state.shape[0]):
        for i in range(first, n):
            slopes[c, i] = 0.0
        for side in (1.0, -1.0):
            for i in range(n):
                law.y[i] = state[0, i] + side * law.nudge * law.sizes[i] * state[c, i]
            strode_by(law.entry, law.table, law.y_at, law.z_at, law.z_at)
            for i in range(first, n):
                slopes[c, i] += side * law.z[n - first + i] / (2.0 * law.nudge * law.sizes[i])


@jit_inline
def finish_piece(scheme: GrowthScheme, tangent: Tangent, h: float) -> float:
    """Combine the slopes of a piece into its end; return the estimated error of the vectors."""
    state, slopes, end = tangent.state, tangent.slopes, tangent.end
    b, of_fifth, of_third = scheme.b, scheme.fifth, scheme.third
    rows, n = state.shape
    fifth, third = 0.0, 0.0
    for c in range(rows):
        for i in range(n):
            increment, low, lower = 0.0, 0.0, 0.0
            for j in range(STAGES):
                slope = slopes[j, c, i]
                increment += b[j] * slope
                low += of_fifth[j] * slope
                lower += of_third[j] * slope
            end[c, i] = state[c, i] + h * increment
            if c > 0:
                fifth += low * low
                third += lower * lower
    # both estimates combined as in dop853 (Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.10)
    total = fifth + 0.01 * third
    return abs(h) * fifth / np.sqrt(total) if total > 0.0 else total  # nan stays nan


@jit_separate
def combine(state: Floats, slopes: Floats, a: Floats, s: int, h: float, stage: Floats) -> None:
    """Write stage s of an explicit Runge-Kutta step, state + h sum a[s, j] slopes[j], shape (1 + m, n), to `stage`."""
    rows, n = state.shape
    for c in range(rows):
        for i in range(n):
            stage[c, i] = state[c, i]
    for j in range(s):
        weight = h * a[s, j]
        if weight != 0.0:
            for c in range(rows):
                for i in range(n):
                    stage[c, i] += weight * slopes[j, c, i]


@jit_separate
def multiply_derivatives(
    e: Floats, weights: Floats, entries: IntArray, first: int, stage: Floats, slopes: Floats, s: int
) -> None:
    """Multiply every vector by the derivatives of accelerations and rates."""
    rows, n = stage.shape
    count = entries.shape[1]
    for c in range(1, rows):
        for i in range(first, n):
            slopes[s, c, i] = 0.0
        for j in range(count):
            slopes[s, c, entries[0, j]] += e[j] * weights[j] * stage[c, entries[1, j]]


@jit_inline
def advance_piece(law: GrowthLaw, scheme: GrowthScheme, tangent: Tangent, t: float, h: float) -> float:
    """Make one piece, to `tangent.end`; return the estimated error of the vectors."""
    # fields are named once: numba counts references, with an atomic operation, wherever an array is named
    state, stage, slopes, a, times = tangent.state, tangent.stage, tangent.slopes, scheme.a, scheme.c
    y, z, e, time_and_regime, entries, weights, ratios = (
        law.y,
        law.z,
        law.e,
        law.time_and_regime,
        law.entries,
        law.weights,
        law.ratios,
    )
    rows, n = state.shape
    first = law.coordinates
    for s in range(STAGES):
        combine(state, slopes, a, s, h, stage)
        for i in range(n):
            y[i] = stage[0, i]
        time_and_regime[T] = t + times[s] * h
        strode_by(law.entry, law.table, law.y_at, law.z_at, law.z_at)
        for i in range(first):
            slopes[s, 0, i] = stage[0, first + i]
            for c in range(1, rows):
                slopes[s, c, i] = stage[c, first + i] * ratios[i]
        for i in range(first, n):
            slopes[s, 0, i] = z[n - first + i]
        # differences evaluate the law again, into the same z: its accelerations are copied by now
        if law.nudge > 0.0:
            differences_at(law, stage, slopes[s])
        else:
            multiply_derivatives(e, weights, entries, first, stage, slopes, s)
    return finish_piece(scheme, tangent, h)


@jit_separate
def replace_vanished(vectors: Floats, c: int) -> None:
    """Replace a vector that has vanished by a unit vector orthogonal to those before it."""
    n = vectors.shape[1]
    for axis in range(n):
        for i in range(n):
            vectors[c, i] = 1.0 if i == axis else 0.0
        for k in range(1, c):
            projection = vectors[k, axis]
            for i in range(n):
                vectors[c, i] -= projection * vectors[k, i]
        size = 0.0
        for i in range(n):
            size += vectors[c, i] * vectors[c, i]
        if size > 0.5 / n:  # at least one of the n axes has a part of 1/n outside the span of fewer than n vectors
            for i in range(n):
                vectors[c, i] /= np.sqrt(size)
            return


@jit_inline
def orthonormalise(vectors: Floats, upper: Floats) -> None:
    """Factorise the rows of `vectors` from the second on, m of n numbers, as Q R; Q replaces them, R is `upper`.

    Modified Gram-Schmidt. A vector that depends on those before it has 0 on the diagonal of R.
    """
    rows, n = vectors.shape
    for c in range(1, rows):
        squared_length = 0.0
        for i in range(n):
            squared_length += vectors[c, i] * vectors[c, i]
        for k in range(1, c):
            projection = 0.0
            for i in range(n):
                projection += vectors[k, i] * vectors[c, i]
            upper[k - 1, c - 1] = projection
            for i in range(n):
                vectors[c, i] -= projection * vectors[k, i]
        size = 0.0
        for i in range(n):
            size += vectors[c, i] * vectors[c, i]
        if size <= DEPENDENT * DEPENDENT * squared_length:
            upper[c - 1, c - 1] = 0.0
            replace_vanished(vectors, c)
            continue
        size = np.sqrt(size)
        upper[c - 1, c - 1] = size
        for i in range(n):
            vectors[c, i] /= size


@jit_inline
def add_growth(tangent: Tangent, grown: Grown, block: int) -> None:
    """Add the growth of a piece to a block, and to that since the start."""
    upper, total, product = tangent.upper, tangent.total, tangent.product
    m = upper.shape[0]
    for c in range(m):
        factor = grown.factors[block, c] * upper[c, c]
        if factor > LARGE:
            factor, grown.exponents[block, c] = factor / LARGE, grown.exponents[block, c] + 1
        elif 0.0 < factor < 1.0 / LARGE:
            factor, grown.exponents[block, c] = factor * LARGE, grown.exponents[block, c] - 1
        grown.factors[block, c] = factor
    largest = 0.0
    for j in range(m):
        for k in range(j, m):
            entry = 0.0
            # both factors are upper triangular: outside j to k every term is zero
            for c in range(j, k + 1):
                entry += upper[j, c] * total[c, k]
            product[j, k] = entry
            largest = max(largest, abs(entry))
    scale, shift = 1.0, 0
    if largest > LARGE:
        scale, shift = 1.0 / LARGE, 1
    elif 0.0 < largest < 1.0 / LARGE:
        scale, shift = LARGE, -1
    tangent.exponents[0] += shift
    for j in range(m):
        for k in range(j, m):
            total[j, k] = product[j, k] * scale


@jit_separate
def apply_event_matrix(law: GrowthLaw, matrix: Floats, tangent: Tangent) -> None:
    """Multiply every vector by the matrix of an event."""
    state, end = tangent.state, tangent.end
    rows, n = state.shape
    for c in range(1, rows):
        for i in range(n):
            entry = 0.0
            for j in range(n):
                entry += matrix[i, j] * law.sizes[j] * state[c, j]
            end[c, i] = entry / law.sizes[i]
    for c in range(1, rows):
        for i in range(n):
            state[c, i] = end[c, i]


@jit_inline
def carry(law: GrowthLaw, scheme: GrowthScheme, tangent: Tangent, grown: Grown, block: int, t: float, t1: float) -> int:
    """Carry a state and its vectors to a time, in as many pieces as the tolerance requires."""
    while t < t1:
        remaining = t1 - t
        h = min(remaining, tangent.pace[0])
        last = h >= remaining
        error = advance_piece(law, scheme, tangent, t, h)
        tangent.pieces[0] += 1
        if tangent.pieces[0] > scheme.most_pieces:
            return STIFF
        # negated, so that nan counts as too large an error
        if not error <= scheme.tolerance:
            tangent.pace[0] = h / 2.0
            # an error that stays nan halves the piece until it is below the spacing of times
            if t + h / 2.0 == t:
                return LOST
            continue
        if error < SPARE * scheme.tolerance:
            tangent.pace[0] = max(tangent.pace[0], 2.0 * h)
        for c in range(tangent.state.shape[0]):
            for i in range(tangent.state.shape[1]):
                tangent.state[c, i] = tangent.end[c, i]
        orthonormalise(tangent.state, tangent.upper)
        add_growth(tangent, grown, block)
        grown.errors[block] += error
        # t + (t1 - t) may round to a neighbour of t1, and leave a piece of next to nothing
        t = t1 if last else t + h
    return DONE


def grow(law: GrowthLaw, scheme: GrowthScheme, rows: Rows, tangent: Tangent, grown: Grown) -> int:
    """Carry tangent vectors from the first of some rows to the last; return the outcome."""
    first_side = law.p.shape[0] - rows.sides.shape[1]
    for k in range(rows.times.shape[0] - 1):
        if rows.jumps[k] >= 0:
            apply_event_matrix(law, rows.matrices[rows.jumps[k]], tangent)
            orthonormalise(tangent.state, tangent.upper)
            add_growth(tangent, grown, rows.blocks[k])
        t, t1 = rows.times[k], rows.times[k + 1]
        # both rows of an event are at one time: only its matrix acts between them
        if not t1 > t:
            continue
        law.time_and_regime[REGIME] = rows.regimes[k]
        for i in range(rows.sides.shape[1]):
            law.p[first_side + i] = rows.sides[k, i]
        for i in range(rows.pieces.shape[1]):
            # the third of the three numbers of a drive's table is the piece that it is in
            law.places[3 * i + 2] = rows.pieces[k, i]
        # from the recorded state, so that the vectors belong to the run and not to where this integration drifts
        for i in range(rows.states.shape[1]):
            tangent.state[0, i] = rows.states[k, i]
        parts = rows.parts[k]
        for part in range(parts):
            begin = t + (t1 - t) * (part / parts)
            end = t1 if part == parts - 1 else t + (t1 - t) * ((part + 1) / parts)
            outcome: int = carry(law, scheme, tangent, grown, rows.blocks[k] + part, begin, end)
            if outcome != DONE:
                return outcome
    return DONE


def _fields_of(field_class: type, *fields: Any) -> Any:
    return Fields(field_class, fields)


_ROW, _BLOCK, _CUBE = (array_kind("f8", dims) for dims in (1, 2, 3))
_WHOLE, _LISTS = array_kind("i8", 1), array_kind("i8", 2)
GROWTH = EnginePart(
    "growth",
    "the growth of small changes",
    5,
    (
        (
            grow,
            signature_of(
                INTEGER,
                _fields_of(GrowthLaw, *[INTEGER] * 4, *[_ROW] * 5, _WHOLE, _LISTS, *[_ROW] * 3, INTEGER, FLOAT),
                _fields_of(GrowthScheme, _BLOCK, *[_ROW] * 4, FLOAT, INTEGER),
                _fields_of(Rows, _ROW, _BLOCK, _ROW, _BLOCK, _LISTS, _WHOLE, _CUBE, _WHOLE, _WHOLE),
                _fields_of(Tangent, *[_BLOCK] * 3, _CUBE, *[_BLOCK] * 3, _ROW, _WHOLE, _WHOLE),
                _fields_of(Grown, _BLOCK, _LISTS, _ROW),
            ),
        ),
    ),
)
