"""Addresses of all kinds that fsspec reaches, and open files: one word for each verb, complete or not at all."""

from __future__ import annotations

import gzip
import io
import pickle
import re
import subprocess
import threading
import time
from pathlib import Path
from typing import Any

import dask
import pytest

import xdynamics as xd
from cases.problems import oscillator
from cases.verdicts import verified
from cases.web_server import web_server
from xdynamics.archive import filesystems, segments
from xdynamics.archive.address_store import ADDRESSES
from xdynamics.archive.store import TakenError, location_of

pytest.importorskip("aiohttp")
MODEL = oscillator().model
ASKED: dict[str, Any] = {"method": "rk4", "step": 0.1, "until": 1.0}
RUN = xd.simulate(MODEL, **ASKED)
OTHER = xd.simulate(MODEL, **(ASKED | {"step": 0.05}))


def test_the_address_of_a_file_is_its_path(tmp_path: Path) -> None:
    """Assert that `file://` is the path behind it, for reading and writing."""
    assert xd.save(RUN, f"file://{tmp_path}/run.nc") == tmp_path / "run.nc"
    assert xd.open_run(f"file://{tmp_path}/run.nc").identical(xd.open_run(tmp_path / "run.nc"))


@pytest.mark.parametrize("where", ["memory", "open"])
def test_a_run_is_kept_and_replaced(where: str, request: pytest.FixtureRequest) -> None:
    """Assert the digest of the run in memory and in an open file, new and replaced, and that a pickled one is the same."""
    place: Any = f"memory://{request.node.name}/run.nc" if where == "memory" else io.BytesIO()
    for run in (RUN, OTHER):
        xd.save(run, place)
        assert verified(place) == xd.content_digest(run)
        opened = xd.open_run(place)
        assert pickle.loads(pickle.dumps(opened.load())).identical(opened)


def test_an_open_file_has_the_bytes_of_an_archive(tmp_path: Path) -> None:
    """Assert that a file opened for writing is an archive under its own name, and one opened for reading a run."""
    with (tmp_path / "run.nc").open("wb") as file:
        xd.save(RUN, file)
    assert verified(tmp_path / "run.nc") == xd.content_digest(RUN)
    with (tmp_path / "run.nc").open("rb") as file:
        assert xd.open_run(file).load().attrs["content_digest"] == xd.content_digest(RUN)
        with pytest.raises(xd.InputError, match="is opened for reading; open it with open"):
            xd.save(RUN, file)
    with pytest.raises(xd.InputError, match="is closed; open it with"):
        xd.open_run(file)
    with pytest.raises(xd.InputError, match="is opened for text, and an archive is bytes"):
        xd.save(RUN, io.StringIO())  # type: ignore[arg-type]
    with pytest.raises(xd.InputError, match="BytesIO-.*' does not exist"):
        xd.open_run(io.BytesIO())


def test_what_was_replaced_is_read_anew(tmp_path: Path) -> None:
    """Assert the run that an open file or a web server has now, of as many bytes as the one before, which is still in use."""
    replaced = xd.simulate(MODEL, **ASKED, initial={"x": "0.5 m"})
    xd.save(replaced, tmp_path / "other.nc")
    file = io.BytesIO()
    xd.save(RUN, file)
    xd.save(RUN, tmp_path / "run.nc")
    with web_server(tmp_path, parts=True) as server:
        server.mark = False
        places: list[Any] = [file, f"{server.address}/run.nc"]
        before = [xd.open_run(place) for place in places]
        file.seek(0)
        file.write((tmp_path / "other.nc").read_bytes())
        (tmp_path / "run.nc").write_bytes((tmp_path / "other.nc").read_bytes())
        for place, run in zip(places, before, strict=True):
            assert verified(place) == xd.content_digest(replaced)
            assert run.x.values.tolist() == RUN.x.values.tolist()


