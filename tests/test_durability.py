"""What is on the disk, and when: no name stands for a file that a lost current would empty."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from problems import oscillator
from xdynamics.archive import segment

WAYS = {
    "save": lambda path: xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), path),
    "simulate": lambda path: xd.simulate(oscillator().model, step=0.1, until=1.0, path=path).close(),
    "segment": lambda path: segment.write(path, {}, {"a": np.ones(3)}, [("b", "f8", (2,))], [np.ones(2)]),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_file_reaches_the_disk_before_it_takes_its_name(
    way: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that the whole file is synced, then renamed, and then the folder is synced that holds the name."""
    done: list[Any] = []
    sync, rename = os.fsync, os.replace

    def synced(handle: int) -> None:
        sync(handle)
        done.append((os.fstat(handle).st_ino, os.fstat(handle).st_size))

    def renamed(old: Path, new: Path) -> None:
        rename(old, new)
        done.append(Path(new))

    monkeypatch.setattr(os, "fsync", synced)
    monkeypatch.setattr(os, "replace", renamed)
    path = tmp_path / "run.nc"
    WAYS[way](path)
    named = done.index(path)
    assert (path.stat().st_ino, path.stat().st_size) in done[:named]
    assert tmp_path.stat().st_ino in [one[0] for one in done[named + 1 :] if isinstance(one, tuple)]
