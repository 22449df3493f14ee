"""Runs and sweeps in chunks whose reading is counted, or fails."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
import xarray as xr


class Stored:
    """An array that notes from where it is read."""

    def __init__(self, name: str, values: np.ndarray, reads: Counter[tuple[str, int]]) -> None:
        self._name, self._values, self._reads = name, values, reads
        self.shape, self.dtype, self.ndim = values.shape, values.dtype, values.ndim

    def __getitem__(self, key: Any) -> np.ndarray:
        values = self._values[key]
        if values.size:
            self._reads[self._name, getattr(key[0], "start", key[0])] += 1
        return values


def chunked(run: xr.Dataset, sizes: Sequence[int]) -> tuple[xr.Dataset, Counter[tuple[str, int]]]:
    """Return a run in memory as one in chunks of so many rows, and how often each chunk of each variable was read."""
    import dask.array as da

    reads: Counter[tuple[str, int]] = Counter()
    lazy = run.copy()
    for name, variable in run.variables.items():
        if variable.dims[:1] == ("step",):
            chunks = (tuple(sizes), *((size,) for size in variable.shape[1:]))
            array = da.from_array(Stored(str(name), variable.values, reads), chunks=chunks, name=f"{name}-{id(reads)}")
            lazy[name] = xr.Variable(variable.dims, array, variable.attrs)
    return lazy, reads


class UnreadError(Exception):
    """An array was read that no one may read."""


class Unread(Stored):
    """An array that cannot be read."""

    def __getitem__(self, key: Any) -> np.ndarray:
        if self._values[key].size:
            raise UnreadError(f"'{self._name}' is read")
        return self._values[key]


def unread(dataset: xr.Dataset) -> xr.Dataset:
    """Return a run or a sweep with dask arrays that cannot be computed, where values are along a dimension."""
    import dask.array as da

    reads: Counter[tuple[str, int]] = Counter()
    return dataset.assign(
        {
            name: (variable.dims, da.from_array(Unread(str(name), variable.values, reads)), variable.attrs)
            for name, variable in dataset.variables.items()
            if variable.dims not in ((), ("document",)) and name not in dataset.indexes
        }
    )


def ragged(count: int, parts: int, case: int) -> list[int]:
    """Return random sizes of chunks that add up to a count."""
    borders = np.random.default_rng(case).choice(np.arange(1, count), min(parts, count) - 1, replace=False)
    return np.diff([0, *np.sort(borders), count]).tolist()
