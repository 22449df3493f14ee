"""Limiting cases: one parameter moved to its limit, all else fixed, and how runs come to the limit's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.dynamics.shortened_steps import wanted_times
from xdynamics.elementary.arrays import log
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.evidence.observables import observe
from xdynamics.evidence.runs import march
from xdynamics.faults import InputError
from xdynamics.model import Model
from xdynamics.record.flag_words import time_unit
from xdynamics.schema import AT, AT_TIME, LEVEL
from xdynamics.units import Unit, behind, parse_quantity, time_in

Floats = NDArray[np.float64]
ROLE = "limiting"
FEWEST = 2  # values
LEAST_NEARER = 0.01  # logarithm of the ratio of two distances to the limit


def limiting(
    model: Model,
    parameter: str,
    values: Sequence[str | float],
    limit: str | float,
    *,
    at: Sequence[str | float] | str | float,
    observables: Sequence[str] | None = None,
    **asked: Any,
) -> xr.Dataset:
    """March a model with one parameter ever closer to a limit, and with the limit itself.

    Parameters
    ----------
    model : Model
    parameter : str
        The one that is moved; everything else, initial state and output times included, stays.
    values : sequence of str or float
        Ever closer to the limit; a bare number has the parameter's own unit.
    limit : str or float
        Like ``"0 kg m-1"``.
    at : times
        Where to compare.
    observables : sequence of str, optional
        By default all coordinates, velocities and states.
    **asked
        Settings, as for `simulate`.

    Returns
    -------
    xarray.Dataset
        Over `level`: `parameter_value`, `run_digest`, `run_outcome`. Over `level` and `at`, for each observable y: y, `distance_y` (y
        less that of the limit), `order_y` (of the distance, in the distance of the parameter; in that of its inverse,
        where the limit is so large that it stands for infinity: attribute `order_in`). Over `at`: `limit_y`,
        and `approached_y`, 1 where every distance is less than the one before.

    Raises
    ------
    InputError
        If there is no such parameter, values do not come closer, or a setting is wrong.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/coupled_masses.toml")
    >>> found = limiting(model, "kc", [0.1, 0.01, 0.001], 0.0, at=["1 s"], method="rk4", step="10 ms", until="1 s")
    >>> found.approached_x1.values.tolist(), round(float(found.order_x1[-1, 0]), 2)
    ([1], 1.0)
    """
    unit, numbers, end = _values(model, parameter, values, limit)
    times = wanted_times(
        [time_in(model.time_unit, one, "at") for one in ([at] if isinstance(at, str | float | int) else at)]
    )
    asked_for = [observables] if isinstance(observables, str) else observables
    names = tuple(model.units) if asked_for is None else tuple(asked_for)
    models = [model.replace(parameters={parameter: value}) for value in (*numbers.tolist(), end)]
    runs = [march(one, **{"force_samples": "none"} | asked) for one in models]
    for run, value in zip(runs, (*numbers.tolist(), end), strict=True):
        if float(run["time"][-1]) < float(times.max()):
            why = run.attrs["run_outcome_text"]
            raise InputError(f"with {parameter} = {value!r} {unit.text} the run ends before: {why}")
    found = [observe(run, one, names, times) for run, one in zip(runs, models, strict=True)]
    variables: dict[str, Any] = {
        "parameter_value": ((LEVEL,), numbers, about(unit.text, f"{parameter} of the level", ROLE)),
        "run_digest": ((LEVEL,), np.array([archive.digest_of_run(run) for run in runs[:-1]]), about("1", "content digest of the level's run", "digest")),
        "run_outcome": ((LEVEL,), np.array([str(run.attrs["run_outcome"]) for run in runs[:-1]]), about("1", "outcome of the level's run", "outcome")),
        AT_TIME: ((AT,), times, about(model.time_unit.text, "time of comparison", "time")),
    }  # fmt: skip
    away, how = _distance(parameter, numbers, end)
    for name in names:
        every = np.stack([one[name][0] for one in found])
        variables |= _approach(name, str(runs[0][name].attrs["units"]), every[:-1], every[-1], away)
    said = {
        "order_in": how,
        "parameter": parameter,
        "limit": end,
        "limit_units": unit.text,
        "model_digest": model.digest,
    }
    digests = [archive.digest_of_run(run) for run in runs]
    return exhibit("limiting case", f"{model.name}: {parameter} to {end!r} {unit.text}", digests, variables, said)


def _values(
    model: Model, parameter: str, values: Sequence[str | float], limit: str | float
) -> tuple[Unit, Floats, float]:
    """Read what a parameter is moved to, and its limit, in its own unit."""
    if parameter not in model.parameters:
        raise InputError(f"'{parameter}' is no parameter; there are {', '.join(model.parameters) or 'none'}")
    unit = model.parameters[parameter].quantity.unit

    def read(given: Any) -> float:
        if not isinstance(given, str):
            return float(given)
        found = parse_quantity(given)
        if found.unit.dimension != unit.dimension:
            raise InputError(f"{parameter} {given!r} has units '{found.unit.dimension}', needs '{unit.text}'")
        return found.si / float(unit.factor)

    end, numbers = read(limit), np.array([read(one) for one in values])
    away = np.abs(numbers - end)
    if len(numbers) < FEWEST or not (np.diff(away) < 0.0).all() or not away[-1] > 0.0:
        said = [*map(str, values)]
        raise InputError(f"values of '{parameter}' are {said}, need {FEWEST} or more that come closer to {limit!r}")
    return unit, numbers, end


def _distance(parameter: str, values: Floats, limit: float) -> tuple[Floats, str]:
    """Return how far values are from their limit, in what the order is; from one that stands for infinity, by their inverses."""
    away = np.abs(values - limit)
    far = bool((log(away[:-1] / away[1:]) <= LEAST_NEARER).any())
    if far and values.all() and abs(limit) > float(np.max(np.abs(values))):
        return np.abs(1.0 / values - 1.0 / limit), f"1/{parameter}"
    return away, parameter


def _approach(name: str, units: str, values: Floats, limit: Floats, away: Floats) -> dict[str, Any]:
    """Say how one quantity comes to its limit; levels first."""
    distance = values - limit
    with np.errstate(divide="ignore", invalid="ignore"):
        nearer = log(away[:-1] / away[1:])
        # values that are all as far from a limit have no order in it
        nearer = np.where(nearer > LEAST_NEARER, nearer, np.nan)
        orders = log(np.abs(distance[:-1] / distance[1:])) / nearer[:, None]
    away_from = np.abs(distance)
    closer = ((np.diff(away_from, axis=0) < 0.0) | (away_from[1:] == 0.0)).all(axis=0)
    each = (LEVEL, AT)
    return {
        name: (each, values, about(units, name, ROLE)),
        f"distance_{name}": (each, distance, about(units, f"{name} less that of the limit", ROLE)),
        f"order_{name}": (each, np.vstack([np.full(len(limit), np.nan)[None], orders]), about("1", f"order of the distance of {name} in that of the parameter, from the level before", ROLE)),
        f"limit_{name}": ((AT,), limit, about(units, f"{name} with the parameter at its limit", ROLE)),
        f"approached_{name}": ((AT,), closer.astype(np.int8), about("1", "1 where every distance is less than the one before", ROLE)),
    }  # fmt: skip


def lines_of(found: xr.Dataset) -> Iterator[str]:
    """Say how each quantity came to its limit."""
    for name in [str(one).removeprefix("distance_") for one in found.data_vars if str(one).startswith("distance_")]:
        units = found[name].attrs["units"]
        for k, time in enumerate(found[AT_TIME].values.tolist()):
            last, order = float(found[f"distance_{name}"][-1, k]), float(found[f"order_{name}"][-1, k])
            word = "approached" if int(found[f"approached_{name}"][k]) else "not approached"
            shown = f"order {order:.3g}, " if np.isfinite(order) else ""
            yield f"{name} at t = {time:.9g}{behind(time_unit(found))}: {last:.3g} {units} from its limit, {shown}{word}"
