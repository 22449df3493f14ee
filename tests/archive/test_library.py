"""The lock around the netCDF4 library: whatever threads and forks do with archives comes out as it does alone."""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import netCDF4
import pytest
import xarray as xr
from xarray.backends.netCDF4_ import NETCDF4_PYTHON_LOCK

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive import netcdf_library, shared_handles
from xdynamics.archive.netcdf_library import READ_CACHE, file_at, with_library_lock


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests, which only read it."""
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path_factory.mktemp("library") / "run.nc")


TOGETHER = """
import gc, sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified

folder, model = Path(sys.argv[1]), oscillator().model
made = xd.simulate(model, step=0.01, until=5.0)
shared = xd.save(made, folder / "shared.nc")
digest = xd.content_digest(made)

def work(number):
    path, kind = folder / f"{number}.nc", number % 7
    if kind == 0:
        return verified(shared)
    if kind == 1:
        return xd.content_digest(xd.open_run(xd.save(made, path)))
    if kind == 2:
        return xd.content_digest(xd.open_run(shared).chunk({"step": 40}).compute())
    if kind == 3:
        assert xd.reproduce(shared).attrs["identical"] == 1
        return digest
    if kind == 4:
        return xd.content_digest(xd.simulate(model, step=0.01, until=5.0, path=path))
    if kind == 5:
        assert xd.compare(xd.open_run(shared), made).attrs["identical"] == 1
        return digest
    run = xd.open_run(shared)
    run.x.values
    run = None
    gc.collect()
    return digest

with ThreadPoolExecutor(8) as pool:
    found = set(pool.map(work, range(int(sys.argv[2]))))
