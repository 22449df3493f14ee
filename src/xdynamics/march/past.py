"""The past of a march with delays: a polynomial of every accepted step, and the breaking points to come.

Where the motion has a jump or a kink, a delayed value has one a delay later, and the motion one that is smoother by a
derivative: the march lands on such points up to the order of the method (Hairer, Norsett, Wanner, Solving ODEs I,
section II.17). Between two of them lies a stretch, and a step reads delayed values on its own side of the points that
it lands on.

Before the march, room is made for its past, and the delays and known breaking points are listed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.bounds import EPS
from xdynamics.elementary.piecewise import BEGIN, HEAD, LENGTH, STRETCH, width_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.kernels import Law
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.layout import past_degree
from xdynamics.kernels.program import T1, H, T
from xdynamics.march.calls import call_law
from xdynamics.march.run import BOOK, DELAY, Run
from xdynamics.methods.scheme import Scheme
from xdynamics.model import Model
from xdynamics.model.delays import in_history
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import constants, drive_pieces
from xdynamics.units import TIME, UNSCALED, Scales

ROUNDING = 8.0 * EPS  # of a time: two breaking points that differ by less are one


@jit_separate
def begin_past(run: Run) -> None:
    """Begin with an empty past, and the breaking points of the start and of tables before it."""
    if run.delays.shape[0] == 0:
        return
    book = run.book[0]
    book.pieces, book.stretch, book.crossing, book.aimed, book.breaks = 0, 0, 0, 0, 0
    for k in range(run.first_breaks.shape[0]):
        add_break(run, run.first_breaks[k], 2)
    echo(run, run.now[0].t, 0)
    enter_past(run, run.now[0].t)


@jit_separate
def echo(run: Run, t: float, level: int) -> None:
    """Add the breaking points one delay after a given one; `level` is the derivative that jumps there."""
    for k in range(run.delays.shape[0]):
        add_break(run, t + run.delays[k].time, level + 1)


@jit_separate
def add_break(run: Run, t: float, level: int) -> None:
    """Insert a future breaking point in order of time, unless it is smoother than the method's order resolves."""
    book = run.book[0]
    if level > book.most:
        return
    break_index = book.breaks
    while break_index > 0 and run.breaks[0, break_index - 1] > t:
        break_index -= 1
    close = ROUNDING * max(abs(t), abs(run.plan[0].start))
    for near in (break_index - 1, break_index):
        if 0 <= near < book.breaks and abs(run.breaks[0, near] - t) <= close:
            run.breaks[1, near] = min(run.breaks[1, near], float(level))
            return
    for k in range(book.breaks, break_index, -1):
        run.breaks[0, k], run.breaks[1, k] = run.breaks[0, k - 1], run.breaks[1, k - 1]
    run.breaks[0, break_index], run.breaks[1, break_index] = t, level
    book.breaks += 1


@jit_separate
def soonest(run: Run, node: float) -> float:
    """Return the next time to land on: a node, or a breaking point before it."""
    book = run.book[0]
    book.aimed = 0
    if book.breaks > 0 and run.breaks[0, 0] < node - run.snaps[run.now[0].node]:
        book.aimed = 1
        return float(run.breaks[0, 0])
    return node


@jit_separate
def pass_breaks(run: Run, t: float, level: int) -> None:
    """Remove the breaking points at the march's landing, and add their echoes; a node has a level or -1."""
    book, lowest_level = run.book[0], np.int64(level)
    close = ROUNDING * max(abs(t), abs(run.plan[0].start))
    passed = 0
    while passed < book.breaks and run.breaks[0, passed] <= t + close:
        break_level = np.int64(run.breaks[1, passed])
        lowest_level = break_level if lowest_level < 0 or break_level < lowest_level else lowest_level
        passed += 1
    for k in range(passed, book.breaks):
        run.breaks[0, k - passed], run.breaks[1, k - passed] = run.breaks[0, k], run.breaks[1, k]
    book.breaks -= passed
    if lowest_level >= 0:
        break_here(run, t, lowest_level)
        book.crossing = 1


@jit_separate
def break_here(run: Run, t: float, level: int) -> None:
    """Begin a new stretch, since the motion has a jump or a kink here."""
    run.book[0].stretch += 1
    echo(run, t, level)


