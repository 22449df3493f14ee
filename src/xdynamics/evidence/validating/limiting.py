"""Limiting cases: one parameter moved to its limit, all else fixed, and how runs approach the limiting run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.dynamics.recorded_steps import wanted_times
from xdynamics.elementary.arrays import log
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.observables import observables_of, observe
from xdynamics.evidence.stage_tasks import Task, march_task
from xdynamics.evidence.stages import Stage, blank_run
from xdynamics.faults import InputError
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.model import Model
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import expand_quantities, quantity_names
from xdynamics.record.unfolding import get_column
from xdynamics.schema import AT, AT_TIME, LEVEL
from xdynamics.units import Quantity, Unit, parse_quantity, time_in, unit_suffix

Floats = NDArray[np.float64]
ROLE = "limiting"
FEWEST = 2  # values
LEAST_NEARER = 0.01  # logarithm of the ratio of two distances to the limit


@dataclass(frozen=True)
class Approach:
    """A parameter that approaches a limit, and the quantities that are compared.

    Attributes
    ----------
    model : Model
    parameter : str
    unit : Unit
        Its own.
    values : ndarray, shape (n,)
        Ever closer to the limit.
    limit : float
    times : ndarray, shape (m,), s
    names : tuple of str
        Of observables.
    """

    model: Model
    parameter: str
    unit: Unit
    values: Floats
    limit: float
    times: Floats
    names: tuple[str, ...]

    @property
    def numbers(self) -> list[float]:
        """The values, and the limit last."""
        return [*self.values.tolist(), self.limit]

    @property
    def models(self) -> list[Model]:
        """The model with each of the numbers."""
        return [
            self.model.replace(parameters={self.parameter: str(Quantity(number, self.unit))}) for number in self.numbers
        ]


def limiting(
    model: Model,
    parameter: str,
    values: Sequence[str | float],
    limit: str | float,
    *,
    at: Sequence[str | float] | str | float,
    observables: Sequence[str] | None = None,
    compute: bool = True,
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
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, with one task for each value, and nothing is
        marched before one is computed.
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
    parameter = model.shapes.internal_name(parameter)
    unit, numbers, end = _parameter_values(model, parameter, values, limit)
    times = wanted_times(
        [time_in(model.time_unit, item, "at") for item in ([at] if isinstance(at, str | float | int) else at)]
    )
    requested = [observables] if isinstance(observables, str) else observables
    available = observables_of(model)
    names = (
        tuple(model.elements.units)
        if requested is None
        else expand_quantities(map(model.shapes.internal_name, requested), available, model.shapes)
    )
    if unknown := [name for name in names if name not in available]:
        raise InputError(
            f"observable '{unknown[0]}' is none of the model's; there are {', '.join(quantity_names(available))}"
        )
    approach = Approach(model, parameter, unit, numbers, end, times, names)
    settings = {"force_samples": "none"} | asked
    marches = tuple(march_task(item, **settings) for item in approach.models)
    task = Task.of("limiting", partial(_limiting_in_task, approach), marches, parameter, times.tolist(), names)

    def template() -> xr.Dataset:
        run = blank_run(March(model, unthinned_settings_for(model, **settings)))
        words, blank = [""] * len(numbers), np.full((len(numbers) + 1, times.size), np.nan)
        return _limiting_dataset(approach, run, words, words, dict.fromkeys(names, blank), ())

    return Stage(task, template, ("parameter_value", AT_TIME)).result(compute=compute)


def _limiting_in_task(approach: Approach, *runs: xr.Dataset) -> xr.Dataset:
    """Compare the runs of all numbers.

    Raises
    ------
    InputError
        If one of them ends before the last time.
    """
    parameter, unit, last = approach.parameter, approach.unit.text, float(approach.times.max())
    for run, number in zip(runs, approach.numbers, strict=True):
        if float(run["time"][-1]) < last:
            raise InputError(
                f"with {parameter} = {number!r} {unit} the run ends before: {run.attrs['run_outcome_text']}"
            )
    samples = [
        observe(run, model, approach.names, approach.times) for run, model in zip(runs, approach.models, strict=True)
    ]
    values = {name: np.stack([sample[name][0] for sample in samples]) for name in approach.names}
    digests = [archive.digest_of_run(run) for run in runs]
    outcomes = [str(run.attrs["run_outcome"]) for run in runs[:-1]]
    return _limiting_dataset(approach, runs[0], digests[:-1], outcomes, values, digests)


def _limiting_dataset(
    approach: Approach,
    run: xr.Dataset,
    level_digests: Sequence[str],
    outcomes: Sequence[str],
    values: dict[str, Floats],
    digests: Sequence[str],
) -> xr.Dataset:
    """Return how each observable, given with the limit's last, comes closer to it, in the units of a run."""
    model, parameter, unit, end = approach.model, approach.parameter, approach.unit.text, approach.limit
    variables: dict[str, Any] = {
        "parameter_value": ((LEVEL,), approach.values, attrs_of(unit, f"{parameter} of the level", ROLE)),
        "run_digest": ((LEVEL,), np.array(level_digests), attrs_of("1", "content digest of the level's run", "digest")),
        "run_outcome": ((LEVEL,), np.array(outcomes), attrs_of("1", "outcome of the level's run", "outcome")),
        AT_TIME: ((AT,), approach.times, attrs_of(model.time_unit.text, "time of comparison", "time")),
    }
    distances, order_in = _limit_distances(parameter, approach.values, end)
    for name, numbers in values.items():
        units = str(get_column(run, name).attrs["units"])
        variables |= _approach(name, units, numbers[:-1], numbers[-1], distances)
    attributes = {
        "order_in": order_in,
        "parameter": parameter,
        "limit": end,
        "limit_units": unit,
        "model_digest": model.digest,
    }
    return evidence_dataset(
        "limiting case",
        f"{model.name}: {parameter} to {end!r} {unit}",
        digests,
        variables,
        attributes,
        shapes=model.shapes,
    )


