"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import Inside, sampled
from xdynamics.evidence.chunks import Chunks
from xdynamics.evidence.diagnosing.summits import MOST_HUMPS, Summits, crests, humps, summits
from xdynamics.evidence.observables import evaluated_on, rate_tree, tree_of
from xdynamics.evidence.stored_columns import RowRange
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]
Rows = NDArray[np.int64]

STATES = ("coordinate", "velocity", "state")  # roles of what steps integrate
SOUGHT = (*STATES, "energy", "observable", "force", "reaction")  # and of everything whose extremes are sought
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
    model, found = rows.model, [_Heights(name, sign) for name, sign in wanted]
    for part in rows.parts("time", "row_kind", *dict.fromkeys(name for name, _ in wanted)):
        for heights in found:
            heights.rise(part)
    near, places_near = rows.near(np.concatenate([heights.rows.ravel() for heights in found]))
    ends = np.cumsum([heights.rows.size for heights in found])
    factors = {name: _factor(rows.run, name) for name, _ in wanted}
    searches = [
        _begun(rows, near, heights, here) for heights, here in zip(found, np.split(places_near, ends[:-1]), strict=True)
    ]
    inside: Inside | None = None
    while True:
        places = [search.places() for _, search in searches]
        if not any(item.size for item in places):
            break
        ends = np.cumsum([0, *(item.size for item in places)])
        inside = inside or Inside.of(near, functions, REINTEGRATE)
        states = inside.at(np.concatenate(places), after=False)
        for k, ((name, _), (_, search)) in enumerate(zip(wanted, searches, strict=True)):
            if places[k].size:
                here = states.isel({schema.AT: slice(ends[k], ends[k + 1])})
                search.narrow(*_with_rates(near, model, name, factors[name], here))
    results = [_settled(*item) for item in searches]
    between_rows = [k for k, result in enumerate(results) if result.rule == INTERPOLATED]
    if inside is not None and between_rows:
        states = inside.at(np.array([results[k].time for k in between_rows]), after=False)
        for i, k in enumerate(between_rows):
            name = wanted[k][0]
            _, off = _with_errors(near, model, name, factors[name], states.isel({schema.AT: slice(i, i + 1)}))
            results[k] = results[k]._replace(uncertainty=float(off[0]))
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


def _begun(rows: Chunks, near: xr.Dataset, heights: _Heights, places: Rows) -> tuple[Extreme, Summits]:
    """Return the best accepted state, and the search of the steps around each hump, whose rows are at places near it."""
    name, sign, model = heights.name, heights.sign, rows.model
    top, time, kind = heights.best
    at_event = kind in (schema.EVENT_BEFORE, schema.EVENT_AFTER)
    best = Extreme(sign * top, time, LOCATED if at_event else SAMPLED, 0.0)
    values, times = heights.values, heights.times
    if rows.run.variables[name].attrs["role"] not in STATES and model.python_functions:
        best = best._replace(uncertainty=0.0 if at_event else heights.above)
        values, times, places = values[:, :0], times[:, :0], places[:0]
    tree, rates = rate_tree(model, name), None
    if tree is not None:
        states = {variable: _column(near, variable)[places] for variable in model.units}
        rates = evaluated_on(near, model, [tree], states, times.ravel(), places)[0].reshape(values.shape)
        rates = rates / _factor(rows.run, name)
    # the rows of a hump, one after the other
    middles = 1 + 3 * np.arange(values.shape[1])
    search = summits(
        sign,
        np.array([best.value]),
        np.array([best.time]),
        values.T.ravel(),
        times.T.ravel(),
        np.array([0, values.size]),
        rates,
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


def _with_rates(run: xr.Dataset, model: Model, name: str, factor: float, states: xr.Dataset) -> tuple[Floats, Floats]:
    """Return a quantity on states inside steps, and its rate; where no rate is known, the quantity twice."""
    values, tree = _values(run, model, name, factor, states), rate_tree(model, name)
    if tree is None:
        return values, values
    state = {variable: _column(states, variable) for variable in model.units}
    times, rows = _column(states, schema.AT_TIME), _column(states, "row")
    return values, evaluated_on(run, model, [tree], state, times, rows)[0] / factor


def _values(run: xr.Dataset, model: Model, name: str, factor: float, states: xr.Dataset, moved: str = "") -> Floats:
    """Return a quantity on states inside steps; with one variable moved by its interpolation error, if named."""
    if name in model.units and not moved:
        recorded: Floats = _column(states, name)
        return recorded
    state = {variable: _column(states, variable) for variable in model.units}
    if moved:
        state[moved] = state[moved] + _column(states, schema.error(moved))
    times, rows = _column(states, schema.AT_TIME), _column(states, "row")
    return evaluated_on(run, model, [tree_of(model, name)], state, times, rows)[0] / factor


def between(
    run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None
) -> tuple[Floats, Floats]:
    """Return a quantity at times inside steps, and its error by the interpolation of the state."""
    states = sampled(run, times, after=False, rule=REINTEGRATE, functions=functions)
    return _with_errors(run, model, name, _factor(run, name), states)


def _with_errors(run: xr.Dataset, model: Model, name: str, factor: float, states: xr.Dataset) -> tuple[Floats, Floats]:
    """Return the same of known states, where the unit's factor is given: the quantity itself need not be in the record."""
    values = _values(run, model, name, factor, states)
    if name in model.units:
        return values, np.abs(_column(states, schema.error(name)))
    uncertain = [variable for variable in model.units if _column(states, schema.error(variable)).any()]
    moved = (np.abs(_values(run, model, name, factor, states, variable) - values) for variable in uncertain)
    return values, sum(moved, np.zeros(values.shape))


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


def sought(run: xr.Dataset) -> list[str]:
    """Name the quantities whose extremes are sought; in large models only those that steps integrate."""
    along = {
        str(name): variable.attrs.get("role")
        for name in run.data_vars
        if (variable := run.variables[name]).dims == (schema.STEPS,)
    }
    names = [name for name, role in along.items() if role in SOUGHT]
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
