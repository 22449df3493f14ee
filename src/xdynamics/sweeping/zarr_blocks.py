"""Blocks of members in a Zarr store, each marched into the chunks of the arrays by one worker, with digests.

One process at a time cuts a sweep into blocks, and counts the finished ones.

Digests of a block are computed while it is marched, digests of an array when the sweep is complete. Those of blocks
tell which chunk is damaged. Those of arrays, in the order of their members, identify the sweep: they do not depend on
how its members were cut into blocks.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from hashlib import sha256
from itertools import pairwise, product
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.folder_store import is_folder, made_folder, store_of, taking_name
from xdynamics.archive.store import LockedError, Place, TakenError
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.march.outcomes import WORDS
from xdynamics.record.folding import names_as_words
from xdynamics.runtime.files import synced
from xdynamics.schema import RUN_SEAL
from xdynamics.sweeping.additions import Additions
from xdynamics.sweeping.kept_quantities import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.kept_quantities import OUTCOME, KeptVariable
from xdynamics.sweeping.members import FILE, RUNS, SEAL, Block, Plan, archive_members, march_block
from xdynamics.sweeping.tasks import Chunks, measured_chunks

CUT = "blocks.json"  # sizes of the blocks along each axis
MAX_CUT_BYTES = 100_000_000  # bytes of it
Progress = Callable[[float, float, int], None]


@contextmanager
def lock_folder(work: Place, folder: Place) -> Iterator[None]:
    """Lock the working files of a march into a folder against other processes.

    Raises
    ------
    InputError
        If another process has it locked.
    """
    with ExitStack() as stack:
        try:
            stack.enter_context(store_of(work).locked(work))
        except LockedError as error:
            raise InputError(
                f"another process marches into '{folder}'; wait for it, or name another folder ({error})"
            ) from None
        yield


def saved_or_new_chunks(plan: Plan, members: int | None, work: Place) -> Chunks:
    """Return the chunks that a sweep was begun with, or choose and save them."""
    file = work / CUT
    with suppress(OSError, ValueError, TypeError, OverflowError, RecursionError):  # no such file, or a damaged one
        content = json.loads(store_of(file).content(file, MAX_CUT_BYTES))
        saved = tuple(tuple(map(int, widths)) for widths in content)
        if tuple(map(sum, saved)) == plan.grid.shape and all(width > 0 for widths in saved for width in widths):
            return saved
    chunks = measured_chunks(plan, members)
    with taking_name(file) as new:
        new.part.write_text(json.dumps(chunks))
    return chunks


def block_name(block: Block) -> str:
    """Name a block by the members along each axis."""
    return "_".join(f"{extent.start}-{extent.stop}" for extent in block)


class watch_blocks:  # noqa: N801 - used as a statement
    """Report how many blocks are done by counting their files, whichever process writes them."""

    def __init__(self, parts: list[Place], progress: Progress | None) -> None:
        import threading

        self.parts, self.progress, self.stopped = parts, progress, threading.Event()
        self.thread = threading.Thread(target=self._tell, daemon=True) if progress else None

    def __enter__(self) -> None:
        if self.thread:
            self.thread.start()

    def __exit__(self, *_: object) -> None:
        self.stopped.set()
        if self.thread:
            self.thread.join()

    def _tell(self) -> None:
        while not self.stopped.wait(1.0):
            present_names = {entry.name for entry in store_of(self.parts[0]).names(self.parts[0].parent)}
            finished_count = sum(part.name in present_names for part in self.parts)
            if self.progress:
                self.progress(finished_count / len(self.parts), 0.0, finished_count)


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
    # the shape is hashed, too: the same bytes in another shape are other values
    return sha256(f"{values.shape}".encode() + content).hexdigest()


def digest_of_array(folder: Place, name: str, members: int, metadata: Place | None = None) -> str:
    """Return the digest of an array along members, whose first dimensions, so many, are the axes of the sweep."""
    array = arrays_in(folder, metadata=metadata)[name]
    # little-endian, so that every machine comes to the same digest
    dtype = np.dtype(array.dtype).newbyteorder("<")
    digest = sha256(f"{dtype.str}{tuple(array.shape)}".encode())
    for chunk_block in chunk_blocks(array.shape[:members], array.chunks[:members]):
        digest.update(np.ascontiguousarray(array[chunk_block], dtype).tobytes())
    return digest.hexdigest()


def chunk_blocks(shape: Sequence[int], widths: Sequence[int]) -> Iterator[Block]:
    """Cut a grid into consecutive parts of complete chunks, in the order of members, so that none is read twice."""
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
    """Force the chunks of a block to the disk, where the store is a folder; an object is durable once written."""
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
    """Return the digest of a sweep's request, axes and arrays.

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
    # a block is named by its range along each axis, so its parts count the axes
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


BYTES = "digest_byte"
MEANINGS = "flag_meanings"
TOML = "model_toml"
HEXADECIMAL = {DIGEST_OF_RUN: ("", ""), FILE: (f"{RUNS}/", ".nc"), SEAL: ("", "")}  # what stands around the digits


