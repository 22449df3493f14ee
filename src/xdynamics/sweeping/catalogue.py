"""A sweep in a folder: finished blocks, then one catalogue of all members, with complete runs beside it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.archive.folder_store import (
    check_target,
    has_archive,
    is_folder,
    is_zarr,
    made_folder,
    store_of,
    taking_name,
)
from xdynamics.archive.integrity_checks import DAMAGED, Examination
from xdynamics.archive.reading import read_values
from xdynamics.archive.sandboxed_reading import know
from xdynamics.archive.seals import tail_of
from xdynamics.archive.shared_handles import keep_open
from xdynamics.archive.store import METADATA, NOTES, ZARR, Address, Given, LockedError, Place, TakenError, location_of
from xdynamics.archive.zarr_archive import complete_replacement
from xdynamics.evidence.evidence_dataset import attrs_of, evidence_dataset
from xdynamics.faults import ArchiveError, InputError, numbered_lines
from xdynamics.schema import EVIDENCE, SWEEP
from xdynamics.sweeping.additions import Additions, existing_additions
from xdynamics.sweeping.collection import DIGEST, sweep_dataset, with_axes
from xdynamics.sweeping.kept_quantities import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.kept_quantities import OUTCOME, STOPPED_BY
from xdynamics.sweeping.member import run_path
from xdynamics.sweeping.members import (
    DIGITS,
    FILE,
    LONGEST_WORD,
    RUNS,
    SEAL,
    Block,
    Plan,
    archive_members,
    intact_digests,
    march_block,
)
from xdynamics.sweeping.tasks import Chunks, blocks_of, measured_chunks
from xdynamics.sweeping.zarr_sweep import write_zarr_sweep

if TYPE_CHECKING:
    import xarray as xr

CATALOGUE = "catalogue.nc"
UNFINISHED = ".unfinished"
PART, BLOCK = "sweep part", "sweep_block"
SHA256_DIGITS = 64  # digits of a full sha256


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
                f"another process writes into '{folder}'; wait for it, or name another folder ({error})"
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


def _remedy(folder: Place) -> str:
    """Return what is to be done with a damaged sweep."""
    removed = f"'{folder}'" if folder.suffix == ZARR else f"what is damaged or added and '{CATALOGUE}'"
    return f"remove {removed}, and the same sweep computes what is missing"


def open_sweep(path: Given) -> xr.Dataset:
    """Open and verify the catalogue of a sweep: every member with its axes, outcome, digest and variables.

    Parameters
    ----------
    path : str or Path
        The folder that `sweep` marched into, or ``"s3://bucket/folder"``; or a Zarr store, ``"grid.zarr"``, whose members
        are dask arrays.

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
    folder = location_of(path)
    file = _catalogue_of(folder)
    is_there = has_archive(file)
    if not is_there and unfinished_folders(folder):
        raise InputError(f"the sweep in '{folder}' is not finished; call the same sweep again, and it goes on")
    if not is_there:
        missing = f"{NOTES}/digests.json" if file == folder else CATALOGUE
        raise InputError(f"'{folder}' holds no sweep: there is no {missing} in it; name what sweep wrote into")
    try:
        archived_sweep = archive.open_run(file, chunks={} if is_zarr(file) else None)
    except ArchiveError as error:
        between = "\n" if "\n" in str(error) else "; "
        raise ArchiveError(f"{error}{between}{_remedy(folder)}", error.faults, error.verdict) from None
    if archived_sweep.attrs.get(EVIDENCE) != SWEEP:
        raise ArchiveError(f"'{file}' is no catalogue of a sweep")
    sweep = with_axes(_with_words(archived_sweep))
    sweep.set_close(archived_sweep._close)  # noqa: SLF001 - a Dataset that xarray derives does not close its file
    # a file in the folder, in which the archives of whole runs are found
    sweep.encoding["source"] = str((file / METADATA if file == folder else file).absolute())
    return sweep


