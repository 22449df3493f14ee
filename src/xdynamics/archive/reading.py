"""Runs from files: opened by any thread, compared with every digest."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.file_structure import inventory
from xdynamics.archive.folder_store import is_zarr, store_of
from xdynamics.archive.integrity import remember_archive
from xdynamics.archive.integrity_checks import DAMAGED, EDITED, Examination, harmed
from xdynamics.archive.netcdf_library import DAMAGE, error_text, opened_file, stored_attributes, with_library_lock
from xdynamics.archive.sandboxed_reading import examine_sandboxed, examine_structure, is_known, is_seen, see
from xdynamics.archive.seals import Tail, tail_of
from xdynamics.archive.shared_handles import MOST_REPLACED, Identity, identity_of, open_shared
from xdynamics.archive.store import Given, LocalFile, Place, location_of
from xdynamics.archive.text_encoding import Form, text_form
from xdynamics.faults import ArchiveError, EditedWarning, InputError, KindWarning, first_names, numbered_lines, warn
from xdynamics.record import faults_of
from xdynamics.record.pint_records import quantified
from xdynamics.record.provenance import xdynamics_version
from xdynamics.record.schemas import is_evidence, kind_description
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import FORMER_SCHEMAS, ROOT_DIGEST, SCHEMA_VERSION, SEALED, is_former

if TYPE_CHECKING:
    import netCDF4
    import xarray as xr


def open_run(
    path: Given | IO[bytes],
    *,
    check: bool = True,
    quantify: bool = False,
    chunks: Mapping[str, int] | int | Literal["auto"] | None = None,
) -> xr.Dataset:
    """Open an archived run, verified; variables are read when they are used, by any thread.

    Parameters
    ----------
    path : str, Path or file object
        A file, a Zarr store, an address like ``"s3://bucket/run.nc"`` or ``"https://host/run.nc"``, whose file is
        downloaded whole to a temporary one first, or a binary file open for reading.
    check : bool
        Whether to compare the file with its seal and its digests first. This reads the whole file: once where this
        process has seen the same bytes before, else twice, the second time in a process of its own, which a
        malicious file may hang or end. Without the check, the objects of an unknown file are still listed, so that no
        link out of it is followed, and a file of a newer schema is read as if it were of this version's.
    quantify : bool
        Whether to return numbers with units in their arrays, by pint-xarray. They are read then, not when they are used.
    chunks : mapping of str to int, or int or "auto", optional
        Whether to return dask arrays, with so many rows in a chunk: ``{"step": 100_000}``; ``{}`` for chunks as they are
        in the file. As ``xarray.open_dataset(path, engine="xdynamics", chunks=…)`` does; `diagnose`, `sample` and `plot`
        read such a run chunk by chunk.

    Raises
    ------
    InputError
        If there is no such file, or it is none: a directory, a pipe, a socket, a device; or chunks cannot be made so.
    ArchiveError
        If the file is damaged or no run archive, or of a schema that this version does not know; names what differs.

    Warns
    -----
    EditedWarning
        If what the record says was changed since it was archived; `save` then takes it as derived data alone.
    """
    location = location_of(path)
    if isinstance(location, Path) and location.suffix.lower() == ".toml" and location.is_file():
        raise InputError(
            f"'{location}' is a model, and a run of it is needed: xdynamics run {location} -o {location.with_suffix('.nc')}, in"
            " Python run = xd.simulate(xd.Model.from_toml(…))"
        )
    run, examination = _open_location(location, check=check)
    run.attrs.pop(SEALED, None)  # describes the file, not the run
    if check:
        try:
            check_schema(run.attrs, location)
        except ArchiveError:
            run.close()
            raise
    edits = examination.faults if examination is not None and examination.verdict == EDITED else ()
    _check_record(run, location, examination)
    if edits:
        warn(f"'{location}' was edited since it was archived: {first_names(edits)}", EditedWarning)
    opened_run = remember_archive(
        run, partial(_reopen_run, location, str(run.attrs.get(ROOT_DIGEST, ""))), edits=edits, texts=check
    )
    opened_run = opened_run if chunks is None else _chunked(opened_run, chunks)
    return quantified(opened_run) if quantify else opened_run


def _open_location(location: Place, *, check: bool) -> tuple[xr.Dataset, Examination | None]:
    """Open an archive, of which a file is compared with its digests now, and a Zarr store as it is read."""
    if not is_zarr(location):
        local_file = _local_archive(location, whole=False)
        return (_open_verified if local_file.partial is None else _open_partial)(local_file, check=check)
    from xdynamics.archive.zarr_archive import open_store, state_faults

    run = open_store(location)
    if check and (faults := state_faults(run, values=False)):
        examination = Examination(tuple(faults), verdict=EDITED)
        examination.raise_faults(location, also_edited=True)
        return run, examination
    return run, None


def _open_partial(local_file: LocalFile, *, check: bool) -> tuple[xr.Dataset, Examination | None]:
    """Open an archive whose chunks are compared with their digests when they are read; return an examination of what is edited."""
    edited = None
    if check:
        examination = examine_structure(local_file.path)
        examination.raise_faults(local_file.location, also_edited=True)
        edited = examination if examination.faults else None
    else:
        _check_objects(local_file)
    try:
        return open_shared(local_file.path, _identity(local_file), local_file), edited
    except DAMAGE as error:
        raise _unreadable(local_file.location, error) from None


def read_columns(path: Given, names: Collection[str]) -> xr.Dataset:
    """Read some variables of an archived run into memory, and its attributes; verified as `open_run` does.

    For many files of which little is wanted each: of one whose bytes are known here nothing else is read.

    Raises
    ------
    InputError, ArchiveError
        As `open_run` does.
    """
    import xarray as xr

    location = location_of(path)
    local_file = None if is_zarr(location) else _local_archive(location, whole=False)
    look = None if local_file is None or local_file.partial is not None else _SealedIdentity.from_file(local_file)
    if local_file is None or look is None or not is_known(look.tail):
        with open_run(path) as run:
            return run[[name for name in names if name in run.variables]].load()
    with opened_file(local_file.path) as file:
        # asked after the opening: the name may have gone to another file since the seal was read
        if _identity(local_file) != look.identity:
            raise ArchiveError(f"'{local_file.location}' was replaced while it was opened; open it again")
        variables = {name: file.variables[name] for name in names if name in file.variables}
        columns = {name: xr.Variable(*_stored_column(variable)) for name, variable in variables.items()}
        return xr.Dataset(columns, attrs=stored_attributes(file))


def _stored_column(variable: netCDF4.Variable[Any]) -> tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]:
    """Return dims, values and attributes of a variable of a run's file; letters as texts."""
    dims, values = variable.dimensions, np.asarray(_all_stored_values(variable))
    if values.dtype == "S1":
        # null letters, which fill up short texts, fall away at the end of numpy's byte strings
        texts = np.ascontiguousarray(values).view(f"S{values.shape[-1]}")[..., 0]
        dims, values = dims[:-1], np.char.decode(texts, "utf-8")
    return dims, values, stored_attributes(variable)


