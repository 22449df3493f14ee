"""A sweep in a folder: blocks as they are done, then one catalogue of all members, and whole runs beside it."""

from __future__ import annotations

import fcntl
import json
import os
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from xdynamics import archive
from xdynamics.archive import leftovers
from xdynamics.archive.reading import values_of
from xdynamics.archive.seals import tail_of
from xdynamics.archive.target import taking_name
from xdynamics.evidence.exhibit import exhibit
from xdynamics.faults import ArchiveError, InputError, numbered
from xdynamics.files import asked, made_folder
from xdynamics.schema import EVIDENCE, SWEEP
from xdynamics.sweeping.additions import Additions, additions
from xdynamics.sweeping.collection import DIGEST, collected, with_axes
from xdynamics.sweeping.files import archived, digests_of
from xdynamics.sweeping.members import DIGEST as DIGEST_OF_RUN
from xdynamics.sweeping.members import DIGITS, FILE, LONGEST_WORD, OUTCOME, SEAL, STOPPED_BY, Block, Plan, marched
from xdynamics.sweeping.tasks import Chunks, blocks_of, chunks_of

if TYPE_CHECKING:
    import xarray as xr

CATALOGUE = "catalogue.nc"
UNFINISHED = ".unfinished"
CUT = "blocks.json"  # how many members along each axis the parts hold
RUNS = "runs"
PART, BLOCK = "sweep part", "sweep_block"
LONG = 64  # digits of a whole sha256
Progress = Callable[[float, float, int], None]


REMEDY = f"remove what is damaged or added and '{CATALOGUE}', and the same sweep marches what is missing"


def open_sweep(path: str | Path) -> xr.Dataset:
    """Open the catalogue of a sweep, verified: every member with its axes, outcome, digest and what was kept of it.

    Parameters
    ----------
    path : str or Path
        The folder that `sweep` marched into.

    Raises
    ------
    InputError
        If there is none, or it is not finished: the same `sweep` goes on with it.
    ArchiveError
        If the catalogue is damaged.

    Notes
    -----
    Of a sweep with ``keep=["log"]``, `member` opens one run; `ragged` gives the rows of all behind each other, and
    ``sweep(found, keep=["y"], times=[…])`` all on common times, without the files. xarray itself opens a folder of runs
    as rows behind each other, one file after the other (``parallel=True`` breaks the netCDF library)::

        xr.open_mfdataset("folder/runs/*.nc", engine="netcdf4", combine="nested", concat_dim="step", parallel=False,
                          preprocess=lambda run: run[["time", "y", "v_y"]], decode_times=False)
    """
    folder = Path(path)
    file = folder / CATALOGUE
    if not file.is_file() and (folder / UNFINISHED).is_dir():
        raise InputError(f"the sweep in '{folder}' is not finished; call the same sweep again, and it goes on")
    if not file.is_file():
        raise InputError(
            f"'{folder}' holds no sweep: there is no {CATALOGUE} in it; name the folder that sweep marched into"
        )
    try:
        opened = archive.open_run(file)
    except ArchiveError as error:
        raise ArchiveError(f"{error}\n{REMEDY}", error.faults) from None
    if opened.attrs.get(EVIDENCE) != SWEEP:
        raise ArchiveError(f"'{file}' is no catalogue of a sweep")
    found = with_axes(_with_words(opened))
    found.set_close(opened._close)  # noqa: SLF001 - by which a Dataset that xarray made of another would not be closed
    found.encoding["source"] = str(file.absolute())
    return found


def _with_words(found: xr.Dataset) -> xr.Dataset:
    """Have words and digests of members as lazy arrays of texts of one width, as they were before they were saved."""
    widths = {OUTCOME: LONGEST_WORD, SEAL: LONG, FILE: LONG + len(f"{RUNS}/.nc")}
    if DIGEST_OF_RUN in found:
        widths[DIGEST_OF_RUN] = LONG if FILE in found else DIGITS
    for name in {*widths, STOPPED_BY} & {*found.data_vars}:
        texts = found[name].variable
        if name not in widths or not texts.ndim:
            words = np.asarray(texts).astype(str)
        else:
            each = texts.chunk(dict(texts.sizes))
            words = each.data.astype(np.dtype(f"U{widths[name]}"))
        found[name] = texts.dims, words, texts.attrs
    return found


def verify(path: str | Path) -> str:
    """Compare an archive with its digests, or the folder of a sweep with its catalogue's; return the content digest.

    Raises
    ------
    InputError
        If there is no such file, or it is none: a pipe, a socket, a device, a directory that holds no sweep.
    ArchiveError
        Naming every variable that differs from its digest; of a sweep every file.

    Warns
    -----
    KindWarning
        If the file is as it was written, and holds a selection of a run or derived data.
    """
    path = Path(path)
    is_sweep = asked(path, Path.is_dir) and ((path / CATALOGUE).exists() or (path / UNFINISHED).exists())
    return verify_sweep(path)[0] if is_sweep else archive.verify(path)


