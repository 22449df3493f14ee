"""The largest and the least value of every element of quantities over a run: as `extremes`, all elements side by side."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import Inside
from xdynamics.evidence.chunks import Chunks, with_roles
from xdynamics.evidence.diagnosing.extremes import (
    INTERPOLATED,
    LOCATED,
    MOST_NAMES,
    MOST_NUMBERS,
    SAMPLED,
    SOUGHT,
    STATES,
    Functions,
    beyond,
    extreme_variables,
    numbers_inside,
)
from xdynamics.evidence.diagnosing.states_inside import column, parts_of
from xdynamics.evidence.diagnosing.summits import MOST_HUMPS, Summits, crests, humps, summits
from xdynamics.evidence.observables import knows_state_rates, state_rates
from xdynamics.evidence.stored_columns import RowRange
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record.folding import model_dimensions
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]


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


def has_many_elements(run: xr.Dataset, model: Model) -> bool:
    """Whether a record of quantities has so many elements that extremes are sought of those alone that steps integrate.

    Of others elements are told apart: each force and observable is then evaluated where it is largest. So it is where
    rates are not known from states alone.
    """
    if not model_dimensions(run):
        return False
    elements = sum(int(np.prod(run.variables[name].shape[1:])) for name in with_roles(run, SOUGHT))
    return elements > MOST_NAMES and knows_state_rates(run, model)


def extremes_by_quantities(rows: Chunks, functions: Functions | None) -> dict[str, tuple[Any, ...]]:
    """Return the largest and the least value of all elements that steps integrate as variables of a Dataset."""
    run, variables = rows.run, dict[str, tuple[Any, ...]]()
    wanted = [(name, sign) for name in with_roles(run, STATES) for sign in (1.0, -1.0)]
    for (name, sign), result in zip(wanted, extremes_of_elements(rows, wanted, functions), strict=True):
        variables |= extreme_variables(run, name, sign, result)
    return variables


def extremes_of_elements(
    rows: Chunks, wanted: Sequence[tuple[str, float]], functions: Functions | None
) -> list[ElementExtremes]:
    """Find the largest values of quantities that steps integrate, or with a sign of -1 the least.

    The rates of these have to be known from states alone; see `knows_state_rates`.
    """
    found = [_ElementHeights.of(rows, name, sign) for name, sign in wanted]
    for stretch in rows.parts("time", "row_kind", *dict.fromkeys(name for name, _ in wanted)):
        for heights in found:
            heights.rise(stretch)
    searches, inside = _begun(rows, found), None
    near, _ = rows.near(np.concatenate([heights.rows.ravel() for heights in found]))
    while True:
        times = [search.places() for search in searches]
        asked = sum(item.size for item in times)
        if not asked:
            break
        if inside is None and asked * numbers_inside(rows.model) > MOST_NUMBERS:
            return [_accepted(*pair) for pair in zip(found, searches, strict=True)]
        inside = inside or Inside.of(near, functions, REINTEGRATE)
        states = inside.at(np.concatenate(times), after=False)
        at = {block.name: column(states, block.name) for block in inside.layout.used.blocks}
        where = column(states, schema.AT_TIME), column(states, "row")
        rates, parts = _rates(rows, near, at, *where), parts_of([item.size for item in times])
        for heights, search, part in zip(found, searches, parts, strict=True):
            if part.start < part.stop:
                members = search.asked
                values = at[heights.name][part].reshape(members.size, search.best.size)[
                    np.arange(members.size), members
                ]
                search.narrow(values, rates[heights.name][members, np.arange(part.start, part.stop)])
    settled = [_settled(*pair) for pair in zip(found, searches, strict=True)]
    return settled if inside is None else [*_with_errors(found, settled, inside)]


def _begun(rows: Chunks, found: Sequence[_ElementHeights]) -> list[Summits]:
    """Begin the searches of the steps around each hump of each element."""
    near, places = rows.near(np.concatenate([heights.rows.ravel() for heights in found]))
    distinct, inverse = np.unique(places, return_inverse=True)
    at = {heights.name: column(near, heights.name)[distinct] for heights in found}
    rates = _rates(rows, near, at, column(near, "time")[distinct], distinct)
    parts = parts_of([heights.rows.size for heights in found])
    return [
        heights.search(rates[heights.name][heights.members, inverse[part].reshape(3, -1)])
        for heights, part in zip(found, parts, strict=True)
    ]


def _rates(rows: Chunks, near: object, at: dict[str, Floats], times: Floats, numbers: Rows) -> dict[str, Floats]:
    """Return the rates of quantities at states, shape (elements, k), in recorded units."""
    rates = state_rates(near, rows.model, at, times, numbers)  # type: ignore[arg-type]
    assert rates is not None  # noqa: S101 - asked before
    units = {name: parse_unit(str(rows.run.variables[name].attrs["units"])) for name in rates}
    return {name: own / float(units[name].factor) for name, own in rates.items()}


def _accepted(heights: _ElementHeights, search: Summits) -> ElementExtremes:
    """Return the best accepted states, and how far parabolas and tangents exceed them."""
    best, above = heights.accepted(), search.open_heights
    return best._replace(uncertainties=np.where(above > best.uncertainties, above, best.uncertainties))


def _settled(heights: _ElementHeights, search: Summits) -> ElementExtremes:
    """Return the results of the search where they are better than the best accepted states, which are returned elsewhere."""
    best, sign = heights.accepted(), heights.sign
    better = sign * search.best > sign * best.values
    return ElementExtremes(
        np.where(better, search.best, best.values),
        np.where(better, search.when, best.times),
        np.where(better, INTERPOLATED, best.rules),
        np.zeros(better.size),
    )


def _with_errors(
    found: Sequence[_ElementHeights], settled: Sequence[ElementExtremes], inside: Inside
) -> Iterator[ElementExtremes]:
    """Yield extremes with the errors of those that are between accepted states by interpolation."""
    members = [np.flatnonzero(result.rules == INTERPOLATED) for result in settled]
    times = np.concatenate([result.times[own] for result, own in zip(settled, members, strict=True)])
    states = inside.at(times, after=False) if times.size else None
    for heights, result, own, part in zip(
        found, settled, members, parts_of([own.size for own in members]), strict=True
    ):
        if states is not None:
            errors = column(states, schema.error(heights.name))[part].reshape(own.size, result.rules.size)
            result.uncertainties[own] = np.abs(errors[np.arange(own.size), own])
        yield result


@dataclass
class _ElementHeights:
    """The highest rows of each element of a quantity, and its humps, of the parts of a run so far.

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
    def of(cls, rows: Chunks, name: str, sign: float) -> _ElementHeights:
        """Return the heights of a quantity before any row."""
        size = int(np.prod(rows.run.variables[name].shape[1:]))
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
        signed, own = self.sign * values, slice(part.before, part.before + part.count)
        self._raise(part, values, signed[:, own])
        every = np.arange(self.best.size + 1) * count
        rows, members = crests(signed.ravel(), every)
        inside = (rows - every[members] >= own.start) & (rows - every[members] < own.stop)
        rows, members = humps(signed.ravel(), np.tile(time, self.best.size), every, rows[inside], members[inside])
        rows = rows - every[members]
        here = np.stack([np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, count - 1)])
        self.rows = np.concatenate([self.rows, part.numbers[here]], axis=1)
        self.values = np.concatenate([self.values, values[members, here]], axis=1)
        self.times = np.concatenate([self.times, time[here]], axis=1)
        self.members = np.concatenate([self.members, members])
        self._sort()

    def _raise(self, part: RowRange, values: Floats, own: Floats) -> None:
        """Take the best rows of a part where they are better; `own` has its signed values."""
        time, elements = part.columns["time"], np.arange(self.best.size)
        unknown = np.isnan(own)
        tops = np.argmax(np.where(unknown, -np.inf, own), axis=1)
        heights = own[elements, tops]
        tops += part.before
        for i in np.flatnonzero(~unknown.all(axis=1) & ~(heights <= self.best)).tolist():
            self.above[i] = beyond(values[i], time, int(tops[i]))
            self.best[i], self.when[i] = heights[i], time[tops[i]]
            self.kinds[i] = part.columns["row_kind"][tops[i]]

    def _sort(self) -> None:
        """Order humps by their elements, as rows go, and keep the highest of each where there are many."""
        counts = np.bincount(self.members, minlength=self.best.size)
        kept = np.lexsort((self.rows[1], self.members))
        if counts.max(initial=0) > MOST_HUMPS:
            order = np.lexsort((self.rows[1], self.sign * self.values[1], self.members))
            from_end = np.repeat(np.cumsum(counts), counts) - np.arange(order.size)
            highest = np.zeros(order.size, bool)
            highest[order[from_end <= MOST_HUMPS]] = True
            kept = kept[highest[kept]]
        self.members = self.members[kept]
        self.rows, self.values, self.times = self.rows[:, kept], self.values[:, kept], self.times[:, kept]

    def search(self, rates: Floats) -> Summits:
        """Begin the search of the steps around each hump; rates are those in its three rows."""
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
