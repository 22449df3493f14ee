"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event, and which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.inside import model_of, sampled
from xdynamics.evidence.diagnosing.summits import Summits, crests, humps, summits
from xdynamics.evidence.observing import evaluated_on, rate_tree, tree_of
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.units import parse_unit

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]
Rows = NDArray[np.int64]

STATES = ("coordinate", "velocity", "state")  # roles of what steps carry
SOUGHT = (*STATES, "energy", "observable", "force", "reaction")  # and of all that has extremes
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
        Of `RULES`: the accepted state with it, a state between accepted ones, or the state at an event.
    uncertainty : float
        Of the value, by interpolation alone: 0 of an accepted state that is known to be the largest.
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

    A state at an event that is above all others stands as it is. Else the steps to and from each row that is no lower than
    its neighbours are searched for a zero of the quantity's rate, by states of the run's own method between, on which
    forces, contact forces, energies and observables are evaluated; see `summits`. Forces in Python are looked at in
    accepted states alone: how far the parabola through the largest and its neighbours goes beyond it is then what the
    value is uncertain by.
    """
    model = model_of(run, functions)
    begun = [_begun(run, model, name, sign) for name, sign in wanted]
    while True:
        places = [search.places() for _, search in begun]
        if not any(one.size for one in places):
            break
        ends = np.cumsum([0, *(one.size for one in places)])
        states = sampled(run, np.concatenate(places), after=False, rule=REINTEGRATE, functions=functions)
        for k, ((name, _), (_, search)) in enumerate(zip(wanted, begun, strict=True)):
            if places[k].size:
                here = states.isel({schema.AT: slice(ends[k], ends[k + 1])})
                search.narrow(*_with_rates(run, model, name, here))
    found = [_settled(*one) for one in begun]
    for k, (name, _) in enumerate(wanted):
        if found[k].rule == INTERPOLATED:
            doubt = float(between(run, model, name, np.array([found[k].time]), functions)[1][0])
            found[k] = found[k]._replace(uncertainty=doubt)
    return found


def _begun(run: xr.Dataset, model: Model, name: str, sign: float) -> tuple[Extreme, Summits]:
    """Return the best accepted state, and the search of the steps about each that is no lower than its neighbours."""
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
    beside = np.stack([np.maximum(rows - 1, 0), rows, np.minimum(rows + 1, len(time) - 1)])
    tree, rates = rate_tree(model, name), None
    if tree is not None:
        at = {one: np.asarray(run[one])[beside.ravel()] for one in model.units}
        rates = evaluated_on(run, model, [tree], at, time[beside.ravel()], beside.ravel())[0].reshape(beside.shape) / _factor(run, name)  # fmt: skip
    search = summits(sign, np.array([best.value]), np.array([best.time]), values, time, first, rates, rows, members)
    return best, search


def _settled(best: Extreme, search: Summits) -> Extreme:
    """Return what the search came to, if that is better than the best accepted state."""
    value, time = float(search.best[0]), float(search.when[0])
    return Extreme(value, time, INTERPOLATED, 0.0) if search.sign * value > search.sign * best.value else best


def _factor(run: xr.Dataset, name: str) -> float:
    return float(parse_unit(str(run[name].attrs["units"])).factor)


def _with_rates(run: xr.Dataset, model: Model, name: str, states: xr.Dataset) -> tuple[Floats, Floats]:
    """Return a quantity on states inside steps, and its rate; of one whose rate is not known the quantity for both."""
    values, tree = _values(run, model, name, states), rate_tree(model, name)
    if tree is None:
        return values, values
    at = {one: np.asarray(states[one]) for one in model.units}
    times, rows = np.asarray(states[schema.AT_TIME]), np.asarray(states["row"])
    return values, evaluated_on(run, model, [tree], at, times, rows)[0] / _factor(run, name)


def _values(run: xr.Dataset, model: Model, name: str, states: xr.Dataset, moved: str = "") -> Floats:
    """Return a quantity on states inside steps; with one of them moved by what interpolation may have it off."""
    if name in model.units and not moved:
        return np.asarray(states[name])
    at = {one: np.asarray(states[one]) for one in model.units}
    if moved:
        at[moved] = at[moved] + np.asarray(states[schema.error(moved)])
    times, rows = np.asarray(states[schema.AT_TIME]), np.asarray(states["row"])
    return evaluated_on(run, model, [tree_of(model, name)], at, times, rows)[0] / _factor(run, name)


def between(run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None) -> tuple[Floats, Floats]:  # fmt: skip
    """Return a quantity at times inside steps, and what the interpolation of the state may have it off."""
    states = sampled(run, times, after=False, rule=REINTEGRATE, functions=functions)
    values = _values(run, model, name, states)
    if name in model.units:
        return values, np.abs(np.asarray(states[schema.error(name)]))
    errors = [one for one in model.units if np.asarray(states[schema.error(one)]).any()]
    moved = (np.abs(_values(run, model, name, states, one) - values) for one in errors)
    return values, sum(moved, np.zeros(values.shape))


def beyond(values: Floats, time: Floats, row: int) -> float:
    """Return how far the parabola through an extreme row and its neighbours goes beyond it; 0 at either end."""
    if not 0 < row < len(values) - 1:
        return 0.0
    before, after = time[row] - time[row - 1], time[row + 1] - time[row]
    if not (before > 0.0 and after > 0.0):
        return 0.0
    left, right = (values[row] - values[row - 1]) / before, (values[row + 1] - values[row]) / after
    bend, slope = (right - left) / (before + after), (left * after + right * before) / (before + after)
    return float(slope**2 / abs(4.0 * bend)) if bend else 0.0


def sought(run: xr.Dataset) -> list[str]:
    """Name what has extremes; of large models what steps carry alone."""
    along = {str(name): one.attrs.get("role") for name, one in run.data_vars.items() if one.dims == (schema.STEPS,)}
    names = [name for name, role in along.items() if role in SOUGHT]
    return names if len(names) <= MOST_NAMES else [name for name in names if along[name] in STATES]


def extremes_of(run: xr.Dataset, names: Sequence[str], functions: Functions | None) -> dict[str, tuple[Any, ...]]:
    """Return the variables that say the largest and the least value of quantities."""
    found: dict[str, tuple[Any, ...]] = {}
    rules, second = schema.flags(dict(enumerate(RULES))), str(run["time"].attrs["units"])
    wanted = [(name, sign) for name in names for sign in (1.0, -1.0)]
    for (name, sign), one in zip(wanted, extremes(run, wanted, functions), strict=True):
        units, word, said = (
            str(run[name].attrs["units"]),
            *(("maximum", "largest") if sign > 0 else ("minimum", "least")),
        )
        found |= {
            f"{word}_{name}": ((), one.value, {"units": units, "long_name": f"{said} {name} of the run", "role": "diagnostic"}),
            f"{word}_{name}_time": ((), one.time, {"units": second, "long_name": f"when {name} was {said}", "role": "diagnostic"}),
            f"{word}_{name}_rule": ((), np.int8(one.rule), {"units": "1", "long_name": RULE_SAID, "role": "flag"} | rules),
            f"{word}_{name}_uncertainty": ((), one.uncertainty, {"units": units, "long_name": DOUBT_SAID.format(f"{word}_{name}"), "role": "error"}),
        }  # fmt: skip
    return found
