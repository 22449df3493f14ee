"""Error budgets over the axes of a sweep: one for each member, in one Dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.evidence.evidence_dataset import exhibit
from xdynamics.evidence.grid_axes import AXES, AXIS, OWN_DIGEST, axes_said, sweep_of
from xdynamics.evidence.stages import computed
from xdynamics.faults import InputError, few
from xdynamics.record.flag_words import words_of
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import TEXT_NAMES
from xdynamics.sweeping.collection import plan_of
from xdynamics.units import unit_suffix
from xdynamics.units.digits import aligned, short_number

if TYPE_CHECKING:
    import xarray as xr

KIND = "budgets of a sweep"
MOST = 4096  # members, each of which is some runs and tasks
TERM_NAMES = ("term_name", "term_kind")
TOTALS = ("numerical_rss", "physical_rss", "total_rss")


def budgets_over(
    sweep: xr.Dataset, quantity: str, budget: Callable[..., xr.Dataset], *, compute: bool, **asked: Any
) -> xr.Dataset:
    """Return the error budget of every member of a sweep, along its axes; see `error_budget`.

    Raises
    ------
    InputError
        If there are too many members, or the budgets of two have other terms.
    """
    load_dask_whole()
    import dask.array

    da: Any = dask.array
    sweep = sweep_of(sweep)
    grid = plan_of(sweep).grid
    if grid.size > MOST:
        raise InputError(f"the sweep has {grid.size} members, and budgets are of {MOST} at most; select some by isel")
    members = [
        budget(grid.model_of(at), quantity, compute=False, **asked, **grid.asked_of(at))
        for at in np.ndindex(grid.shape)
    ]
    first = members[0]
    for at, other in zip(np.ndindex(grid.shape), members, strict=True):
        if [*other["term_name"].values] != [*first["term_name"].values]:
            names = [", ".join(map(str, each["term_name"].values)) for each in (first, other)]
            raise InputError(f"member {grid.name_of(at)} has the terms {names[1]}, and the first has {names[0]}")
    dims = [dim for dim in grid.dims if dim in sweep.dims]
    shape = tuple(sweep.sizes[dim] for dim in dims)
    variables: dict[str, Any] = {
        str(name): (one.dims, one.variable.values, dict(one.attrs))
        for name, one in sweep.coords.items()
        if AXIS in one.attrs and {*one.dims} <= {*dims}
    }
    coordinates = [*variables]
    for name, one in first.variables.items():
        if name in TERM_NAMES:
            variables[str(name)] = one.dims, one.values, dict(one.attrs)
        elif name not in TEXT_NAMES and name not in variables:
            cells = [da.asarray(member.variables[name].data) for member in members]
            stacked = da.stack(cells).reshape((*shape, *one.shape))
            variables[str(name)] = (*dims, *one.dims), stacked, dict(one.attrs)
    attributes = {key: sweep.attrs[key] for key in ("model_digest", OWN_DIGEST) if key in sweep.attrs}
    attributes |= {"of": first.attrs["of"], AXES: " ".join(dims), "coverage": first.attrs["coverage"]}
    title = (
        f"error budgets of {str(sweep.attrs['title']).partition(':')[0]}: {first.attrs['of']} over {', '.join(dims)}"
    )
    found = exhibit(KIND, title, [], variables, attributes).set_coords(coordinates)
    return computed(found)[0] if compute else found


def lines_of(budgets: xr.Dataset) -> Iterator[str]:
    """Summarise budgets over a grid: the range of the number and of its uncertainty, and of each term where it is largest."""
    units = unit_suffix(str(budgets["value"].attrs["units"]))
    yield f"result    {budgets.attrs['of']} over {', '.join(axes_said(budgets))}"
    header = ("", "least", "greatest")
    rows = [("value", *_range(budgets["value"].values, units))]
    rows += [(f"{name.removesuffix('_rss')} uncertainty", *_range(budgets[name].values, units)) for name in TOTALS]
    kinds = words_of(budgets["term_kind"])
    sizes = budgets["standard_uncertainty"].transpose("term", ...).values
    for name, kind, size in zip(budgets["term_name"].values.tolist(), kinds, sizes, strict=True):
        rows.append((f"{kind} {name}", *_range(size, units)))
    yield from aligned(header, rows)
    outcomes = [str(one) for one in np.unique(budgets["run_outcome"].values.astype(str))]
    yield f"outcomes  {few(outcomes)}"


def _range(values: Any, units: str) -> tuple[str, str]:
    finite = values[~np.isnan(values)]
    if not finite.size:
        return "", ""
    return tuple(f"{short_number(float(one))}{units}" for one in (finite.min(), finite.max()))  # type: ignore[return-value]


SUMMARIES = {KIND: lines_of}
