"""Files of opened runs: which are open, which are let go, and which file each of them is."""

from __future__ import annotations

import gc
import os
import pickle
import shutil
from pathlib import Path
from typing import Any

import pytest

import xdynamics as xd
from cases.problems import oscillator
from xdynamics.archive import netcdf_library, shared_handles
from xdynamics.archive.shared_handles import SharedArchive, identity_of, is_still_read, open_shared
from xdynamics.faults import ArchiveError


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive for all tests, which only read it."""
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path_factory.mktemp("lending") / "run.nc")


@pytest.fixture(autouse=True)
def nothing_open() -> None:
    """Let go of what earlier tests opened."""
    gc.collect()
    shared_handles._close_all_archives()


def test_what_was_used_longest_ago_is_closed(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of many files those stay open that were read last, and that all can be read."""
    monkeypatch.setattr(shared_handles, "MOST_OPEN", 2)
    first, second, third = (SharedArchive(archived) for _ in range(3))
    a, b = first.acquire(), second.acquire()
    assert first.acquire() is a
    third.acquire()
    assert list(shared_handles._open) == [id(first), id(third)]
    assert (a.isopen(), b.isopen()) == (True, False)
    with second.acquire_context() as again:
        assert again.isopen()
    assert again.isopen()
    assert list(shared_handles._open) == [id(third), id(second)]


def test_a_file_is_found_again_from_elsewhere(archived: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert that a relative name means the file that it meant when it was opened, and is the one a record names."""
    monkeypatch.chdir(archived.parent)
    run = xd.open_run("run.nc")
    assert run.encoding["source"] == "run.nc"
    monkeypatch.chdir(tmp_path)
    run.close()
    assert run.x.values.size == 11


def test_another_file_is_closed_again(archived: Path, tmp_path: Path) -> None:
    """Assert that a file which is not the one that was opened is neither read nor held."""
    path, opened = Path(shutil.copy(archived, tmp_path / "run.nc")), []
    device, *rest = identity_of(path)
    assert SharedArchive(path, (device + 1, *rest)).acquire().isopen()
    for other in (
        (device, rest[0] + 1, *rest[1:]),
        (device, rest[0], rest[1] + 1, rest[2]),
        (device, *rest[:2], rest[2] + 1),
    ):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(shared_handles, "file_at", opened.append)
            with pytest.raises(ArchiveError, match="run.nc' is another file than the one that was opened; open it"):
                SharedArchive(path, other).acquire()
        assert opened == []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            shared_handles,
            "file_at",
            lambda path: opened.append(netcdf_library.file_at(path)) or os.utime(path) or opened[-1],
        )
        with pytest.raises(ArchiveError, match="run.nc' is another file than the one that was opened; open it again"):
            SharedArchive(path).acquire()
    assert not opened[-1].isopen()
    assert list(shared_handles._open) == []


def test_a_name_that_others_take_is_asked_for_again(archived: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a file is opened anew while its name goes to others, for a while."""
    acquire, tried = SharedArchive.acquire, []

    def taken(one: SharedArchive, needs_lock: bool = True) -> Any:
        tried.append(one)
        if len(tried) < times:
            raise ArchiveError("is another file")
        return acquire(one, needs_lock)

    monkeypatch.setattr(SharedArchive, "acquire", taken)
    times = shared_handles.MOST_REPLACED
    open_shared(archived).close()
    assert len({id(one) for one in tried[:times]}) == times
    tried.clear()
    times = shared_handles.MOST_REPLACED + 1
    with pytest.raises(ArchiveError, match="is another file"):
        open_shared(archived)
    assert len(tried) == shared_handles.MOST_REPLACED


@pytest.mark.dear
def test_a_file_is_lent_until_nobody_can_read_it(archived: Path, tmp_path: Path) -> None:
    """Assert that it is told of this file alone, by whatever name, and not of runs that are closed, gone or in memory."""
    (tmp_path / "link.nc").symlink_to(archived)
    other = Path(shutil.copy(archived, tmp_path / "other.nc"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            shared_handles.gc, "collect", lambda: 1 / 0
        )  # nobody waits for it where there is nothing to collect
        assert not is_still_read(archived)
    run = xd.open_run(archived)
    again = xd.open_run(archived)
    assert [is_still_read(one) for one in (archived, tmp_path / "link.nc", other, tmp_path / "none.nc")] == [
        True,
        True,
        False,
        False,
    ]
    again.close()
    assert is_still_read(archived)
    run.attrs["itself"] = run  # which waits to be collected
    del run
    assert not is_still_read(archived)
    assert again.x.values.size == 11
    assert not is_still_read(archived)


def test_closing_goes_with_a_run(archived: Path) -> None:
    """Assert that a run which was sent elsewhere and back closes its own file, and one in memory none."""
    run = xd.open_run(archived)
    sent = pickle.loads(pickle.dumps(run))
    assert sent.x.values.size == 11
    assert len(shared_handles._open) == 2
    sent.close()
    assert len(shared_handles._open) == 1
    assert run.x.values.size == 11
    (file,) = shared_handles._open.values()
    run.close()
    assert list(shared_handles._open) == []
    assert not file.isopen()
    closing = pickle.loads(pickle.dumps(shared_handles._Closing(None)))
    closing()


def test_values_are_lent_as_they_are_stored(tmp_path: Path) -> None:
    """Assert that nothing that a file says of scales, gaps and dates makes other numbers of those that it holds."""
    with netcdf_library.opened_file(tmp_path / "odd.nc", "w") as file:
        file.createDimension("n", 3)
        for name, about in (
            ("when", {"units": "days since 2000-01-01"}),
            ("scaled", {"scale_factor": 10.0, "missing_value": 2.0}),
        ):
            variable = file.createVariable(name, "f8", ("n",), fill_value=False)
            variable.set_auto_maskandscale(False)
            variable[:] = [1.0, 2.0, 3.0]
            variable.setncatts(about)
    with open_shared(tmp_path / "odd.nc") as run:
        assert {str(name): value.values.tolist() for name, value in run.items()} == {
            "when": [1, 2, 3],
            "scaled": [1, 2, 3],
        }


def test_in_the_end_every_file_is_closed(archived: Path) -> None:
    """Assert that what is open when the interpreter ends is closed, what finalisers left too."""
    runs = [xd.open_run(archived) for _ in range(3)]
    files = [*shared_handles._open.values()]
    del runs[0]
    shared_handles._close_all_archives()
    assert len(files) == 3
    assert not any(file.isopen() for file in files)
    assert (list(shared_handles._open), netcdf_library._files_to_close) == ([], [])
