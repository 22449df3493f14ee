"""Two runs at the same times, or a run and measured data: how far apart, since when, and what differs between them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics.dynamics.wanted_times import wanted_times
from xdynamics.evidence.comparing.differences import compare_runs
from xdynamics.evidence.comparing.grids import compare_sweeps
from xdynamics.evidence.comparing.lazy_comparison import describe_comparison, describe_residuals
from xdynamics.evidence.comparing.measured import is_measured
from xdynamics.evidence.comparing.residuals import data_residuals
from xdynamics.evidence.comparing.several import compare_each
from xdynamics.evidence.grid_axes import is_sweep
from xdynamics.evidence.runs import prepare_record
from xdynamics.evidence.stages import task_of
from xdynamics.faults import InputError
from xdynamics.record import check, unfold
from xdynamics.record.flag_words import time_unit_of
from xdynamics.record.folding import model_dimensions
from xdynamics.record.named_elements import element_labels
from xdynamics.record.partial_records import is_evidence, kind_description
from xdynamics.runtime.files import displayed_path
from xdynamics.schema import STEPS

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]


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
    """Compare runs of any steps with a first one, a run with measured data, or two sweeps; see `grids.compare_sweeps` of these.

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
        How a file is read that does not say it: `skip`, `header`, `units`, `time_zero`, `decimal`, as in
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
        With ``compute=False``, how many occurrences of each event to compare, if the models have some; 0 for none.

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
        if not compute:
            return describe_residuals(first, second, functions, gaps, reading)
        return data_residuals(first, second, functions, gaps, reading)
    _check_comparable(second)
    if "model_toml" not in second.variables:
        raise InputError("compare needs the models of both runs, and 'model_toml' was left out of the second")
    first, second = _with_same_quantities(first, second, functions)
    sample_times = None if times is None else wanted_times(times, time_unit_of(first))
    if not compute:
        return describe_comparison(first, second, sample_times, functions, {} if sizes is None else sizes, occurrences)
    return compare_runs(first, second, sample_times, functions)


def _check_given(first: Any, second: Any, times: Any) -> None:
    """Refuse runs that are given otherwise than as a first one and what it is compared with."""
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
