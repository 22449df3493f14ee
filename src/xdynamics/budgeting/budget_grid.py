"""Error budgets over the axes of a sweep: one for each member, in one Dataset."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.evidence.evidence_dataset import evidence_dataset
from xdynamics.evidence.grid_axes import AXES, AXIS, OWN_DIGEST, sweep_axis_names, sweep_of
from xdynamics.evidence.stages import compute_datasets
from xdynamics.faults import InputError, first_names
from xdynamics.record.flag_words import words_of_flag
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import TEXT_NAMES
from xdynamics.sweeping.collection import plan_of
from xdynamics.units import unit_suffix
from xdynamics.units.digits import aligned_table, short_number

if TYPE_CHECKING:
    import xarray as xr

KIND = "budgets of a sweep"
MAX_MEMBERS = 4096  # members, each of which is some runs and tasks
TERM_NAMES = ("term_name", "term_kind")
TOTALS = ("numerical_rss", "physical_rss", "total_rss")


def budgets_over(
    sweep: xr.Dataset, quantity: str, budget: Callable[..., xr.Dataset], *, compute: bool, **budget_arguments: Any
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
    if grid.size > MAX_MEMBERS:
        raise InputError(
            f"the sweep has {grid.size} members, and budgets are of {MAX_MEMBERS} at most; select some by isel"
        )
    members = [
        budget(
            grid.member_model(position),
            quantity,
            compute=False,
            **budget_arguments,
            **grid.simulate_arguments(position),
        )
        for position in np.ndindex(grid.shape)
    ]
    first = members[0]
    for position, result in zip(np.ndindex(grid.shape), members, strict=True):
        if [*result["term_name"].values] != [*first["term_name"].values]:
            names = [", ".join(map(str, terms_of["term_name"].values)) for terms_of in (first, result)]
            raise InputError(
                f"member {grid.member_name(position)} has the terms {names[1]}, and the first has {names[0]}"
            )
    dims = [dim for dim in grid.dims if dim in sweep.dims]
    shape = tuple(sweep.sizes[dim] for dim in dims)
    variables: dict[str, Any] = {
        str(name): (variable.dims, variable.variable.values, dict(variable.attrs))
        for name, variable in sweep.coords.items()
        if AXIS in variable.attrs and {*variable.dims} <= {*dims}
    }
    coordinates = [*variables]
    for name, variable in first.variables.items():
        if name in TERM_NAMES:
            variables[str(name)] = variable.dims, variable.values, dict(variable.attrs)
        elif name not in TEXT_NAMES and name not in variables:
            cells = [da.asarray(member.variables[name].data) for member in members]
            stacked_cells = da.stack(cells).reshape((*shape, *variable.shape))
            variables[str(name)] = (*dims, *variable.dims), stacked_cells, dict(variable.attrs)
    attributes = {key: sweep.attrs[key] for key in ("model_digest", OWN_DIGEST) if key in sweep.attrs}
    attributes |= {"of": first.attrs["of"], AXES: " ".join(dims), "coverage": first.attrs["coverage"]}
    title = (
        f"error budgets of {str(sweep.attrs['title']).partition(':')[0]}: {first.attrs['of']} over {', '.join(dims)}"
    )
    budgets = evidence_dataset(KIND, title, [], variables, attributes).set_coords(coordinates)
    return compute_datasets(budgets)[0] if compute else budgets


def budget_grid_lines(budgets: xr.Dataset) -> Iterator[str]:
    """Summarise budgets over a grid: the range of the number and of its uncertainty, and of each term where it is largest."""
    units = unit_suffix(str(budgets["value"].attrs["units"]))
    yield f"result    {budgets.attrs['of']} over {', '.join(sweep_axis_names(budgets))}"
    header = ("", "least", "greatest")
    rows = [("value", *_range_texts(budgets["value"].values, units))]
    rows += [
        (f"{name.removesuffix('_rss')} uncertainty", *_range_texts(budgets[name].values, units)) for name in TOTALS
    ]
    kinds = words_of_flag(budgets["term_kind"])
    sizes = budgets["standard_uncertainty"].transpose("term", ...).values
    for name, kind, size in zip(budgets["term_name"].values.tolist(), kinds, sizes, strict=True):
        rows.append((f"{kind} {name}", *_range_texts(size, units)))
    yield from aligned_table(header, rows)
    outcomes = [str(outcome) for outcome in np.unique(budgets["run_outcome"].values.astype(str))]
    yield f"outcomes  {first_names(outcomes)}"


def _range_texts(values: Any, units: str) -> tuple[str, str]:
    finite = values[~np.isnan(values)]
    if not finite.size:
        return "", ""
    return tuple(f"{short_number(float(end))}{units}" for end in (finite.min(), finite.max()))  # type: ignore[return-value]


SUMMARIES = {KIND: budget_grid_lines}
