"""What is on the disk, and when: no name stands for a file that a lost current would empty."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, oscillator
from xdynamics.archive import segments
from xdynamics.archive.target import check_path_target, taking_path_name

WAYS = {
    "save": lambda path: xd.save(xd.simulate(oscillator().model, step=0.1, until=1.0), path),
    "simulate": lambda path: xd.simulate(oscillator().model, step=0.1, until=1.0, path=path).close(),
    "segment": lambda path: segments.write_segment(path, {}, {"a": np.ones(3)}, [("b", "f8", (2,))], [np.ones(2)]),
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


def test_a_new_file_has_the_rights_of_any_new_file(tmp_path: Path) -> None:
    """Assert that nobody loses or gets a right by the temporary name, and that one that replaces a file is private until then."""
    usual, new = tmp_path / "usual", tmp_path / "new"
    usual.touch()
    with taking_path_name(new) as file:
        file.part.write_bytes(b"1")
    assert new.stat().st_mode == usual.stat().st_mode
    with taking_path_name(usual) as file:
        assert file.part.stat().st_mode & 0o077 == 0
        file.part.write_bytes(b"1")
    assert usual.stat().st_mode == new.stat().st_mode


def test_a_file_that_is_not_the_model_s_may_be_replaced(tmp_path: Path) -> None:
    """Assert that a model's own file is refused, and another one is not, wherever the model came from."""
    path, old = tmp_path / "free.toml", tmp_path / "run.nc"
    path.write_text(oscillator().model.to_toml())
    old.touch()
    model = xd.Model.from_toml(path)
    with pytest.raises(xd.InputError, match="is the model file itself"):
        check_path_target(path, model)
    path.unlink()
    for one in (model, oscillator().model, xd.Model.from_toml(MODELS / "rocket_c6.toml"), None):
        check_path_target(old, one)
