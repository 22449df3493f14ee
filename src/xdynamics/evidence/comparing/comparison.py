"""Comparison of two runs at common times, or of a run with measured data: distances, when they part, and causes.

A comparison of runs that are not marched yet is described lazily; one task computes it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import schema
from xdynamics.dynamics.recorded_steps import model_of_record, wanted_times
from xdynamics.evidence.comparing.bits import blank_bitwise_table
from xdynamics.evidence.comparing.causes import model_differences
from xdynamics.evidence.comparing.differences import (
    common_times,
    compare_each,
    compare_runs,
    comparison_dataset,
    difference_variables,
    event_difference,
    event_differences,
    shared_names,
)
from xdynamics.evidence.comparing.grids import compare_sweeps
from xdynamics.evidence.comparing.measured import (
    Measured,
    is_measured,
    measured_for,
    residuals_of,
    residuals_with,
)
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.grid_axes import is_sweep
from xdynamics.evidence.observables import is_comparable
from xdynamics.evidence.runs import prepare_record
from xdynamics.evidence.stages import Stage, foreseen_record, task_of, task_of_runs
from xdynamics.faults import InputError
from xdynamics.record import check, unfold
from xdynamics.record.event_columns import NO_DETECTOR
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import model_dimensions
from xdynamics.record.schemas import is_evidence, kind_description
from xdynamics.record.unfolding import DETECTOR, detectors_of, element_labels
from xdynamics.runtime.files import displayed_path
from xdynamics.schema import AT, AT_TIME, OCCURRENCE, STEPS

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


def _lazy_comparison(
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

    def template() -> xr.Dataset:
        models = [model_of_record(run, functions) for run in runs]
        blanks = {
            name: np.zeros((len(shown_times), *first.variables[name].shape[1:]))
            for name in shared_names(first, second)
            if all(is_comparable(model, name) for model in models)
        }
        sample = {name: (blank, blank, 0.0) for name, blank in blanks.items()}
        variables = difference_variables(first, second, shown_times, [sample, sample])
        records = [foreseen_record(run) for run in runs]
        table = blank_bitwise_table(*records)
        variables |= {str(name): (entry.dims, entry.values, entry.attrs) for name, entry in table.items()}
        variables |= _event_variables(first, second, records, stated, marched=marched)
        variables |= {name: ((), value, attrs_of("1", text, "outcome")) for name, (text, value) in LATER.items()}
        attributes = model_differences(first, second) | {"selection": str(first.attrs.get(schema.SELECTION_OF, ""))}
        return comparison_dataset(first, second, (), variables, attributes)

    words = None if sample_times is None else sample_times.tolist()
    compared = partial(compare_runs, times=sample_times, functions=functions, occurrences=occurrences)
    task = task_of_runs("comparison", compared, runs, (words, occurrences), read=True)
    return Stage(task, template, ("name", *(() if times is None else (AT_TIME,)))).result(compute=False)


def _compare_with_data(run: xr.Dataset, data: Measured, functions: Functions | None, *, compute: bool) -> xr.Dataset:
    """Compare a run with measured data, at once or in a task."""
    compared = partial(residuals_with, data=data, functions=functions)
    if compute:
        return compared(run)
    task = task_of_runs("comparison", compared, (run,), *data.words, read=True)
    blank = np.zeros(data.times.size)
    computed = dict.fromkeys(data.values, (blank, blank))
    shapes = model_of_record(run, functions).shapes
    known_names = [f"{kind}_{name}" for kind in ("measured", "measured_uncertainty") for name in data.values]
    return Stage(task, lambda: residuals_of(run, shapes, computed, data, ()), [AT_TIME, *known_names]).result(
        compute=False
    )


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
            f"the number of times at which both '{first.attrs['title']}' and the other run have values is known only once they are computed;"
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
            f"how often {', '.join(names)} will be met is known only once the runs are computed; give the number to compare,"
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


def compare(
    first: xr.Dataset,
    second: Any = None,
    times: Sequence[float] | Floats | float | str | None = None,
    *,
    functions: Functions | None = None,
    gaps: str = "refuse",
    reading: Mapping[str, Any] | None = None,
    compute: bool = True,
    sizes: Mapping[str, int] | None = None,
    occurrences: int | None = None,
) -> xr.Dataset:
    """Compare runs of any steps with a first one, a run with measured data, or two sweeps (`grids.compare_sweeps`).

    Parameters
    ----------
    first : xarray.Dataset
        A run record, or a sweep.
    second : xarray.Dataset, sequence or mapping of these, pandas.DataFrame, str or Path
        Another run record; several, by name or in a list, each of which is compared with the first; or measured data: a file (CSV, of an instrument, Excel, netCDF) or a DataFrame whose columns have units, ``time [s]``,
        ``y [mm]`` and, if known, the standard uncertainty ``u(y) [mm]``; or a Dataset along one dimension, with
        a variable `time`, units as attributes, and uncertainties as `u_y`.
    times : array_like of float, shape (n,), s, optional
        Where to compare; by default at every accepted time of either run that both reach
        (of a run that was marched with `keep_every`, at its kept times only). Data have their own.
    gaps : {"refuse", "skip"}
        For measured data: whether rows in which a number is missing are refused or left out. Columns that the run does
        not have are left out (`data_left_out`).
    reading : mapping, optional
        How a file is read that does not say it: `skip`, `header`, `units`, `argument_column`, `duplicates`, `time_zero`, `decimal`, as in
        ``{"units": {"t": "s", "x": "mm"}}``; see `xdynamics help files`.
    functions : mapping of str to callable, optional
        The Python functions that the models' forces call.
    compute : bool
        Whether to compare at once. If False, the Dataset has dask arrays, and one task compares the runs whole: those that
        `simulate` described and that are still to be marched are marched first, those in chunks are read. What only this
        tells, attributes else (`cause`, `parted`, `events`, `settings`, `first_difference`, `identical`), are variables.
    sizes : mapping of str to int, optional
        With ``compute=False`` of runs still to be marched, without `times`: how many to show, ``{"at": 5000}``; beyond what
        there is there is nan.
    occurrences : int, optional
        With ``compute=False``, how many occurrences of each event to compare, the first ones, if the models have
        some: nan where there are fewer; 0 for none.

    Returns
    -------
    xarray.Dataset
        Along `at`, for every coordinate, velocity, state, energy and observable y of both: `difference_y` (second minus
        first, in the units of the first), `scaled_difference_y` (over `difference_scale_y`, the largest y of the first
        run at these times) and `interpolation_error_y` (the sum of both runs' errors between accepted states). Along
        `occurrence`: `difference_event_time_<name>` of events that both met, with the uncertainty of their
        location. Along `variable`: `name`, `same`, `first_row`, bit for bit. Attributes name what
        differs: `parameters`, `initial`, `model`, `settings`, `events` (a line each), `parted` (since when the runs are
        further apart than interpolation can be), `cause`, `first_difference`, `identical`. On dask arrays the
        differences of states are lazy, and nothing else is returned, unless ``compute=False``. With several runs all of this
        is along `run` too, what are attributes else as texts, with `run_name` and ``largest_difference_y``. With data: `measured_y`, y as computed,
        `difference_y` (measured minus computed), `scaled_difference_y` (over `difference_scale_y`, the largest
        measured y), `interpolation_error_y`, `measured_uncertainty_y`, and without a dimension `rms_difference_y`,
        `scaled_rms_difference_y` and `reduced_chi_square_y`.

    Raises
    ------
    InputError
        If a Dataset is not a run record, the runs have no time or no quantity in common, or data cannot be read.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> coarse, fine = (xd.simulate(model, step=h, until="2 s") for h in ("20 ms", "7 ms"))
    >>> apart = compare(coarse, fine, times=[0.5, 1.0])
    >>> bool((abs(apart.difference_x) < 1e-3).all()), apart.attrs["cause"]
    (True, 'settings: solver_step: 0.02 | 0.007')
    """
    _check_given(first, second, times)
    if is_sweep(first):
        if times is not None or not compute or sizes is not None or occurrences is not None:
            raise InputError(
                "times, compute, sizes and occurrences are for runs: sweeps are compared where both have values, as lazy as they"
                " are"
            )
        return compare_sweeps(first, second)
    _check_comparable(first)
    if isinstance(second, Mapping | list | tuple) and not isinstance(second, xr.Dataset):
        if not compute or sizes is not None or occurrences is not None:
            raise InputError(
                "compute, sizes and occurrences are for a single second run; of several each is compared at once"
            )
        return _compare_several(first, second, times, functions)
    if "model_toml" not in first.variables:
        raise InputError("compare needs the model of the run, and 'model_toml' was left out")
    for word, size_argument in (("sizes", sizes), ("occurrences", occurrences)):
        if compute and size_argument is not None:
            raise InputError(
                f"{word} are {size_argument!r}, and are for compute=False: what is compared at once has its own"
            )
    if is_measured(second):
        first = prepare_record(first, functions)
        data = measured_for(first, second, functions, gaps, reading)
        return _compare_with_data(first, data, functions, compute=compute)
    _check_comparable(second)
    if "model_toml" not in second.variables:
        raise InputError("compare needs the models of both runs, and 'model_toml' was left out of the second")
    first, second = _with_same_quantities(first, second, functions)
    sample_times = None if times is None else wanted_times(times, time_unit_of(first))
    if not compute:
        return _lazy_comparison(first, second, sample_times, functions, {} if sizes is None else sizes, occurrences)
    return compare_runs(first, second, sample_times, functions)


def _check_given(first: Any, second: Any, times: Any) -> None:
    """Refuse arguments that are not a first run and its partner, or its list of partners."""
    if second is None or (isinstance(first, Mapping | list | tuple) and not isinstance(first, xr.Dataset)):
        raise InputError("compare needs a run, and what it is compared with; several runs as in compare(a, [b, c])")
    if isinstance(times, xr.Dataset):
        raise InputError("times is a Dataset; several runs are compared with a first one as in compare(a, [b, c])")
    if is_sweep(first) is not is_sweep(second):
        raise InputError("one is a sweep and the other is none; give two sweeps, or a run of it by xdynamics.member")


def _compare_several(first: xr.Dataset, other_runs: Any, times: Any, functions: Functions | None) -> xr.Dataset:
    """Compare several runs with a first one; those without names are called by their files, or numbered."""
    runs_by_name = (
        other_runs
        if isinstance(other_runs, Mapping)
        else {_run_name(run, i): run for i, run in enumerate(other_runs, 2)}
    )
    if not isinstance(other_runs, Mapping) and len(runs_by_name) < len(other_runs):
        runs_by_name = {f"{i} {_run_name(run, i)}": run for i, run in enumerate(other_runs, 2)}
    for run in (first, *runs_by_name.values()):
        _check_comparable(run)
        if "model_toml" not in run.variables:
            raise InputError("compare needs the models of all runs, and 'model_toml' was left out of one")
    elements = [_with_same_quantities(first, run, functions) for run in runs_by_name.values()]
    reference = first if all(pair[0] is first for pair in elements) else unfold(first)
    runs = {
        name: pair[1] if pair[0] is reference else unfold(pair[1])
        for name, pair in zip(runs_by_name, elements, strict=True)
    }
    sample_times = None if times is None else wanted_times(times, time_unit_of(first))
    return compare_each(reference, runs, sample_times, functions)


def _run_name(run: Any, number: int) -> str:
    source = getattr(run, "encoding", {}).get("source")
    return Path(source).name if source else f"run {number}"


def _with_same_quantities(
    first: xr.Dataset, second: xr.Dataset, functions: Functions | None
) -> tuple[xr.Dataset, xr.Dataset]:
    """Return two runs by quantities; by elements where one has other dimensions or labels than the other."""
    runs = prepare_record(first, functions), prepare_record(second, functions)
    dims = [{dim: element_labels(run, dim) for dim in model_dimensions(run) if dim in run.dims} for run in runs]
    return runs if dims[0] == dims[1] else (unfold(first), unfold(second))


def _check_comparable(run: Any) -> None:
    if isinstance(run, str | Path):
        raise InputError(f"'{displayed_path(run)}' is a path; open it first, with open_run")
    if isinstance(run, xr.Dataset) and is_evidence(run.attrs):
        raise InputError(f"this is {kind_description(run.attrs)}; compare needs runs")
    if not isinstance(run, xr.Dataset) or "time" not in run.variables or "row_kind" not in run.variables:
        raise InputError("compare needs two run records, or one and measured data; one has no 'time' along 'step'")
    if task_of(run) is None:
        check(run, whole=False, values=False)
    if any(run[name].dims != (STEPS,) for name in ("time", "row_kind")):  # in derived data these may be anything
        raise InputError(
            f"compare needs 'time' and 'row_kind' along '{STEPS}', and they are along {run['time'].dims} and"
            f" {run['row_kind'].dims}"
        )
