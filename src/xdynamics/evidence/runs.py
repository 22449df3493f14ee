"""The runs that evidence is made from."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from xdynamics import archive, record
from xdynamics.archive.folder_store import has_archive, store_of
from xdynamics.archive.store import Given, Place
from xdynamics.dynamics.shortened_steps import StepInterpolator
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march import March, Settings
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.march.outcomes import INTERRUPTED, OUTCOMES
from xdynamics.methods.scheme import REINTEGRATE
from xdynamics.model import Model
from xdynamics.record.folding import model_dimensions
from xdynamics.record.run_dataset import check_record_room
from xdynamics.runtime.lazy_imports import load_dask_whole

if TYPE_CHECKING:
    import xarray as xr


def record_march(
    march: March,
    path: Given | None,
    rows_before: Iterable[tuple[str, Any]] = (),
    *,
    resume: bool = False,
    memory: str | float | None = None,
) -> xr.Dataset:
    """March, and return the record: in memory, or opened from the file that it is streamed to.

    Parameters
    ----------
    march : March
    path : str or Path, optional
    rows_before : iterable of (str, ndarray)
        Rows that precede those of the march.
    resume : bool
        Whether to go on from segments beside the file.
    memory : str or float, optional
        The most that it may take in memory; see `check_growth`.
    """
    if path is not None:
        return archive.open_run(archive.stream(march, path, earlier_parts=rows_before, resume=resume), check=False)
    return archive.marched(record.dataset(march, rows_before, memory))


def march_model(
    model: Model, path: Place | None = None, memory: str | float | None = None, **requested_settings: Any
) -> xr.Dataset:
    """March a model as `simulate` does, in memory or into a file, without its warnings: outcomes stay in the record.

    Raises
    ------
    InputError
        If a setting is wrong, or the log does not fit into `memory` or on the disk.
    KeyboardInterrupt
        If the march was interrupted: for a single run that is an outcome, for evidence from several it is the end.
    """
    return march_with_settings(model, unthinned_settings_for(model, **requested_settings), path, memory)


def _open_kept_run(prepared: March, path: Place) -> xr.Dataset | None:
    """Open the stored run of a march; None if there is none, or the file is damaged or of another march."""
    with suppress(ArchiveError, InputError):
        if has_archive(path):
            run = archive.open_run(path)
            if record.comes_of(run, prepared):
                return run
            run.close()
    return None


def march_with_settings(
    model: Model, settings: Settings, path: Place | None = None, memory: str | float | None = None
) -> xr.Dataset:
    """March a model with settings that may leave rows or columns out of the record; see `march_model`.

    A file that holds the finished run already, and is intact, is opened in place of a march.

    Raises
    ------
    KeyboardInterrupt
        If the march was interrupted.
    """
    load_dask_whole()
    prepared = March(model, settings)
    if path is not None and (kept_run := _open_kept_run(prepared, path)) is not None:
        return kept_run
    check_record_room(prepared, memory, path and store_of(path).written_at(path))
    run = record_march(prepared, path, resume=path is not None and archive.has_segments(path), memory=memory)
    if run.attrs["run_outcome"] == OUTCOMES[INTERRUPTED].word:
        raise KeyboardInterrupt
    return run


def prepare_record(run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None = None) -> xr.Dataset:
    """Return a record as verbs read it: with one variable for each quantity, or for each element where some were left out."""
    if not model_dimensions(run) or StepInterpolator(run, functions or {}, REINTEGRATE).takes_quantities:
        return run
    return record.unfold(run)
