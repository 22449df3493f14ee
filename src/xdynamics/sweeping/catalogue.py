"""A sweep in a folder: blocks as they are finished, then one catalogue of all members, with whole runs beside it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.archive.integrity_checks import DAMAGED, Examination
from xdynamics.archive.place import Given, Place, placed
from xdynamics.archive.reading import values_of
from xdynamics.archive.sandboxed_reading import know
from xdynamics.archive.seals import tail_of
from xdynamics.archive.shared_handles import keep_open
from xdynamics.archive.store import TakenError
from xdynamics.archive.stores import is_folder, made_folder, store_of
from xdynamics.evidence.evidence_dataset import about, exhibit
from xdynamics.faults import ArchiveError, InputError, numbered
from xdynamics.schema import EVIDENCE, SWEEP
from xdynamics.sweeping import zarr_catalogue, zarr_digests, zarr_opening
from xdynamics.sweeping.additions import Additions, additions
from xdynamics.sweeping.collection import DIGEST, collected, with_axes
from xdynamics.sweeping.kept_quantities import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.kept_quantities import OUTCOME, STOPPED_BY
from xdynamics.sweeping.member import place_of
from xdynamics.sweeping.member_files import RUNS, archived, digests_of
from xdynamics.sweeping.members import DIGITS, FILE, LONGEST_WORD, SEAL, Block, Plan, marched
from xdynamics.sweeping.stored_blocks import Progress, alone_in, begun, said, watching
from xdynamics.sweeping.tasks import blocks_of

if TYPE_CHECKING:
    import xarray as xr

CATALOGUE = "catalogue.nc"
UNFINISHED = ".unfinished"
PART, BLOCK = "sweep part", "sweep_block"
LONG = 64  # digits of a full sha256


REMEDY = f"remove what is damaged or added and '{CATALOGUE}', and the same sweep marches what is missing"


def open_sweep(path: Given) -> xr.Dataset:
    """Open and verify the catalogue of a sweep: every member with its axes, outcome, digest and kept variables.

    Parameters
    ----------
    path : str or Path
        The folder that `sweep` marched into, or ``"s3://bucket/folder"``; or a Zarr store, ``"grid.zarr"``.

    Raises
    ------
    InputError
        If there is no sweep, or it is not finished; the same call of `sweep` continues it.
    ArchiveError
        If the catalogue is damaged.

    Notes
    -----
    Of a sweep with ``keep=["log"]``, `member` opens one run; `ragged` concatenates the rows of all runs, and
    ``sweep(found, keep=["y"], times=[…])`` puts them on common times, without the files. xarray itself concatenates the
    rows of a folder of runs, reading one file after the other (``parallel=True`` breaks the netCDF library)::

        xr.open_mfdataset("folder/runs/*.nc", engine="netcdf4", combine="nested", concat_dim="step", parallel=False,
                          preprocess=lambda run: run[["time", "y", "v_y"]], decode_times=False)
    """
    folder = placed(path)
    if zarr_catalogue.is_one(folder):
        return zarr_opening.opened(folder)
    file = folder / CATALOGUE
    is_there = _is_file(file)
    if not is_there and is_folder(folder / UNFINISHED):
        raise InputError(f"the sweep in '{folder}' is not finished; call the same sweep again, and it goes on")
    if not is_there:
        raise InputError(
            f"'{folder}' holds no sweep: there is no {CATALOGUE} in it; name the folder that sweep marched into"
        )
    try:
        opened = archive.open_run(file)
    except ArchiveError as error:
        between = "\n" if "\n" in str(error) else "; "
        raise ArchiveError(f"{error}{between}{REMEDY}", error.faults, error.verdict) from None
    if opened.attrs.get(EVIDENCE) != SWEEP:
        raise ArchiveError(f"'{file}' is no catalogue of a sweep")
    sweep = with_axes(_with_words(opened))
    sweep.set_close(opened._close)  # noqa: SLF001 - a Dataset that xarray derives does not close its file
    sweep.encoding["source"] = str(file.absolute())
    return sweep


def _is_file(place: Place) -> bool:
    return store_of(place).kind(place) is None


def _with_words(sweep: xr.Dataset) -> xr.Dataset:
    """Return words and digests of members as lazy arrays of fixed-width texts, as they were before saving."""
    widths = {OUTCOME: LONGEST_WORD, SEAL: LONG, FILE: LONG + len(f"{RUNS}/.nc")}
    if DIGEST_OF_RUN in sweep:
        widths[DIGEST_OF_RUN] = LONG if FILE in sweep else DIGITS
    for name in {*widths, STOPPED_BY} & {*sweep.data_vars}:
        texts = sweep[name].variable
        if name not in widths or not texts.ndim:
            words = np.asarray(texts).astype(str)
        else:
            chunked = texts.chunk(dict(texts.sizes))
            words = chunked.data.astype(np.dtype(f"U{widths[name]}"))
        sweep[name] = texts.dims, words, texts.attrs
    return sweep


def verify(path: Given) -> xr.Dataset:
    """Compare an archive with its digests, or the folder of a sweep with its catalogue's.

    Returns
    -------
    xarray.Dataset
        ``verdict``: ``verified`` if every byte is as it was written, ``repacked`` if another program wrote the file and every
        number agrees (`save` seals it again). ``digest``: the content digest, of names, dimensions, types, units and values,
        which does not depend on the container; notes (history, comment, what tools add) are outside it.

    Raises
    ------
    InputError
        If there is no such file, or it is not a regular file (a pipe, a socket, a device) or a folder of a sweep.
    ArchiveError
        Naming every variable that differs from its digest; for a sweep, every file. Its ``verdict`` is ``edited`` where the
        file is sound, and ``damaged`` where its bytes are not those that were written.

    Warns
    -----
    KindWarning
        If the file is intact, and holds a selection of a run or derived data.
    """
    import xarray as xr

    place = placed(path)
    is_sweep = zarr_catalogue.is_one(place) or (
        is_folder(place) and (_is_file(place / CATALOGUE) or is_folder(place / UNFINISHED))
    )
    examination = verify_sweep(place)[0] if is_sweep else archive.verify(place)
    answer = {
        "verdict": (
            (),
            examination.verdict,
            about("1", "verified: as it was written; repacked: every number agrees", "verdict"),
        ),
        "digest": ((), examination.digest, about("1", "content digest, a sha256", "digest")),
    }
    return xr.Dataset(answer, attrs={"title": f"verification of {place.name}", "archive": str(path)})


def verify_sweep(path: Given) -> tuple[Examination, int]:
    """Verify a sweep's catalogue, and all bytes of every archived run by the seal in the catalogue.

    Returns
    -------
    tuple of Examination and int
        Verdict and content digest of the catalogue, and the number of archived runs.

    Raises
    ------
    ArchiveError
        Naming every file that is damaged, missing or belongs to another run.
    """
    folder = placed(path)
    if zarr_catalogue.is_one(folder):
        examination = Examination((), zarr_digests.verified(folder))
    else:
        examination = archive.verify(folder / CATALOGUE) if _is_file(folder / CATALOGUE) else Examination(())
    with open_sweep(folder) as sweep:
        faults, files = _faults(folder, sweep), int(sweep[FILE].size) if FILE in sweep else 0
    if faults:
        raise _damaged(folder, faults)
    return examination, files


def _damaged(folder: Place, faults: list[str]) -> ArchiveError:
    return ArchiveError(f"'{folder}' is damaged:{numbered(faults)}\n{REMEDY}", tuple(faults), DAMAGED)


def _faults(folder: Place, sweep: xr.Dataset) -> list[str]:
    """Compare archived runs with the seals in the catalogue; name files that are not among its runs.

    Extra runs are allowed while members are being added, or where adding them was interrupted.
    """
    if FILE not in sweep:
        return []
    seals = dict(zip(map(str, sweep[FILE].values.ravel()), map(str, sweep[SEAL].values.ravel()), strict=True))
    seals.pop("", None)  # of members whose models are refused
    entries = store_of(folder).names(folder / RUNS)
    present = {f"{RUNS}/{entry.name}" for entry in entries if not entry.name.startswith(".")}
    foreign = [] if unfinished(folder) else sorted(present - {*seals})
    foreign_faults = [f"{name} is no run of the sweep" for name in foreign]
    with ThreadPoolExecutor() as pool:
        return [entry for entry in pool.map(partial(_fault_of, folder), seals.items()) if entry] + foreign_faults


def _fault_of(folder: Place, name_and_seal: tuple[str, str]) -> str:
    """Describe what is wrong with the archive of a run, given its seal in the catalogue; empty if nothing is."""
    name, seal = name_and_seal
    try:
        place = place_of(folder, name)
        if not _is_file(place):
            return f"{name} is missing"
        held = store_of(folder).held(place)
        tail = tail_of(held.path)
    except ArchiveError as error:
        return str(error)
    except OSError as error:
        return f"{name} cannot be read: {error.strerror or error}"
    if tail.digest == seal:
        return ""
    return f"{name}: {tail.fault or f'its seal is {tail.digest or None}, in the catalogue {seal}'}"


def filled(plan: Plan, members: int | None, folder: Place, progress: Progress | None) -> xr.Dataset:
    """March a sweep into a folder or a Zarr store, or what is missing of it, and return its catalogue.

    Parameters
    ----------
    plan : Plan
    members : int, optional
        Members of a task; an interrupted sweep keeps the tasks that it began with.
    folder : Path, or name of a folder of objects
    progress : callable, optional

    Raises
    ------
    InputError
        If the path is no folder, or it holds another sweep that is no part of this one.
    """
    if zarr_catalogue.is_one(folder):
        zarr_catalogue.fill(plan, members, folder, progress)
        return zarr_opening.opened(folder)
    store = store_of(folder)
    for place in (store.made_folder(folder), folder / RUNS):
        store.clear(place)
    existing = None
    if _is_file(folder / CATALOGUE):
        sweep = _whole(folder)
        _forget(folder, str(sweep.attrs[DIGEST]))  # left by a process that was stopped after saving the catalogue
        if sweep.attrs[DIGEST] == plan.digest:
            return sweep
        existing = additions(plan, sweep, folder / CATALOGUE, partial(archive.open_run, check=False))
        sweep.close()
        if isinstance(catalogue := folder / CATALOGUE, Path):
            keep_open(catalogue)  # whoever reads the smaller sweep goes on with its file, which loses its name
    work = folder / UNFINISHED / _work(plan.digest)
    if others := [path for path in unfinished(folder) if path != work]:
        raise InputError(
            f"'{folder}' holds a part of another sweep, which the same call goes on with; name another folder, or give"
            f" it up by removing '{others[0]}'"
        )
    with alone_in(store.made_folder(work), folder):
        blocks = [block for _, block in blocks_of(begun(plan, members, work))]
        parts = [work / f"{said(block)}.nc" for block in blocks]
        new = _march(plan, blocks, parts, progress, existing)
        arrays = _joined(plan, blocks, parts)
        if SEAL in arrays and existing is None:
            _know(np.asarray(arrays[SEAL]), new)
        archive.save(collected(plan, arrays), folder / CATALOGUE)
        _forget(folder, plan.digest)
    return open_sweep(folder)


def _forget(folder: Place, digest: str) -> None:
    """Remove the blocks of a sweep whose catalogue is complete; those of another sweep stay."""
    store = store_of(folder)
    store.remove_folder(folder / UNFINISHED / _work(digest))
    with suppress(OSError, ArchiveError):
        store.remove(folder / UNFINISHED)


def _work(digest: str) -> str:
    return digest[:16]


def _whole(folder: Place) -> xr.Dataset:
    """Open an existing sweep, checking that all its runs are intact."""
    sweep = open_sweep(folder)
    if faults := _faults(folder, sweep):
        raise _damaged(folder, faults)
    return sweep


def unfinished(folder: Place) -> list[Place]:
    """List the folders of unfinished sweeps in a folder, or of what is being added to a Zarr store."""
    if zarr_catalogue.is_one(folder):
        return zarr_digests.growths(folder)
    return [place for place in store_of(folder).names(folder / UNFINISHED) if is_folder(place)]


def _march(
    plan: Plan, blocks: list[Block], parts: list[Place], progress: Progress | None, existing: Additions | None
) -> list[Block]:
    """March the missing blocks, on whichever dask scheduler is active, and return them."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # dask's functions are not typed
    todo = [
        (block, part)
        for block, part in zip(blocks, parts, strict=True)
        if not digests_of(part, partial(_is_part, plan, block))[0]
    ]
    if not todo:
        return []
    delayed_plan, delayed_keep, delayed_existing = delayed(plan), delayed(_keep), delayed(existing)
    with watching(parts, progress):
        compute(*(delayed_keep(delayed_plan, list(block), part.absolute(), delayed_existing) for block, part in todo))
    return [block for block, _ in todo]


