"""The segments of one march: when there is one, where they are, and how they go.

A stretch of a march as a file: what was written comes back, and what was not is told.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import oscillator
from xdynamics.archive import segments
from xdynamics.archive.seals import Seal
from xdynamics.archive.segments import Segments, discard, has_segments, segments_folder
from xdynamics.faults import ArchiveError
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
            with pytest.raises(
                xd.InputError, match="run.nc' is being computed by another process; wait for it, or end"
            ):
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


MEMORY = {
    "now": np.array([(1.5, 3)], dtype=[("t", "<f8"), ("n", "<i8")]),
    "y": np.arange(6.0).reshape(2, 3),
    "none": np.zeros((0, 4)),
}
ROWS = {
    "x": np.arange(10.0),
    "pairs": np.arange(14.0).reshape(7, 2),
    "flag": np.zeros((0,), "i1"),
    "rare": np.zeros((0, 2)),
}


def seals() -> dict[str, Seal]:
    """Digests of nothing so far."""
    return {name: Seal(name, ("n", "m")[: row.ndim], row.dtype) for name, row in ROWS.items()}


def digests() -> dict[str, str]:
    """The digest of every variable with its rows."""
    made = seals()
    for name, row in ROWS.items():
        made[name].update(row)
    return {name: value.hexdigest() for name, value in made.items()}


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A segment."""
    shapes = [(name, row.dtype, row.shape) for name, row in ROWS.items()]
    segments.write_segment(tmp_path / "1.segment", {"of": "a run", "digests": digests()}, MEMORY, shapes, ROWS.values())
    return tmp_path / "1.segment"


def test_a_segment_comes_back(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert memory and rows bit by bit, rows in pieces, one at least of every variable, and the digest of the head."""
    found = segments.read_segment(path)
    assert (found.header["of"], found.path) == ("a run", path)
    head = path.read_bytes().partition(b"\nsha256 ")[0]
    assert found.digest == hashlib.sha256(head).hexdigest()
    memory = found.memory()
    assert list(memory) == list(MEMORY)
    for name, value in MEMORY.items():
        assert (memory[name].dtype, memory[name].shape) == (value.dtype, value.shape)
        assert memory[name].tobytes() == value.tobytes()
    none = [(0,), (0, 2)]
    by_pairs = [(4,), (4,), (2,), (2, 2), (2, 2), (2, 2), (1, 2)]
    for piece, shapes in ((1 << 22, [(10,), (7, 2)]), (32, by_pairs), (8, [(1,)] * 10 + [(1, 2)] * 7)):
        monkeypatch.setattr(segments, "_PIECE", piece)
        parts = list(found.rows())
        assert [one.shape for _, one in parts] == shapes + none
        for name, row in ROWS.items():
            assert np.concatenate([part for other, part in parts if other == name]).tobytes() == row.tobytes()


def test_rows_come_four_megabytes_at_a_time(tmp_path: Path) -> None:
    """Assert that the memory a segment takes is bounded, however long it is."""
    values = np.arange(600_000.0)
    segments.write_segment(tmp_path / "1.segment", {}, {}, [("x", values.dtype, values.shape)], [values])
    assert [len(part) for _, part in segments.read_segment(tmp_path / "1.segment").rows()] == [
        1 << 19,
        600_000 - (1 << 19),
    ]


def test_rows_are_held_against_digests(path: Path) -> None:
    """Assert that a digest of all rows so far passes, and that what differs in kind or value is named."""
    found = segments.read_segment(path)
    found.check(seals())
    for missing in ROWS:
        with pytest.raises(ArchiveError, match=f"has a variable '{missing}' that the run has not"):
            found.check({name: seal for name, seal in seals().items() if name != missing})
    with pytest.raises(ArchiveError, match="has a variable 'flag' that the run has not"):
        found.check(seals() | {"flag": Seal("flag", ("n",), np.dtype("i2"))})
    begun = seals()
    begun["pairs"].update(np.ones((1, 2)))
    with pytest.raises(ArchiveError, match="differs from the digest of 'pairs'"):
        found.check(begun)
    with pytest.raises(ArchiveError, match="differs from the digest of 'more'"):
        found.check(seals() | {"more": Seal("more", ("n",), np.dtype("f8"))})


def said(memory: Any = (), rows: Any = (), **more: Any) -> bytes:
    """The first line of a segment."""
    return json.dumps({"kind": "xdynamics segment 1", "memory": memory, "rows": rows} | more).encode() + b"\n"


def sealed(head: bytes) -> bytes:
    """A head with its digest."""
    return head + b"\nsha256 " + hashlib.sha256(head).hexdigest().encode() + b"\n"


@pytest.mark.parametrize(
    ("content", "fault"),
    [
        (sealed(said(kind="xdynamics segment 2")), "is of another version"),
        (said([["y", "<f8", [1000]]]), "is cut off"),
        (said([["y", "<f8", [-1]]]), "is cut off"),
        (said([["y", "<f8", [1]]]) + bytes(8), "differs from its digest"),
        (sealed(said([["y", "<f8", [1]]]) + bytes(8))[:-1], "differs from its digest"),
        (sealed(said()) + b"1", r"has 132 bytes and says 131"),
        (sealed(said(rows=[["x", "<f8", [2, 3]]])), r"has \d+ bytes and says \d+"),
        (sealed(said(rows=[["x", "no", [2]]])), "is damaged, or no segment of this version"),
        (sealed(said(rows=[["x", "<f8", ["2"]]])), "is damaged, or no segment of this version"),
        (sealed(b"[]\n"), "is damaged, or no segment of this version"),
        (b"\xff\n", "is damaged, or no segment of this version"),
    ],
)
def test_what_is_no_segment_is_told(tmp_path: Path, content: bytes, fault: str) -> None:
    """Assert a predicate for whatever a file may hold."""
    (tmp_path / "1.segment").write_bytes(content)
    with pytest.raises(ArchiveError, match=f"^{fault}$"):
        segments.read_segment(tmp_path / "1.segment")


def test_what_cannot_be_read_is_told(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a folder, a file that the system does not open and a line without an end are told from damage."""
    with pytest.raises(ArchiveError, match="^is no file$"):
        segments.read_segment(path.parent)
    with monkeypatch.context() as patch:
        patch.setattr(segments, "_read_segment_head", refuse)
        with pytest.raises(ArchiveError, match="^cannot be read: Input/output error$"):
            segments.read_segment(path)
    monkeypatch.setattr(segments, "_LONGEST_LINE", 100)
    with pytest.raises(ArchiveError, match="is damaged, or no segment"):
        segments.read_segment(path)


def refuse(*_: object) -> Any:
    """Fail as a disk does."""
    raise OSError(5, "Input/output error")


def test_a_segment_is_whole_or_not_there(path: Path) -> None:
    """Assert that a write that breaks off leaves the old one as it was, and no part."""
    before = path.read_bytes()
    with pytest.raises(ArchiveError, match="1.segment' cannot be written: Input/output error; nothing is changed"):
        segments.write_segment(path, {}, {}, [("x", "f8", (2,))], (refuse() if n else np.ones(1) for n in range(2)))
    assert path.read_bytes() == before
    assert [entry.name for entry in path.parent.iterdir()] == ["1.segment"]
