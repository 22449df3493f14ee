"""Limiting cases: one parameter moved to its limit, everything else fixed, and how runs approach the limiting run."""

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
from xdynamics.units import Unit, parse_quantity, time_in, unit_suffix

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
    """March a model with one parameter ever closer to a limit, and at the limit itself.

    Parameters
    ----------
    model : Model
    parameter : str
        The parameter that is moved; everything else, including initial state and output times, stays fixed.
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
        Over `level`: `parameter_value`, `run_digest`, `run_outcome`. Over `level` and `at`, for each observable y: y,
        `distance_y` (y less that of the limit), `order_y` (of the distance, in the distance of the parameter; in that
        of its inverse if the limit is so large that it stands for infinity: attribute `order_in`). Over `at`:
        `limit_y`, and `approached_y`, 1 where every distance is less than the one before.

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
        [time_in(model.time_unit, item, "at") for item in ([at] if isinstance(at, str | float | int) else at)]
    )
    requested = [observables] if isinstance(observables, str) else observables
    names = tuple(model.units) if requested is None else tuple(requested)
    models = [model.replace(parameters={parameter: value}) for value in (*numbers.tolist(), end)]
    runs = [march(item, **{"force_samples": "none"} | asked) for item in models]
    for run, value in zip(runs, (*numbers.tolist(), end), strict=True):
        if float(run["time"][-1]) < float(times.max()):
            why = run.attrs["run_outcome_text"]
            raise InputError(f"with {parameter} = {value!r} {unit.text} the run ends before: {why}")
    samples = [observe(run, item, names, times) for run, item in zip(runs, models, strict=True)]
    variables: dict[str, Any] = {
        "parameter_value": ((LEVEL,), numbers, about(unit.text, f"{parameter} of the level", ROLE)),
        "run_digest": (
            (LEVEL,),
            np.array([archive.digest_of_run(run) for run in runs[:-1]]),
            about("1", "content digest of the level's run", "digest"),
        ),
        "run_outcome": (
            (LEVEL,),
            np.array([str(run.attrs["run_outcome"]) for run in runs[:-1]]),
            about("1", "outcome of the level's run", "outcome"),
        ),
        AT_TIME: ((AT,), times, about(model.time_unit.text, "time of comparison", "time")),
    }
    distances, order_in = _distance(parameter, numbers, end)
    for name in names:
        levels = np.stack([item[name][0] for item in samples])
        variables |= _approach(name, str(runs[0][name].attrs["units"]), levels[:-1], levels[-1], distances)
    attributes = {
        "order_in": order_in,
        "parameter": parameter,
        "limit": end,
        "limit_units": unit.text,
        "model_digest": model.digest,
    }
    digests = [archive.digest_of_run(run) for run in runs]
    return exhibit("limiting case", f"{model.name}: {parameter} to {end!r} {unit.text}", digests, variables, attributes)


def _values(
    model: Model, parameter: str, values: Sequence[str | float], limit: str | float
) -> tuple[Unit, Floats, float]:
    """Read the values of a parameter and its limit, in its own unit."""
    if parameter not in model.parameters:
        raise InputError(f"'{parameter}' is no parameter; there are {', '.join(model.parameters) or 'none'}")
    unit = model.parameters[parameter].quantity.unit

    def read(value: Any) -> float:
        if not isinstance(value, str):
            return float(value)
        quantity = parse_quantity(value)
        if quantity.unit.dimension != unit.dimension:
            raise InputError(f"{parameter} {value!r} has units '{quantity.unit.dimension}', needs '{unit.text}'")
        return quantity.si / float(unit.factor)

    end, numbers = read(limit), np.array([read(number) for number in values])
    distances = np.abs(numbers - end)
    if len(numbers) < FEWEST or not (np.diff(distances) < 0.0).all() or not distances[-1] > 0.0:
        texts = [*map(str, values)]
        raise InputError(f"values of '{parameter}' are {texts}, need {FEWEST} or more that come closer to {limit!r}")
    return unit, numbers, end


def _distance(parameter: str, values: Floats, limit: float) -> tuple[Floats, str]:
    """Return the distances of values from their limit, by inverses if it stands for infinity, and what they are in."""
    distances = np.abs(values - limit)
    far = bool((log(distances[:-1] / distances[1:]) <= LEAST_NEARER).any())
    if far and values.all() and abs(limit) > float(np.max(np.abs(values))):
        return np.abs(1.0 / values - 1.0 / limit), f"1/{parameter}"
    return distances, parameter


def _approach(name: str, units: str, values: Floats, limit: Floats, parameter_distances: Floats) -> dict[str, Any]:
    """Return the variables of one quantity's approach to its limit; levels first."""
    distance = values - limit
    with np.errstate(divide="ignore", invalid="ignore"):
        nearer = log(parameter_distances[:-1] / parameter_distances[1:])
        # values at equal distances from a limit have no order in it
        nearer = np.where(nearer > LEAST_NEARER, nearer, np.nan)
        orders = log(np.abs(distance[:-1] / distance[1:])) / nearer[:, None]
    sizes = np.abs(distance)
    closer = ((np.diff(sizes, axis=0) < 0.0) | (sizes[1:] == 0.0)).all(axis=0)
    dims = (LEVEL, AT)
    return {
        name: (dims, values, about(units, name, ROLE)),
        f"distance_{name}": (dims, distance, about(units, f"{name} less that of the limit", ROLE)),
        f"order_{name}": (
            dims,
            np.vstack([np.full(len(limit), np.nan)[None], orders]),
            about("1", f"order of the distance of {name} in that of the parameter, from the level before", ROLE),
        ),
        f"limit_{name}": ((AT,), limit, about(units, f"{name} with the parameter at its limit", ROLE)),
        f"approached_{name}": (
            (AT,),
            closer.astype(np.int8),
            about("1", "1 where every distance is less than the one before", ROLE),
        ),
    }


def lines_of(study: xr.Dataset) -> Iterator[str]:
    """Describe the approach of each quantity to its limit, line by line."""
    for name in [str(key).removeprefix("distance_") for key in study.data_vars if str(key).startswith("distance_")]:
        units = study[name].attrs["units"]
        for k, time in enumerate(study[AT_TIME].values.tolist()):
            last, order = float(study[f"distance_{name}"][-1, k]), float(study[f"order_{name}"][-1, k])
            word = "approached" if int(study[f"approached_{name}"][k]) else "not approached"
            shown = f"order {order:.3g}, " if np.isfinite(order) else ""
            yield (
                f"{name} at t = {time:.9g}{unit_suffix(time_unit(study))}: {last:.3g} {units} from its limit, {shown}{word}"
            )


SUMMARIES = {"limiting case": lines_of}
