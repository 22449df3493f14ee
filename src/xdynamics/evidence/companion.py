"""The error that a run has accumulated since its start, by one more run of the same model at a tighter setting."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, schema
from xdynamics.dynamics.recorded_steps import model_of_record, wanted_times
from xdynamics.dynamics.shortened_steps import StepInterpolator, sample_in_steps
from xdynamics.evidence.evidence_dataset import attrs_of, event_rows_by_name, evidence_dataset, match_times
from xdynamics.evidence.runs import prepare_record
from xdynamics.evidence.stage_tasks import Task, march_task, results_of
from xdynamics.evidence.stages import Stage, task_of, task_of_runs
from xdynamics.faults import InputError
from xdynamics.march.configuration import THINNING
from xdynamics.march.outcomes import GOOD
from xdynamics.methods import METHODS
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record import check_kind, shapes_of, unfold
from xdynamics.record.arguments import recorded_arguments
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.schemas import is_whole, kind_description
from xdynamics.schema import AT_TIME, EVENTS
from xdynamics.units import Quantity, unit_suffix
from xdynamics.units.digits import digits

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]

TIGHTER = 10.0  # factor between tolerances


@dataclass(frozen=True)
class Tighter:
    """The tighter settings by which a record's model is marched once more.

    Attributes
    ----------
    model : Model
    settings : dict
        Of the march.
    factor : float
        By which the difference between both runs is multiplied to give the error of the record: Richardson's, with the
        order of the method in its step, and 1 in the tolerance.
    tightening : str
        In words, what is tighter.
    """

    model: Model
    settings: Mapping[str, Any]
    factor: float
    tightening: str

    @property
    def task(self) -> Task:
        """The task that marches it.

        Raises
        ------
        InputError
            If no march can have such settings.
        """
        with _no_tighter():
            return march_task(self.model, **self.settings)

    def marched(self) -> xr.Dataset:
        """March it in this process, and return the run.

        Raises
        ------
        InputError
            If no march can have such settings.
        """
        with _no_tighter():
            marched: xr.Dataset = results_of(march_task(self.model, **self.settings))[0]
        return marched

    def to_companion(self, run: xr.Dataset, marched: xr.Dataset, functions: Functions | None) -> Companion:
        """Return the marched run as the companion of the record."""
        return Companion(run, marched, self.factor, self.tightening, functions)

    def blank_global_errors(self, states: xr.Dataset) -> xr.Dataset:
        """Describe the global errors of sampled states that are described themselves."""
        return _with_global_errors(
            states, {name: states.variables[name].values for name in _state_names(states)}, self.factor, self.tightening
        )


@dataclass(frozen=True)
class Companion:
    """One more run of a record's model at a tighter setting, from the record alone.

    Attributes
    ----------
    full_record, run : xarray.Dataset
        The record, and the tighter run.
    factor : float
    tightening : str
        As in `Tighter`.
    functions : mapping, optional
    """

    full_record: xr.Dataset
    run: xr.Dataset
    factor: float
    tightening: str
    functions: Functions | None

    def with_global_errors(self, states: xr.Dataset) -> xr.Dataset:
        """Add global errors to sampled states; nan after the end of the tighter run."""
        times = states[AT_TIME].values
        reached = times <= float(self.run["time"][-1])
        names, errors = _state_names(states), {}
        tight = sample_in_steps(
            self.holding(names), times[reached], after_event=True, rule=REINTEGRATE, functions=self.functions
        )
        for name in names:
            errors[name] = np.full(states.variables[name].shape, np.nan)
            errors[name][reached] = self.factor * (
                states.variables[name].values[reached] - tight.variables[name].values
            )
        return _with_global_errors(states, errors, self.factor, self.tightening).assign_attrs(
            companion_digest=archive.digest_of_run(self.run)
        )

    def holding(self, names: Sequence[str]) -> xr.Dataset:
        """Return the tighter run with variables of these names, which may be those of elements."""
        return self.run if all(name in self.run.variables for name in names) else unfold(self.run)

    def event_errors(self) -> Floats:
        """Return the error of each event's time, s; nan where the tighter run did not meet the event."""
        errors = np.full(self.full_record.sizes.get(EVENTS, 0), np.nan)
        event_rows = [event_rows_by_name(run) for run in (self.full_record, self.run)]
        for name in {*event_rows[0]} & {*event_rows[1]}:
            rows, tighter_rows = (events[name] for events in event_rows)
            times, tight = self.full_record["event_time"].values[rows], self.run["event_time"].values[tighter_rows]
            mine, theirs = match_times(times, tight)
            errors[rows[mine]] = self.factor * (times[mine] - tight[theirs])
        return errors


