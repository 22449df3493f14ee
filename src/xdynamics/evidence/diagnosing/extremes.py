"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event, and which."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.inside import model_of, sampled
from xdynamics.evidence.observing import evaluated_on, tree_of
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
MOST_HUMPS = 1000  # that are searched, the highest among accepted states
MOST_NAMES = 200  # quantities, above which extremes of forces and observables are not sought
LOOKS, ROUNDS = 9, 12  # of a search: so many places at once, then between the neighbours of the best


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


@dataclass
class Search:
    """The search for one extreme: what is best so far, and the brackets that it goes on in.

    Attributes
    ----------
    name : str
    sign : float
        1 of the largest, -1 of the least.
    best : Extreme
    low, high : ndarray, shape (k,), s
    """

    name: str
    sign: float
    best: Extreme
    low: Floats
    high: Floats

    @property
    def places(self) -> Floats:
        """Where it looks next, shape (LOOKS, k); nowhere where a bracket has no room left."""
        if not (self.high > self.low).all():
            self.low = self.high = np.zeros(0)
        return self.low + (self.high - self.low) * np.linspace(0.0, 1.0, LOOKS)[:, None]

    def narrow(self, places: Floats, looked: Floats) -> None:
        """Take the best of what was looked at, and go on between its neighbours in each bracket."""
        k, each = np.argmax(np.where(np.isnan(looked), -np.inf, self.sign * looked), axis=0), np.arange(len(self.low))
        top = int(np.argmax(self.sign * looked[k, each]))
        value = float(looked[k[top], top])
        if self.sign * value > self.sign * self.best.value:
            self.best = Extreme(value, float(places[k[top], top]), INTERPOLATED, 0.0)
        self.low, self.high = places[np.maximum(k - 1, 0), each], places[np.minimum(k + 1, LOOKS - 1), each]


def extreme(run: xr.Dataset, name: str, sign: float, functions: Functions | None) -> Extreme:
    """Find the largest value of a quantity, or with a sign of -1 the least; see `extremes`."""
    return extremes(run, [(name, sign)], functions)[0]


def extremes(run: xr.Dataset, wanted: Sequence[tuple[str, float]], functions: Functions | None) -> list[Extreme]:
    """Find the largest values of quantities, or with a sign of -1 the least.

    A state at an event that is above all others stands as it is. Else the steps to and from each row that is no lower than
    its neighbours are searched, by states of the run's own method between, on which forces, contact forces, energies and
    observables are evaluated. Forces in Python are looked at in accepted states alone: how far the parabola through the
    largest and its neighbours goes beyond it is then what the value is uncertain by.
    """
    model = model_of(run, functions)
    searches = [_begun(run, model, name, sign) for name, sign in wanted]
    for _ in range(ROUNDS):
        places = [one.places for one in searches]
        if not any(one.size for one in places):
            break
        ends = np.cumsum([0, *(one.size for one in places)])
        states = sampled(run, np.concatenate([one.ravel() for one in places]), after=False, rule=REINTEGRATE, functions=functions)  # fmt: skip
        for k, (one, where) in enumerate(zip(searches, places, strict=True)):
            if where.size:
                here = states.isel({schema.AT: slice(ends[k], ends[k + 1])})
                one.narrow(where, _values(run, model, one.name, here).reshape(where.shape))
    found = [one.best for one in searches]
    for k, (name, _) in enumerate(wanted):
        if found[k].rule == INTERPOLATED:
            doubt = float(between(run, model, name, np.array([found[k].time]), functions)[1][0])
            found[k] = found[k]._replace(uncertainty=doubt)
    return found


def _begun(run: xr.Dataset, model: Model, name: str, sign: float) -> Search:
    """Return the search with the best accepted state, and the steps about each that is no lower than its neighbours."""
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    row = int(np.nanargmax(sign * values))
    at_event = int(run["row_kind"][row]) in (schema.EVENT_BEFORE, schema.EVENT_AFTER)
    best = Extreme(float(values[row]), float(time[row]), LOCATED if at_event else SAMPLED, 0.0)
    if run[name].attrs["role"] not in STATES and model.python_functions:
        doubt = 0.0 if at_event else _beyond(values, time, row)
        return Search(name, sign, best._replace(uncertainty=doubt), np.zeros(0), np.zeros(0))
    humps = _humps(sign * values, time)
    return Search(name, sign, best, time[np.maximum(humps - 1, 0)], time[np.minimum(humps + 1, len(time) - 1)])


def _values(run: xr.Dataset, model: Model, name: str, states: xr.Dataset, moved: str = "") -> Floats:
    """Return a quantity on states inside steps; with one of them moved by what interpolation may have it off."""
    if name in model.units and not moved:
        return np.asarray(states[name])
    at = {one: np.asarray(states[one]) for one in model.units}
    if moved:
        at[moved] = at[moved] + np.asarray(states[schema.error(moved)])
    units = float(parse_unit(str(run[name].attrs["units"])).factor)
    times, rows = np.asarray(states[schema.AT_TIME]), np.asarray(states["row"])
    return evaluated_on(run, model, [tree_of(model, name)], at, times, rows)[0] / units


def between(run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None) -> tuple[Floats, Floats]:  # fmt: skip
    """Return a quantity at times inside steps, and what the interpolation of the state may have it off."""
    states = sampled(run, times, after=False, rule=REINTEGRATE, functions=functions)
    values = _values(run, model, name, states)
    if name in model.units:
        return values, np.abs(np.asarray(states[schema.error(name)]))
    errors = [one for one in model.units if np.asarray(states[schema.error(one)]).any()]
    moved = (np.abs(_values(run, model, name, states, one) - values) for one in errors)
    return values, sum(moved, np.zeros(values.shape))


def _beyond(values: Floats, time: Floats, row: int) -> float:
    """Return how far the parabola through an extreme row and its neighbours goes beyond it; 0 at either end."""
    if not 0 < row < len(values) - 1:
        return 0.0
    before, after = time[row] - time[row - 1], time[row + 1] - time[row]
    if not (before > 0.0 and after > 0.0):
        return 0.0
    left, right = (values[row] - values[row - 1]) / before, (values[row + 1] - values[row]) / after
    bend, slope = (right - left) / (before + after), (left * after + right * before) / (before + after)
    return float(slope**2 / abs(4.0 * bend)) if bend else 0.0


def _humps(values: Floats, time: Floats) -> Rows:
    """Return the rows that lie no lower than both neighbours, and higher than one: as many as are searched, the highest."""
    inner = np.pad(values, 1, constant_values=-np.inf)
    rows = np.flatnonzero((values >= inner[:-2]) & (values >= inner[2:]) & (values > np.minimum(inner[:-2], inner[2:])))
    rows = rows[(time[np.minimum(rows + 1, len(time) - 1)] > time[np.maximum(rows - 1, 0)])]
    return rows[np.argsort(values[rows], kind="stable")[-MOST_HUMPS:]]


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
            f"{word}_{name}_rule": ((), np.int8(one.rule), {"units": "1", "long_name": "an accepted state, a state between, or one at an event", "role": "flag"} | rules),
            f"{word}_{name}_uncertainty": ((), one.uncertainty, {"units": units, "long_name": f"what interpolation may have {word}_{name} off; the error of the integration is not in it", "role": "error"}),
        }  # fmt: skip
    return found
