"""Many archives into an object store: several at once, and none under its name before all are there."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from datetime import timedelta
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.object_server import Way, bucket
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.archive import address_store
from xdynamics.archive.address_store import ADDRESSES
from xdynamics.archive.filesystems import ask, ask_s3
from xdynamics.archive.store import Address, TakenError, location_of

pytest.importorskip("s3fs")
pytest.importorskip("moto")
PENDULUM = xd.Model.from_toml(MODELS / "pendulum.toml")
COUNT = 6


@pytest.fixture(scope="module")
def store() -> Iterator[Way]:
    """An object store with the bucket `bucket`, and the way to it."""
    with bucket() as way:
        yield way


@pytest.fixture
def folder(store: Way, request: pytest.FixtureRequest) -> Address:  # noqa: ARG001 - it has to be there
    """A folder of this test's own, in which nothing is."""
    made = location_of(f"s3://bucket/{abs(hash(request.node.name)):x}")
    assert isinstance(made, Address)
    return made


def runs(until: float = 0.1) -> list[xr.Dataset]:
    """Short runs, each of another step."""
    return [xd.simulate(PENDULUM, method="rk4", step=0.01 + 0.001 * k, until=until) for k in range(COUNT)]


def digests(folder: Address) -> list[str]:
    """What is under the names of a folder, in order."""
    return [verified(str(place)) for place in ADDRESSES.names(folder)]


def contents(made: list[xr.Dataset]) -> list[str]:
    """The digests of some runs."""
    return [xd.content_digest(run) for run in made]


def uploads_in(folder: Address) -> list[str]:
    """The names of uploads into a folder that are not finished."""
    found = ask_s3(folder, "list_multipart_uploads", Prefix=folder.key).get("Uploads") or []
    return [str(entry["Key"]) for entry in found]


def left_in(folder: Address) -> list[str]:
    """All that is in a folder beside archives: locks and unfinished uploads."""
    return [path for path in ask(folder, "find") if not path.endswith(".nc")] + uploads_in(folder)


@pytest.mark.dear
def test_runs_are_saved_several_at_once(store: Way, folder: Address, tmp_path: Path) -> None:
    """Assert the files of `save`, new and replaced, sent at the same time, with nothing left there or here."""
    under_way, most, lock = [0], [0], threading.Lock()

    def counted(_: str, path: str) -> str:
        if "partNumber" in path:
            with lock:
                under_way[0] += 1
                most[0] = max(most[0], under_way[0])
            time.sleep(0.2)
            with lock:
                under_way[0] -= 1
        return ""

    (tmp_path / "copies").mkdir()
    for until in (0.1, 0.2):
        made = runs(until)
        with pytest.MonkeyPatch.context() as patch, store.going(counted):
            patch.setattr(tempfile, "tempdir", str(tmp_path / "copies"))
            places = xd.save_many(made, str(folder))
            assert not list((tmp_path / "copies").iterdir())
        assert [place.name for place in places] == [f"{k:06d}.nc" for k in range(COUNT)]
        assert digests(folder) == contents(made)
        assert left_in(folder) == []
    assert most[0] > 2


@pytest.mark.dear
def test_folders_and_stores_take_one_list(folder: Address, tmp_path: Path) -> None:
    """Assert that each run goes where its path says."""
    made = runs()
    paths = [tmp_path / "a.nc", str(folder / "b.nc"), tmp_path / "c.nc", str(folder / "d.nc")]
    assert [str(place) for place in xd.save_many(made[:4], paths)] == [*map(str, paths)]
    assert [verified(path) for path in paths] == contents(made[:4])


@pytest.mark.dear
@pytest.mark.parametrize("where", ["uploads", "partNumber=1"])
def test_if_one_cannot_be_sent_none_changes(store: Way, folder: Address, where: str) -> None:
    """Assert the old files, nothing begun that is left, and one line with the file's name and how many have theirs."""
    old = runs()
    xd.save_many(old, str(folder))

    def broken(_: str, path: str) -> str:
        return "500 InternalError" if "000003.nc" in path and where in path and sent.is_set() else ""

    sent = threading.Event()
    check = ADDRESSES.check_each

    def checked(places: Any) -> None:  # an upload is begun, and dropped, to find out whether a name may be written
        check(places)
        sent.set()

    with pytest.MonkeyPatch.context() as patch, store.going(broken):
        patch.setattr(ADDRESSES, "check_each", checked)
        with pytest.raises(xd.ArchiveError, match=r"000003.nc' .*; none of 6 files has its name, nothing is changed"):
            xd.save_many(runs(0.2), str(folder))
    assert digests(folder) == contents(old)
    assert left_in(folder) == []


