"""The runs that evidence is made from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics import archive, record
from xdynamics.march import March
from xdynamics.march.configuration import unthinned_settings_for
from xdynamics.march.outcomes import INTERRUPTED, OUTCOMES
from xdynamics.model import Model
from xdynamics.record.size import check_room
from xdynamics.runtime.lazy_imports import load_dask_whole

if TYPE_CHECKING:
    import xarray as xr


def march(model: Model, path: Path | None = None, memory: str | float | None = None, **asked: Any) -> xr.Dataset:
    """March a model as `simulate` does, in memory or into a file, without its warnings: outcomes stay in the record.

    Raises
    ------
    InputError
        If a setting is wrong, or the log does not fit into `memory` or on the disk.
    KeyboardInterrupt
        If the march was interrupted: for a single run that is an outcome, for evidence from several it is the end.
    """
    load_dask_whole()
    prepared = March(model, unthinned_settings_for(model, **asked))
    check_room(prepared, memory, path)
    if path is not None:
        run = archive.open_run(archive.stream(prepared, path, resume=archive.has_segments(path)), check=False)
    else:
        run = archive.marched(record.dataset(prepared, prepared.blocks()))
    if run.attrs["run_outcome"] == OUTCOMES[INTERRUPTED].word:
        raise KeyboardInterrupt
    return run
