"""Columns of a record stacked, for functions of many of them at once: in memory, or chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.schema import STEPS

Floats = NDArray[np.float64]


def blockwise(
    function: Callable[[Floats, Floats, Any], Floats],
    where: Floats,
    columns: list[Any],
    height: int,
    whole: Callable[[], Any],
    later: Callable[[], Any],
) -> Any:
    """Apply a function to stacked columns, and to what is the same for all of them, lazily where they are lazy."""
    if not any(column.chunks for column in columns):
        return function(where, stacked(columns), whole())
    import dask.array

    da: Any = dask.array  # its functions are not typed

    data = [da.asarray(column.transpose(STEPS, ...).data) for column in columns]
    parts = da.concatenate([part.reshape(len(part), -1).T for part in data]).rechunk({0: -1})
    places = da.from_array(where, chunks=(len(where), parts.chunks[1]))
    return da.map_blocks(
        function,
        places,
        parts,
        dtype=float,
        chunks=((height,), parts.chunks[1]),
        meta=np.empty((0, 0)),
        links=later(),
    )


def stacked(columns: list[Any]) -> Floats:
    """Return the numbers of some variables along `step`, a row for each of their elements."""
    parts = [np.asarray(column.transpose(STEPS, ...)) for column in columns]
    return np.concatenate([part.reshape(len(part), -1).T for part in parts])
