"""Runs in files: written whole or not at all, with a digest for everything, checked on opening."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.seals import (
    CHUNKS,
    OTHER_CHUNK,
    Seal,
    letters,
    root_digest,
    seal_file,
    seal_holds,
    slabs,
    stored_digest,
    volatile_digest,
)
from xdynamics.faults import ArchiveError, InputError, numbered
from xdynamics.march import Block, March
from xdynamics.record import own_attributes, provenance
from xdynamics.schema import BOUNDS, DIGEST, ROOT_DIGEST, STEPS, VOLATILE_DIGEST

if TYPE_CHECKING:
    import netCDF4
    import xarray as xr

Array = NDArray[Any]

BLOCK_ROWS = 131_072
BLOCK_NUMBERS = 32_000_000  # of a block, which has fewer rows where there are many columns
# what the libraries raise on files that are damaged or of another kind
_DAMAGE = (OSError, RuntimeError, ValueError, AttributeError, LookupError, TypeError, MemoryError, OverflowError)
READ_BACK = 64_000_000  # bytes up to which a new file is read again in full before it takes its name


def save(run: xr.Dataset, path: str | Path) -> Path:
    """Write a run to a netCDF4 file.

    The file is written under a temporary name in the same folder, closed, opened again and checked, and takes its
    name last: under the final name there is the old file or the new one, never something between.

    Parameters
    ----------
    run : xarray.Dataset
        A run record; checked against the schema first.
    path : str or Path

    Raises
    ------
    InputError
        If the Dataset is no run record.
    ArchiveError
        If the file cannot be written; the final name is untouched.
    """
    record.check(run)
    with _new_file(Path(path)) as writer:
        for name, variable in run.variables.items():
            sizes = {str(dim): n for dim, n in zip(variable.dims, variable.shape, strict=True) if n}
            coordinates = "time" if STEPS in variable.dims and name != "time" else None
            writer.define(
                str(name), tuple(map(str, variable.dims)), variable.dtype, dict(variable.attrs), coordinates, sizes
            )
        for name, variable in run.variables.items():
            for part in slabs(variable):
                writer.append(str(name), part)
        writer.finish(dict(run.attrs))
    return Path(path)


def stream(march: March, path: str | Path) -> Path:
    """March straight into a file, in bounded memory; one block is written while the next is marched.

    Raises
    ------
    ArchiveError
        If the file cannot be written; the final name is untouched.
    """
    spec = record.columns(march)
    with _new_file(Path(path)) as writer, ThreadPoolExecutor(1) as pool:
        for column in spec:
            one = column.variable
            coordinates = "time" if STEPS in one.dims and one.name != "time" else None
            writer.define(one.name, one.dims, np.dtype(one.dtype), one.attributes, coordinates, {})
        pending: Future[None] | None = None
        rows = min(BLOCK_ROWS, BLOCK_NUMBERS // len(march.layout.row), march.expected_rows or BLOCK_ROWS)
        for block in march.blocks(rows):
            parts = _taken(spec, block)
            if pending:
                pending.result()
            pending = pool.submit(writer.write, parts)
            writer.hash(parts)
        if pending:
            pending.result()
        for one, value in record.constants(march):
            dtype = np.dtype(object) if one.dtype == "U" else np.dtype(one.dtype)
            sizes = dict(zip(one.dims, np.shape(value), strict=True))
            writer.define(one.name, one.dims, dtype, one.attributes, None, sizes)
            writer.append(one.name, np.asarray(value, dtype=dtype))
        writer.finish(provenance.attributes(march))
    return Path(path)


def open_run(path: str | Path, *, check: bool = True) -> xr.Dataset:
    """Open an archived run, verified; variables are read when they are used.

    Parameters
    ----------
    path : str or Path
    check : bool
        Whether to compare the file with its seal first, or where it bears none with every digest; this reads the whole
        file once.

    Raises
    ------
    ArchiveError
        If the file is damaged or no run archive; names what differs.
    """
    import xarray as xr

    path = Path(path)
    check_source(path)
    if check and not seal_holds(path):
        verify(path)
    try:
        return xr.open_dataset(path, engine="netcdf4", decode_times=False, mask_and_scale=False)
    except _DAMAGE as error:
        raise ArchiveError(f"'{path}' cannot be opened as a run archive: {error}") from None


def verify(path: str | Path) -> str:
    """Compare an archive with its digests: the file's bytes, every variable, every attribute.

    Returns
    -------
    str
        The content digest.

    Raises
    ------
    InputError
        If there is no such file.
    ArchiveError
        Naming every variable that differs from its digest.
    """
    path = Path(path)
    check_source(path)
    faults = ["the bytes of the file differ from its seal"] if seal_holds(path) is False else []
    with _opened(path) as file:
        faults += [
            f"attribute '{name}' is missing" for name in (ROOT_DIGEST, VOLATILE_DIGEST) if name not in file.ncattrs()
        ]
        digests: dict[str, str] = {}
        for name, variable in file.variables.items():
            fault = _fault_of(variable, digests)
            if fault:
                faults.append(f"variable '{name}' {fault}")
        attributes = {key: file.getncattr(key) for key in file.ncattrs()}
        if not faults:
            own = {name: _attributes_of(one) for name, one in file.variables.items()}
            if attributes[ROOT_DIGEST] != root_digest(digests, own, attributes):
                faults.append("the attributes differ from the content digest")
            if attributes[VOLATILE_DIGEST] != volatile_digest(attributes):
                faults.append("the attributes on date, versions and machine differ from their digest")
    if faults:
        raise ArchiveError(f"'{path}' is damaged or no run archive:{numbered(faults)}", tuple(faults))
    return str(attributes[ROOT_DIGEST])


def _fault_of(variable: Any, digests: dict[str, str]) -> str:
    """Compare one variable with its digest, and note the digest; return what is wrong."""
    try:
        digests[variable.name] = stored_digest(variable)
        attributes = {key: variable.getncattr(key) for key in variable.ncattrs()}
    except _DAMAGE as error:
        return f"cannot be read: {error}"
    if attributes.get(DIGEST) != digests[variable.name]:
        return "differs from its digest"
    if attributes.get("coordinates", "time") != "time" or attributes.get("_Encoding", "utf-8") != "utf-8":
        return "is not stored as it was written"
    return ""


class _Writer:
    """Fills one netCDF file: variables are defined, appended to, then sealed."""

    def __init__(self, file: netCDF4.Dataset) -> None:
        self._file = file
        self._seals: dict[str, Seal] = {}
        self._attributes: dict[str, dict[str, Any]] = {}
        self._coordinates: dict[str, str] = {}
        self._filled: dict[str, int] = {}

    def define(
        self,
        name: str,
        dims: tuple[str, ...],
        dtype: np.dtype[Any],
        attributes: Mapping[str, Any],
        coordinates: str | None,
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
        if coordinates:
            self._coordinates[name] = coordinates
        if seal.is_text:
            return  # created when its length is known
        chunks = (
            [min(CHUNKS.get(dim, OTHER_CHUNK), max(1, sizes.get(dim, CHUNKS.get(dim, OTHER_CHUNK)))) for dim in dims]
            if dims
            else None
        )
        variable = self._file.createVariable(
            name, seal.dtype, dims, chunksizes=chunks, fill_value=False, endian="little"
        )
        if chunks:
            # room for the one chunk that is being filled: the library's 16 MiB each would not be bounded memory
            variable.set_var_chunk_cache(size=2 * prod(chunks) * seal.dtype.itemsize)

    def append(self, name: str, values: Array) -> None:
        """Write and hash the next values of a variable."""
        self.write([(name, values)])
        self.hash([(name, values)])

    def write(self, parts: list[tuple[str, Array]]) -> None:
        """Write the next values of variables."""
        for name, values in parts:
            if self._seals[name].is_text:
                self._write_text(name, letters(values))
            elif values.ndim == 0:
                self._file.variables[name][...] = values
            elif values.shape[0]:
                start = self._filled[name]
                self._file.variables[name][start : start + values.shape[0]] = values
                self._filled[name] = start + values.shape[0]

    def _write_text(self, name: str, letters: Array) -> None:
        """Write a text as characters: variable-length strings crash the library when a file is open twice."""
        dim = f"{name}_characters"
        self._file.createDimension(dim, len(letters))
        variable = self._file.createVariable(name, "S1", (dim,), fill_value=False)
        variable.set_auto_chartostring(False)
        variable[:] = letters
        variable.setncattr("_Encoding", "utf-8")

    def hash(self, parts: list[tuple[str, Array]]) -> None:
        """Add the next values of variables to their digests."""
        for name, values in parts:
            self._seals[name].update(values)

    def finish(self, attributes: Mapping[str, Any]) -> None:
        """Write every attribute and digest."""
        kept = {key: value for key, value in attributes.items() if key not in (ROOT_DIGEST, VOLATILE_DIGEST)}
        digests = {name: seal.hexdigest() for name, seal in self._seals.items()}
        for name, own in self._attributes.items():
            kept_as = {"coordinates": self._coordinates[name]} if name in self._coordinates else {}
            self._file.variables[name].setncatts(own | kept_as | {DIGEST: digests[name]})
        self._file.setncatts(kept)
        self._file.setncattr(ROOT_DIGEST, root_digest(digests, self._attributes, kept))
        self._file.setncattr(VOLATILE_DIGEST, volatile_digest(kept))


def check_target(path: Path) -> None:
    """Refuse a path that no file can be written to.

    Raises
    ------
    InputError
        If it is a directory, its folder does not exist, or it is no path at all.
    """
    if _asked(path, Path.is_dir):
        raise InputError(f"'{path}' is a directory; name a file in it, like '{path / 'run.nc'}'")
    if not _asked(path.parent, Path.is_dir):
        raise InputError(f"'{path}' cannot be written: the folder '{path.parent}' does not exist")


def check_source(path: Path) -> None:
    """Refuse a path that no file can be read from; see `check_target`."""
    if _asked(path, Path.is_dir):
        raise InputError(f"'{path}' is a directory; name a file in it")
    if not _asked(path, Path.exists):
        raise InputError(f"'{path}' does not exist")


def _asked(path: Path, question: Callable[[Path], bool]) -> bool:
    if "\0" in str(path):
        raise InputError(f"{str(path)[:80]!r} is no path for a file: it holds a null character")
    try:
        return question(path)
    except OSError as error:
        raise InputError(f"'{str(path)[:80]}' is no path for a file: {error}") from None


@contextmanager
def _new_file(path: Path) -> Iterator[_Writer]:
    """Write a file under a temporary name, check it, and give it its name."""
    import netCDF4

    check_target(path)
    temporary = None
    try:
        handle, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".part")
        os.close(handle)
        temporary = Path(name)
        umask = os.umask(0)
        os.umask(umask)
        temporary.chmod(0o666 & ~umask)
        with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
            file.set_fill_off()
            yield _Writer(file)
        if temporary.stat().st_size <= READ_BACK:
            verify(temporary)
        else:
            with _opened(temporary):
                pass
        seal_file(temporary)
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
    except (OSError, RuntimeError) as error:
        raise ArchiveError(
            f"'{path}' cannot be written: {_cause(path.parent, error)}; nothing is changed there"
        ) from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def _cause(folder: Path, error: Exception) -> str:
    """Say why a write failed; the netCDF library itself guesses."""
    try:
        with tempfile.TemporaryFile(dir=folder) as probe:
            probe.write(b"\0" * 1_000_000)
            probe.flush()
    except OSError as why:
        return why.strerror or str(why)
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return f"{error} (disk full, file-size limit or lost device)"


def _sync(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


@contextmanager
def _opened(path: Path) -> Iterator[netCDF4.Dataset]:
    import netCDF4

    check_source(path)
    try:
        with netCDF4.Dataset(path, "r") as file:
            file.set_auto_maskandscale(False)
            yield file
    except _DAMAGE as error:
        raise ArchiveError(f"'{path}' is damaged or no run archive: {error}") from None


def _taken(spec: Iterable[record.Column], block: Block) -> list[tuple[str, Array]]:
    return [(column.variable.name, column.take(block)) for column in spec]


def _attributes_of(variable: Any) -> dict[str, Any]:
    return own_attributes({key: variable.getncattr(key) for key in variable.ncattrs()})