def global_error(name: str) -> str:
    """Return the name of the error that a variable has accumulated since the start of a run."""
    return f"global_error_{name}"


def companion(
    run: xr.Dataset,
    times: Sequence[float] | Floats | float | str | None = None,
    *,
    functions: Functions | None = None,
    compute: bool = True,
) -> xr.Dataset:
    """Estimate the global errors of a run by one more run with half the steps or a tenth of the tolerances.

    Parameters
    ----------
    run : xarray.Dataset
        A run record, in memory or opened from an archive.
    times : array_like of float, shape (n,), s, optional
        Where to estimate; by default at the end of the run, or of the tighter one where an event stops that first.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    compute : bool
        Whether to march at once. If False, the Dataset has dask arrays, and the run is marched when one is computed;
        the record has to be open then.

    Returns
    -------
    xarray.Dataset
        Along `at`: every coordinate, velocity and state, `error_…` of its interpolation and `global_error_…`, which it
        has accumulated since the start: value less that of the solution. Along `event`: `event_time`,
        `event_time_global_error`, nan where the tighter run met the event less often.

    Raises
    ------
    InputError
        If there is no tighter setting, or the Dataset is not a run record.

    Notes
    -----
    Richardson's estimate, with the order p of the method: the difference from the run with half the steps, times
    2**p/(2**p - 1); errors are proportional to tolerances, so from the run with a tenth of them, times 10/9.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> run = xd.simulate(model, method="rk4", step="50 ms", until="2 s")
    >>> true = float(run.x[-1]) - np.cos(4.0)
    >>> bool(abs(companion(run).global_error_x[0] - true) < 0.1*abs(true))
    True
    """
    check_kind(run)
    run = prepare_record(run, functions)
    sample_times = None if times is None else wanted_times(times, time_unit_of(run))
    tighter = tighter_of(run, functions)
    words = None if sample_times is None else sample_times.tolist()
    estimated = partial(_beside_tighter, tighter, functions, sample_times)
    if compute:
        return estimated(run, tighter.marched())
    task = task_of_runs("companion", estimated, (run,), words, needs=(tighter.task,), read=True)
    template = partial(_blank_companion, run, tighter, functions, sample_times)
    return Stage(task, template, () if sample_times is None else (AT_TIME,)).result(compute=False)


def _beside_tighter(
    tighter: Tighter, functions: Functions | None, sample_times: Floats | None, run: xr.Dataset, marched: xr.Dataset
) -> xr.Dataset:
    """Return the errors of a record by its tighter run."""
    companion = tighter.to_companion(run, marched, functions)
    last = min(float(data["time"][-1]) for data in (run, marched))  # an event may stop the tighter run first
    times = np.array([last]) if sample_times is None else sample_times
    states = sample_in_steps(run, times, after_event=True, rule=REINTEGRATE, functions=functions)
    states = companion.with_global_errors(states)
    digests = [archive.digest_of_run(run), states.attrs["companion_digest"]]
    return _companion_dataset(run, states, run["event_time"].values, companion.event_errors(), digests)


def _blank_companion(
    run: xr.Dataset, tighter: Tighter, functions: Functions | None, sample_times: Floats | None
) -> xr.Dataset:
    """Return the errors of a record before its tighter run is marched."""
    times = np.full(1, np.nan) if sample_times is None else sample_times
    states = StepInterpolator.of_run(run, functions, REINTEGRATE).blank(times)
    errors = np.full(run.sizes.get(EVENTS, 0), np.nan)
    return _companion_dataset(run, tighter.blank_global_errors(states), errors, errors, ())


def _companion_dataset(
    run: xr.Dataset, states: xr.Dataset, event_times: Floats, event_errors: Floats, digests: Sequence[str]
) -> xr.Dataset:
    variables = {str(name): (data.dims, data.values, data.attrs) for name, data in states.variables.items()}
    unit = time_unit_of(run).text
    variables["event_time"] = ((EVENTS,), event_times, attrs_of(unit, "accepted time of the event", "event"))
    variables["event_time_global_error"] = (
        (EVENTS,),
        event_errors,
        attrs_of(unit, "error of the event's time since the start of the run", "error"),
    )
    attributes = {"companion": states.attrs["companion"], "model_digest": run.attrs["model_digest"]}
    return evidence_dataset(
        "companion",
        f"{run.attrs['title']}, beside a tighter run",
        digests,
        variables,
        attributes,
        shapes=shapes_of(run),
    )


