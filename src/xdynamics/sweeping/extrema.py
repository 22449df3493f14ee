"""Largest and least value of a quantity in each of many runs: what `diagnose` finds in one run, for all at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.extremes import STATES
from xdynamics.evidence.diagnosing.heights import INTERPOLATED, LOCATED, SAMPLED, beyond
from xdynamics.evidence.diagnosing.summits import Summits, crests, humps, summits
from xdynamics.evidence.observables import rate_tree
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE
from xdynamics.sweeping.ensemble_records import Harvest

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

NO_RULE = -1  # of a member without a finite value


class Extremes(NamedTuple):
    """The extremes of one quantity, shape (members,).

    Attributes
    ----------
    value : ndarray
        In the unit of a record; nan for a member without a finite value.
    time : ndarray, s
    rule : ndarray of int8
        Index into `RULES` (an accepted state, a state between, one at an event), or `NO_RULE`.
    uncertainty : ndarray
        Of the value, by interpolation alone, as for a single run.
    """

    value: Floats
    time: Floats
    rule: NDArray[np.int8]
    uncertainty: Floats


def extremes(runs: Harvest, name: str, sign: float) -> Extremes:
    """Find the largest value of a quantity in every member (with a sign of -1 the least), its time and uncertainty.

    Parameters
    ----------
    runs : Harvest
        With complete logs.
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
    result = _accepted(runs, values, tops)
    unrated = runs.columns[name].variable.role not in STATES and bool(runs.model.python_functions)
    solves_anew = (
        bool(runs.model.assemblies) and not runs.settings.method.stepper.locates
    )  # impulses at each time inside
    if unrated or solves_anew:
        for i in np.flatnonzero(result.rule == SAMPLED).tolist():
            run_rows = slice(first[i], first[i + 1])
            result.uncertainty[i] = beyond(values[run_rows], time[run_rows], int(tops[i] - first[i]))
    if unrated:
        return result
    search = _search(runs, name, sign, result, humps(sign * values, time, first, rows, members))
    if solves_anew:
        return result._replace(uncertainty=np.fmax(result.uncertainty, search.open_heights))
    while (places := search.places()).size:
        times = search.asked
        states, from_rows = runs.states_at(times, places, after=False, known=search.rows)
        search.narrow(*runs.with_rates(name, states, times, from_rows, places))
    between = np.flatnonzero(sign * search.best > sign * result.value)
    for array, improved in ((result.value, search.best), (result.time, search.when)):
        array[between] = improved[between]
    if between.size:
        result.rule[between] = INTERPOLATED
        result.uncertainty[between] = runs.doubts(name, between, result.time[between])
    return result


def _accepted(runs: Harvest, values: Floats, tops: Rows) -> Extremes:
    """Return the extremes over accepted states alone."""
    has_number = tops >= 0
    at_event = np.isin(runs["row_kind"][tops], (EVENT_BEFORE, EVENT_AFTER))
    rule = np.where(has_number, np.where(at_event, LOCATED, SAMPLED), NO_RULE).astype(np.int8)
    best, when = np.where(has_number, values[tops], np.nan), np.where(has_number, runs["time"][tops], np.nan)
    return Extremes(best, when, rule, np.where(has_number, 0.0, np.nan))


def _search(runs: Harvest, name: str, sign: float, accepted: Extremes, humped: tuple[Rows, Rows]) -> Summits:
    """Begin the search for extremes between accepted states, around the humps of a quantity."""
    (rows, members), first, time = humped, runs.runs.first_row, runs["time"]
    rates = None
    if rate_tree(runs.model, name) is not None:
        low, high = np.maximum(rows - 1, first[members]), np.minimum(rows + 1, first[members + 1] - 1)
        rates_at_rows = runs.rate_at_rows(name, members, rows)
        rising = sign * rates_at_rows > 0.0
        rates_opposite = runs.rate_at_rows(
            name, members, np.where(rising, high, low)
        )  # at the other end of the bracket
        rates = np.stack(
            [np.where(rising, np.nan, rates_opposite), rates_at_rows, np.where(rising, rates_opposite, np.nan)]
        )
    return summits(sign, accepted.value.copy(), accepted.time.copy(), runs[name], time, first, rates, rows, members)


def _tops(values: Floats, rows: Rows, members: Rows, size: int) -> Rows:
    """Return the first row of each member that holds its largest value, a crest; -1 where there is no finite value."""
    largest = np.full(size, -np.inf)
    np.maximum.at(largest, members, values[rows])
    highest = np.flatnonzero(values[rows] == largest[members])[::-1]
    tops = np.full(size, -1)
    tops[members[highest]] = rows[highest]
    return tops
