"""The verb of grids on the command line, its figures, and what folders of runs tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main

BALL = MODELS / "ball_drag.toml"


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.mark.dear
def test_a_sweep_is_marched_shown_drawn_and_verified(tmp_path: Path) -> None:
    """Assert axes, outcomes, files, figure and seals, and that the same command marches nothing again."""
    folder, asked = tmp_path / "s", ["--axis", "vt=20:60:5 m s-1", "--axis", "method=heun,dop853", "--rtol", "1e-8"]
    done = call(
        "sweep", BALL, *asked, "--keep", "end,event_time_ground", "--keep", "log", "--check", "0.5", "-o", folder
    )
    assert done.exit_code == 0, done.output
    assert "axis      vt: 5 values, 20, 30, 40, 50, 60 m s-1" in done.output
    assert "outcomes  10 stopped_by_event" in done.output
    written = (folder / "catalogue.nc").stat().st_mtime_ns
    again = call("sweep", BALL, *asked, "--keep", "end,event_time_ground", "--keep", "log", "-o", folder)
    assert again.exit_code == 0
    assert (folder / "catalogue.nc").stat().st_mtime_ns == written
    shown = call("show", folder)
    assert "event_time_ground from" in shown.output
    verified = call("verify", folder)
    assert verified.exit_code == 0
    assert "a sweep and its 10 archived runs" in verified.output
    assert call("plot", folder, "-o", tmp_path / "s.png").exit_code == 0
    assert (tmp_path / "s.png").stat().st_size > 20_000
    file = next((folder / "runs").iterdir())
    file.write_bytes(file.read_bytes()[:-1])
    hurt = call("verify", folder)
    assert hurt.exit_code == 1
    assert file.name in hurt.output


def test_what_varies_together_and_what_is_drawn(tmp_path: Path) -> None:
    """Assert zipped axes and draws, each a sweep that python opens."""
    pair = call(
        "sweep",
        BALL,
        "--axis",
        "vt=20,30 m s-1",
        "--axis",
        "v_y=10,15 m s-1",
        "--together",
        "throw=vt,v_y",
        "--method",
        "heun",
        "--rtol",
        "1e-6",
        "-o",
        tmp_path / "a",
    )
    assert pair.exit_code == 0, pair.output
    assert dict(xd.open_sweep(tmp_path / "a").sizes) == {"throw": 2}
    drawn = call(
        "sweep",
        BALL,
        "--draw",
        "vt=20:40 m s-1",
        "--draws",
        8,
        "--seed",
        3,
        "--method",
        "heun",
        "--rtol",
        "1e-6",
        "-o",
        tmp_path / "b",
    )
    assert drawn.exit_code == 0, drawn.output
    found = xd.open_sweep(tmp_path / "b")
    assert found.vt.dims == ("draw",)
    assert "vt" in found.coords


def test_members_that_end_badly_give_exit_code_1(tmp_path: Path) -> None:
    """Assert that a sweep with a failed member is kept, told and answered for."""
    done = call("sweep", BALL, "--axis", "m=0,1 kg", "--method", "heun", "--step", "10 ms", "-o", tmp_path / "s")
    assert done.exit_code == 1
    assert "(ended badly)" in done.output
    assert xd.open_sweep(tmp_path / "s").sizes["m"] == 2


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (["--axis", "vt"], "needs NAME=VALUE"),
        (["--axis", "vt=1", "--axis", "vt=2"], "sets 'vt' twice"),
        (["--axis", "vt=1:2"], "needs start:stop:count unit"),
        (["--together", "a=vt", "--axis", "m=1"], "names 'vt', for which there is no --axis"),
        (["--draw", "vt=20:40 m s-1"], "go together"),
        (["--draw", "vt=20", "--draws", "4"], "needs LOW:HIGH"),
        (["--axis", "vt=20", "--keep", "nothing"], "keep has 'nothing', which no run"),
    ],
)
def test_wrong_options_are_named(tmp_path: Path, asked: list[str], message: str) -> None:
    """Assert one line and exit code 2, and that no folder is made."""
    done = call("sweep", BALL, *asked, "-o", tmp_path / "s")
    assert done.exit_code == 2
    assert message in done.output
    assert not (tmp_path / "s").exists()


@pytest.mark.dear
def test_figures_of_every_kind_of_grid() -> None:
    """Assert panels: maps over two axes, lines over one, bands and histograms of draws, points for words."""
    model = xd.Model.from_toml(BALL)
    asked = {"rtol": 1e-6, "until": "4 s"}
    maps = xd.plot(
        xd.sweep(
            model,
            {"v_y": "5:30:6 m s-1", "vt": "20:40:5 m s-1", "method": ["heun", "dop853"]},
            keep=["event_time_ground", "event_count_apex"],
            **asked,
        ).compute()
    )
    titles = [axis.get_title(loc="left") for axis in maps.axes if axis.get_visible()]
    assert titles[:2] == ["event_time_ground, heun", "event_time_ground, dop853"]
    lines = xd.plot(
        xd.sweep(model, {"v_y": "5:30:6 m s-1", "method": ["heun", "dop853"]}, keep=["maximum_y"], **asked).compute()
    )
    labels = lines.axes[0].get_legend_handles_labels()[1]
    assert labels == ["heun", "dop853"]
    assert lines.axes[0].get_xlabel() == "v_y (m s⁻¹)"
    drawn = xd.sweep(
        model,
        {"draw": xd.Draws(64, {"v_y": (10.0, 20.0)})},
        keep=["y", "maximum_y"],
        times=[0.2, 0.4],
        method="heun",
        **asked,
    ).compute()
    bands = xd.plot(drawn)
    median = next(line for line in bands.axes[0].lines if line.get_label() == "median")
    np.testing.assert_allclose(median.get_ydata(), np.median(drawn.y.values, axis=0))
    words = xd.plot(
        xd.sweep(model, {"method": ["heun", "rk4"]}, keep=["maximum_y"], step="10 ms", until="4 s").compute()
    )
    assert [yticklabel.get_text() for yticklabel in words.axes[0].get_yticklabels()] == ["heun", "rk4"]
