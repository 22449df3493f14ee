"""The pipelines: each runs in one call, small, and leaves archives, figures and one page; each has the one form."""

from __future__ import annotations

import importlib.util
import io
import sys
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import dask
import numpy as np
import pytest
import xarray as xr
from dask.callbacks import Callback
from dask.diagnostics import progress

import xdynamics as xd
from cases.object_server import bucket
from cases.problems import MODELS, ROOT, particle
from cases.stages import marches, no_march
from cases.verdicts import verified
from xdynamics.evidence.cluster import cluster_of, connected
from xdynamics.evidence.stages import is_lazy

FIRST = "rocket_flight"  # the one that is run wherever one alone is: it is the README's
PIPELINES = sorted(
    (entry.parent.name for entry in (ROOT / "pipelines").glob("*/pipeline.py")), key=lambda name: (name != FIRST, name)
)
# of the studies what makes them small
SMALL: dict[str, dict[str, Any]] = {
    "chain_recurrence": {
        "step": "0.5 s",
        "rows": 201,
        "until": "2000 s",
        "recurrence": "1000 s",
        "refine": {"steps": ["0.4 s", "0.2 s"]},
    },
    "convergence_study": {"methods": ["velocity_verlet", "rk4"]},
    "oscillator_methods": {"until": "8 s"},
    "ball_with_drag": {
        "landing": {"steps": ["100 ms"], "until_change": {"event_time_ground": "1 ms", "after_ground_v_y": "1 cm s-1"}},
        "budget": {"quantity": "t", "event": "ground", "draws": 200},
    },
    "bouncing_ball_events": {},
    "coupled_modes": {"until": "5 s", "refine": {"steps": ["80 ms", "40 ms"], "at": ["5 s"]}},
    "cluster_study": {"members": 6, "times": "0:6:7 s", "budget": {"quantity": "y", "event": "apogee"}},
    "drag_grid": {"angle": {"first": 10.0, "last": 80.0, "count": 8}, "drag": {"first": 0.0, "last": 3e-3, "count": 4}},
    "impact_oscillator_bifurcation": {"frequencies": "2.4:3.0:12 s-1", "until": "60 s", "occurrences": [5, 15]},
    "mass_calibration": {"draws": 2000},
    "method_comparison": {"methods": ["velocity_verlet", "dop853"], "steps": "160, 80, 40 ms"},
    "pendulum_period": {
        "parameters": ["length", "damping", "theta"],
        "number": {"quantity": "t", "event": "middle", "draws": 200},
    },
    "pendulum_basins": {"x": "-2:2:12 m", "y": "-2:2:12 m", "close": {"x": "1.2:1.4:4 m", "y": "0.4:0.6:4 m"}},
    "rocket_flight": {"steps": ["20 ms", "10 ms"], "apogee": {"quantity": "y", "event": "apogee", "draws": 200}},
}


# by a fit, by levels that are added until a change is small, to know which members are extreme, or as one member
MARCHED_BEFORE = {"pendulum_period", "ball_with_drag", "cluster_study", "pendulum_basins"}


def main_of(name: str) -> Callable[..., str]:
    """The pipeline's main function."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "pipelines" / name / "pipeline.py")
    assert spec is not None
    assert spec.loader is not None
    pipeline = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pipeline)
    found: Callable[..., str] = pipeline.main
    return found


@pytest.mark.every(17)
@pytest.mark.parametrize("name", PIPELINES)
def test_it_leaves_archives_figures_and_a_page(name: str, tmp_path: Path) -> None:
    """Assert that everything is there, verified, and that the page names each with its digest."""
    study = tomllib.loads((ROOT / "pipelines" / name / "study.toml").read_text()) | SMALL[name]
    page = main_of(name)(str(tmp_path / "results"), study)
    archives = sorted((tmp_path / "results").glob("*.nc"))
    assert len(archives) >= 3
    kept = (tmp_path / "results" / "report.md").read_text()
    assert kept.strip() in page + "\n" or page.strip() in kept
    for archive in archives:
        assert f"{archive.name}, {verified(archive)}" in kept
    figures = sorted((tmp_path / "results").glob("*.png"))
    assert figures
    assert all(f"]({figure.name})" in kept and figure.stat().st_size > 10_000 for figure in figures)


@pytest.mark.every(3)
@pytest.mark.parametrize("name", [name for name in PIPELINES if name not in MARCHED_BEFORE])
def test_nothing_is_marched_before_the_report(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that all stages are described while every march fails."""
    stages: list[xr.Dataset] = []

    def reported(_: str, **described: Any) -> str:
        for entry in described.values():
            stages.extend(entry.values() if isinstance(entry, dict) else [entry])
        raise EOFError("reported")

    monkeypatch.setattr(xd, "report", reported)
    study = tomllib.loads((ROOT / "pipelines" / name / "study.toml").read_text()) | SMALL[name]
    with no_march(), pytest.raises(EOFError, match="reported"):
        main_of(name)(str(tmp_path / "results"), study)
    assert stages
    assert all(is_lazy(stage) for stage in stages)


