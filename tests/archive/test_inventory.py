"""Archives with more in them than netCDF shows, or than is in them: named before anything is followed."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path
from typing import Any

import pytest

import xdynamics as xd
from cases.planting import PLANTS, planted
from cases.problems import oscillator
from cases.verdicts import verified
from xdynamics.archive import reading
from xdynamics.archive.file_structure import inventory
from xdynamics.archive.seals import MARK, seal_file, tail_of
from xdynamics.archive.signatures import new_key

GOLDEN = Path(__file__).parents[2] / "data" / "golden"


@pytest.fixture(scope="module")
def archived(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One archive, of which tests take copies; the process that reads what others wrote is there."""
    xd.verify(GOLDEN / "0.2" / "ball_drag_dop853.nc")
    return xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), tmp_path_factory.mktemp("whole") / "run.nc")


@pytest.mark.parametrize("what", PLANTS)
def test_what_is_planted_is_named(archived: Path, tmp_path: Path, what: str) -> None:
    """Assert one fault that names the object, in 2 s, though all digests hold and what it leads to is a pipe."""
    path, pipe = Path(shutil.copy(archived, tmp_path / "run.nc")), tmp_path / "pipe"
    os.mkfifo(pipe)
    said = planted(path, what, pipe)
    assert tail_of(path).digest
    began = time.monotonic()
    with pytest.raises(xd.ArchiveError) as caught:
        xd.verify(path)
    assert time.monotonic() - began < 2.0
    assert caught.value.faults[0] == said
    for act in (xd.open_run, xd.reproduce):
        message = "was edited, and is no run record" if "its digest" in said else "is damaged or no run archive"
        with pytest.raises(xd.ArchiveError, match=message):
            act(path)
    if "that netCDF shows" not in said and "its digest" not in said:  # what is not shown is not followed either
        with pytest.raises(xd.ArchiveError, match="is damaged or no run archive") as caught:
            xd.open_run(path, check=False)
        assert caught.value.faults[0] == said


@pytest.mark.parametrize("name", ["0.1/ball_drag_midpoint.nc", "0.2/woodpecker_dop853.nc"])
def test_archives_of_all_versions_have_nothing_else(name: str) -> None:
    """Assert that what was written by earlier versions has no object that is not shown."""
    found = inventory(GOLDEN / name)
    assert found.faults == []
    assert {"", "time", "model_toml"} < {*found.attributes}
    xd.verify(GOLDEN / name)


def test_what_is_known_is_not_listed_again(archived: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a file is listed once, and one that was written or verified here never."""
    listed: list[Path] = []
    monkeypatch.setattr(reading, "inventory", lambda path: listed.append(path) or inventory(path))
    xd.open_run(archived, check=False).close()
    path = Path(shutil.copy(archived, tmp_path / "run.nc"))
    for _ in range(2):
        xd.open_run(path, check=False).close()
        assert listed == [path]
    other = Path(shutil.copy(GOLDEN / "0.2" / "ball_drag_dop853.nc", tmp_path / "other.nc"))
    xd.verify(other)
    xd.open_run(other, check=False).close()
    assert listed == [path]


@pytest.mark.parametrize("check", [True, False])
def test_a_file_that_takes_the_name_of_a_checked_one_is_checked(
    archived: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, check: bool
) -> None:
    """Assert that what is opened is what was looked at: another run is looked at in its turn, and a planted one refused."""
    path, other = Path(shutil.copy(archived, tmp_path / "run.nc")), tmp_path / "other.nc"
    lent, swaps = reading.open_shared, [1]

    def swapped(*given: Any) -> Any:
        if swaps:
            swaps.pop()
            other.replace(path)
        return lent(*given)

    monkeypatch.setattr(reading, "open_shared", swapped)
    xd.save(xd.simulate(oscillator().model, step=0.05, until=1.0), other)
    with xd.open_run(path, check=check) as run:
        assert run.sizes["step"] == 21
    os.mkfifo(tmp_path / "pipe")
    said = planted(Path(shutil.copy(archived, other)), "external link", tmp_path / "pipe")
    swaps.append(1)
    with pytest.raises(xd.ArchiveError) as caught:
        xd.open_run(path, check=check)
    assert caught.value.faults[0] == said

    def swapped_always(*given: Any) -> Any:
        shutil.copy(archived, other)
        other.replace(path)
        return lent(*given)

    monkeypatch.setattr(reading, "open_shared", swapped_always)
    shutil.copy(archived, other)
    other.replace(path)
    with pytest.raises(xd.ArchiveError, match="was replaced each time it was opened; try again"):
        xd.open_run(path, check=check)


def test_bytes_before_the_file_are_none(archived: Path, tmp_path: Path) -> None:
    """Assert that what stands in front of an archive, where HDF5 lets others write, is refused."""
    path = tmp_path / "run.nc"
    path.write_bytes(b"#!/bin/sh\n".ljust(512) + archived.read_bytes().rpartition(MARK)[0])
    seal_file(path)
    with pytest.raises(xd.ArchiveError, match="it cannot be read: it does not begin as an HDF5 file does"):
        xd.verify(path)


def test_a_signature_is_of_every_byte(archived: Path, tmp_path: Path) -> None:
    """Assert that an archive whose bytes were changed where no digest looks, and sealed anew, is not what was signed."""
    path = Path(shutil.copy(archived, tmp_path / "run.nc"))
    public = new_key(tmp_path / "key.pem")
    xd.sign(path, tmp_path / "key.pem")
    digest = xd.verify_signature(path, public)
    content = path.read_bytes().rpartition(MARK)[0]
    path.write_bytes(content + b"and more behind the end of what HDF5 reads")
    seal_file(path)
    assert verified(path) == digest
    with pytest.raises(xd.ArchiveError, match="is not what was signed: its digest of the file's bytes is"):
        xd.verify_signature(path, public)
