"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.shortened_steps import model_of, sampled
from xdynamics.evidence.diagnosing.summits import Summits, crests, humps, summits
from xdynamics.evidence.observables import evaluated_on, rate_tree, tree_of
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


def extreme(run: xr.Dataset, name: str, sign: float, functions: Functions | None) -> Extreme:
    """Find the largest value of a quantity, or with a sign of -1 the least; see `extremes`."""
    return extremes(run, [(name, sign)], functions)[0]


def extremes(run: xr.Dataset, wanted: Sequence[tuple[str, float]], functions: Functions | None) -> list[Extreme]:
    """Find the largest values of quantities, or with a sign of -1 the least.

    A state at an event that is above all others is taken as it is. Otherwise the steps to and from each row that is not
    lower than its neighbours are searched for a zero of the quantity's rate, by steps of the run's own method to states
    between, on which forces, contact forces, energies and observables are evaluated; see `summits`. If a force is
    written in Python, only accepted states are used, except for states that steps integrate: the uncertainty is then
    how far the parabola through the largest value and its neighbours rises above it.
    """
    model = model_of(run, functions)
    searches = [_begun(run, model, name, sign) for name, sign in wanted]
    while True:
        places = [search.places() for _, search in searches]
        if not any(item.size for item in places):
            break
        ends = np.cumsum([0, *(item.size for item in places)])
        states = sampled(run, np.concatenate(places), after=False, rule=REINTEGRATE, functions=functions)
        for k, ((name, _), (_, search)) in enumerate(zip(wanted, searches, strict=True)):
            if places[k].size:
                here = states.isel({schema.AT: slice(ends[k], ends[k + 1])})
                search.narrow(*_with_rates(run, model, name, here))
    results = [_settled(*item) for item in searches]
    for k, (name, _) in enumerate(wanted):
        if results[k].rule == INTERPOLATED:
            uncertainty = float(between(run, model, name, np.array([results[k].time]), functions)[1][0])
            results[k] = results[k]._replace(uncertainty=uncertainty)
    return results


def _begun(run: xr.Dataset, model: Model, name: str, sign: float) -> tuple[Extreme, Summits]:
    """Return the best accepted state, and the search of the steps around each row not lower than its neighbours."""
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    row = int(np.nanargmax(sign * values))
    at_event = int(run["row_kind"][row]) in (schema.EVENT_BEFORE, schema.EVENT_AFTER)
    best, first = (
        Extreme(float(values[row]), float(time[row]), LOCATED if at_event else SAMPLED, 0.0),
        np.array([0, len(time)]),
    )
    rows, members = humps(sign * values, time, first, *crests(sign * values, first))
    if run[name].attrs["role"] not in STATES and model.python_functions:
        best = best._replace(uncertainty=0.0 if at_event else beyond(values, time, row))
        rows, members = rows[:0], members[:0]
    neighbours = np.stack([np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, len(time) - 1)])
    tree, rates = rate_tree(model, name), None
    if tree is not None:
        states = {variable: np.asarray(run[variable])[neighbours.ravel()] for variable in model.units}
        rates = evaluated_on(run, model, [tree], states, time[neighbours.ravel()], neighbours.ravel())[0].reshape(
            neighbours.shape
        ) / _factor(run, name)
    search = summits(sign, np.array([best.value]), np.array([best.time]), values, time, first, rates, rows, members)
    return best, search


def _settled(best: Extreme, search: Summits) -> Extreme:
    """Return the result of the search if it is better than the best accepted state, which is returned otherwise."""
    value, time = float(search.best[0]), float(search.when[0])
    return Extreme(value, time, INTERPOLATED, 0.0) if search.sign * value > search.sign * best.value else best


def _factor(run: xr.Dataset, name: str) -> float:
    return float(parse_unit(str(run[name].attrs["units"])).factor)


def _with_rates(run: xr.Dataset, model: Model, name: str, states: xr.Dataset) -> tuple[Floats, Floats]:
    """Return a quantity on states inside steps, and its rate; where no rate is known, the quantity twice."""
    values, tree = _values(run, model, name, states), rate_tree(model, name)
    if tree is None:
        return values, values
    state = {variable: np.asarray(states[variable]) for variable in model.units}
    times, rows = np.asarray(states[schema.AT_TIME]), np.asarray(states["row"])
    return values, evaluated_on(run, model, [tree], state, times, rows)[0] / _factor(run, name)


def _values(run: xr.Dataset, model: Model, name: str, states: xr.Dataset, moved: str = "") -> Floats:
    """Return a quantity on states inside steps; with one variable moved by its interpolation error, if named."""
    if name in model.units and not moved:
        return np.asarray(states[name])
    state = {variable: np.asarray(states[variable]) for variable in model.units}
    if moved:
        state[moved] = state[moved] + np.asarray(states[schema.error(moved)])
    times, rows = np.asarray(states[schema.AT_TIME]), np.asarray(states["row"])
    return evaluated_on(run, model, [tree_of(model, name)], state, times, rows)[0] / _factor(run, name)


def between(
    run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None
) -> tuple[Floats, Floats]:
    """Return a quantity at times inside steps, and its error by the interpolation of the state."""
    states = sampled(run, times, after=False, rule=REINTEGRATE, functions=functions)
    values = _values(run, model, name, states)
    if name in model.units:
        return values, np.abs(np.asarray(states[schema.error(name)]))
    uncertain = [variable for variable in model.units if np.asarray(states[schema.error(variable)]).any()]
    moved = (np.abs(_values(run, model, name, states, variable) - values) for variable in uncertain)
    return values, sum(moved, np.zeros(values.shape))


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
        for name, variable in run.data_vars.items()
        if variable.dims == (schema.STEPS,)
    }
    names = [name for name, role in along.items() if role in SOUGHT]
    return names if len(names) <= MOST_NAMES else [name for name in names if along[name] in STATES]


def extremes_of(run: xr.Dataset, names: Sequence[str], functions: Functions | None) -> dict[str, tuple[Any, ...]]:
    """Return the largest and the least value of quantities as variables of a Dataset."""
    variables: dict[str, tuple[Any, ...]] = {}
    rules, time_unit = schema.flags(dict(enumerate(RULES))), str(run["time"].attrs["units"])
    wanted = [(name, sign) for name in names for sign in (1.0, -1.0)]
    for (name, sign), result in zip(wanted, extremes(run, wanted, functions), strict=True):
        units, word, adjective = (
            str(run[name].attrs["units"]),
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