@pytest.mark.dear
def test_a_store_that_fails_between_names_is_told(store: Way, folder: Address) -> None:
    """Assert that all but the one that failed are new, that it is the old one, whole, and that the line counts them."""
    old, new = runs(), runs(0.2)
    xd.save_many(old, str(folder))

    def broken(method: str, path: str) -> str:
        return "500 InternalError" if (method, "000003.nc?uploadId" in path) == ("POST", True) else ""

    with (
        store.going(broken),
        pytest.raises(xd.ArchiveError, match="000003.nc' .*; 5 of 6 files have their names, under"),
    ):
        xd.save_many(new, str(folder))
    expected = contents(new)
    expected[3] = contents(old)[3]
    assert digests(folder) == expected
    assert left_in(folder) == []


@pytest.mark.dear
def test_an_answer_that_is_lost_is_understood(store: Way, folder: Address) -> None:
    """Assert that a file whose last answer did not arrive is known to have its name."""
    made = runs()
    lost = []

    def once(method: str, path: str) -> str:
        if method == "POST" and "uploadId" in path and "000002.nc" in path:
            lost.append(path)
            return "lost"
        return ""

    with store.going(once):
        xd.save_many(made, str(folder))
    assert lost
    assert digests(folder) == contents(made)


@pytest.mark.dear
def test_what_another_writes_meanwhile_stays(folder: Address) -> None:
    """Assert that the one name that another process took is not taken from it, and that its lock did not stop it."""
    old, new, other = runs(), runs(0.2), runs(0.3)[4]
    xd.save_many(old, str(folder))
    complete, wrote = address_store.Upload.complete, list[bool]()

    def late(upload: Any) -> None:
        if upload.location.name == "000004.nc" and not wrote:
            wrote.append(True)
            xd.save(other, str(upload.location))
        complete(upload)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(address_store.Upload, "complete", late)
        with pytest.raises(
            TakenError, match="000004.nc' was written by another process meanwhile.*; 5 of 6 files have"
        ):
            xd.save_many(new, str(folder))
    expected = contents(new)
    expected[4] = xd.content_digest(other)
    assert digests(folder) == expected


@pytest.mark.dear
def test_uploads_under_way_are_not_cleared_away(folder: Address, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that who clears a folder leaves what another process is sending, and drops what was begun long ago."""
    made, send, cleared = runs(), address_store.Upload.send, []

    def sent(upload: Any) -> None:
        send(upload)
        if upload.location.name == "000001.nc":
            ADDRESSES.clear(folder)
            cleared.append(uploads_in(folder))

    monkeypatch.setattr(address_store.Upload, "send", sent)
    monkeypatch.setattr(address_store, "ABANDONED", timedelta(days=36_500))  # this server dates all of them 2010
    xd.save_many(made, str(folder))
    assert f"{folder.key}/000001.nc" in cleared[0]
    assert digests(folder) == contents(made)
    ask_s3(folder, "create_multipart_upload", Key=(folder / "dead.nc").key)
    ADDRESSES.clear(folder)
    assert left_in(folder) == [(folder / "dead.nc").key]  # it may still live
    monkeypatch.undo()
    ADDRESSES.clear(folder)
    assert left_in(folder) == []


KILLED = """
import os, signal, sys, threading
import s3fs
import xdynamics as xd
model, calls, call = xd.Model.from_toml(sys.argv[1]), [], s3fs.S3File._call_s3
def killed(file, method, *given, **how):
    if method == sys.argv[3]:
        calls.append(method)
        if len(calls) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
    return call(file, method, *given, **how)
s3fs.S3File._call_s3 = killed
runs = [xd.simulate(model, method="rk4", step=0.01 + 0.001 * k, until=0.2) for k in range(6)]
xd.save_many(runs, sys.argv[2])
"""


@pytest.mark.dear
@pytest.mark.parametrize("where", ["upload_part", "complete_multipart_upload"])
def test_a_killed_process_leaves_each_file_whole(folder: Address, where: str, request: pytest.FixtureRequest) -> None:
    """Assert old files or new ones, old alone before all were sent, and that the next call clears up and writes all."""
    if where == "upload_part" and not request.config.getoption("--whole"):
        pytest.skip("with --whole: another process is started")
    old, new = runs(), runs(0.2)
    xd.save_many(old, str(folder))
    program = [sys.executable, "-c", KILLED, str(MODELS / "pendulum.toml"), str(folder), where]
    assert subprocess.run(program, check=False, env=dict(os.environ)).returncode == -9
    found = digests(folder)
    assert all(one in pair for one, *pair in zip(found, contents(old), contents(new), strict=True))
    if where == "upload_part":
        assert found == contents(old)
    xd.save_many(new, str(folder))
    assert digests(folder) == contents(new)
    assert left_in(folder) == []