@dataclass(frozen=True)
class ZarrTarget:
    """Where the members of a sweep are marched into.

    Attributes
    ----------
    folder : Path, or name of a folder of objects
        The store.
    notes : Path, or name of a folder of objects
        Where the digests of its blocks are kept until it is whole.
    metadata : Path, or name of an object
        What tells the sizes of its arrays.
    existing : Additions, optional
        The members that it has already.
    """

    folder: Place
    notes: Place
    metadata: Place
    existing: Additions | None = None

    def digest_file(self, block: Block) -> Place:
        """Return the path of a block's digests."""
        return self.notes / f"{block_name(block)}{NOTE}"

    def block_faults(self, block: Block) -> list[str]:
        """Compare the chunks of a block that was noted before with its digests."""
        try:
            digests = json.loads(store_of(self.notes).content(self.digest_file(block), MAX_BYTES))
        except ValueError:
            return ["its digests are damaged"]
        return faults_of_block(self.folder, block, digests, self.metadata)


def array_form(variable: KeptVariable, plan: Plan) -> tuple[tuple[str, ...], tuple[int, ...], Any, dict[str, Any]]:
    """Return further dimensions, their sizes, the type and the attributes of an array: words are flags, digests bytes."""
    if variable.name in HEXADECIMAL:
        prefix, suffix = HEXADECIMAL[variable.name]
        width = (np.dtype(variable.dtype).itemsize // 4 - len(prefix) - len(suffix)) // 2
        encoding = f"hexadecimal{f', {prefix}….{suffix[1:]}' if prefix else ''}; zeros where there is none"
        return (*variable.dims, BYTES), (*variable.sizes, width), "u1", variable.attributes | {"encoded": encoding}
    if np.dtype(variable.dtype).kind == "U":
        words = _flag_words(variable.name, plan)
        flags = {"flag_values": list(range(len(words))), MEANINGS: " ".join(words)}
        return variable.dims, variable.sizes, "i2", variable.attributes | flags
    return variable.dims, variable.sizes, np.dtype(variable.dtype), variable.attributes


def _flag_words(name: str, plan: Plan) -> list[str]:
    """Return the words of a variable, in the order of their flags."""
    return (
        sorted(WORDS)
        if name == OUTCOME
        else sorted(names_as_words([event]) for event in plan.grid.model.elements.events)
    )


def _stored_values(variable: KeptVariable, values: Values, plan: Plan) -> Values:
    """Return the values of a block as the store keeps them."""
    if variable.name in HEXADECIMAL:
        prefix_length, suffix_length = map(len, HEXADECIMAL[variable.name])
        width = values.dtype.itemsize // 4 - prefix_length - suffix_length
        letters = "".join(
            text[prefix_length : len(text) - suffix_length].rjust(width, "0") for text in values.ravel().tolist()
        )
        return np.frombuffer(bytes.fromhex(letters), "u1").reshape(*values.shape, -1)
    if values.dtype.kind == "U":
        words = np.array(_flag_words(variable.name, plan))
        places = np.minimum(np.searchsorted(words, values), words.size - 1)
        return np.where(words[places] == values, places, -1).astype("i2")
    return values.astype(variable.dtype, copy=False)


def march_blocks(plan: Plan, blocks: list[Block], target: ZarrTarget, progress: Progress | None) -> None:
    """March the blocks that have no digests, or others than their chunks, on whichever dask scheduler is active."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # dask's functions are not typed
    present_names = {entry.name for entry in store_of(target.notes).names(target.notes)}
    todo = [
        block for block in blocks if target.digest_file(block).name not in present_names or target.block_faults(block)
    ]
    if todo:
        delayed_plan, delayed_filling, delayed_march = delayed(plan), delayed(target), delayed(_march_block_into_chunks)
        with watch_blocks([target.digest_file(block) for block in blocks], progress):
            compute(*(delayed_march(delayed_plan, list(block), delayed_filling) for block in todo))


def _march_block_into_chunks(plan: Plan, block: Block, target: ZarrTarget) -> None:
    """March a block into its chunks, and then note their digests; existing members are copied."""
    folder, existing = target.folder, target.existing
    values = march_block(plan, block, existing.copy_existing) if existing else march_block(plan, block)
    if plan.keeping.keeps_whole_runs:
        existing_mask = existing.existing_members(block) if existing else np.zeros(plan.grid.block_shape(block), bool)
        archive_members(plan, block, made_folder(folder / RUNS), values, existing_mask)
    arrays, digests = arrays_in(folder, "r+", target.metadata), {}
    for variable in plan.variables:
        numbers = _stored_values(variable, values[variable.name], plan)
        arrays[variable.name][tuple(block)] = numbers
        digests[variable.name] = values_digest(numbers)
    synchronise(folder, [*digests], block)
    with suppress(TakenError), taking_name(target.digest_file(block)) as new:
        new.part.write_text(json.dumps(digests))  # of two workers with one block both write the same


def write_digests(plan: Plan, blocks: list[Block], target: ZarrTarget, known_digests: Mapping[str, Any]) -> None:
    """Write the digests of all arrays and blocks into one file, including blocks whose digests were known."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # as above
    store, digest, names = store_of(target.folder), delayed(digest_of_array), [entry.name for entry in plan.variables]
    new_digests = {
        block_name(block): json.loads(store.content(target.digest_file(block), MAX_BYTES)) for block in blocks
    }
    digests = compute(*(digest(target.folder, name, len(plan.grid.shape), target.metadata) for name in names))
    facts = {
        "sweep": plan.digest,
        "metadata": sha256(store.content(target.metadata, MAX_BYTES)).hexdigest(),
        "axes": digests_of_axes(target.folder, target.metadata),
        "arrays": dict(zip(names, digests, strict=True)),
        "blocks": {**known_digests, **new_digests},
    }
    with taking_name(target.notes / DIGESTS) as new:
        new.part.write_text(json.dumps(facts, sort_keys=True))
