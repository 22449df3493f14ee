"""Lazy arrays of archives: values that are read on use, by one thread at a time, and decoded for the reader.

xarray asks for values by index. A list of indices is read in stretches of chunks and selected in memory: the library
looks up each number of a list by itself, at 60 microseconds each; a stretch it copies at memory's speed.

Texts of many members are stored as numbers (see `text_encoding`); the reader gets the texts.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from xarray import Variable
from xarray.backends import BackendArray, NetCDF4DataStore
from xarray.core import indexing

from xdynamics.archive.netcdf_library import with_library_lock
from xdynamics.archive.text_encoding import Form, text_form
from xdynamics.faults import ArchiveError
from xdynamics.record.flag_words import own_attributes
from xdynamics.schema import DIGEST

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
    """Return the chunk size along a dimension, and the number of chunks that make a stretch."""
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


class NumberStore(NetCDF4DataStore):
    """xarray's own reading of variables and how they are stored; their values are read here, as they are stored."""

    __slots__ = ()

    def open_store_variable(self, name: str, var: Any) -> Variable:
        """Return a variable without reading its values."""
        variable = super().open_store_variable(name, var)
        values = StoredValues(self._manager, name, variable.shape, variable.dtype)
        if variable.dtype == "S1":  # letters of a record are UTF-8, whether another program says so or not
            variable.attrs["_Encoding"] = "utf-8"
        return Variable(variable.dims, indexing.LazilyIndexedArray(values), variable.attrs, variable.encoding)


class VariableStore(NumberStore):
    """The same, with the texts that are kept as numbers."""

    __slots__ = ()

    def open_store_variable(self, name: str, var: Any) -> Variable:
        """Return a variable without reading its values."""
        variable = super().open_store_variable(name, var)
        form = text_form(variable.attrs, variable.dtype, tuple(map(str, variable.dims)), variable.shape)
        if form is None:
            return variable
        numbers = StoredValues(self._manager, name, variable.shape, variable.dtype)
        texts = indexing.LazilyIndexedArray(Texts(numbers, form))
        attributes = own_attributes(variable.attrs) | {DIGEST: variable.attrs.get(DIGEST, "")}
        return Variable(variable.dims[: len(texts.shape)], texts, attributes)


class StoredValues(BackendArray):
    """The values of one variable."""

    def __init__(self, lent: Any, name: str, shape: tuple[int, ...], dtype: Any) -> None:
        self.lent, self.name, self.shape, self.dtype = lent, name, shape, dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_by_key)

    def _read_by_key(self, key: tuple[Any, ...]) -> Any:
        if self.lent.partial is not None:  # outside of the library's lock: a store is waited for
            self.lent.partial.provide(self.name, self._chunk_widths(), self.shape, key)
        return self._read_stored(key)

    @with_library_lock
    def _chunk_widths(self) -> tuple[int, ...]:
        chunks = self.lent.acquire().variables[self.name].chunking()
        return tuple(chunks) if isinstance(chunks, list | tuple) else self.shape

    @with_library_lock
    def _read_stored(self, key: tuple[Any, ...]) -> Any:
        variable = self.lent.acquire().variables[self.name]
        variable.set_auto_maskandscale(False)
        variable.set_auto_chartostring(False)
        try:
            values = read_elements(variable, key)
        except (OSError, RuntimeError) as error:  # a damaged file that was opened unchecked, or a lost disk
            raise ArchiveError(f"variable '{self.name}' of '{self.lent.location}' cannot be read: {error}") from None
        finally:
            # also after an error: a file that was overwritten is a better reason than what the library says of it
            self.lent.check_unchanged()
        if self.dtype == "S1":
            self._check_text(values)
        return values

    def _check_text(self, letters: Any) -> None:
        """Check that bytes are text to xarray, which decodes a row of them at a time."""
        width = letters.shape[-1] if letters.ndim else 1
        for row in letters.reshape(-1, width or 1):
            try:
                row.tobytes().decode()
            except UnicodeDecodeError as error:
                raise ArchiveError(
                    f"variable '{self.name}' of '{self.lent.location}' is no text in UTF-8: {error.reason} at {error.start}"
                ) from None


class VariableValues(BackendArray):
    """The values of a variable that another reader opened."""

    def __init__(self, name: str, variable: Variable) -> None:
        self.name, self.variable, self.shape, self.dtype = name, variable, variable.shape, variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_by_key)

    def _read_by_key(self, key: tuple[Any, ...]) -> Any:
        try:
            # arrays in the key select along their own dimensions
            return self.variable[key].values
        except ArchiveError:
            raise
        except (RuntimeError, ValueError) as error:  # of a codec
            raise ArchiveError(f"variable {self.name} cannot be read: {error}") from None


class Texts(BackendArray):
    """The texts of one variable that are numbers in the file."""

    def __init__(self, numbers: StoredValues | VariableValues, form: Form) -> None:
        self.numbers, self.form, self.dtype = numbers, form, np.dtype(f"U{form.width}")
        self.shape: tuple[int, ...] = numbers.shape[: len(numbers.shape) - form.further]

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_by_key)

    def _read_by_key(self, key: tuple[Any, ...]) -> Any:
        stored_key = indexing.OuterIndexer((*key, *(slice(None),) * self.form.further))
        try:
            return self.form.texts(np.asarray(self.numbers[stored_key]))
        except ValueError as error:  # of a file that was opened unchecked
            raise ArchiveError(f"texts of '{self.numbers.name}' cannot be read: {error}") from None
