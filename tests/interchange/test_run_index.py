"""An index of archived runs: a row a run, numbers read when they are used, and several models marched into a folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
SPRING = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
SPEEDS = (20.0, 30.0, 40.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three balls, an oscillator, a ledger and a text."""
    path: Path = tmp_path_factory.mktemp("runs")
    for vt in SPEEDS:
        xd.simulate(BALL.replace(parameters={"vt": vt}), rtol=1e-6, path=path / f"ball_{vt:g}.nc")
    xd.simulate(SPRING, until="4 s", path=path / "spring.nc")
    xd.save(xd.validate(xd.Model.from_toml(MODELS / "bouncing_ball.toml")), path / "ledger.nc")
    (path / "text.nc").write_text("no archive")
    (path / "notes.txt").write_text("nothing")
    return path


def test_an_index_has_what_each_run_says_of_itself(folder: Path) -> None:
    """Assert names, outcomes, settings, parameters with nan where a model has none, and what was left out."""
    found = xd.open_runs(folder)
    assert found.member.values.tolist() == ["ball_20.nc", "ball_30.nc", "ball_40.nc", "spring.nc"]
    assert found.run_outcome.values.tolist() == ["stopped_by_event"] * 3 + ["completed"]
    assert found.vt.values[:3].tolist() == [*SPEEDS]
    assert np.isnan(found.vt.values[3])
    assert found.vt.attrs["units"] == "m s-1"
    assert found.solver_step.values.tolist()[3] == 1e-3
    assert [line.split("'")[1].rsplit("/")[-1] for line in found.attrs["left_out"].splitlines()] == [
        "ledger.nc",
        "text.nc",
    ]
    assert found.sel(member="ball_30.nc").solver_method == "midpoint"


def test_numbers_are_those_of_the_runs(folder: Path) -> None:
    """Assert ends, events, both sides of them and a diagnosis against the records, lazily; nan where there is none."""
    words = [
        *("end", "end_total_energy", "event_time_ground", "event_count_apex", "after_ground_v_y"),
        *(
            "before_ground_v_y",
            "event_residual_ground",
            "energy_drift",
            "maximum_y",
            "run_fastest_rate",
            "turning_time",
        ),
    ]
    found = xd.open_runs(folder, keep=words)
    assert all(found[word].chunks is not None for word in words[1:])
    loaded = found.load()
    for k, vt in enumerate(SPEEDS):
        with xd.open_run(folder / f"ball_{vt:g}.nc") as run:
            ground, apex = (run.dynamics.events(name) for name in ("ground", "apex"))
            diagnosis = xd.diagnose(run, companion=False)
            expected = {
                "end_y": run.y[-1],
                "end_total_energy": run.total_energy[-1],
                "event_time_ground": ground.event_time[0],
                "event_count_apex": apex.sizes["event"],
                "after_ground_v_y": ground.after_v_y[0],
                "before_ground_v_y": ground.before_v_y[0],
                "event_residual_ground": ground.event_residual[0],
                "energy_drift": diagnosis.energy_drift,
                "maximum_y": diagnosis.maximum_y,
                "turning_time": diagnosis.turning_time[0],
                "run_fastest_rate": run.attrs["run_fastest_rate"],
            }
            for name, value in expected.items():
                assert float(loaded[name][k]) == float(value), name
    assert np.isnan(loaded.event_time_ground[3])
    assert loaded.end_x.attrs["units"] == "m"
    assert np.isnan(loaded.end_x.values[:3]).all()


