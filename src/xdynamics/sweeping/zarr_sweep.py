"""A sweep as a Zarr store, written block by block: its arrays are never in memory as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np

from xdynamics.archive.reading import read_forms, read_values
from xdynamics.archive.store import Place
from xdynamics.archive.text_encoding import TextEncoding
from xdynamics.archive.zarr_archive import create_store, region_writer, replacement, seal_record
from xdynamics.record.folding import unlabelled
from xdynamics.schema import ORIGIN
from xdynamics.sweeping.collection import sweep_dataset
from xdynamics.sweeping.members import Block, Plan


def write_zarr_sweep(plan: Plan, blocks: list[Block], parts: list[Place], folder: Place) -> None:
    """Write the blocks of a sweep into a Zarr store, a chunk each, in place of the sweep that is there.

    Parameters
    ----------
    plan : Plan
    blocks : list of tuple of slice
        Of equal extents but for the last ones.
    parts : list of Path or Address
        The file of each block.
    folder : Path or Address
        The store.
    """
    import dask.array

    da: Any = dask.array  # its functions are not typed
    encodings = _text_encodings(plan, parts)
    widths = [min(extent.stop - extent.start, size) for extent, size in zip(blocks[0], plan.grid.shape, strict=True)]
    shapes = {variable.name: (*plan.grid.shape, *variable.sizes) for variable in plan.variables}
    nothing = {variable.name: da.zeros(shapes[variable.name], dtype=variable.dtype) for variable in plan.variables}
    sweep, chunks = unlabelled(sweep_dataset(plan, nothing)), {}
    sweep.attrs.pop(ORIGIN, None)
    for variable in plan.variables:
        sizes, dtype, attributes = dict(zip(variable.dims, variable.sizes, strict=True)), np.dtype(variable.dtype), {}
        if (encoding := encodings.get(variable.name)) is not None:
            sizes, dtype, attributes = sizes | encoding.dims(variable.name), encoding.dtype, encoding.attributes
        chunks[variable.name] = (*widths, *sizes.values())
        filler = "" if dtype.kind == "O" else 0
        empty = da.full((*plan.grid.shape, *sizes.values()), filler, dtype=dtype, chunks=(*widths, *sizes.values()))
        sweep[variable.name] = (*plan.grid.dims, *sizes), empty, dict(sweep[variable.name].attrs) | attributes
    with replacement(folder) as store:
        create_store(sweep, store, chunks)
        with region_writer(store) as write:
            for block, part in zip(blocks, parts, strict=True):
                for name, values in read_values(part).items():
                    if name in chunks:
                        write(name, tuple(block), encodings[name].encode(values) if name in encodings else values)
        seal_record(store)


def _text_encodings(plan: Plan, parts: list[Place]) -> dict[str, TextEncoding]:
    """Return how each variable of texts is kept, as all its parts allow."""
    names = [variable.name for variable in plan.variables if np.dtype(variable.dtype).kind == "U"]
    forms: dict[str, list[Any]] = {name: [] for name in names}
    for part in parts:
        values = read_forms(part, names)
        for name in names:
            texts, form = values[name]
            forms[name].append((form, bool(texts.any())))
    return {name: TextEncoding.of_parts(forms[name]) for name in names}