def _chunked(run: xr.Dataset, chunks: Any) -> xr.Dataset:
    """Return a run with dask arrays, each chunk of which is read when it is computed."""
    load_dask_whole()
    sizes = chunks.values() if isinstance(chunks, Mapping) else [chunks]
    if any(size != "auto" and (isinstance(size, bool) or not isinstance(size, int) or size < 1) for size in sizes):
        raise InputError(f"chunks are {chunks!r}, need rows by dimension, like {{'step': 100_000}}, a number or 'auto'")
    if isinstance(chunks, Mapping) and (unknown := [dim for dim in chunks if dim not in run.dims]):
        raise InputError(f"chunks name {unknown[0]!r}; there are {', '.join(map(str, run.dims))}")
    texts = [name for name, variable in run.variables.items() if variable.dtype.kind in "OU"]
    chunk_sizes: Any = _stored_chunks(run.drop_vars(texts)) if chunks == {} else chunks
    chunked = run.drop_vars(texts).chunk(chunk_sizes, inline_array=True)
    return chunked.assign({name: run[name] for name in texts}).set_coords(
        [name for name in texts if name in run.coords]
    )


def _stored_chunks(run: xr.Dataset) -> dict[str, int]:
    """Return the size of a chunk in the file along every dimension; of a coordinate where no variable has one."""
    sizes: dict[str, int] = {}
    for variable in [*run.coords.values(), *run.data_vars.values()]:
        sizes |= {dim: int(size) for dim, size in variable.encoding.get("preferred_chunks", {}).items() if size}
    return sizes


