"""A march straight into a file: how many rows at a time, and what is known of its length beforehand."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import netCDF4
import pytest

import xdynamics as xd
from cases.problems import MODELS, oscillator
from cases.verdicts import verified
from xdynamics.archive import segments
from xdynamics.archive.seals import CHUNKS
from xdynamics.archive.writing import Writer
from xdynamics.march import March
from xdynamics.march.configuration import settings_for
from xdynamics.schema import EVENTS, SAMPLES, STEPS, TRIALS

MODEL = oscillator().model


@pytest.mark.parametrize(
    ("columns", "elements", "expected", "rows"),
    [
        (10, False, 0, 131_072),
        (10, False, 201, 201),
        (10, False, 10**6, 131_072),
        (999, False, 10**6, 32_032),
        (1000, False, 0, 32_000),
        (1000, True, 0, 4000),
        (5_000_000, True, 10**6, 1),
    ],
)
def test_a_block_is_bounded(columns: int, elements: bool, expected: int, rows: int) -> None:
    """Assert that a block has no more rows than its march, than a chunk, and than 256 MB of numbers, 32 MB of elements."""
    shapes = SimpleNamespace(shapes=SimpleNamespace(dims={"u": ("site",)} if elements else {}))
    layout = SimpleNamespace(row=SimpleNamespace(size=columns), watched=(), model=shapes)
    march: Any = SimpleNamespace(layout=layout, expected_rows=expected)
    assert segments._rows_per_block(march) == rows


def test_a_run_of_one_block_is_as_long_as_it_is(tmp_path: Path) -> None:
    """Assert chunks as long as a short run, none for what it has none of, and whole ones of a run in blocks."""
    model, path = xd.Model.from_toml(MODELS / "pendulum.toml"), tmp_path / "run.nc"
    run = xd.simulate(model, step=0.05, until=3.0, path=path)
    dims = (STEPS, EVENTS, SAMPLES, TRIALS)
    with netCDF4.Dataset(path) as file:
        found = {dim: (len(file.dimensions[dim]), file.dimensions[dim].isunlimited()) for dim in dims}
        assert found == {dim: (run.sizes[dim], run.sizes[dim] == 0) for dim in dims}
        assert run.sizes[TRIALS] == 0
        assert [file[name].chunking() for name in ("theta", "event_time")] == [[run.sizes[STEPS]], [1]]
        assert file["theta"].coordinates == "time"
        assert "coordinates" not in [*file["time"].ncattrs(), *file["event_time"].ncattrs(), *file["g"].ncattrs()]


def test_rows_at_events_leave_a_short_run_short(tmp_path: Path) -> None:
    """Assert that rows at events, which nobody knows beforehand, make no large file of a short run."""
    xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), path=tmp_path / "run.nc").close()
    assert (tmp_path / "run.nc").stat().st_size < 1_000_000


def test_a_run_of_blocks_may_grow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that where the end is not in sight the steps are unlimited, and the content is the same."""
    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)
    streamed = xd.simulate(MODEL, step=0.01, until=2.0, path=tmp_path / "run.nc")
    assert verified(tmp_path / "run.nc") == xd.content_digest(xd.simulate(MODEL, step=0.01, until=2.0))
    streamed.close()
    with netCDF4.Dataset(tmp_path / "run.nc") as file:
        assert file.dimensions[STEPS].isunlimited()
        assert file["x"].chunking() == [CHUNKS[STEPS]]


def test_segments_are_kept_while_the_run_is_not_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert a segment behind every block that is due but the last, and none of them left in the end."""
    kept: list[int] = []
    due, keep = [False, True, True], segments.Segments.keep

    def kept_too(one: segments.Segments, writer: Writer, *given: Any) -> None:
        kept.append(writer.filled["x"])
        keep(one, writer, *given)

    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)
    monkeypatch.setattr(segments.Segments, "due", property(lambda _: due.pop(0) if due else True))
    monkeypatch.setattr(segments.Segments, "keep", kept_too)
    march = March(MODEL, settings_for(MODEL, step=0.01, until=2.0))
    assert segments.stream(march, str(tmp_path / "run.nc")) == tmp_path / "run.nc"
    assert kept == [108, 162]
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.nc"]


def test_a_write_that_fails_ends_the_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what goes wrong while the next block is marched, or behind the last, is told."""
    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)

    write = Writer.write

    def refuse(one: Writer, parts: list[Any]) -> None:
        if len(parts) > 1:  # a block, not a constant
            raise OSError(28, "No space left on device")
        write(one, parts)

    monkeypatch.setattr(Writer, "write", refuse)
    for until in (0.1, 2.0):
        march = March(MODEL, settings_for(MODEL, step=0.01, until=until))
        with pytest.raises(xd.ArchiveError, match="cannot be written: No space left on device"):
            segments.stream(march, tmp_path / "run.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_nothing_behind(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run extended on a disk that is full ends without its file, and without a folder for its segments."""
    kept = xd.save(xd.simulate(MODEL, step=0.01, until=1.0), tmp_path / "run.nc")

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(segments, "BLOCK_ROWS", 50)
    monkeypatch.setattr(segments.Segments, "due", property(lambda self: not self.failed))
    monkeypatch.setattr(segments, "write_segment", full)
    monkeypatch.setattr(Writer, "finish", full)
    with (
        pytest.warns(xd.ResumeWarning, match="no more segments of .*: No space left on device; the run goes on"),
        pytest.raises(xd.ArchiveError, match="cannot be written: No space left on device"),
    ):
        xd.extend(kept, until=3.0, path=tmp_path / "longer.nc")
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.nc"]


def test_the_model_s_own_file_is_no_target(tmp_path: Path) -> None:
    """Assert that a march refuses the file that its model is from, before anything is made beside it."""
    path = tmp_path / "free.toml"
    path.write_text(MODEL.to_toml())
    model = xd.Model.from_toml(path)
    with pytest.raises(xd.InputError, match="is the model file itself"):
        segments.stream(March(model, settings_for(model, step=0.1, until=1.0)), path)
    assert [entry.name for entry in tmp_path.iterdir()] == ["free.toml"]
