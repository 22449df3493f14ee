"""Elements of a stored variable by index: read in stretches of chunks, and chosen in memory.

The library looks up each number of a list by itself, at 60 microseconds each; a stretch it copies at memory's speed.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import netCDF4

Array = NDArray[Any]

LARGEST = 1 << 25  # bytes of a stretch
UNCHUNKED = 1 << 16  # elements that are taken for a chunk where a variable has none


def chosen(variable: netCDF4.Variable[Any], key: tuple[Any, ...]) -> Any:
    """Return ``variable[key]``, where each list in the key selects along its own dimension."""
    axis = next((axis for axis, index in enumerate(key) if isinstance(index, np.ndarray)), None)
    if axis is None:
        return variable[key]

    def stretch(first: int, last: int) -> Array:
        return np.asarray(chosen(variable, (*key[:axis], slice(first, last), *key[axis + 1 :])))

    rows = _counted_from_the_start(key[axis], variable.shape[axis])
    if not rows.size:
        return stretch(0, 0)
    # a number in the place of a list or slice removes its dimension
    before: tuple[Any, ...] = (slice(None),) * (axis - sum(isinstance(index, int | np.integer) for index in key[:axis]))
    result = None
    for which in _together(rows, *_sizes(variable, axis)):
        batch = rows[which]
        first = int(batch.min())
        part = stretch(first, int(batch.max()) + 1)[(*before, batch - first)]
        if result is None:
            shape = part.shape
            result = np.empty((*shape[: len(before)], rows.size, *shape[len(before) + 1 :]), part.dtype)
        result[(*before, which)] = part
    return result


def _counted_from_the_start(rows: Array, length: int) -> NDArray[np.int64]:
    """Return non-negative indices of elements; negative ones count from the end."""
    positions = np.where(rows < 0, rows + length, rows).astype(np.int64)
    outside = np.flatnonzero((positions < 0) | (positions >= length))
    if outside.size:
        raise IndexError(f"index {rows[outside[0]]} is out of bounds for a dimension of {length}")
    return positions


def _sizes(variable: netCDF4.Variable[Any], axis: int) -> tuple[int, int]:
    """Return how many elements along a dimension are stored together, and how many of such parts make a stretch."""
    chunks = variable.chunking()
    part = int(chunks[axis]) if isinstance(chunks, list | tuple) else UNCHUNKED
    others = prod(variable.shape[:axis] + variable.shape[axis + 1 :])
    width = np.dtype(variable.dtype).itemsize if variable.dtype is not str else 1
    return part, max(1, LARGEST // max(1, part * others * width))


def _together(rows: NDArray[np.int64], part: int, most: int) -> Iterator[NDArray[np.int64]]:
    """Yield which of the rows are read in one stretch: those of neighbouring parts, so many at most."""
    order = np.argsort(rows, kind="stable")
    parts, starts = np.unique(rows[order] // part, return_index=True)
    apart = np.concatenate([[True], np.diff(parts) > 1])
    begins = np.flatnonzero(apart)
    within = np.arange(parts.size) - begins[np.cumsum(apart) - 1]
    yield from np.split(order, starts[(within % most == 0)][1:])
