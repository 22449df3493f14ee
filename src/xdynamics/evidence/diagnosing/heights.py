"""The highest rows of the elements of a quantity, and the humps around which more is sought between them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.evidence.diagnosing.summits import MOST_HUMPS, Summits, crests, humps, summits
from xdynamics.evidence.stored_columns import RowRange

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

SAMPLED, INTERPOLATED, LOCATED = range(3)
RULES = ("sampled", "interpolated", "located")
SAID = ("sampled at an accepted state", "interpolated between accepted states", "located by an event")


class ElementExtremes(NamedTuple):
    """One extreme value of each element, in the order of the record; see `Extreme`.

    Attributes
    ----------
    values, times, uncertainties : ndarray, shape (n,)
    rules : ndarray of int, shape (n,)
    """

    values: Floats
    times: Floats
    rules: Rows
    uncertainties: Floats


@dataclass
class Heights:
    """The highest rows of each element of a quantity, and its humps, of the parts of a run so far; a scalar is one element.

    Attributes
    ----------
    name : str
    sign : float
        1 for the largest values, -1 for the least.
    best, when, above : ndarray, shape (n,)
        The largest value times the sign, its time, how far the parabola through it and its neighbours exceeds it.
    kinds : ndarray of int, shape (n,)
        What kind of row it is in.
    members : ndarray of int, shape (k,)
        The element of each hump.
    rows, values, times : ndarray, shape (3, k)
        Of each hump: the row before, its own, the row after; the highest of them where an element has many.
    """

    name: str
    sign: float
    best: Floats
    when: Floats
    above: Floats
    kinds: Rows
    members: Rows = field(default_factory=lambda: np.zeros(0, np.int64))
    rows: Rows = field(default_factory=lambda: np.zeros((3, 0), np.int64))
    values: Floats = field(default_factory=lambda: np.zeros((3, 0)))
    times: Floats = field(default_factory=lambda: np.zeros((3, 0)))

    @classmethod
    def of(cls, name: str, sign: float, size: int = 1) -> Heights:
        """Return the heights of a quantity of so many elements before any row."""
        best, when = np.full((2, size), np.nan)
        return cls(name, sign, best, when, np.zeros(size), np.full(size, schema.INITIAL, np.int64))

    def accepted(self) -> ElementExtremes:
        """Return the best accepted states, which parabolas through their neighbours may exceed."""
        at_event = np.isin(self.kinds, (schema.EVENT_BEFORE, schema.EVENT_AFTER))
        rules, above = np.where(at_event, LOCATED, SAMPLED), np.where(at_event, 0.0, self.above)
        return ElementExtremes(self.sign * self.best, self.when.copy(), rules, above)

    def rise(self, part: RowRange) -> None:
        """Take further rows."""
        time, count = part.columns["time"], len(part.columns["time"])
        values = np.ascontiguousarray(part.columns[self.name].reshape(count, -1).T)
        signed, part_slice = self.sign * values, slice(part.rows_before, part.rows_before + part.count)
        self._raise(part, values, signed[:, part_slice])
        every = np.arange(self.best.size + 1) * count
        rows, members = crests(signed.ravel(), every)
        in_part = (rows - every[members] >= part_slice.start) & (rows - every[members] < part_slice.stop)
        rows, members = humps(signed.ravel(), np.tile(time, self.best.size), every, rows[in_part], members[in_part])
        rows = rows - every[members]
        hump_rows = np.stack([np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, count - 1)])
        self.rows = np.concatenate([self.rows, part.row_numbers[hump_rows]], axis=1)
        self.values = np.concatenate([self.values, values[members, hump_rows]], axis=1)
        self.times = np.concatenate([self.times, time[hump_rows]], axis=1)
        self.members = np.concatenate([self.members, members])
        self._sort()

    def _raise(self, part: RowRange, values: Floats, signed_part: Floats) -> None:
        """Take the best rows of a part where they are better; `signed_part` has its signed values."""
        time, elements = part.columns["time"], np.arange(self.best.size)
        unknown = np.isnan(signed_part)
        tops = np.argmax(np.where(unknown, -np.inf, signed_part), axis=1)
        heights = signed_part[elements, tops]
        tops += part.rows_before
        for i in np.flatnonzero(~unknown.all(axis=1) & ~(heights <= self.best)).tolist():
            self.above[i] = parabola_excess(values[i], time, int(tops[i]))
            self.best[i], self.when[i] = heights[i], time[tops[i]]
            self.kinds[i] = part.columns["row_kind"][tops[i]]

    def _sort(self) -> None:
        """Order humps by their elements, as rows go, and keep the highest of each where there are many."""
        counts = np.bincount(self.members, minlength=self.best.size)
        kept_humps = np.lexsort((self.rows[1], self.members))
        if counts.max(initial=0) > MOST_HUMPS:
            order = np.lexsort((self.rows[1], self.sign * self.values[1], self.members))
            from_end = np.repeat(np.cumsum(counts), counts) - np.arange(order.size)
            highest = np.zeros(order.size, bool)
            highest[order[from_end <= MOST_HUMPS]] = True
            kept_humps = kept_humps[highest[kept_humps]]
        self.members = self.members[kept_humps]
        self.rows, self.values, self.times = (
            self.rows[:, kept_humps],
            self.values[:, kept_humps],
            self.times[:, kept_humps],
        )

    def without_humps(self) -> Heights:
        """Return the same, between whose rows nothing is sought."""
        empty = np.zeros((3, 0))
        return replace(self, members=self.members[:0], rows=self.rows[:, :0], values=empty, times=empty)

    def search(self, rates: Floats | None) -> Summits:
        """Begin the search of the steps around each hump; rates are those in its three rows, if they are known."""
        counts, best = np.bincount(self.members, minlength=self.best.size), self.accepted()
        return summits(
            self.sign,
            best.values.copy(),
            best.times,
            self.values.T.ravel(),
            self.times.T.ravel(),
            np.concatenate([[0], np.cumsum(3 * counts)]),
            rates,
            1 + 3 * np.arange(self.members.size),
            self.members,
        )


def parabola_excess(values: Floats, time: Floats, row: int) -> float:
    """Return how far the parabola through an extreme row and its neighbours exceeds it; 0 at either end."""
    if not 0 < row < len(values) - 1:
        return 0.0
    step_before, step_after = time[row] - time[row - 1], time[row + 1] - time[row]
    if not (step_before > 0.0 and step_after > 0.0):
        return 0.0
    left, right = (values[row] - values[row - 1]) / step_before, (values[row + 1] - values[row]) / step_after
    bend, slope = (
        (right - left) / (step_before + step_after),
        (left * step_after + right * step_before) / (step_before + step_after),
    )
    return float(slope**2 / abs(4.0 * bend)) if bend else 0.0
