"""A sweep in a Zarr store: arrays whose chunks are the blocks of members, each written by the worker that marched it.

Plain ``xarray.open_zarr`` opens it, lazily, with units and labels: outcomes are flags, digests bytes. What stands beside the
arrays, in `.xdynamics`, are the digests of their chunks; a block without one is not finished.
"""

from __future__ import annotations

import json
from contextlib import suppress
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import Place
from xdynamics.archive.store import TakenError
from xdynamics.archive.stores import made_folder, store_of, taking_name
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march.outcomes import WORDS
from xdynamics.record.element_names import listed
from xdynamics.record.folding import labelled, unlabelled
from xdynamics.schema import EVIDENCE, ORIGIN, ROOT_DIGEST, SWEEP
from xdynamics.sweeping.collection import DIGEST, collected, with_axes
from xdynamics.sweeping.kept_quantities import Kept
from xdynamics.sweeping.member_files import RUNS, archived
from xdynamics.sweeping.members import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.members import FILE, OUTCOME, SEAL, STOPPED_BY, Block, Plan, marched
from xdynamics.sweeping.stored_blocks import CUT, Progress, alone_in, begun, said, watching
from xdynamics.sweeping.tasks import Chunks, blocks_of
from xdynamics.sweeping.zarr_digests import (
    DIGESTS,
    KEPT,
    METADATA,
    MOST,
    NOTE,
    NOTES,
    arrays_in,
    content_digest,
    digest_of,
    digest_of_array,
    digests_of_axes,
    facts_of,
    faults_of_block,
    quietly,
    synchronise,
    zarr_package,
)

if TYPE_CHECKING:
    import xarray as xr

Values = NDArray[Any]

SUFFIX = ".zarr"
BYTES = "digest_byte"
MEANINGS = "flag_meanings"
_TOML = "model_toml"
HEXADECIMAL = {DIGEST_OF_RUN: ("", ""), FILE: (f"{RUNS}/", ".nc"), SEAL: ("", "")}  # what stands around the digits


def is_one(place: Place) -> bool:
    """Whether a place is named as a Zarr store."""
    return place.suffix == SUFFIX


def fill(plan: Plan, members: int | None, folder: Place, progress: Progress | None) -> None:
    """March a sweep into a Zarr store, or what is missing of it.

    Raises
    ------
    InputError
        If the package zarr is missing, or the store holds another sweep.
    """
    zarr_package()
    store, notes = store_of(folder), folder / NOTES
    if store.kind(notes / DIGESTS) is None:
        if facts_of(folder)["sweep"] == plan.digest:
            _forget(notes)  # left by a process that was stopped after it had put all digests into one file
            return
        raise InputError(
            f"'{folder}' holds another sweep, and members are not added to a Zarr store; name another, or remove it"
        )
    made_folder(folder)
    store.clear(made_folder(notes))
    with alone_in(notes):
        if store.kind(notes / METADATA) == "":  # else zarr warns of a folder that is none of its own
            with taking_name(notes / METADATA) as new:
                new.part.write_text(json.dumps({"zarr_format": 3, "node_type": "group", "attributes": {}}))
        chunks = begun(plan, members, notes)
        if store.kind(folder / METADATA) != "":
            _check_same(plan, folder)
        _lay_out(plan, chunks, folder)
        blocks = [block for _, block in blocks_of(chunks)]
        _march(plan, blocks, folder, progress)
        _finish(plan, blocks, folder)


def _check_same(plan: Plan, folder: Place) -> None:
    """Check that what was begun in a store is this sweep."""
    there = json.loads(store_of(folder).content(folder / METADATA, MOST)).get("attributes", {}).get(DIGEST)
    if there not in (None, plan.digest):
        raise InputError(f"'{folder}' holds a part of another sweep; name another store, or remove it")