def test_nothing_in_an_open_file_is_lost(tmp_path: Path) -> None:
    """Assert that what stands in a file is not written over; of streams and packed files, what is written and read."""
    (tmp_path / "file").write_bytes(b"PRECIOUS")
    for mode, words in (("ab", "is open somewhere else"), ("r+b", "holds something that is no archive")):
        with (tmp_path / "file").open(mode) as file, pytest.raises(xd.InputError, match=words):
            xd.save(RUN, file)
    assert (tmp_path / "file").read_bytes() == b"PRECIOUS"
    with gzip.open(tmp_path / "run.gz", "wb") as packed:
        xd.save(RUN, packed)  # type: ignore[arg-type]
    with gzip.open(tmp_path / "run.gz", "rb") as packed:
        assert verified(packed) == xd.content_digest(RUN)
    xd.save(RUN, tmp_path / "run.nc")
    xd.save(OTHER, tmp_path / "other.nc")
    for name, run in {"run.nc": RUN, "other.nc": OTHER}.items():  # each stream is another, wherever it is in memory
        with subprocess.Popen(["cat", tmp_path / name], stdout=subprocess.PIPE) as process:
            assert verified(process.stdout) == xd.content_digest(run)
    bad, file = xd.simulate(MODEL, rtol=1e-9, until=1.0, max_steps=3), io.BytesIO()
    for run in (RUN, bad):  # there is no name beside it for the one that ended badly
        xd.save(run, file)
    assert xd.open_run(file).attrs["run_outcome"] == "step_limit"


def test_of_two_writers_in_memory_one_is_told(request: pytest.FixtureRequest) -> None:
    """Assert that what was new, then what was read, is not written over by who began before."""
    place = location_of(f"memory://{request.node.name}/run.nc")

    def write(early: Any) -> None:
        with ADDRESSES.taking_name(place) as late:  # type: ignore[arg-type]
            late.part.write_text("late")
            xd.save(early, str(place))

    for early in (RUN, OTHER):
        with pytest.raises(TakenError, match="was written by another process meanwhile"):
            write(early)
        assert verified(str(place)) == xd.content_digest(early)


@pytest.mark.parametrize("keep", [["end"], ["log"]])
def test_a_sweep_is_kept_in_memory(keep: list[str], request: pytest.FixtureRequest) -> None:
    """Assert the numbers of a sweep without a folder, its members, and that nobody else marches there meanwhile."""
    folder = f"memory://{request.node.originalname}{keep[0]}"
    sweep = xd.sweep(MODEL, {"k": "1:2:3 N m-1"}, keep=keep, path=folder, **ASKED)
    assert verified(folder) == sweep.attrs["content_digest"]
    assert sweep.run_digest.values.tolist() or keep == ["end"]
    place = location_of(folder)
    with (
        ADDRESSES.locked(place),
        pytest.raises(xd.InputError, match="is locked; if the process that locked it has ended"),
    ):
        ADDRESSES.locked(place).__enter__()  # type: ignore[arg-type]
    names = [entry.name for entry in ADDRESSES.names(place)]  # type: ignore[arg-type]
    assert names == (["catalogue.nc", "runs"] if keep == ["log"] else ["catalogue.nc"])


