"""Runs from files: opened by any thread, compared with every digest."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.integrity_checks import DAMAGED, EDITED, Examination, harmed
from xdynamics.archive.inventory import inventory
from xdynamics.archive.netcdf_library import DAMAGE, alone, attributes, opened, words_of
from xdynamics.archive.origin import read
from xdynamics.archive.place import Given, Place, placed
from xdynamics.archive.sandboxed_reading import examined, is_known, is_seen, see
from xdynamics.archive.seals import Tail, tail_of
from xdynamics.archive.shared_handles import MOST_REPLACED, Identity, identity_of, lent
from xdynamics.archive.store import Held
from xdynamics.archive.stores import store_of
from xdynamics.archive.text_encoding import form_of
from xdynamics.faults import ArchiveError, EditedWarning, InputError, KindWarning, few, numbered, warn
from xdynamics.record import faults_of
from xdynamics.record.circumstances import xdynamics_version
from xdynamics.record.partial_records import is_evidence, kind_description
from xdynamics.record.pint_records import quantified
from xdynamics.runtime.lazy_imports import load_dask_whole
from xdynamics.schema import FORMER_SCHEMAS, ROOT_DIGEST, SCHEMA_VERSION, SEALED, is_former

if TYPE_CHECKING:
    import netCDF4
    import xarray as xr


def open_run(
    path: Given,
    *,
    check: bool = True,
    quantify: bool = False,
    chunks: Mapping[str, int] | int | Literal["auto"] | None = None,
) -> xr.Dataset:
    """Open an archived run, verified; variables are read when they are used, by any thread.

    Parameters
    ----------
    path : str or Path
        A file, or an object like ``"s3://bucket/run.nc"``, which is downloaded whole to a temporary file first.
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
    place = placed(path)
    run, examination = _opened(_held(place), check=check)
    run.attrs.pop(SEALED, None)  # describes the file, not the run
    if check:
        try:
            check_schema(run.attrs, place)
        except ArchiveError:
            run.close()
            raise
    edits = examination.faults if examination is not None and examination.verdict == EDITED else ()
    _check_record(run, place, examination)
    if edits:
        warn(f"'{place}' was edited since it was archived: {few(edits)}", EditedWarning)
    result = read(run, partial(_again, place, str(run.attrs.get(ROOT_DIGEST, ""))), edits=edits, texts=check)
    result = result if chunks is None else _chunked(result, chunks)
    return quantified(result) if quantify else result


def columns_of(path: Given, names: Collection[str]) -> xr.Dataset:
    """Read some variables of an archived run into memory, and its attributes; verified as `open_run` does.

    For many files of which little is wanted each: of one whose bytes are known here nothing else is read.

    Raises
    ------
    InputError, ArchiveError
        As `open_run` does.
    """
    import xarray as xr

    held = _held(placed(path))
    look = _Look.at(held)
    if not is_known(look.tail):
        with open_run(path) as run:
            return run[[name for name in names if name in run.variables]].load()
    with opened(held.path) as file:
        if _identity(held) != look.identity:
            raise ArchiveError(f"'{held.place}' was replaced while it was opened; open it again")
        variables = {name: file.variables[name] for name in names if name in file.variables}
        columns = {name: xr.Variable(*_column(variable)) for name, variable in variables.items()}
        return xr.Dataset(columns, attrs=attributes(file))


def _column(variable: netCDF4.Variable[Any]) -> tuple[tuple[str, ...], NDArray[Any], dict[str, Any]]:
    """Return dims, values and attributes of a variable of a run's file; letters as texts."""
    dims, values = variable.dimensions, np.asarray(_stored(variable))
    if values.dtype == "S1":
        texts = np.ascontiguousarray(values).view(f"S{values.shape[-1]}")[..., 0]
        dims, values = dims[:-1], np.char.decode(texts, "utf-8")
    return dims, values, attributes(variable)


def _chunked(run: xr.Dataset, chunks: Any) -> xr.Dataset:
    """Return a run with dask arrays, each chunk of which is read when it is computed."""
    load_dask_whole()
    sizes = chunks.values() if isinstance(chunks, Mapping) else [chunks]
    if any(size != "auto" and (isinstance(size, bool) or not isinstance(size, int) or size < 1) for size in sizes):
        raise InputError(f"chunks are {chunks!r}, need rows by dimension, like {{'step': 100_000}}, a number or 'auto'")
    if isinstance(chunks, Mapping) and (unknown := [dim for dim in chunks if dim not in run.dims]):
        raise InputError(f"chunks name {unknown[0]!r}; there are {', '.join(map(str, run.dims))}")
    wanted: Any = _stored_chunks(run) if chunks == {} else chunks
    texts = [name for name, variable in run.variables.items() if variable.dtype.kind in "OU"]
    return run.drop_vars(texts).chunk(wanted, inline_array=True).assign_coords({name: run[name] for name in texts})


