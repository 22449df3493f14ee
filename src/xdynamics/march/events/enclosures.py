"""Enclosures of event functions between two states of the motion: intervals that contain every value on the way.

Between two states of a step, a coordinate is the Hermite polynomial through both positions, velocities and
accelerations, a first-order state the one through both values and rates, each widened by its distance from such
polynomials of lower degree; where the step leaves a polynomial of its own, as that of a collocation method does, it is
that one, and Hermite's where that is narrower (`elementary.bounds`). Their Bernstein coefficients bound them, and
interval arithmetic, rounded outward, bounds the functions (Moore, Kearfott, Cloud, Introduction to Interval Analysis,
2009). The rows to compute come from `kernels.interval_program`.

The operations on intervals are called by address: each reads its operands where a row says, and stores its result.

A silent region is a box of the variables of event functions: positions, velocities, states, time. Their enclosures show
once that none has a zero anywhere in it. While steps stay inside the box, a step costs only bounds of its positions,
however many detectors there are. A step that leaves the box is examined by itself, and the box grows, or a new one is
put around it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from math import inf
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary import SETS, bounds
from xdynamics.elementary.bounds import BREAKS, POLYNOMIALS, SMOOTH, ULPS, UNBOUNDED, Interval, on_curve
from xdynamics.elementary.intervals import Intervals
from xdynamics.elementary.numbers import FunctionLines, LaneValue
from xdynamics.elementary.text import count_calls, declarations, definitions, written_intervals
from xdynamics.kernels import machine
from xdynamics.kernels.compiling import PLAINLY, jit_inline, jit_separate, keys_of
from xdynamics.kernels.drive_tables import find_piece_of_table
from xdynamics.kernels.interval_program import (
    CONSTANT,
    NUMBER,
    OPERANDS,
    PHASE,
    RULES,
    SLOPE,
    TIME,
    UNKNOWN,
    VALUE,
    VARIABLE,
    VARIABLES,
)
from xdynamics.kernels.program import REGIME, WORDS
from xdynamics.march.calls import enclosed_by, floats_at, row_by, run_at
from xdynamics.march.run import ALIVE, ALL, ARRAYS, ENCLOSE, PIECE, PLAN, Run

Rule = tuple[str, bool]  # an operation, and whether it is for a first look at a step
ROUGH = ("sin", "cos")  # those that a first look evaluates once instead of twice
_KEPT: list[machine.Code] = []  # as long as the process, as the addresses


def operation_addresses(math_functions: str, degree: int) -> NDArray[np.int64]:
    """Return addresses of operations in the order of `RULES`, then of rough ones.

    Variables are enclosed by the polynomial of some degree that a step leaves, or by Hermite's where that is 0.
    """
    fine = [name for name in RULES if name not in VARIABLES]
    rules = *((name, False) for name in fine), *((name, True) for name in ROUGH)
    # in two texts, of which the first is the same for all models: compiled once per installation
    address = _operations(math_functions, rules, 0)
    address = address | _operations(math_functions, tuple((name, False) for name in VARIABLES), degree)
    exact = [address[name, False] for name in RULES]
    return np.array([*exact, *(address.get((name, True), exact[i]) for i, name in enumerate(RULES))], np.int64)


@lru_cache(maxsize=64)
def _operations(math_functions: str, requested_rules: tuple[Rule, ...], degree: int) -> dict[Rule, int]:
    return (_plain_operations if PLAINLY else _compiled_operations)(math_functions, requested_rules, degree)


def _compiled_operations(math_functions: str, requested_rules: tuple[Rule, ...], degree: int) -> dict[Rule, int]:
    symbols = {rule: f"{rule[0]}_{'roughly' if rule[1] else 'finely'}" for rule in requested_rules}
    entries = "\n".join(_print_operation(symbol, *rule, degree) for rule, symbol in symbols.items())
    functions = definitions(dict.fromkeys(count_calls(entries), False), 1, math_functions)
    _KEPT.append(machine.compiled(f"{declarations(1)}\n{functions}\n{entries}", symbols.values()))
    return {rule: _KEPT[-1].addresses[symbol] for rule, symbol in symbols.items()}


def _plain_operations(math_functions: str, requested_rules: tuple[Rule, ...], degree: int) -> dict[Rule, int]:
    keys = keys_of(in_python(name, math_functions, rough=rough, degree=degree) for name, rough in requested_rules)
    return dict(zip(requested_rules, keys, strict=True))


def in_python(
    name: str, math_functions: str, *, rough: bool = False, degree: int = 0
) -> Callable[[Run, Any, Any, int], None]:
    """Return an operation as a function of a run, two of its states and the number of a row, in plain Python."""

    def operation(run: Run, y: Any, z: Any, row: int) -> None:
        target, *places = run.rows[row, 1 : 2 + OPERANDS[name]].tolist()
        kind = Intervals(SETS[math_functions], float(run.plan[0].margin), rough)
        if name in VARIABLES:
            piece, error = run.piece[0], float(run.piece[0].wide * abs(run.located_e[places[VARIABLES[name]]]))
            ends = [[float(state[state_index]) for state in (y, z)] for state_index in places]
            operands: list[Any] = [
                *(end[k] for k in range(2) for end in ends),
                float(piece.width),
                error,
                int(piece.part),
            ]
            if degree:
                coefficients = [
                    float(run.w[k]) for k in _coefficient_indices(run.plan[0], places[: POLYNOMIALS[name]], degree)
                ]
                shares = float(piece.full), float(piece.first), float(piece.last)
                operands = [*coefficients, *(number for end in ends for number in end), *operands[-3:], *shares]
        else:
            operands = [Interval(float(run.under[k]), float(run.over[k]), int(run.flaws[k])) for k in places]
        run.under[target], run.over[target], run.flaws[target] = kind.of(_operation(name, degree), *operands)

    return operation


def _operation(name: str, degree: int) -> str:
    """Return the name of an operation among those of `elementary.intervals`."""
    return on_curve(name) if degree and name in VARIABLES else name


def _coefficient_indices(plan: Any, places: Sequence[int], degree: int) -> list[int]:
    """Return where in `w` the coefficients of components are."""
    return [int(plan.curve + power * plan.used) + state_index for state_index in places for power in range(degree + 1)]


def _print_operation(symbol: str, name: str, rough: bool, degree: int) -> str:
    """Print an operation as a function of a run's table, two of its states and a row."""
    write = _Lines(1)
    under_array, over_array, flaws = (write.array(array) for array in ("under", "over", "flaws"))
    target, *places = (write.word("%row", 1 + k).text for k in range(1 + OPERANDS[name]))
    kind = written_intervals(write, write.field(PLAN, "plan", "margin"), rough=rough)
    if name in VARIABLES:
        ends = [[write.number(state, state_index) for state in ("%y", "%z")] for state_index in places]
        error = write.number(write.array("located_e"), places[VARIABLES[name]]).absolute()
        width, wide, part = (write.field(PIECE, "piece", field) for field in ("width", "wide", "part"))
        operands: list[Any] = [*(end[k] for k in range(2) for end in ends), width, wide * error, part]
        if degree:
            shares = [write.field(PIECE, "piece", field) for field in ("full", "first", "last")]
            coefficients = write.coefficients(places[: POLYNOMIALS[name]], degree)
            operands = [*coefficients, *(number for end in ends for number in end), *operands[-3:], *shares]
    else:
        operands = [
            Interval(write.number(under_array, k), write.number(over_array, k), write.word(flaws, k)) for k in places
        ]
    for value, letter, array in zip(
        map(write.value, kind.of(_operation(name, degree), *operands)),
        ("double", "double", "i64"),
        (under_array, over_array, flaws),
        strict=True,
    ):
        write.lines.append(f"store {letter} {value.text}, ptr {write.word_address(array, target)}, align 8")
    body = "\n  ".join(write.lines)
    return f"define void @{symbol}(ptr %run, ptr %y, ptr %z, ptr %row) nounwind {{\n  {body}\n  ret void\n}}"


