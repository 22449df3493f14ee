"""The largest and the least value of a quantity in each of many runs: what `diagnose` finds in one, for all at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.extremes import INTERPOLATED, LOCATED, SAMPLED, STATES, beyond
from xdynamics.evidence.diagnosing.summits import Summits, crests, humps, summits
from xdynamics.evidence.observing import rate_tree
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE
from xdynamics.sweeping.harvest import Harvest

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

NO_RULE = -1  # of a member without any number


class Extremes(NamedTuple):
    """The extremes of one quantity, shape (members,).

    Attributes
    ----------
    value : ndarray
        In the unit of a record; nan of a member without any number.
    time : ndarray, s
    rule : ndarray of int8
        Of `RULES`, or `NO_RULE`: an accepted state, a state between, or one at an event.
    uncertainty : ndarray
        Of the value, by interpolation alone, as of a single run.
    """

    value: Floats
    time: Floats
    rule: NDArray[np.int8]
    uncertainty: Floats


def extremes(runs: Harvest, name: str, sign: float) -> Extremes:
    """Find the largest value of a quantity in every member, or with a sign of -1 the least; and when, how, and how surely.

    Parameters
    ----------
    runs : Harvest
        With whole logs.
    name : str
    sign : float
    """
    if (name, sign) not in runs.extremes:
        runs.extremes[name, sign] = _extremes(runs, name, sign)
    return Extremes(*runs.extremes[name, sign])


def _extremes(runs: Harvest, name: str, sign: float) -> Extremes:
    values, time, first = runs[name], runs["time"], runs.runs.first_row
    rows, members = crests(sign * values, first)
    tops = _tops(sign * values, rows, members, runs.size)
    found = _accepted(runs, values, tops)
    if runs.columns[name].variable.role not in STATES and runs.model.python_functions:
        for i in np.flatnonzero(found.rule == SAMPLED).tolist():
            own = slice(first[i], first[i + 1])
            found.uncertainty[i] = beyond(values[own], time[own], int(tops[i] - first[i]))
        return found
    search = _search(runs, name, sign, found, humps(sign * values, time, first, rows, members))
    while (places := search.places()).size:
        asked = search.asked
        states, from_rows = runs.states_at(asked, places, after=False, known=search.rows)
        search.narrow(*runs.with_rates(name, states, asked, from_rows, places))
    between = np.flatnonzero(sign * search.best > sign * found.value)
    for array, better in ((found.value, search.best), (found.time, search.when)):
        array[between] = better[between]
    if between.size:
        found.rule[between] = INTERPOLATED
        found.uncertainty[between] = runs.doubts(name, between, found.time[between])
    return found


def _accepted(runs: Harvest, values: Floats, tops: Rows) -> Extremes:
    """Return what the best accepted states tell."""
    there = tops >= 0
    at_event = np.isin(runs["row_kind"][tops], (EVENT_BEFORE, EVENT_AFTER))
    rule = np.where(there, np.where(at_event, LOCATED, SAMPLED), NO_RULE).astype(np.int8)
    best, when = np.where(there, values[tops], np.nan), np.where(there, runs["time"][tops], np.nan)
    return Extremes(best, when, rule, np.where(there, 0.0, np.nan))


def _search(runs: Harvest, name: str, sign: float, found: Extremes, humped: tuple[Rows, Rows]) -> Summits:
    """Begin the search about the humps of a quantity."""
    (rows, members), first, time = humped, runs.runs.first_row, runs["time"]
    rates = None
    if rate_tree(runs.model, name) is not None:
        low, high = np.maximum(rows - 1, first[members]), np.minimum(rows + 1, first[members + 1] - 1)
        at = _rates(runs, name, rows, members)
        rising = sign * at > 0.0
        other = _rates(runs, name, np.where(rising, high, low), members)  # the end of a bracket with `at`
        rates = np.stack([np.where(rising, np.nan, other), at, np.where(rising, other, np.nan)])
    return summits(sign, found.value.copy(), found.time.copy(), runs[name], time, first, rates, rows, members)


def _rates(runs: Harvest, name: str, rows: Rows, members: Rows) -> Floats:
    """Return the rate of a quantity at accepted states."""
    states = {one: runs[one][rows] for one in runs.layout.used}
    return runs.rate(name, states, members, rows, runs["time"][rows])


def _tops(values: Floats, rows: Rows, members: Rows, size: int) -> Rows:
    """Return the first row of each member that holds its largest value, which is a crest; -1 of one without any number."""
    largest = np.full(size, -np.inf)
    np.maximum.at(largest, members, values[rows])
    highest = np.flatnonzero(values[rows] == largest[members])[::-1]
    found = np.full(size, -1)
    found[members[highest]] = rows[highest]
    return found
