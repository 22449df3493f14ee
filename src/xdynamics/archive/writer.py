"""A netCDF file while it is filled: variables are defined, appended to, then sealed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import prod
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.declared_sizes import variables_to_compress
from xdynamics.archive.netcdf_library import with_library_lock
from xdynamics.archive.place import Place
from xdynamics.archive.seals import (
    CHUNKS,
    OTHER_CHUNK,
    Seal,
    digest_lines,
    letters_of,
    root_digest,
    utf8_letters,
    volatile_digest,
)
from xdynamics.archive.text_encoding import EncodedTexts, encoded_texts
from xdynamics.march.outcomes import GOOD
from xdynamics.record.partial_records import is_evidence
from xdynamics.record.variable_attributes import own_attributes
from xdynamics.schema import (
    BOUNDS,
    CLOSED_TIME,
    COMPRESSION,
    COMPRESSION_WORDS,
    DIGEST,
    DIGESTS,
    ROOT_DIGEST,
    SEAL_WORDS,
    SEALED,
    STEP_NUMBER,
    VOLATILE_DIGEST,
    coordinates_of,
    is_former,
)

if TYPE_CHECKING:
    import netCDF4

Array = NDArray[Any]

COUNTED = (STEP_NUMBER.name, CLOSED_TIME)  # that compress to nearly nothing, and always are
BACK = 1 << 19  # values that are read back at once


class Writer:
    """Fills one netCDF file: variables are defined, appended to, then sealed.

    Attributes
    ----------
    path : Path, or name of an object
        The name that the file takes in the end.
    numbered : bool
        Whether outcomes and digests are kept as numbers, as of a sweep's many members; other readers see the numbers.
    complete : bool
        Whether the run ended well; known when it is finished.
    digest : str
        The content digest; known when it is finished.
    seal : str
        The digest of the file's bytes; known when it has its name.
    """

    path: Place
    numbered = False
    complete: bool
    digest: str
    seal: str

    def __init__(self, file: netCDF4.Dataset) -> None:
        self._file = file
        self._packed: set[str] = set()
        self._seals: dict[str, Seal] = {}
        self._attributes: dict[str, dict[str, Any]] = {}
        self._filled: dict[str, int] = {}

    def pack(self, widths: Mapping[str, tuple[str, int]]) -> None:
        """Compress variables that are going to be defined, as far as readers accept; see `bounds.packed`."""
        self._packed = variables_to_compress(widths)

    @with_library_lock
    def define(
        self,
        name: str,
        dims: tuple[str, ...],
        dtype: np.dtype[Any],
        attributes: Mapping[str, Any],
        sizes: Mapping[str, int],
    ) -> None:
        """Create a variable; a dimension without a size may grow."""
        for dim in dims:
            if dim not in self._file.dimensions:
                self._file.createDimension(dim, 2 if dim == BOUNDS else sizes.get(dim))
        seal = Seal(name, dims, dtype)
        self._seals[name] = seal
        self._attributes[name] = own_attributes(attributes)
        self._filled[name] = 0
        if seal.is_text:
            return  # created when its length is known
        chunks = _chunk_shape(dims, sizes) if dims else None
        # further levels of zlib take more time, a tenth and up, for a hundredth of the bytes
        variable = self._file.createVariable(
            name,
            seal.dtype,
            dims,
            chunksizes=chunks,
            fill_value=False,
            endian="little",
            zlib=name in self._packed or name in COUNTED,
            complevel=1,
            shuffle=name in self._packed or name in COUNTED,
        )
        variable.set_auto_maskandscale(False)
        if chunks:
            # room for the one chunk that is being filled: the library's 16 MiB each would not be bounded memory
            variable.set_var_chunk_cache(size=2 * prod(chunks) * seal.dtype.itemsize)

    def describe(self, name: str, more: Mapping[str, Any]) -> None:
        """Add attributes of a variable that were not known when it was defined."""
        self._attributes[name] |= own_attributes(more)

    @property
    def filled(self) -> dict[str, int]:
        """How many values along its first dimension every variable was given."""
        return dict(self._filled)

    def digests(self) -> dict[str, str]:
        """Return the digest of every variable, as far as it is hashed."""
        return {name: seal.hexdigest() for name, seal in self._seals.items()}

    @with_library_lock
    def shapes_since(self, earlier_counts: Mapping[str, int]) -> list[tuple[str, Any, tuple[int, ...]]]:
        """Return name, type and shape of the values that variables were given since they held `earlier_counts`."""
        return [
            (name, self._seals[name].dtype, (n - earlier_counts.get(name, 0), *self._file.variables[name].shape[1:]))
            for name, n in self._filled.items()
        ]

    def since(self, earlier_counts: Mapping[str, int]) -> Iterator[Array]:
        """Read back the values that variables were given since they held `earlier_counts`, some megabytes at a time."""
        for name, n in self._filled.items():
            rows = max(1, BACK // prod(self._file.variables[name].shape[1:]))
            for start in range(earlier_counts.get(name, 0), n, rows):
                yield self._read_back(name, start, min(start + rows, n))

    @with_library_lock
    def _read_back(self, name: str, start: int, stop: int) -> Array:
        return np.asarray(self._file.variables[name][start:stop])

    def append(self, name: str, values: Array) -> None:
        """Write and hash the next values of a variable."""
        values = utf8_letters(values) if self._seals[name].is_text else values
        self.write([(name, values)])
        self.hash([(name, values)])

    def write(self, parts: list[tuple[str, Array]]) -> None:
        """Write the next values of variables."""
        for name, values in parts:
            self._write_one(name, values)

    @with_library_lock
    def _write_one(self, name: str, values: Array) -> None:
        if self._seals[name].is_text:
            self._write_text(name, utf8_letters(values))
        elif values.ndim == 0:
            self._file.variables[name][...] = values
        elif values.shape[0]:
            start = self._filled[name]
            self._file.variables[name][start : start + values.shape[0]] = values
            self._filled[name] = start + values.shape[0]

    def _write_text(self, name: str, letters: Array) -> None:
        """Write texts as numbers or characters: variable-length strings crash the library when a file is open twice."""
        numbers = encoded_texts(name, self._attributes[name].get("role"), letters) if self.numbered else None
        if numbers is not None:
            self._write_numbers(name, numbers)
            return
        dim = letters_of(name)
        self._file.createDimension(dim, letters.shape[-1])
        variable = self._file.createVariable(name, "S1", (*self._seals[name].dims, dim), fill_value=False)
        variable.set_auto_chartostring(False)
        variable[...] = letters
        variable.setncattr("_Encoding", "utf-8")

    def _write_numbers(self, name: str, numbers: EncodedTexts) -> None:
        dims, values = self._seals[name].dims, numbers.values
        if numbers.dim:
            self._file.createDimension(numbers.dim, values.shape[-1])
            dims = (*dims, numbers.dim)
        variable = self._file.createVariable(name, values.dtype, dims, fill_value=False)
        variable.set_auto_maskandscale(False)
        variable[...] = values
        variable.setncatts(numbers.attributes)

    def hash(self, parts: list[tuple[str, Array]]) -> None:
        """Add the next values of variables to their digests."""
        for name, values in parts:
            self._seals[name].update(values)

    @with_library_lock
    def finish(self, attributes: Mapping[str, Any]) -> None:
        """Write every attribute and digest; remember the content digest, and whether the run ended well."""
        self.complete = is_evidence(attributes) or attributes.get("run_outcome") in GOOD
        written_attributes = {
            key: value for key, value in attributes.items() if key not in (ROOT_DIGEST, VOLATILE_DIGEST, DIGESTS)
        }
        written_attributes[SEALED] = SEAL_WORDS
        written_attributes.pop(COMPRESSION, None)
        if self._packed:
            written_attributes[COMPRESSION] = COMPRESSION_WORDS
        digests, former = self.digests(), is_former(attributes)
        about = {name: (seal.dims, self._attributes[name].get("role")) for name, seal in self._seals.items()}
        for name, variable_attributes in self._attributes.items():
            coordinates = coordinates_of(name, about, former=former)
            kept_as = {"coordinates": coordinates} if coordinates else {}
            self._file.variables[name].setncatts(
                variable_attributes | kept_as | ({DIGEST: digests[name]} if former else {})
            )
        if not former:
            written_attributes[DIGESTS] = digest_lines(digests)
        self._file.setncatts(written_attributes)
        self.digest = root_digest(digests, self._attributes, written_attributes)
        self._file.setncattr(ROOT_DIGEST, self.digest)
        self._file.setncattr(VOLATILE_DIGEST, volatile_digest(digests, self._attributes, written_attributes))


def _chunk_shape(dims: tuple[str, ...], sizes: Mapping[str, int]) -> list[int]:
    """Return the form of a variable's chunks: of rows with many elements as many as a megabyte holds, or a part of one."""
    chunks = [min(chunk_limit := CHUNKS.get(dim, OTHER_CHUNK), max(1, sizes.get(dim, chunk_limit))) for dim in dims]
    room = CHUNKS.get(dims[0], OTHER_CHUNK)
    for k in reversed(range(1, len(dims))):
        if (size := sizes.get(dims[k], 0)) > chunks[k]:
            parts = -(-size // max(chunks[k], room // prod(chunks[k + 1 :])))
            chunks[k] = -(-size // parts)  # equal parts: what is left of the last one would be written too
    if dims[0] in CHUNKS and (inner := prod(chunks[1:])) > 2:  # elements of a model's dimensions
        chunks[0] = min(chunks[0], max(1, room // inner))
    return chunks