def _local_archive(location: Place, *, whole: bool = True) -> LocalFile:
    """Return an archive as a file of this machine; a large one without its values, unless it is wanted whole."""
    store = store_of(location)
    store.check_source(location)
    return store.local_file(location, whole=whole)


def _open_verified(local_file: LocalFile, *, check: bool) -> tuple[xr.Dataset, Examination | None]:
    """Open a checked file, again if it was replaced meanwhile; return the examination if one was made."""
    for _ in range(MOST_REPLACED):
        identity, examination = _check_digests(local_file) if check else (_check_objects(local_file), None)
        try:
            return open_shared(local_file.path, identity, local_file), examination
        except DAMAGE as error:
            if _identity(local_file) == identity:
                raise _unreadable(local_file.location, error) from None
    raise ArchiveError(
        f"'{local_file.location}' was replaced each time it was opened; try again when nothing replaces it"
    )


def _unreadable(path: Place, error: Exception) -> ArchiveError:
    if isinstance(error, ArchiveError):
        return error
    return ArchiveError(f"'{path}' cannot be opened as a run archive: {error_text(error)}")


def _check_digests(local_file: LocalFile) -> tuple[Identity, Examination | None]:
    """Compare a file with its seal and digests; return its identity, and the examination of unknown bytes."""
    look = _SealedIdentity.from_file(local_file)
    if is_known(look.tail):
        see(look.identity)
        return look.identity, None
    examination, identity = _examine_stable_file(local_file, look)
    examination.raise_faults(local_file.location, also_edited=True)
    return identity, examination


def _check_objects(local_file: LocalFile) -> Identity:
    """Check that a file has no objects that lead out of it, which the netCDF library follows; return its identity."""
    identity = _identity(local_file)
    if not is_seen(identity):
        try:
            objects = inventory(local_file.path)
        except DAMAGE as error:
            raise _unreadable(local_file.location, error) from None
        harmed(*objects.faults).raise_faults(local_file.location)
        see(identity)
    return identity


def _identity(local_file: LocalFile) -> Identity:
    try:
        return identity_of(local_file.path)
    except OSError as error:
        raise ArchiveError(f"'{local_file.location}' cannot be read: {error.strerror or error}") from None


def _reopen_run(path: Place, digest: str) -> xr.Dataset | None:
    """Open a file again, if it still has the record of a digest."""
    try:
        run = open_run(path)
    except InputError:
        return None
    return run if run.attrs[ROOT_DIGEST] == digest else None


def check_schema(
    attributes: Mapping[Any, Any], path: Place, reader: str = "xdynamics.open_run(path, check=False)"
) -> None:
    """Check that a file or store was not written by a version whose records may mean something that is unknown here.

    Parameters
    ----------
    attributes : mapping
    path : Path, or name of an object
    reader : str
        What opens it all the same.

    Raises
    ------
    ArchiveError
    """
    schema = str(attributes.get("schema_version", SCHEMA_VERSION))
    newest_schema = FORMER_SCHEMAS if is_former(attributes) else int(SCHEMA_VERSION)
    if not (schema.isdecimal() and int(schema) <= newest_schema):
        writer = attributes.get("xdynamics_version", "of unknown version")
        raise ArchiveError(
            f"'{path}' has schema {schema}, written by xdynamics {writer}; this is {xdynamics_version()}, which reads schemas"
            f" up to {SCHEMA_VERSION}: install a newer one; {reader} shows the variables as they are"
        )


