"""All members of a sweep as whole runs in one Dataset: concatenated rows (CF contiguous ragged arrays)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.faults import InputError
from xdynamics.march import march_many
from xdynamics.schema import STEPS
from xdynamics.sweeping.collection import plan_of
from xdynamics.sweeping.ensemble_records import Harvest

if TYPE_CHECKING:
    import xarray as xr

RUN, ROW, SIZE = "run", "row", "row_size"
MOST = 2_000_000_000  # bytes of rows in one Dataset


def ragged(sweep: xr.Dataset, *, functions: Mapping[str, Callable[..., float]] | None = None) -> xr.Dataset:
    """Return every accepted state of every member, runs concatenated.

    Parameters
    ----------
    sweep : xarray.Dataset
        What `sweep` or `open_sweep` returned, or a part of it: ``found.isel(k=slice(0, 100))``.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.

    Returns
    -------
    xarray.Dataset
        Along `row` what a record has along `step`: `time`, coordinates, velocities, forces, energies …; along `run`
        `row_size`, and what varies. Member i's rows follow those of the first i members (CF 1.11, section 9.3.3);
        members are in the order of the axes, the last axis fastest.

    Raises
    ------
    InputError
        If the rows take more than two gigabytes; take a part of the sweep.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = ragged(xd.sweep(model, {"v_y": "10:30:3 m s-1"}, method="heun", rtol=1e-6))
    >>> int(found.row_size.sum()) == found.sizes["row"]
    True
    """
    plan = plan_of(sweep, functions)
    grid = plan.grid
    harvests: list[tuple[Any, Harvest]] = []
    bytes_ = 0
    for group in grid.groups([slice(None)] * len(grid.shape)):
        runs = march_many(group.model, group.settings, **group.arrays, logs=True)
        harvests.append((group.places, Harvest(group.model, group.settings, runs)))
        bytes_ += runs.kept.log.rows.nbytes
        if bytes_ > MOST:
            raise InputError(
                f"the rows of {grid.size} members take more than {MOST / 1e9:g} GB; take a part of the sweep, like"
                " isel(…)"
            )
    names = [name for name in _names(harvests[0][1]) if all(name in harvest.columns for _, harvest in harvests)]
    sizes = np.zeros(grid.size, np.int64)
    for places, harvest in harvests:
        sizes[places] = np.diff(harvest.runs.first_row)
    first = np.concatenate([[0], np.cumsum(sizes)])
    values = {name: np.empty(int(first[-1]), harvests[0][1][name].dtype) for name in names}
    for places, harvest in harvests:
        destination = np.concatenate([np.arange(first[i], first[i + 1]) for i in places.tolist()])
        for name in names:
            values[name][destination] = harvest[name]
    columns = harvests[0][1].columns
    variables: dict[str, Any] = {
        name: ((ROW,), values[name], dict(columns[name].variable.attributes)) for name in names
    }
    size_attributes = about("1", "accepted states of the run", "index") | {"sample_dimension": ROW}
    variables[SIZE] = ((RUN,), sizes, size_attributes)
    at = grid.places([slice(None)] * len(grid.shape))
    for k, column in grid.columns:
        column_values = column.values[at[:, k]]
        is_numeric = np.issubdtype(column_values.dtype, np.number)
        attributes = about(column.unit.text, f"{column.name} of the run", "axis")
        variables[f"{RUN}_{column.label}"] = (
            (RUN,),
            column_values if is_numeric else column_values.astype(str),
            attributes,
        )
    title = f"{grid.model.name}: every state of {grid.size} runs"
    attributes = {
        key: sweep.attrs[key] for key in ("sweep_digest", "sweep_settings", "model_digest") if key in sweep.attrs
    }
    attributes = {"featureType": "timeSeries"} | attributes
    return exhibit("ragged sweep", title, [], variables, attributes, shapes=grid.model.shapes)


def _names(harvest: Harvest) -> list[str]:
    return [name for name, column in harvest.columns.items() if column.variable.dims == (STEPS,)]
