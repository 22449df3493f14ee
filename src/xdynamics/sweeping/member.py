"""The complete run of one member of a sweep: from its archive, or marched again from the catalogue alone."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import archive, record
from xdynamics.archive.store import Place, location_of
from xdynamics.evidence.grid_axes import sweep_of
from xdynamics.evidence.runs import march_model
from xdynamics.faults import ArchiveError
from xdynamics.kernels.layout import layout_of
from xdynamics.march import March
from xdynamics.march.outcomes import GOOD
from xdynamics.schema import ROOT_DIGEST
from xdynamics.sweeping.collection import plan_of
from xdynamics.sweeping.grid import AxisIndices, SweepGrid, indices_of_labels
from xdynamics.sweeping.kept_quantities import DIGEST, OUTCOME
from xdynamics.sweeping.members import FILE, RUNS, digest_of_end

if TYPE_CHECKING:
    import xarray as xr

_RUN_FILE_NAME = re.compile(rf"{RUNS}/[0-9a-f]+(\.partial)*\.nc")  # named by a digest


def member(
    sweep: xr.Dataset, *, functions: Mapping[str, Callable[..., float]] | None = None, **labels: Any
) -> xr.Dataset:
    """Return the complete run of one member of a sweep, bit for bit.

    Parameters
    ----------
    sweep : xarray.Dataset
        What `sweep` or `open_sweep` returned, or a part of it.
    functions : mapping of str to callable, optional
        The Python functions that the model's forces call.
    **labels
        A value of every axis: ``k="1 N m-1"``, ``k=1.0`` in the axis' unit, ``method="heun"``; for an axis along which
        several columns vary, the number of the member.

    Returns
    -------
    xarray.Dataset

    Raises
    ------
    InputError
        If an axis has no such value; the nearest is named.
    ArchiveError
        If the run marched again differs from what the sweep holds.

    Examples
    --------
    >>> import xdynamics as xd
    >>> model = xd.Model.from_toml("data/models/ball_drag.toml")
    >>> found = xd.sweep(model, {"v_y": "10:30:3 m s-1"}, rtol=1e-6, method="heun")
    >>> run = member(found, v_y="20 m s-1")
    >>> float(run.y[-1]) == float(found.end_y.sel(v_y=20))
    True
    """
    grid = plan_of(sweep, functions).grid
    folder, sweep = sweep_folder(sweep), sweep_of(record.whole_of(sweep))
    axis_indices = indices_of_labels(grid, labels)
    dim_indices = {dim: k for dim, k in zip(grid.dims, axis_indices, strict=True) if dim in sweep.dims}
    states = [block.name for block in layout_of(grid.model).used.blocks]
    ends = [f"end_{name}" for name in ("time", *states) if f"end_{name}" in sweep]
    catalogued = (
        sweep[[entry for entry in (DIGEST, OUTCOME, FILE, *ends) if entry in sweep]].isel(dim_indices).compute()
    )
    if FILE in catalogued and str(catalogued[FILE].values) and folder:
        return open_member(run_path(folder, str(catalogued[FILE].values)), str(catalogued[DIGEST].values))
    is_archived = FILE in catalogued
    recorded = is_archived and grid.recording
    model = grid.member_model(axis_indices)
    run = record.whole_of(
        _march_recorded(grid, axis_indices) if recorded else march_model(model, **grid.simulate_arguments(axis_indices))
    )
    digest = archive.digest_of_run(run) if is_archived else digest_of_end(run, states)
    known_ends = [entry for entry in ends if not _is_untold(catalogued[entry].values, run)]
    marched_values = {DIGEST: digest, OUTCOME: run.attrs[OUTCOME]} | {
        entry: run[entry.removeprefix("end_")].values[-1] for entry in known_ends if entry.removeprefix("end_") in run
    }
    differences = [
        f"{name} is {entry}, in the sweep {value}"
        for name, entry in marched_values.items()
        if name in catalogued and not _equal_values(value := catalogued[name].values, entry)
    ]
    if differences:
        raise ArchiveError(
            f"member {grid.member_name(axis_indices)}, computed again, comes to something else: {'; '.join(differences)}"
        )
    return run


def _is_untold(value: Any, run: xr.Dataset) -> bool:
    """Whether a value is nan because its run failed before the end."""
    return run.attrs[OUTCOME] not in GOOD and bool(np.isnan(value).all())


def _equal_values(value: Any, marched_value: Any) -> bool:
    """Whether words or numbers are equal; nan equals nan."""
    numbers = np.asarray(marched_value).dtype.kind == "f"
    return np.array_equal(value, marched_value, equal_nan=numbers)


def _march_recorded(grid: SweepGrid, axis_indices: AxisIndices) -> xr.Dataset:
    """March a member again, recording what the sweep recorded."""
    member_march = March(grid.member_model(axis_indices), grid.recorded_settings_of(axis_indices))
    return archive.marched(record.dataset(member_march))


def sweep_folder(sweep: xr.Dataset) -> Place | None:
    """Return the folder that a sweep was opened from."""
    source = sweep.encoding.get("source")
    return location_of(source).parent if source else None


def run_path(folder: Place, file: str) -> Place:
    """Return the path of a run's file, whose name the catalogue states, in the sweep's own folder.

    Raises
    ------
    ArchiveError
        If the catalogue names anything else.
    """
    if not _RUN_FILE_NAME.fullmatch(file):
        raise ArchiveError(
            f"the catalogue of '{folder}' names {file[:80]!r} as the file of a run; its runs are in '{RUNS}'"
        )
    return folder / file


def open_member(file: Place, digest: str) -> xr.Dataset:
    """Open a member's archive, and check that it holds the run named in the catalogue.

    Raises
    ------
    ArchiveError
        If it holds another run, or is damaged.
    """
    run = archive.open_run(file)
    try:
        check_digest(file, str(run.attrs[ROOT_DIGEST]), digest)
    except ArchiveError:
        run.close()
        raise
    return run


def check_digest(file: Place, digest: str, catalogued: str) -> None:
    """Check that a member's archive holds the run named in the catalogue.

    Raises
    ------
    ArchiveError
        If it holds another.
    """
    if digest != catalogued:
        raise ArchiveError(f"'{file}' has the content digest {digest}, in the catalogue {catalogued}")
