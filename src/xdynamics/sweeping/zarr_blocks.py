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
from xdynamics.record.element_names import listed
from xdynamics.sweeping.additions import Additions
from xdynamics.sweeping.kept_quantities import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.kept_quantities import OUTCOME, Kept
from xdynamics.sweeping.member_files import RUNS, archived
from xdynamics.sweeping.members import FILE, SEAL, Block, Plan, marched
from xdynamics.sweeping.stored_blocks import Progress, said, watching
from xdynamics.sweeping.zarr_digests import (
    DIGESTS,
    MOST,
    NOTE,
    arrays_in,
    digest_of,
    digest_of_array,
    digests_of_axes,
    faults_of_block,
    synchronise,
)

Values = NDArray[Any]

BYTES = "digest_byte"
MEANINGS = "flag_meanings"
TOML = "model_toml"
HEXADECIMAL = {DIGEST_OF_RUN: ("", ""), FILE: (f"{RUNS}/", ".nc"), SEAL: ("", "")}  # what stands around the digits


@dataclass(frozen=True)
class Filling:
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

    def note(self, block: Block) -> Place:
        """Return the place of the digests of a block."""
        return self.notes / f"{said(block)}{NOTE}"

    def faults(self, block: Block) -> list[str]:
        """Compare the chunks of a block that was noted before with its digests."""
        try:
            digests = json.loads(store_of(self.notes).content(self.note(block), MOST))
        except ValueError:
            return ["its digests are damaged"]
        return faults_of_block(self.folder, block, digests, self.metadata)


def form_of(variable: Kept, plan: Plan) -> tuple[tuple[str, ...], tuple[int, ...], Any, dict[str, Any]]:
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


def march_blocks(plan: Plan, blocks: list[Block], filling: Filling, progress: Progress | None) -> None:
    """March the blocks that have no digests, or others than their chunks, on whichever dask scheduler is active."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # dask's functions are not typed
    present = {place.name for place in store_of(filling.notes).names(filling.notes)}
    todo = [block for block in blocks if filling.note(block).name not in present or filling.faults(block)]
    if todo:
        delayed_plan, delayed_filling, keep = delayed(plan), delayed(filling), delayed(_keep)
        with watching([filling.note(block) for block in blocks], progress):
            compute(*(keep(delayed_plan, list(block), delayed_filling) for block in todo))


def _keep(plan: Plan, block: Block, filling: Filling) -> None:
    """March a block into its chunks, and then note their digests; existing members are copied."""
    folder, existing = filling.folder, filling.existing
    values = marched(plan, block, existing.take) if existing else marched(plan, block)
    if plan.keeping.whole:
        present = existing.there(block) if existing else np.zeros(plan.grid.shape_of(block), bool)
        archived(plan, block, made_folder(folder / RUNS), values, present)
    arrays, digests = arrays_in(folder, "r+", filling.metadata), {}
    for variable in plan.variables:
        numbers = _numbers(variable, values[variable.name], plan)
        arrays[variable.name][tuple(block)] = numbers
        digests[variable.name] = digest_of(numbers)
    synchronise(folder, [*digests], block)
    with suppress(TakenError), taking_name(filling.note(block)) as new:
        new.part.write_text(json.dumps(digests))  # of two workers with one block both write the same


def finish(plan: Plan, blocks: list[Block], filling: Filling, known: Mapping[str, Any]) -> None:
    """Put the digests of all arrays and blocks into one file, those of blocks that were known before too."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # as above
    store, digest, names = store_of(filling.folder), delayed(digest_of_array), [entry.name for entry in plan.variables]
    noted = {said(block): json.loads(store.content(filling.note(block), MOST)) for block in blocks}
    digests = compute(*(digest(filling.folder, name, len(plan.grid.shape), filling.metadata) for name in names))
    facts = {
        "sweep": plan.digest,
        "metadata": sha256(store.content(filling.metadata, MOST)).hexdigest(),
        "axes": digests_of_axes(filling.folder, filling.metadata),
        "arrays": dict(zip(names, digests, strict=True)),
        "blocks": {**known, **noted},
    }
    with taking_name(filling.notes / DIGESTS) as new:
        new.part.write_text(json.dumps(facts, sort_keys=True))
