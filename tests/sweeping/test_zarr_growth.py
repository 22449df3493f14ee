"""Members added to a Zarr store: the same as a sweep that was made at once, and whole whenever it is stopped."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any
from unittest import mock

import dask
import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.object_server import bucket
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive import zarr_archive
from xdynamics.archive.folder_store import FOLDERS
from xdynamics.archive.store import location_of
from xdynamics.cli import main
from xdynamics.sweeping import catalogue, grid

pytest.importorskip("zarr")
MODEL = oscillator().model
ASKED: dict[str, Any] = {"step": 0.1, "until": 1.0, "keep": ["end", "x"], "times": [0.5], "members_per_task": 2}
BEFORE: dict[str, Any] = {"k": [1.0, 1.25, 1.5], "method": ["rk4", "heun"]}
STIFFER, THIRD = {"k": [*BEFORE["k"], 1.75, 1.1]}, {"method": [*BEFORE["method"], "midpoint"]}


@pytest.fixture
def marched(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many members were marched, call by call."""
    counts: list[int] = []
    march_many = grid.march_many

    def counted(*given: Any, **more: Any) -> Any:
        runs = march_many(*given, **more)
        counts.append(len(runs.ends))
        return runs

    monkeypatch.setattr(grid, "march_many", counted)
    return counts


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of six members in a store, that stays as it is."""
    folder = tmp_path_factory.mktemp("growth") / "grid.zarr"
    xd.sweep(MODEL, BEFORE, path=folder, **ASKED)
    return folder


@pytest.fixture
def stored(whole: Path, tmp_path: Path) -> Path:
    """The same, to be added to."""
    return Path(shutil.copytree(whole, tmp_path / "grid.zarr"))


@pytest.mark.dear
@pytest.mark.parametrize("more", [STIFFER | THIRD, THIRD])
def test_added_members_are_as_if_made_at_once(
    more: dict[str, Any], stored: Path, tmp_path: Path, marched: list[int]
) -> None:
    """Assert bits and digests, along one axis, another and both, and that no member that was there was marched again."""
    after, there = BEFORE | more, len(BEFORE["k"]) * len(BEFORE["method"])
    marched.clear()
    grown = xd.sweep(MODEL, after, path=stored, **ASKED)
    assert sum(marched) == grown.end_x.size - there
    once = xd.sweep(MODEL, after, path=tmp_path / "once.zarr", **ASKED)
    assert verified(stored) == verified(tmp_path / "once.zarr") == grown.attrs["content_digest"]
    xr.testing.assert_identical(grown.drop_attrs().load(), once.drop_attrs().load())
    for consolidated in (True, False):
        plain = [xr.open_zarr(path, consolidated=consolidated) for path in (stored, tmp_path / "once.zarr")]
        xr.testing.assert_equal(*plain)
        assert plain[0].k.attrs == plain[1].k.attrs
    marched.clear()
    xd.sweep(MODEL, after, path=stored, **ASKED)
    assert not marched
    assert [path.name for path in sorted((stored / ".xdynamics").iterdir())] == ["digests.json", "zarr.json"]
    further = xd.sweep(MODEL, after | {"k": [*after["k"], 3.0]}, path=stored, **ASKED)
    assert sum(marched) == further.sizes["solver_method"]
    assert verified(stored)


@pytest.mark.dear
def test_whole_runs_are_added(tmp_path: Path) -> None:
    """Assert that archives of members that are there stay, and that what was kept of them is found."""
    asked = ASKED | {"keep": ["log", "end"], "times": None, "method": "rk4", "path": tmp_path / "grid.zarr"}
    xd.sweep(MODEL, {"k": BEFORE["k"]}, **asked)
    there = {place: place.stat().st_mtime_ns for place in (tmp_path / "grid.zarr" / "runs").iterdir()}
    grown = xd.sweep(MODEL, STIFFER, **asked)
    assert {place: place.stat().st_mtime_ns for place in there} == there
    for k in STIFFER["k"]:
        assert float(xd.member(grown, k=k).x[-1]) == float(grown.end_x.sel(k=k))
    assert verified(tmp_path / "grid.zarr") == grown.attrs["content_digest"]


def broken(times: int, function: Any) -> Any:
    """Return a function that is stopped when it is called after so many times."""
    calls: list[Any] = []

    def stopped(*given: Any) -> Any:
        if len(calls) == times:
            raise KeyboardInterrupt
        calls.append(given)
        return function(*given)

    return stopped


@pytest.mark.dear
@pytest.mark.parametrize("blocks", [5, 8])
def test_an_addition_that_was_stopped_leaves_the_sweep_as_it_was_and_goes_on(
    blocks: int, stored: Path, marched: list[int]
) -> None:
    """Assert the old sweep for us and for plain xarray, what `verify` says, that another addition waits, and the end of this one."""
    before, after = verified(stored), BEFORE | STIFFER | THIRD
    marched.clear()
    old = xr.open_zarr(stored).load()
    with (
        mock.patch.object(catalogue, "_march_block_into_file", broken(blocks, catalogue._march_block_into_file)),
        dask.config.set(scheduler="synchronous"),
        pytest.raises(KeyboardInterrupt),
    ):
        xd.sweep(MODEL, after, path=stored, **ASKED)
    assert verified(stored) == before
    for consolidated in (True, False):
        xr.testing.assert_identical(xr.open_zarr(stored, consolidated=consolidated).load(), old)
    assert xd.sweep(MODEL, BEFORE, path=stored, **ASKED).attrs["content_digest"] == before
    said = CliRunner().invoke(main, ["verify", str(stored)])
    assert (said.exit_code, "members were being added to it: the same sweep, called again" in said.output) == (0, True)
    with pytest.raises(
        xd.InputError, match=r"which the same call goes on with; .* or give it up by removing '.*unfinished"
    ):
        xd.sweep(MODEL, BEFORE | STIFFER, path=stored, **ASKED)
    done = sum(marched)
    grown = xd.sweep(MODEL, after, path=stored, **ASKED)
    assert (done > 0, sum(marched)) == (True, 9)
    assert grown.end_x.values.tolist() == xd.sweep(MODEL, after, **ASKED).end_x.values.tolist()
    assert verified(stored) == grown.attrs["content_digest"] != before


def stopped_after(count: int) -> Any:
    """Return what moves so many files of a store, and is stopped then."""
    move = FOLDERS.move

    def stopped(names: list[str], *folders: Path) -> None:
        move(names[:count], *folders)
        raise KeyboardInterrupt

    return stopped


@pytest.mark.dear
def test_at_every_moment_of_the_exchange_there_is_one_sweep_or_the_other(stored: Path, tmp_path: Path) -> None:
    """Assert a sweep that is verified, whichever file was to be moved when it was stopped, and that the call goes on."""
    after, old = BEFORE | STIFFER, verified(stored)
    new = verified(once(after, tmp_path))
    for moment in (0, 1, 7, 20):
        folder = Path(shutil.copytree(stored, tmp_path / f"{moment}.zarr"))
        with mock.patch.object(FOLDERS, "move", stopped_after(moment)), pytest.raises(KeyboardInterrupt):
            xd.sweep(MODEL, after, path=folder, **ASKED)
        assert verified(folder) == new  # all of it was there when the moves began
        assert xd.open_sweep(folder).sizes["k"] == 5
        assert xd.sweep(MODEL, after, path=folder, **ASKED).attrs["content_digest"] == new
        assert verified(folder) == new
        assert xr.open_zarr(folder).end_x.values.tolist() == xd.open_sweep(folder).end_x.values.tolist()
    with mock.patch.object(zarr_archive, "_digests_of", broken(0, None)), pytest.raises(KeyboardInterrupt):
        xd.sweep(MODEL, after, path=stored, **ASKED)
    assert verified(stored) == old


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"axes": {"k": [1.0, 1.25]}}, "it has k = 1.5, which this sweep has not; give them too"),
        ({"until": 2.0}, "setting 'until' is 1.0 there, here 2.0"),
        ({"keep": ["end"], "times": None}, "keep is end, x there, here end"),
    ],
)
def test_what_does_not_fit_is_refused(changed: dict[str, Any], words: str, whole: Path) -> None:
    """Assert one clear error with the remedy, and the store as it was."""
    before, axes = xd.open_sweep(whole).attrs["content_digest"], BEFORE | changed.get("axes", {})
    more = {name: value for name, value in changed.items() if name != "axes"}
    with pytest.raises(xd.InputError, match=words) as told:
        xd.sweep(MODEL, axes, path=whole, **ASKED | more)
    head, *faults, remedy = str(told.value).splitlines()
    assert head.endswith(":")
    assert faults[0].startswith("  1. ")
    assert remedy.startswith("name another folder")
    assert xd.open_sweep(whole).attrs["content_digest"] == before
    assert not catalogue.unfinished_folders(whole)


def test_damage_is_found_before_members_are_added(stored: Path) -> None:
    """Assert that a store whose chunk is hurt grows no member, and that the chunk is named."""
    chunk = stored / "end_x" / "c" / "0" / "0"
    chunk.write_bytes(chunk.read_bytes()[:-3])
    with pytest.raises(xd.ArchiveError, match="file 'end_x/c/0/0' of .* differs from its digest"):
        xd.sweep(MODEL, BEFORE | STIFFER, path=stored, **ASKED)


PROGRAM = """
import os, signal, sys, dask, xdynamics as xd
from xdynamics.sweeping import catalogue
keep, left = catalogue._march_block_into_file, [{left}]

