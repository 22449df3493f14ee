"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import Inside, sampled
from xdynamics.evidence.chunks import Chunks
from xdynamics.evidence.diagnosing.summits import MOST_HUMPS, Summits, crests, humps, summits
from xdynamics.evidence.observables import evaluated_on, rate_tree, tree_of
from xdynamics.evidence.stored_columns import RowRange
from xdynamics.expressions import Node
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.mass import Assignment
from xdynamics.model.motion import read_by
from xdynamics.reaction_names import contact_force, friction_force
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]
Rows = NDArray[np.int64]

STATES = ("coordinate", "velocity", "state")  # roles of what steps integrate
SOUGHT = (*STATES, "energy", "observable", "force", "reaction", "joint")  # and of everything whose extremes are sought
SAMPLED, INTERPOLATED, LOCATED = range(3)
RULES = ("sampled", "interpolated", "located")
SAID = ("sampled at an accepted state", "interpolated between accepted states", "located by an event")
RULE_SAID = "an accepted state, a state between, or one at an event"
DOUBT_SAID = "what interpolation may have {} off; the error of the integration is not in it"
MOST_NAMES = 200  # quantities, above which extremes of forces and observables are not sought


class Extreme(NamedTuple):
    """One extreme value.

    Attributes
    ----------
    value : float
        In the unit of the record.
    time : float, s
    rule : int
        Index into `RULES`: an accepted state, a state between accepted ones, or the state at an event.
    uncertainty : float
        Of the value, from interpolation alone: 0 for an accepted state that is known to be the largest.
    """

    value: float
    time: float
    rule: int
    uncertainty: float


def extreme(run: xr.Dataset | Chunks, name: str, sign: float, functions: Functions | None) -> Extreme:
    """Find the largest value of a quantity, or with a sign of -1 the least; see `extremes`."""
    return extremes(run, [(name, sign)], functions)[0]


def extremes(
    run: xr.Dataset | Chunks, wanted: Sequence[tuple[str, float]], functions: Functions | None
) -> list[Extreme]:
    """Find the largest values of quantities, or with a sign of -1 the least.

    A state at an event that is above all others is taken as it is. Otherwise the steps to and from each row that is not
    lower than its neighbours are searched for a zero of the quantity's rate, by steps of the run's own method to states
    between, on which forces, contact forces, energies and observables are evaluated; see `summits`. If a force is
    written in Python, only accepted states are used, except for states that steps integrate: the uncertainty is then
    how far the parabola through the largest value and its neighbours rises above it.
    """
    rows = Chunks.of(run, functions)
    found = [_Heights(name, sign) for name, sign in wanted]
    for part in rows.parts("time", "row_kind", *dict.fromkeys(name for name, _ in wanted)):
        for heights in found:
            heights.rise(part)
    near, places = rows.near(np.concatenate([heights.rows.ravel() for heights in found]))
    quantities = _Quantities(
        near, rows.model, [name for name, _ in wanted], [_factor(rows.run, name) for name, _ in wanted]
    )
    searches = _begun(rows, quantities, found, places)
    inside: Inside | None = None
    while True:
        times = [search.places() for _, search in searches]
        if not any(item.size for item in times):
            break
        inside = inside or Inside.of(near, functions, REINTEGRATE)
        states = _States.inside(
            rows.model, inside.at(np.concatenate(times), after=False), [item.size for item in times]
        )
        values = quantities.values(states, states.variables)
        for (_, search), value, rate in zip(searches, values, quantities.rates(states, values), strict=True):
            if value.size:
                search.narrow(value, rate)
    results = [_settled(*item) for item in searches]
    between_rows = np.array([result.rule == INTERPOLATED for result in results])
    if inside is not None and between_rows.any():
        ends = inside.at(np.array([result.time for result in results if result.rule == INTERPOLATED]), after=False)
        states = _States.inside(rows.model, ends, [int(is_between) for is_between in between_rows])
        errors = quantities.errors(states, quantities.values(states, states.variables))
        results = [
            result._replace(uncertainty=float(off[0])) if off.size else result
            for result, off in zip(results, errors, strict=True)
        ]
    return results


@dataclass(frozen=True)
class _States:
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
    def inside(cls, model: Model, states: xr.Dataset, sizes: Sequence[int]) -> _States:
        """Take what was interpolated or marched, so many states for each quantity."""
        variables = {name: _column(states, name) for name in model.units}
        errors = {name: _column(states, schema.error(name)) for name in model.units}
        return cls(variables, errors, _column(states, schema.AT_TIME), _column(states, "row"), _parts(sizes))

    def moved(self, name: str) -> Mapping[str, Floats]:
        """Return the variables with one of them off by its error."""
        return {**self.variables, name: self.variables[name] + self.errors[name]}


def _parts(sizes: Sequence[int]) -> list[slice]:
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(*pair) for pair in pairwise(ends)]


