"""A sweep in a Zarr store, whose chunks are blocks of members: marched, opened lazily, extended along its axes.

Each block is written by the worker that marched it. Plain ``xarray.open_zarr`` opens the store lazily, with units and
labels: outcomes are flags, digests bytes. `open_zarr_sweep` gives the sweep as it was before it was stored, with words
and digests. The folder `.xdynamics` beside the arrays has the digests of their chunks; a block without one is not
finished.

Members may be added behind the last values of an axis; stored members stay where they are. While new members are
marched, the store's own metadata state the old sizes, so that a reader sees the old sweep. Chunks behind these sizes
are seen by no reader. A chunk that was filled in part is replaced by one with the same members and those that follow.
At the end the metadata are replaced, and with them the sweep.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.folder_store import made_folder, store_of, taking_name
from xdynamics.archive.reading import check_schema
from xdynamics.archive.store import Place, location_of
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.record.folding import labelled, unlabelled
from xdynamics.schema import EVIDENCE, ORIGIN, ROOT_DIGEST, SWEEP
from xdynamics.sweeping.additions import NONE, Additions, existing_additions
from xdynamics.sweeping.collection import DIGEST, sweep_dataset, with_axes
from xdynamics.sweeping.kept_quantities import OUTCOME, STOPPED_BY
from xdynamics.sweeping.members import Plan
from xdynamics.sweeping.tasks import Chunks, blocks_of
from xdynamics.sweeping.zarr_blocks import (
    CUT,
    DIGESTS,
    HEXADECIMAL,
    MAX_BYTES,
    MEANINGS,
    MEMBER_ARRAYS,
    METADATA,
    NOTE,
    NOTES,
    TOML,
    Progress,
    ZarrTarget,
    array_form,
    arrays_in,
    block_name,
    facts_of,
    growth_folders,
    lock_folder,
    march_blocks,
    quietly,
    saved_or_new_chunks,
    sweep_content_digest,
    synchronise,
    verify_arrays,
    write_digests,
    zarr_package,
)

if TYPE_CHECKING:
    import xarray as xr

Values = NDArray[Any]


def open_zarr_sweep(folder: Place) -> xr.Dataset:
    """Open a sweep lazily: chunks are read when they are used; `verified` compares them with their digests.

    Raises
    ------
    ArchiveError
        If the folder holds no sweep, or one of a newer schema.
    """
    import xarray as xr

    zarr_package()
    facts = facts_of(folder)
    stored = xr.open_zarr(str(folder), consolidated=True, mask_and_scale=False, decode_times=False)
    check_schema(stored.attrs, folder, "xarray.open_zarr")
    sweep = stored.assign(
        {name: _as_texts(stored[name]) for name in (OUTCOME, STOPPED_BY, *HEXADECIMAL) if name in stored}
    )
    words = {name: entry for name, entry in sweep.variables.items() if entry.dtype.kind not in "biufU"}
    sweep = sweep.assign(
        {name: (entry.dims, np.array(entry.values.tolist(), str), entry.attrs) for name, entry in words.items()}
    )
    sweep[TOML] = ((), str(stored.attrs[TOML]), {"units": "1", "long_name": "the model that members share, as TOML"})
    sweep.attrs = {name: value for name, value in stored.attrs.items() if name not in (TOML, MEMBER_ARRAYS)}
    sweep.attrs[ROOT_DIGEST] = sweep_content_digest(facts)
    if sweep.attrs.get(EVIDENCE) != SWEEP:
        raise ArchiveError(f"'{folder}' is no sweep")
    sweep = with_axes(labelled(sweep))
    sweep.encoding["source"] = str(folder.absolute() / METADATA)
    return sweep


def _as_texts(numbers: xr.DataArray) -> xr.Variable:
    """Return flags and bytes as texts, lazily."""
    import xarray as xr

    attributes = {
        name: value for name, value in numbers.attrs.items() if name not in ("flag_values", MEANINGS, "encoded")
    }
    data: Any = numbers.data
    if MEANINGS in numbers.attrs:
        words = np.array([*str(numbers.attrs[MEANINGS]).split(), ""])
        return xr.Variable(numbers.dims, data.map_blocks(words.__getitem__, dtype=words.dtype), attributes)
    prefix, suffix = HEXADECIMAL[str(numbers.name)]
    dtype = f"U{2 * numbers.shape[-1] + len(prefix) + len(suffix)}"
    texts = data.map_blocks(
        partial(_hexadecimal, prefix=prefix, suffix=suffix), dtype=dtype, drop_axis=numbers.ndim - 1
    )
    return xr.Variable(numbers.dims[:-1], texts, attributes)


def _hexadecimal(numbers: Values, prefix: str, suffix: str) -> Values:
    """Return bytes as hexadecimal texts between a prefix and a suffix; empty texts where all bytes are zero."""
    width = 2 * numbers.shape[-1]
    letters = np.frombuffer(np.ascontiguousarray(numbers).tobytes().hex().encode(), f"S{width}")
    texts = letters.reshape(numbers.shape[:-1]).astype(f"U{width}")
    texts = np.char.add(np.char.add(prefix, texts), suffix) if prefix else texts
    return np.where(numbers.any(axis=-1), texts, "")


CONSOLIDATED = "consolidated_metadata"
Metadata = dict[str, Any]


def is_left(plan: Plan, folder: Place) -> bool:
    """Whether files of a completed addition remain, since its process was stopped before it removed them."""
    return _growth_folder(plan, folder) in growth_folders(folder)


def _growth_folder(plan: Plan, folder: Place) -> Place:
    """Return the folder that holds the notes of an addition until it is complete."""
    return folder / NOTES / plan.digest[:16]


def grow_store(plan: Plan, template: xr.Dataset, folder: Place, progress: Progress | None) -> None:
    """March what a sweep has more than the one in a store, and make it the store's.

    Parameters
    ----------
    plan : Plan
    template : xarray.Dataset
        The sweep without its members: axes and attributes.
    folder : Path, or name of a folder of objects
    progress : callable, optional

    Raises
    ------
    InputError
        If the sweep in the store is no part of this one, or its members are not the first ones along every axis.
    ArchiveError
        If the store is damaged.
    """
    folder, store = folder.absolute(), store_of(folder)
    work = _growth_folder(plan, folder)
    if facts_of(folder)["sweep"] != plan.digest:  # else nothing remains but to put its digests in their place
        if other_growths := [growth for growth in growth_folders(folder) if growth != work]:
            raise InputError(
                f"members are being added to '{folder}', or were when that was stopped; the same call goes on with it, and"
                f" removing '{other_growths[0]}' gives it up"
            )
        verify_arrays(folder)
        existing = existing_additions(plan, open_zarr_sweep(folder), folder / METADATA, _open_by_metadata)
        _check_behind(plan, existing, open_zarr_sweep(folder), folder)
        store.clear(made_folder(work))
        target = ZarrTarget(folder, work, work / METADATA, existing)
        _write_grown_metadata(plan, template, target)
        old_digests = facts_of(folder)["blocks"]
        blocks = {block_name(block): block for _, block in blocks_of(_grown_chunks(plan, folder))}
        known_digests = {name: old_digests[name] for name in blocks if name in old_digests}
        new = [block for name, block in blocks.items() if name not in known_digests]
        march_blocks(plan, new, target, progress)
        write_digests(plan, new, target, known_digests)
    _exchange_metadata(plan, folder, work)


def _open_by_metadata(metadata: str) -> xr.Dataset:
    return open_zarr_sweep(location_of(metadata).parent)


def _check_behind(plan: Plan, existing: Additions, stored_sweep: xr.Dataset, folder: Place) -> None:
    """Check that the members of a store are the first ones along every axis."""
    dims = tuple(str(dim) for dim in stored_sweep["end_time"].dims)
    faults = []
    if dims != plan.grid.dims:
        faults.append(f"its axes are {', '.join(dims)} there, here {', '.join(plan.grid.dims)}")
    for dim, places in zip(plan.grid.dims, existing.old_indices, strict=True):
        count = int((places != NONE).sum())
        if dim in dims and places[:count].tolist() != [*range(count)]:
            faults.append(f"the values of '{dim}' that it has are not the first ones here, in their order")
    if faults:
        raise InputError(
            f"members are added to the Zarr store '{folder}' behind its last ones:{numbered_lines(faults)}\ngive first what it"
            " has, and then what is to be added, which xarray sorts: sweep.sortby('…'); to a folder without '.zarr'"
            " members are added anywhere",
            tuple(faults),
        )


def _grown_chunks(plan: Plan, folder: Place) -> Chunks:
    """Return the blocks of a sweep, as wide as those that the store has."""
    widths = arrays_in(folder)[plan.variables[0].name].chunks[: len(plan.grid.shape)]
    return tuple(
        (*[width] * (size // width), *([size % width] if size % width else []))
        for size, width in zip(plan.grid.shape, widths, strict=True)
    )


def _write_grown_metadata(plan: Plan, template: xr.Dataset, target: ZarrTarget) -> None:
    """Write beside the store what its metadata will be, and then the further values of the axes behind those that it has."""
    store, folder = store_of(target.folder), target.folder
    sizes = dict(zip(plan.grid.dims, plan.grid.shape, strict=True))
    axes = {str(name): entry for name, entry in template.variables.items() if {*entry.dims} & {*sizes}}
    metadata: Metadata = json.loads(store.content(folder / METADATA, MAX_BYTES))
    old_shapes = {name: tuple(array["shape"]) for name, array in _array_metadata(metadata)}
    for name, array in _array_metadata(metadata):
        dims = array.get("dimension_names", ())  # of what has none they are left out
        array["shape"] = [sizes.get(dim, size) for dim, size in zip(dims, array["shape"], strict=True)]
        array["attributes"] |= axes[name].attrs if name in axes else {}
    metadata["attributes"] |= template.attrs
    if store.kind(target.metadata) == "":
        _replace_file(target.metadata, json.dumps(metadata, indent=2).encode())
    arrays = arrays_in(folder, "r+", target.metadata)
    for name, entry in axes.items():
        size, width = old_shapes[name][0], arrays[name].chunks[0]
        arrays[name][size:] = np.asarray(entry.values)[size:]
        # from the last old chunk on, which may have been filled in part
        for begin in range(size - size % width, entry.size, width):
            synchronise(folder, [name], (slice(begin, begin + width),))


def _array_metadata(metadata: Metadata) -> Iterator[tuple[str, Metadata]]:
    """Yield name and metadata of every array in the store's metadata; a user's other arrays are not listed."""
    yield from (
        (name, node) for name, node in metadata[CONSOLIDATED]["metadata"].items() if node["node_type"] == "array"
    )


def _exchange_metadata(plan: Plan, folder: Place, work: Place) -> None:
    """Replace metadata and digests by those of the extended sweep; an interruption leaves the old or new sweep."""
    store, digests = store_of(folder), folder / NOTES / DIGESTS
    if json.loads(store.content(digests, MAX_BYTES))["sweep"] != plan.digest:
        metadata = store.content(work / METADATA, MAX_BYTES)
        for name, array in _array_metadata(json.loads(metadata)):
            if json.loads(store.content(folder / name / METADATA, MAX_BYTES)) != array:
                _replace_file(folder / name / METADATA, json.dumps(array, indent=2).encode())
        _replace_file(folder / NOTES / CUT, json.dumps(_grown_chunks(plan, folder)).encode())
        # from here on `facts_of` finds the new digests in the growth folder, until they replace the old ones below
        _replace_file(folder / METADATA, metadata)
        _replace_file(digests, store.content(work / DIGESTS, MAX_BYTES))
    store.remove_folder(work)


def _replace_file(path: Place, content: bytes) -> None:
    with taking_name(path) as new:
        new.part.write_bytes(content)


SUFFIX = ".zarr"
ZARR_FILES = (METADATA, ".zgroup", ".zarray", ".zmetadata")  # what a store of either version of Zarr has


def is_zarr_path(path: Place) -> bool:
    """Whether a path has the suffix of a Zarr store."""
    return path.suffix == SUFFIX


def march_into_zarr(plan: Plan, members: int | None, folder: Place, progress: Progress | None) -> None:
    """March the missing members of a sweep into a Zarr store, behind the members of a sweep already there.

    Raises
    ------
    InputError
        If the package zarr is missing, or the store holds a sweep that this one does not extend so.
    ArchiveError
        If it cannot be written: the disk is full, or others' alone.
    """
    zarr_package()
    try:
        _march_missing(plan, members, folder, progress)
    except OSError as error:  # zarr raises it as it comes
        raise ArchiveError(
            f"'{folder}' cannot be written: {error.strerror or error}; blocks of members that are whole are kept, and the"
            " same call goes on with the others"
        ) from None


def _march_missing(plan: Plan, members: int | None, folder: Place, progress: Progress | None) -> None:
    store, notes = store_of(folder), folder / NOTES
    is_whole = store.kind(notes / DIGESTS) is None
    if is_whole and facts_of(folder)["sweep"] == plan.digest and not is_left(plan, folder):
        _remove_block_digests(notes)  # left by a process that was stopped after it had put all digests into one file
        return
    if not is_whole:
        _check_no_foreign_store(folder)
    made_folder(folder)
    store.clear(made_folder(notes))
    with lock_folder(notes, folder):
        if is_whole:
            grow_store(plan, sweep_template(plan), folder, progress)
            return
        if store.kind(notes / METADATA) == "":  # else zarr warns of a folder that is none of its own
            with taking_name(notes / METADATA) as new:
                new.part.write_text(json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {}}))
        chunks = saved_or_new_chunks(plan, members, notes)
        if store.kind(folder / METADATA) != "":
            _check_same_sweep(plan, folder)
        _write_array_metadata(plan, chunks, folder)
        blocks = [block for _, block in blocks_of(chunks)]
        target = ZarrTarget(folder.absolute(), notes.absolute(), folder.absolute() / METADATA)
        march_blocks(plan, blocks, target, progress)
        write_digests(plan, blocks, target, {})
        _remove_block_digests(notes)


def _check_no_foreign_store(folder: Place) -> None:
    """Check that a folder has no other Zarr store: a store of a sweep has the file of its blocks beside it."""
    store = store_of(folder)
    if store.kind(folder / NOTES / CUT) is not None and any(store.kind(folder / name) is None for name in ZARR_FILES):
        raise InputError(f"'{folder}' holds a Zarr store that is no sweep's; name another place")


def _check_same_sweep(plan: Plan, folder: Place) -> None:
    """Check that the part of a sweep in a store belongs to this sweep."""
    stored_digest = json.loads(store_of(folder).content(folder / METADATA, MAX_BYTES)).get("attributes", {}).get(DIGEST)
    if stored_digest not in (None, plan.digest):
        raise InputError(f"'{folder}' holds a part of another sweep; name another store, or remove it")


def sweep_template(plan: Plan) -> xr.Dataset:
    """Return a sweep as its store has it, without arrays of members: axes, times, parameters, attributes."""
    sweep = unlabelled(sweep_dataset(plan, {}))
    texts = {
        name: entry.astype(object) for name, entry in sweep.variables.items() if entry.dtype.kind == "U" and entry.ndim
    }
    template = sweep.assign(texts).set_coords([*sweep.coords])
    attributes = {
        str(name): _json_attribute(value) for name, value in sweep.attrs.items() if name not in (ORIGIN, ROOT_DIGEST)
    }
    variable_names = [variable.name for variable in plan.variables]
    template.attrs = attributes | {TOML: str(template[TOML].values), MEMBER_ARRAYS: variable_names}
    return template.drop_vars(TOML)


def _write_array_metadata(plan: Plan, chunks: Chunks, folder: Place) -> None:
    """Write the metadata of every array, and the axes' values; no member is marched for it."""
    import dask.array

    da: Any = dask.array  # its functions are not typed
    sweep = sweep_template(plan)
    for variable in plan.variables:
        dims, sizes, dtype, attributes = array_form(variable, plan)
        shape = (*plan.grid.shape, *sizes)
        empty = da.zeros(shape, dtype=dtype, chunks=(*(widths[0] for widths in chunks), *sizes))
        sweep[variable.name] = ((*plan.grid.dims, *dims), empty, attributes)
    with quietly():
        sweep.to_zarr(str(folder), mode="a", compute=False, zarr_format=3, consolidated=True)


def _json_attribute(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def _remove_block_digests(notes: Place) -> None:
    """Remove the digests of single blocks of a complete sweep, and files that a stopped process left."""
    store = store_of(notes)
    with suppress(OSError, ArchiveError):  # another process removes them too, or this one may not write here
        store.clear(notes)
        for entry in store.names(notes):
            if entry.suffix == NOTE and entry.name not in (DIGESTS, CUT, METADATA):
                store.remove(entry)