def killed(*given):
    kept = keep(*given)
    left[0] -= 1
    if not left[0]:
        os.kill(os.getpid(), signal.SIGKILL)
    return kept

catalogue._march_block_into_file = killed
dask.config.set(scheduler="synchronous")
xd.sweep(xd.Model.from_toml(sys.argv[1]), {axes!r}, path=sys.argv[2], **{asked!r})
"""


def kill_in_the_middle(model: Path, folder: str, axes: dict[str, Any], left: int) -> None:
    """Add members in another process, which ends by kill -9 behind so many of the blocks that are new."""
    program = PROGRAM.format(left=left, axes=axes, asked=ASKED)
    done = subprocess.run([sys.executable, "-c", program, model, folder], check=False, capture_output=True)
    assert done.returncode == -signal.SIGKILL, done.stderr.decode()


@pytest.mark.dear
def test_an_addition_that_was_killed_goes_on(whole: Path, stored: Path, tmp_path: Path, marched: list[int]) -> None:
    """Assert the old sweep after kill -9 behind the third of six blocks, and that the same call marches what is missing."""
    old, after = verified(stored), BEFORE | {"k": [*BEFORE["k"], 1.75, 2.0, 3.0, 4.0]}
    if not (child := os.fork()):
        keep, left = catalogue._march_block_into_file, iter(range(3))

        def killed(*given: Any) -> Any:
            kept = keep(*given)
            return kept if next(left) < 2 else os.kill(os.getpid(), signal.SIGKILL)

        try:
            with (
                mock.patch.object(catalogue, "_march_block_into_file", killed),
                dask.config.set(scheduler="synchronous"),
            ):
                xd.sweep(MODEL, after, path=stored, **ASKED)
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL
    assert verified(stored) == old == verified(whole)
    xr.testing.assert_identical(xr.open_zarr(stored).load(), xr.open_zarr(whole).load())
    marched.clear()
    grown = xd.sweep(MODEL, after, path=stored, **ASKED)
    assert 0 < sum(marched) < 4 * len(BEFORE["method"])
    assert verified(stored) == verified(once(after, tmp_path)) == grown.attrs["content_digest"]


def once(axes: dict[str, Any], folder: Path) -> Path:
    """March a sweep into a store of its own, and return where."""
    xd.sweep(MODEL, axes, path=folder / "once.zarr", **ASKED)
    return folder / "once.zarr"


@pytest.mark.dear
def test_members_are_added_in_an_object_store(tmp_path: Path, marched: list[int]) -> None:
    """Assert the digest of a folder's, that kill -9 leaves the old sweep, and that an answer which is lost does no harm."""
    pytest.importorskip("s3fs")
    (tmp_path / "model.toml").write_text(MODEL.to_toml())
    place, after = "s3://bucket/grid.zarr", BEFORE | STIFFER | THIRD
    with bucket() as way:
        old = xd.sweep(MODEL, BEFORE, path=place, **ASKED).attrs["content_digest"]
        kill_in_the_middle(tmp_path / "model.toml", place, after, left=3)
        assert verified(place) == xd.open_sweep(place).attrs["content_digest"] == old
        marched.clear()
        with way.once("lost", "PUT"):
            grown = xd.sweep(MODEL, after, path=place, **ASKED)
        assert 0 < sum(marched) < 15 - 6
        assert verified(place) == verified(once(after, tmp_path)) == grown.attrs["content_digest"]
        assert catalogue.unfinished_folders(location_of(place)) == []


@pytest.mark.dear
def test_members_are_added_on_a_cluster(stored: Path, tmp_path: Path) -> None:
    """Assert the digest of threads where workers march what is added, one of which is killed meanwhile."""
    pytest.importorskip("distributed")
    after = BEFORE | {"k": [*BEFORE["k"], *np.linspace(2.0, 3.0, 40).tolist()]}
    with xd.cluster(2) as client:
        victim = min(client.run(os.getpid).values())
        killer = threading.Timer(0.2, os.kill, (victim, signal.SIGKILL))
        killer.start()
        grown = xd.sweep(MODEL, after, path=stored, **ASKED)
        killer.join()
    assert verified(stored) == verified(once(after, tmp_path)) == grown.attrs["content_digest"]
