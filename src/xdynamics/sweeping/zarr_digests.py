"""Digests of a sweep in a Zarr store: of each block while it is marched, of each array when the sweep is whole.

Those of blocks say which chunk is damaged; those of arrays, in the order of their members, what the sweep is: they do not
depend on how its members were cut into blocks.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from hashlib import sha256
from itertools import pairwise, product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import Place
from xdynamics.archive.stores import is_folder, store_of
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.runtime.files import synced
from xdynamics.schema import RUN_SEAL
from xdynamics.sweeping.members import Block
from xdynamics.sweeping.stored_blocks import CUT, block_name

Values = NDArray[Any]

NOTES, DIGESTS, NOTE = ".xdynamics", "digests.json", ".json"
METADATA = "zarr.json"
MEMBER_ARRAYS = "sweep_variables"  # attribute: the arrays that are along members
MAX_BYTES = 1_000_000_000  # bytes of digests and metadata
MEMBERS_PER_READ = 1 << 16  # members that are read at once


def zarr_package() -> Any:
    """Return the package zarr.

    Raises
    ------
    InputError
        If it is missing.
    """
    try:
        import zarr
    except ImportError:
        raise InputError("sweeps in a Zarr store need the package zarr: pip install 'xdynamics[zarr]'") from None
    return zarr


@contextmanager
def quietly() -> Iterator[None]:
    """Leave out zarr's notes that metadata in one file are none of the format's specification yet."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def arrays_in(folder: Place, mode: str = "r", metadata: Place | None = None) -> Any:
    """Open the arrays of a store, where they are given in sizes that other metadata tell than its own."""
    zarr = zarr_package()
    with quietly():
        group = zarr.open_group(str(folder), mode=mode)
        if metadata is None or metadata == folder / METADATA:
            return group
        store_metadata = json.loads(store_of(metadata).content(metadata, MAX_BYTES))
        return zarr.Group(zarr.AsyncGroup.from_dict(group.store_path, store_metadata))


def values_digest(values: Values) -> str:
    """Return the digest of values in memory."""
    values = np.ascontiguousarray(values)
    content = json.dumps(values.tolist()).encode() if values.dtype.kind in "OTU" else values.tobytes()
    return sha256(f"{values.shape}".encode() + content).hexdigest()


def digest_of_array(folder: Place, name: str, members: int, metadata: Place | None = None) -> str:
    """Return the digest of an array along members, whose first dimensions, so many, are the axes of the sweep."""
    array = arrays_in(folder, metadata=metadata)[name]
    dtype = np.dtype(array.dtype).newbyteorder("<")
    digest = sha256(f"{dtype.str}{tuple(array.shape)}".encode())
    for chunk_block in chunk_blocks(array.shape[:members], array.chunks[:members]):
        digest.update(np.ascontiguousarray(array[chunk_block], dtype).tobytes())
    return digest.hexdigest()


