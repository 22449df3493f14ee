"""Runs over a grid of parameters, initial values, methods, steps: one lazy Dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import record
from xdynamics.archive.store import GIVEN, Given, location_of
from xdynamics.faults import InputError
from xdynamics.model import Model, check_model
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.sweeping import catalogue
from xdynamics.sweeping.axes import read_axes
from xdynamics.sweeping.collection import plan_of, sweep_dataset
from xdynamics.sweeping.grid import SweepGrid
from xdynamics.sweeping.kept_quantities import END, keeping_of
from xdynamics.sweeping.members import Plan, march_of
from xdynamics.sweeping.tasks import counted_chunks, lazy_arrays
from xdynamics.units import Quantity, unit_suffix

if TYPE_CHECKING:
    import xarray as xr

MAX_MEMBERS = 200_000_000  # in one sweep


def sweep(
    model: Model | xr.Dataset,
    axes: Mapping[str, Any] | None = None,
    *,
    keep: Sequence[str] | str = (END,),
    times: Any = None,
    occurrences: int | tuple[int, int] = 1,
    path: Given | None = None,
    check: float = 0.0,
    members_per_task: int | None = None,
    progress: Callable[[float, float, int], None] | None = None,
    **settings: Any,
) -> xr.Dataset:
    """March a model once for every combination of values along its axes, each bit for bit as if it were marched alone.

    Parameters
    ----------
    model : Model, or xarray.Dataset
        An earlier sweep, or a part of one, is marched again with its settings, to keep something else:
        ``sweep(found, keep=["y"], times=[1.0])`` puts all runs on common times.
    axes : mapping
        What varies, by name: parameters, initial values (``initial_x`` names the axis so), drives, ``method``,
        ``step``, ``rtol`` and other settings of `simulate` that are one word or number. Values are a list of texts with
        units or of numbers in the declared unit, an array with `units`, or a text: ``"0:2e-3:41 kg m-1"`` (first, last,
        count), ``"1, 2, 5 kg"``. A drive takes CSV files, or one file with a column for each value. Group what varies
        together in a mapping under a name of its own, ``{"body": {"m": […], "c": […]}}``; give random values as
        `Draws`.
    keep : sequence of str
        ``end`` (coordinates, velocities, states where each run ended), ``end_x``, ``event_time_ground``,
        ``event_count_ground``, ``after_ground_x``, ``before_ground_x``, ``maximum_x``, ``minimum_x`` (with time, rule
        and uncertainty, as in `diagnose`; of accelerations and forces, too, ``maximum_a_x``), ``x`` or any energy or
        observable at `times`, ``log`` for whole runs, one file each. Of an event also all else that a record has of it, ``event_residual_ground``. Any number of `diagnose`
        (``energy_drift``, ``period``, ``believed_until``) or of a record's attributes (``run_fastest_rate``) takes the
        member's whole run and its diagnosis, some tenths of a second each.
    times : array_like, s, or of texts
        Along `at`; for every coordinate, velocity and state, or those that `keep` names. nan after the end of a run.
    occurrences : int, or (int, int)
        How many occurrences of every event, cycle or turn to keep, along `occurrence` if more than the first;
        ``(100, 160)`` leaves out the first hundred.
    path : str or Path, optional
        A folder to march into, or ``"s3://bucket/folder"``; a name that ends in ``.zarr`` is that of a Zarr store, for
        sweeps too large for one file. The same call continues an interrupted sweep without marching finished members
        again, and members can be added to an existing sweep: by a longer or finer axis, one more axis, further methods.
    check : float
        Fraction of members that are also marched alone and compared bit for bit: ``0.01``.
    members_per_task : int, optional
        Members in a task; by default a sixteenth of the members for each processor, and at least 64 if there are as
        many. With `path`, as many as take about a second.
    progress : callable, optional
        Called with the fraction done, 0 and the number of tasks done, for a sweep into a folder.
    **settings
        Of `simulate`, for all members; ``keep_every``, ``log`` and ``compress`` apply to the records of
        ``keep=["log"]``, everything else that is kept uses every row. What a model file's `[run]` leaves out of records
        is recorded here, unless these settings say otherwise.

    Returns
    -------
    xarray.Dataset
        On the axes' own dimensions, lazy: computed by dask's threads, or on a cluster where there is a
        `dask.distributed` client, anew at each use: ``.compute()`` keeps the numbers, ``.persist()`` on a cluster. With `path` it is marched at once, and opened from there. For every member
        `end_time`, `run_outcome`, counts, `run_uncontrolled` (of how many variables given absolute tolerances may let
        pass 3 %, if every step errs by as much as they allow), and `run_digest`. A member that fails is a row with its
        outcome. `member` marches one again, to its whole run.

    Raises
    ------
    InputError
        If an axis, a word or a setting cannot be used, before anything is marched; every fault is named. If the folder
        holds a sweep that this one does not extend; the differences are named.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = sweep(model, {"v_y": "10:20:3 m s-1", "method": ["heun", "dop853"]}, keep=["event_time_ground"], rtol=1e-6)
    >>> dict(found.sizes), found.event_time_ground.attrs["units"]
    ({'v_y': 3, 'solver_method': 2}, 's')
    >>> bool((found.event_time_ground.diff("v_y") > 0).all())
    True
    """
    load_dask_whole()
    grid = _grid_to_march(model, axes, settings)
    keeping = keeping_of(keep, times, occurrences, grid.model.time_unit)
    if not keeping.keeps_whole_runs:
        grid = _unrecorded(grid, settings)
    grid.check()
    plan = Plan(grid, keeping, _checked_fraction(check))
    sweep_dataset(plan, {})  # refuses unknown words
    if grid.recording and (first := march_of(grid, (0,) * len(grid.shape))):
        record.columns(first)  # refuses unknown columns
    _check_sample_times(plan)
    if plan.keeping.keeps_whole_runs and path is None:
        raise InputError("keep has 'log', and whole runs are kept in files; give path='a folder'")
    members = None if members_per_task is None else _checked_member_count(members_per_task)
    if path is None:
        return sweep_dataset(plan, *lazy_arrays(plan, counted_chunks(grid, members)))
    if not isinstance(path, GIVEN):
        raise InputError(f"path is {path!r}, needs the name of a folder")
    return catalogue.march_into_folder(plan, members, location_of(path), progress)


def _grid_to_march(model: Any, axes: Any, settings: Mapping[str, Any]) -> SweepGrid:
    """Return the grid to march: a model over axes, or the members of an earlier sweep."""
    if hasattr(model, "attrs") and hasattr(model, "data_vars"):
        if axes is not None or settings:
            raise InputError("an earlier sweep has its axes and settings; give keep, times and occurrences alone")
        return plan_of(model).grid
    check_model(model)
    shared_settings = {name: json_value(name, value) for name, value in settings.items() if value is not None}
    grid = SweepGrid(model, read_axes(model, axes or {}), shared_settings)
    if repeated := [column.name for _, column in grid.columns if column.name in shared_settings]:
        raise InputError(
            f"'{repeated[0]}' varies along an axis, and is {shared_settings[repeated[0]]!r} for all members too; give one"
        )
    if grid.size > MAX_MEMBERS:
        raise InputError(f"the axes make {grid.size} members, and {MAX_MEMBERS} are the most; take fewer values")
    return grid


def _unrecorded(grid: SweepGrid, settings: Mapping[str, Any]) -> SweepGrid:
    """Drop an earlier sweep's recording settings if no complete runs are recorded; refuse settings just given."""
    if refused_names := [name for name in grid.recording if settings.get(name) is not None]:
        verb = "says" if len(refused_names) == 1 else "say"
        raise InputError(
            f"{' and '.join(refused_names)} {verb} how whole runs are recorded, and keep has none: add 'log' to keep with"
            f" path='a folder', or leave {' and '.join(refused_names)} out; what else is kept is of every row"
        )
    return grid.unrecorded