def is_sweep_folder(location: Place) -> bool:
    """Whether a location is a folder, and not the Zarr store of another record: what `open_sweep` opens, or says why not."""
    if location.suffix != ZARR or not is_folder(location) or unfinished_folders(location) or not has_archive(location):
        return is_folder(location)
    with archive.open_run(location, check=False) as record:
        return record.attrs.get(EVIDENCE) == SWEEP


def _catalogue_of(folder: Place) -> Place:
    """Return the archive of a sweep's members: the Zarr store itself, or a file in the folder."""
    return folder if folder.suffix == ZARR else folder / CATALOGUE


def _unfinished_of(folder: Place) -> Place:
    """Return the folder of unfinished sweeps."""
    return folder / NOTES / UNFINISHED[1:] if folder.suffix == ZARR else folder / UNFINISHED


def _is_file(path: Place) -> bool:
    return store_of(path).kind(path) is None


def _with_words(sweep: xr.Dataset) -> xr.Dataset:
    """Return words and digests of members as lazy arrays of fixed-width texts, as they were before saving."""
    widths = {OUTCOME: LONGEST_WORD, SEAL: SHA256_DIGITS, FILE: SHA256_DIGITS + len(f"{RUNS}/.nc")}
    if DIGEST_OF_RUN in sweep:
        widths[DIGEST_OF_RUN] = SHA256_DIGITS if FILE in sweep else DIGITS
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

    location = location_of(path)
    is_sweep = is_sweep_folder(location) and (
        has_archive(_catalogue_of(location)) or bool(unfinished_folders(location))
    )
    examination = verify_sweep(location)[0] if is_sweep else archive.verify(location)
    answer = {
        "verdict": (
            (),
            examination.verdict,
            attrs_of("1", "verified: as it was written; repacked: every number agrees", "verdict"),
        ),
        "digest": ((), examination.digest, attrs_of("1", "content digest, a sha256", "digest")),
    }
    return xr.Dataset(answer, attrs={"title": f"verification of {location.name}", "archive": str(path)})


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
    folder = location_of(path)
    catalogue = _catalogue_of(folder)
    examination = archive.verify(catalogue) if has_archive(catalogue) else Examination(())
    with open_sweep(folder) as sweep:
        faults, files = _faults_of_run_files(folder, sweep), int(sweep[FILE].size) if FILE in sweep else 0
    if faults:
        raise _damaged(folder, faults)
    return examination, files


def _damaged(folder: Place, faults: list[str]) -> ArchiveError:
    return ArchiveError(f"'{folder}' is damaged:{numbered_lines(faults)}\n{_remedy(folder)}", tuple(faults), DAMAGED)


def _faults_of_run_files(folder: Place, sweep: xr.Dataset) -> list[str]:
    """Compare archived runs with the seals in the catalogue; name files that are not among its runs.

    Extra runs are allowed while members are being added, or where adding them was interrupted.
    """
    if FILE not in sweep:
        return []
    seals = dict(zip(map(str, sweep[FILE].values.ravel()), map(str, sweep[SEAL].values.ravel()), strict=True))
    seals.pop("", None)  # of members whose models are refused
    entries = store_of(folder).names(folder / RUNS)
    present_names = {f"{RUNS}/{entry.name}" for entry in entries if not entry.name.startswith(".")}
    foreign_names = [] if unfinished_folders(folder) else sorted(present_names - {*seals})
    foreign_faults = [f"{name} is no run of the sweep" for name in foreign_names]
    with ThreadPoolExecutor() as pool:
        return [
            entry for entry in pool.map(partial(_fault_of_run_file, folder), seals.items()) if entry
        ] + foreign_faults


def _fault_of_run_file(folder: Place, name_and_seal: tuple[str, str]) -> str:
    """Describe the fault of a run's archive by its seal in the catalogue; empty if there is none."""
    name, seal = name_and_seal
    try:
        run_file = run_path(folder, name)
        if not _is_file(run_file):
            return f"{name} is missing"
        local_file = store_of(folder).local_file(run_file)
        tail = tail_of(local_file.path)
    except ArchiveError as error:
        return str(error)
    except OSError as error:
        return f"{name} cannot be read: {error.strerror or error}"
    if tail.digest == seal:
        return ""
    return f"{name}: {tail.fault or f'its seal is {tail.digest or None}, in the catalogue {seal}'}"