def _know(seals: NDArray[Any], blocks: list[Block]) -> None:
    """Remember the seals of the runs of some blocks, which the workers of this call wrote or examined."""
    for block in blocks:
        for seal in filter(None, seals[tuple(block)].ravel().tolist()):
            know(str(seal))


def _keep(plan: Plan, block: Block, part: Place, existing: Additions | None) -> None:
    """March a block into a file, after archiving its whole runs in files of their own; existing members are copied."""
    values = marched(plan, block, existing.take) if existing else marched(plan, block)
    if plan.keeping.whole:
        files = made_folder(part.parent.parent.parent / RUNS)
        present = existing.there(block) if existing else np.zeros(plan.grid.shape_of(block), bool)
        archived(plan, block, files, values, present)
    variables = {
        variable.name: ((*plan.grid.dims, *variable.dims), values[variable.name], variable.attributes)
        for variable in plan.variables
    }
    kept = exhibit(PART, plan.digest, [], variables, {DIGEST: plan.digest, BLOCK: said(block)})
    try:
        archive.save(kept, part)
    except TakenError:  # another worker was given the same block, and was faster
        if not digests_of(part, partial(_is_part, plan, block))[0]:
            raise


def _is_part(plan: Plan, block: Block, part: xr.Dataset) -> bool:
    """Whether a file holds a given block of a sweep, regardless of its name."""
    return part.attrs.get(DIGEST) == plan.digest and part.attrs.get(BLOCK) == said(block)


