"""Members added to a sweep in a Zarr store, behind the last values of its axes: what is there stays where it is.

While they are marched, the store's own metadata tell the sizes that it had, so that whoever opens it sees the sweep as it
was. Chunks behind these sizes are seen by nobody; one that was filled in part is replaced by one with the same members, and
those that follow. In the end the metadata are replaced, and with them the sweep.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from xdynamics.archive.place import Place, location_of
from xdynamics.archive.stores import made_folder, store_of, taking_name
from xdynamics.faults import InputError, numbered_lines
from xdynamics.sweeping.additions import NONE, Additions, existing_additions
from xdynamics.sweeping.members import Plan
from xdynamics.sweeping.stored_blocks import CUT, Progress, block_name
from xdynamics.sweeping.tasks import Chunks, blocks_of
from xdynamics.sweeping.zarr_blocks import ZarrTarget, march_blocks, write_digests
from xdynamics.sweeping.zarr_digests import (
    DIGESTS,
    MAX_BYTES,
    METADATA,
    NOTES,
    arrays_in,
    facts_of,
    growth_folders,
    synchronise,
    verify_arrays,
)
from xdynamics.sweeping.zarr_opening import open_zarr_sweep

if TYPE_CHECKING:
    import xarray as xr

CONSOLIDATED = "consolidated_metadata"
Metadata = dict[str, Any]


def is_left(plan: Plan, folder: Place) -> bool:
    """Whether an addition that made a sweep what it is now was stopped before it had removed what is of no more use."""
    return _growth_folder(plan, folder) in growth_folders(folder)


def _growth_folder(plan: Plan, folder: Place) -> Place:
    """Return the folder of what is known of an addition until it is whole."""
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
        for begin in range(size - size % width, entry.size, width):
            synchronise(folder, [name], (slice(begin, begin + width),))


def _array_metadata(metadata: Metadata) -> Iterator[tuple[str, Metadata]]:
    """Yield name and metadata of every array that the metadata of a store tell of; others are what a user put there."""
    yield from (
        (name, node) for name, node in metadata[CONSOLIDATED]["metadata"].items() if node["node_type"] == "array"
    )


def _exchange_metadata(plan: Plan, folder: Place, work: Place) -> None:
    """Let the store's metadata tell of what was added, and its digests; whoever stops this has the one or the other sweep."""
    store, digests = store_of(folder), folder / NOTES / DIGESTS
    if json.loads(store.content(digests, MAX_BYTES))["sweep"] != plan.digest:
        metadata = store.content(work / METADATA, MAX_BYTES)
        for name, array in _array_metadata(json.loads(metadata)):
            if json.loads(store.content(folder / name / METADATA, MAX_BYTES)) != array:
                _replace_file(folder / name / METADATA, json.dumps(array, indent=2).encode())
        _replace_file(folder / NOTES / CUT, json.dumps(_grown_chunks(plan, folder)).encode())
        _replace_file(folder / METADATA, metadata)
        _replace_file(digests, store.content(work / DIGESTS, MAX_BYTES))
    store.remove_folder(work)


def _replace_file(path: Place, content: bytes) -> None:
    with taking_name(path) as new:
        new.part.write_bytes(content)