def march_into_folder(plan: Plan, members: int | None, folder: Place, progress: Progress | None) -> xr.Dataset:
    """March the missing members of a sweep into a folder or a Zarr store, and return its catalogue.

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
    _check_reach(folder)
    store, catalogue, existing = store_of(folder), _catalogue_of(folder), None
    if catalogue == folder:
        if isinstance(folder, Path):
            made_folder(folder.parent)
        check_target(folder)
    for required_folder in (store.made_folder(folder), folder / RUNS):
        store.clear(required_folder)
    if has_archive(catalogue):
        sweep = _open_intact(folder)
        _remove_blocks(
            folder, str(sweep.attrs[DIGEST])
        )  # left by a process that was stopped after saving the catalogue
        if catalogue == folder:
            complete_replacement(folder)
        if sweep.attrs[DIGEST] == plan.digest:
            return sweep
        existing = existing_additions(plan, sweep, catalogue, partial(archive.open_run, check=False))
        sweep.close()
        if isinstance(catalogue, Path) and catalogue != folder:
            keep_open(catalogue)  # whoever reads the smaller sweep goes on with its file, which loses its name
    work = _unfinished_of(folder) / _work_name(plan.digest)
    for other_work in unfinished_folders(folder):
        if other_work != work:
            with lock_folder(other_work, folder):  # refused in other words while that one is written
                raise InputError(_other_part_text(folder, other_work, has_catalogue=existing is not None))
    with lock_folder(store.made_folder(work), folder):
        blocks = [block for _, block in blocks_of(saved_or_new_chunks(plan, members, work))]
        parts = [work / f"{block_name(block)}.nc" for block in blocks]
        new = _march_missing_blocks(plan, blocks, parts, progress, existing, folder.absolute())
        if catalogue == folder:
            write_zarr_sweep(plan, blocks, parts, folder)
        else:
            arrays = _join_blocks(plan, blocks, parts)
            if SEAL in arrays and existing is None:
                _remember_seals(np.asarray(arrays[SEAL]), new)
            archive.save(sweep_dataset(plan, arrays), catalogue)
        # only now: blocks are all there is of the sweep until its catalogue has its name
        _remove_blocks(folder, plan.digest)
    return open_sweep(folder)


def _other_part_text(folder: Place, work: Place, *, has_catalogue: bool) -> str:
    """Return how to go on where a part of another sweep stands in a folder."""
    how = (
        f"'{work}' (`xdynamics verify {folder}` then names the runs that it left)"
        if has_catalogue
        else f"'{folder}' whole"
    )
    return (
        f"'{folder}' holds a part of another sweep, which the same call goes on with; name another folder, or give it up"
        f" by removing {how}"
    )


def _check_reach(folder: Place) -> None:
    """Check that all processes that march reach the folder."""
    import dask.config

    is_memory = isinstance(folder, Address) and folder.scheme == "memory"
    if is_memory and dask.config.get("scheduler", None) in ("processes", "multiprocessing", "dask.distributed"):
        raise InputError(
            f"'{folder}' is in the memory of this process, and dask computes in others; name a folder, or compute here:"
            " dask.config.set(scheduler='threads')"
        )


def _remove_blocks(folder: Place, digest: str) -> None:
    """Remove the blocks of a sweep whose catalogue is complete; those of another sweep stay."""
    store = store_of(folder)
    store.remove_folder(_unfinished_of(folder) / _work_name(digest))
    with suppress(OSError, ArchiveError):
        store.remove(_unfinished_of(folder))


def _work_name(digest: str) -> str:
    return digest[:16]


def _open_intact(folder: Place) -> xr.Dataset:
    """Open an existing sweep, checking that all its runs are intact."""
    sweep = open_sweep(folder)
    if faults := _faults_of_run_files(folder, sweep):
        raise _damaged(folder, faults)
    return sweep


def unfinished_folders(folder: Place) -> list[Place]:
    """List the folders of unfinished sweeps in a folder, or in a Zarr store."""
    return [entry for entry in store_of(folder).names(_unfinished_of(folder)) if is_folder(entry)]


def _march_missing_blocks(
    plan: Plan,
    blocks: list[Block],
    parts: list[Place],
    progress: Progress | None,
    existing: Additions | None,
    folder: Place,
) -> list[Block]:
    """March the missing blocks, on whichever dask scheduler is active, and return them."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # dask's functions are not typed
    todo = [
        (block, part)
        for block, part in zip(blocks, parts, strict=True)
        if not intact_digests(part, partial(_is_part, plan, block))[0]
    ]
    if not todo:
        return []
    delayed_plan, delayed_keep, delayed_existing = delayed(plan), delayed(_march_block_into_file), delayed(existing)
    with watch_blocks(parts, progress):
        compute(
            *(
                delayed_keep(delayed_plan, list(block), part.absolute(), delayed_existing, folder)
                for block, part in todo
            )
        )
    return [block for block, _ in todo]


