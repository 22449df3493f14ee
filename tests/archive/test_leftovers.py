"""Temporary files: how they are named and locked, and which of them a later process removes."""

from __future__ import annotations

import fcntl
import os
import secrets
from pathlib import Path

import pytest

from xdynamics.archive import target
from xdynamics.archive.target import TemporaryFile, sweep_temporary_files, try_lock

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
