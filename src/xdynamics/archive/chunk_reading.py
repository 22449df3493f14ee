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


def read_elements(variable: netCDF4.Variable[Any], key: tuple[Any, ...]) -> Any:
    """Return ``variable[key]``, where each list in the key selects along its own dimension."""
    axis = next((axis for axis, index in enumerate(key) if isinstance(index, np.ndarray)), None)
    if axis is None:
        return variable[key]

    def read_stretch(first: int, last: int) -> Array:
        return np.asarray(read_elements(variable, (*key[:axis], slice(first, last), *key[axis + 1 :])))

    rows = _nonnegative_indices(key[axis], variable.shape[axis])
    if not rows.size:
        return read_stretch(0, 0)
    # a number in the place of a list or slice removes its dimension
    leading_slices: tuple[Any, ...] = (slice(None),) * (
        axis - sum(isinstance(index, int | np.integer) for index in key[:axis])
    )
    elements = None
    for batch_indices in _rows_by_stretch(rows, *_stretch_sizes(variable, axis)):
        batch = rows[batch_indices]
        first = int(batch.min())
        part = read_stretch(first, int(batch.max()) + 1)[(*leading_slices, batch - first)]
        if elements is None:
            shape = part.shape
            elements = np.empty(
                (*shape[: len(leading_slices)], rows.size, *shape[len(leading_slices) + 1 :]), part.dtype
            )
        elements[(*leading_slices, batch_indices)] = part
    return elements


def _nonnegative_indices(rows: Array, length: int) -> NDArray[np.int64]:
    """Return non-negative indices of elements; negative ones count from the end."""
    positions = np.where(rows < 0, rows + length, rows).astype(np.int64)
    outside = np.flatnonzero((positions < 0) | (positions >= length))
    if outside.size:
        raise IndexError(f"index {rows[outside[0]]} is out of bounds for a dimension of {length}")
    return positions


def _stretch_sizes(variable: netCDF4.Variable[Any], axis: int) -> tuple[int, int]:
    """Return how many elements along a dimension are stored together, and how many of such parts make a stretch."""
    chunks = variable.chunking()
    part = int(chunks[axis]) if isinstance(chunks, list | tuple) else UNCHUNKED
    elements_per_row = prod(variable.shape[:axis] + variable.shape[axis + 1 :])
    width = np.dtype(variable.dtype).itemsize if variable.dtype is not str else 1
    return part, max(1, LARGEST // max(1, part * elements_per_row * width))


def _rows_by_stretch(rows: NDArray[np.int64], part: int, max_parts: int) -> Iterator[NDArray[np.int64]]:
    """Yield which of the rows are read in one stretch: those of neighbouring parts, so many at most."""
    order = np.argsort(rows, kind="stable")
    parts, starts = np.unique(rows[order] // part, return_index=True)
    starts_stretch = np.concatenate([[True], np.diff(parts) > 1])
    begins = np.flatnonzero(starts_stretch)
    index_in_stretch = np.arange(parts.size) - begins[np.cumsum(starts_stretch) - 1]
    yield from np.split(order, starts[(index_in_stretch % max_parts == 0)][1:])
