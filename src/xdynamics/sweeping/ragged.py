"""All members of a sweep as whole runs in one Dataset: concatenated rows (CF contiguous ragged arrays)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.stage_tasks import Task
from xdynamics.evidence.stages import Stage, lazy_stage
from xdynamics.faults import InputError
from xdynamics.record.run_columns import unsampled_columns
from xdynamics.schema import RAGGED, ROW, ROW_SIZE, RUN, SAMPLE_DIMENSION, STEPS
from xdynamics.schema import Variable as RecordVariable
from xdynamics.sweeping.collection import plan_of
from xdynamics.sweeping.ensemble_records import MemberRuns
from xdynamics.sweeping.grid import SweepGrid
from xdynamics.sweeping.members import Plan

if TYPE_CHECKING:
    import xarray as xr

MAX_BYTES = 2_000_000_000  # bytes of rows in one Dataset
COPIED = ("sweep_digest", "sweep_settings", "model_digest")  # attributes of the sweep


def ragged(
    sweep: xr.Dataset,
    *,
    functions: Mapping[str, Callable[..., float]] | None = None,
    compute: bool = True,
    sizes: Mapping[str, int] | None = None,
) -> xr.Dataset:
    """Return every accepted state of every member, runs concatenated.

    Parameters
    ----------
    sweep : xarray.Dataset
        What `sweep` or `open_sweep` returned, or a part of it: ``found.isel(k=slice(0, 100))``.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    compute : bool
        Whether to march at once. Otherwise the Dataset has dask arrays, and what is computed of it marches all members
        once; saved, it has as many rows as there are.
    sizes : mapping of str to int, optional
        With ``compute=False``, how many rows to show, which only marching tells: ``{"row": 100_000}``. Beyond the last
        row there is nan, -1 of flags; more rows than stated are an error when they are computed.

    Returns
    -------
    xarray.Dataset
        Along `row` what a record has along `step`: `time`, coordinates, velocities, forces, energies …; along `run`
        `row_size`, and what varies. Member i's rows follow those of the first i members (CF 1.11, section 9.3.3);
        members are in the order of the axes, the last axis fastest.

    Raises
    ------
    InputError
        If the rows take more than two gigabytes; take a part of the sweep. If nothing is to be marched, and how many
        rows there will be is not stated.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = ragged(xd.sweep(model, {"v_y": "10:30:3 m s-1"}, method="heun", rtol=1e-6))
    >>> int(found.row_size.sum()) == found.sizes["row"]
    True
    """
    plan = plan_of(sweep, functions)
    copied_attributes = {key: sweep.attrs[key] for key in COPIED if key in sweep.attrs}
    if compute:
        if sizes is not None:
            raise InputError(f"sizes are {sizes!r}, and are for compute=False: runs that are marched have their own")
        return _march_all(plan, copied_attributes)
    task = Task.of("ragged", partial(_march_all, plan, copied_attributes), (), plan.digest)
    template = _ragged_template(plan, copied_attributes, _stated_rows(plan, sizes))
    return lazy_stage(
        Stage(template, task, [name for name in map(str, template.variables) if name.startswith(f"{RUN}_")])
    )


def _march_all(plan: Plan, copied_attributes: Mapping[str, Any]) -> xr.Dataset:
    """March all members, and put their rows together."""
    grid = plan.grid
    group_runs: list[tuple[Any, MemberRuns]] = []
    bytes_ = 0
    for group in grid.groups([slice(None)] * len(grid.shape)):
        runs = group.march_members(slice(None), logs=True)
        group_runs.append((group.block_indices, MemberRuns(group.model, group.settings, runs)))
        bytes_ += runs.log_block.log.rows.nbytes
        if bytes_ > MAX_BYTES:
            raise InputError(
                f"the rows of {grid.size} members take more than {MAX_BYTES / 1e9:g} GB; take a part of the sweep, like"
                " isel(…)"
            )
    sizes = np.zeros(grid.size, np.int64)
    for places, member_runs in group_runs:
        sizes[places] = np.diff(member_runs.runs.first_row)
    first = np.concatenate([[0], np.cumsum(sizes)])
    columns = _row_variables(grid)
    values = {name: np.empty(int(first[-1]), column.dtype) for name, column in columns.items()}
    for places, member_runs in group_runs:
        destination = np.concatenate([np.arange(first[i], first[i + 1]) for i in places.tolist()])
        for name in columns:
            values[name][destination] = member_runs[name]
    return _ragged_dataset(grid, columns, values, sizes, copied_attributes)


def _stated_rows(plan: Plan, sizes: Any) -> int:
    """Read how many rows to show."""
    rows = sizes.get(ROW) if isinstance(sizes, Mapping) and {*sizes} <= {ROW} else None
    if isinstance(rows, bool) or not isinstance(rows, int) or rows < 1:
        raise InputError(
            f"sizes are {sizes!r}: how many rows {plan.grid.size} runs of '{plan.grid.model.name}' have is known only once"
            f" they are marched; give a number, sizes={{'{ROW}': {1000 * plan.grid.size}}}, say, or compute=True"
        )
    return rows


def _ragged_template(plan: Plan, copied_attributes: Mapping[str, Any], rows: int) -> xr.Dataset:
    """Describe the rows of all members before any is marched."""
    columns = _row_variables(plan.grid)
    values = {name: np.zeros(rows, column.dtype) for name, column in columns.items()}
    return _ragged_dataset(plan.grid, columns, values, np.zeros(plan.grid.size, np.int64), copied_attributes)


def _row_variables(grid: SweepGrid) -> dict[str, RecordVariable]:
    """Return what the records of all members have along their steps."""
    groups = [
        {
            column.variable.name: column.variable
            for column in unsampled_columns(group.settings.layout(group.model), group.settings)
        }
        for group in grid.groups([slice(None)] * len(grid.shape))
    ]
    return {
        name: variable
        for name, variable in groups[0].items()
        if variable.dims == (STEPS,) and all(name in group for group in groups)
    }


def _ragged_dataset(
    grid: SweepGrid,
    columns: Mapping[str, RecordVariable],
    values: Mapping[str, Any],
    sizes: Any,
    copied_attributes: Mapping[str, Any],
) -> xr.Dataset:
    """Put rows, their numbers and what varies into one Dataset."""
    variables: dict[str, Any] = {
        name: ((ROW,), values[name], dict(column.attributes)) for name, column in columns.items()
    }
    size_attributes = attrs_of("1", "accepted states of the run", "index") | {SAMPLE_DIMENSION: ROW}
    variables[ROW_SIZE] = ((RUN,), sizes, size_attributes)
    axis_indices = grid.indices_in([slice(None)] * len(grid.shape))
    for k, column in grid.columns:
        column_values = column.values[axis_indices[:, k]]
        is_numeric = np.issubdtype(column_values.dtype, np.number)
        variables[f"{RUN}_{column.label}"] = (
            (RUN,),
            column_values if is_numeric else column_values.astype(str),
            attrs_of(column.unit.text, f"{column.name} of the run", "axis"),
        )
    title = f"{grid.model.name}: every state of {grid.size} runs"
    attributes = {"featureType": "timeSeries"} | dict(copied_attributes)
    return evidence_dataset(RAGGED, title, [], variables, attributes, shapes=grid.model.shapes)
