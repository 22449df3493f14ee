"""Whole runs of a sweep, each in a file named by the digest of all inputs of the run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import record
from xdynamics.archive.place import Place
from xdynamics.archive.reading import open_run, verified
from xdynamics.archive.seals import tail_of
from xdynamics.archive.segments import clear_segments, has_segments
from xdynamics.archive.store import TakenError
from xdynamics.archive.stores import store_of
from xdynamics.archive.streaming import streamed
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march import March
from xdynamics.sweeping.kept_quantities import COUNTS, DIGEST
from xdynamics.sweeping.members import FILE, SEAL, Block, Plan, march_of

if TYPE_CHECKING:
    import xarray as xr

Values = dict[str, NDArray[Any]]

RUNS = "runs"  # folder in that of a sweep


def archived(plan: Plan, block: Block, folder: Place, arrays: Values, known: NDArray[np.bool_]) -> None:
    """Archive every unknown member of a block, and enter its file, content digest and seal into the arrays.

    A member whose file exists and is intact is not marched again; one whose model is refused gets no file. All files are
    opened again before they take their names, and the first that is written is read again in full: the others differ from
    it in numbers alone.

    Raises
    ------
    InputError
        If a run differs from the same member marched side by side with others.
    """
    grid = plan.grid
    shape, has_read = grid.shape_of(block), False
    for i, at in enumerate(grid.places(block)):
        place = np.unravel_index(i, shape)
        march = None if known[place] else march_of(grid, at)
        if march is None:
            continue
        file = folder / f"{record.input_digest(march)}.nc"
        digest, seal = digests_of(file, partial(record.comes_of, march=march))
        if digest:
            clear_segments(file)  # left by a process that was stopped after finishing the file
        else:
            digest, seal = _streamed(march, file, read_back=not has_read)
            has_read = True
            if differences := _apart(march, {name: values[place] for name, values in arrays.items()}):
                raise InputError(
                    f"member {grid.name_of(at)}: {differences}: this is a fault of xdynamics; please report it"
                )
        arrays[FILE][place], arrays[DIGEST][place], arrays[SEAL][place] = f"{folder.name}/{file.name}", digest, seal


def _streamed(march: March, file: Place, *, read_back: bool) -> tuple[str, str]:
    """March a member into its file; where another worker did so meanwhile, take that."""
    try:
        written = streamed(march, file, resume=has_segments(file), read_back=read_back)
    except TakenError:
        digest, seal = digests_of(file, partial(record.comes_of, march=march))
        if not digest:
            raise
        return digest, seal
    return written.digest, written.seal


def _apart(march: March, abreast: dict[str, Any]) -> str:
    """Describe how a run marched alone differs from the same run marched side by side; empty if it does not."""
    now, state = march.now, march.run.y[: march.layout.used.size] * record.factors(march.layout, march.settings.scales)
    alone: dict[str, Any] = dict(zip(COUNTS, (march.accepted, now.trials, now.evaluations), strict=True))
    used = march.layout.used
    for block in used.blocks:
        place = used.place(block.name)
        alone[f"end_{block.name}"] = state[place : place + block.size].reshape(block.shape)
    return ", ".join(
        f"{name} is {result}, side by side {abreast[name]}"
        for name, result in alone.items()
        if name in abreast and not np.array_equal(abreast[name], result)
    )


def digests_of(file: Place, wanted: Callable[[xr.Dataset], bool]) -> tuple[str, str]:
    """Return content digest and seal of a file that is intact and the wanted one; empty texts otherwise."""
    store = store_of(file)
    with suppress(ArchiveError, InputError):
        if store.kind(file) is None:
            held = store.held(file)
            digest, seal = verified(file).digest, tail_of(held.path).digest
            with open_run(file, check=False) as run:
                return (digest, seal) if seal and wanted(run) else ("", "")
    return "", ""