print(found == {digest})
"""


@pytest.mark.dear
def test_eight_threads_over_archives(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Assert that eight threads that save, open, read, verify, reproduce and stream neither crash nor mix up a number."""
    works = 42 if request.config.getoption("--whole") else 21
    done = subprocess.run(
        [sys.executable, "-c", TOGETHER, str(tmp_path), str(works)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        timeout=100,
    )
    assert (done.returncode, done.stdout) == (0, "True\n"), done.stderr


def waits(function: Callable[[], object], held: threading.Event) -> bool:
    """Tell whether a function waits until an event is set, in a thread of its own."""
    ended = threading.Event()
    thread = threading.Thread(target=lambda: (function(), ended.set()))
    thread.start()
    waited = not ended.wait(0.2)
    held.set()
    thread.join(20)
    return waited and ended.is_set()


def inside(held: threading.Event) -> threading.Thread:
    """Start a thread that is in the library until an event is set, or for a while."""
    taken = threading.Event()
    thread = threading.Thread(target=with_library_lock(lambda: (taken.set(), held.wait(10))))
    thread.start()
    taken.wait()
    return thread


def test_one_is_alone(archived: Path) -> None:
    """Assert that who is in the library may go into it again, and that other threads wait, xarray's own too."""
    assert with_library_lock(with_library_lock(lambda: 1))() == 1
    foreign = xr.open_dataset(archived, engine="netcdf4", decode_times=False)
    for function in (with_library_lock(lambda: None), foreign.x.load):
        held = threading.Event()
        thread = inside(held)
        assert waits(function, held)
        thread.join()


def test_who_reads_by_xarray_is_waited_for() -> None:
    """Assert that nobody comes into the library while somebody reads by xarray alone."""
    held, taken = threading.Event(), threading.Event()

    def read() -> None:
        with NETCDF4_PYTHON_LOCK:
            taken.set()
            held.wait(10)

    thread = threading.Thread(target=read)
    thread.start()
    taken.wait()
    assert waits(with_library_lock(lambda: None), held)
    thread.join()


@pytest.mark.dear
def test_the_interpreter_ends_without_a_word(archived: Path) -> None:
    """Assert that a run that is still open when a script ends says nothing of it."""
    script = (
        f"import xdynamics as xd\nrun = xd.open_run({str(archived)!r})\ntwice = run.x * 2\ndef kept(): return run\n"
    )
    done = subprocess.run([sys.executable, "-c", script], check=False, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_finaliser_does_not_wait(archived: Path) -> None:
    """Assert that a run is collected while another thread is in the library, and its file closed with the next."""
    run, held = xd.open_run(archived), threading.Event()
    thread = inside(held)
    del run
    gc.collect()
    assert netcdf_library._files_to_close
    held.set()
    thread.join()
    assert not shared_handles.is_still_read(archived)
    again = xd.open_run(archived)
    assert not netcdf_library._files_to_close
    again.close()


def test_a_fork_does_not_inherit_a_taken_lock(archived: Path) -> None:
    """Assert that a child can read although a thread of its parent was in the library as it was to be forked."""
    held = threading.Event()
    thread = inside(held)
    threading.Timer(0.2, held.set).start()
    child = os.fork()
    if not child:
        os._exit(0 if xd.open_run(archived, check=False).x.values.size else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    thread.join()


INTERRUPTED = """
import os, random, signal, sys, threading
from pathlib import Path
import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive.netcdf_library import _library_lock, with_library_lock

path, moments = Path(sys.argv[1]), random.Random(5)
run = xd.simulate(oscillator().model, step=0.01, until=5.0)
xd.save(run, path)
for _ in range(int(sys.argv[2])):
    try:
        threading.Timer(moments.uniform(0.0, 0.05), lambda: os.kill(os.getpid(), signal.SIGINT)).start()
        for _ in range(8):  # a finaliser may have swallowed it
            xd.save(run, path)
            xd.open_run(path).load()
    except KeyboardInterrupt:
        pass
    assert not _library_lock._is_owned()
    thread = threading.Thread(target=with_library_lock(lambda: None))
    thread.start()
    thread.join(10)
    assert not thread.is_alive()
    assert verified(path) == xd.content_digest(run)
"""


@pytest.mark.dear
def test_an_interrupt_leaves_nothing_locked(tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Assert that after Ctrl-C at 6 moments of saving and reading, with --whole 20, the library is free, and the archive whole."""
    rounds = 20 if request.config.getoption("--whole") else 6
    done = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(tmp_path / "run.nc"), str(rounds)],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])},
        timeout=100,
    )
    assert done.returncode == 0, done.stderr


def test_few_files_are_open_at_a_time(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that more runs can be open than files, and are read all the same."""
    monkeypatch.setattr(shared_handles, "MOST_OPEN", 2)
    runs = [xd.open_run(archived) for _ in range(5)]
    assert len(shared_handles._open) == 2
    assert {xd.content_digest(run) for run in runs} == {verified(archived)}


def test_an_opened_run_goes_to_another_process_and_back(archived: Path) -> None:
    """Assert that an opened run is pickled as the way to its file."""
    run = pickle.loads(pickle.dumps(xd.open_run(archived)))
    assert xd.content_digest(run) == verified(archived)
    run.close()


def test_another_file_under_the_name_is_told(tmp_path: Path) -> None:
    """Assert that a closed run is read again from its own file, and from no other that took the name."""
    made = xd.simulate(oscillator().model, step=0.1, until=1.0)
    path = xd.save(made, tmp_path / "run.nc")
    again, late = xd.open_run(path), xd.open_run(path)
    for run in (again, late):
        run.close()
    assert again.x.values[1] == made.x.values[1]
    xd.save(xd.simulate(oscillator().model, step=0.05, until=1.0), path)
    assert again.v_x.values[1] == made.v_x.values[1]  # it holds the file that has no name any more
    with pytest.raises(xd.ArchiveError, match="is another file than the one that was opened"):
        late.x.load()


def test_the_mask_of_the_process_is_left_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a new file has the mode that the mask gives it, without a change of the mask, which all threads share."""

    def refuse(mask: int) -> int:
        raise AssertionError(mask)

    before = os.umask(0o027)
    try:
        with monkeypatch.context() as patched:
            patched.setattr(os, "umask", refuse)
            path = xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path / "run.nc")
    finally:
        os.umask(before)
    assert path.stat().st_mode & 0o777 == 0o640


def test_a_close_that_fails_is_the_last_one(tmp_path: Path) -> None:
    """Assert that no finaliser closes again what the library could not: it would use memory that is free already."""
    file = netcdf_library.file_at(tmp_path / "run.nc", "w")
    file.createDimension("step", 2**62)  # more than HDF5 can lay out
    file.createVariable("x", "f8", ())
    with pytest.raises(RuntimeError, match="HDF error"):
        netcdf_library.close_file(file)
    assert not file.isopen()


def test_the_locks_are_xarrays_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that the two locks of xarray are found, in its order, and others taken while it is not imported."""
    assert netcdf_library._locks_of_xarray() == [lock.lock for lock in NETCDF4_PYTHON_LOCK.locks]
    monkeypatch.setitem(sys.modules, "xarray.backends.netCDF4_", None)
    first, second = netcdf_library._locks_of_xarray()
    assert first is not second
    assert not first.locked()
    assert with_library_lock(lambda: 1)() == 1


def test_a_fork_is_made_with_all_locks_and_frees_them() -> None:
    """Assert that nobody is in the library while a process forks, but who forks may be, and goes on being."""
    locks = netcdf_library._locks_of_xarray()
    netcdf_library._before_fork()
    assert netcdf_library._library_lock._is_owned()
    assert [lock.locked() for lock in locks] == [True, True]
    netcdf_library._after_fork()
    assert not netcdf_library._library_lock._is_owned()
    assert [lock.locked() for lock in locks] == [False, False]

    @with_library_lock
    def forking() -> bool:
        netcdf_library._before_fork()
        netcdf_library._after_fork()
        return netcdf_library._library_lock._is_owned()

    assert forking()
    assert not netcdf_library._library_lock._is_owned()


def test_a_file_says_its_own_name(archived: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that names of any bytes come out as they went in, absolute, as text of the system or in another encoding."""
    path = tmp_path / os.fsdecode(b"caf\xe9 \xc3\xa4.nc")
    path.write_bytes(archived.read_bytes())
    monkeypatch.chdir(tmp_path)
    with netcdf_library.opened_file(Path(path.name)) as file:
        assert file.filepath() == str(path)
        assert file.filepath("latin-1") == os.fsencode(path).decode("latin-1")
    assert not file.isopen()


def test_values_are_read_as_they_are_stored(tmp_path: Path) -> None:
    """Assert that no scale that a file names is applied, that its attributes are told, and that it is closed after an error."""
    with netcdf_library.opened_file(tmp_path / "new.nc", "w") as file:
        file.createDimension("n", 2)
        variable = file.createVariable("x", "i2", ("n",))
        variable.scale_factor = 10.0
        variable.set_auto_maskandscale(False)
        variable[:] = [1, 2]
    with suppress(KeyError), netcdf_library.opened_file(tmp_path / "new.nc") as file:
        assert netcdf_library.read_stored(file["x"], slice(1, 2)).tolist() == [2]
        assert netcdf_library.stored_attributes(file["x"]) == {"scale_factor": 10.0}
        raise KeyError
    assert not file.isopen()


def test_what_was_left_is_closed_before_the_next(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that files of finalisers are closed, those that are closed already too, and half-opened ones collected."""
    one, two = netcdf_library.file_at(archived), netcdf_library.file_at(archived)
    netcdf_library.close_file(one)
    for file in (one, two):
        netcdf_library.close_later(file)
    netcdf_library.close_file(netcdf_library.file_at(archived))
    assert not two.isopen()
    collected = []
    monkeypatch.setattr(netcdf_library.gc, "collect", lambda: collected.append(1))
    (odd := archived.with_name("odd.nc")).write_bytes(b"no archive")
    with pytest.raises(OSError, match="Unknown file format"):
        netcdf_library.file_at(odd)
    assert collected


def test_an_error_without_words_is_told_by_its_name() -> None:
    """Assert what is said of a file that could not be read."""
    assert [netcdf_library.error_text(one) for one in (OSError("odd"), MemoryError())] == ["odd", "MemoryError"]


def two_of_a_size(folder: Path) -> tuple[Path, Path]:
    """Save two runs of as many rows, whose files are of one size."""
    model = oscillator().model
    made = [xd.simulate(model, step=step, until=10 * step, force_samples="none") for step in (0.125, 0.25)]
    return xd.save(made[0], folder / "one.nc"), xd.save(made[1], folder / "two.nc")


def test_what_is_overwritten_while_it_is_open_is_told(tmp_path: Path) -> None:
    """Assert that a run gives no number of the archive that was copied over its own, and that one is opened as it is."""
    one, two = two_of_a_size(tmp_path)
    run, after = xd.open_run(one), xd.content_digest(xd.open_run(two))
    run.x.values  # noqa: B018 - now its file is open
    one.write_bytes(two.read_bytes())
    with pytest.raises(xd.ArchiveError, match="was overwritten while it was open"):
        run.v_x.load()
    assert verified(one) == after
    assert xd.content_digest(xd.open_run(one)) == after
    with pytest.raises(xd.ArchiveError, match="another file than the one that was opened"):
        run.a_x.load()


def test_what_is_kept_open_is_not_mixed(tmp_path: Path) -> None:
    """Assert that an archive copied over one that the library still has open is refused, not read with its structure."""
    one, two = two_of_a_size(tmp_path)
    run = xd.open_run(one)
    with one.open("rb"):  # as of a damaged file, which the library does not close
        one.write_bytes(two.read_bytes())
        with pytest.raises(xd.ArchiveError, match="was overwritten while this process had it open"):
            xd.open_run(one)
    run.close()
    assert xd.content_digest(xd.open_run(one)) == verified(two)


def test_little_of_a_read_file_is_kept_in_memory(archived: Path) -> None:
    """Assert that a variable of an opened archive may keep one chunk, and that the process's own setting is restored."""
    before = netCDF4.get_chunk_cache()
    file = file_at(archived)
    chunked = [variable for variable in file.variables.values() if variable.chunking() != "contiguous"]
    assert chunked
    assert {variable.get_var_chunk_cache()[0] for variable in chunked} == {READ_CACHE}
    assert netCDF4.get_chunk_cache() == before
    file.close()
