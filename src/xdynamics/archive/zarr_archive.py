"""Records as Zarr stores, written by xarray: each is replaced whole, and each of its files is compared when it is read.

The folder `.xdynamics` of a store has the digest of every file. Files that are to replace those of a store are written
into a folder of it, and their digests last, which is the moment at which readers here see them: a reader looks for a
file there first, then in the store. Then the files are moved into the store. So a process that is killed leaves the old
record or the new one, and whoever writes next completes the moves.
"""

from __future__ import annotations

import json
import re
import secrets
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from functools import lru_cache
from hashlib import sha256
from itertools import product
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics import schema
from xdynamics.archive.folder_store import (
    check_zarr_target,
    is_folder,
    made_folder,
    store_of,
    taking_name,
    zarr_package,
)
from xdynamics.archive.integrity import variable_digest
from xdynamics.archive.integrity_checks import DAMAGED, EDITED, Examination
from xdynamics.archive.seals import digest_lines, digests_in, root_digest, volatile_digest
from xdynamics.archive.shared_handles import LAZY, open_shared
from xdynamics.archive.store import DIGESTS, METADATA, NOTES, READABLE, Address, LockedError, Place
from xdynamics.archive.text_encoding import text_form
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.record.flag_words import own_attributes
from xdynamics.runtime.files import is_inside
from xdynamics.runtime.lazy_imports import load_dask_whole

if TYPE_CHECKING:
    import xarray as xr

    from xdynamics.archive.compared_store import ComparedStore, FileDigest

KIND = "xdynamics files 1"
SEAL_WORDS = f"{NOTES}/{DIGESTS} has the sha256 of every file of this store"
MOST_DIGESTS, MOST_METADATA = 200_000_000, 64_000_000  # bytes of the digests, and of the metadata
LARGEST_CHUNK = 1 << 29  # bytes of a chunk in memory, at 8 an item
_REPLACEMENT = re.compile("[0-9a-f]{16}")  # the name of a folder with files that replace those of a store
_KEY = re.compile(r"[^/\\\x00-\x1f]+(/[^/\\\x00-\x1f]+)*")
_TYPES = re.compile(r"bool|string|float(32|64)|u?int(8|16|32|64)")
_CODECS = (["bytes"], ["bytes", "zstd"], ["vlen-utf8"])
# what is raised where digests or metadata are none
_DAMAGE = (ValueError, LookupError, TypeError, AttributeError, RecursionError, OverflowError, MemoryError)


_quiet = threading.RLock()


@contextmanager
def quietly() -> Iterator[None]:
    """Write all chunks, and leave out zarr's notes that texts and metadata in one file are none of the format's specification yet.

    One thread at a time: filters of warnings and zarr's settings are those of the process.
    """
    with _quiet, warnings.catch_warnings(), zarr_package().config.set({"array.write_empty_chunks": True}):
        warnings.simplefilter("ignore")
        yield


@contextmanager
def replacement(location: Place) -> Iterator[Path]:
    """Lend a folder of this machine, whose files replace those of a store when the `with` block is done.

    Raises
    ------
    InputError
        If another process writes there, or it holds what is no record's store.
    ArchiveError
        If it cannot be written; nothing is changed there.
    """
    check_zarr_target(location)
    store, notes, seen = store_of(location), made_folder(made_folder(location) / NOTES), False
    try:
        with store.locked(notes):
            if store.kind(notes / METADATA) == "":  # else zarr warns of a folder that is none of its own
                with taking_name(notes / METADATA) as new:
                    new.part.write_text(json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {}}))
            _complete_moves(location)
            work = notes / secrets.token_hex(8)
            try:
                with store.filled_folder(work) as folder:
                    yield folder
                    digests = _digests_of(folder)
                with taking_name(work / DIGESTS) as new:  # from here on readers see the files
                    new.part.write_text(digests)
                seen = True
                _complete_moves(location)
            finally:
                if store.kind(work / DIGESTS) == "":
                    store.remove_folder(work)
    except LockedError as error:
        raise InputError(f"another process writes '{location}'; wait for it, or name another place ({error})") from None
    except OSError as error:
        reason = error.strerror or str(error)
        if seen:
            raise ArchiveError(
                f"'{location}' is written, and its files could not all be moved into place: {reason}; xdynamics reads it all"
                " the same, and writing it again completes that"
            ) from error
        raise ArchiveError(f"'{location}' cannot be written: {reason}; nothing is changed there") from error


