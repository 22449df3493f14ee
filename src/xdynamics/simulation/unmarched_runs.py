"""Runs and states that are described before they are marched, with dask arrays behind them.

States of a run at wanted times may take the place of its record. The source and the destination of a run are checked
before the march.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, record, schema
from xdynamics.archive.folder_store import is_same
from xdynamics.archive.store import GIVEN, Given, Place, location_of
from xdynamics.dynamics.recorded_steps import wanted_times
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.runs import march_with_settings, record_march
from xdynamics.evidence.sampling import sample
from xdynamics.evidence.stage_tasks import MARCH, Task
from xdynamics.evidence.stages import Stage
from xdynamics.faults import AccuracyWarning, InputError, warn
from xdynamics.keywords import FULL, STATES
from xdynamics.march import March, Settings
from xdynamics.march.outcomes import GOOD, INTERRUPTED, OUTCOMES
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record.flag_words import without_bounds
from xdynamics.record.folding import fold, labelled
from xdynamics.record.named_rows import rows_named
from xdynamics.record.run_dataset import KNOWN_BEFORE
from xdynamics.record.schemas import ending_words, kind_description
from xdynamics.units import Unit, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.march.runner import Progress


@contextmanager
def open_source_run(run: xr.Dataset | Given, path: Given | None, verb: str) -> Iterator[xr.Dataset]:
    """Open or check a run from which another is made at `path`; the verb is for messages.

    Raises
    ------
    InputError
        If it is no whole run, was edited, or is the file that the other run would replace.
    """
    participle = f"{verb.removesuffix('e')}ed"
    is_archive = isinstance(run, GIVEN)
    if isinstance(run, GIVEN) and path is not None and is_same(location_of(path), location_of(run)):
        raise InputError(f"'{path}' is the archive that is {participle}; name another file")
    with archive.open_run(run) if isinstance(run, GIVEN) else nullcontext(run) as source_run:
        record.check_kind(source_run)
        if not is_archive:
            archive.check_unchanged(source_run)
        if kind := kind_description(source_run.attrs):
            raise InputError(f"the run cannot be {participle}, it is {kind}; {verb} the run itself")
        yield source_run


def check_destination(path: Any, *, resume: bool) -> None:
    """Check the file of a run, before anything is marched.

    Raises
    ------
    InputError
        If the path is no name of a file, or a run is to be resumed without one.
    """
    if path is not None and not isinstance(path, GIVEN):
        raise InputError(f"path is {path!r}, needs the name of a file")
    if resume and path is None:
        raise InputError("resume needs path=…, the file that the run was to be streamed to")


def marched_record(
    march: March,
    path: Given | None,
    earlier_rows: Iterable[tuple[str, Any]] = (),
    *,
    resume: bool = False,
    memory: str | float | None = None,
) -> xr.Dataset:
    """March, warn of inaccuracies, and return the record; see `record_march`."""
    run = record_march(march, path, earlier_rows, resume=resume, memory=memory)
    warn_of_accuracy(march, run)
    return run


def warn_of_accuracy(march: March, run: xr.Dataset) -> None:
    """Warn of errors that the tolerances of a finished run did not control, and of a run that came to no good end."""
    if run.attrs["run_outcome"] not in (*GOOD, OUTCOMES[INTERRUPTED].word):
        warn(f"{march.model.name} {EARLY}: {ending_words(run.attrs)[0]}", AccuracyWarning)
    for doubt in march.doubts:
        warn(f"{march.model.name}: {doubt}", AccuracyWarning)


EARLY = "did not reach the end that was asked for"
Floats = NDArray[np.float64]


def times_within(times: Any, unit: Unit, start: float, until: float) -> Floats:
    """Read the times to return states at, before anything is marched.

    Raises
    ------
    InputError
        If one is no time of the run.
    """
    sample_times = wanted_times(times, unit)
    times_outside = sample_times[(sample_times < start) | (sample_times > until)]
    if times_outside.size:
        raise InputError(
            f"times have {float(times_outside[0])!r}{unit_suffix(unit)}, and the run goes from {start!r}{unit_suffix(unit)} to"
            f" {until!r}{unit_suffix(unit)}"
        )
    return sample_times


def check_sampled(settings: Settings) -> None:
    """Check that settings record in a file the rows from which states at wanted times are computed.

    Raises
    ------
    InputError
        Naming them.
    """
    if settings.keep_every > 1 or settings.log not in (FULL, STATES):
        word = "keep_every" if settings.keep_every > 1 else "log"
        raise InputError(
            f"times are sampled from the rows of the file, and {word} leaves some of what they need out of it: leave"
            f" out times or {word}"
        )


def sampled_march(model: Model, settings: Settings, sample_times: Floats, progress: Progress | None) -> xr.Dataset:
    """March, and keep the part of the log from which states at wanted times are computed, a step for each."""
    kept_times = None if model.delays else sample_times  # delayed values are of all rows
    march = March(model, replace(settings, keep_every=1, log=STATES), progress, kept_times)
    partial_run = record.dataset(march)
    warn_of_accuracy(march, partial_run)
    states = sampled_states(partial_run, sample_times, model)
    if model.delays:
        return states
    rows = states["row"]
    return states.assign(row=rows.copy(data=partial_run[schema.STEP_NUMBER.name].values[rows.values]))


def add_events(states: xr.Dataset, run: xr.Dataset) -> xr.Dataset:
    """Add the events of a run to its states at wanted times: when each was, and the state after it."""
    import xarray as xr

    rows_after = rows_named(run, "event_row_after")
    variables = {name: run.variables[name].copy(deep=False) for name in ("event_time", "event_detector")}
    variables["event_time"].attrs = without_bounds(run.variables["event_time"].attrs)
    for name, variable in run.variables.items():
        if variable.dims[:1] == (schema.STEPS,) and variable.attrs.get("role") in schema.OF_MOTION:
            attributes = {"units": variable.attrs["units"], "long_name": f"{name} after the event", "role": "event"}
            variables[f"after_{name}"] = xr.Variable(
                (schema.EVENTS, *variable.dims[1:]), variable.values[rows_after], attributes
            )
    return states.assign(variables)


def sampled_states(run: xr.Dataset, sample_times: Floats | None, model: Model) -> xr.Dataset:
    """Return the states at wanted times, as far as the run came; the record where none are wanted."""
    if sample_times is None:
        return run
    reached_times = sample_times[sample_times <= float(run["time"][-1])]
    states = (
        sample(run, reached_times, functions=model.functions)
        if reached_times.size
        else sample(run, float(run["time"][-1])).isel(at=slice(0))
    )
    return states.assign_attrs({key: run.attrs[key] for key in ("run_outcome", "run_outcome_text")})


OUTCOME = {"run_outcome": "how the run ended, in one word", "run_outcome_text": "how the run ended, as a sentence"}
COUNTED = (
    schema.STEPS,
    schema.EVENTS,
    schema.TRIALS,
    schema.SAMPLES,
    schema.CLOSED_LINKS,
)  # dimensions that sizes can be given of


def unmarched_run(
    model: Model,
    settings: Settings,
    sample_times: NDArray[np.float64] | None,
    path: Given | None,
    memory: str | float | None,
    sizes: Mapping[str, int],
) -> xr.Dataset:
    """Describe the record of a march, or states at wanted times; see `simulate`.

    Raises
    ------
    InputError
        If a size is missing that only marching tells, or is no number.
    """
    march = March(model, settings)
    location = None if path is None else location_of(path)
    task = _march_task(march, location, memory)
    if sample_times is None:
        run = record.described(march, _read_sizes(march, sizes))
        known_names = [
            str(name) for name, variable in run.variables.items() if variable.attrs.get("role") in KNOWN_BEFORE
        ]
        foreseen = labelled(record.foreseen(march))
        stage = Stage(task, lambda: _with_outcome(run), [*known_names, schema.GIVEN_STEP.name], foreseen)
        return stage.result(compute=False)
    if sizes:
        raise InputError(f"sizes are {dict(sizes)}, and times say already how many states there are; leave sizes out")
    if location is None:
        task = Task.of(
            "states", partial(sampled_march, model, settings, sample_times, None), (), task.name, sample_times.tolist()
        )
    else:
        check_sampled(settings)
        task = Task.of("states", partial(_sample_record, model, sample_times), (task,), sample_times.tolist())
    run = record.described(march, {schema.STEPS: 1})
    states = StepInterpolator.of_run(run, model.functions, REINTEGRATE).blank(sample_times)
    template = labelled(fold(states, record.shapes_of(run)))
    known_names = [schema.AT_TIME, *(str(name) for name in template.variables if name not in states.variables)]
    return Stage(task, lambda: _with_outcome(template), known_names).result(compute=False)


def _march_task(march: March, location: Place | None, memory: str | float | None) -> Task:
    """Return the task of a march, named alike in every stage that needs this march."""
    words = [record.input_digest(march), *(["compressed"] if march.settings.compress else [])]
    name = "-".join([MARCH, *words, *([str(location)] if location is not None else [])])
    call = partial(march_with_settings, march.model, march.settings, location, memory)
    return Task(name, call, lasting=location is None, steps=float(march.expected_rows or 0))


def _sample_record(model: Model, sample_times: NDArray[np.float64], run: xr.Dataset) -> xr.Dataset:
    return sampled_states(run, sample_times, model)


def _with_outcome(template: xr.Dataset) -> xr.Dataset:
    """Add how the run ended: an attribute of the record, and not known before."""
    import xarray as xr

    about = {name: {"units": "1", "long_name": text, "role": "outcome"} for name, text in OUTCOME.items()}
    return template.assign({name: xr.Variable((), "", attributes) for name, attributes in about.items()})


def _read_sizes(march: March, requested_sizes: Any) -> dict[str, int]:
    """Read the sizes of the record's dimensions; those of a grid without events are known."""
    if not isinstance(requested_sizes, Mapping):
        raise InputError(f"sizes are {requested_sizes!r}, need numbers by dimension, like {{'step': 5000}}")
    for dim, size in requested_sizes.items():
        if dim not in COUNTED:
            raise InputError(f"sizes name {dim!r}; there are {', '.join(COUNTED)}")
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise InputError(f"sizes have {size!r} for '{dim}', need a positive whole number")
    if schema.STEPS in requested_sizes:
        return dict(requested_sizes)
    if (rows := _grid_row_count(march)) is None:
        raise InputError(
            f"how many rows the run of '{march.model.name}' has is known only once it is computed: its steps are chosen,"
            " or events, nodes or keep_every decide which rows there are. Give a size, sizes={'step': 5000}, say; times=…"
            " for states at these times; or compute=True"
        )
    return {schema.STEPS: rows, **requested_sizes}


def _grid_row_count(march: March) -> int | None:
    """Return the number of rows of a march on a grid without events; else None."""
    settings, layout = march.settings, march.layout
    if settings.adaptive or layout.watched or layout.reactions.size or march.thinning or len(march.run.nodes):
        return None
    if isinstance(settings.step, tuple):
        return len(settings.step) + 1
    plan = march.run.plan[0]
    count = max(1, round((plan.end - plan.start) / plan.step_size) - 1)
    while plan.start + count * plan.step_size < plan.end - march.run.snaps[0]:  # as the march ends its grid
        count += 1
    return int(count) + 1