@dataclass
class _Quantities:
    """Recorded quantities on states inside steps: what several of them read is evaluated once.

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
    def _trees(self) -> list[Node | None]:
        return [None if name in self.model.units else tree_of(self.model, name) for name in self.names]

    @cached_property
    def _rate_trees(self) -> list[Node | None]:
        return [rate_tree(self.model, name) for name in self.names]

    def values(self, states: _States, variables: Mapping[str, Floats]) -> list[Floats]:
        """Return each quantity on its part of the states, for these variables."""
        found = self._evaluated(self._trees, states, variables)
        return [
            variables[name][part] if value is None else value
            for name, value, part in zip(self.names, found, states.parts, strict=True)
        ]

    def rates(self, states: _States, values: Sequence[Floats]) -> list[Floats]:
        """Return the rate of each; its own value where none is known."""
        found = self._evaluated(self._rate_trees, states, states.variables)
        return [value if rate is None else rate for value, rate in zip(values, found, strict=True)]

    def errors(self, states: _States, values: Sequence[Floats]) -> list[Floats]:
        """Return how far the errors of the variables move each."""
        totals = [np.zeros(value.shape) for value in values]
        for variable in (name for name in self.model.units if states.errors[name].any()):
            moved = self.values(states, states.moved(variable))
            totals = [total + np.abs(off - value) for total, off, value in zip(totals, moved, values, strict=True)]
        return [
            np.abs(states.errors[name][part]) if name in self.model.units else total
            for name, total, part in zip(self.names, totals, states.parts, strict=True)
        ]

    def _evaluated(
        self, trees: list[Node | None], states: _States, variables: Mapping[str, Floats]
    ) -> list[Floats | None]:
        """Evaluate each expression on its part, if it has any states; None where there is no expression."""
        results: list[Floats | None] = [None if tree is None else np.zeros(0) for tree in trees]
        known = [
            (k, tree, part)
            for k, (tree, part) in enumerate(zip(trees, states.parts, strict=True))
            if tree is not None and part.start < part.stop
        ]
        if not known:
            return results
        places, some, parts = zip(*known, strict=True)
        key = (id(trees), *places)
        if key not in self._read:
            self._read[key] = read_by(self.model, some)
        read = self._read[key]
        found = evaluated_on(self.run, self.model, some, variables, states.times, states.rows, parts, read)
        for k, value in zip(places, found, strict=True):
            results[k] = value / self.factors[k]
        return results


@dataclass
class _Heights:
    """The highest rows of one quantity, and its humps, of the parts of a run so far.

    Attributes
    ----------
    name : str
    sign : float
        1 for the largest values, -1 for the least.
    best : (float, float, int)
        The largest value times the sign, its time, and what kind of row it is in.
    above : float
        How far the parabola through it and its neighbours exceeds it.
    rows, values, times : ndarray, shape (3, k)
        Of each hump: the row before, its own, the row after; the highest of them where there are many.
    """

    name: str
    sign: float
    best: tuple[float, float, int] = (np.nan, np.nan, schema.INITIAL)
    above: float = 0.0
    rows: Rows = field(default_factory=lambda: np.zeros((3, 0), np.int64))
    values: Floats = field(default_factory=lambda: np.zeros((3, 0)))
    times: Floats = field(default_factory=lambda: np.zeros((3, 0)))

    def rise(self, part: RowRange) -> None:
        """Take further rows."""
        values, time = part.columns[self.name], part.columns["time"]
        signed, own = self.sign * values, slice(part.before, part.before + part.count)
        if not np.isnan(signed[own]).all():
            top = part.before + int(np.nanargmax(signed[own]))
            if not signed[top] <= self.best[0]:
                self.best = float(signed[top]), float(time[top]), int(part.columns["row_kind"][top])
                self.above = beyond(values, time, top)
        every = np.array([0, len(time)])
        rows, members = crests(signed, every)
        inside = (rows >= own.start) & (rows < own.stop)
        rows, _ = humps(signed, time, every, rows[inside], members[inside])
        here = np.stack([np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, len(time) - 1)])
        self.rows = np.concatenate([self.rows, part.numbers[here]], axis=1)
        self.values, self.times = (
            np.concatenate(pair, axis=1) for pair in ((self.values, values[here]), (self.times, time[here]))
        )
        if self.rows.shape[1] > MOST_HUMPS:
            highest = np.lexsort((self.rows[1], self.sign * self.values[1]))[-MOST_HUMPS:]
            kept = np.sort(highest)
            self.rows, self.values, self.times = self.rows[:, kept], self.values[:, kept], self.times[:, kept]


def _begun(
    rows: Chunks, quantities: _Quantities, found: Sequence[_Heights], places: Rows
) -> list[tuple[Extreme, Summits]]:
    """Return the best accepted states, and the searches of the steps around each hump, whose rows are at these places."""
    sizes = [heights.rows.size for heights in found]
    states = {variable: _column(quantities.run, variable)[places] for variable in rows.model.units}
    times = np.concatenate([heights.times.ravel() for heights in found])
    unknown = [np.zeros(0)] * len(found)
    rates = quantities.rates(_States(states, {}, times, places, _parts(sizes)), unknown)
    return [_search(rows, heights, rate) for heights, rate in zip(found, rates, strict=True)]


def _search(rows: Chunks, heights: _Heights, rates: Floats) -> tuple[Extreme, Summits]:
    """Return the best accepted state, and the search of the steps around each hump; without rates where none are known."""
    name, sign = heights.name, heights.sign
    top, time, kind = heights.best
    at_event = kind in (schema.EVENT_BEFORE, schema.EVENT_AFTER)
    best = Extreme(sign * top, time, LOCATED if at_event else SAMPLED, 0.0)
    values, times = heights.values, heights.times
    if rows.run.variables[name].attrs["role"] not in STATES and (rows.model.python_functions or rows.model.delays):
        best = best._replace(uncertainty=0.0 if at_event else heights.above)
        values, times = values[:, :0], times[:, :0]
    # the rows of a hump, one after the other
    middles = 1 + 3 * np.arange(values.shape[1])
    search = summits(
        sign,
        np.array([best.value]),
        np.array([best.time]),
        values.T.ravel(),
        times.T.ravel(),
        np.array([0, values.size]),
        rates.reshape(values.shape) if rates.size else None,
        middles,
        np.zeros(middles.size, np.int64),
    )
    return best, search


def _settled(best: Extreme, search: Summits) -> Extreme:
    """Return the result of the search if it is better than the best accepted state, which is returned otherwise."""
    value, time = float(search.best[0]), float(search.when[0])
    return Extreme(value, time, INTERPOLATED, 0.0) if search.sign * value > search.sign * best.value else best


def _factor(run: xr.Dataset, name: str) -> float:
    return float(parse_unit(str(run.variables[name].attrs["units"])).factor)


def between(
    run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None
) -> tuple[Floats, Floats]:
    """Return a quantity at times inside steps, and its error by the interpolation of the state."""
    states = _States.inside(
        model, sampled(run, times, after=False, rule=REINTEGRATE, functions=functions), [times.size]
    )
    quantity = _Quantities(run, model, [name], [_factor(run, name)])
    values = quantity.values(states, states.variables)
    return values[0], quantity.errors(states, values)[0]


def _column(states: xr.Dataset, name: str) -> Any:
    """Return a variable's numbers: a DataArray made of it first takes many times as long."""
    return np.asarray(states.variables[name].values)