def _with_global_errors(states: xr.Dataset, errors: Mapping[str, Floats], factor: float, tightening: str) -> xr.Dataset:
    """Add errors since the start to states, with their words."""
    import xarray as xr

    variables = {}
    for name, error in errors.items():
        text = f"error of {name} since the start: its difference from the run with {tightening}, times {factor:.6g}"
        state_variable = states.variables[name]
        described = attrs_of(str(state_variable.attrs["units"]), text, "error")
        # fastpath: xarray would import dask to find out that the numbers are not one of its arrays
        variables[global_error(name)] = xr.Variable(state_variable.dims, error, described, fastpath=True)
    return states.assign(variables).assign_attrs(companion=tightening)


def _state_names(states: xr.Dataset) -> list[str]:
    """Name the coordinates, velocities and states."""
    return [str(key) for key in states.variables if schema.error(str(key)) in states.variables]


def check_whole(run: xr.Dataset) -> None:
    """Check that a record is a complete run, unchanged since it was marched.

    Raises
    ------
    InputError
        Naming what it is instead, or how it was changed.
    """
    if not is_whole(run.attrs):
        raise InputError(f"this is {kind_description(run.attrs)}; a run is computed beside a whole run")
    if all(variable.chunks is None for variable in run.variables.values()):
        archive.check_unchanged(run)


@contextmanager
def _no_tighter() -> Iterator[None]:
    """Raise that settings at their limit allow no tighter run."""
    try:
        yield
    except InputError as error:
        raise InputError(f"there is no tighter run beside this one: {error}") from None


def tighter_of(run: xr.Dataset, functions: Functions | None) -> Tighter:
    """Return half the steps of a record's run, or a tenth of its tolerances.

    Raises
    ------
    InputError
        If the Dataset is not a whole run record.
    """
    check_kind(run)
    check_whole(run)
    model = model_of_record(run, functions)
    settings = {
        name: value for name, value in recorded_arguments(run).items() if value is not None and name not in THINNING
    }
    settings |= {"force_samples": "none", **reached_only(run)}
    if str(run.attrs["solver_step_control"]) == "adaptive":
        tightening = f"a {TIGHTER:.0f}th of the tolerances"
        return Tighter(model, _tightened(settings), TIGHTER / (TIGHTER - 1.0), tightening)
    step = settings["step"]
    halved = np.repeat(np.asarray(step) / 2.0, 2) if np.ndim(step) else step / 2.0
    ratio = 2.0 ** METHODS[run.attrs["solver_method"]].order
    return Tighter(model, settings | {"step": halved}, ratio / (ratio - 1.0), "half the steps")


def reached_only(run: xr.Dataset) -> dict[str, Any]:
    """Return the end of a run that failed on its way, as settings for runs beside it: beyond it nothing is compared."""
    if task_of(run) is not None or run.attrs["run_outcome"] in GOOD or schema.GIVEN_STEP.name in run:
        return {}
    begin, end = (float(run["time"][row]) for row in (0, -1))
    nodes = [time for time in np.atleast_1d(run.attrs.get("solver_nodes", ())).tolist() if time < end]
    return {"until": end, **({"nodes": nodes} if nodes else {})} if end > begin else {}


def _tightened(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings with a tenth of the tolerances; the first step is chosen again."""
    atol = {
        name: Quantity(tolerance.value / TIGHTER, tolerance.unit)
        for name, tolerance in settings.get("atol", {}).items()
    } or None
    other_settings = {name: value for name, value in settings.items() if name != "step"}
    return other_settings | {
        "rtol": settings["rtol"] / TIGHTER,
        "atol": atol,
        "max_steps": int(TIGHTER * settings["max_steps"]),
    }


def companion_lines(evidence: xr.Dataset) -> Iterator[str]:
    """Describe the errors of a run at its last time and of its events, line by line."""
    unit = unit_suffix(time_unit_of(evidence))
    yield f"beside a run with {evidence.attrs['companion']}"
    for name in [str(key) for key in evidence.data_vars if global_error(str(key)) in evidence]:
        value, error = float(evidence[name][-1]), float(evidence[global_error(name)][-1])
        yield (
            f"{name} = {value:.{digits(value, uncertainty=abs(error))}g}{unit_suffix(str(evidence[name].attrs['units']))} at t ="
            f" {float(evidence[AT_TIME][-1]):.9g}{unit}, off by {error:.2g}"
        )
    for time, error in zip(evidence["event_time"].values, evidence["event_time_global_error"].values, strict=True):
        yield (
            f"event at t = {float(time):.{digits(float(time), uncertainty=abs(float(error)))}g}{unit}, off by"
            f" {float(error):.2g}{unit}"
        )


SUMMARIES = {"companion": companion_lines}
