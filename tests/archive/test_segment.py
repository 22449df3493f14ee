"""A stretch of a march as a file: what was written comes back, and what was not is told."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from xdynamics.archive import segments
from xdynamics.archive.seals import Seal
from xdynamics.faults import ArchiveError

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
