"""Runs and states that are described before they are marched, with dask arrays behind them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.place import Given, Place, location_of
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.evidence.runs import march_with_settings
from xdynamics.evidence.stage_tasks import MARCH, Task
from xdynamics.evidence.stages import Stage, lazy_stage
from xdynamics.faults import InputError
from xdynamics.march import March, Settings
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.whole import is_read_by_quantity
from xdynamics.record.folding import fold, labelled
from xdynamics.record.run_dataset import KNOWN_BEFORE
from xdynamics.schema import AT, AT_TIME, CLOSED_LINKS, EVENTS, GIVEN_STEP, SAMPLES, STEPS, TRIALS
from xdynamics.simulation.wanted_states import check_sampled, sampled_march, sampled_states

if TYPE_CHECKING:
    import xarray as xr

OUTCOME = {"run_outcome": "how the run ended, in one word", "run_outcome_text": "how the run ended, as a sentence"}
COUNTED = (STEPS, EVENTS, TRIALS, SAMPLES, CLOSED_LINKS)  # dimensions that sizes can be given of


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
        foreseen = foreseen if is_read_by_quantity(model) else record.unfold(foreseen)
        return lazy_stage(Stage(_with_outcome(run), task, [*known_names, GIVEN_STEP.name], foreseen))
    if sizes:
        raise InputError(f"sizes are {dict(sizes)}, and times say already how many states there are; leave sizes out")
    if location is None:
        task = Task.of(
            "states", partial(sampled_march, model, settings, sample_times, None), (), task.name, sample_times.tolist()
        )
    else:
        check_sampled(settings)
        task = Task.of("states", partial(_sample_record, model, sample_times), (task,), sample_times.tolist())
    run = record.described(march, {STEPS: 1})
    states = StepInterpolator.of_run(run, model.functions, REINTEGRATE).blank(len(sample_times))
    states = states.assign_coords({AT_TIME: (AT, sample_times, states[AT_TIME].attrs)})
    template = labelled(fold(states, record.shapes_of(run)))
    known_names = [AT_TIME, *(str(name) for name in template.variables if name not in states.variables)]
    return lazy_stage(Stage(_with_outcome(template), task, known_names))


def _march_task(march: March, location: Place | None, memory: str | float | None) -> Task:
    """Return the task that marches, the same as of any stage that marches so too."""
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
    if STEPS in requested_sizes:
        return dict(requested_sizes)
    if (rows := _grid_row_count(march)) is None:
        raise InputError(
            f"how many rows the run of '{march.model.name}' has is known only once it is marched: its steps are chosen,"
            " or events, nodes or keep_every decide which rows there are. Give a size, sizes={'step': 5000}, say; times=…"
            " for states at these times; or compute=True"
        )
    return {STEPS: rows, **requested_sizes}


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