def _lay_out(plan: Plan, chunks: Chunks, folder: Place) -> None:
    """Write the metadata of every array, and the axes' values; no member is marched for it."""
    import dask.array

    da: Any = dask.array  # its functions are not typed
    sweep = unlabelled(collected(plan, {}))
    names = [variable.name for variable in plan.variables]
    for variable in plan.variables:
        dims, sizes, dtype, attributes = _form(variable, plan)
        shape = (*plan.grid.shape, *sizes)
        empty = da.zeros(shape, dtype=dtype, chunks=(*(widths[0] for widths in chunks), *sizes))
        sweep[variable.name] = ((*plan.grid.dims, *dims), empty, attributes)
    texts = {
        name: entry.astype(object) for name, entry in sweep.variables.items() if entry.dtype.kind == "U" and entry.ndim
    }
    sweep = sweep.assign(texts).set_coords([*sweep.coords])
    attributes = {str(name): _plain(value) for name, value in sweep.attrs.items() if name not in (ORIGIN, ROOT_DIGEST)}
    sweep.attrs = attributes | {_TOML: str(sweep[_TOML].values), KEPT: names}
    with quietly():
        sweep.drop_vars(_TOML).to_zarr(str(folder), mode="a", compute=False, zarr_format=3, consolidated=True)


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else value


