"""Whole runs of a sweep, each in a file that is named by a digest of all that the run is marched from."""

from __future__ import annotations

import json
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive, record
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march import March
from xdynamics.schema import ROOT_DIGEST
from xdynamics.sweeping.members import DIGEST, FILE, OUTCOME, Block, Plan, digest_of_end


def input_digest(march: March) -> str:
    """Return the digest of every word on which the bits of a march depend."""
    return sha256(json.dumps(record.identity(march), sort_keys=True).encode()).hexdigest()


def archived(plan: Plan, block: Block, folder: Path, found: dict[str, NDArray[Any]]) -> None:
    """Archive every member of a block, and note its file and its content digest in what was found.

    A file that is there, and whole, is not marched again.

    Raises
    ------
    InputError
        If a run comes to something else than the same member side by side with others.
    """
    grid = plan.grid
    shape = grid.shape_of(block)
    for i, at in enumerate(grid.places(block)):
        march = March(grid.model_of(at), grid.settings_of(at))
        file = folder / f"{input_digest(march)}.nc"
        if not _is_whole(file):
            archive.stream(march, file)
        where = np.unravel_index(i, shape)
        with archive.open_run(file, check=False) as run:
            alone = {DIGEST: digest_of_end(run, march.layout.used), OUTCOME: run.attrs[OUTCOME]}
            content = str(run.attrs[ROOT_DIGEST])
        apart = [f"{name} is {one}, side by side {found[name][where]}" for name, one in alone.items() if found[name][where] != one]  # fmt: skip
        if apart:
            raise InputError(f"member {grid.said(at)}: {'; '.join(apart)}: this is a fault of xdynamics; please report it")  # fmt: skip
        found[FILE][where], found[DIGEST][where] = f"{folder.name}/{file.name}", content


def _is_whole(file: Path) -> bool:
    if not file.is_file():
        return False
    with suppress(ArchiveError, InputError):
        archive.verify(file)
        return True
    return False
