"""Elements of a variable that is read when it is used: once for all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from xarray import Variable
from xarray.backends import BackendArray
from xarray.core import indexing

Array = NDArray[Any]

MOST_READ = 4  # selections of rows that are kept: elements are asked for the same ones, one after the other


class SharedElements:
    """A variable whose elements are read together.

    Parameters
    ----------
    variable : xarray.Variable
        With the dimensions of the model last.
    own : int
        How many other dimensions it has.
    """

    def __init__(self, variable: Variable, outer_count: int) -> None:
        self.variable, self.outer_count = variable, outer_count
        self._read: dict[Any, Array] = {}

    def element(self, element_index: tuple[int, ...]) -> Any:
        """Return the values of an element, to be read when they are used."""
        return indexing.LazilyIndexedArray(ElementArray(self, element_index))

    def rows_of_all(self, key: tuple[Any, ...]) -> Array:
        """Return the values of all elements in some rows."""
        if all(isinstance(part, slice) and part == slice(None) for part in key):
            return np.asarray(self.variable.values)
        word = tuple(part.tobytes() if isinstance(part, np.ndarray) else str(part) for part in key)
        values = self._read.get(word)
        if values is None:
            values = np.asarray(self.variable[key].values)
            for oldest in [*self._read][: len(self._read) + 1 - MOST_READ]:
                self._read.pop(oldest, None)
            self._read[word] = values
        return values


class ElementArray(BackendArray):
    """The values of one element."""

    def __init__(self, shared: SharedElements, element_index: tuple[int, ...]) -> None:
        self.shared, self.element_index = shared, element_index
        self.shape, self.dtype = shared.variable.shape[: shared.outer_count], shared.variable.dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._element_values)

    def _element_values(self, key: tuple[Any, ...]) -> Any:
        index_of_all: Any = (..., *self.element_index)
        return self.shared.rows_of_all(key)[index_of_all]