@pytest.mark.parametrize("place", ["{0}/run.zarr", "memory://resumed/run.nc", "memory://resumed/run.zarr"])
def test_an_interrupted_march_is_resumed(place: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a march into a Zarr store or into memory goes on from its segments to the same bits, and leaves none."""
    for name, value in {"EVERY": 0.0, "SHARE": 0.0, "BLOCK_ROWS": 50}.items():
        monkeypatch.setattr(segments, name, value)
    path, asked = place.format(tmp_path), ASKED | {"until": 20.0}

    def interrupt(_done: float, t: float, _rows: int) -> None:
        if t > 12.0:
            raise RuntimeError("as the test asks")

    with pytest.raises(RuntimeError):
        xd.simulate(MODEL, **asked, path=path, progress=interrupt)
    assert segments.has_segments(location_of(path))
    run = xd.simulate(MODEL, **asked, path=path, resume=True)
    assert verified(path) == xd.content_digest(run) == xd.content_digest(xd.simulate(MODEL, **asked))
    assert not segments.has_segments(location_of(path))


def test_memory_is_of_one_process() -> None:
    """Assert that other processes are not sent to march into the memory of this one."""
    for name in ("memory://grid", "memory://grid.zarr"):
        with (
            dask.config.set(scheduler="processes"),
            pytest.raises(xd.InputError, match="is in the memory of this process"),
        ):
            xd.sweep(MODEL, {"k": "1:2:3 N m-1"}, path=name, **ASKED)


@pytest.mark.parametrize("parts", [True, False])
def test_a_run_is_read_from_a_web_server(tmp_path: Path, *, parts: bool) -> None:
    """Assert the run of a server with and without parts of files, once more where the connection breaks."""
    xd.save(RUN, tmp_path / "run.nc")
    with web_server(tmp_path, parts=parts) as server:
        assert verified(f"{server.address}/run.nc?download=1") == xd.content_digest(RUN)
        server.what = "cut"
        assert verified(f"{server.address}/run.nc?again=1") == xd.content_digest(RUN)
        assert server.what == ""
        with pytest.raises(xd.InputError, match="none.nc' does not exist"):
            xd.open_run(f"{server.address}/none.nc")
        for verb in (lambda name: xd.save(RUN, name), lambda name: xd.simulate(MODEL, path=name, **ASKED)):
            with pytest.raises(
                xd.InputError, match="new.nc' cannot be written: addresses that begin with 'http://' are read"
            ):
                verb(f"{server.address}/new.nc")


BAD = {
    "longer": "no answer",  # or as many bytes as are declared
    "unknown": "its server does not say how many bytes it has; download it",
    "403": r"its store denies access with these credentials \(403\)",
    "401": r"its store does not accept the credentials \(401\)",
    "503": r"its store failed 4 times \(503\); call again later",
    "slow": r"no answer from its store \((Socket)?TimeoutError\)",
}


def read(address: str) -> str:
    """Read a run; return why it cannot be, else a word."""
    try:
        return "read" if verified(address) == xd.content_digest(RUN) else "another"
    except xd.InputError as error:
        return str(error)


@pytest.mark.parametrize("what", BAD)
def test_a_download_ends(what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that no more is read than is declared, and that what refuses or drips is one line in time."""
    xd.save(RUN, tmp_path / "run.nc")
    for name, value in {"READ": 0.5, "SLOWEST": 10**7}.items() if what == "slow" else ():
        monkeypatch.setattr(filesystems, name, value)
    begun = time.monotonic()
    with web_server(tmp_path, parts=False) as server:
        server.what = what
        answer = read(f"{server.address}/run.nc")
    assert re.search(f"run.nc' cannot be read: {BAD[what]}", answer) or (what, answer) == ("longer", "read")
    assert time.monotonic() - begun < 20.0


WRONG = {
    "ftp://host/run.nc": "addresses that begin with 'ftp://' are unknown; there are folders, and addresses that begin with",
    "https://host/run.nc?access_token=abc": "credentials stand in an address that begins with 'https://'",
    "https://me:word@host/run.nc": "credentials stand in an address that begins with 'https://'; leave them out of it",
    "memory://": "names no object: nothing stands behind '://'",
    "memory://a/../run.nc": r"it has '\.\.' between slashes",
    "gs://A/run.nc": "the bucket is 'A', needs 3 to 63 small letters",
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_address_is_one_line(name: str) -> None:
    """Assert one line that says what is wrong, for reading and for writing, without a secret."""
    for verb in (xd.open_run, xd.verify, lambda place: xd.save(RUN, place)):
        with pytest.raises(xd.InputError, match=WRONG[name]) as told:
            verb(name)
        assert not [word for word in ("abc", "word@", "\n") if word in str(told.value)]


def test_a_package_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an address whose filesystem is not installed says what to install."""
    import sys

    monkeypatch.setitem(sys.modules, "gcsfs", None)
    with pytest.raises(
        xd.InputError, match=r"addresses that begin with 'gs://' need the package gcsfs: pip install 'xdynamics\[gs\]'"
    ):
        xd.open_run("gs://bucket/run.nc")


def test_threads_read_one_copy(request: pytest.FixtureRequest) -> None:
    """Assert that threads that open one address share a download."""
    place = f"memory://{request.node.name}/run.nc"
    xd.save(RUN, place)
    found: list[str] = []
    threads = [threading.Thread(target=lambda: found.append(verified(place))) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {*found} == {xd.content_digest(RUN)}