def _parameter_values(
    model: Model, parameter: str, values: Sequence[str | float], limit: str | float
) -> tuple[Unit, Floats, float]:
    """Read the values of a parameter and its limit, in its own unit."""
    elements = model.elements
    if parameter not in elements.statement.parameters:
        raise InputError(
            f"'{parameter}' is no parameter; there are {', '.join(quantity_names(elements.statement.parameters)) or 'none'}"
        )
    declared = elements.statement.parameters[parameter].quantity
    unit = declared.unit

    def to_own_unit(value: Any) -> float:
        if not isinstance(value, str):
            return declared.scale_of_numbers.value(float(value))
        quantity = parse_quantity(value)
        if quantity.unit.dimension != unit.dimension:
            raise InputError(f"{parameter} {value!r} has units '{quantity.unit.dimension}', needs '{unit.text}'")
        return quantity.si / float(unit.factor)

    end, numbers = to_own_unit(limit), np.array([to_own_unit(number) for number in values])
    distances = np.abs(numbers - end)
    if len(numbers) < FEWEST or not (np.diff(distances) < 0.0).all() or not distances[-1] > 0.0:
        texts = [*map(str, values)]
        raise InputError(f"values of '{parameter}' are {texts}, need {FEWEST} or more that come closer to {limit!r}")
    return unit, numbers, end


def _limit_distances(parameter: str, values: Floats, limit: float) -> tuple[Floats, str]:
    """Return the distances of values from their limit and their unit; inverses, if the limit stands for infinity."""
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
        name: (dims, values, attrs_of(units, name, ROLE)),
        f"distance_{name}": (dims, distance, attrs_of(units, f"{name} less that of the limit", ROLE)),
        f"order_{name}": (
            dims,
            np.vstack([np.full(len(limit), np.nan)[None], orders]),
            attrs_of("1", f"order of the distance of {name} in that of the parameter, from the level before", ROLE),
        ),
        f"limit_{name}": ((AT,), limit, attrs_of(units, f"{name} with the parameter at its limit", ROLE)),
        f"approached_{name}": (
            (AT,),
            closer.astype(np.int8),
            attrs_of("1", "1 where every distance is less than the one before", ROLE),
        ),
    }


def limiting_lines(study: xr.Dataset) -> Iterator[str]:
    """Describe the approach of each quantity to its limit, line by line."""
    for name in [str(key).removeprefix("distance_") for key in study.data_vars if str(key).startswith("distance_")]:
        units = study[name].attrs["units"]
        for k, time in enumerate(study[AT_TIME].values.tolist()):
            last, order = float(study[f"distance_{name}"][-1, k]), float(study[f"order_{name}"][-1, k])
            word = "approached" if int(study[f"approached_{name}"][k]) else "not approached"
            order_text = f"order {order:.3g}, " if np.isfinite(order) else ""
            yield (
                f"{name} at t = {time:.9g}{unit_suffix(time_unit_of(study))}: {last:.3g} {units} from its limit, {order_text}{word}"
            )


SUMMARIES = {"limiting case": limiting_lines}
