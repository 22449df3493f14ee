"""Runs that evidence is made from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from xdynamics import archive, record
from xdynamics.entrance import load_dask_whole
from xdynamics.march import March
from xdynamics.march.asking import settings_for
from xdynamics.model import Model

if TYPE_CHECKING:
    import xarray as xr


def march(model: Model, path: Path | None = None, **asked: Any) -> xr.Dataset:
    """March a model as `simulate` does, in memory or into a file, and keep warnings back: outcomes stay in the record."""
    load_dask_whole()
    one = March(model, settings_for(model, **asked))
    if path is not None:
        return archive.open_run(archive.stream(one, path), check=False)
    found: xr.Dataset = archive.marched(record.dataset(one, one.blocks()))
    return found