def _stored_chunks(run: xr.Dataset) -> dict[str, int]:
    """Return the size of a chunk in the file along every dimension."""
    sizes: dict[str, int] = {}
    for variable in run.variables.values():
        sizes |= {dim: int(size) for dim, size in variable.encoding.get("preferred_chunks", {}).items() if size}
    return sizes


def _held(place: Place) -> Held:
    """Return an archive as a file of this machine."""
    store = store_of(place)
    store.check_source(place)
    return store.held(place)


def _opened(held: Held, *, check: bool) -> tuple[xr.Dataset, Examination | None]:
    """Check a file and open the same one, again if its name went to another meanwhile; return what was found, if it was unknown."""
    for _ in range(MOST_REPLACED):
        identity, examination = _checked(held) if check else (_listed(held), None)
        try:
            return lent(held.path, identity, held), examination
        except DAMAGE as error:
            if _identity(held) == identity:
                raise _unreadable(held.place, error) from None
    raise ArchiveError(f"'{held.place}' was replaced each time it was opened; try again when nothing replaces it")


def _unreadable(path: Place, error: Exception) -> ArchiveError:
    if isinstance(error, ArchiveError):
        return error
    return ArchiveError(f"'{path}' cannot be opened as a run archive: {words_of(error)}")


def _checked(held: Held) -> tuple[Identity, Examination | None]:
    """Compare a file with its seal and digests; return its identity, and what was found if its bytes were unknown here."""
    look = _Look.at(held)
    if is_known(look.tail):
        see(look.identity)
        return look.identity, None
    examination, identity = _examined(held, look)
    examination.settle(held.place, also_edited=True)
    return identity, examination


def _listed(held: Held) -> Identity:
    """Check that a file has no objects that lead out of it, which the netCDF library follows; return its identity."""
    identity = _identity(held)
    if not is_seen(identity):
        try:
            objects = inventory(held.path)
        except DAMAGE as error:
            raise _unreadable(held.place, error) from None
        harmed(*objects.faults).settle(held.place)
        see(identity)
    return identity


def _identity(held: Held) -> Identity:
    try:
        return identity_of(held.path)
    except OSError as error:
        raise ArchiveError(f"'{held.place}' cannot be read: {error.strerror or error}") from None


def _again(path: Place, digest: str) -> xr.Dataset | None:
    """Open a file again, if it still holds the same record."""
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
    known = FORMER_SCHEMAS if is_former(attributes) else int(SCHEMA_VERSION)
    if not (schema.isdecimal() and int(schema) <= known):
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
        faults = [words_of(error)]
    if faults:
        run.close()
        verdict = EDITED if examination and examination.verdict == EDITED else ""
        said = "was edited, and is no run record any more" if verdict else "is as it was written, but no run record"
        raise ArchiveError(f"'{path}' {said}:{numbered(faults)}", tuple(faults), verdict)


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
    examination = verified(placed(path))
    with open_run(path, check=False) as run:
        kind = "" if is_evidence(run.attrs) else kind_description(run.attrs)
    if kind:
        warn(f"'{path}' is as it was written, and is {kind}", KindWarning)
    return examination


def verified(place: Place) -> Examination:
    """Compare with the digests alone; see `verify`."""
    examination = _examined(_held(place))[0]
    examination.settle(place)
    return examination


def values_of(place: Place) -> dict[str, NDArray[Any]]:
    """Read the values of a file that was written and checked here; texts as bytes, in a quarter of the memory."""
    values_by_name, held = {}, _held(place)
    with opened(held.path) as file:
        for name, variable in file.variables.items():
            values, about = np.asarray(_stored(variable)), attributes(variable)
            form = form_of(about, values.dtype, variable.dimensions, values.shape)
            letters = form.letters(values) if form else values
            is_text = letters.dtype == "S1"
            values_by_name[name] = (
                np.ascontiguousarray(letters).view(f"S{letters.shape[-1]}")[..., 0] if is_text else values
            )
    return values_by_name


@alone
def _stored(variable: netCDF4.Variable[Any]) -> Any:
    variable.set_auto_chartostring(False)
    return variable[...]


@dataclass(frozen=True)
class _Look:
    """The identity of the file at a path, and its seal, for which every byte was read."""

    identity: Identity
    tail: Tail

    @classmethod
    def at(cls, held: Held) -> _Look:
        identity = _identity(held)
        try:
            return cls(identity, tail_of(held.path))
        except OSError as error:
            raise ArchiveError(f"'{held.place}' cannot be read: {error.strerror or error}") from None


def _examined(held: Held, look: _Look | None = None) -> tuple[Examination, Identity]:
    """Compare a file with its seal and digests, again if another file took its name meanwhile.

    The identity of the file is returned too.
    """
    for _ in range(MOST_REPLACED):
        look = look or _Look.at(held)
        examination = examined(held.path, look.tail)
        identity = look.identity
        if not examination.faults or identity_of(held.path) == identity:
            break
        look = None
    if examination.verdict != DAMAGED:
        see(identity)
    return examination, identity
