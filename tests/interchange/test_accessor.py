"""`run.dynamics`, `times=` and tables: what one asks of a run, in a notebook and on the command line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
BOUNCING = xd.Model.from_toml(MODELS / "bouncing_ball.toml")


@pytest.fixture(scope="module")
def run() -> xr.Dataset:
    """A ball on the floor."""
    return xd.simulate(BOUNCING, until="2 s")


def test_the_accessor_has_the_verbs(run: xr.Dataset) -> None:
    """Assert that each word gives what its verb gives, with a docstring."""
    xr.testing.assert_identical(run.dynamics.at("0:1:5 s"), xd.sample(run, np.linspace(0, 1, 5)))
    assert "stopped" not in repr(run.dynamics)
    assert repr(run.dynamics).startswith("Bouncing ball, by velocity_verlet\noutcome   reached t = 2 s")
    public = [name for name in dir(run.dynamics) if not name.startswith("_")]
    assert public == ["at", "events", "frame", "plot"] or "animate" in public
    assert all(getattr(type(run.dynamics), name).__doc__ for name in public)


def test_events_with_both_sides(run: xr.Dataset, tmp_path: Path) -> None:
    """Assert times, uncertainties and one-sided states in one small Dataset, which is saved and opened."""
    found = run.dynamics.events("floor")
    assert dict(found.sizes) == {"event": 3}
    assert found.after_v_y.values == pytest.approx(-0.9 * found.before_v_y.values, rel=1e-12)
    assert set(found.event_name.values) == {"floor"}
    assert {"event_time", "event_time_uncertainty", "event_kind", "event_energy_lost"} <= {*found.data_vars}
    assert all("units" in variable.attrs for variable in found.data_vars.values())
    xd.save(found, tmp_path / "events.nc")
    assert xd.open_run(tmp_path / "events.nc").attrs["evidence"] == "events"
    assert dict(run.dynamics.events().sizes) == {"event": 3}
    with pytest.raises(xd.InputError, match="the run knows no event 'flor'; there are floor"):
        run.dynamics.events("flor")
    still = xd.simulate(xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"), until="1 s")
    assert still.dynamics.events().sizes["event"] == 0


def test_frames(run: xr.Dataset) -> None:
    """Assert one tidy table a dimension: times first, brackets as two columns, flags as words, units beside."""
    steps, events = run.dynamics.frame(), run.dynamics.frame("event")
    assert (len(steps), steps.columns[0], steps.index.name) == (run.sizes["step"], "time", "step")
    assert steps["y"].to_numpy().tolist() == run["y"].values.tolist()
    assert steps["row_kind"].iloc[0] == "initial"
    assert steps.attrs["units"]["v_y"] == "m s-1"
    assert (events["event_time_bounds_upper"] >= events["event_time_bounds_lower"]).all()
    assert len(run.dynamics.frame("sample")) == run.sizes["sample"]
    assert run.dynamics.at([0.1, 0.2]).dynamics.frame("at")["at_time"].tolist() == [0.1, 0.2]
    with pytest.raises(xd.InputError, match="no dimension 'steps'; there are step, trial, event, sample"):
        run.dynamics.frame("steps")


def test_times_are_what_sample_gives(tmp_path: Path) -> None:
    """Assert states along `at`, the whole record in the file, and that an early end leaves times out."""
    settings = {"method": "dop853", "rtol": 1e-8, "until": "3 s"}
    whole = xd.simulate(BALL, **settings)
    found = xd.simulate(BALL, **settings, times="0:3:7 s", path=tmp_path / "ball.nc")
    xr.testing.assert_equal(found, xd.sample(whole, np.linspace(0.0, 3.0, 7)))
    assert xd.content_digest(xd.open_run(tmp_path / "ball.nc")) == xd.content_digest(whole)
    early = xd.simulate(BALL, method="dop853", rtol=1e-8, until="9 s", times=["1 s", 2.0, "4 s"])
    assert early.at_time.values.tolist() == [1.0, 2.0]
    assert early.attrs["run_outcome"] == "stopped_by_event"
    assert xd.simulate(BALL, method="dop853", rtol=1e-8, until="9 s", times=5.0).sizes["at"] == 0


@pytest.mark.parametrize(
    ("times", "said"),
    [
        ("0:9:3 s", "times have 4.5 s, and the run goes from 0.0 s to 3.0 s"),
        ("0:1:3 m", "are in 'm', need a time"),
        ("0:1:0 s", "need a count from 1"),
        ("1 kg", "has units 'kg', needs 's'"),
        ([np.nan], "nan"),
        (["1 s", "x"], "does not start with a finite number"),
        ("0s:1s:3 ms", "with units after its ends and after the count"),
    ],
)
def test_wrong_times(times: object, said: str, tmp_path: Path) -> None:
    """Assert that wrong times are refused before anything is marched or written."""
    with pytest.raises(xd.InputError, match=said):
        xd.simulate(BALL, method="dop853", rtol=1e-8, until="3 s", times=times, path=tmp_path / "ball.nc")  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


def test_tables_of_the_command_line(tmp_path: Path) -> None:
    """Assert the table of `run --times` and of `sample`, that the numbers are whole, and that `compare` reads it."""
    archive = tmp_path / "ball.nc"
    done = call(
        "run", MODELS / "ball_drag.toml", "-o", archive, "--method", "dop853", "--rtol", "1e-8", "--times", "0:3:7 s"
    )
    assert done.exit_code == 0, done.output
    assert f"table     {tmp_path / 'ball.csv'}: 7 rows" in done.output
    run = xd.open_run(archive)
    assert float(xd.compare(run, tmp_path / "ball.csv")["rms_difference_y"]) == 0.0
    printed = call("sample", archive, "--times", "0:3:7 s")
    assert printed.output == (tmp_path / "ball.csv").read_text()
    assert printed.output.startswith("time [s],y [m],v_y [m s-1]\n0.0,0.0,20.0\n")
    assert (
        call("sample", archive, "--times", "1 s", "-o", tmp_path / "one.csv").output
        == f"table     {tmp_path / 'one.csv'}: 1 rows\n"
    )
    for wrong, said in (
        (["--times", "99 s"], "outside the run"),
        (["--times", "1 s", "-o", tmp_path], "is a directory"),
        (["--times", "1 s", "-o", tmp_path / "no" / "x.csv"], "no folder"),
    ):
        done = call("sample", archive, *wrong)
        assert (done.exit_code, said in done.output) == (2, True), done.output


@pytest.mark.parametrize("verb", [xd.plot, xd.animate])
def test_no_rows_are_no_picture(run: xr.Dataset, verb: Any) -> None:
    """Assert words where a selection is empty."""
    with pytest.raises(xd.InputError, match="there is nothing to draw: the record has no rows"):
        verb(run.isel(step=slice(0, 0)))


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (lambda run: run.isel(step=slice(0, 3)), "a part of a run"),
        (lambda run: run.isel(step=slice(500, None)), "a part of a run"),
        (lambda run: run.isel(step=slice(0, 0)), "a part of a run"),
        (lambda run: run.isel(event=0), "a part of a run"),
        (lambda run: run[["y"]], "a part of a run"),
        (lambda run: run.dynamics.at([1.0]), "a part of a run"),
        (lambda _: xr.Dataset({"a": ("x", [1.0])}), "no run"),
        (
            lambda _: xd.simulate(BOUNCING, until="2 s", compute=False, sizes={"step": 9, "event": 1}),
            "a run that is still to be computed",
        ),
        (lambda run: run.dynamics.events(), "evidence, no run: events from 1 run"),
        (xd.modes, "evidence, no run: modes from 1 run"),
    ],
)
def test_what_is_no_whole_run_is_described(run: xr.Dataset, part: Any, said: str) -> None:
    """Assert what it is and how many rows it has, not the end or the events of the whole; and a page of it."""
    lines = repr(part(run).dynamics).splitlines()
    assert f"kind      {said}" in lines
    assert not [line for line in lines if line.startswith(("event ", "end "))]
    assert said in part(run).dynamics._repr_html_()


def test_states_at_one_time_are_numbers(run: xr.Dataset) -> None:
    """Assert that a time gives a number of each quantity, and a row of times, of one too, an array along `at`."""
    for time in (0.5, "0.5 s", np.float64(0.5), "500 ms"):
        states = run.dynamics.at(time)
        assert dict(states.sizes) == {}
        assert float(states.y) == float(xd.sample(run, [0.5]).y[0])
        assert float(states.at_time) == 0.5
    for times in ([0.5], "0.5 s, 0.6 s", "0:1:3 s"):
        assert "at" in run.dynamics.at(times).dims


def test_common_times_are_chosen_among_those_there_are() -> None:
    """Assert that evidence gives what stands at a time, and refuses times that it has not and rules of runs."""
    levels = xd.refine(BALL, method="rk4", steps=["0.1 s", "0.05 s", "0.025 s"], at=["0.5 s", "1 s"])
    assert levels.dynamics.at("1 s").y.values.tolist() == levels.y.isel(at=1).values.tolist()
    assert levels.dynamics.at([1.0, 0.5]).at_time.values.tolist() == [1.0, 0.5]
    with pytest.raises(xd.InputError, match=r"there is no time 0\.7 here; at_time has 0\.5, 1\.0"):
        levels.dynamics.at(0.7)
    with pytest.raises(xd.InputError, match="side says how a run is sampled"):
        levels.dynamics.at(0.5, side="before")
