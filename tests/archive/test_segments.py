"""The segments of one march: when there is one, where they are, and how they go."""

from __future__ import annotations

import fcntl
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import oscillator
from xdynamics.archive import segments
from xdynamics.archive.segments import Segments, discard, has_segments, segments_folder
from xdynamics.march import March
from xdynamics.march.configuration import settings_for

MODEL = oscillator().model


def march() -> March:
    """A march that has not begun."""
    return March(MODEL, settings_for(MODEL, step=0.1, until=1.0))


def segments_at(path: Path, *names: str) -> Path:
    """Put empty files where the segments of an archive would be."""
    folder = segments_folder(path)
    folder.mkdir()
    for name in names:
        (folder / name).touch()
    return folder


def test_segments_are_ten_seconds_or_a_hundredth_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a short run has none, and that writing them takes no more than its share of a long one."""
    clock = SimpleNamespace(now=100.0, monotonic=lambda: clock.now)
    monkeypatch.setattr(segments, "time", clock)
    with Segments(tmp_path / "run.nc", march(), resume=False) as made:
        assert (made.patience, len(made)) == (10.0, 0)
        due = []
        for clock.now, made._last in (
            (109.9, 100.0),
            (110.0, 100.0),
            (2100.0, 2080.1),
            (2100.0, 2080.0),
            (2100.0, 100.0),
        ):
            due.append(made.due)
        assert due == [False, True, False, True, True]
        made.failed = True
        assert not made.due
    assert list(tmp_path.iterdir()) == []


def test_a_segment_says_the_time_in_seconds(tmp_path: Path) -> None:
    """Assert that where a run is scaled its segments say how far it came in the unit of its messages, one after the other."""
    scaled = March(MODEL, settings_for(MODEL, step=0.1, until=1.0, scales={"time": "4 s"}))
    writer = SimpleNamespace(filled={}, shapes_since=lambda _: [], since=lambda _: iter([]))
    with Segments(tmp_path / "run.nc", scaled, resume=False) as made:
        for _ in range(2):
            made.keep(writer, {"now": np.array([(0.125,)], dtype=[("t", "f8")])}, {})
    names = segments._segment_names(segments_folder(tmp_path / "run.nc"))
    assert [name.name for name in names] == ["000001.segment", "000002.segment"]
    first, second = (segments.read_segment(name) for name in names)
    assert (first.header["t"], first.header["before"], second.header["before"]) == (0.5, "", first.digest)


def test_segments_stand_beside_the_file_itself(tmp_path: Path) -> None:
    """Assert that links lead to the segments of the file that they point to."""
    (tmp_path / "far").mkdir()
    (tmp_path / "run.nc").symlink_to(tmp_path / "far" / "real.nc")
    assert segments_folder(tmp_path / "run.nc") == (tmp_path / "far").resolve() / ".real.nc.segments"
    assert not has_segments(tmp_path / "run.nc")
    segments_at(tmp_path / "run.nc", "000001.segment")
    assert has_segments(tmp_path / "far" / "real.nc")


def test_segments_are_taken_in_their_order(tmp_path: Path) -> None:
    """Assert that the order in which a folder lists its files says nothing."""
    names = [f"{n:06d}.segment" for n in range(1, 40)]
    folder = segments_at(tmp_path / "run.nc", *names[::2], *names[1::2], "000040.part")
    assert [name.name for name in segments._segment_names(folder)] == names


def test_the_last_segment_goes_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what is left at any moment can be gone on from, and how many there were."""
    folder, gone = segments_at(tmp_path / "run.nc", "000002.segment", "000001.segment", "000003.part"), []
    unlink = Path.unlink
    monkeypatch.setattr(Path, "unlink", lambda path: gone.append(path.name) or unlink(path))
    assert discard(tmp_path / "run.nc") == 2
    assert gone == ["000003.part", "000002.segment", "000001.segment"]
    assert not folder.exists()
    with pytest.raises(xd.InputError, match="run.nc' has no segments: there is no '.*.run.nc.segments'"):
        discard(str(tmp_path / "run.nc"))


@pytest.mark.parametrize(
    ("error", "said"), [(PermissionError(13, "Permission denied"), "Permission denied"), (OSError("odd"), "odd")]
)
def test_what_cannot_be_removed_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: OSError, said: str
) -> None:
    """Assert one error with the folder and the cause, and that the folder is free for the next."""
    folder = segments_at(tmp_path / "run.nc", "000001.segment")

    def refuse(_: Path) -> None:
        raise error

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", refuse)
        with pytest.raises(xd.ArchiveError, match=f"the segments in '{folder}' cannot be removed: {said}$"):
            discard(tmp_path / "run.nc")
    assert discard(tmp_path / "run.nc") == 1


def test_a_folder_is_one_process_s_at_a_time(tmp_path: Path) -> None:
    """Assert that who holds the segments keeps others off until it is done, and leaves no descriptor open."""
    segments_at(tmp_path / "run.nc")
    before = os.open(tmp_path, os.O_RDONLY)
    os.close(before)
    with Segments(tmp_path / "run.nc", march(), resume=True):
        for act in (lambda: discard(tmp_path / "run.nc"), lambda: Segments(tmp_path / "run.nc", march(), resume=True)):
            with pytest.raises(xd.InputError, match="run.nc' is being marched by another process; wait for it, or end"):
                act()
    assert not segments_folder(tmp_path / "run.nc").exists()  # an empty one is of no use
    free = os.open(tmp_path, os.O_RDONLY)
    os.close(free)
    assert free == before


def test_where_there_are_no_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that segments are kept and removed on a file system that knows no locks."""

    def refuse(*_: object) -> None:
        raise OSError

    monkeypatch.setattr(fcntl, "flock", refuse)
    segments_at(tmp_path / "run.nc", "000001.segment")
    assert discard(tmp_path / "run.nc") == 1


def test_segments_are_asked_for(tmp_path: Path) -> None:
    """Assert that those of another run are not gone over, with both ways on."""
    segments_at(tmp_path / "run.nc", "000001.segment")
    with pytest.raises(xd.InputError, match=r"by resume \(--resume\), or remove them with `xdynamics discard"):
        Segments(tmp_path / "run.nc", march(), resume=False)
    with pytest.warns(xd.ResumeWarning, match="000001.segment' is damaged, or no segment .*: the run starts anew"):
        Segments(tmp_path / "run.nc", march(), resume=True).__exit__(None, None, None)