def _digests_of(folder: Path) -> str:
    """Return the text that lists the files of a folder, with their bytes and digests."""
    entries = {
        entry.relative_to(folder).as_posix(): f"{entry.stat().st_size} {sha256(entry.read_bytes()).hexdigest()}"
        for entry in sorted(folder.rglob("*"))
        if entry.is_file()
    }
    return json.dumps({"kind": KIND, "files": entries}, indent=0)


def _complete_moves(location: Place) -> None:
    """Move the files of whole replacements into the store, and remove what is of none."""
    store, notes = store_of(location), location / NOTES
    for work in store.names(notes):
        if not _REPLACEMENT.fullmatch(work.name) or not is_folder(work):
            continue
        content, files = _known_files(work)
        if files:
            for key in {*_known_files(notes)[1]} - {
                *files
            }:  # first: a file may stand where a folder is to be, or the other way round
                with suppress(ArchiveError, OSError):
                    _remove_file(location, key)
            store.move([*files], work, location)
            with taking_name(notes / DIGESTS) as new:
                new.part.write_bytes(content)
        store.remove_folder(work)


def _remove_file(location: Place, key: str) -> None:
    """Remove a file of a store, and the folders in it that are empty then."""
    if isinstance(location, Address):
        store_of(location).remove(location / key)
    elif is_inside(path := location / key, location):
        path.unlink()
        for folder in [*path.relative_to(location).parents][:-1]:
            (location / folder).rmdir()


def complete_replacement(location: Place) -> None:
    """Complete what a process began that was stopped while it moved files into a store."""
    notes = location / NOTES
    if any(_REPLACEMENT.fullmatch(work.name) for work in store_of(location).names(notes)):
        with suppress(LockedError), store_of(location).locked(notes):  # else another process does it
            _complete_moves(location)


def _known_files(folder: Place) -> tuple[bytes, dict[str, FileDigest]]:
    """Return the text of the digests that are in a folder, and what it says; nothing where there are none, or damaged ones."""
    with suppress(*_DAMAGE, OSError):
        content = store_of(folder).content(folder / DIGESTS, MOST_DIGESTS)
        return content, _files_of(content)
    return b"", {}


def _files_of(content: bytes) -> dict[str, FileDigest]:
    """Return the digests of a store's files.

    Raises
    ------
    ArchiveError
        If they are of a version that is unknown here.
    ValueError, LookupError, TypeError, AttributeError
        If they are damaged, or name files elsewhere.
    """
    from xdynamics.archive.compared_store import FileDigest

    document = json.loads(content)
    if document.get("kind") != KIND:
        kind = "a sweep of version 0.2" if "sweep" in document else f"'{str(document.get('kind'))[:60]}'"
        raise ArchiveError(f"its digests are those of {kind}, and not of this version's '{KIND}'; write it again")
    files = {}
    for key, text in document["files"].items():
        if not _KEY.fullmatch(key) or {".", ".."} & {*key.split("/")}:
            raise ValueError(f"{key[:60]!r} is no file of a store")
        size, digest = text.split(" ")
        files[key] = FileDigest(int(size), digest)
        if files[key].size < 0:
            raise ValueError(f"{key[:60]!r} has {size} bytes")
    return files


def copy_archive(part: Path, folder: Path) -> None:
    """Write the variables of an archive, as they are stored, into an empty folder as a Zarr store."""
    if is_large := part.stat().st_size > LAZY:  # its variables are dask arrays
        load_dask_whole()
    with open_shared(part, as_stored=True) as archive:
        stored = archive.assign_attrs({schema.SEALED: SEAL_WORDS})
        chunks = {
            name: tuple(variable.encoding.get("chunksizes") or variable.shape)
            for name, variable in stored.variables.items()
        }
        stored.attrs[schema.VOLATILE_DIGEST] = volatile_digest(
            digests_in(stored.attrs), _own_attributes(stored), stored.attrs
        )
        with _in_this_thread() if is_large else nullcontext():
            create_store(stored, folder, chunks, compresses=schema.COMPRESSION in archive.attrs, compute=True)


