"""Whole runs of a sweep, each in a file that is named by a digest of all that the run is marched from."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.reading import open_run, verified
from xdynamics.archive.seals import tail_of
from xdynamics.archive.segments import clear_segments, has_segments
from xdynamics.archive.streaming import streamed
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march import March
from xdynamics.sweeping.members import COUNTS, DIGEST, FILE, SEAL, Block, Plan, march_of

if TYPE_CHECKING:
    import xarray as xr

Values = dict[str, NDArray[Any]]


def input_digest(march: March) -> str:
    """Return the digest of every word on which the bits of a march depend."""
    return sha256(json.dumps(record.identity(march), sort_keys=True).encode()).hexdigest()


def archived(plan: Plan, block: Block, folder: Path, found: Values, known: NDArray[np.bool_]) -> None:
    """Archive every member of a block that is not known, and note its file and its content digest in what was found.

    A file that is there, and whole, is not marched again; of a member whose model is refused there is none.

    Raises
    ------
    InputError
        If a run comes to something else than the same member side by side with others.
    """
    grid = plan.grid
    shape = grid.shape_of(block)
    for i, at in enumerate(grid.places(block)):
        where = np.unravel_index(i, shape)
        march = None if known[where] else march_of(grid, at)
        if march is None:
            continue
        file = folder / f"{input_digest(march)}.nc"
        digest, seal = digests_of(file, partial(record.comes_of, march=march))
        if digest:
            clear_segments(file)  # of a process that was stopped when the file was whole
        else:
            written = streamed(march, file, resume=has_segments(file))
            digest, seal = written.digest, written.seal
            if apart := _apart(march, {name: values[where] for name, values in found.items()}):
                raise InputError(f"member {grid.said(at)}: {apart}: this is a fault of xdynamics; please report it")
        found[FILE][where], found[DIGEST][where], found[SEAL][where] = f"{folder.name}/{file.name}", digest, seal


def _apart(march: March, found: dict[str, Any]) -> str:
    """Say what a run alone has come to that is not what it came to side by side."""
    now, scales = march.now, record.factors(march.model, march.settings.scales)
    alone: dict[str, Any] = dict(zip(COUNTS, (march.accepted, now.trials, now.evaluations), strict=True))
    state = zip(march.layout.used, march.run.y.tolist(), strict=False)
    alone |= {f"end_{name}": value * scales[name] for name, value in state}
    return ", ".join(f"{name} is {one}, side by side {found[name]}" for name, one in alone.items() if name in found and found[name] != one)  # fmt: skip


def digests_of(file: Path, wanted: Callable[[xr.Dataset], bool]) -> tuple[str, str]:
    """Return the content digest and the seal of a file that is whole and what is wanted; nothing of another."""
    if file.is_file():
        with suppress(ArchiveError, InputError):
            digest, seal = verified(file), tail_of(file).digest
            with open_run(file, check=False) as found:
                return (digest, seal) if wanted(found) else ("", "")
    return "", ""
