"""Sweeps in a Zarr store: written by blocks, verified by digests, opened by plain xarray."""

from __future__ import annotations

import errno
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import dask
import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, oscillator
from cases.verdicts import verified
from xdynamics.archive import target
from xdynamics.sweeping import catalogue, members

pytest.importorskip("zarr")
MODEL = oscillator().model
ASKED: dict[str, Any] = {
    "axes": {"k": "1:2:5 N m-1", "method": ["rk4", "heun"]},
    "step": 0.1,
    "until": 1.0,
    "keep": ["end", "x"],
    "times": [0.5],
}


@pytest.fixture(scope="module")
def whole() -> xr.Dataset:
    """The sweep in memory."""
    return xd.sweep(MODEL, **ASKED).compute()


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    """A sweep in a store, of six blocks."""
    xd.sweep(MODEL, **ASKED, path=tmp_path / "grid.zarr", members_per_task=2)
    return tmp_path / "grid.zarr"


def test_a_store_has_what_a_sweep_has(stored: Path, whole: xr.Dataset) -> None:
    """Assert all values, texts too, lazily, units, the same members, and one digest for all of it."""
    sweep = xd.open_sweep(stored)
    assert sweep.end_x.chunks == ((2, 2, 1), (1, 1))
    for name in whole.data_vars:
        np.testing.assert_array_equal(sweep[name].values, whole[name].values)
        assert sweep[name].attrs["units"] == whole[name].attrs["units"]
    assert verified(stored) == sweep.attrs["content_digest"] == xd.content_digest(whole)
    run = xd.member(sweep, k="2 N m-1", method="heun")
    assert float(run.x[-1]) == float(whole.end_x[4, 1])
    assert xd.sweep(MODEL, **ASKED, path=stored).attrs["content_digest"] == sweep.attrs["content_digest"]


def test_a_sweep_of_elements_is_the_same_in_both_forms(tmp_path: Path) -> None:
    """Assert variables, attributes and digest of a folder's catalogue for a model with dimensions."""
    model, asked = xd.Model.from_toml(MODELS / "heat.toml"), {"method": "rk4", "step": 1e-4, "until": 1e-3}
    stored = xd.sweep(model, {"L": [1.0, 1.1]}, path=tmp_path / "grid.zarr", **asked)
    folder = xd.sweep(model, {"L": [1.0, 1.1]}, path=tmp_path / "grid", **asked)
    assert stored.attrs["content_digest"] == folder.attrs["content_digest"]
    assert {*stored.data_vars} == {*folder.data_vars}
    assert {name for name in stored.attrs if name not in folder.attrs} == set()
    assert "origin" not in xr.open_zarr(tmp_path / "grid.zarr").attrs


def test_plain_xarray_opens_it(stored: Path, whole: xr.Dataset) -> None:
    """Assert that without this package there are lazy numbers with units, labels and the meanings of flags."""
    plain = xr.open_zarr(stored)
    assert plain.end_x.chunks is not None
    assert float(plain.end_x.sel({"k": 2.0, "solver_method": "heun"})) == float(whole.end_x[4, 1])
    assert (plain.end_x.attrs["units"], plain.k.attrs["units"]) == ("m", "N m-1")
    words = plain.run_outcome.attrs["flag_meanings"].split()
    assert {words[code] for code in plain.run_outcome.values.ravel()} == {"completed"}


def test_what_was_begun_goes_on(tmp_path: Path, whole: xr.Dataset) -> None:
    """Assert that a sweep which broke off is told, goes on with the blocks that are missing or hurt, and is whole then."""
    folder, march, marched = tmp_path / "grid.zarr", catalogue._march_block_into_file, []

    def broken(*given: Any) -> None:
        if len(marched) == 4:
            raise KeyboardInterrupt
        marched.append(given[2])
        march(*given)

    one_by_one = dask.config.set(scheduler="synchronous")
    with (
        mock.patch.object(catalogue, "_march_block_into_file", broken),
        one_by_one,
        pytest.raises(KeyboardInterrupt),
    ):
        xd.sweep(MODEL, **ASKED, path=folder, members_per_task=2)
    with pytest.raises(xd.InputError, match="grid.zarr' is not finished; call the same sweep again, and it goes on"):
        xd.open_sweep(folder)
    marched[0].write_bytes(marched[0].read_bytes()[:-3])
    again = []
    with mock.patch.object(catalogue, "_march_block_into_file", lambda *given: again.append(given[1]) or march(*given)):
        sweep = xd.sweep(MODEL, **ASKED, path=folder, members_per_task=2)
    assert len(again) == 3
    assert sweep.end_x.values.tolist() == whole.end_x.values.tolist()
    assert verified(folder)