@jit_separate
def note_past(run: Run) -> None:
    """Keep the polynomial of the trial, before anything changes its end."""
    book, trial, state = run.book[0], run.trial[0], run.whole
    for i in range(state.shape[0]):
        state[i] = run.z[i]
    run.at[T], run.at[T1], run.at[H] = run.now[0].t, trial.t, trial.h
    call_law(run.law[run.plan[0].polynomial], run, run.y, state, 0)
    run.now[0].evaluations += book.evaluations
    first, curve = book.pieces * book.width, run.plan[0].curve
    run.past_steps[first + BEGIN], run.past_steps[first + LENGTH] = run.now[0].t, trial.h
    run.past_steps[first + STRETCH] = book.stretch
    for i in range(book.width - HEAD):
        run.past_steps[first + HEAD + i] = run.w[curve + i]
    book.pieces += 1


@jit_separate
def enter_past(run: Run, until: float) -> None:
    """Set every delay to the pieces of the past that a step up to a time reads, or to the history.

    They are those of the stretch in which the step begins to read, and all that begin before it ends to: a stretch ends,
    too, at breaking points that are too smooth for a step to end a delay later.
    """
    if run.delays.shape[0] == 0:
        return
    book, t, start = run.book[0], run.now[0].t, run.plan[0].start
    close = ROUNDING * max(abs(t), abs(start))
    for k in range(run.delays.shape[0]):
        x, piece_index = t - run.delays[k].time + close, 3 * (book.slot + k)
        is_before_start = x < start or book.pieces == 0
        run.p[run.delays[k].flag] = 1.0 if is_before_start else 0.0
        run.places[piece_index], run.places[piece_index + 1] = book.first, 0
        if not is_before_start:
            piece = max(0, last_within(run, BEGIN, x))
            stretch = run.past_steps[piece * book.width + STRETCH]
            # numbers are whole: half of one less finds the last piece of an earlier stretch
            low = last_within(run, STRETCH, stretch - 0.5) + 1
            read_last = last_within(run, BEGIN, until - run.delays[k].time - close)
            high = max(last_within(run, STRETCH, stretch), read_last)
            run.places[piece_index], run.places[piece_index + 1] = book.first + low * book.width, high + 1 - low


@jit_separate
def last_within(run: Run, number: int, bound: float) -> int:
    """Return the last piece whose number is at most a bound, -1 if there is none; numbers ascend."""
    low, high, width = 0, run.book[0].pieces, run.book[0].width
    while low < high:
        middle = (low + high) // 2
        if run.past_steps[middle * width + number] <= bound:
            low = middle + 1
        else:
            high = middle
    return low - 1


@jit_separate
def has_room_for_past(run: Run) -> bool:
    """Whether one more step fits, with all the breaking points that follow from it."""
    book = run.book[0]
    return (book.pieces + 1) * book.width <= run.past_steps.shape[0] and book.breaks + 3 * run.delays.shape[
        0
    ] <= run.breaks.shape[1]


Floats = NDArray[np.float64]
PIECES, BREAKS = 256, 64  # for which there is room at first


class Past(NamedTuple):
    """The steps of a finished run: their pieces, and the counts of these."""

    pieces: Floats
    book: NDArray[Any]

    def lend(self, run: Run) -> None:
        """Let a run of equal model and method read this past."""
        lend_past(run, self.pieces, self.pieces.size)
        run.book[...] = self.book


def delay_times(model: Model, scales: Scales = UNSCALED) -> Floats:
    """Return the delays as numbers, in SI units over the scales."""
    if not model.delays:
        return np.zeros(0)  # without the constants of every element
    constant_values = constants(model, scales)
    return np.array([evaluate(delay, constant_values) for delay in model.delays])


