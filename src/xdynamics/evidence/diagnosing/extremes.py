"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event, and which."""

from __future__ import annotations

from collections.abc import Callable, Mapping
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


def extreme(run: xr.Dataset, name: str, sign: float, functions: Functions | None) -> Extreme:
    """Find the largest value of a quantity, or with a sign of -1 the least.

    A state at an event that is above all others stands as it is. Else the steps to and from each row that is no lower than
    its neighbours are searched, by states of the run's own method between, on which forces, contact forces, energies and
    observables are evaluated. Forces in Python are looked at in accepted states alone: how far the parabola through the
    largest and its neighbours goes beyond it is then what the value is uncertain by.
    """
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    row = int(np.nanargmax(sign * values))
    kind = int(run["row_kind"][row])
    best = Extreme(float(values[row]), float(time[row]), SAMPLED, 0.0)
    if kind in (schema.EVENT_BEFORE, schema.EVENT_AFTER):
        best = best._replace(rule=LOCATED)
    model = model_of(run, functions)
    if run[name].attrs["role"] not in STATES and model.python_functions:
        return best._replace(uncertainty=_beyond(values, time, row) if best.rule == SAMPLED else 0.0)
    humps = _humps(sign * values, time)
    low, high = time[np.maximum(humps - 1, 0)], time[np.minimum(humps + 1, len(time) - 1)]
    for _ in range(ROUNDS):
        places = low + (high - low) * np.linspace(0.0, 1.0, LOOKS)[:, None]
        if not (high > low).all():
            break
        looked, doubts = (one.reshape(places.shape) for one in between(run, model, name, places.ravel(), functions))
        k, each = np.argmax(np.where(np.isnan(looked), -np.inf, sign * looked), axis=0), np.arange(len(low))
        top = int(np.argmax(sign * looked[k, each]))
        value = float(looked[k[top], top])
        if sign * value > sign * best.value:
            best = Extreme(value, float(places[k[top], top]), INTERPOLATED, float(doubts[k[top], top]))
        low, high = places[np.maximum(k - 1, 0), each], places[np.minimum(k + 1, LOOKS - 1), each]
    return best


def between(run: xr.Dataset, model: Model, name: str, times: Floats, functions: Functions | None) -> tuple[Floats, Floats]:  # fmt: skip
    """Return a quantity at times inside steps, and what the interpolation of the state may have it off."""
    found = sampled(run, times, after=False, rule=REINTEGRATE, functions=functions)
    if name in found:
        return np.asarray(found[name]), np.abs(np.asarray(found[schema.error(name)]))
    rows, units = np.asarray(found["row"]), float(parse_unit(str(run[name].attrs["units"])).factor)
    states = {one: np.asarray(found[one]) for one in model.units}

    def evaluated(more: dict[str, Floats]) -> Floats:
        return evaluated_on(run, model, [tree_of(model, name)], states | more, times, rows)[0] / units

    values = evaluated({})
    errors = {one: np.asarray(found[schema.error(one)]) for one in model.units}
    moved = (np.abs(evaluated({one: states[one] + off}) - values) for one, off in errors.items() if off.any())
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


def extremes_of(run: xr.Dataset, name: str, functions: Any) -> dict[str, tuple[Any, ...]]:
    """Return the variables that say the largest and the least value of a quantity."""
    units = str(run[name].attrs["units"])
    found: dict[str, tuple[Any, ...]] = {}
    rules = schema.flags(dict(enumerate(RULES)))
    for word, sign in (("maximum", 1.0), ("minimum", -1.0)):
        one = extreme(run, name, sign, functions)
        said = "largest" if sign > 0 else "least"
        found |= {
            f"{word}_{name}": ((), one.value, {"units": units, "long_name": f"{said} {name} of the run", "role": "diagnostic"}),
            f"{word}_{name}_time": ((), one.time, {"units": "s", "long_name": f"when {name} was {said}", "role": "diagnostic"}),
            f"{word}_{name}_rule": ((), np.int8(one.rule), {"units": "1", "long_name": "an accepted state, a state between, or one at an event", "role": "flag"} | rules),
            f"{word}_{name}_uncertainty": ((), one.uncertainty, {"units": units, "long_name": f"what interpolation may have {word}_{name} off; the error of the integration is not in it", "role": "error"}),
        }  # fmt: skip
    return found