def verify_sweep(path: str | Path) -> tuple[str, int]:
    """Verify a sweep's catalogue, and of every whole run all bytes of its file, by the seal that the catalogue tells.

    Returns
    -------
    tuple of str and int
        Content digest of the catalogue, and how many files of runs there are.

    Raises
    ------
    ArchiveError
        Naming every file that is damaged, missing or of another run.
    """
    folder = Path(path)
    digest = archive.verify(folder / CATALOGUE) if (folder / CATALOGUE).is_file() else ""
    with open_sweep(folder) as sweep:
        faults, files = _faults(folder, sweep), int(sweep[FILE].size) if FILE in sweep else 0
    if faults:
        raise _damaged(folder, faults)
    return digest, files


def _damaged(folder: Path, faults: list[str]) -> ArchiveError:
    return ArchiveError(f"'{folder}' is damaged:{numbered(faults)}\n{REMEDY}", tuple(faults))


def _faults(folder: Path, sweep: xr.Dataset) -> list[str]:
    """Compare the files of whole runs with the seals that the catalogue tells; name those that are none of its runs.

    Where members are being added, or were until their process was stopped, other runs are theirs.
    """
    if FILE not in sweep:
        return []
    named = dict(zip(map(str, sweep[FILE].values.ravel()), map(str, sweep[SEAL].values.ravel()), strict=True))
    named.pop("", None)  # of members whose models are refused
    there = (
        {f"{RUNS}/{one.name}" for one in (folder / RUNS).iterdir() if not one.name.startswith(".")}
        if (folder / RUNS).is_dir()
        else set()
    )
    others = [] if unfinished(folder) else sorted(there - {*named})
    added = [f"{name} is no run of the sweep" for name in others]
    with ThreadPoolExecutor() as pool:
        return [one for one in pool.map(partial(_fault_of, folder), named.items()) if one] + added


def _fault_of(folder: Path, named: tuple[str, str]) -> str:
    """Say what is wrong with the file of a run, whose seal the catalogue tells."""
    name, seal = named
    try:
        found = tail_of(folder / name)
    except FileNotFoundError:
        return f"{name} is missing"
    except OSError as error:
        return f"{name} cannot be read: {error.strerror or error}"
    if found.digest == seal:
        return ""
    return f"{name}: {found.fault or f'its seal is {found.digest or None}, in the catalogue {seal}'}"


def filled(plan: Plan, members: int | None, folder: Path, progress: Progress | None) -> xr.Dataset:
    """March a sweep into a folder, or what of it is not there, and return its catalogue.

    Parameters
    ----------
    plan : Plan
    members : int, optional
        Of a task; what was begun goes on in the tasks that it was begun in.
    folder : Path
    progress : callable, optional

    Raises
    ------
    InputError
        If the folder holds another sweep that is no part of this one, or is none.
    """
    for place in (made_folder(folder), folder / RUNS):
        leftovers.sweep(place)
    there = None
    if (folder / CATALOGUE).is_file():
        found = _whole(folder)
        _forget(folder, str(found.attrs[DIGEST]))  # of a process that was stopped when all was done
        if found.attrs[DIGEST] == plan.digest:
            return found
        there = additions(plan, found, folder / CATALOGUE)
        found.close()
        archive.check_target(folder / CATALOGUE)  # nobody reads what is to be replaced
    work = folder / UNFINISHED / _work(plan.digest)
    if others := [one for one in unfinished(folder) if one != work]:
        raise InputError(f"'{folder}' holds a part of another sweep, which the same call goes on with; name another folder, or give it up by removing '{others[0]}'")  # fmt: skip
    with _alone_in(made_folder(work)):
        blocks = [block for _, block in blocks_of(_begun(plan, members, work))]
        parts = [work / f"{_said(block)}.nc" for block in blocks]
        _march(plan, blocks, parts, progress, there)
        archive.save(collected(plan, _joined(plan, blocks, parts)), folder / CATALOGUE)
        _forget(folder, plan.digest)
    return open_sweep(folder)


def _forget(folder: Path, digest: str) -> None:
    """Remove the blocks of a sweep whose catalogue is whole; those of another one stay."""
    shutil.rmtree(folder / UNFINISHED / _work(digest), ignore_errors=True)
    with suppress(OSError):
        (folder / UNFINISHED).rmdir()


def _work(digest: str) -> str:
    return digest[:16]


def _whole(folder: Path) -> xr.Dataset:
    """Open a sweep that was marched before, with all its runs."""
    found = open_sweep(folder)
    if faults := _faults(folder, found):
        raise _damaged(folder, faults)
    return found


def unfinished(folder: Path) -> list[Path]:
    """List the folders of sweeps that were begun in a folder, and are not finished."""
    place = folder / UNFINISHED
    return sorted(one for one in place.iterdir() if one.is_dir()) if place.is_dir() else []


