"""Complete runs of a sweep's members together: states at common times, or concatenated rows.

States at common times are read lazily, each from its member's file. Concatenated rows of all members are one Dataset
(CF contiguous ragged arrays).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.reading import read_columns
from xdynamics.archive.sandboxed_reading import is_known, know
from xdynamics.archive.seals import Tail
from xdynamics.archive.store import GIVEN, Given, Place
from xdynamics.dynamics.recorded_steps import step_columns, wanted_times
from xdynamics.dynamics.shortened_steps import sample_in_steps
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.evidence.stage_tasks import Task
from xdynamics.evidence.stages import Stage
from xdynamics.faults import InputError
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record import unfold
from xdynamics.record.folding import expand_quantities, quantity_names
from xdynamics.record.run_columns import unsampled_columns
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import (
    AT,
    AT_TIME,
    GIVEN_STEP,
    RAGGED,
    ROOT_DIGEST,
    ROW,
    ROW_SIZE,
    RUN,
    SAMPLE_DIMENSION,
    STEPS,
    TEXT_NAMES,
)
from xdynamics.schema import Variable as RecordVariable
from xdynamics.sweeping.catalogue import open_sweep
from xdynamics.sweeping.collection import DIGEST as DIGEST_OF_SWEEP
from xdynamics.sweeping.collection import plan_of
from xdynamics.sweeping.ensemble_records import MemberRuns
from xdynamics.sweeping.grid import AxisIndices, SweepGrid
from xdynamics.sweeping.kept_quantities import DIGEST
from xdynamics.sweeping.member import check_digest, open_member, run_path, sweep_folder
from xdynamics.sweeping.members import FILE, SEAL, Plan

if TYPE_CHECKING:
    import xarray as xr

Floats = NDArray[np.float64]
Functions = Mapping[str, Callable[..., float]]


def open_logs(
    sweep: xr.Dataset | Given,
    times: Any = None,
    *,
    names: Sequence[str] | None = None,
    functions: Functions | None = None,
) -> xr.Dataset:
    """Open the runs that a sweep with ``keep=["log"]`` archived, as one lazy Dataset along its axes, at common times.

    Parameters
    ----------
    sweep : xarray.Dataset, str or Path
        What `open_sweep` returned, a part of it, or the folder.
    times : array_like, s, or texts like ``"0:10:101 s"``
        By default the sweep's own.
    names : sequence of str, optional
        Coordinates, velocities and states; by default all.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.

    Returns
    -------
    xarray.Dataset
        On the axes' dimensions and `at`, what `sample` gives of every run: nan outside it, and where a member has no run.
        A file is opened, verified and read when a value of its member is used, by threads or on a cluster.

    Raises
    ------
    InputError
        If the sweep has no archived runs, it is not known where they are, or there are no times.

    Examples
    --------
    >>> import tempfile
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/harmonic_oscillator.toml")
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     grid = xd.sweep(model, {"m": "1:2:3 kg"}, keep=["log"], step="0.1 s", until="1 s", path=folder)
    ...     logs = open_logs(grid, "0:1:11 s", names=["x"])
    ...     print(dict(logs.sizes), float(logs.x.sel(m=2)[-1]) == float(xd.member(grid, m=2.0).x[-1]))
    {'m': 3, 'at': 11} True
    """
    load_dask_whole()
    catalogue = open_sweep(sweep) if isinstance(sweep, GIVEN) else sweep
    plan = plan_of(catalogue, functions)
    folder = sweep_folder(catalogue)
    if FILE not in catalogue:
        raise InputError("the sweep has no archived runs: give sweep keep=['log'] and path='a folder'")
    if folder is None:
        raise InputError("it is not known where the runs of the sweep are: open it by open_sweep")
    model = plan.grid.model
    state_names = expand_quantities(
        map(model.shapes.internal_name, names or model.elements.units), model.elements.units, model.shapes
    )
    if unknown := [name for name in state_names if name not in model.elements.units]:
        raise InputError(f"names have '{unknown[0]}'; there are {', '.join(quantity_names(model.elements.units))}")
    if times is None and not plan.keeping.times.size:
        raise InputError("the sweep has no times of its own; give times, like '0:10:101 s'")
    sample_times = plan.keeping.times if times is None else wanted_times(times, model.time_unit)
    arrays = _lazy_states(catalogue, folder, _RunReader(plan, sample_times, tuple(state_names), functions))
    dims = catalogue[FILE].dims
    variables: dict[str, Any] = {
        name: (
            (*dims, AT),
            arrays[name],
            attrs_of(model.elements.units[name].text, f"{name} of the run at a time", "coordinate"),
        )
        for name in state_names
    }
    variables[AT_TIME] = ((AT,), sample_times, attrs_of(model.time_unit.text, "wanted time", "time"))
    described = ((name, entry) for name, entry in catalogue.coords.items() if name not in TEXT_NAMES)
    axes = {name: entry for name, entry in described if {*entry.dims} <= {*dims}}
    logs = evidence_dataset(
        "logs of a sweep",
        f"{model.name}: runs over {', '.join(map(str, dims))}",
        [],
        variables | {str(name): (entry.dims, entry.values, dict(entry.attrs)) for name, entry in axes.items()},
        {DIGEST_OF_SWEEP: catalogue.attrs[DIGEST_OF_SWEEP], "model_digest": model.digest},
        shapes=model.shapes,
    )
    return logs.set_coords([*axes])


@dataclass(frozen=True)
class _RunReader:
    """The columns, times and settings by which every run of a sweep is read.

    Attributes
    ----------
    plan : Plan
    times : ndarray, s
    names : tuple of str
    functions : mapping of str to callable, optional
    dims : tuple of str
        The axes that are left in what is read, in its order.
    """

    plan: Plan
    times: Floats
    names: tuple[str, ...]
    functions: Functions | None
    dims: tuple[str, ...] = ()

    def read_states(self, axis_indices: AxisIndices, file: Place, digest: str, seal: str) -> Floats:
        """Read the states of one run at the times, in the order of the names.

        Parameters
        ----------
        axis_indices : sequence of int
            Its place along the dimensions.
        file : Path, or name of an object
        digest : str
            Its content digest, in the catalogue.
        seal : str
            Its seal, where the bytes that it is of are known to who asks; else empty.

        Raises
        ------
        ArchiveError
            If the file is damaged, or holds another run.
        """
        if seal:
            know(seal)
        numbers = dict(zip(self.dims, axis_indices, strict=True))
        model = self.plan.grid.member_model([numbers.get(dim, 0) for dim in self.plan.grid.dims])
        run = (
            unfold(open_member(file, digest))
            if model.shapes.dims
            else _read_run_columns(file, digest, self._column_names(model))
        )
        with run:
            ends = np.asarray(run["time"][[0, -1]])
            within_run = (self.times >= ends[0]) & (self.times <= ends[1])
            states = np.full((len(self.names), self.times.size), np.nan)
            if within_run.any():
                same = run["model_toml"].values.item() == model.to_toml()
                same_model = model if same else None  # else of another version
                samples = sample_in_steps(
                    run,
                    self.times[within_run],
                    after_event=True,
                    rule=REINTEGRATE,
                    functions=self.functions,
                    model=same_model,
                )
                states[:, within_run] = [samples[name].values for name in self.names]
        return states

    def _column_names(self, model: Model) -> set[str]:
        """Name the variables of a run from which states within steps are interpolated."""
        settings, none = self.plan.grid.settings_of((0,) * len(self.plan.grid.shape)), np.zeros(0, np.int64)
        return {
            "time",
            "model_toml",
            GIVEN_STEP.name,
            *(name for name, _ in step_columns(model, settings, none, none, by_element=True)),
        }


def _read_run_columns(file: Place, digest: str, names: set[str]) -> xr.Dataset:
    """Read columns of a member's archive, checking that it holds the run named in the catalogue."""
    run = read_columns(file, names)
    check_digest(file, str(run.attrs[ROOT_DIGEST]), digest)
    return run