def _in_this_thread() -> Any:
    import dask

    return dask.config.set(scheduler="synchronous")


def create_store(
    record: xr.Dataset,
    folder: Path,
    chunks: Mapping[Any, tuple[int, ...]],
    *,
    compresses: bool = True,
    compute: bool = False,
) -> None:
    """Write a record into an empty folder; without `compute` the values of dask arrays are left out, for `region_writer`.

    Parameters
    ----------
    record : xarray.Dataset
    folder : Path
    chunks : mapping of str to tuple of int
        The shape of a variable's chunks.
    compresses : bool
    compute : bool
    """
    # texts of any length: those of numpy's width are none of the format's specification
    texts = {name: text.astype(object) for name, text in record.variables.items() if text.dtype.kind in "US"}
    stored, encodings = record.assign(texts), dict[Any, dict[str, Any]]()
    stored.attrs = {name: _json_value(value) for name, value in record.attrs.items()}
    for name, variable in stored.variables.items():
        variable.encoding = {}
        variable.attrs = {key: _json_value(value) for key, value in variable.attrs.items()}
        sizes = chunks.get(name, variable.shape)
        encodings[name] = {"_FillValue": None}
        if variable.ndim:
            encodings[name]["chunks"] = tuple(max(1, min(pair)) for pair in zip(sizes, variable.shape, strict=False))
        if not compresses or variable.dtype.kind == "O":
            encodings[name]["compressors"] = None
    write: Any = stored.to_zarr
    with quietly():
        write(str(folder), mode="w", zarr_format=3, consolidated=True, encoding=encodings, compute=compute)


@contextmanager
def region_writer(folder: Path) -> Iterator[Callable[[str, tuple[slice, ...], Any], None]]:
    """Lend a function that writes a part of an array of a store, by its name and the extents of its first dimensions."""
    with quietly():
        arrays = zarr_package().open_group(str(folder), mode="r+")
        opened = {name: arrays[name] for name in arrays.array_keys()}

        def write(name: str, extents: tuple[slice, ...], values: Any) -> None:
            opened[name][extents] = values

        yield write


def seal_record(folder: Path) -> None:
    """Write the digests of a store's variables and attributes into its attributes, once all values are there."""
    zarr = zarr_package()
    with _opened(str(folder)) as record:
        digests = {str(name): variable_digest(str(name), variable) for name, variable in record.variables.items()}
        attributes = dict(record.attrs) | {schema.SEALED: SEAL_WORDS}
        attributes[schema.DIGESTS] = digest_lines(digests)
        attributes[schema.ROOT_DIGEST] = root_digest(digests, _own_attributes(record), attributes)
        attributes[schema.VOLATILE_DIGEST] = volatile_digest(digests, _own_attributes(record), attributes)
    with quietly():
        zarr.open_group(str(folder), mode="r+").attrs.update(
            {name: _json_value(value) for name, value in attributes.items()}
        )
        zarr.consolidate_metadata(str(folder))


def _own_attributes(record: xr.Dataset) -> dict[str, dict[str, Any]]:
    return {str(name): own_attributes(variable.attrs) for name, variable in record.variables.items()}