class _Lines(FunctionLines):
    """Lines that read arrays of a run."""

    def word_address(self, begin: str, number: int | str) -> str:
        """Write the address of a word."""
        return self.line("p", f"getelementptr i64, ptr {begin}, i64 {number}").text

    def word(self, begin: str, number: int | str) -> LaneValue:
        """Read an integer."""
        return self.line("w", f"load i64, ptr {self.word_address(begin, number)}, align 8")

    def number(self, begin: str, number: int | str) -> LaneValue:
        """Read a number."""
        return self.line("n", f"load double, ptr {self.word_address(begin, number)}, align 8")

    def coefficients(self, places: Sequence[str], degree: int) -> list[LaneValue]:
        """Read those of the step's polynomial, of components of the state."""
        array, used = self.array("w"), self.field(PLAN, "plan", "used").text
        values_read, first = [], self.field(PLAN, "plan", "curve").text
        for state_index in places:
            term = self.line("w", f"add i64 {first}, {state_index}").text
            for power in range(degree + 1):
                if power:
                    term = self.line("w", f"add i64 {term}, {used}").text
                values_read.append(self.number(array, term))
        return values_read

    def array(self, name: str) -> str:
        """Write where an array begins."""
        entry_address = self.word_address("%run", WORDS * list(ARRAYS).index(name))
        # a run's arrays stay where they are; without the mark LLVM would load their addresses again after every store
        return self.line("p", f"load ptr, ptr {entry_address}, align 8, !invariant.load !0").text

    def field(self, record: Any, array: str, name: str) -> LaneValue:
        """Read a field of an array's only record."""
        dtype, offset = record.fields[name][:2]
        return (self.number if dtype.kind == "f" else self.word)(self.array(array), offset // 8)


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
    # negated, so that a nan bound is unbounded too
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
        # of which the least and the greatest bound the cubic
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


# of `Run.region`: whether there is a box, how many widths of a step it reaches beyond the step, for how many steps none
# is tried, and how many of these are left; then the box, and after it the bounds of the step
STANDS, REACH, PAUSE, WAIT, BOX = range(5)
POSITION, INSTANT, OTHER = range(3)  # kinds of variables of the box
FARTHEST, LONGEST = 64.0, 16.0
GROWN = 0.5  # of the width of a step that left the box: how far the box grows beyond it
SLACK = (
    1e-9  # of a bound: `coordinate_bounds` takes fewer operations than the enclosure, which its bounds have to contain
)


@jit_inline
def stays_in_region(run: Run) -> bool:
    """Whether all variables of event functions stay inside the box during the trial."""
    now, trial, piece, n = run.now[0], run.trial[0], run.piece[0], run.box_variables.shape[0]
    if run.region[STANDS] == 0.0:
        return False
    piece.start, piece.end, piece.width, piece.wide = now.t, trial.t, trial.h, 0.0
    piece.rough, piece.part = 1, 0
    for j in range(n):
        sort, k = run.box_variables[j, 0], run.box_variables[j, 1]
        low, high = now.t, trial.t
        if sort == POSITION:
            low, high = coordinate_bounds(run, k)
        elif sort == OTHER:
            enclosed_by(run.functions[ENCLOSE], run, run.y, run.z, k, k + 1, ALL)
            low, high = run.under[run.rows[k, 1]], run.over[run.rows[k, 1]]
        # negated, so that nan counts as outside the box
        if not (run.region[BOX + j] <= low and high <= run.region[BOX + n + j]):
            return False
    return True


@jit_inline
def coordinate_bounds(run: Run, i: int) -> tuple[float, float]:
    """Bounds of a coordinate between the states y and z, in few operations: they contain those of `enclose_between`."""
    n, used, w = run.plan[0].coordinates, run.plan[0].used, run.trial[0].h
    q0, v0, a0, q1, v1, a1 = run.y[i], run.y[n + i], run.y[used + i], run.z[i], run.z[n + i], run.z[used + i]
    # inner Bernstein coefficients of Hermite's quintic are q + h v/5 and q + 2 h v/5 + h**2 a/20: the sums below
    # reach beyond both
    slant0, slant1, bend0, bend1 = 0.4 * w * v0, -0.4 * w * v1, 0.05 * w * w * a0, 0.05 * w * w * a1
    # `odd` vanishes for every quartic and `even` for every cubic: they shrink faster with the step than the motion
    # does
    odd = abs((q1 - q0) - 0.5 * w * (v0 + v1) + (w * w * (1.0 / 12.0)) * (a1 - a0))
    even = abs(w * (v1 - v0) - 0.5 * w * w * (a0 + a1))
    size = max(abs(q0), abs(q1)) + abs(slant0) + abs(slant1) + abs(bend0) + abs(bend1)
    off = odd + even * (1.0 / 128.0) + SLACK * size
    low = min(q0 + min(slant0, 0.0) + min(bend0, 0.0), q1 + min(slant1, 0.0) + min(bend1, 0.0))
    high = max(q0 + max(slant0, 0.0) + max(bend0, 0.0), q1 + max(slant1, 0.0) + max(bend1, 0.0))
    return low - off, high + off


@jit_separate
def end_region(run: Run) -> None:
    """Discard the box: after an event or a node, event functions change, or have to stay on other sides."""
    if run.box_variables.shape[0] > 0:
        run.region[STANDS] = 0.0


@jit_separate
def set_region(run: Run) -> None:
    """Extend the last box by the trial just enclosed, or put a new box around that trial."""
    n, region = run.box_variables.shape[0], run.region
    if region[WAIT] > 0.0:
        region[WAIT] -= 1.0
        return
    for j in range(n):
        target = run.box_variables[j, 2]
        low, high = (
            coordinate_bounds(run, run.box_variables[j, 1])
            if run.box_variables[j, 0] == POSITION
            else (run.under[target], run.over[target])
        )
        region[BOX + 2 * n + j], region[BOX + 3 * n + j] = low, high
    run.piece[0].rough = 2
    stands = region[STANDS] != 0.0 and (is_silent(run, GROWN, True) or is_silent(run, GROWN / 8.0, True))
    if not stands:
        stands = is_silent(run, max(region[REACH], GROWN), False)
        region[REACH] = min(FARTHEST, 2.0 * max(region[REACH], GROWN)) if stands else region[REACH] / 4.0
    run.piece[0].rough = 0
    region[STANDS] = 1.0 if stands else 0.0
    region[PAUSE] = 1.0 if stands else min(LONGEST, 2.0 * max(1.0, region[PAUSE]))
    region[WAIT] = 0.0 if stands else region[PAUSE]


@jit_separate
def is_silent(run: Run, reach: float, joins_last_box: bool) -> bool:
    """Whether no event function has a zero in a box `reach` widths beyond the step, joined to the last box or not."""
    n, region = run.box_variables.shape[0], run.region
    for j in range(n):
        target, low, high = run.box_variables[j, 2], region[BOX + 2 * n + j], region[BOX + 3 * n + j]
        beyond = reach * (high - low)
        if joins_last_box:
            box_low, box_high = region[BOX + j], region[BOX + n + j]
            low, high = (
                min(box_low, low - beyond if low < box_low else low),
                max(box_high, high + beyond if high > box_high else high),
            )
        else:
            low, high = low - beyond, high + beyond
        run.under[target], run.over[target] = low, high
    enclosed_by(run.functions[ENCLOSE], run, run.y, run.z, run.parts[0], run.parts[1], ALL)
    for i in range(run.detectors.shape[0]):
        if may_reach_zero(run, i):
            return False
    for j in range(n):
        region[BOX + j], region[BOX + n + j] = run.under[run.box_variables[j, 2]], run.over[run.box_variables[j, 2]]
    return True


@jit_inline
def may_reach_zero(run: Run, i: int) -> bool:
    """Whether bounds of an event function leave open that it reaches zero, or is on the side that it is guarded from."""
    value_index, watch = run.detectors[i].value, run.watches[i]
    keeps_side = (watch.armed > 0 and run.under[value_index] > 0.0) or (watch.armed < 0 and run.over[value_index] < 0.0)
    return bool(watch.asleep == 0 and not (keeps_side and (watch.guard == 0 or watch.armed == watch.guard)))