def _remember_seals(seals: NDArray[Any], blocks: list[Block]) -> None:
    """Remember the seals of the runs of some blocks, which the workers of this call wrote or examined."""
    for block in blocks:
        for seal in filter(None, seals[tuple(block)].ravel().tolist()):
            know(str(seal))


def _march_block_into_file(plan: Plan, block: Block, part: Place, existing: Additions | None, folder: Place) -> None:
    """March a block into a file, after archiving its complete runs; existing members are copied."""
    values = march_block(plan, block, existing.copy_existing) if existing else march_block(plan, block)
    if plan.keeping.keeps_whole_runs:
        files = made_folder(folder / RUNS)
        existing_mask = existing.existing_members(block) if existing else np.zeros(plan.grid.block_shape(block), bool)
        archive_members(plan, block, files, values, existing_mask)
    variables = {
        variable.name: ((*plan.grid.dims, *variable.dims), values[variable.name], variable.attributes)
        for variable in plan.variables
    }
    block_dataset = evidence_dataset(PART, plan.digest, [], variables, {DIGEST: plan.digest, BLOCK: block_name(block)})
    try:
        archive.save(block_dataset, part)
    except TakenError:  # another worker was given the same block, and was faster
        if not intact_digests(part, partial(_is_part, plan, block))[0]:
            raise


def _is_part(plan: Plan, block: Block, part: xr.Dataset) -> bool:
    """Whether a file holds a given block of a sweep, regardless of its name."""
    return part.attrs.get(DIGEST) == plan.digest and part.attrs.get(BLOCK) == block_name(block)


def _join_blocks(plan: Plan, blocks: list[Block], parts: list[Place]) -> dict[str, Any]:
    """Read the blocks into full arrays; texts are stored as bytes and decoded lazily, part by part."""
    import dask.array

    da: Any = dask.array  # its functions are not typed
    shapes = {entry.name: (*plan.grid.shape, *entry.sizes) for entry in plan.variables}
    texts = {entry.name: np.dtype(entry.dtype) for entry in plan.variables if np.dtype(entry.dtype).kind == "U"}
    types = {entry.name: entry.dtype for entry in plan.variables} | {
        name: f"S{entry.itemsize // 4}" for name, entry in texts.items()
    }
    arrays: dict[str, Any] = {name: np.empty(shape, types[name]) for name, shape in shapes.items()}
    for block, part in zip(blocks, parts, strict=True):
        values = read_values(part)
        for name, array in arrays.items():
            array[tuple(block)] = values[name]
    lazy = {name: _Texts(arrays[name], entry) for name, entry in texts.items()}
    # name=False: dask would read and hash all bytes to make a name of them
    return arrays | {name: da.from_array(entry, chunks=entry.shape, name=False) for name, entry in lazy.items()}


class _Texts:
    """An array of bytes that is decoded into texts where it is indexed."""

    def __init__(self, characters: NDArray[Any], dtype: np.dtype[Any]) -> None:
        self.characters, self.dtype, self.shape, self.ndim = characters, dtype, characters.shape, characters.ndim

    def __getitem__(self, key: Any) -> NDArray[Any]:
        texts: NDArray[Any] = self.characters[key].astype(self.dtype)
        return texts
