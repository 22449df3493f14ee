"""Several runs compared with one of them, all at the same times."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.evidence.comparing.comparison_summary import OF_SEVERAL, ROLE
from xdynamics.evidence.comparing.differences import common_times, compared, wanted
from xdynamics.evidence.evidence_dataset import about, exhibit
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
    others: Mapping[str, xr.Dataset],
    times: NDArray[np.float64] | None,
    functions: Mapping[str, Callable[..., float]] | None,
) -> xr.Dataset:
    """Compare runs with a first one, as `compare` does with one; what that has as attributes is along `run` here.

    Raises
    ------
    InputError
        If the runs have no time or no quantity in common, or no two are given.
    """
    if not others:
        raise InputError("second has no run; give one at least")
    at = common_times(first, *others.values()) if times is None else times
    found = [compared(first, run, at, functions) for run in others.values()]
    most = max(one.sizes.get(OCCURRENCE, 0) for one in found)
    shared = [name for name in found[0].data_vars if all(_is_apart(one, name) for one in found)]
    alike = [
        one[shared].pad({OCCURRENCE: (0, most - one.sizes[OCCURRENCE])}) if OCCURRENCE in one.dims else one[shared]
        for one in found
    ]
    variables: dict[str, Any] = {AT_TIME: wanted(first, at)}
    variables["run_name"] = (RUN,), np.array([*others]), about("1", "which run is compared with the reference", "name")
    variables["identical"] = (
        (RUN,),
        np.array([int(one.attrs["identical"]) for one in found], np.int8),
        about("1", "1 where the run is the reference, bit for bit", ROLE),
    )
    for word, said in TOLD.items():
        variables[word] = (
            (RUN,),
            np.array([str(one.attrs.get(word, "")) for one in found]),
            about("1", said, ROLE),
        )
    for name in shared:
        rows = [one[str(name)].variable for one in alike]
        variables[str(name)] = (RUN, *rows[0].dims), np.stack([row.values for row in rows]), dict(rows[0].attrs)
        if str(name).startswith("difference_") and rows[0].dims:
            largest = np.array([np.nanmax(np.abs(row.values), initial=0.0) for row in rows])
            of_largest = about(str(rows[0].attrs["units"]), f"largest size of {name}", ROLE)
            variables[f"largest_{name}"] = (RUN,), largest, of_largest
    title = f"{first.attrs['title']}, and {len(others)} runs beside it"
    digests = [archive.digest_of_run(run) for run in (first, *others.values())]
    attributes = {"identical": int(all(one.attrs["identical"] for one in found))}
    return exhibit(OF_SEVERAL, title, digests, variables, attributes, shapes=shapes_of(first))


def _is_apart(found: xr.Dataset, name: Any) -> bool:
    """Whether a variable of a comparison is of numbers that differ, not of single bits."""
    return name in found and {*found[name].dims} <= {AT, OCCURRENCE, *found.coords} | {*shapes_of(found).extents}
