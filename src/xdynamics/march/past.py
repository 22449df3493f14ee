"""The past of a march with delays: a polynomial of every accepted step, and the breaking points that are still to come.

Where the motion has a jump or a kink, a delayed value has one a delay later, and the motion one that is smoother by a
derivative: the march lands on such points up to the order of the method (Hairer, Norsett, Wanner, Solving ODEs I, section
II.17). Between two of them lies a stretch, and a step reads delayed values on its own side of the points that it lands on.
"""

from __future__ import annotations

import numpy as np

from xdynamics.elementary.past_pieces import BEGIN, HEAD, LENGTH, STRETCH
from xdynamics.elementary.rounding_margins import EPS
from xdynamics.kernels.compiling import jit_separate
from xdynamics.kernels.program import T1, H, T
from xdynamics.march.calls import call_law
from xdynamics.march.run import Run

ROUNDING = 8.0 * EPS  # of a time: two breaking points that differ by less are one


@jit_separate
def begin_past(run: Run) -> None:
    """Have no past at the start, and the breaking points that follow from the start and from tables before it."""
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
    """Note the breaking points that follow from one, a delay later each; `level` is of the derivative that jumps there."""
    for k in range(run.delays.shape[0]):
        add_break(run, t + run.delays[k].time, level + 1)


@jit_separate
def add_break(run: Run, t: float, level: int) -> None:
    """Note a breaking point to come, in its place among the others, unless it is smoother than the method can tell."""
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
    """Leave behind the breaking points that the march has landed on, and note what follows; a node has a level or -1."""
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
    """Set every delay to the pieces of the past that a step from here to a time reads, or to what was before the start.

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
