"""Summits of quantities between accepted states: zeros of a rate, many at once, of a single run or of many.

Where the rate is known and changes sign over a step, the summit is the zero of the rate. The cubic through values and
rates at both ends of a bracket gives the next time to evaluate, by repeating a step of the run's method. Elsewhere
(forces of contacts, steps in which more happens than their ends show) the bracket is scanned. No operation sums or
compares across members: each member has the bits that it has alone.

The search starts from the highest rows of each element, and from the humps around them.

States inside steps, each at its own time, come with their rates and with the error of their interpolation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.elementary.bounds import EPS
from xdynamics.evidence.chunks import RowRange
from xdynamics.evidence.observables import TreesOf, evaluate_at_states, rate_tree, tree_of
from xdynamics.expressions import Node
from xdynamics.expressions.calculus import ZERO
from xdynamics.model import Model
from xdynamics.model.constraints import Assignment
from xdynamics.model.motion import assignments_read
from xdynamics.runtime.lazy_imports import cached_property

if TYPE_CHECKING:
    import xarray as xr

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
        """The member of each time to evaluate."""
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
        """Narrow the brackets by values at all requested times, and by rates at the first k of them."""
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
        """Return the time to evaluate inside each bracket."""
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
    # the negation of not lower is higher only because no nan is left
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
        """Include further rows in the search for the highest row and the humps of each element."""
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
        """Replace the best rows by higher rows of a part; `signed_part` has its signed values."""
        time, elements = part.columns["time"], np.arange(self.best.size)
        unknown = np.isnan(signed_part)
        tops = np.argmax(np.where(unknown, -np.inf, signed_part), axis=1)
        heights = signed_part[elements, tops]
        tops += part.rows_before
        # negated: before the first row the best is nan
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
        """Return the heights without humps, so that no summit is searched between rows."""
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
    """Return the excess of the parabola through an extreme row and its neighbours over the row; 0 at either end."""
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


@dataclass(frozen=True)
class StatesInside:
    """States inside steps, of several quantities one after the other.

    Attributes
    ----------
    variables, errors : mapping of str to ndarray, shape (k,)
        What steps integrate, and its error by interpolation, in recorded units.
    times : ndarray, shape (k,), s
    rows : ndarray of int, shape (k,)
        From which each step starts.
    parts : list of slice
        Of each quantity.
    """

    variables: Mapping[str, Floats]
    errors: Mapping[str, Floats]
    times: Floats
    rows: Rows
    parts: list[slice]

    @classmethod
    def from_dataset(cls, model: Model, states: xr.Dataset, sizes: Sequence[int]) -> StatesInside:
        """Read interpolated or marched states, `sizes` of them for each quantity in turn."""
        variables = {name: variable_numbers(states, name) for name in model.elements.units}
        errors = {name: variable_numbers(states, schema.error(name)) for name in model.elements.units}
        return cls(
            variables,
            errors,
            variable_numbers(states, schema.AT_TIME),
            variable_numbers(states, "row"),
            consecutive_slices(sizes),
        )

    def shifted_by_error(self, name: str) -> Mapping[str, Floats]:
        """Return the variables with one of them off by its error."""
        return {**self.variables, name: self.variables[name] + self.errors[name]}


def consecutive_slices(sizes: Sequence[int]) -> list[slice]:
    """Return the slices of consecutive pieces with given sizes."""
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


@dataclass
class QuantitiesInside:
    """Recorded quantities on states inside steps; common subexpressions are evaluated once.

    Attributes
    ----------
    run : xarray.Dataset
    model : Model
    names : list of str
    factors : list of float
        SI units in the unit of each.
    """

    run: xr.Dataset
    model: Model
    names: list[str]
    factors: list[float]
    _read: dict[tuple[int, ...], list[Assignment]] = field(default_factory=dict)  # by an expression list and its places

    @cached_property
    def _value_trees(self) -> list[Node | None]:
        return [None if name in self.model.elements.units else tree_of(self.model, name) for name in self.names]

    @cached_property
    def _rate_trees(self) -> list[Node | None]:
        return [rate_tree(self.model, name) for name in self.names]

    def _rate_trees_of(self, model: Model) -> list[Node]:
        """Return the rates by the forces of a model that slides along switches; 0 where none is known."""
        return [rate_tree(model, name) or ZERO for name in self.names]

    def values(self, states: StatesInside, variables: Mapping[str, Floats]) -> list[Floats]:
        """Return each quantity on its part of the states, for these variables."""
        tree_values = self._tree_values(self._value_trees, states, variables)
        return [
            variables[name][part] if value is None else value
            for name, value, part in zip(self.names, tree_values, states.parts, strict=True)
        ]

    def rates(self, states: StatesInside, values: Sequence[Floats]) -> list[Floats]:
        """Return the rate of each; its own value where none is known."""
        rate_values = self._tree_values(self._rate_trees, states, states.variables, self._rate_trees_of)
        return [value if rate is None else rate for value, rate in zip(values, rate_values, strict=True)]

    def errors(self, states: StatesInside, values: Sequence[Floats]) -> list[Floats]:
        """Return how far the errors of the variables move each."""
        elements = self.model.elements
        totals = [np.zeros(value.shape) for value in values]
        computed = [name for name in self.names if name not in elements.units]
        for variable in (name for name in elements.units if computed and states.errors[name].any()):
            shifted_values = self.values(states, states.shifted_by_error(variable))
            totals = [
                total + np.abs(off - value) for total, off, value in zip(totals, shifted_values, values, strict=True)
            ]
        return [
            np.abs(states.errors[name][part]) if name in elements.units else total
            for name, total, part in zip(self.names, totals, states.parts, strict=True)
        ]

    def _tree_values(
        self,
        trees: list[Node | None],
        states: StatesInside,
        variables: Mapping[str, Floats],
        trees_of: TreesOf | None = None,
    ) -> list[Floats | None]:
        """Evaluate each expression on its part, if it has any states; None where there is no expression."""
        results: list[Floats | None] = [None if tree is None else np.zeros(0) for tree in trees]
        present_trees = [
            (k, tree, part)
            for k, (tree, part) in enumerate(zip(trees, states.parts, strict=True))
            if tree is not None and part.start < part.stop
        ]
        if not present_trees:
            return results
        places, selected_trees, parts = zip(*present_trees, strict=True)
        # an identity suffices: both lists of trees are cached, and live as long as this object
        key = (id(trees), *places)
        if key not in self._read:
            self._read[key] = assignments_read(self.model, selected_trees)
        read = self._read[key]
        of_slid = None if trees_of is None else lambda model: [trees_of(model)[k] for k in places]
        tree_values = evaluate_at_states(
            self.run, self.model, selected_trees, variables, states.times, states.rows, parts, read, of_slid
        )
        for k, value in zip(places, tree_values, strict=True):
            results[k] = value / self.factors[k]
        return results


def variable_numbers(states: xr.Dataset, name: str) -> Any:
    """Return a variable's numbers: a DataArray made of it first takes many times as long."""
    return np.asarray(states.variables[name].values)
