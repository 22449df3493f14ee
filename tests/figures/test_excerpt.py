"""Figures of long runs in chunks: few rows are kept, each chunk is read once, and nothing that is seen is lost."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.chunked import chunked, ragged
from cases.problems import MODELS
from xdynamics.figures import excerpt
from xdynamics.record.named_rows import rows_named

LONG: dict[str, dict[str, Any]] = {
    "bouncing_ball": {"until": 10.0, "step": 5e-4},
    "double_pendulum": {"until": 10.0, "step": 5e-4, "method": "rk4"},
    "impact_oscillator_section": {"until": 40.0, "step": 2e-3},
}


@pytest.fixture(params=LONG, scope="module")
def long(request: pytest.FixtureRequest) -> xr.Dataset:
    """Return a run of 20,000 rows."""
    return xd.simulate(xd.Model.from_toml(MODELS / f"{request.param}.toml"), **LONG[request.param])


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let 20,000 rows be too many to be drawn as they are."""
    monkeypatch.setattr(excerpt, "MOST_NUMBERS", 200_000)


@pytest.mark.dear
@pytest.mark.usefixtures("few")
def test_an_excerpt_has_the_extremes_and_the_events(long: xr.Dataset) -> None:
    """Assert the least and greatest value of every state and energy, and the states at events, with each chunk read once."""
    lazy, reads = chunked(long, ragged(long.sizes["step"], 23, 1))
    found = excerpt.excerpt_of(lazy)
    assert max(reads.values()) == 1
    assert found.sizes["step"] < long.sizes["step"] / 3
    for name, variable in found.data_vars.items():
        if variable.dims == ("step",) and variable.attrs.get("role") in (
            "coordinate",
            "velocity",
            "energy",
            "reaction",
        ):
            assert (variable.min(), variable.max()) == (long[name].min(), long[name].max()), name
    assert np.array_equal(found.time[rows_named(found, "event_row_before")], long.event_time)
    assert np.array_equal(found.time, long.time[found.step])


@pytest.mark.dear
@pytest.mark.usefixtures("few")
def test_a_figure_of_an_excerpt_shows_what_that_of_the_run_shows(long: xr.Dataset) -> None:
    """Assert the same panels, marks and names, axes of the same extents, with each chunk read once."""
    lazy, reads = chunked(long, ragged(long.sizes["step"], 23, 2))
    whole, found = (xd.plot(run).axes for run in (long, lazy))
    assert max(reads.values()) == 1
    assert sum(read == "time" for read, _ in reads) == 23
    assert len(whole) == len(found)
    for one, other in zip(whole, found, strict=True):
        assert other.get_title(loc="left") == one.get_title(loc="left")
        assert [text.get_text() for text in other.texts] == [text.get_text() for text in one.texts]
        assert other.axis() == pytest.approx(one.axis(), rel=2e-3)
        marks = [[line.get_xydata() for line in axes.lines if line.get_linestyle() == "None"] for axes in (one, other)]
        assert all(np.array_equal(*pair) for pair in zip(*marks, strict=True))


def test_a_figure_of_a_short_run_reads_each_chunk_once() -> None:
    """Assert one reading of every chunk that is drawn, times among them, where all rows are drawn."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until=2.0)
    sizes = ragged(run.sizes["step"], 5, 3)
    lazy, reads = chunked(run, sizes)
    xd.plot(lazy)
    assert {*reads.values()} == {1}
    for name in ("time", "y", "v_y"):
        assert sum(read == name for read, _ in reads) == len(sizes)


@pytest.mark.parametrize("is_lazy", [False, True])
def test_no_chord_is_drawn_through_a_phase_portrait(monkeypatch: pytest.MonkeyPatch, *, is_lazy: bool) -> None:
    """Assert that every piece of the curve of a long oscillation is as near to its circle as the record is."""
    monkeypatch.setattr(excerpt, "MOST_NUMBERS", 200_000)
    run = xd.simulate(xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"), method="rk4", step=0.01, until=300.0)
    assert run.sizes["step"] > 20_000
    axes = xd.plot(run.chunk(step=7000, inline_array=True) if is_lazy else run, only="phase").axes[-1]
    assert axes.get_title(loc="left").startswith("phase portrait")
    x, v = np.asarray(max((line.get_xydata() for line in axes.lines), key=len)).T
    assert np.isfinite(x).sum() > 1000
    amplitudes = float(np.abs(run.x).max()), float(np.abs(run.v_x).max())
    middles = [(values[1:] + values[:-1]) / 2.0 / size for values, size in zip((x, v), amplitudes, strict=True)]
    distances = np.hypot(*middles)
    assert np.nanmin(distances) == pytest.approx(1.0, abs=2e-3)


@pytest.mark.dear
@pytest.mark.usefixtures("few")
def test_many_events_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that of many events the first and last of each name and the largest impulses are kept, each chunk read once."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until=10.0, step=5e-4)
    monkeypatch.setattr(excerpt, "_max_rows_per_column", lambda _: 40)
    found = excerpt.excerpt_of(run.chunk(step=1000, event=7, inline_array=True))
    assert found.sizes["event"] < run.sizes["event"]
    assert found.event_impulse_y.max() == run.event_impulse_y.max()
    assert set(found.event_kind.values) == set(run.event_kind.values)
    assert np.array_equal(found.time[rows_named(found, "event_row_before")], found.event_time)


@pytest.mark.dear
def test_a_run_in_chunks_is_reported_as_the_one_in_memory(tmp_path: Any) -> None:
    """Assert the same page, archive and figure."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until=1.0)
    xd.save(run, tmp_path / "run.nc")
    pages = [
        xd.report(tmp_path / name, run=given)
        for name, given in (("lazy", xd.open_run(tmp_path / "run.nc", chunks={"step": 100})), ("whole", run))
    ]
    assert pages[0] == pages[1]
    assert (tmp_path / "lazy/run.png").read_bytes() == (tmp_path / "whole/run.png").read_bytes()
