"""Runs opened in chunks: the same bits as of runs in memory, each chunk read once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.chunked import chunked, ragged
from cases.problems import MODELS
from xdynamics.evidence.stage_tasks import LIMIT

DIAGNOSED: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "harmonic_oscillator": (
        {"method": "velocity_verlet", "step": 0.05, "until": 20.0},
        {"exact": {"x": "cos(2*t/second)*metre"}},
    ),
    "ball_drag": ({"step": 0.05}, {}),
    "double_pendulum": ({"method": "dop853", "rtol": 1e-6, "until": 5.0}, {}),
    "kepler": ({"method": "radau_iia", "rtol": 1e-6, "until": 5.0}, {"of": "y", "reference": 1.0}),
    "coupled_masses": ({"until": 5.0}, {"level": "1 mm"}),
    "bouncing_ball": ({"until": 3.0}, {}),
}


def assert_same(found: xr.Dataset, whole: xr.Dataset) -> None:
    """Assert the same names, attributes and bits."""
    assert list(found.variables) == list(whole.variables)
    for name, variable in whole.variables.items():
        assert repr(found[name].attrs) == repr(variable.attrs), name
        assert found[name].values.tobytes() == variable.values.tobytes(), name


@pytest.mark.cases(46)
def test_a_diagnosis_of_chunks_has_the_bits_of_that_of_the_whole(case: int) -> None:
    """Assert every result over ragged chunks, some of one row, with no chunk of any variable read twice."""
    name = [*DIAGNOSED][case % len(DIAGNOSED)]
    asked, more = DIAGNOSED[name]
    run = xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), **asked)
    lazy, reads = chunked(run, ragged(run.sizes["step"], 2 + case % 17, case))
    found = xd.diagnose(lazy, **more)
    assert_same(found, xd.diagnose(run, **more))
    assert reads
    assert max(reads.values()) == 1


@pytest.mark.dear
def test_a_diagnosis_of_more_than_is_remembered_reads_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a run longer than the bound is diagnosed, to the same bits: its times and forces are read once."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until=1.0)
    xd.save(run, tmp_path / "run.nc")
    monkeypatch.setenv(LIMIT, "0.0001")
    with xd.open_run(tmp_path / "run.nc") as kept:
        lazy, reads = chunked(kept, [50, run.sizes["step"] - 50])
        found = xd.diagnose(lazy, companion=False)
    assert_same(found, xd.diagnose(run, companion=False))
    assert 1 < max(reads.values()) < 30
    assert {reads[name, 0] for name in ("time", "force_gravity_y")} == {1}


def test_chunks_of_quantities_with_dimensions_are_read_once() -> None:
    """Assert every result of three bodies in a plane, whose six elements lie in one chunk, with exponents."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "figure_eight.toml"), until=1.0)
    lazy, reads = chunked(run, ragged(run.sizes["step"], 4, 0))
    asked: dict[str, Any] = {"companion": False, "lyapunov": 1}
    assert_same(xd.diagnose(lazy, **asked), xd.diagnose(run, **asked))
    assert {*reads.values()} == {1}


def test_samples_and_comparisons_read_each_chunk_once() -> None:
    """Assert 300 times in any order on ragged chunks: the bits of the whole, and of two runs no chunk read twice."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"), method="rk4", step=0.05, until=10.0)
    times = np.random.default_rng(0).uniform(0.0, 10.0, 300)
    (lazy, reads), (other, others) = (chunked(run, ragged(run.sizes["step"], parts, 3)) for parts in (7, 5))
    assert_same(xd.sample(lazy, times).compute(), xd.sample(run, times))
    assert max(reads.values()) == 1
    reads.clear()
    assert (xd.compare(lazy, other, times=times).compute().difference_x == 0).all()
    assert max(reads.values()) == max(others.values()) == 1
