"""Folders that are built beside and renamed: whole or not there, made again after a kill, by one of many processes."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest

import xdynamics as xd
from xdynamics.archive.folder_store import BUILT, new_folder_at

FILES = {f"part{k}": bytes([65 + k]) * 20_000 for k in range(12)}


def build(path: Path) -> None:
    """Build a folder of some files."""
    with new_folder_at(path) as built:
        for name, content in FILES.items():
            (built / name).write_bytes(content)


def whole(path: Path) -> bool:
    """Whether a folder has all files, each whole."""
    return {entry.name: entry.read_bytes() for entry in path.iterdir()} == FILES


def forked(path: Path) -> int:
    """Build a folder in a process of its own, which ends with 0, or with 2 where it is told that there is one."""
    if number := os.fork():
        return number
    try:
        build(path)
        os._exit(0)
    except xd.InputError as error:
        os._exit(2 if "already" in str(error) else 3)
    finally:
        os._exit(4)


def ended(number: int) -> int:
    """Wait for a process; return how it ended."""
    return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1])


@pytest.mark.cases(300)
def test_a_folder_is_whole_or_not_there(case: int, tmp_path: Path) -> None:
    """Assert that whenever its builder is killed, the folder is whole or not there, and is made again without a rest."""
    path, dice = tmp_path / "made", random.Random(case)
    if case % 3 == 0:
        path.mkdir()
    number = forked(path)
    time.sleep(dice.uniform(0.0, 0.02))
    os.kill(number, signal.SIGKILL)
    ended(number)
    if path.exists() and [*path.iterdir()]:
        assert whole(path)
        with pytest.raises(xd.InputError, match="holds 'part0' already"):
            build(path)
        (tmp_path / f".made.{0:08x}{BUILT}").mkdir()
        path = tmp_path / "made2"
        build(path)
        return
    build(path)
    assert whole(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["made"]


def test_one_of_many_processes_wins(tmp_path: Path) -> None:
    """Assert that of six that build one folder at once, one ends well, the others are told, and nothing is left over."""
    path = tmp_path / "made"
    codes = sorted(map(ended, [forked(path) for _ in range(6)]))
    assert codes == [0, 2, 2, 2, 2, 2]
    assert whole(path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["made"]


def test_a_folder_that_is_swept_before_it_is_opened_is_begun_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that a folder which another process takes for one of the dead, between its making and its lock, is made anew."""
    make, swept = Path.mkdir, []

    def made_and_swept(path: Path, *how: int, **named: bool) -> None:
        make(path, *how, **named)
        if path.name.endswith(BUILT) and len(swept) < 2:
            swept.append(path)
            path.rmdir()

    monkeypatch.setattr(Path, "mkdir", made_and_swept)
    build(tmp_path / "made")
    assert len(swept) == 2
    assert whole(tmp_path / "made")
    assert [entry.name for entry in tmp_path.iterdir()] == ["made"]


def test_a_folder_that_is_being_built_stays(tmp_path: Path) -> None:
    """Assert that what living processes build under a name, and folders of others, are not swept away."""
    (tmp_path / f".made.notours{BUILT}").mkdir()
    path, living = tmp_path / "made", []

    def late() -> None:
        with new_folder_at(path):
            living.append(first.exists())
            path.mkdir()
            (path / "x").write_text("")

    with new_folder_at(path) as first:
        with pytest.raises(xd.InputError, match="holds 'x' already"):
            late()
        (path / "x").unlink()
    assert living == [True]
    assert sorted(entry.name for entry in tmp_path.iterdir()) == [f".made.notours{BUILT}", "made"]


def test_what_is_no_place_for_a_folder_is_named(tmp_path: Path) -> None:
    """Assert one error for a file, for a folder that is in a file, and for a name that is too long."""
    (tmp_path / "file").write_text("")
    for name, said in (
        ("file", "is a file; name a folder"),
        ("file/in", "is a file|Not a directory"),
        ("n" * 300, "File name too long"),
    ):
        with pytest.raises(xd.InputError, match=said):
            build(tmp_path / name)
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]
    build(tmp_path / ("n" * 255))
    assert whole(tmp_path / ("n" * 255))