def test_damage_is_named(stored: Path) -> None:
    """Assert that a chunk that is hurt, exchanged or lost, and other metadata, are named, by `verify` and by who reads."""
    chunk = stored / "end_x" / "c" / "1" / "0"
    whole = chunk.read_bytes()

    def hurt(words: str) -> None:
        for verb in (xd.verify, lambda path: xd.open_sweep(path).end_x.values):
            with pytest.raises(xd.ArchiveError, match=words):
                verb(stored)

    chunk.write_bytes(whole[:-3])
    hurt("file 'end_x/c/1/0'(?s:.*) differs from its digest")
    chunk.write_bytes((stored / "end_x" / "c" / "0" / "0").read_bytes())
    hurt("file 'end_x/c/1/0'(?s:.*) differs from its digest")
    chunk.unlink()
    hurt("file 'end_x/c/1/0'(?s:.*) is missing")
    chunk.write_bytes(whole)
    assert verified(stored)
    metadata = stored / "zarr.json"
    metadata.write_text(metadata.read_text().replace("N m-1", "N m-2"))
    with pytest.raises(xd.ArchiveError, match="file 'zarr.json' of .* differs from its digest"):
        xd.open_sweep(stored)


def test_what_a_store_does_not_take(stored: Path) -> None:
    """Assert that another sweep is refused with the remedy, and that where there is none that is said."""
    with pytest.raises(xd.InputError, match=r"grid.zarr' holds another sweep, (?s:.*)'until' is 1\.0 there, here 2\.0"):
        xd.sweep(MODEL, **(ASKED | {"until": 2.0}), path=stored)
    with pytest.raises(xd.InputError, match="none.zarr' holds no sweep: there is no .xdynamics/digests.json in it"):
        xd.open_sweep(stored.with_name("none.zarr"))


LOGGED: dict[str, Any] = ASKED | {"axes": {"k": "1:2:3 N m-1"}, "keep": ["log", "end"], "times": None, "method": "rk4"}


def killed_in_a_run(folder: Path) -> None:
    """March the sweep in a copy of this process, which is killed when the third run has been archived."""
    streamed, files = members._stream_member, list[Path]()

    def broken_off(march: Any, file: Path, **asked: Any) -> tuple[str, str]:
        files.append(file)
        written = streamed(march, file, **asked)
        if len(files) == 3:
            os.kill(os.getpid(), signal.SIGKILL)
        return written

    if not (child := os.fork()):
        try:
            with (
                mock.patch.object(members, "_stream_member", broken_off),
                dask.config.set(scheduler="synchronous"),
            ):
                xd.sweep(MODEL, **LOGGED, path=folder, members_per_task=2)
        finally:
            os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == -signal.SIGKILL


@pytest.mark.dear
def test_whole_runs_stand_beside_the_arrays(tmp_path: Path) -> None:
    """Assert each run's file, found by member and by open_logs; after a kill no run is marched twice, and the digests are the same."""
    folder, whole = tmp_path / "grid.zarr", xd.sweep(MODEL, **LOGGED, path=tmp_path / "folder")
    killed_in_a_run(folder)
    archived = {place: place.stat().st_mtime_ns for place in (folder / "runs").glob("*.nc")}
    assert len(archived) == 3
    sweep = xd.sweep(MODEL, **LOGGED, path=folder, members_per_task=2)
    assert {place: place.stat().st_mtime_ns for place in archived} == archived
    for name in ("run_file", "run_digest", "end_x"):
        assert sweep[name].values.tolist() == whole[name].values.tolist()
    assert float(xd.member(sweep, k="2 N m-1").x[-1]) == float(whole.end_x[-1])
    logs = [xd.open_logs(grid, [0.25, 0.5]) for grid in (folder, whole)]
    assert logs[0].x.values.tolist() == logs[1].x.values.tolist()
    assert str(xr.open_zarr(folder).run_file[0].values) == str(whole.run_file[0].values)
    xd.sweep(MODEL, **LOGGED, path=tmp_path / "again.zarr", members_per_task=1)
    assert verified(folder) == verified(tmp_path / "again.zarr")
    first = next(iter(archived))
    first.write_bytes(first.read_bytes()[:-1])
    with pytest.raises(xd.ArchiveError, match=f"{first.name}: its seal is"):
        xd.verify(folder)
    first.unlink()
    with pytest.raises(xd.ArchiveError, match=f"runs/{first.name} is missing"):
        xd.verify(folder)


