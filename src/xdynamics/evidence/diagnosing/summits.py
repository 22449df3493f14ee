"""Summits between accepted states: zeros of a quantity's rate, many at once, of one run or of many.

Where the rate is known and changes its sign over a step, the summit is where it is zero: the cubic through values and
rates at both ends of a bracket gives the next place to evaluate, by repeating a step of the run's method. Elsewhere
(forces of contacts, steps in which more happens than their ends show) the bracket is scanned. Nothing here sums or
compares across members: each has the same bits as alone.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

MOST_HUMPS = 1000  # of a run that are searched: those with the highest accepted states
# where no rate is known: places evaluated at once; rounds, each between the neighbours of the best
LOOKS, SWEEPS = 9, 12
ROUNDS = 40  # where it is known: three are usual, a kink takes 4 to 39
WIDE = 4.0  # times the height at which the tangents meet: how high a bracket may reach that bends up in a part of it
SMOOTH_ROUNDS = 3  # after which one round in three bisects, and one in three takes the point where the tangents meet


@dataclass
class Summits:
    """The search for the summits of one quantity.

    Attributes
    ----------
    sign : float
        1 for the largest values, -1 for the least.
    best, when : ndarray, shape (members,)
        The best accepted value of each member, and its time; in the end the best of all.
    members, rows : ndarray of int, shape (k,)
        Of each bracket whose rate changes its sign: its member, and the row from which its step starts.
    ends, values, rates : ndarray, shape (2, k)
        Times of its ends, and there the quantity and its rate, both times the sign.
    blind : ndarray of int, shape (m,)
        Members of the brackets that are scanned.
    borders : ndarray, shape (2, m)
    """

    sign: float
    best: Floats
    when: Floats
    members: Rows
    rows: Rows
    ends: Floats
    values: Floats
    rates: Floats
    blind: Rows
    borders: Floats
    _round: int = 0
    _places: Floats = field(default_factory=lambda: np.zeros(0))
    _looks: Floats = field(default_factory=lambda: np.zeros((LOOKS, 0)))

    @property
    def place_members(self) -> Rows:
        """The member of each place."""
        return np.concatenate([self.members, np.tile(self.blind, LOOKS)])

    @property
    def open_heights(self) -> Floats:
        """How far tangents at the ends of a bracket meet above the best of each member; at least 0."""
        heights = np.zeros(self.best.size)
        np.maximum.at(heights, self.members, self._tangents_meeting()[1] - self.sign * self.best[self.members])
        return heights

    def places(self) -> Floats:
        """Return the times to evaluate next; none when the search is over."""
        low, high = self.ends
        middle, top = low + (high - low) / 2.0, self.values.max(axis=0, initial=-np.inf)
        hope = top + WIDE * (self._tangents_meeting()[1] - top) >= self.sign * self.best[self.members]
        self._keep_brackets(hope & (middle > low) & (middle < high) & (self._round < ROUNDS))
        open_ = (self.borders[1] > self.borders[0]) & (self._round < SWEEPS)
        self.blind, self.borders = self.blind[open_], self.borders[:, open_]
        self._places = self._aims()
        self._looks = self.borders[0] + (self.borders[1] - self.borders[0]) * np.linspace(0.0, 1.0, LOOKS)[:, None]
        self._round += 1
        return np.concatenate([self._places, self._looks.ravel()])

    def narrow(self, values: Floats, rates: Floats) -> None:
        """Take values at the places, and rates at the first k of them; continue in smaller brackets."""
        k = self.members.size
        seen, rate, aims = self.sign * values[:k], self.sign * rates[:k], self._places
        looked = np.where(np.isnan(values[k:]), -np.inf, self.sign * values[k:]).reshape(self._looks.shape)
        top, columns = np.argmax(looked, axis=0), np.arange(self.blind.size)
        highest, where = looked[top, columns], self._looks[top, columns]
        self._improve(
            np.concatenate([self.members, self.blind]), np.concatenate([seen, highest]), np.concatenate([aims, where])
        )
        self.borders = np.stack(
            [self._looks[np.maximum(top - 1, 0), columns], self._looks[np.minimum(top + 1, LOOKS - 1), columns]]
        )
        rising, columns = rate > 0.0, np.arange(k)
        end = np.where(rising, 0, 1)
        self.ends[end, columns], self.values[end, columns], self.rates[end, columns] = aims, seen, rate
        gain = np.abs(rate * (self._summit() - aims))  # upper bound of what the cubic still promises
        self._keep_brackets(gain > EPS * np.abs(seen))

    def _aims(self) -> Floats:
        """Return the place to evaluate inside each bracket."""
        low, high = self.ends
        middle: Floats = low + (high - low) / 2.0
        turn = self._round % 3 if self._round >= SMOOTH_ROUNDS else 2
        if turn == 1:
            return middle
        aims = self._tangents_meeting()[0] if turn == 0 else self._summit()
        bracketed: Floats = np.where((aims > low) & (aims < high), aims, middle)
        return bracketed

    def _summit(self) -> Floats:
        """Return where the cubic through values and rates at both ends is largest (Nocedal, Wright, (3.59))."""
        (low, high), (first, last), (rise, fall) = self.ends, self.values, self.rates
        width = high - low
        with np.errstate(all="ignore"):
            mean = 3.0 * (last - first) / width - rise - fall
            root = np.sqrt(mean * mean - rise * fall)
            summit_times: Floats = high - width * ((root - fall - mean) / (rise - fall + 2.0 * root))
        return summit_times

    def _tangents_meeting(self) -> tuple[Floats, Floats]:
        """Return where the tangents at both ends meet, and how high: an upper bound where the curve bends down."""
        (low, high), (first, last), (rise, fall) = self.ends, self.values, self.rates
        with np.errstate(all="ignore"):
            time = (last - first - fall * (high - low)) / (rise - fall)
            return low + time, first + rise * time

    def _keep_brackets(self, kept_brackets: NDArray[np.bool_]) -> None:
        """Continue with some of the brackets."""
        self.members, self.rows = self.members[kept_brackets], self.rows[kept_brackets]
        self.ends, self.values, self.rates = (
            self.ends[:, kept_brackets],
            self.values[:, kept_brackets],
            self.rates[:, kept_brackets],
        )

    def _improve(self, members: Rows, values: Floats, times: Floats) -> None:
        """Replace the best of each member by a better value, the first of equal ones."""
        better = np.flatnonzero(values > self.sign * self.best[members])
        order = better[np.lexsort((better, -values[better], members[better]))]
        top = order[np.flatnonzero(np.diff(members[order], prepend=-1))]
        self.best[members[top]], self.when[members[top]] = self.sign * values[top], times[top]


def crests(values: Floats, first: Rows) -> tuple[Rows, Rows]:
    """Return the rows not lower than both neighbours in their member, and higher than one; and their members.

    Parameters
    ----------
    values : ndarray, shape (rows,)
        Of all members, one after the other.
    first : ndarray of int, shape (members + 1,)
        Where each member's rows begin, and where the last ones end.
    """
    values = np.where(np.isnan(values), -np.inf, values) if np.isnan(values).any() else values
    not_lower, higher = np.ones((2, values.size), bool), np.zeros(values.size, bool)
    np.greater_equal(values[1:], values[:-1], out=not_lower[0, 1:])
    np.greater_equal(values[:-1], values[1:], out=not_lower[1, :-1])
    higher[1:] = ~not_lower[1, :-1]
    higher[:-1] |= ~not_lower[0, 1:]
    begin, end = first[:-1], first[1:] - 1
    not_lower[0, begin] = not_lower[1, end] = higher[begin] = higher[end] = True
    rows = np.flatnonzero(not_lower[0] & not_lower[1] & higher)
    rows = rows[values[rows] > -np.inf]  # and no nan
    return rows, np.searchsorted(first, rows, side="right") - 1


def humps(values: Floats, time: Floats, first: Rows, rows: Rows, members: Rows) -> tuple[Rows, Rows]:
    """Return the crests whose neighbours are at other times; the highest of them where there are many."""
    low, high = np.maximum(rows - 1, first[members]), np.minimum(rows + 1, first[members + 1] - 1)
    wide = time[high] > time[low]
    rows, members = rows[wide], members[wide]
    counts = np.bincount(members, minlength=len(first) - 1)
    if counts.max(initial=0) > MOST_HUMPS:
        order = np.lexsort((np.arange(rows.size), values[rows], members))
        from_end = np.repeat(np.cumsum(counts), counts) - np.arange(rows.size)
        highest = np.sort(order[from_end <= MOST_HUMPS])
        rows, members = rows[highest], members[highest]
    return rows, members


def summits(
    sign: float,
    best: Floats,
    when: Floats,
    values: Floats,
    time: Floats,
    first: Rows,
    rates: Floats | None,
    rows: Rows,
    members: Rows,
) -> Summits:
    """Begin the search around the humps of a quantity.

    Parameters
    ----------
    sign : float
    best, when : ndarray, shape (members,)
        Best accepted values, and their times.
    values, time : ndarray, shape (rows,)
    first : ndarray of int, shape (members + 1,)
    rates : ndarray, shape (3, k), optional
        Of the quantity, in the rows before each hump, at it and after it; None if it is not known.
    rows, members
        Of the humps.
    """
    low, high = np.maximum(rows - 1, first[members]), np.minimum(rows + 1, first[members + 1] - 1)
    if rates is None:
        empty = np.zeros((2, 0))
        return Summits(
            sign,
            best,
            when,
            rows[:0],
            rows[:0],
            empty,
            empty.copy(),
            empty.copy(),
            members,
            time[np.stack([low, high])],
        )
    rate_before, rate_at, rate_after = sign * rates
    begin, end = np.where(rate_at > 0.0, rows, low), np.where(rate_at > 0.0, high, rows)
    rise, fall = np.where(rate_at > 0.0, rate_at, rate_before), np.where(rate_at > 0.0, rate_after, rate_at)
    wide = time[end] > time[begin]
    turns = wide & (rise > 0.0) & (fall < 0.0)
    blind = wide & ~turns & (rate_at != 0.0)
    ends = np.stack([begin, end])[:, turns]
    return Summits(
        sign,
        best,
        when,
        members[turns],
        begin[turns],
        time[ends],
        sign * values[ends],
        np.stack([rise, fall])[:, turns],
        members[blind],
        time[np.stack([low, high])[:, blind]],
    )
