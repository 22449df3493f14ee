"""Enclosures of event functions between two states of the motion: intervals that contain every value on the way.

Between two states of a step, a coordinate is the Hermite polynomial through both positions, velocities and
accelerations, a first-order state the one through both values and rates, each widened by its distance from such
polynomials of lower degree; where the step leaves a polynomial of its own, as that of a collocation method does, it is
that one, and Hermite's where that is narrower (`elementary.curve_bounds`). Their Bernstein coefficients bound them, and
interval arithmetic, rounded outward, bounds the functions (Moore, Kearfott, Cloud, Introduction to Interval Analysis,
2009). The rows to compute come from `kernels.interval_program`.
"""

from __future__ import annotations

from math import inf
from typing import Any

from numpy.typing import NDArray

from xdynamics.elementary import bounds
from xdynamics.elementary.rounding_margins import BREAKS, SMOOTH, ULPS, UNBOUNDED
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.drive_tables import find_piece_of_table
from xdynamics.kernels.interval_program import CONSTANT, NUMBER, PHASE, RULES, SLOPE, TIME, UNKNOWN, VALUE, VARIABLE
from xdynamics.kernels.program import REGIME
from xdynamics.march.calls import floats_at, row_by, run_at
from xdynamics.march.run import ALIVE, ALL, Run

State = NDArray[Any]
below, above = jit_separate(bounds.below), jit_separate(bounds.above)


@jit_separate
def store_bounds(run: Run, target: int, low: float, high: float, flaw: int) -> None:
    """Store the bounds of a value."""
    run.under[target], run.over[target], run.flaws[target] = low, high, flaw


@jit_separate
def enclose_functions(run: Run, y: State, z: State, first: int, last: int, whose: int) -> None:
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
    in_box, sparse, piece = run.piece[0].rough == 2, whose != ALL, run.piece[0]
    roughly = len(RULES) if run.piece[0].rough == 1 else 0
    if sparse:
        mark_needed_values(run, first, last, whose)
    for k in range(first, last):
        row, target, a = run.rows[k, 0], run.rows[k, 1], run.rows[k, 2]
        if sparse and run.needed_intervals[target] == 0:
            continue
        if row < VARIABLE or (row < NUMBER and not in_box):
            row_by(run.functions[row + roughly], run, y, z, k)
        elif row == TIME and not in_box:
            store_bounds(run, target, piece.start, piece.end, SMOOTH)
        elif row == PHASE:
            store_bounds(run, target, run.at[REGIME], run.at[REGIME], SMOOTH)
        elif row == UNKNOWN:
            store_bounds(run, target, -inf, inf, SMOOTH)
        elif row == NUMBER:
            store_bounds(run, target, run.numbers[a], run.numbers[a], SMOOTH)
        elif row == CONSTANT:
            store_bounds(run, target, run.p[a], run.p[a], SMOOTH)
        elif row >= VALUE:
            enclose_table(run, row, target, a, run.rows[k, 3], run.rows[k, 4])


@jit_separate
def mark_needed_values(run: Run, first: int, last: int, whose: int) -> None:
    """Mark the values that event functions need and, as far as the rows reach, those of their derivatives."""
    for k in range(first, last):
        run.needed_intervals[run.rows[k, 1]] = 0
    for i in range(run.detectors.shape[0]):
        if i == whose or (whose == ALIVE and run.watches[i].alive):
            detector = run.detectors[i]
            run.needed_intervals[detector.value] = 1
            if last >= run.parts[2]:
                run.needed_intervals[detector.slope] = 1
            if last >= run.parts[3] and detector.bend >= 0:
                run.needed_intervals[detector.bend] = 1
    for k in range(last - 1, first - 1, -1):
        row = run.rows[k, 0]
        if run.needed_intervals[run.rows[k, 1]] and (row < VARIABLE or row >= VALUE):
            run.needed_intervals[run.rows[k, 2]] = 1
            if row < VARIABLE:  # an unused operand is place 0, whose value does no harm
                run.needed_intervals[run.rows[k, 3]] = run.needed_intervals[run.rows[k, 4]] = 1


@jit_separate
def enclose_table(run: Run, row: int, target: int, a: int, drive: int, of_time: int) -> None:
    """Enclose a drive or its slope over the pieces of the table that the argument passes through."""
    low, high, flaw = run.under[a], run.over[a], run.flaws[a]
    first, count = run.places[3 * drive], run.places[3 * drive + 1]
    if not (low > -inf and high < inf):
        store_bounds(run, target, -inf, inf, UNBOUNDED)
        return
    begin = run.places[3 * drive + 2] if of_time else find_piece_of_table(low, run.tables, first, count)
    end = begin if of_time else find_piece_of_table(high, run.tables, first, count)
    lowest, highest = inf, -inf
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
            store_bounds(run, target, -inf, inf, UNBOUNDED)
            return
        off = ULPS * (abs(c3 * to * to * to) + abs(c2 * to * to) + abs(c1 * to) + abs(c0))
        lowest = min(lowest, min(min(b0, b1), min(b2, z0)) - off)  # noqa: PLW3301 - two at a time: one order of comparisons
        highest = max(highest, max(max(b0, b1), max(b2, z0)) + off)  # noqa: PLW3301
    margin = run.plan[0].margin
    store_bounds(
        run, target, below(lowest, margin), above(highest, margin), flaw if begin == end else max(flaw, BREAKS)
    )


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
    enclose_functions(run_at(address), floats_at(y), floats_at(z), first, last, whose)
