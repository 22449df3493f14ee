"""Archives with more in them than netCDF shows, or than is in them: named before anything is followed."""

from __future__ import annotations

import os
import shutil
import time
from pathlib import Path

import pytest

import xdynamics as xd
from planting import PLANTS, planted
from problems import oscillator
from xdynamics.archive.inventory import inventory
from xdynamics.archive.seals import MARK, seal_file, tail_of
from xdynamics.archive.signatures import new_key

GOLDEN = Path(__file__).parents[1] / "data" / "golden"


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
        with pytest.raises(xd.ArchiveError, match="is damaged or no run archive"):
            act(path)


@pytest.mark.parametrize("name", ["0.1/ball_drag_midpoint.nc", "0.2/woodpecker_dop853.nc"])
def test_archives_of_all_versions_have_nothing_else(name: str) -> None:
    """Assert that what was written by earlier versions has no object that is not shown."""
    found = inventory(GOLDEN / name)
    assert found.faults == []
    assert {"", "time", "model_toml"} < {*found.attributes}
    xd.verify(GOLDEN / name)


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
    assert xd.verify(path) == digest
    with pytest.raises(xd.ArchiveError, match="is not what was signed: its digest of the file's bytes is"):
        xd.verify_signature(path, public)
