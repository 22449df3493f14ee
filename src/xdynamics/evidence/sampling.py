"""The state between accepted steps, from a record alone, and its interpolation error."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, record
from xdynamics.dynamics.recorded_steps import wanted_times
from xdynamics.dynamics.shortened_steps import StepInterpolator, sample_in_steps
from xdynamics.evidence.companion import Tighter, tighter_of
from xdynamics.evidence.runs import prepare_record
from xdynamics.evidence.stages import Stage, in_memory, task_of_runs
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE, RULES
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import fold, labelled, model_dimensions
from xdynamics.record.run_dataset import check_dataset
from xdynamics.schema import AT_TIME

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]
SIDES = ("before", "after")


def sample(
    run: xr.Dataset,
    times: Sequence[float] | Floats | float | str,
    *,
    side: str = "after",
    rule: str = REINTEGRATE,
    functions: Functions | None = None,
    companion: bool = False,
    compute: bool | None = None,
) -> xr.Dataset:
    """Evaluate a run at any times within it: as if the step there had been shortened to end at the time.

    Parameters
    ----------
    run : xarray.Dataset
        A run record, in memory or opened from an archive. On dask arrays the result is lazy: `time` is searched at once,
        by bisection over its chunks, and of the states those chunks are read later that hold a wanted step.
    times : array_like of float, shape (n,), s; or texts like ``"1.5 s"``, ``"0:20:201 s"``
        In any order; a single time gives one row. A range is start:stop:count, both ends included. At an accepted time
        the accepted state is returned unchanged.
    side : {"after", "before"}
        Which of the two states of an event to return exactly at its time. A step never reaches across an event.
    rule : {"reintegrate", "interpolant"}
        A step of the run's own method from the accepted state before, shortened to end at the time: it has the method's
        order, and events are located on it. Or the interpolant of the whole step, a polynomial, whose slopes are
        continuous too where it is Hermite's; its order may be far below the method's, see ``xdynamics methods``.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    companion : bool
        Whether to add `global_error_…`, the error of each value accumulated since the start, by one more run at a
        tighter setting; see `companion`.
    compute : bool, optional
        Whether to evaluate at once. If False, the Dataset has dask arrays, and one task reads the run, in chunks those
        that hold a wanted step; one that `simulate` described and that is still to be marched is marched first. By
        default as the run is: lazy of dask arrays, and else at once.

    Returns
    -------
    xarray.Dataset
        Along `at`: `at_time`, `row` (of `step`, from which the step goes), and for every coordinate, velocity and
        state its value and `error_…`: how far it is from the solution through the accepted state before. The
        error of that state itself is not included; at an accepted time it is zero. Where a step's equations could not
        be solved again, both are nan.

    Raises
    ------
    InputError
        If a time lies outside the run or is not a number, the Dataset is not a run record, or was edited.

    Notes
    -----
    The error is estimated by two steps of half the length, extrapolated with the whole one (Hairer, Norsett, Wanner,
    Solving ODEs I, section II.4), plus the rounding of one sum; continuous extensions: section II.6. A step of
    `radau_iia` depends on the iterations before it and does not reproduce the accepted state to the bit: the
    difference is added with a weight that rises as s**6 along the step, and counted as error.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> run = xd.simulate(model, method="dormand_prince", rtol=1e-8, until="2 s")
    >>> found = sample(run, [0.5, 1.0])
    >>> abs(found.x - np.cos(2 * found.at_time)).max().item() < 1e-6
    True
    """
    check_dataset(run)
    archive.check_states(run)
    if rule not in RULES:
        raise InputError(f"rule is {rule!r}; there are {', '.join(RULES)}")
    if side not in SIDES:
        raise InputError(f"side is {side!r}; there are {', '.join(SIDES)}")
    if not isinstance(compute, bool | None):
        raise InputError(f"compute is {compute!r}, needs true or false")
    if not model_dimensions(run):
        return _sample_states(run, times, side, rule, functions, companion=companion, compute=compute)
    record.check_kind(run)
    read = prepare_record(run, functions)
    states = _sample_states(read, times, side, rule, functions, companion=companion, compute=compute)
    return labelled(fold(states, record.shapes_of(run)))


def _sample_states(
    run: xr.Dataset,
    times: Any,
    side: str,
    rule: str,
    functions: Functions | None,
    *,
    companion: bool,
    compute: bool | None,
) -> xr.Dataset:
    """Evaluate a run, of elements or of quantities with dimensions; see `sample`."""
    sample_times = wanted_times(times, time_unit_of(run))
    tighter = tighter_of(run, functions) if companion else None
    states_of = partial(_states_at, sample_times, side, rule, functions, tighter)
    if compute is not False:
        marched = () if tighter is None else (tighter.marched(),)
        return states_of(run, *marched, lazy=compute is None)
    needs = () if tighter is None else (tighter.task,)
    task = task_of_runs("sample", states_of, (run,), sample_times.tolist(), side, rule, companion, needs=needs)
    blank = StepInterpolator.of_run(run, functions, rule).blank(sample_times)
    stage = Stage(task, lambda: blank if tighter is None else tighter.blank_global_errors(blank), (AT_TIME,))
    return stage.result(compute=False)


def _states_at(
    sample_times: Floats,
    side: str,
    rule: str,
    functions: Functions | None,
    tighter: Tighter | None,
    run: xr.Dataset,
    *marched: xr.Dataset,
    lazy: bool = False,
) -> xr.Dataset:
    """Evaluate states, lazy or, of a run in chunks, by reading only those that are needed."""
    states = sample_in_steps(run, sample_times, after_event=side == "after", rule=rule, functions=functions)
    states = states if lazy else in_memory(states)
    return states if tighter is None else tighter.to_companion(run, marched[0], functions).with_global_errors(states)
