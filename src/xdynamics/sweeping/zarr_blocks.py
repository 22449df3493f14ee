"""Blocks of members, each marched into the chunks of the arrays of a Zarr store by one worker, with the digests of its own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics.archive.place import Place
from xdynamics.archive.store import TakenError
from xdynamics.archive.stores import made_folder, store_of, taking_name
from xdynamics.march.outcomes import WORDS
from xdynamics.record.element_names import names_as_words
from xdynamics.sweeping.additions import Additions
from xdynamics.sweeping.kept_quantities import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.kept_quantities import OUTCOME, KeptVariable
from xdynamics.sweeping.member_files import RUNS, archive_members
from xdynamics.sweeping.members import FILE, SEAL, Block, Plan, march_block
from xdynamics.sweeping.stored_blocks import Progress, block_name, watch_blocks
from xdynamics.sweeping.zarr_digests import (
    DIGESTS,
    MAX_BYTES,
    NOTE,
    arrays_in,
    digest_of_array,
    digests_of_axes,
    faults_of_block,
    synchronise,
    values_digest,
)

Values = NDArray[Any]

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
        """Return the place of the digests of a block."""
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
    return sorted(WORDS) if name == OUTCOME else sorted(names_as_words([event]) for event in plan.grid.model.events)


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
    """Put the digests of all arrays and blocks into one file, those of blocks that were known before too."""
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
