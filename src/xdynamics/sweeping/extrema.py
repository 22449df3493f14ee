"""The largest and the least value of a quantity in each of many runs: what `diagnose` finds in one, for all at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.extremes import LOOKS, MOST_HUMPS, ROUNDS, STATES
from xdynamics.sweeping.harvest import Harvest

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


def extremes(runs: Harvest, name: str, sign: float) -> tuple[Floats, Floats]:
    """Find the largest value of a quantity in every member, or with a sign of -1 the least, and when.

    Parameters
    ----------
    runs : Harvest
        With whole logs.
    name : str
    sign : float

    Returns
    -------
    tuple of ndarray, shape (members,)
        In the unit of a record, and s; nan of a member without any number.
    """
    values, time, first = runs[name], runs["time"], runs.runs.first_row
    rows = _tops(sign * values, first)
    best, when = np.where(rows >= 0, values[rows], np.nan), np.where(rows >= 0, time[rows], np.nan)
    if runs.columns[name].variable.role not in STATES and runs.model.python_functions:
        return best, when
    humps, members = _humps(sign * values, time, first)
    low = time[np.maximum(humps - 1, first[members])]
    high = time[np.minimum(humps + 1, first[members + 1] - 1)]
    going = np.ones(runs.size, bool)
    for _ in range(ROUNDS):
        going[members[~(high > low)]] = False
        mine = np.flatnonzero(going[members])
        if not mine.size:
            break
        places = low[mine] + (high[mine] - low[mine]) * np.linspace(0.0, 1.0, LOOKS)[:, None]
        each = np.broadcast_to(members[mine], places.shape).ravel()
        # states of one member behind each other, whose parameters are then loaded once
        order = np.argsort(each, kind="stable")
        looked = np.empty(each.size)
        looked[order] = runs.observed(name, each[order], places.ravel()[order], after=False)
        looked = looked.reshape(places.shape)
        k, column = np.argmax(np.where(np.isnan(looked), -np.inf, sign * looked), axis=0), np.arange(mine.size)
        _improve(best, when, sign, members[mine], looked[k, column], places[k, column])
        low[mine], high[mine] = places[np.maximum(k - 1, 0), column], places[np.minimum(k + 1, LOOKS - 1), column]
    return best, when


def _improve(best: Floats, when: Floats, sign: float, members: Rows, values: Floats, times: Floats) -> None:
    """Take each member's best candidate, the first of equal ones, where it is better than what there is."""
    order = np.lexsort((np.arange(members.size), -sign * values, members))
    top = order[np.flatnonzero(np.diff(members[order], prepend=-1))]
    better = top[sign * values[top] > sign * best[members[top]]]
    best[members[better]], when[members[better]] = values[better], times[better]


def _tops(values: Floats, first: Rows) -> Rows:
    """Return the first row of each member that holds its largest value; -1 of one without any number."""
    largest = np.fmax.reduceat(values, first[:-1])
    members = np.repeat(np.arange(len(first) - 1), np.diff(first))
    rows = np.flatnonzero(values == largest[members])
    found = np.full(len(first) - 1, -1)
    found[members[rows[::-1]]] = rows[::-1]
    return found


def _humps(values: Floats, time: Floats, first: Rows) -> tuple[Rows, Rows]:
    """Return the rows that lie no lower than both neighbours in their member, and higher than one, and the members."""
    members = np.repeat(np.arange(len(first) - 1), np.diff(first))
    before, behind = np.full(values.size, -np.inf), np.full(values.size, -np.inf)
    before[1:], behind[:-1] = values[:-1], values[1:]
    before[first[:-1]], behind[first[1:] - 1] = -np.inf, -np.inf
    rows = np.flatnonzero((values >= before) & (values >= behind) & (values > np.minimum(before, behind)))
    low, high = np.maximum(rows - 1, first[members[rows]]), np.minimum(rows + 1, first[members[rows] + 1] - 1)
    rows = rows[time[high] > time[low]]
    counts = np.bincount(members[rows], minlength=len(first) - 1)
    if counts.max(initial=0) > MOST_HUMPS:
        order = np.lexsort((np.arange(rows.size), values[rows], members[rows]))
        from_end = np.repeat(np.cumsum(counts), counts) - np.arange(rows.size)
        rows = np.sort(rows[order[from_end <= MOST_HUMPS]])
    return rows, members[rows]
