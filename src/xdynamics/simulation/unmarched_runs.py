"""Runs and states that are described before they are marched, with dask arrays behind them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.place import Given, Place, placed
from xdynamics.dynamics.shortened_steps import Inside
from xdynamics.evidence.runs import marched_by
from xdynamics.evidence.stage_tasks import MARCH, Task
from xdynamics.evidence.stages import Stage, lazy
from xdynamics.faults import InputError
from xdynamics.march import March, Settings
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.model.whole import is_read_whole
from xdynamics.record.folding import fold, labelled
from xdynamics.record.run_dataset import KNOWN_BEFORE
from xdynamics.schema import AT, AT_TIME, CLOSED_LINKS, EVENTS, GIVEN_STEP, SAMPLES, STEPS, TRIALS
from xdynamics.simulation.wanted_states import check_sampled, sampled_march, states_at

if TYPE_CHECKING:
    import xarray as xr

OUTCOME = {"run_outcome": "how the run ended, in one word", "run_outcome_text": "how the run ended, as a sentence"}
COUNTED = (STEPS, EVENTS, TRIALS, SAMPLES, CLOSED_LINKS)  # dimensions that sizes can be given of


def unmarched_run(
    model: Model,
    settings: Settings,
    wanted: NDArray[np.float64] | None,
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
    place = None if path is None else placed(path)
    task = _task(march, place, memory)
    if wanted is None:
        run = record.described(march, _sizes(march, sizes))
        known = [str(name) for name, variable in run.variables.items() if variable.attrs.get("role") in KNOWN_BEFORE]
        foreseen = labelled(record.foreseen(march))
        foreseen = foreseen if is_read_whole(model) else record.unfold(foreseen)
        return lazy(Stage(_with_outcome(run), task, [*known, GIVEN_STEP.name], foreseen))
    if sizes:
        raise InputError(f"sizes are {dict(sizes)}, and times say already how many states there are; leave sizes out")
    if place is None:
        task = Task.of("states", partial(sampled_march, model, settings, wanted, None), (), task.name, wanted.tolist())
    else:
        check_sampled(settings)
        task = Task.of("states", partial(_sampled, model, wanted), (task,), wanted.tolist())
    run = record.described(march, {STEPS: 1})
    states = Inside.of(run, model.functions, REINTEGRATE).blank(len(wanted))
    states = states.assign_coords({AT_TIME: (AT, wanted, states[AT_TIME].attrs)})
    whole = labelled(fold(states, record.shapes_of(run)))
    known = [AT_TIME, *(str(name) for name in whole.variables if name not in states.variables)]
    return lazy(Stage(_with_outcome(whole), task, known))


def _task(march: March, place: Place | None, memory: str | float | None) -> Task:
    """Return the task that marches, the same as of any stage that marches so too."""
    words = [record.input_digest(march), *(["compressed"] if march.settings.compress else [])]
    name = "-".join([MARCH, *words, *([str(place)] if place is not None else [])])
    call = partial(marched_by, march.model, march.settings, place, memory)
    return Task(name, call, lasting=place is None, steps=float(march.expected_rows or 0))


def _sampled(model: Model, wanted: NDArray[np.float64], run: xr.Dataset) -> xr.Dataset:
    return states_at(run, wanted, model)


def _with_outcome(template: xr.Dataset) -> xr.Dataset:
    """Add how the run ended: an attribute of the record, and not known before."""
    import xarray as xr

    about = {name: {"units": "1", "long_name": text, "role": "outcome"} for name, text in OUTCOME.items()}
    return template.assign({name: xr.Variable((), "", attributes) for name, attributes in about.items()})


def _sizes(march: March, given: Any) -> dict[str, int]:
    """Read the sizes of the record's dimensions; those of a grid without events are known."""
    if not isinstance(given, Mapping):
        raise InputError(f"sizes are {given!r}, need numbers by dimension, like {{'step': 5000}}")
    for dim, size in given.items():
        if dim not in COUNTED:
            raise InputError(f"sizes name {dim!r}; there are {', '.join(COUNTED)}")
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise InputError(f"sizes have {size!r} for '{dim}', need a positive whole number")
    if STEPS in given:
        return dict(given)
    if (rows := _rows(march)) is None:
        raise InputError(
            f"how many rows the run of '{march.model.name}' has is known only once it is marched: its steps are chosen,"
            " or events, nodes or keep_every decide which rows there are. Give a size, sizes={'step': 5000}, say; times=…"
            " for states at these times; or compute=True"
        )
    return {STEPS: rows, **given}


def _rows(march: March) -> int | None:
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
