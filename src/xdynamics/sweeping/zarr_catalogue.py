"""A sweep in a Zarr store: arrays whose chunks are the blocks of members, each written by the worker that marched it.

Plain ``xarray.open_zarr`` opens it, lazily, with units and labels: outcomes are flags, digests bytes. What stands beside the
arrays, in `.xdynamics`, are the digests of their chunks; a block without one is not finished.
"""

from __future__ import annotations

import json
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from xdynamics.archive.place import Place
from xdynamics.archive.stores import made_folder, store_of, taking_name
from xdynamics.faults import ArchiveError, InputError
from xdynamics.record.folding import unlabelled
from xdynamics.schema import ORIGIN, ROOT_DIGEST
from xdynamics.sweeping import zarr_growth
from xdynamics.sweeping.collection import DIGEST, sweep_dataset
from xdynamics.sweeping.members import Plan
from xdynamics.sweeping.stored_blocks import CUT, Progress, lock_folder, saved_or_new_chunks
from xdynamics.sweeping.tasks import Chunks, blocks_of
from xdynamics.sweeping.zarr_blocks import TOML, ZarrTarget, array_form, march_blocks, write_digests
from xdynamics.sweeping.zarr_digests import (
    DIGESTS,
    MAX_BYTES,
    MEMBER_ARRAYS,
    METADATA,
    NOTE,
    NOTES,
    facts_of,
    quietly,
    zarr_package,
)

if TYPE_CHECKING:
    import xarray as xr

SUFFIX = ".zarr"
ZARR_FILES = (METADATA, ".zgroup", ".zarray", ".zmetadata")  # what a store of either version of Zarr has


def is_zarr_path(path: Place) -> bool:
    """Whether a place is named as a Zarr store."""
    return path.suffix == SUFFIX


def march_into_zarr(plan: Plan, members: int | None, folder: Place, progress: Progress | None) -> None:
    """March a sweep into a Zarr store, or what is missing of it; members are added behind those of a sweep that is there.

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
    if is_whole and facts_of(folder)["sweep"] == plan.digest and not zarr_growth.is_left(plan, folder):
        _remove_block_digests(notes)  # left by a process that was stopped after it had put all digests into one file
        return
    if not is_whole:
        _check_no_foreign_store(folder)
    made_folder(folder)
    store.clear(made_folder(notes))
    with lock_folder(notes, folder):
        if is_whole:
            zarr_growth.grow_store(plan, sweep_template(plan), folder, progress)
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
    """Check that no store of others is in a place: one that a sweep began has the blocks that it was cut into beside it."""
    store = store_of(folder)
    if store.kind(folder / NOTES / CUT) is not None and any(store.kind(folder / name) is None for name in ZARR_FILES):
        raise InputError(f"'{folder}' holds a Zarr store that is no sweep's; name another place")


def _check_same_sweep(plan: Plan, folder: Place) -> None:
    """Check that what was begun in a store is this sweep."""
    stored_digest = json.loads(store_of(folder).content(folder / METADATA, MAX_BYTES)).get("attributes", {}).get(DIGEST)
    if stored_digest not in (None, plan.digest):
        raise InputError(f"'{folder}' holds a part of another sweep; name another store, or remove it")


def sweep_template(plan: Plan) -> xr.Dataset:
    """Return a sweep as a store keeps it, but for what its members give: axes, times, parameters, attributes."""
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
    """Remove the digests of single blocks of a sweep that is whole, and what a process that was stopped has left."""
    store = store_of(notes)
    with suppress(OSError, ArchiveError):  # another process removes them too, or this one may not write here
        store.clear(notes)
        for entry in store.names(notes):
            if entry.suffix == NOTE and entry.name not in (DIGESTS, CUT, METADATA):
                store.remove(entry)
