"""The largest and the least value of a quantity in each of many runs: what `diagnose` finds in one, for all at once."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xdynamics.evidence.diagnosing.extremes import STATES
from xdynamics.evidence.diagnosing.summits import crests, humps, summits
from xdynamics.evidence.observing import rate_tree
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
    if (name, sign) not in runs.extremes:
        runs.extremes[name, sign] = _extremes(runs, name, sign)
    return runs.extremes[name, sign]


def _extremes(runs: Harvest, name: str, sign: float) -> tuple[Floats, Floats]:
    values, time, first = runs[name], runs["time"], runs.runs.first_row
    signed = sign * values
    rows, members = crests(signed, first)
    tops = _tops(signed, rows, members, runs.size)
    best, when = np.where(tops >= 0, values[tops], np.nan), np.where(tops >= 0, time[tops], np.nan)
    if runs.columns[name].variable.role not in STATES and runs.model.python_functions:
        return best, when
    rows, members = humps(signed, time, first, rows, members)
    tree, rates = rate_tree(runs.model, name), None
    if tree is not None:
        beside = np.stack(
            [np.maximum(rows - 1, first[members]), rows, np.minimum(rows + 1, first[members + 1] - 1)]
        ).ravel()
        states = {one: runs[one][beside] for one in runs.layout.used}
        rates = runs.rate(name, states, np.tile(members, 3), beside, time[beside]).reshape(3, -1)
    search = summits(sign, best, when, values, time, first, rates, rows, members)
    while (places := search.places()).size:
        asked = search.asked
        states, from_rows = runs.states_at(asked, places, after=False, known=search.rows)
        seen = runs.value(name, states, asked, from_rows, places)
        search.narrow(seen, seen if tree is None else runs.rate(name, states, asked, from_rows, places))
    return search.best, search.when


def _tops(values: Floats, rows: Rows, members: Rows, size: int) -> Rows:
    """Return the first row of each member that holds its largest value, which is a crest; -1 of one without any number."""
    largest = np.full(size, -np.inf)
    np.maximum.at(largest, members, values[rows])
    highest = np.flatnonzero(values[rows] == largest[members])[::-1]
    found = np.full(size, -1)
    found[members[highest]] = rows[highest]
    return found