def _json_value(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def compared_store(location: Place) -> ComparedStore:
    """Return the files of a store, as its digests say; nothing but digests and metadata is read.

    Raises
    ------
    InputError
        If there is none, or it holds no record.
    ArchiveError
        If its digests or metadata are damaged, or no archive has such.
    """
    zarr_package()
    from xdynamics.archive.compared_store import ComparedStore, chunk_form

    content, folders = _current_digests(location)
    try:
        files = _files_of(content)
        size = files[METADATA].size
        metadata = (
            ComparedStore(location, folders, files, {}, _reopened).read(METADATA) if size <= MOST_METADATA else b"{}"
        )
        arrays = json.loads(metadata)["consolidated_metadata"]["metadata"]
        faults = [fault for name, array in arrays.items() for fault in _array_faults(name, array, files)]
        forms = {name: chunk_form(array) for name, array in arrays.items()} if not faults else {}
    except ArchiveError as error:
        raise error if error.faults else ArchiveError(f"'{location}' cannot be opened: {error}") from None
    except _DAMAGE as error:
        raise _unreadable(location, error) from None
    if faults:
        raise ArchiveError(
            f"'{location}' is damaged or no run archive:{numbered_lines(faults[:20])}", tuple(faults), DAMAGED
        )
    return ComparedStore(location, folders, files, forms, _reopened)


@lru_cache(maxsize=8)
def _reopened(location: Place, identity: str) -> ComparedStore:
    """Return a store in another process; an error if it is not the one that was opened."""
    store = compared_store(location)
    if store.identity != identity:
        raise ArchiveError(f"'{location}' is another store than the one that was opened; open it again")
    return store


def _unreadable(location: Any, error: BaseException) -> ArchiveError:
    return ArchiveError(
        f"'{location}' is damaged or no run archive: its digests or metadata cannot be read"
        f" ({type(error).__name__}: {str(error)[:120]})"
    )


def _current_digests(location: Place) -> tuple[bytes, tuple[Place, ...]]:
    """Return the digests of the files that readers are to see, and the folders in which these files are."""
    store, notes = store_of(location), location / NOTES
    is_web = isinstance(location, Address) and location.scheme in READABLE  # where folders are not listed
    replacements = [] if is_web else [work for work in store.names(notes) if _REPLACEMENT.fullmatch(work.name)]
    for work in replacements:
        if store.kind(work / DIGESTS) is None:
            return store.content(work / DIGESTS, MOST_DIGESTS), (work, location)
    try:
        return store.content(notes / DIGESTS, MOST_DIGESTS), (location,)
    except (InputError, OSError) as error:
        if isinstance(error, ArchiveError) or store.kind(notes / DIGESTS) != "":
            raise ArchiveError(f"'{notes / DIGESTS}' cannot be read: {error}") from None
    if store.kind(location) == "":
        raise InputError(f"'{location}' does not exist")
    if replacements:
        raise InputError(f"'{location}' is not complete: a process is writing it, or was stopped; write it again")
    raise InputError(
        f"'{location}' holds no record: there is no '{NOTES}/{DIGESTS}' in it, with the digests of its files; xarray.open_zarr"
        " shows what another program wrote, and xd.save(run, 'run.zarr') writes a record"
    )


def _array_faults(name: str, array: Mapping[str, Any], files: Mapping[str, Any]) -> Iterator[str]:
    """Describe what no array of an archive has; nothing is allocated for what it declares."""
    shape, grid = array["shape"], array["chunk_grid"]
    codecs = [codec["name"] for codec in array["codecs"]]
    little = all(codec.get("configuration", {}).get("endian", "little") == "little" for codec in array["codecs"])
    if codecs not in _CODECS or not little:
        yield f"array '{name}' is packed by {str(array['codecs'])[:90]}, which no archive is"
        return
    if not _TYPES.fullmatch(str(array["data_type"])) or array.get("storage_transformers") or grid["name"] != "regular":
        yield f"array '{name}' is of the type {str(array['data_type'])[:60]!r}, or cut otherwise than an archive's"
        return
    chunk_shape = grid["configuration"]["chunk_shape"]
    if len(chunk_shape) != len(shape) or not all(isinstance(n, int) and n >= 0 for n in (*shape, *chunk_shape)):
        yield f"array '{name}' has the chunks {str(chunk_shape)[:60]} for the shape {str(shape)[:60]}"
        return
    if 8 * prod(chunk_shape) > LARGEST_CHUNK:
        yield f"a chunk of array '{name}' declares {prod(chunk_shape)} items, {LARGEST_CHUNK // 8} are the most"
        return
    key_form = array["chunk_key_encoding"]
    if key_form["name"] != "default" or key_form.get("configuration", {}).get("separator", "/") != "/":
        yield f"chunks of array '{name}' have other names than an archive's"
        return
    counts = [-(-n // max(1, width)) for n, width in zip(shape, chunk_shape, strict=True)]
    prefix = f"{name}/c"
    stored = sum(key.startswith(f"{prefix}/") or key == prefix for key in files) if prod(counts) < len(files) + 1 else 0
    if prod(counts) != stored:
        yield f"array '{name}' declares {prod(counts)} chunks, and there are digests of {stored}"
    elif any("/".join([prefix, *map(str, index)]) not in files for index in product(*map(range, counts))):
        yield f"chunks of array '{name}' are not those of its shape {shape}"


def open_store(location: Place) -> xr.Dataset:
    """Open the record of a store, lazily, as `open_run` gives it: texts as they were; values are compared as they are read.

    Raises
    ------
    InputError, ArchiveError
        As `compared_store`.
    """
    record = _opened(compared_store(location.absolute()))
    record.encoding["source"] = str(location)
    return record


def _opened(store: Any) -> xr.Dataset:
    import xarray as xr
    from xarray.core import indexing

    from xdynamics.archive.stored_values import Texts, VariableValues

    try:
        with quietly():
            stored = xr.open_dataset(
                store, engine="zarr", consolidated=True, decode_times=False, mask_and_scale=False, chunks=None
            )
    except ArchiveError:
        raise
    except _DAMAGE as error:
        raise _unreadable(store, error) from None
    stored.attrs = _as_arrays(stored.attrs)
    variables = {}
    for name in dict.fromkeys([*digests_in(stored.attrs), *stored.variables]):
        if name not in stored.variables:
            continue
        variable = stored.variables[name]
        attributes, dims = _as_arrays(variable.attrs, variable.dtype), variable.dims
        values: Any = VariableValues(f"'{name}' of '{store}'", variable)
        form = text_form(attributes, variable.dtype, tuple(map(str, dims)), variable.shape)
        if form is not None:
            values, attributes = Texts(values, form), own_attributes(attributes)
        lazy: Any = indexing.LazilyIndexedArray(values)
        if variable.dtype.kind in "OT":
            lazy = np.array(values[indexing.BasicIndexer((slice(None),) * variable.ndim)].tolist(), str)
        variables[name] = xr.Variable(dims[: lazy.ndim], lazy, attributes, variable.encoding)
    coordinates = [name for name in stored.coords if name in variables]
    return xr.Dataset(variables, attrs=stored.attrs).set_coords(coordinates)


def _as_arrays(attributes: Mapping[Any, Any], dtype: Any = None) -> dict[Any, Any]:
    """Return attributes with arrays of numbers, which Zarr keeps as lists."""
    return {
        name: np.array(value, dtype if name in schema.FLAG_ATTRIBUTES else None)
        if isinstance(value, list)
        else np.uint64(value)
        if isinstance(value, int) and value > np.iinfo(np.int64).max
        else value
        for name, value in attributes.items()
    }


def state_faults(record: xr.Dataset, *, values: bool) -> list[str]:
    """Compare a record with the digests in its attributes: attributes alone, or all values, too."""
    stated, faults = digests_in(record.attrs), []
    if values:
        faults = [
            f"variable '{name}' differs from its digest"
            for name, variable in record.variables.items()
            if variable_digest(str(name), variable) != stated.get(str(name))
        ]
    attributes = _own_attributes(record)
    faults += [f"variable '{name}' is missing, of which there is a digest" for name in stated if name not in attributes]
    faults += [f"variable '{name}' has no digest" for name in attributes if name not in stated]
    if not faults:
        if root_digest(stated, attributes, record.attrs) != record.attrs.get(schema.ROOT_DIGEST):
            faults.append("the attributes differ from the content digest")
        if volatile_digest(stated, attributes, record.attrs) != record.attrs.get(schema.VOLATILE_DIGEST):
            faults.append("the attributes on date, versions and machine differ from their digest")
    return faults


def examine_store(location: Place) -> Examination:
    """Read a store completely, and compare every file, variable and attribute with its digest."""
    store = compared_store(location.absolute())
    with _opened(store) as record:
        try:
            for key in store.files:  # values are read below
                if key.endswith(METADATA):
                    store.read(key)
            faults, verdict = state_faults(record, values=True), EDITED
        except ArchiveError as error:
            faults, verdict = _file_faults(store) or [str(error)], DAMAGED
        attributes = dict(record.attrs)
    if not faults:
        return Examination((), str(attributes[schema.ROOT_DIGEST]), str(attributes.get("run_outcome", "")))
    return Examination(tuple(faults), str(attributes.get(schema.ROOT_DIGEST, "")), verdict=verdict)


def _file_faults(store: ComparedStore) -> list[str]:
    """Name every file of a store that differs from its digest."""
    faults: list[str] = []
    for key in store.files:
        try:
            store.read(key)
        except ArchiveError as error:
            faults += error.faults or (str(error),)
    return faults
