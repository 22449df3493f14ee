"""Enclosures of event functions between two states of the motion: intervals that contain every value on the way.

Between two states of a step, a coordinate is the Hermite polynomial through both positions, velocities and
accelerations, a first-order state the one through both values and rates, each widened by its distance from such
polynomials of lower degree. Their Bernstein coefficients bound them, and interval arithmetic, rounded outward, bounds
the functions (Moore, Kearfott, Cloud, Introduction to Interval Analysis, 2009). The rows to compute come from
`kernels.interval_program`.
"""

from __future__ import annotations

from math import inf
from typing import Any

from numpy.typing import NDArray

from xdynamics.kernels.compiling import compiled, shared
from xdynamics.kernels.drive_tables import find_piece
from xdynamics.kernels.interval_program import (
    CONSTANT,
    COORDINATE,
    NUMBER,
    PHASE,
    SLOPE,
    STATE,
    TIME,
    UNKNOWN,
    VALUE,
)
from xdynamics.kernels.program import REGIME
from xdynamics.kernels.rounding_margins import ARCHED, BENT, BREAKS, ROUNDED, SMOOTH, ULPS, UNBOUNDED
from xdynamics.march.events.intervals import (
    DIVIDE,
    above,
    arithmetic,
    below,
    function,
    least_of,
    most_of,
    put,
)
from xdynamics.march.handle import floats_at, run_at
from xdynamics.march.run import ALIVE, ALL, Run

State = NDArray[Any]


@shared
def enclose(run: Run, y: State, z: State, first: int, last: int, whose: int) -> None:
    """Compute rows of the event functions on the piece between two states.

    Parameters
    ----------
    run : Run
        Its `piece` has the times of the states; `under`, `over` and `flaws` are filled.
    y, z : ndarray
        The state at the piece's start and end.
    first, last : int
        Rows.
    whose : int
        The number of an event function, `ALL`, or `ALIVE`: rows that these do not need are skipped.
    """
    in_box, sparse = run.piece[0].rough == 2, whose != ALL
    if sparse:
        demand(run, first, last, whose)
    for k in range(first, last):
        row, target, a = run.rows[k, 0], run.rows[k, 1], run.rows[k, 2]
        if sparse and run.wanted[target] == 0:
            continue
        if row <= DIVIDE:
            arithmetic(run, row, target, a, run.rows[k, 3])
        elif row in (COORDINATE, STATE, TIME):
            if not in_box:
                variable(run, y, z, k)
        elif row == PHASE:
            put(run, target, run.at[REGIME], run.at[REGIME], SMOOTH)
        elif row == UNKNOWN:
            put(run, target, -inf, inf, SMOOTH)
        elif row == NUMBER:
            put(run, target, run.numbers[a], run.numbers[a], SMOOTH)
        elif row == CONSTANT:
            put(run, target, run.p[a], run.p[a], SMOOTH)
        elif row >= VALUE:
            looked_up(run, row, target, a, run.rows[k, 3], run.rows[k, 4])
        else:
            function(run, row, target, a, run.rows[k, 3], run.rows[k, 4])


@shared
def demand(run: Run, first: int, last: int, whose: int) -> None:
    """Mark the values that event functions need and, as far as the rows reach, those of their derivatives."""
    for k in range(first, last):
        run.wanted[run.rows[k, 1]] = 0
    for i in range(run.detectors.shape[0]):
        if i == whose or (whose == ALIVE and run.watches[i].alive):
            detector = run.detectors[i]
            run.wanted[detector.value] = 1
            if last >= run.parts[2]:
                run.wanted[detector.slope] = 1
            if last >= run.parts[3] and detector.bend >= 0:
                run.wanted[detector.bend] = 1
    for k in range(last - 1, first - 1, -1):
        row = run.rows[k, 0]
        if run.wanted[run.rows[k, 1]] and (row < NUMBER or row >= VALUE):
            run.wanted[run.rows[k, 2]] = 1
            if row < NUMBER:  # an unused operand is place 0, whose value does no harm
                run.wanted[run.rows[k, 3]] = run.wanted[run.rows[k, 4]] = 1


@compiled
def variable(run: Run, y: State, z: State, k: int) -> None:
    """Enclose the time, a variable of the state, or its derivative."""
    row, target = run.rows[k, 0], run.rows[k, 1]
    if row == COORDINATE:
        coordinate(run, y, z, target, run.rows[k, 2], run.rows[k, 3])
    elif row == STATE:
        companion(run, y, z, target, run.rows[k, 2], run.rows[k, 3])
    else:
        put(run, target, run.piece[0].start, run.piece[0].end, SMOOTH)


