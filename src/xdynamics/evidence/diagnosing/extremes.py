"""The largest and the least value of a quantity over a run: sampled, interpolated, or located by an event, and which."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.inside import sampled
from xdynamics.methods.scheme import REINTEGRATE

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Rows = NDArray[np.int64]

SAMPLED, INTERPOLATED, LOCATED = range(3)
RULES = ("sampled", "interpolated", "located")
MOST_HUMPS = 1000  # that are searched, the highest among accepted states
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
        Of the value, by interpolation alone: 0 of an accepted state.
    """

    value: float
    time: float
    rule: int
    uncertainty: float


def extreme(run: xr.Dataset, name: str, sign: float, functions: Mapping[str, Callable[..., float]] | None) -> Extreme:
    """Find the largest value of a quantity, or with a sign of -1 the least.

    A state at an event that is above all others stands as it is. Else the steps to and from each row that is no lower than
    its neighbours are searched, by states of the run's own method between; energies and observables are looked at in
    accepted states alone.
    """
    values, time = np.asarray(run[name]), np.asarray(run["time"])
    row = int(np.nanargmax(sign * values))
    kind = int(run["row_kind"][row])
    best = Extreme(float(values[row]), float(time[row]), SAMPLED, 0.0)
    if kind in (schema.EVENT_BEFORE, schema.EVENT_AFTER):
        best = best._replace(rule=LOCATED)
    if run[name].attrs["role"] not in ("coordinate", "velocity", "state"):
        return best
    humps = _humps(sign * values, time)
    low, high = time[np.maximum(humps - 1, 0)], time[np.minimum(humps + 1, len(time) - 1)]
    for _ in range(ROUNDS):
        places = low + (high - low) * np.linspace(0.0, 1.0, LOOKS)[:, None]
        if not (high > low).all():
            break
        found = sampled(run, places.ravel(), after=False, rule=REINTEGRATE, functions=functions)
        looked = np.asarray(found[name]).reshape(places.shape)
        k, each = np.nanargmax(sign * looked, axis=0), np.arange(len(low))
        top = int(np.nanargmax(sign * looked[k, each]))
        value = float(looked[k[top], top])
        if sign * value > sign * best.value:
            doubts = np.abs(np.asarray(found[schema.error(name)])).reshape(places.shape)
            best = Extreme(value, float(places[k[top], top]), INTERPOLATED, float(doubts[k[top], top]))
        low, high = places[np.maximum(k - 1, 0), each], places[np.minimum(k + 1, LOOKS - 1), each]
    return best


def _humps(values: Floats, time: Floats) -> Rows:
    """Return the rows that lie no lower than both neighbours: as many as are searched, the highest of them."""
    inner = np.pad(values, 1, constant_values=-np.inf)
    rows = np.flatnonzero((values >= inner[:-2]) & (values >= inner[2:]))
    rows = rows[(time[np.minimum(rows + 1, len(time) - 1)] > time[np.maximum(rows - 1, 0)])]
    return rows[np.argsort(values[rows], kind="stable")[-MOST_HUMPS:]]


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
