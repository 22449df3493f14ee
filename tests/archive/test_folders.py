"""Folders that are built beside and renamed: whole or not there, made again after a kill, by one of many processes.

Temporary files: how they are named and locked, and which of them a later process removes.
"""

from __future__ import annotations

import fcntl
import os
import random
import secrets
import signal
import time
from pathlib import Path

import pytest

import xdynamics as xd
from xdynamics.archive import target
from xdynamics.archive.folder_store import BUILT, new_folder_at
from xdynamics.archive.target import TemporaryFile, sweep_temporary_files, try_lock

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


HDF = b"\x89HDF\r\n\x1a\n"


def names(folder: Path) -> list[str]:
    """List a folder."""
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize("name", ["run.nc", "n" * 252 + ".nc", "ä" * 126 + ".nc"])
def test_a_part_stands_beside_its_target(tmp_path: Path, name: str) -> None:
    """Assert an empty file of the asked mode and its lock, with names that a sweep knows, gone in the end."""
    mask = os.umask(0)
    os.umask(mask)
    with TemporaryFile.create_beside(tmp_path / name, 0o640) as part:
        lock = f"{part.path.name}.lock"
        assert names(tmp_path) == [part.path.name, lock]
        assert len(os.fsencode(lock)) == min(255, len(os.fsencode(name)) + 20)
        assert all(target._OURS.fullmatch(os.fsencode(one)) for one in names(tmp_path))
        assert os.fsencode(part.path.name).startswith(b"." + os.fsencode(name)[:230])
        assert (part.path.stat().st_size, part.path.stat().st_mode & 0o777) == (0, 0o640 & ~mask)
        assert (tmp_path / lock).stat().st_mode & 0o777 == 0o600 & ~mask
        assert not try_lock(os.open(tmp_path / lock, os.O_RDWR), needed=False)
        part.path.rename(tmp_path / "taken")
    assert names(tmp_path) == ["taken"]
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(part.handle)


def test_a_name_that_is_taken_is_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that two processes which think of one name do not share it, nor one that was just swept away."""
    tokens = ["aaaaaaaa", "aaaaaaaa", "bbbbbbbb", "cccccccc"]
    monkeypatch.setattr(secrets, "token_hex", lambda _: tokens.pop(0))
    swept = []

    def swept_once(handle: int, *, needed: bool) -> bool:
        if not swept:
            swept.append(handle)
            (tmp_path / ".run.nc.bbbbbbbb.part.lock").unlink()
        return try_lock(handle, needed=needed)

    with TemporaryFile.create_beside(tmp_path / "run.nc", 0o600) as first:
        monkeypatch.setattr(target, "try_lock", swept_once)
        with TemporaryFile.create_beside(tmp_path / "run.nc", 0o600) as second:
            assert [one.path.name for one in (first, second)] == [".run.nc.aaaaaaaa.part", ".run.nc.cccccccc.part"]
            assert second.handle == swept[0]  # closed, and given again
    assert names(tmp_path) == []


def test_an_interrupt_leaves_no_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that neither file nor descriptor is left where something comes between."""
    held = []

    def interrupt(handle: int, **_: object) -> None:
        held.append(handle)
        raise KeyboardInterrupt

    monkeypatch.setattr(target, "try_lock", interrupt)
    with pytest.raises(KeyboardInterrupt), TemporaryFile.create_beside(tmp_path / "run.nc", 0o600):
        pass
    assert names(tmp_path) == []
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(held[0])


@pytest.mark.parametrize(
    ("error", "taken"), [(None, (True, True)), (BlockingIOError, (False, False)), (OSError, (False, True))]
)
def test_where_there_are_no_locks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: type[OSError] | None, taken: tuple[bool, bool]
) -> None:
    """Assert that a lock which is needed is not had there, and one that is not is done without."""

    def lock(*_: object) -> None:
        if error:
            raise error

    monkeypatch.setattr(fcntl, "flock", lock)
    assert (try_lock(0, needed=True), try_lock(0, needed=False)) == taken
    if error:
        (tmp_path / ".run.nc.abcd1234.part").touch()
        sweep_temporary_files(tmp_path)
        assert names(tmp_path) == [".run.nc.abcd1234.part"]
    if error is OSError:
        with TemporaryFile.create_beside(tmp_path / "run.nc", 0o600) as part:
            assert part.path.exists()


def test_what_is_swept_away(tmp_path: Path) -> None:
    """Assert that of files with such names those go that a dead process began, with their locks, and no other."""
    ours = {
        ".a.nc.abcd1234.part": HDF + b"more",
        ".b.nc.abcd1234.part": bytes(100),
        ".c\n.nc.abcd_234.part": b"",
        ".d.nc.abcd1234.part.lock": b"",
        ".e.nc.abcd1234.part": b"dear",
        ".e.nc.abcd1234.part.lock": b"",
    }
    others = {
        ".f.nc.abcd1234.part": b"dear",
        ".g.nc.abcd1234.part": HDF[:7],
        ".h.nc.ABCD1234.part": b"",
        "i.nc.abcd1234.part": b"",
        ".j.nc.abcd123.part": b"",
        ".k.nc.abcd1234.part.locks": b"",
        ".l.nc.abcd1234.part.lock": b"dear",
        ".l.nc.abcd1234.part": b"",
    }
    for name, content in (ours | others).items():
        (tmp_path / name).write_bytes(content)
    (tmp_path / ".m.nc.abcd1234.part").mkdir()
    os.mkfifo(tmp_path / ".n.nc.abcd1234.part")
    (tmp_path / ".o.nc.abcd1234.part").symlink_to(tmp_path / "i.nc.abcd1234.part")
    sweep_temporary_files(tmp_path)
    assert names(tmp_path) == sorted([*others, *(f".{name}.nc.abcd1234.part" for name in "mno")])
    sweep_temporary_files(tmp_path / "nowhere")


def test_what_a_living_process_writes_stays(tmp_path: Path) -> None:
    """Assert that a lock keeps its part too, old files beside which there is none are asked themselves, and nothing stays open."""
    with (
        TemporaryFile.create_beside(tmp_path / "run.nc", 0o600),
        (tmp_path / ".old.nc.abcd1234.part").open("wb") as old,
    ):
        fcntl.flock(old, fcntl.LOCK_EX)
        before = names(tmp_path)
        free = os.open(os.devnull, os.O_RDONLY)
        os.close(free)
        sweep_temporary_files(tmp_path)
        assert names(tmp_path) == before
        again = os.open(os.devnull, os.O_RDONLY)
        os.close(again)
        assert again == free
    sweep_temporary_files(tmp_path)
    assert names(tmp_path) == []
