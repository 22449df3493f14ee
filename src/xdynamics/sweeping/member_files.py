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
from xdynamics.archive.reading import open_run, verify_digests
from xdynamics.archive.seals import tail_of
from xdynamics.archive.segments import clear_segments, has_segments
from xdynamics.archive.store import TakenError
from xdynamics.archive.stores import store_of
from xdynamics.archive.streaming import stream_to_writer
from xdynamics.faults import ArchiveError, InputError
from xdynamics.march import March
from xdynamics.sweeping.kept_quantities import COUNT_FUNCTIONS, DIGEST
from xdynamics.sweeping.members import FILE, SEAL, Block, Plan, march_of

if TYPE_CHECKING:
    import xarray as xr

MemberValues = dict[str, NDArray[Any]]

RUNS = "runs"  # folder in that of a sweep


def archive_members(
    plan: Plan, block: Block, folder: Place, arrays: MemberValues, existing_members: NDArray[np.bool_]
) -> None:
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
    shape, has_read = grid.block_shape(block), False
    for i, axis_indices in enumerate(grid.indices_in(block)):
        block_index = np.unravel_index(i, shape)
        march = None if existing_members[block_index] else march_of(grid, axis_indices)
        if march is None:
            continue
        file = folder / f"{record.input_digest(march)}.nc"
        digest, seal = intact_digests(file, partial(record.comes_of, march=march))
        if digest:
            clear_segments(file)  # left by a process that was stopped after finishing the file
        else:
            digest, seal = _stream_member(march, file, read_back=not has_read)
            has_read = True
            if differences := _differences_text(march, {name: values[block_index] for name, values in arrays.items()}):
                raise InputError(
                    f"member {grid.member_name(axis_indices)}: {differences}: this is a fault of xdynamics; please report it"
                )
        arrays[FILE][block_index], arrays[DIGEST][block_index], arrays[SEAL][block_index] = (
            f"{folder.name}/{file.name}",
            digest,
            seal,
        )


def _stream_member(march: March, file: Place, *, read_back: bool) -> tuple[str, str]:
    """March a member into its file; where another worker did so meanwhile, take that."""
    try:
        file_digests = stream_to_writer(march, file, resume=has_segments(file), read_back=read_back)
    except TakenError:
        digest, seal = intact_digests(file, partial(record.comes_of, march=march))
        if not digest:
            raise
        return digest, seal
    return file_digests.digest, file_digests.seal


def _differences_text(march: March, abreast: dict[str, Any]) -> str:
    """Describe how a run marched alone differs from the same run marched side by side; empty if it does not."""
    march_state, state = (
        march.now,
        march.run.y[: march.layout.used.size] * record.factors(march.layout, march.settings.scales),
    )
    single_values: dict[str, Any] = dict(
        zip(COUNT_FUNCTIONS, (march.accepted, march_state.trials, march_state.evaluations), strict=True)
    )
    used = march.layout.used
    for block in used.blocks:
        state_index = used.offset_of(block.name)
        single_values[f"end_{block.name}"] = state[state_index : state_index + block.size].reshape(block.shape)
    return ", ".join(
        f"{name} is {value}, side by side {abreast[name]}"
        for name, value in single_values.items()
        if name in abreast and not np.array_equal(abreast[name], value)
    )


def intact_digests(file: Place, is_expected: Callable[[xr.Dataset], bool]) -> tuple[str, str]:
    """Return content digest and seal of a file that is intact and the wanted one; empty texts otherwise."""
    store = store_of(file)
    with suppress(ArchiveError, InputError):
        if store.kind(file) is None:
            local_file = store.local_file(file)
            digest, seal = verify_digests(file).digest, tail_of(local_file.path).digest
            with open_run(file, check=False) as run:
                return (digest, seal) if seal and is_expected(run) else ("", "")
    return "", ""
