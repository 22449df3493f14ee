"""What each axis of a sweep changes: outcomes, counts of events, and the variance of every number."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.elementary.rounding_margins import EPS
from xdynamics.evidence.evidence_dataset import attrs_of
from xdynamics.evidence.grid_axes import member_number_names, sweep_of
from xdynamics.evidence.stage_tasks import Gathered, Task
from xdynamics.evidence.stages import Stage, compute_datasets, lazy_stage
from xdynamics.record.laziness import is_chunked
from xdynamics.schema import AT, OCCURRENCE
from xdynamics.sweeping.collection import DIGEST
from xdynamics.sweeping.ensemble_analysis import ROLE, axis_dims, survey_dataset
from xdynamics.sweeping.kept_quantities import EVENT_COUNT, OUTCOME
from xdynamics.sweeping.members import end_descriptions

if TYPE_CHECKING:
    import xarray as xr

AXES = "sweep_axis"
ROUNDING = 64.0  # spacings of numbers; a smaller spread counts as zero


def influences(sweep: xr.Dataset, *, compute: bool = True) -> xr.Dataset:
    """Return how much each axis changes outcomes, counts of events, and every number.

    Parameters
    ----------
    sweep : xarray.Dataset
    compute : bool
        Whether to compute at once. If False, the Dataset has dask arrays, and one task that needs all members.

    Returns
    -------
    xarray.Dataset
        Along `sweep_axis`, named by `axis_name`: ``outcome_changes``, the share of neighbours along the axis that ended in different ways;
        ``event_count_ground_changes`` the same for a count; ``main_effect_end_y``, the share of variance that the axis
        has alone, over members that have the number; of a quantity with dimensions, for each of its elements.

    Raises
    ------
    InputError
        If the Dataset is no sweep.

    Notes
    -----
    The main effect is the variance of means over all other axes, divided by the total variance: Sobol's first-order
    index for values distributed like the grid (Saltelli et al., Global Sensitivity Analysis, 2008, 1.2).
    """
    sweep = sweep_of(sweep)
    if compute:
        return _influences_in_memory(compute_datasets(sweep)[0])
    lazy_names = [str(name) for name, variable in sweep.variables.items() if is_chunked(variable)]
    small_sweep = sweep.isel({dim: slice(2) for dim in sweep.dims})
    blank = small_sweep.assign(
        {
            name: (
                small_sweep[name].dims,
                np.zeros(small_sweep[name].shape, small_sweep[name].dtype),
                small_sweep[name].attrs,
            )
            for name in lazy_names
        }
    )
    about_names = {name: (sweep[name].dims, sweep[name].attrs) for name in lazy_names}
    call = partial(_influences_of_gathered, sweep.drop_vars(lazy_names), about_names)
    task = Task.of("influences", call, tuple(Gathered(sweep[name]) for name in lazy_names), sweep.attrs.get(DIGEST))
    return lazy_stage(Stage(_influences_in_memory(blank), task, ("axis_name",)))


def _influences_of_gathered(eager_sweep: xr.Dataset, names: Mapping[str, Any], *values: Any) -> xr.Dataset:
    """Put the values of a sweep's variables into it, and return its influences."""
    gathered_variables = {
        name: (dims, data, attrs) for (name, (dims, attrs)), data in zip(names.items(), values, strict=True)
    }
    return _influences_in_memory(eager_sweep.assign(gathered_variables))


def _influences_in_memory(sweep: xr.Dataset) -> xr.Dataset:
    """Return the influences of axes on a sweep in memory."""
    axes = [dim for dim in axis_dims(sweep) if dim in sweep.dims]
    names = member_number_names(sweep)
    counts = [name for name in names if name.startswith(EVENT_COUNT)]
    variables: dict[str, Any] = {"axis_name": ((AXES,), np.array(axes), attrs_of("1", "the axis", "name"))}
    for name in (OUTCOME, *counts):
        values = end_descriptions(sweep).values if name == OUTCOME else sweep[name].values
        word = "outcome" if name == OUTCOME else name
        shares = [_share_of_changes(values, sweep[name].dims.index(dim)) for dim in axes]
        variables[f"{word}_changes"] = (
            (AXES,),
            np.array(shares),
            attrs_of("1", f"share of neighbours along the axis that differ in {name}", ROLE),
        )
    for name in (number for number in names if number not in counts and not {AT, OCCURRENCE} & {*sweep[number].dims}):
        number = sweep[name].astype(float)
        member_dims = [dim for dim in number.dims if dim in axes]
        variance = number.var(member_dims)
        varies = variance > (ROUNDING * EPS * abs(number).max(member_dims)) ** 2
        effects = [
            (
                number.mean([averaged_dim for averaged_dim in member_dims if averaged_dim != dim]).var(dim)
                / variance.where(varies)
            ).fillna(0.0)
            for dim in axes
        ]
        variables[f"main_effect_{name}"] = (
            (AXES, *effects[0].dims),
            np.array(effects),
            attrs_of("1", f"share of the variance of {name} that the axis has alone", ROLE),
        )
    return survey_dataset("influences", f"what {', '.join(axes)} change", sweep, variables, {})


def _share_of_changes(values: NDArray[Any], axis: int) -> float:
    """Return the share of neighbours along an axis that differ, among those that both exist."""
    axis_first = np.moveaxis(values, axis, 0)
    both_known = (axis_first[1:] == axis_first[1:]) & (axis_first[:-1] == axis_first[:-1])
    return float(np.mean(axis_first[1:][both_known] != axis_first[:-1][both_known])) if both_known.any() else 0.0