@contextmanager
def _alone_in(work: Path) -> Iterator[None]:
    """Keep other processes out of a folder that is marched into, as long as this one lives."""
    handle = os.open(work, os.O_RDONLY | os.O_CLOEXEC)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"another process marches into '{work.parents[1]}'; wait for it, or name another folder") from None  # fmt: skip
        except OSError:  # a file system without locks
            pass
        yield
    finally:
        os.close(handle)


def _begun(plan: Plan, members: int | None, work: Path) -> Chunks:
    """Return the cut that a sweep was begun with, whose blocks are there, or begin one."""
    file = work / CUT
    with suppress(OSError, ValueError, TypeError, OverflowError, RecursionError):  # none, or a damaged one
        found = tuple(tuple(map(int, one)) for one in json.loads(file.read_text()))
        if tuple(map(sum, found)) == plan.grid.shape and all(width > 0 for one in found for width in one):
            return found
    chunks = chunks_of(plan, members)
    with taking_name(file) as new:
        new.part.write_text(json.dumps(chunks))
    return chunks


def _march(plan: Plan, blocks: list[Block], parts: list[Path], progress: Progress | None, there: Additions | None) -> None:  # fmt: skip
    """March the blocks that are not there, on whatever schedules."""
    from dask import base
    from dask.delayed import delayed

    compute: Any = base.compute  # dask's functions are not typed
    todo = [(block, part) for block, part in zip(blocks, parts, strict=True) if not digests_of(part, partial(_is_part, plan, block))[0]]  # fmt: skip
    if not todo:
        return
    told, keep, known = delayed(plan), delayed(_keep), delayed(there)
    with _watching(parts, progress):
        compute(*(keep(told, list(block), str(part.absolute()), known) for block, part in todo))


def _keep(plan: Plan, block: Block, part: str, there: Additions | None) -> None:
    """March a block into a file of its own; whole runs into files of theirs, which go before; what is there is taken."""
    found = marched(plan, block, there.take) if there else marched(plan, block)
    if plan.keeping.whole:
        files = Path(part).parents[2] / RUNS
        files.mkdir(exist_ok=True)
        known = there.there(block) if there else np.zeros(plan.grid.shape_of(block), bool)
        archived(plan, block, files, found, known)
    variables = {one.name: ((*plan.grid.dims, *one.dims), found[one.name], one.attributes) for one in plan.variables}  # fmt: skip
    archive.save(exhibit(PART, plan.digest, [], variables, {DIGEST: plan.digest, BLOCK: _said(block)}), part)


def _is_part(plan: Plan, block: Block, part: xr.Dataset) -> bool:
    """Whether a file holds a block of a sweep, whatever it is named."""
    return part.attrs.get(DIGEST) == plan.digest and part.attrs.get(BLOCK) == _said(block)


def _said(block: Block) -> str:
    return "_".join(f"{one.start}-{one.stop}" for one in block)


def _joined(plan: Plan, blocks: list[Block], parts: list[Path]) -> dict[str, Any]:
    """Read the blocks into whole arrays; texts are bytes, and become texts a part at a time, as they are used."""
    import dask.array

    da: Any = dask.array  # its functions are not typed
    shapes = {one.name: (*plan.grid.shape, *one.sizes) for one in plan.variables}
    texts = {one.name: np.dtype(one.dtype) for one in plan.variables if np.dtype(one.dtype).kind == "U"}
    types = {one.name: one.dtype for one in plan.variables} | {name: f"S{one.itemsize // 4}" for name, one in texts.items()}  # fmt: skip
    found: dict[str, Any] = {name: np.empty(shape, types[name]) for name, shape in shapes.items()}
    for block, part in zip(blocks, parts, strict=True):
        values = values_of(part)
        for name, whole in found.items():
            whole[tuple(block)] = values[name]
    lazy = {name: _Texts(found[name], one) for name, one in texts.items()}
    return found | {name: da.from_array(one, chunks=one.shape, name=False) for name, one in lazy.items()}


class _Texts:
    """Bytes as an array of texts, of which those are made that are asked for."""

    def __init__(self, found: NDArray[Any], dtype: np.dtype[Any]) -> None:
        self.found, self.dtype, self.shape, self.ndim = found, dtype, found.shape, found.ndim

    def __getitem__(self, key: Any) -> NDArray[Any]:
        texts: NDArray[Any] = self.found[key].astype(self.dtype)
        return texts


class _watching:  # noqa: N801 - used as a statement
    """Tells how many blocks are done, by the files that are there: whoever marches them."""

    def __init__(self, parts: list[Path], progress: Progress | None) -> None:
        import threading

        self.parts, self.progress, self.over = parts, progress, threading.Event()
        self.thread = threading.Thread(target=self._tell, daemon=True) if progress else None

    def __enter__(self) -> None:
        if self.thread:
            self.thread.start()

    def __exit__(self, *_: object) -> None:
        self.over.set()
        if self.thread:
            self.thread.join()

    def _tell(self) -> None:
        while not self.over.wait(1.0):
            done = sum(part.is_file() for part in self.parts)
            if self.progress:
                self.progress(done / len(self.parts), 0.0, done)