def _check_sample_times(plan: Plan) -> None:
    """Refuse times outside the runs, where all members begin and end together."""
    times, grid = plan.keeping.times, plan.grid
    if not times.size or {"t", "until"} & {entry.name for _, entry in grid.columns}:
        return
    second = unit_suffix(grid.model.time_unit)
    begin, end = grid.model.statement.initial["t"].si, grid.settings_of((0,) * len(grid.shape)).until
    if times_outside := [entry for entry in times.tolist() if not begin <= entry <= end]:
        raise InputError(
            f"times has {times_outside[0]!r}{second}, and the runs are from t = {begin!r}{second} to until = {end!r}{second}"
        )


def _checked_member_count(members: Any) -> int:
    if isinstance(members, bool) or not isinstance(members, int) or members < 1:
        raise InputError(f"members_per_task is {members!r}, needs a positive whole number")
    return members


def _checked_fraction(check: Any) -> float:
    if isinstance(check, bool) or not isinstance(check, int | float) or not 0.0 <= check <= 1.0:
        raise InputError(f"check is {check!r}, needs a part of the members from 0 to 1")
    return float(check)


def json_value(name: str, value: Any) -> Any:
    """Return a setting as JSON can hold it.

    Raises
    ------
    InputError
        If it is neither a number, a text, nor a list or mapping of these.
    """
    if isinstance(value, Quantity):
        return str(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Mapping):
        return {str(key): json_value(name, element) for key, element in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [json_value(name, element) for element in value]
    if isinstance(value, str | int | float):
        return value
    raise InputError(f"setting '{name}' is {value!r}, needs words or numbers")
