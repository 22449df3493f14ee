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

from xdynamics.archive.place import Place, placed
from xdynamics.archive.stores import made_folder, store_of, taking_name
from xdynamics.faults import InputError, numbered
from xdynamics.sweeping.additions import NONE, Additions, additions
from xdynamics.sweeping.members import Plan
from xdynamics.sweeping.stored_blocks import CUT, Progress, said
from xdynamics.sweeping.tasks import Chunks, blocks_of
from xdynamics.sweeping.zarr_blocks import Filling, finish, march_blocks
from xdynamics.sweeping.zarr_digests import (
    DIGESTS,
    METADATA,
    MOST,
    NOTES,
    arrays_in,
    facts_of,
    growths,
    synchronise,
    verified,
)
from xdynamics.sweeping.zarr_opening import opened

if TYPE_CHECKING:
    import xarray as xr

CONSOLIDATED = "consolidated_metadata"
Told = dict[str, Any]


def is_left(plan: Plan, folder: Place) -> bool:
    """Whether an addition that made a sweep what it is now was stopped before it had removed what is of no more use."""
    return _work(plan, folder) in growths(folder)


def _work(plan: Plan, folder: Place) -> Place:
    """Return the folder of what is known of an addition until it is whole."""
    return folder / NOTES / plan.digest[:16]


def grow(plan: Plan, described: xr.Dataset, folder: Place, progress: Progress | None) -> None:
    """March what a sweep has more than the one in a store, and make it the store's.

    Parameters
    ----------
    plan : Plan
    described : xarray.Dataset
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
    work = _work(plan, folder)
    if facts_of(folder)["sweep"] != plan.digest:  # else nothing remains but to put its digests in their place
        if others := [place for place in growths(folder) if place != work]:
            raise InputError(
                f"members are being added to '{folder}', or were when that was stopped; the same call goes on with it, and"
                f" removing '{others[0]}' gives it up"
            )
        verified(folder)
        existing = additions(plan, opened(folder), folder / METADATA, _opened)
        _check_behind(plan, existing, opened(folder), folder)
        store.clear(made_folder(work))
        filling = Filling(folder, work, work / METADATA, existing)
        _lay_out(plan, described, filling)
        before = facts_of(folder)["blocks"]
        blocks = {said(block): block for _, block in blocks_of(_chunks(plan, folder))}
        known = {name: before[name] for name in blocks if name in before}
        new = [block for name, block in blocks.items() if name not in known]
        march_blocks(plan, new, filling, progress)
        finish(plan, new, filling, known)
    _exchange(plan, folder, work)


def _opened(metadata: str) -> xr.Dataset:
    return opened(placed(metadata).parent)


def _check_behind(plan: Plan, existing: Additions, there: xr.Dataset, folder: Place) -> None:
    """Check that the members of a store are the first ones along every axis."""
    dims = tuple(str(dim) for dim in there["end_time"].dims)
    faults = []
    if dims != plan.grid.dims:
        faults.append(f"its axes are {', '.join(dims)} there, here {', '.join(plan.grid.dims)}")
    for dim, places in zip(plan.grid.dims, existing.places, strict=True):
        count = int((places != NONE).sum())
        if dim in dims and places[:count].tolist() != [*range(count)]:
            faults.append(f"the values of '{dim}' that it has are not the first ones here, in their order")
    if faults:
        raise InputError(
            f"members are added to the Zarr store '{folder}' behind its last ones:{numbered(faults)}\ngive first what it"
            " has, and then what is to be added, which xarray sorts: sweep.sortby('…'); to a folder without '.zarr'"
            " members are added anywhere",
            tuple(faults),
        )


def _chunks(plan: Plan, folder: Place) -> Chunks:
    """Return the blocks of a sweep, as wide as those that the store has."""
    widths = arrays_in(folder)[plan.variables[0].name].chunks[: len(plan.grid.shape)]
    return tuple(
        (*[width] * (size // width), *([size % width] if size % width else []))
        for size, width in zip(plan.grid.shape, widths, strict=True)
    )


def _lay_out(plan: Plan, described: xr.Dataset, filling: Filling) -> None:
    """Write beside the store what its metadata will be, and then the further values of the axes behind those that it has."""
    store, folder = store_of(filling.folder), filling.folder
    sizes = dict(zip(plan.grid.dims, plan.grid.shape, strict=True))
    axes = {str(name): entry for name, entry in described.variables.items() if {*entry.dims} & {*sizes}}
    told: Told = json.loads(store.content(folder / METADATA, MOST))
    before = {name: tuple(array["shape"]) for name, array in _arrays(told)}
    for name, array in _arrays(told):
        dims = array.get("dimension_names", ())  # of what has none they are left out
        array["shape"] = [sizes.get(dim, size) for dim, size in zip(dims, array["shape"], strict=True)]
        array["attributes"] |= axes[name].attrs if name in axes else {}
    told["attributes"] |= described.attrs
    if store.kind(filling.metadata) == "":
        _replace(filling.metadata, json.dumps(told, indent=2).encode())
    arrays = arrays_in(folder, "r+", filling.metadata)
    for name, entry in axes.items():
        size, width = before[name][0], arrays[name].chunks[0]
        arrays[name][size:] = np.asarray(entry.values)[size:]
        for begin in range(size - size % width, entry.size, width):
            synchronise(folder, [name], (slice(begin, begin + width),))


def _arrays(told: Told) -> Iterator[tuple[str, Told]]:
    """Yield name and metadata of every array that the metadata of a store tell of; others are what a user put there."""
    yield from ((name, node) for name, node in told[CONSOLIDATED]["metadata"].items() if node["node_type"] == "array")


def _exchange(plan: Plan, folder: Place, work: Place) -> None:
    """Let the store's metadata tell of what was added, and its digests; whoever stops this has the one or the other sweep."""
    store, digests = store_of(folder), folder / NOTES / DIGESTS
    if json.loads(store.content(digests, MOST))["sweep"] != plan.digest:
        metadata = store.content(work / METADATA, MOST)
        for name, array in _arrays(json.loads(metadata)):
            if json.loads(store.content(folder / name / METADATA, MOST)) != array:
                _replace(folder / name / METADATA, json.dumps(array, indent=2).encode())
        _replace(folder / NOTES / CUT, json.dumps(_chunks(plan, folder)).encode())
        _replace(folder / METADATA, metadata)
        _replace(digests, store.content(work / DIGESTS, MOST))
    store.remove_folder(work)


def _replace(place: Place, content: bytes) -> None:
    with taking_name(place) as new:
        new.part.write_bytes(content)