def past_arrays(
    model: Model, law: Law, scales: Scales, tables: Floats, places: NDArray[np.int64]
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a run for delayed values, none without delays; `tables` and `places` with room for them."""
    layout, count, start = law.layout, len(model.delays), model.statement.initial["t"].si / scales.si_factor(TIME)
    first_breaks = np.zeros(0)
    delays, book = np.zeros(count, DELAY), np.zeros(min(count, 1), BOOK)
    if count:
        names = [*constants(model, scales)]
        delays["time"] = delay_times(model, scales)
        delays["flag"] = [names.index(in_history(delay)) for delay in range(count)]
        pairs = zip(model.elements.looked_up_at.values(), drive_pieces(model, scales), strict=True)
        knots = np.concatenate([np.empty(0), *(origins for argument, (origins, _) in pairs if argument == CLOCK)])
        echoes = np.ravel(knots[knots <= start, None] + delays["time"])
        first_breaks = np.unique(echoes[echoes > start])
        width = width_of(layout.used.size, past_degree(layout))
        book["first"], book["width"], book["slot"] = tables.size, width, len(layout.drives)
        book["most"], book["evaluations"] = law.scheme.order + 1, _polynomial_evaluations(law.scheme)
        tables, places = np.append(tables, np.zeros(PIECES * width)), np.append(places, np.zeros(3 * count, np.int64))
        places[3 * len(layout.drives) :: 3] = book["first"][0]
    first = int(book["first"][0]) if count else tables.size
    return {
        "tables": tables,
        "places": places,
        "past_steps": tables[first:],
        "delays": delays,
        "book": book,
        "breaks": np.zeros((2, BREAKS + first_breaks.size + 3 * count if count else 0)),
        "first_breaks": first_breaks,
    }


def jumps_at(nodes: Floats, knots: Floats, ticks: Floats) -> NDArray[np.int64]:
    """Return which derivative of the motion jumps at each node: none (-1), or that at a point of a table or at a tick."""
    if not nodes.size:  # a fifth of the time in which a run is posed
        return np.zeros(0, np.int64)
    return np.where(np.isin(nodes, ticks), 0, np.isin(nodes, knots) * 2 - 1)


def _polynomial_evaluations(scheme: Scheme) -> int:
    """Count the force evaluations that the polynomial of a step takes."""
    if scheme.interpolant.needs_no_stages:
        return 0
    return scheme.method.stepper.evaluations(scheme.method.statements, scheme.interpolant.lines)


def make_room(run: Run) -> None:
    """Give a run room for further pieces and breaking points; pieces that no delay reaches any more are left out."""
    if not run.delays.size:
        return
    book = run.book[0]
    width, pieces = int(book.width), int(book.pieces)
    if (pieces + 1) * width > run.past_steps.size:
        drop_old(run)
        if 2 * int(book.pieces) * width >= run.past_steps.size:
            lend_past(run, run.past_steps, max(PIECES * width, 2 * run.past_steps.size))
    if int(book.breaks) + 3 * run.delays.size > run.breaks.shape[1]:
        room = np.zeros((2, BREAKS + run.breaks.shape[1] + 3 * run.delays.size))
        run.put(breaks=np.hstack([run.breaks, room]))


def drop_old(run: Run) -> None:
    """Leave out pieces that no delay reaches any more."""
    book = run.book[0]
    pieces = run.past_steps[: int(book.pieces * book.width)].reshape(-1, int(book.width))
    reach = float(run.now[0].t) - float(run.delays["time"].max()) * (1.0 + 1e-9)
    old = max(0, int(np.searchsorted(pieces[:, BEGIN], reach, side="right")) - 2)
    kept_pieces = pieces[old:].ravel().copy()
    run.past_steps[: kept_pieces.size], book.pieces = kept_pieces, len(pieces) - old


def trim_past(run: Run) -> None:
    """Reduce the past to the pieces that are known and may still be needed."""
    if run.delays.size:
        drop_old(run)
        size = int(run.book[0].pieces * run.book[0].width)
        lend_past(run, run.past_steps[:size], size)
        run.put(breaks=np.ascontiguousarray(run.breaks[:, : int(run.book[0].breaks)]))


def fit_past_room(run: Run, past: int, breaks: int) -> None:
    """Give a run as much room for its past as another one had."""
    lend_past(run, np.zeros(past), past)
    run.put(breaks=np.zeros((2, breaks)))


def lend_past(run: Run, past: Floats, size: int) -> None:
    """Give a run new memory for its past, which begins with given pieces."""
    # pieces are the end of `tables`, as programs find them by places in that array
    first = int(run.book[0].first)
    tables = np.append(run.tables[:first], np.zeros(size))
    tables[first : first + past.size] = past
    run.put(tables=tables, past_steps=tables[first:])
