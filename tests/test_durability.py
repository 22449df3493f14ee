"""What is on the disk, and when: a name never stands for a file that a lost current would empty."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import pytest

import xdynamics as xd
from problems import oscillator


@pytest.mark.parametrize("way", ["save", "simulate"])
def test_a_file_reaches_the_disk_before_it_takes_its_name(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that the whole file is synced, then renamed, and then the folder is synced that holds the name."""
    done: list[Any] = []
    sync, rename = os.fsync, os.replace
    monkeypatch.setattr(
        os, "fsync", lambda one: (done.append((os.fstat(one).st_ino, os.fstat(one).st_size)), sync(one))
    )
    monkeypatch.setattr(os, "replace", lambda *names: (rename(*names), done.append(Path(names[1]))))
    path = tmp_path / "run.nc"
    if way == "save":
        xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), path)
    else:
        xd.simulate(oscillator().model, step=0.1, until=1.0, path=path)
    named = done.index(path)
    assert (path.stat().st_ino, path.stat().st_size) in done[:named]
    assert tmp_path.stat().st_ino in [one[0] for one in done[named + 1 :] if isinstance(one, tuple)]
