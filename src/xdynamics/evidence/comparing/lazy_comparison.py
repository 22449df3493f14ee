"""Comparisons that are described before runs are marched or read."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.recorded_models import model_of_record
from xdynamics.evidence.comparing.bits import blank_bitwise_table
from xdynamics.evidence.comparing.causes import model_differences
from xdynamics.evidence.comparing.differences import (
    common_times,
    compare_runs,
    difference_of,
    event_difference,
    event_differences,
    shared_names,
    times_variable,
    title_of,
)
from xdynamics.evidence.comparing.residuals import measured_for, residuals_of, residuals_with
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.observables import is_comparable
from xdynamics.evidence.run_tasks import in_memory, task_of_runs
from xdynamics.evidence.stages import Stage, foreseen_record, lazy_stage, task_of
from xdynamics.faults import InputError
from xdynamics.record import shapes_of
from xdynamics.record.event_columns import NO_DETECTOR
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.named_elements import DETECTOR, detectors_of
from xdynamics.schema import AT, AT_TIME, OCCURRENCE

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]

LATER: dict[str, tuple[str, Any]] = {
    "identical": ("1 where the runs are the same, bit for bit", 0),
    "first_difference": ("the first difference, the earliest row first", ""),
    "settings": ("settings that differ, a line each", ""),
    "events": ("events that the runs did not meet equally often, a line each", ""),
    "parted": ("since when the runs are further apart than interpolation can be", ""),
    "cause": ("likely cause of the difference", ""),
}  # attributes of a comparison that are known when it is made, and what they say


def describe_comparison(
    first: xr.Dataset,
    second: xr.Dataset,
    sample_times: Floats | None,
    functions: Functions | None,
    sizes: Any,
    occurrences: int | None,
) -> xr.Dataset:
    """Describe a comparison of two runs; one task makes it, after those that march the runs.

    Raises
    ------
    InputError
        If a size is missing that only marching tells, is stated of what is known, or is no number.
    """
    runs = (first, second)
    marched = all(task_of(run) is None for run in runs)
    times = common_times(first, second) if sample_times is None and marched else sample_times
    stated = _stated_sizes(sizes, occurrences, is_needed=times is None)
    shown_times = np.zeros(_at_stated(stated, first)) if times is None else times
    variables: dict[str, Any] = {AT_TIME: times_variable(first, shown_times)}
    models = [model_of_record(run, functions) for run in runs]
    for name in shared_names(first, second):
        if all(is_comparable(model, name) for model in models):
            numbers = np.zeros((len(shown_times), *first.variables[name].shape[1:]))
            blank = numbers, numbers, 0.0
            variables |= difference_of(name, first.variables[name], second.variables[name], blank, blank)
    records = [foreseen_record(run) for run in runs]
    variables |= {
        str(name): (entry.dims, entry.values, entry.attrs) for name, entry in blank_bitwise_table(*records).items()
    }
    variables |= _event_variables(first, second, records, stated, marched=marched)
    variables |= {name: ((), value, attrs_of("1", text, "outcome")) for name, (text, value) in LATER.items()}
    attributes = model_differences(first, second) | {"selection": str(first.attrs.get(schema.SELECTION_OF, ""))}
    template = evidence_dataset(
        "comparison", title_of(first, second), [], variables, attributes, shapes=shapes_of(first)
    )
    words = None if sample_times is None else sample_times.tolist()
    task = task_of_runs("comparison", partial(_comparison_in_task, sample_times, functions), runs, words)
    return lazy_stage(Stage(template, task, ("name", *(() if times is None else (AT_TIME,)))))


def describe_residuals(
    run: xr.Dataset, source: Any, functions: Functions | None, gaps: str, reading: Mapping[str, Any] | None
) -> xr.Dataset:
    """Describe a comparison of a run with measured data, which are read at once.

    Raises
    ------
    InputError
        If a column cannot be read or has another dimension than the run.
    """
    data = measured_for(run, source, functions, gaps, reading)
    blank = np.zeros(data.times.size), np.zeros(data.times.size)
    template = residuals_of(run, model_of_record(run, functions).shapes, dict.fromkeys(data.values, blank), data, ())
    task = task_of_runs("comparison", partial(_with_data, functions, data), (run,), *data.words)
    known_names = [
        AT_TIME,
        *(f"{kind}_{name}" for kind in ("measured", "measured_uncertainty") for name in data.values),
    ]
    return lazy_stage(Stage(template, task, [name for name in known_names if name in template.variables]))


def _comparison_in_task(
    sample_times: Floats | None, functions: Functions | None, first: xr.Dataset, second: xr.Dataset
) -> xr.Dataset:
    return compare_runs(in_memory(first), in_memory(second), sample_times, functions)


def _with_data(functions: Functions | None, data: Any, run: xr.Dataset) -> xr.Dataset:
    return residuals_with(in_memory(run), data, functions)


def _stated_sizes(sizes: Any, occurrences: int | None, *, is_needed: bool) -> dict[str, int]:
    """Read the sizes of dimensions that only marching tells."""
    if not isinstance(sizes, Mapping):
        raise InputError(f"sizes are {sizes!r}, need numbers by dimension, like {{'{AT}': 5000}}")
    for dim, size in sizes.items():
        if dim != AT:
            remedy = "; how many events are compared is said by occurrences=10" if dim == OCCURRENCE else ""
            raise InputError(f"sizes name {dim!r}; there is {AT}{remedy}")
        if isinstance(size, bool) or not isinstance(size, int) or size < 1:
            raise InputError(f"sizes have {size!r} for '{dim}', need a positive whole number")
    if AT in sizes and not is_needed:
        raise InputError(f"sizes have {sizes[AT]} for '{AT}', and the times are known already; leave it out")
    if occurrences is not None and (type(occurrences) is not int or occurrences < 0):
        raise InputError(f"occurrences is {occurrences!r}, needs a non-negative whole number")
    return dict(sizes) | ({} if occurrences is None else {OCCURRENCE: occurrences})


def _at_stated(stated: Mapping[str, int], first: xr.Dataset) -> int:
    if AT not in stated:
        raise InputError(
            f"the number of times at which both '{first.attrs['title']}' and the other run have values is known only once they are marched;"
            f" give times=…, a number, sizes={{'{AT}': 5000}}, say, or compute=True"
        )
    return stated[AT]


def _event_variables(
    first: xr.Dataset, second: xr.Dataset, records: list[xr.Dataset], stated: Mapping[str, int], *, marched: bool
) -> dict[str, Any]:
    """Describe the differences of events that both runs met; of runs to be marched, those that both may meet."""
    if marched and OCCURRENCE not in stated:
        return dict(event_differences(first, second))
    detectors = [_detector_names(record) for record in records]
    names = [name for name in detectors[0] if name in detectors[1]]
    if names and OCCURRENCE not in stated:
        raise InputError(
            f"how often {', '.join(names)} will be met is known only once the runs are marched; give the number to compare,"
            " like occurrences=10 (nan where there are fewer), or 0 for none"
        )
    count = stated.get(OCCURRENCE, 0)
    variables: dict[str, Any] = {}
    for name in names if count else ():
        blank = np.zeros(count)
        variables |= event_difference(name, time_unit_of(first).text, blank, blank, np.zeros(()))
    return variables


def _detector_names(record: xr.Dataset) -> list[str]:
    """Name the detectors of a run's events."""
    words = detectors_of(record) if DETECTOR in record.variables else []
    return [] if words == [NO_DETECTOR] else words