@pytest.mark.parametrize("name", PIPELINES)
def test_it_has_the_one_form(name: str) -> None:
    """Assert study, 60 lines at most, a page with its command and a figure that is there."""
    folder = ROOT / "pipelines" / name
    assert len((folder / "pipeline.py").read_text().splitlines()) <= 60
    text = (folder / "README.md").read_text()
    assert f"python pipelines/{name}/pipeline.py results" in text
    figure = text.partition("](")[2].partition(")")[0]
    assert (folder / figure).is_file()
    assert (folder / "study.toml").is_file()


def test_the_cluster_study_is_the_same_on_a_cluster_and_an_object_store(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Assert the page of two threads, digests and all, from two processes whose runs are objects."""
    if not request.config.getoption("--whole"):
        pytest.skip("with --whole: a cluster and an object store are started")
    pytest.importorskip("s3fs")
    study = tomllib.loads((ROOT / "pipelines" / "cluster_study" / "study.toml").read_text()) | SMALL["cluster_study"]
    main = main_of("cluster_study")
    with dask.config.set(scheduler="threads", num_workers=2):
        here = main(str(tmp_path / "results"), study)
    with bucket(), cluster_of(None, 2) as client:
        assert connected() is client
        there = main("s3://bucket/results", study)
        logs = xd.open_logs("s3://bucket/results/rockets", [1.0])
        assert np.isfinite(logs.y.values).all()
    assert there == here


def test_what_the_pages_say_is_so() -> None:
    """Assert figures that READMEs of pipelines give: the numeric phase, the growth of Euler, the limit without drag."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    found = xd.diagnose(xd.simulate(oscillator, step="20 ms", until="32 s"), reference=np.pi, companion=False)
    ahead = 8 * 0.02**2 / 24 * (found.cycle_time.values - 2.356)
    assert found.phase_offset.values == pytest.approx(ahead, rel=0.02)
    ball = xd.Model.from_toml(MODELS / "ball_drag.toml")
    limit = xd.limiting(ball, "vt", ["100 m s-1", "1000 m s-1"], "1e7 m s-1", at=["1 s"], method="dop853", rtol=1e-12)
    away = np.abs(limit.distance_y.values[:, 0])
    assert away[0] / away[1] == pytest.approx(100.0, rel=0.05)


def test_a_chain_comes_back_as_its_page_says() -> None:
    """Assert when its longest mode has least and most of the energy, and that what leaves it goes as alpha squared."""
    chain = xd.Model.from_toml(MODELS / "fermi_pasta_ulam.toml")
    run = xd.simulate(chain, step="0.1 s", log=["mode_energy"], force_samples="none")
    share, late = (run.mode_energy[:, 0] / run.mode_energy[0, 0]).values, run.time.values > 9000.0
    assert run.time.values[share.argmin()] == pytest.approx(6898.0)
    assert share.min() == pytest.approx(0.0848, abs=1e-4)
    assert run.time.values[late][share[late].argmax()] == pytest.approx(10194.0)
    assert share[late].max() == pytest.approx(0.9804, abs=1e-4)
    asked = {"at": ["1000 s"], "observables": ["mode_energy[0]"], "until": "1000 s", "step": "0.5 s"}
    lost = xd.limiting(chain, "alpha", ["0.02 N m-2", "0.01 N m-2"], "0 N m-2", **asked)
    away = np.abs(lost.distance_mode_energy.values[:, 0, 0])
    assert away[0] / away[1] == pytest.approx(4.0, rel=0.05)


def test_reports_of_what_cannot_be_reported(tmp_path: Path) -> None:
    """Assert one error each for no record, a file in the folder's place, and what is no record."""
    run = xd.simulate(particle("F"), method="rk4", step=0.1, until=1.0)
    with pytest.raises(xd.InputError, match="report needs at least one record"):
        xd.report(tmp_path)
    (tmp_path / "file").write_text("")
    with pytest.raises(xd.InputError, match="'.*file' is a file; name a folder"):
        xd.report(tmp_path / "file", run=run)
    for other in (xd.Model.from_toml(MODELS / "kepler.toml"), {}, {"a": 1}, 3):
        with pytest.raises(xd.InputError, match="'other' is .*, needs a run, evidence, or several of them by name"):
            xd.report(tmp_path / "results", run=run, other=other)
    assert not (tmp_path / "results").exists()


def test_records_drawn_together(tmp_path: Path) -> None:
    """Assert that of evidence only refinements of one thing, or diagnoses, are drawn together."""
    by_step, by_tolerance = (
        xd.refine(particle("F*cos(t/second)"), method="dop853", until=1.0, **one)
        for one in ({"steps": [0.2, 0.1]}, {"rtols": [1e-4, 1e-6]})
    )
    with pytest.raises(xd.InputError, match="several records are drawn together if all are refinements of one thing"):
        xd.plot({"a": by_step, "b": by_tolerance})
    assert xd.plot({"a": by_step, "b": by_step}, tmp_path / "two.svg").axes


def test_the_record_gives_back_what_was_put_in() -> None:
    """Assert that the pendulum's fit holds the numbers that its record was made with, within three uncertainties."""
    folder = ROOT / "pipelines" / "pendulum_period"
    study = tomllib.loads((folder / "study.toml").read_text())
    found = xd.fit(xd.Model.from_toml(ROOT / study["model"]), folder / study["record"], study["parameters"])
    truth = dict(zip(study["parameters"], (0.994, 0.061, 0.341, 0.0), strict=True))
    for name, value, doubt in zip(
        found.parameter_name.values, found.estimate.values, found.standard_uncertainty.values, strict=True
    ):
        assert abs(value - truth[str(name)]) < 3 * doubt


class Terminal(io.StringIO):
    """Keeps what is written to a terminal."""

    def isatty(self) -> bool:
        """Say that it is one."""
        return True


def test_a_report_computes_its_stages_in_one_graph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one graph with one bar, archives as of eager stages, one march of what they share, and each drawn."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    asked: dict[str, Any] = {"method": "rk4", "until": "10 s"}
    run = xd.simulate(oscillator, step="20 ms", **asked)
    stages = {
        "study": xd.refine(oscillator, steps=["20 ms", "10 ms"], compute=False, **asked),
        "beside": xd.companion(run, compute=False),
        "budget": xd.error_budget(oscillator, "x", at="5 s", step="20 ms", compute=False, **asked),
    }
    graphs: list[Any] = []
    bar: Any = progress.ProgressBar  # it is not typed
    with monkeypatch.context() as seen, marches() as begun, Callback(start=graphs.append):
        seen.setattr(sys, "stderr", Terminal())
        seen.setattr(
            progress, "ProgressBar", lambda **how: bar(**how | {"minimum": 0.0})
        )  # without its second of patience
        page = xd.report(tmp_path / "lazy", run=run, **stages)
        drawn = str(sys.stderr.getvalue())  # type: ignore[attr-defined]
    assert len(graphs) == 1
    assert drawn.count("100% Completed") == 1
    assert begun.count("Harmonic oscillator rk4 0.01") == 1
    eager = {
        "study": xd.refine(oscillator, steps=["20 ms", "10 ms"], **asked),
        "beside": xd.companion(run),
        "budget": xd.error_budget(oscillator, "x", at="5 s", step="20 ms", **asked),
    }
    assert xd.report(tmp_path / "eager", run=run, **eager) == page
    assert {entry.name for entry in (tmp_path / "lazy").iterdir()} == {
        entry.name for entry in (tmp_path / "eager").iterdir()
    }


def test_a_stage_that_fails_leaves_the_others_whole(tmp_path: Path) -> None:
    """Assert that the page names it with its reason, that all others are archived, and that the call ends with it."""
    oscillator = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    asked: dict[str, Any] = {"method": "rk4", "steps": ["20 ms", "10 ms"], "until": "2 s", "compute": False}
    good, bad = xd.refine(oscillator, **asked), xd.refine(oscillator, at=["3 s"], **asked)
    with marches() as begun, pytest.raises(xd.InputError, match="'late' failed: at has 3"):
        xd.report(tmp_path / "results", late=bad, study=good)
    assert len(begun) == 2
    page = (tmp_path / "results" / "report.md").read_text()
    assert "## late\n\nfailed    at has 3.0 s" in page
    assert f"study.nc, {verified(tmp_path / 'results' / 'study.nc')}" in page
    assert not (tmp_path / "results" / "late.nc").exists()
