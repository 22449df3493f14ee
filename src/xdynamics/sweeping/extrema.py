"""Largest and least value of a quantity in each of many runs: what `diagnose` finds in one run, for all at once."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.extremes import STATES
from xdynamics.evidence.diagnosing.heights import INTERPOLATED, LOCATED, SAMPLED, parabola_excess
from xdynamics.evidence.diagnosing.summits import Summits, crests, humps, summits
from xdynamics.evidence.observables import rate_tree
from xdynamics.schema import EVENT_AFTER, EVENT_BEFORE
from xdynamics.sweeping.ensemble_records import MemberRuns

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


def extremes_of_members(runs: MemberRuns, name: str, sign: float) -> Extremes:
    """Find the largest value of a quantity in every member (with a sign of -1 the least), its time and uncertainty.

    Parameters
    ----------
    runs : Harvest
        With complete logs.
    name : str
    sign : float
    """
    if (name, sign) not in runs.extremes_cache:
        runs.extremes_cache[name, sign] = _search_extremes(runs, name, sign)
    return Extremes(*runs.extremes_cache[name, sign])


def _search_extremes(runs: MemberRuns, name: str, sign: float) -> Extremes:
    values, time, first = runs[name], runs["time"], runs.runs.first_row
    rows, members = crests(sign * values, first)
    tops = _highest_rows(sign * values, rows, members, runs.size)
    extremes = _extremes_of_rows(runs, values, tops)
    unrated = runs.columns[name].variable.role not in STATES and bool(runs.model.python_functions)
    solves_anew = (
        bool(runs.model.assemblies) and not runs.settings.method.stepper.locates
    )  # impulses at each time inside
    if unrated or solves_anew:
        for i in np.flatnonzero(extremes.rule == SAMPLED).tolist():
            run_rows = slice(first[i], first[i + 1])
            extremes.uncertainty[i] = parabola_excess(values[run_rows], time[run_rows], int(tops[i] - first[i]))
    if unrated:
        return extremes
    search = _begin_search(runs, name, sign, extremes, humps(sign * values, time, first, rows, members))
    if solves_anew:
        return extremes._replace(uncertainty=np.fmax(extremes.uncertainty, search.open_heights))
    while (places := search.places()).size:
        times = search.place_members
        states, from_rows = runs.states_at(times, places, after_event=False, known_rows=search.rows)
        search.narrow(*runs.evaluate_with_rates(name, states, times, from_rows, places))
    between = np.flatnonzero(sign * search.best > sign * extremes.value)
    for array, improved in ((extremes.value, search.best), (extremes.time, search.when)):
        array[between] = improved[between]
    if between.size:
        extremes.rule[between] = INTERPOLATED
        extremes.uncertainty[between] = runs.interpolation_errors(name, between, extremes.time[between])
    return extremes


def _extremes_of_rows(runs: MemberRuns, values: Floats, tops: Rows) -> Extremes:
    """Return the extremes over accepted states alone."""
    has_number = tops >= 0
    at_event = np.isin(runs["row_kind"][tops], (EVENT_BEFORE, EVENT_AFTER))
    rule = np.where(has_number, np.where(at_event, LOCATED, SAMPLED), NO_RULE).astype(np.int8)
    best, best_times = np.where(has_number, values[tops], np.nan), np.where(has_number, runs["time"][tops], np.nan)
    return Extremes(best, best_times, rule, np.where(has_number, 0.0, np.nan))


def _begin_search(
    runs: MemberRuns, name: str, sign: float, accepted: Extremes, humps_found: tuple[Rows, Rows]
) -> Summits:
    """Begin the search for extremes between accepted states, around the humps of a quantity."""
    (rows, members), first, time = humps_found, runs.runs.first_row, runs["time"]
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


def _highest_rows(values: Floats, rows: Rows, members: Rows, size: int) -> Rows:
    """Return the first row of each member that holds its largest value, a crest; -1 where there is no finite value."""
    largest = np.full(size, -np.inf)
    np.maximum.at(largest, members, values[rows])
    highest = np.flatnonzero(values[rows] == largest[members])[::-1]
    tops = np.full(size, -1)
    tops[members[highest]] = rows[highest]
    return tops