def test_a_file_is_verified_when_it_is_read(folder: Path, tmp_path: Path) -> None:
    """Assert an error by name for a file that was replaced since, or damaged, and none for the index itself."""
    path = tmp_path / "a.nc"
    path.write_bytes((folder / "ball_20.nc").read_bytes())
    found = xd.open_runs([path])
    path.write_bytes((folder / "ball_30.nc").read_bytes())
    with pytest.raises(xd.ArchiveError, match=r"a\.nc' is another run than when it was indexed"):
        found.load()
    content = bytearray((folder / "ball_20.nc").read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(bytes(content))
    damaged = xd.open_runs(path)
    with pytest.raises(xd.ArchiveError, match="damaged"):
        damaged.load()


def test_units_are_those_of_the_first(tmp_path: Path) -> None:
    """Assert numbers of a run whose coordinate has another unit, and an error for one of another kind."""
    text = (MODELS / "harmonic_oscillator.toml").read_text()
    (tmp_path / "cm.toml").write_text(
        text.replace('x = { unit = "m"', 'x = { unit = "cm"').replace('x = "1 m"', 'x = "100 cm"')
    )
    for name, model in (("a", SPRING), ("b", xd.Model.from_toml(tmp_path / "cm.toml"))):
        xd.simulate(model, until="1 s", path=tmp_path / f"{name}.nc")
    ends = xd.open_runs(str(tmp_path / "*.nc"), keep="end_x").end_x
    assert ends.attrs["units"] == "m"
    assert float(ends[1]) == pytest.approx(float(ends[0]), rel=1e-12)


WRONG: dict[str, tuple[Any, dict[str, Any], str]] = {
    "nowhere": ("none", {}, "'none' does not exist"),
    "an empty folder": ("empty", {}, "there is no archived run in 'empty'; it has no .nc file"),
    "a pattern of nothing": ("*.hdf", {}, "there is no archived run in"),
    "evidence": (["ledger.nc"], {}, "'ledger.nc' is evidence, no run"),
    "a text": (["text.nc"], {}, "cannot be opened as a run archive"),
    "a number": (3, {}, "need a folder, a pattern like 'results/*.nc', or files"),
    "nothing": ([], {}, "need a folder"),
    "a number to keep": (".", {"keep": 3}, "keep is 3, needs words like 'end'"),
    "an unknown word": (".", {"keep": "event_time_grund"}, "keep has 'event_time_grund', which no run, event or"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_named(case: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one clear error."""
    monkeypatch.chdir(folder)
    (folder / "empty").mkdir(exist_ok=True)
    runs, more, words = WRONG[case]
    with pytest.raises((xd.InputError, xd.ArchiveError)) as caught:
        xd.open_runs(runs, **more)
    assert words in str(caught.value)


def test_a_table_of_several_files_has_chosen_numbers(folder: Path, tmp_path: Path) -> None:
    """Assert the columns of a table of files, and of a folder, with numbers by name and without digests on a terminal."""
    files = sorted(str(path) for path in folder.glob("ball_*.nc"))
    ask: Any = CliRunner().invoke
    shown = ask(main, ["table", *files, "--keep", "event_time_ground"]).output
    assert "event_time_ground [s]" in shown
    assert "digest" not in shown
    target = tmp_path / "t.csv"
    done = ask(main, ["table", str(folder), "--keep", "event_time_ground,energy_drift", "-o", str(target)])
    assert done.exit_code == 0, done.output
    header, *rows = target.read_text().splitlines()
    assert header.split(",")[0] == "member"
    assert header.endswith("event_time_ground [s],energy_drift [J]")
    assert len(rows) == 4


def test_several_models_are_marched_into_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert an archive of each name, JSON line by line, and that nothing is marched where one model cannot be."""
    monkeypatch.chdir(tmp_path)
    models = [str(MODELS / f"{name}.toml") for name in ("ball_drag", "harmonic_oscillator")]
    ask: Any = CliRunner().invoke
    done = ask(main, ["run", *models, "-o", "out", "--until", "1 s", "--json"])
    assert done.exit_code == 0, done.output
    assert [json.loads(line)["archive"] for line in done.output.splitlines()] == [
        "out/ball_drag.nc",
        "out/harmonic_oscillator.nc",
    ]
    with xr.open_dataset("out/ball_drag.nc", engine="xdynamics") as run:
        assert float(run.time[-1]) == 1.0
    for arguments, words in (
        ([*models, "-o", "a.nc"], "-o 'a.nc' is one archive, and there are 2 models; give a folder"),
        ([models[0], models[0], "-o", "b"], "two models are called 'ball_drag'"),
        ([models[0], "none.toml", "-o", "c"], "none.toml' cannot be read"),
        ([*models, "-o", "d", "--set", "vt=3"], "--set vt: no such parameter"),
    ):
        failed = ask(main, ["run", *arguments])
        assert failed.exit_code == 2
        assert words in failed.output
        assert not [path for path in Path().glob("[abcd]*/*.nc") if path.parent.name != "out"]