def chunk_blocks(shape: Sequence[int], widths: Sequence[int]) -> Iterator[Block]:
    """Cut a grid into parts that follow each other as members do, each of whole chunks, so that none is read twice."""
    members_behind = [prod(shape[k + 1 :]) for k in range(len(shape))]
    k = next(
        (k for k, width in enumerate(widths) if width > 1 or members_behind[k] <= MEMBERS_PER_READ), len(shape) - 1
    )
    step = widths[k] * max(1, MEMBERS_PER_READ // (widths[k] * members_behind[k]))
    edges = [*range(0, shape[k], step), shape[k]]
    for leading_index in product(*map(range, shape[:k])):
        for begin, end in pairwise(edges):
            yield (
                *(slice(i, i + 1) for i in leading_index),
                slice(begin, end),
                *(slice(0, size) for size in shape[k + 1 :]),
            )


def digests_of_axes(folder: Place, metadata: Place | None = None) -> dict[str, str]:
    """Return digests of the arrays that are not along members: axis values, times, parameters."""
    arrays = arrays_in(folder, metadata=metadata)
    member_arrays = set(arrays.attrs[MEMBER_ARRAYS])
    return {
        name: values_digest(np.asarray(array[...]))
        for name, array in sorted(arrays.arrays())
        if name not in member_arrays
    }


def synchronise(folder: Place, names: Sequence[str], block: Block) -> None:
    """Have the chunks of a block reach the disk, where the store is a folder; an object is kept when it is written."""
    if not isinstance(folder, Path):
        return
    arrays = arrays_in(folder)
    for name in names:
        array = arrays[name]
        chunk_index = (part.start // width for part, width in zip(block, array.chunks, strict=False))
        key = array.metadata.encode_chunk_key((*chunk_index, *[0] * (len(array.shape) - len(block))))
        chunk = folder / name / key
        if chunk.exists():  # zarr writes none that holds fill values alone
            for path in (chunk, chunk.parent):
                with synced(path):
                    pass


def facts_of(folder: Place) -> dict[str, Any]:
    """Read the digests of a sweep.

    Raises
    ------
    InputError
        If there is none, or it is not finished.
    ArchiveError
        If they are damaged.
    """
    store, file = store_of(folder), folder / NOTES / DIGESTS
    if store.kind(file) is not None:
        if store.kind(folder / NOTES / CUT) is None:  # else the store may be another program's
            raise InputError(f"the sweep in '{folder}' is not finished; call the same sweep again, and it goes on")
        raise InputError(
            f"'{folder}' holds no sweep: there is no '{NOTES}/{DIGESTS}' in it; name what sweep marched into"
        )
    try:
        facts: dict[str, Any] = json.loads(store.content(file, MAX_BYTES))
        metadata = sha256(store.content(folder / METADATA, MAX_BYTES)).hexdigest()
    except (ValueError, OSError) as error:
        raise ArchiveError(f"'{file}' is damaged: {error}") from None
    for growth_folder in growth_folders(folder) if metadata != facts.get("metadata") else ():
        with suppress(ArchiveError, InputError, ValueError, OSError):  # members are still being marched there
            facts = json.loads(store.content(growth_folder / DIGESTS, MAX_BYTES))
    if metadata != facts.get("metadata"):
        raise ArchiveError(
            f"'{folder / METADATA}' differs from its digest; remove '{folder}', and march the sweep again"
        )
    return facts


def growth_folders(folder: Place) -> list[Place]:
    """List the folders of members that are being added to a sweep, or were when a process was stopped."""
    return [entry for entry in store_of(folder).names(folder / NOTES) if is_folder(entry)]


def sweep_content_digest(facts: dict[str, Any]) -> str:
    """Return the digest of what was asked and what came of it.

    The metadata, which name the machine too, are not in it, nor are the seals of archives, which hold a date.
    """
    content = {name: facts[name] for name in ("sweep", "axes", "arrays")}
    content["arrays"] = {name: digest for name, digest in facts["arrays"].items() if name != RUN_SEAL}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def verify_arrays(folder: Place) -> str:
    """Compare every array of a sweep, its axes and its metadata with their digests; return the content digest.

    Raises
    ------
    ArchiveError
        Naming the arrays and blocks that differ.
    """
    zarr_package()
    facts = facts_of(folder)
    axes = digests_of_axes(folder)
    faults = [f"array '{name}' differs" for name, digest in axes.items() if facts["axes"].get(name) != digest]
    damaged_names = [name for name, digest in facts["arrays"].items() if not _is_intact(folder, name, facts, digest)]
    for extent, digests in facts["blocks"].items() if damaged_names else ():
        block = tuple(slice(*map(int, part.split("-"))) for part in extent.split("_"))
        faults += faults_of_block(folder, block, {name: digests[name] for name in damaged_names})
    faults += [
        f"array '{name}' differs" for name in damaged_names if not any(f"array '{name}'" in fault for fault in faults)
    ]
    if faults:
        raise ArchiveError(
            f"'{folder}' is damaged:{numbered_lines(faults)}\nremove it, and march the sweep again", tuple(faults)
        )
    return sweep_content_digest(facts)


def _is_intact(folder: Place, name: str, facts: Mapping[str, Any], digest: str) -> bool:
    members = len(next(iter(facts["blocks"])).split("_"))
    try:
        return digest_of_array(folder, name, members) == digest
    except Exception:  # noqa: BLE001 - of a codec, for bytes that are none of its
        return False


def faults_of_block(
    folder: Place, block: Block, digests: Mapping[str, str], metadata: Place | None = None
) -> list[str]:
    """Compare the chunks of a block with its digests; describe every difference."""
    arrays, faults = arrays_in(folder, metadata=metadata), list[str]()
    for name, digest in digests.items():
        try:
            same = values_digest(np.asarray(arrays[name][tuple(block)])) == digest
        except Exception as error:  # noqa: BLE001 - as above
            faults.append(f"array '{name}' cannot be read in block {block_name(block)}: {error}")
            continue
        if not same:
            faults.append(f"array '{name}' differs in block {block_name(block)}")
    return faults