def _form(variable: Kept, plan: Plan) -> tuple[tuple[str, ...], tuple[int, ...], Any, dict[str, Any]]:
    """Return further dimensions, their sizes, the type and the attributes of an array: words are flags, digests bytes."""
    if variable.name in HEXADECIMAL:
        before, after = HEXADECIMAL[variable.name]
        width = (np.dtype(variable.dtype).itemsize // 4 - len(before) - len(after)) // 2
        encoding = f"hexadecimal{f', {before}….{after[1:]}' if before else ''}; zeros where there is none"
        return (*variable.dims, BYTES), (*variable.sizes, width), "u1", variable.attributes | {"encoded": encoding}
    if np.dtype(variable.dtype).kind == "U":
        words = _words(variable.name, plan)
        flags = {"flag_values": list(range(len(words))), MEANINGS: " ".join(words)}
        return variable.dims, variable.sizes, "i2", variable.attributes | flags
    return variable.dims, variable.sizes, np.dtype(variable.dtype), variable.attributes


def _words(name: str, plan: Plan) -> list[str]:
    """Return the words of a variable, in the order of their flags."""
    return sorted(WORDS) if name == OUTCOME else sorted(listed([event]) for event in plan.grid.model.events)


def _numbers(variable: Kept, values: Values, plan: Plan) -> Values:
    """Return the values of a block as the store keeps them."""
    if variable.name in HEXADECIMAL:
        before, after = map(len, HEXADECIMAL[variable.name])
        width = values.dtype.itemsize // 4 - before - after
        letters = "".join(text[before : len(text) - after].rjust(width, "0") for text in values.ravel().tolist())
        return np.frombuffer(bytes.fromhex(letters), "u1").reshape(*values.shape, -1)
    if values.dtype.kind == "U":
        words = np.array(_words(variable.name, plan))
        places = np.minimum(np.searchsorted(words, values), words.size - 1)
        return np.where(words[places] == values, places, -1).astype("i2")
    return values.astype(variable.dtype, copy=False)


def _march(plan: Plan, blocks: list[Block], folder: Place, progress: Progress | None) -> None:
    """March the blocks that have no digests, or others than their chunks, on whichever dask scheduler is active."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # dask's functions are not typed
    present = {place.name for place in store_of(folder).names(folder / NOTES)}
    notes = [folder / NOTES / f"{said(block)}{NOTE}" for block in blocks]
    todo = [
        block for block, note in zip(blocks, notes, strict=True) if note.name not in present or _faults(folder, block)
    ]
    if todo:
        delayed_plan, keep = delayed(plan), delayed(_keep)
        with watching(notes, progress):
            compute(*(keep(delayed_plan, list(block), folder.absolute()) for block in todo))


def _faults(folder: Place, block: Block) -> list[str]:
    """Compare the chunks of a block that was noted before with its digests."""
    try:
        digests = json.loads(store_of(folder).content(folder / NOTES / f"{said(block)}{NOTE}", MOST))
    except ValueError:
        return ["its digests are damaged"]
    return faults_of_block(folder, block, digests)


def _keep(plan: Plan, block: Block, folder: Place) -> None:
    """March a block into its chunks, and then note their digests."""
    values = marched(plan, block)
    if plan.keeping.whole:
        archived(plan, block, made_folder(folder / RUNS), values, np.zeros(plan.grid.shape_of(block), bool))
    arrays, digests = arrays_in(folder, "r+"), {}
    for variable in plan.variables:
        numbers = _numbers(variable, values[variable.name], plan)
        arrays[variable.name][tuple(block)] = numbers
        digests[variable.name] = digest_of(numbers)
    synchronise(folder, [*digests], block)
    with suppress(TakenError), taking_name(folder / NOTES / f"{said(block)}{NOTE}") as new:
        new.part.write_text(json.dumps(digests))  # of two workers with one block both write the same


def _finish(plan: Plan, blocks: list[Block], folder: Place) -> None:
    """Put the digests of all arrays and blocks into one file, by which the sweep is whole."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # as above
    store, notes, digest = store_of(folder), folder / NOTES, delayed(digest_of_array)
    noted = {said(block): json.loads(store.content(notes / f"{said(block)}{NOTE}", MOST)) for block in blocks}
    names = [variable.name for variable in plan.variables]
    digests = compute(*(digest(folder.absolute(), name, len(plan.grid.shape)) for name in names))
    facts = {
        "sweep": plan.digest,
        "metadata": sha256(store.content(folder / METADATA, MOST)).hexdigest(),
        "axes": digests_of_axes(folder),
        "arrays": dict(zip(names, digests, strict=True)),
        "blocks": noted,
    }
    with taking_name(notes / DIGESTS) as new:
        new.part.write_text(json.dumps(facts, sort_keys=True))
    _forget(notes)


def _forget(notes: Place) -> None:
    """Remove the digests of single blocks of a sweep that is whole, and what a process that was stopped has left."""
    store = store_of(notes)
    with suppress(OSError, ArchiveError):  # another process removes them too, or this one may not write here
        store.clear(notes)
        for place in store.names(notes):
            if place.suffix == NOTE and place.name not in (DIGESTS, CUT, METADATA):
                store.remove(place)


def opened(folder: Place) -> xr.Dataset:
    """Open a sweep lazily: chunks are read when they are used; `verified` compares them with their digests.

    Raises
    ------
    ArchiveError
        If the folder holds no sweep.
    """
    import xarray as xr

    zarr_package()
    facts = facts_of(folder)
    stored = xr.open_zarr(str(folder), consolidated=True, mask_and_scale=False, decode_times=False)
    sweep = stored.assign(
        {name: _as_texts(stored[name]) for name in (OUTCOME, STOPPED_BY, *HEXADECIMAL) if name in stored}
    )
    words = {name: entry for name, entry in sweep.variables.items() if entry.dtype.kind not in "biufU"}
    sweep = sweep.assign(
        {name: (entry.dims, np.array(entry.values.tolist(), str), entry.attrs) for name, entry in words.items()}
    )
    sweep[_TOML] = ((), str(stored.attrs[_TOML]), {"units": "1", "long_name": "the model that members share, as TOML"})
    sweep.attrs = {name: value for name, value in stored.attrs.items() if name not in (_TOML, KEPT)}
    sweep.attrs[ROOT_DIGEST] = content_digest(facts)
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
    before, after = HEXADECIMAL[str(numbers.name)]
    dtype = f"U{2 * numbers.shape[-1] + len(before) + len(after)}"
    texts = data.map_blocks(partial(_hexadecimal, before=before, after=after), dtype=dtype, drop_axis=numbers.ndim - 1)
    return xr.Variable(numbers.dims[:-1], texts, attributes)


def _hexadecimal(numbers: Values, before: str, after: str) -> Values:
    """Return bytes as texts, with what stands around them; empty ones where all are zero."""
    width = 2 * numbers.shape[-1]
    letters = np.frombuffer(np.ascontiguousarray(numbers).tobytes().hex().encode(), f"S{width}")
    texts = letters.reshape(numbers.shape[:-1]).astype(f"U{width}")
    texts = np.char.add(np.char.add(before, texts), after) if before else texts
    return np.where(numbers.any(axis=-1), texts, "")
