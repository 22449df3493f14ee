"""Several runs compared with one of them, all at the same times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.evidence.comparing.comparison_summary import OF_SEVERAL, ROLE
from xdynamics.evidence.comparing.differences import common_times, compare_runs, times_variable
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.faults import InputError
from xdynamics.record import shapes_of
from xdynamics.schema import AT, AT_TIME, OCCURRENCE

RUN = "run"  # a dimension
# what a comparison has as attributes, and what each is
TOLD = {
    "cause": "the first of what differs from the reference",
    "parted": "when the run is first further from the reference than interpolation can be off; empty if nowhere",
    "first_difference": "the first bit that differs",
    "model": "lines of the model that differ",
    "parameters": "parameters that differ",
    "initial": "initial values that differ",
    "settings": "settings that differ",
    "events": "events that were not met equally often",
}


def compare_each(
    first: xr.Dataset,
    other_runs: Mapping[str, xr.Dataset],
    times: NDArray[np.float64] | None,
    functions: Mapping[str, Callable[..., float]] | None,
) -> xr.Dataset:
    """Compare runs with a first one, as `compare` does with one; what that has as attributes is along `run` here.

    Raises
    ------
    InputError
        If the runs have no time or no quantity in common, or no two are given.
    """
    if not other_runs:
        raise InputError("second has no run; give one at least")
    sample_times = common_times(first, *other_runs.values()) if times is None else times
    comparisons = [compare_runs(first, run, sample_times, functions) for run in other_runs.values()]
    max_occurrences = max(comparison.sizes.get(OCCURRENCE, 0) for comparison in comparisons)
    shared = [
        name for name in comparisons[0].data_vars if all(_is_apart(comparison, name) for comparison in comparisons)
    ]
    padded_comparisons = [
        comparison[shared].pad({OCCURRENCE: (0, max_occurrences - comparison.sizes[OCCURRENCE])})
        if OCCURRENCE in comparison.dims
        else comparison[shared]
        for comparison in comparisons
    ]
    variables: dict[str, Any] = {AT_TIME: times_variable(first, sample_times)}
    variables["run_name"] = (
        (RUN,),
        np.array([*other_runs]),
        attrs_of("1", "which run is compared with the reference", "name"),
    )
    variables["identical"] = (
        (RUN,),
        np.array([int(comparison.attrs["identical"]) for comparison in comparisons], np.int8),
        attrs_of("1", "1 where the run is the reference, bit for bit", ROLE),
    )
    for word, long_name in TOLD.items():
        variables[word] = (
            (RUN,),
            np.array([str(comparison.attrs.get(word, "")) for comparison in comparisons]),
            attrs_of("1", long_name, ROLE),
        )
    for name in shared:
        rows = [comparison[str(name)].variable for comparison in padded_comparisons]
        variables[str(name)] = (RUN, *rows[0].dims), np.stack([row.values for row in rows]), dict(rows[0].attrs)
        if str(name).startswith("difference_") and rows[0].dims:
            largest = np.array([np.nanmax(np.abs(row.values), initial=0.0) for row in rows])
            of_largest = attrs_of(str(rows[0].attrs["units"]), f"largest size of {name}", ROLE)
            variables[f"largest_{name}"] = (RUN,), largest, of_largest
    title = f"{first.attrs['title']}, and {len(other_runs)} runs beside it"
    digests = [archive.digest_of_run(run) for run in (first, *other_runs.values())]
    attributes = {"identical": int(all(comparison.attrs["identical"] for comparison in comparisons))}
    return evidence_dataset(OF_SEVERAL, title, digests, variables, attributes, shapes=shapes_of(first))


def _is_apart(comparison: xr.Dataset, name: Any) -> bool:
    """Whether a variable of a comparison is of numbers that differ, not of single bits."""
    return name in comparison and {*comparison[name].dims} <= {AT, OCCURRENCE, *comparison.coords} | {
        *shapes_of(comparison).extents
    }