def _joined(plan: Plan, blocks: list[Block], parts: list[Place]) -> dict[str, Any]:
    """Read the blocks into full arrays; texts are held as bytes and decoded lazily, part by part."""
    import dask.array

    da: Any = dask.array  # its functions are not typed
    shapes = {entry.name: (*plan.grid.shape, *entry.sizes) for entry in plan.variables}
    texts = {entry.name: np.dtype(entry.dtype) for entry in plan.variables if np.dtype(entry.dtype).kind == "U"}
    types = {entry.name: entry.dtype for entry in plan.variables} | {
        name: f"S{entry.itemsize // 4}" for name, entry in texts.items()
    }
    arrays: dict[str, Any] = {name: np.empty(shape, types[name]) for name, shape in shapes.items()}
    for block, part in zip(blocks, parts, strict=True):
        values = values_of(part)
        for name, array in arrays.items():
            array[tuple(block)] = values[name]
    lazy = {name: _Texts(arrays[name], entry) for name, entry in texts.items()}
    return arrays | {name: da.from_array(entry, chunks=entry.shape, name=False) for name, entry in lazy.items()}


class _Texts:
    """An array of bytes that is decoded into texts where it is indexed."""

    def __init__(self, characters: NDArray[Any], dtype: np.dtype[Any]) -> None:
        self.found, self.dtype, self.shape, self.ndim = characters, dtype, characters.shape, characters.ndim

    def __getitem__(self, key: Any) -> NDArray[Any]:
        texts: NDArray[Any] = self.found[key].astype(self.dtype)
        return texts