def _lazy_states(sweep: xr.Dataset, folder: Place, reading: _RunReader) -> dict[str, Any]:
    """Return every variable as a dask array, whose tasks read one run each, once for all variables."""
    import dask.array
    from dask.base import tokenize
    from dask.highlevelgraph import HighLevelGraph

    da: Any = dask.array  # its functions are not typed
    files, digests = (np.asarray(sweep[name].values) for name in (FILE, DIGEST))
    seals = np.asarray(sweep[SEAL].values) if SEAL in sweep else np.full(files.shape, "")
    token = tokenize(str(folder), files, digests, reading.times, reading.names)
    reader_key, log_key = f"wanted-{token}", f"log-{token}"
    reading = replace(reading, dims=tuple(map(str, sweep[FILE].dims)))
    layers: dict[str, Any] = {
        reader_key: {reader_key: reading},
        log_key: {
            (log_key, *member_index): (
                _states_of_run,
                reader_key,
                member_index,
                run_path(folder, str(files[member_index])),
                str(digests[member_index]),
                _if_known(str(seals[member_index])),
            )
            if files[member_index]
            else np.full((len(reading.names), reading.times.size), np.nan)
            for member_index in product(*map(range, files.shape))
        },
    }
    dependencies: dict[str, set[str]] = {reader_key: set(), log_key: {reader_key}}
    shape = (1,) * files.ndim
    arrays = {}
    for i, name in enumerate(reading.names):
        key = f"{name}-{log_key}"
        graph = {
            (key, *member_index, 0): (_states_of_name, (log_key, *member_index), i, shape)
            for member_index in product(*map(range, files.shape))
        }
        graph_layers = HighLevelGraph(layers | {key: graph}, dependencies | {key: {log_key}})
        arrays[name] = da.Array(
            graph_layers, key, (*((1,) * n for n in files.shape), (reading.times.size,)), dtype=float
        )
    return arrays


def _if_known(seal: str) -> str:
    """Return the seal of a run that was written or examined for this process; a worker need not examine it again."""
    return seal if is_known(Tail(seal)) else ""


def _states_of_run(reading: _RunReader, *run_arguments: Any) -> Floats:
    return reading.read_states(*run_arguments)


def _states_of_name(states: Floats, i: int, shape: tuple[int, ...]) -> Floats:
    values: Floats = states[i].reshape(*shape, -1)
    return values


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
    if compute and sizes is not None:
        raise InputError(f"sizes are {sizes!r}, and are for compute=False: runs that are computed have their own")
    task = Task.of("ragged", partial(_march_all, plan, copied_attributes), (), plan.digest)
    known_names = [f"{RUN}_{column.label}" for _, column in plan.grid.columns]
    stage = Stage(task, lambda: _ragged_template(plan, copied_attributes, _stated_rows(plan, sizes)), known_names)
    return stage.result(compute=compute)


def _march_all(plan: Plan, copied_attributes: Mapping[str, Any]) -> xr.Dataset:
    """March all members, and concatenate their rows."""
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
            f" they are computed; give a number, sizes={{'{ROW}': {1000 * plan.grid.size}}}, say, or compute=True"
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
    """Return the Dataset of concatenated rows, row counts and axis values."""
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