def beyond(values: Floats, time: Floats, row: int) -> float:
    """Return how far the parabola through an extreme row and its neighbours exceeds it; 0 at either end."""
    if not 0 < row < len(values) - 1:
        return 0.0
    before, after = time[row] - time[row - 1], time[row + 1] - time[row]
    if not (before > 0.0 and after > 0.0):
        return 0.0
    left, right = (values[row] - values[row - 1]) / before, (values[row + 1] - values[row]) / after
    bend, slope = (right - left) / (before + after), (left * after + right * before) / (before + after)
    return float(slope**2 / abs(4.0 * bend)) if bend else 0.0


def sought(run: xr.Dataset, model: Model) -> list[str]:
    """Name the quantities whose extremes are sought; in large models only those that steps integrate, and no iterated forces."""
    by_iteration = tuple(name(contact) for contact in model.assemblies for name in (contact_force, friction_force))
    along = {
        str(name): variable.attrs.get("role")
        for name in run.data_vars
        if (variable := run.variables[name]).dims == (schema.STEPS,)
    }
    names = [name for name, role in along.items() if role in SOUGHT and not name.startswith(by_iteration)]
    return names if len(names) <= MOST_NAMES else [name for name in names if along[name] in STATES]


def extremes_of(rows: Chunks, names: Sequence[str], functions: Functions | None) -> dict[str, tuple[Any, ...]]:
    """Return the largest and the least value of quantities as variables of a Dataset."""
    run = rows.run
    variables: dict[str, tuple[Any, ...]] = {}
    rules, time_unit = schema.flags(dict(enumerate(RULES))), str(run.variables["time"].attrs["units"])
    wanted = [(name, sign) for name in names for sign in (1.0, -1.0)]
    for (name, sign), result in zip(wanted, extremes(rows, wanted, functions), strict=True):
        units, word, adjective = (
            str(run.variables[name].attrs["units"]),
            *(("maximum", "largest") if sign > 0 else ("minimum", "least")),
        )
        variables |= {
            f"{word}_{name}": (
                (),
                result.value,
                {"units": units, "long_name": f"{adjective} {name} of the run", "role": "diagnostic"},
            ),
            f"{word}_{name}_time": (
                (),
                result.time,
                {"units": time_unit, "long_name": f"when {name} was {adjective}", "role": "diagnostic"},
            ),
            f"{word}_{name}_rule": (
                (),
                np.int8(result.rule),
                {"units": "1", "long_name": RULE_SAID, "role": "flag"} | rules,
            ),
            f"{word}_{name}_uncertainty": (
                (),
                result.uncertainty,
                {"units": units, "long_name": DOUBT_SAID.format(f"{word}_{name}"), "role": "error"},
            ),
        }
    return variables