@compiled
def coordinate(run: Run, y: State, z: State, target: int, i: int, order: int) -> None:
    """Enclose a coordinate, its velocity or its acceleration.

    Bounds of velocities by positions are divided by the width of the piece. On a piece made short by cutting, rounding
    would dominate them, and so would the mismatch of positions and velocities of a method of low order: there,
    velocities are bounded by accelerations, and accelerations by their change.
    """
    n, used, w = run.plan[0].coordinates, run.plan[0].used, run.piece[0].width
    q0, v0, a0, q1, v1, a1 = y[i], y[n + i], y[used + i], z[i], z[n + i], z[used + i]
    # how far cubic polynomials through positions and velocities are from the quintic one, at its middle
    odd = abs((q1 - q0) - w * (v0 + v1) / 2.0 + w * w * (a1 - a0) / 12.0)
    even = abs(v1 - v0 - w * (a0 + a1) / 2.0)
    off, size = odd + w * even / 128.0, max(abs(q0), abs(q1))
    if order == 0:
        b1, b2 = q0 + w * v0 / 5.0, q0 + 2.0 * w * v0 / 5.0 + w * w * a0 / 20.0
        b4, b3 = q1 - w * v1 / 5.0, q1 - 2.0 * w * v1 / 5.0 + w * w * a1 / 20.0
        low = min(least_of(q0, b1, b2, b3), least_of(b4, q1, b4, q1))
        high = max(most_of(q0, b1, b2, b3), most_of(b4, q1, b4, q1))
        off = off + ROUNDED * size + run.piece[0].wide * abs(run.located_e[i])
    elif order == 1:
        b1, b2 = v0 + w * a0 / 3.0, v1 - w * a1 / 3.0
        low, high = least_of(v0, b1, b2, v1), most_of(v0, b1, b2, v1)
        off = 4.0 * off / w if w > 0.0 else 0.0
        if run.piece[0].part or odd <= 4.0 * ROUNDED * (size + w * max(abs(v0), abs(v1))):
            off = min(off, w * max(abs(a0), abs(a1)))
        off = off + ROUNDED * max(abs(v0), abs(v1)) + run.piece[0].wide * abs(run.located_e[n + i])
    else:
        low, high = min(a0, a1), max(a0, a1)
        bent = 24.0 * odd / (w * w) if w > 0.0 else 0.0
        if run.piece[0].part:
            bent = min(bent, abs(a1 - a0))
        off = bent + 2.0 * even / w if w > 0.0 else 0.0
        off = off + ROUNDED * max(abs(a0), abs(a1))
    put(run, target, below(run, low - off), above(run, high + off), SMOOTH)


@compiled
def companion(run: Run, y: State, z: State, target: int, i: int, order: int) -> None:
    """Enclose a first-order state or its rate."""
    n, used, w = run.plan[0].coordinates, run.plan[0].used, run.piece[0].width
    x0, r0, x1, r1 = y[2 * n + i], y[used + n + i], z[2 * n + i], z[used + n + i]
    odd, even = abs((x1 - x0) - w * (r0 + r1) / 2.0), w * abs(r1 - r0)
    off = odd / 8.0 + even / 64.0
    if order == 0:
        b1, b2 = x0 + w * r0 / 3.0, x1 - w * r1 / 3.0
        low, high = least_of(x0, b1, b2, x1), most_of(x0, b1, b2, x1)
        off = off + ROUNDED * max(abs(x0), abs(x1)) + run.piece[0].wide * abs(run.located_e[2 * n + i])
    else:
        low, high = min(r0, r1), max(r0, r1)
        off = (ARCHED * odd + BENT * even) / w if w > 0.0 else 0.0
        off = off + ROUNDED * max(abs(r0), abs(r1))
    put(run, target, below(run, low - off), above(run, high + off), SMOOTH)


@shared
def looked_up(run: Run, row: int, target: int, a: int, drive: int, of_time: int) -> None:
    """Enclose a drive or its slope over the pieces of the table that the argument passes through."""
    low, high, flaw = run.under[a], run.over[a], run.flaws[a]
    first, count = run.places[3 * drive], run.places[3 * drive + 1]
    if not (low > -inf and high < inf):
        put(run, target, -inf, inf, UNBOUNDED)
        return
    begin = run.places[3 * drive + 2] if of_time else find_piece(low, run.tables, first, count)
    end = begin if of_time else find_piece(high, run.tables, first, count)
    least, most = inf, -inf
    for piece in range(begin, end + 1):
        start = run.tables[first + piece]
        from_ = (low if piece == begin else start) - start
        to = (high if piece == end else run.tables[first + piece + 1]) - start
        c3, c2 = run.tables[first + count + piece], run.tables[first + 2 * count + piece]
        c1, c0 = run.tables[first + 3 * count + piece], run.tables[first + 4 * count + piece]
        if row == SLOPE:
            c3, c2, c1, c0 = 0.0, 3.0 * c3, 2.0 * c2, c1
        # Bernstein coefficients of the cubic between the two
        u, w = from_, to - from_
        b0 = ((c3 * u + c2) * u + c1) * u + c0
        b1 = b0 + w * (((3.0 * c3 * u) + 2.0 * c2) * u + c1) / 3.0
        z0 = ((c3 * to + c2) * to + c1) * to + c0
        b2 = z0 - w * (((3.0 * c3 * to) + 2.0 * c2) * to + c1) / 3.0
        if not (abs(b0) + abs(b1) + abs(b2) + abs(z0) < inf):
            put(run, target, -inf, inf, UNBOUNDED)
            return
        off = ULPS * (abs(c3 * to * to * to) + abs(c2 * to * to) + abs(c1 * to) + abs(c0))
        least = min(least, least_of(b0, b1, b2, z0) - off)
        most = max(most, most_of(b0, b1, b2, z0) + off)
    put(run, target, below(run, least), above(run, most), flaw if begin == end else max(flaw, BREAKS))


def enclose_between(address: Any, y: Any, z: Any, first: int, last: int, whose: int) -> None:
    """Enclose event functions for callers by address, none of which compiles this again.

    Parameters
    ----------
    address : int
        Of a `Run`.
    y, z : int
        The addresses of two of its states.
    first, last : int
        Rows.
    whose : int
        The number of an event function, `ALL`, or `ALIVE`.
    """
    enclose(run_at(address), floats_at(y), floats_at(z), first, last, whose)
