"""Values of archives as xarray asks for them: read when they are used, by one thread at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
from xarray import Variable
from xarray.backends import BackendArray, NetCDF4DataStore
from xarray.core import indexing

from xdynamics.archive.chunk_reading import read_elements
from xdynamics.archive.netcdf_library import with_library_lock
from xdynamics.archive.text_encoding import Form, text_form
from xdynamics.faults import ArchiveError
from xdynamics.record.variable_attributes import own_attributes
from xdynamics.schema import DIGEST


class VariableStore(NetCDF4DataStore):
    """xarray's own reading of variables and how they are stored; their values are read here."""

    __slots__ = ()

    def open_store_variable(self, name: str, var: Any) -> Variable:
        """Return a variable without reading its values."""
        variable = super().open_store_variable(name, var)
        values = StoredValues(self._manager, name, variable.shape, variable.dtype)
        if variable.dtype == "S1":  # letters of a record are UTF-8, whether another program says so or not
            variable.attrs["_Encoding"] = "utf-8"
        form = text_form(variable.attrs, variable.dtype, variable.dims, variable.shape)
        if form is None:
            return Variable(variable.dims, indexing.LazilyIndexedArray(values), variable.attrs, variable.encoding)
        texts = indexing.LazilyIndexedArray(Texts(values, form))
        attributes = own_attributes(variable.attrs) | {DIGEST: variable.attrs.get(DIGEST, "")}
        return Variable(variable.dims[: len(texts.shape)], texts, attributes)


class StoredValues(BackendArray):
    """The values of one variable."""

    def __init__(self, lent: Any, name: str, shape: tuple[int, ...], dtype: Any) -> None:
        self.lent, self.name, self.shape, self.dtype = lent, name, shape, dtype

    def __getitem__(self, key: indexing.ExplicitIndexer) -> Any:
        return indexing.explicit_indexing_adapter(key, self.shape, indexing.IndexingSupport.OUTER, self._read_by_key)

    @with_library_lock
    def _read_by_key(self, key: tuple[Any, ...]) -> Any:
        variable = self.lent.acquire().variables[self.name]
        variable.set_auto_maskandscale(False)
        variable.set_auto_chartostring(False)
        try:
            values = read_elements(variable, key)
        except (OSError, RuntimeError) as error:  # a damaged file that was opened unchecked, or a lost disk
            raise ArchiveError(f"variable '{self.name}' of '{self.lent.location}' cannot be read: {error}") from None
        finally:
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


class Texts(BackendArray):
    """The texts of one variable that are numbers in the file."""

    def __init__(self, numbers: StoredValues, form: Form) -> None:
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
