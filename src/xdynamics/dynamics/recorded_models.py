"""The models of records, read once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache

import xarray as xr

from xdynamics.model import Model


def model_of_record(run: xr.Dataset, functions: Mapping[str, Callable[..., float]] | None) -> Model:
    """Return the model of a record, cached."""
    return _read_cached_model(run.variables["model_toml"].values.item(), tuple((functions or {}).items()))


@lru_cache(maxsize=16)
def _read_cached_model(text: str, functions: tuple[tuple[str, Callable[..., float]], ...]) -> Model:
    """Read a model from its text, cached."""
    return Model.from_record(text, functions=dict(functions))
