"""Room for the past of a march with delays, and what is known of it before the march."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.past_pieces import BEGIN, width_of
from xdynamics.expressions.evaluation import evaluate
from xdynamics.kernels import Law
from xdynamics.kernels.step_polynomial import past_degree
from xdynamics.march.past_records import BOOK, DELAY
from xdynamics.march.run import Run
from xdynamics.methods.scheme import Scheme
from xdynamics.model import Model
from xdynamics.model.delays import in_history
from xdynamics.model.drive_arguments import CLOCK
from xdynamics.model.motion import constants, drive_pieces
from xdynamics.units import TIME, UNSCALED, Scales

Floats = NDArray[np.float64]
PIECES, BREAKS = 256, 64  # for which there is room at first


class Past(NamedTuple):
    """The steps of a run that is over: their pieces, and the numbers that belong to these."""

    pieces: Floats
    book: NDArray[Any]

    def lend(self, run: Run) -> None:
        """Have a run of the same model and method read them."""
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
        pairs = zip(model.looked_up_at.values(), drive_pieces(model, scales), strict=True)
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
    """Keep no more of the past than what is known and may still be needed."""
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
    """Have a run write its past to new memory, and begin it with another."""
    first = int(run.book[0].first)
    tables = np.append(run.tables[:first], np.zeros(size))
    tables[first : first + past.size] = past
    run.put(tables=tables, past_steps=tables[first:])
