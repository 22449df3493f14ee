"""Many archives that reach the disk together: each whole or not at all."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path
from typing import Any

import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS
from cases.verdicts import verified
from xdynamics.archive import target, writing

PENDULUM = xd.Model.from_toml(MODELS / "pendulum.toml")


def runs(count: int, until: float = 1.0) -> list[xr.Dataset]:
    """Return short runs, each of another step."""
    return [xd.simulate(PENDULUM, method="rk4", step=0.01 + 0.001 * k, until=until) for k in range(count)]


@pytest.mark.dear
def test_files_are_those_of_save(tmp_path: Path) -> None:
    """Assert names, digests and compression of runs in a folder, by name and at paths."""
    made = runs(3)
    folder, named, paths = (tmp_path / name for name in ("folder", "named", "paths"))
    paths.mkdir()
    found = xd.save_many(made, folder, compress=True)
    assert [one.name for one in found] == ["000000.nc", "000001.nc", "000002.nc"]
    found += xd.save_many({f"run {k}": run for k, run in enumerate(made)}, named)
    found += xd.save_many(iter(made), [paths / f"{k}.nc" for k in "abc"])
    assert {entry.name for entry in named.iterdir()} == {"run 0.nc", "run 1.nc", "run 2.nc"}
    assert [verified(one) for one in found] == 3 * [xd.content_digest(run) for run in made]
    assert found[0].stat().st_size < found[3].stat().st_size


@pytest.mark.dear
def test_the_disk_is_asked_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one synchronisation for all files and one of the folder; and so for each batch."""
    asked: list[Any] = []
    plain, all_at_once = os.fsync, target.sync_file_systems
    monkeypatch.setattr(os, "fsync", lambda handle: (asked.append("fsync"), plain(handle)))
    monkeypatch.setattr(target, "sync_file_systems", lambda paths: (asked.append(len(paths)), all_at_once(paths)))
    made = runs(5)
    xd.save_many(made, tmp_path / "one")
    assert asked == [5, "fsync"]
    monkeypatch.setattr(writing, "MOST_AT_ONCE", 2)
    xd.save_many(made, tmp_path / "more")
    assert asked[2:] == [2, "fsync", 2, "fsync", 1, "fsync"]


@pytest.mark.every(2)
@pytest.mark.parametrize("where", ["_seal_new_file", "sync_file_systems"])
def test_a_write_that_fails_changes_nothing(where: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that no name is taken where one file, or the disk, fails, that nothing is left beside, and one error names it."""
    before = [verified(one) for one in xd.save_many(runs(3), tmp_path)]
    calls: list[object] = []

    def full(*_given: object, **_asked: object) -> str:
        calls.append(0)
        if where == "_seal_new_file" and len(calls) < 3:
            return "0" * 64
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(writing if where == "_seal_new_file" else target, where, full)
    with pytest.raises(xd.ArchiveError, match=r"00000\d.nc' cannot be written: .*nothing is changed"):
        xd.save_many(runs(3, until=2.0), tmp_path)
    assert [verified(entry) for entry in sorted(tmp_path.iterdir())] == before


@pytest.mark.dear
@pytest.mark.every(6)
@pytest.mark.cases(200)
def test_killed_at_any_moment(case: int, tmp_path: Path) -> None:
    """Assert the old file or the new one under every name, when a process is killed while it writes."""
    rng = random.Random(case)
    old, new = runs(4), runs(4, until=2.0)
    digests = [[xd.content_digest(run) for run in made] for made in (old, new)]
    xd.save_many(old, tmp_path)
    child = os.fork()
    if not child:
        try:
            xd.save_many(new, tmp_path)
        finally:
            os._exit(0)
    time.sleep(rng.uniform(0.0, 0.12))
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    found = [verified(tmp_path / f"{k:06d}.nc") for k in range(4)]
    assert all(one in (a, b) for one, a, b in zip(found, *digests, strict=True))
    xd.save_many(new, tmp_path)
    assert [verified(entry) for entry in sorted(tmp_path.iterdir())] == digests[1]


def test_wrong_lists_are_refused_before_anything_is_written(tmp_path: Path) -> None:
    """Assert one line for two runs of one name, other numbers, no place, what is no run or edited, and a wrong folder."""
    made = runs(2)
    edited = made[1].assign(theta=2.0 * made[1]["theta"])
    (tmp_path / "file").write_text("here")
    wrong: list[tuple[Any, Any, str]] = [
        (made, [tmp_path / "a.nc", tmp_path / "a.nc"], "two runs are to be written to '.*a.nc'"),
        (made, [tmp_path / "a.nc"], "there are 2 runs and 1 paths"),
        (made, None, "needs a file for each run, or a folder"),
        ([made[0], edited], tmp_path, "not the record that was marched"),
        ([made[0], 3], tmp_path, "a run record is to be saved, got '3'"),
        (made[0], tmp_path, "one run was given; save writes it"),
        (made, tmp_path / "file", "is a file; name a folder|file'.*name a folder"),
        (made, [tmp_path / "no" / "a.nc", tmp_path / "b.nc"], "folder .* does not exist"),
        ({"a/b": made[0]}, tmp_path, "'a/b' is no name of a file in the folder"),
    ]
    for given, places, said in wrong:
        with pytest.raises(xd.InputError, match=said):
            xd.save_many(given, places)
    with pytest.raises(xd.InputError, match="compress is 'yes', needs true or false"):
        xd.save_many(made, tmp_path, compress="yes")  # type: ignore[arg-type]
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]