def _check_record(run: xr.Dataset, path: Place, examination: Examination | None) -> None:
    """Check that a file with correct digests is a run record; another program or version may have written it."""
    try:
        faults = faults_of(run, values=examination is not None)
    except ArchiveError:
        run.close()
        raise
    except DAMAGE as error:
        faults = [error_text(error)]
    if faults:
        run.close()
        verdict = EDITED if examination and examination.verdict == EDITED else ""
        verdict_text = (
            "was edited, and is no run record any more" if verdict else "is as it was written, but no run record"
        )
        raise ArchiveError(f"'{path}' {verdict_text}:{numbered_lines(faults)}", tuple(faults), verdict)


def verify(path: Given) -> Examination:
    """Compare an archive with its digests: the file's bytes, every variable, every attribute.

    Returns
    -------
    Examination
        With the content digest, and the verdict: verified, or repacked.

    Raises
    ------
    InputError
        If there is no such file, or it is none: a directory, a pipe, a socket, a device.
    ArchiveError
        Naming every variable that differs from its digest; its verdict is edited or damaged.

    Warns
    -----
    KindWarning
        If the file is as it was written, and holds a selection of a run or derived data.
    """
    examination = verify_digests(location_of(path))
    with open_run(path, check=False) as run:
        kind = "" if is_evidence(run.attrs) else kind_description(run.attrs)
    if kind:
        warn(f"'{path}' is as it was written, and is {kind}", KindWarning)
    return examination


def verify_digests(location: Place) -> Examination:
    """Compare with the digests alone; see `verify`."""
    if is_zarr(location):
        from xdynamics.archive.zarr_archive import examine_store

        examination = examine_store(location)
        examination.raise_faults(location)
        return examination
    examination = _examine_stable_file(_local_archive(location))[0]
    examination.raise_faults(location)
    return examination


def read_values(location: Place) -> dict[str, NDArray[Any]]:
    """Read the values of a file that was written and checked here; texts as bytes, in a quarter of the memory."""
    return {name: values for name, (values, _) in read_forms(location).items()}


def read_forms(location: Place, names: Collection[str] | None = None) -> dict[str, tuple[NDArray[Any], Form | None]]:
    """Read the values of a file's variables as `read_values` does, with the form in which it keeps texts as numbers."""
    values_by_name, local_file = {}, _local_archive(location)
    with opened_file(local_file.path) as file:
        for name, variable in file.variables.items():
            if names is not None and name not in names:
                continue
            values, about = np.asarray(_all_stored_values(variable)), stored_attributes(variable)
            form = text_form(about, values.dtype, variable.dimensions, values.shape)
            letters = form.letters(values) if form else values
            is_text = letters.dtype == "S1"
            texts = np.ascontiguousarray(letters).view(f"S{letters.shape[-1]}")[..., 0] if is_text else values
            values_by_name[name] = texts, form
    return values_by_name


@with_library_lock
def _all_stored_values(variable: netCDF4.Variable[Any]) -> Any:
    variable.set_auto_chartostring(False)
    return variable[...]


@dataclass(frozen=True)
class _SealedIdentity:
    """The identity of the file at a path, and its seal, for which every byte was read."""

    identity: Identity
    tail: Tail

    @classmethod
    def from_file(cls, local_file: LocalFile) -> _SealedIdentity:
        identity = _identity(local_file)
        try:
            return cls(identity, tail_of(local_file.path))
        except OSError as error:
            raise ArchiveError(f"'{local_file.location}' cannot be read: {error.strerror or error}") from None


def _examine_stable_file(local_file: LocalFile, look: _SealedIdentity | None = None) -> tuple[Examination, Identity]:
    """Compare a file with its seal and digests, again if another file took its name meanwhile.

    The identity of the file is returned too.
    """
    for _ in range(MOST_REPLACED):
        look = look or _SealedIdentity.from_file(local_file)
        examination = examine_sandboxed(local_file.path, look.tail)
        identity = look.identity
        # seal and values may have been read from two files: a fault counts only if it was one
        if not examination.faults or identity_of(local_file.path) == identity:
            break
        look = None
    if examination.verdict != DAMAGED:
        see(identity)
    return examination, identity