@pytest.mark.dear
def test_a_digest_does_not_depend_on_how_members_are_cut(stored: Path, tmp_path: Path) -> None:
    """Assert one content digest of one sweep in blocks of one, two and all members, and another of another value."""
    digests = {verified(stored)}
    for count in (1, 3, 10):
        path = tmp_path / f"{count}.zarr"
        xd.sweep(MODEL, **ASKED, path=path, members_per_task=count)
        digests.add(verified(path))
    assert len(digests) == 1


def test_plain_programs_are_not_told_of_what_is_none_of_theirs(stored: Path) -> None:
    """Assert that zarr and xarray open the store without a warning, with its metadata in one file or not."""
    import zarr

    assert xr.open_zarr(stored, consolidated=False).sizes["k"] == 5
    assert "end_x" in dict(zarr.open_group(stored, mode="r").arrays())


def test_zeros_with_a_sign_keep_it(tmp_path: Path) -> None:
    """Assert that blocks of zeros with a sign, which compare as the value that zarr writes no chunk for, keep their bits."""
    still = MODEL.replace(initial={"x": "0 m", "v_x": "-0.0 m s-1"})
    asked = {"axes": {"k": "1:2:4 N m-1"}, "step": 0.1, "until": 0.1, "method": "rk4"}
    grid, found = xd.sweep(still, **asked).compute(), xd.sweep(still, **asked, path=tmp_path / "still.zarr")
    assert found.end_v_x.values.tobytes() == grid.end_v_x.values.tobytes()
    assert np.signbit(grid.end_v_x.values).any() or np.signbit(grid.end_x.values).any()
    assert verified(tmp_path / "still.zarr")


@pytest.mark.dear
def test_a_killed_sweep_goes_on(request: pytest.FixtureRequest) -> None:
    """Assert that kill -9 at random moments loses no finished block, and leaves nothing beside the digest of the whole."""
    script = Path(__file__).parents[1] / "cases" / "killed_sweeps.py"
    sweeps = "3" if request.config.getoption("--whole") else "1"
    path = os.pathsep.join([str(script.parents[1]), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, script, sweeps],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=os.environ | {"PYTHONPATH": path},
    )
    assert done.stderr == ""
    found = re.fullmatch(
        rf"{sweeps} of {sweeps} equal, (\d+) kills, (\d+) behind a finished block, left (.*)\n", done.stdout
    )
    assert found is not None, done.stdout
    assert int(found[1]) > 0
    assert found[3] == "digests.json zarr.json"


def test_what_was_left_behind_the_end_is_cleared(stored: Path) -> None:
    """Assert that blocks, which a process was killed while it removed, are removed by the next call."""
    sweep = xd.open_sweep(stored)
    left = stored / ".xdynamics" / "unfinished" / sweep.attrs["sweep_digest"][:16] / "0-2_0-1.nc"
    left.parent.mkdir(parents=True)
    left.write_text("")
    assert xd.sweep(MODEL, **ASKED, path=stored).attrs["content_digest"] == verified(stored)
    assert sorted(entry.name for entry in (stored / ".xdynamics").iterdir()) == ["digests.json", "zarr.json"]


@pytest.mark.dear
def test_a_full_disk_is_named_and_the_store_goes_on(
    stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert one line where the chunks cannot be written, nothing to be seen, and the digest of a sweep that never stopped."""
    path = tmp_path / "other.zarr"

    def full(*_: Any, **__: Any) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(target, "sync_file_systems", full)
        with pytest.raises(
            xd.ArchiveError, match=r"other\.zarr' cannot be written: No space left .*; nothing is changed"
        ):
            xd.sweep(MODEL, **ASKED, path=path, members_per_task=2)
    assert [entry.name for entry in path.iterdir()] == [".xdynamics"]
    xd.sweep(MODEL, **ASKED, path=path, members_per_task=2)
    assert verified(path) == verified(stored)
