"""Digests of runs: one for each variable, one over everything that is no circumstance."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.record import own_attributes, plain
from xdynamics.schema import (
    BOUNDS,
    EVENTS,
    ORIGIN,
    ROOT_DIGEST,
    SAMPLES,
    STEPS,
    TRIALS,
    VOLATILE,
    VOLATILE_DIGEST,
    Variable,
)

if TYPE_CHECKING:
    import xarray as xr

Array = NDArray[Any]

# rows of one stored chunk: a megabyte of floats for what grows by steps, little for what is rare
CHUNKS = {STEPS: 131_072, SAMPLES: 131_072, TRIALS: 4_096, EVENTS: 512, BOUNDS: 2}
OTHER_CHUNK = 4_096


def content_digest(run: xr.Dataset) -> str:
    """Return the content digest that an archive of a Dataset would have."""
    found = {}
    for name, variable in run.variables.items():
        seal = Seal(str(name), tuple(map(str, variable.dims)), variable.dtype)
        for part in slabs(variable):
            seal.update(part)
        found[str(name)] = seal.hexdigest()
    attributes = {str(name): own_attributes(one.attrs) for name, one in run.variables.items()}
    return root_digest(found, attributes, run.attrs)


MARK = b"\nxdynamics seal 1 "
_LENGTH = len(MARK) + 64 + 1
_PART = 1 << 22


def seal_file(path: Path) -> None:
    """Append a digest of all bytes of a file; readers of HDF5 pass over what stands behind its end."""
    mark = MARK + _file_digest(path, path.stat().st_size).encode() + b"\n"
    with path.open("ab") as file:
        file.write(mark)


def seal_holds(path: Path) -> bool | None:
    """Tell whether a file is byte for byte the one that was sealed; None where it bears no seal."""
    size = path.stat().st_size - _LENGTH
    if size < 0:
        return None
    with path.open("rb") as file:
        file.seek(size)
        mark = file.read()
    if not mark.startswith(MARK):
        return None
    return mark[len(MARK) : -1].decode("ascii", "replace") == _file_digest(path, size)


def _file_digest(path: Path, size: int) -> str:
    """sha256 of the sha256 of every 4 MiB, which all cores may take at once."""

    def of_part(start: int) -> bytes:
        with path.open("rb") as file:
            file.seek(start)
            return hashlib.sha256(file.read(min(_PART, size - start))).digest()

    with ThreadPoolExecutor() as pool:
        return hashlib.sha256(b"".join(pool.map(of_part, range(0, size, _PART)))).hexdigest()


class Seal:
    """The digest of one variable: name, dims, type, bytes in order, shape."""

    def __init__(self, name: str, dims: tuple[str, ...], dtype: np.dtype[Any]) -> None:
        self.is_text = dtype.kind in "UOT"
        self.dtype = dtype if self.is_text else np.dtype(dtype).newbyteorder("<")
        label = "text" if self.is_text else self.dtype.str.replace("|", "<")
        self._sha = hashlib.sha256(json.dumps([name, list(dims), label]).encode())
        self._rows = 0
        self._inner: tuple[int, ...] | None = () if not dims else None

    @classmethod
    def of(cls, variable: Variable) -> Seal:
        """Return the digest of a variable of the record, before its first value."""
        return cls(variable.name, variable.dims, np.dtype(variable.dtype))

    def update(self, values: Array) -> None:
        """Add the next values."""
        if self.is_text:
            self._sha.update(letters(values).tobytes())
            return
        if values.ndim:
            self._rows += values.shape[0]
            self._inner = values.shape[1:]
        self._sha.update(np.ascontiguousarray(values, dtype=self.dtype).data)

    def hexdigest(self) -> str:
        """Return the digest of everything added so far."""
        sealed = self._sha.copy()
        sealed.update(json.dumps([self._rows, *(self._inner or ())]).encode())
        return sealed.hexdigest()


def slabs(variable: Any) -> Iterator[Array]:
    """Yield a variable's values along its first dimension, a chunk at a time; one is computed at a time."""
    if not variable.dims:
        yield np.asarray(variable.values)
        return
    rows = CHUNKS.get(variable.dims[0], OTHER_CHUNK) * 8
    for start in range(0, max(1, variable.shape[0]), rows):
        yield np.asarray(variable[start : start + rows].values)


def letters(text: Array) -> Array:
    """Return a text, as it is in memory or in a file, as single bytes of UTF-8."""
    if text.dtype == "S1" and text.ndim == 1:
        return text
    return np.frombuffer(str(text[()]).encode(), dtype="S1")


def stored_digest(variable: Any) -> str:
    """Return the digest of a variable of an open netCDF file, read a chunk at a time."""
    is_text = variable.dtype is not str and variable.dtype == "S1"
    if variable.dtype is str:
        raise ValueError("it holds texts of any length, which no record does")
    seal = Seal(variable.name, () if is_text else variable.dimensions, np.dtype(object) if is_text else variable.dtype)
    if is_text or not variable.dimensions:
        variable.set_auto_chartostring(False)
        seal.update(np.asarray(variable[...]))
    else:
        rows = CHUNKS.get(variable.dimensions[0], OTHER_CHUNK) * 8
        for start in range(0, max(1, variable.shape[0]), rows):
            seal.update(np.asarray(variable[start : start + rows]))
    return seal.hexdigest()


def root_digest(digests: Mapping[str, str], attributes: Mapping[str, Mapping[str, Any]], run: Mapping[Any, Any]) -> str:
    """Return the content digest, from the variables' digests and every attribute that is no circumstance."""
    outside = {*VOLATILE, ROOT_DIGEST, ORIGIN}
    content = {
        "variables": {name: [digests[name], plain(attributes[name])] for name in sorted(digests)},
        "attributes": plain({key: value for key, value in run.items() if key not in outside}),
    }
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def volatile_digest(run: Mapping[Any, Any]) -> str:
    """Return the digest of the circumstances: date, versions, machine."""
    content = plain({key: value for key, value in run.items() if key in VOLATILE and key != VOLATILE_DIGEST})
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
