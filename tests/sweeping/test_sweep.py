"""Grids of runs: each member is the run that it is alone, whatever the blocks, threads and folders."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.record import unfold
from xdynamics.record.flag_words import words_of_flag
from xdynamics.sweeping.sweep_summary import sweep_lines

BALL = MODELS / "ball_drag.toml"
KEEP = [
    "end",
    "event_time_ground",
    "event_count_ground",
    "maximum_y",
    "minimum_v_y",
    "end_total_energy",
    "total_energy",
    "y",
    "after_apex_v_y",
]
AXES = {"v_y": "10:30:5 m s-1", "vt": ["20 m s-1", "40 m s-1"], "method": ["heun", "dop853"]}


def ball() -> xd.Model:
    """A ball with drag, an apex and a ground."""
    return xd.Model.from_toml(BALL)


@pytest.fixture(scope="module")
def swept() -> xr.Dataset:
    """A grid of balls, computed."""
    return xd.sweep(ball(), AXES, keep=KEEP, times=[0.5, "1 s", 9.0], rtol=1e-6, until="9 s").compute()


def alone(sweep: xr.Dataset, at: tuple[int, int, int]) -> tuple[dict[str, Any], xr.Dataset]:
    """Return what a sweep has of a member, and its run by `simulate`."""
    mine = sweep.isel(dict(zip(("v_y", "vt", "solver_method"), at, strict=True)))
    model = ball().replace(initial={"v_y": float(mine.v_y)}, parameters={"vt": float(mine.vt)})
    return dict(mine.data_vars), xd.simulate(model, method=str(mine["solver_method"].values), rtol=1e-6, until="9 s")


@pytest.mark.parametrize("at", [(0, 0, 0), (4, 1, 1), (2, 0, 1)])
def test_a_member_is_its_run_alone(swept: xr.Dataset, at: tuple[int, int, int]) -> None:
    """Assert ends, events, extremes, observables at times and counts, bit for bit."""
    mine, run = alone(swept, at)
    for name in ("y", "v_y", "total_energy"):
        assert float(mine[f"end_{name}"]) == float(run[name][-1])
    assert float(mine["end_time"]) == float(run.time[-1])
    names = np.array(words_of_flag(run.event_detector))
    assert float(mine["event_time_ground"]) == float(run.event_time[names == "ground"][0])
    assert int(mine["event_count_ground"]) == int((names == "ground").sum())
    found = xd.diagnose(run)
    for name in ("maximum_y", "minimum_v_y", "maximum_y_time"):
        assert float(mine[name]) == float(found[name])
    sampled = xd.sample(run, [0.5, 1.0])
    assert mine["y"].values.tolist()[:2] == sampled.y.values.tolist()
    assert np.isnan(mine["y"].values[2])
    apex = int(run.event_row_after[names == "apex"][0])
    assert float(mine["after_apex_v_y"]) == float(run.v_y[apex])
    for name in ("run_accepted_steps", "run_rejected_trials", "run_force_evaluations"):
        assert int(mine[name]) == int(run.attrs[name])
    assert str(mine["run_outcome"].values) == run.attrs["run_outcome"]


def test_observables_at_times_are_those_of_the_states(swept: xr.Dataset) -> None:
    """Assert the energy of a member at a time from its coordinate and velocity there."""
    _, run = alone(swept, (3, 1, 1))
    state = xd.sample(run, [0.5])
    m, g = 0.145, 9.80665
    energy = m * state.v_y**2 / 2 + m * g * state.y
    found = swept.total_energy.isel({"v_y": 3, "vt": 1, "solver_method": 1, "at": 0})
    assert float(found) == pytest.approx(float(energy[0]), rel=1e-14)


def test_axes_have_units_and_everything_says_what_it_is(swept: xr.Dataset) -> None:
    """Assert units, names and roles of every variable, and that the Dataset is saved and verified like a run."""
    assert swept.v_y.attrs["units"] == "m s-1"
    assert swept.sizes == {"v_y": 5, "vt": 2, "solver_method": 2, "at": 3}
    for name, variable in swept.variables.items():
        assert {"units", "long_name", "role"} <= set(variable.attrs), name
    assert swept.at_time.values.tolist() == [0.5, 1.0, 9.0]


def test_any_blocks_and_workers_give_the_same_bits(swept: xr.Dataset) -> None:
    """Assert the numbers for blocks of one, three and all members, by threads and without."""
    for members, scheduler in ((1, "threads"), (3, "synchronous"), (100, "threads")):
        lazy = xd.sweep(
            ball(), AXES, keep=KEEP, times=[0.5, "1 s", 9.0], rtol=1e-6, until="9 s", members_per_task=members
        )
        assert lazy.end_y.chunks is not None
        again = lazy.compute(scheduler=scheduler)
        for name in swept.data_vars:
            assert again[name].values.tobytes() == swept[name].values.tobytes(), name


def test_a_computed_sweep_is_saved_without_a_second_march(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what came of the blocks is known when it is saved, and that an edited value is refused."""
    from xdynamics.sweeping import tasks

    found = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, rtol=1e-6, method="heun", members_per_task=4).compute()
    monkeypatch.setattr(tasks, "march_block", lambda *_: pytest.fail("marched"))
    xd.save(found, tmp_path / "s.nc")
    with xd.open_run(tmp_path / "s.nc") as kept:
        assert kept.end_y.values.tolist() == found.end_y.values.tolist()
        assert xd.member(kept, vt=20.0).attrs["run_outcome"] == str(found.run_outcome.values[0])
    monkeypatch.undo()
    edited = found.copy(deep=True)
    edited.end_y[3] += 1e-9
    with pytest.raises(xd.InputError, match="not the sweep as it was made"):
        xd.save(edited, tmp_path / "t.nc")


def test_nothing_is_marched_before_it_is_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that with a given number of members a task nothing is computed when a sweep is set up."""
    from xdynamics.sweeping import tasks

    monkeypatch.setattr(tasks, "march_block", lambda *_: pytest.fail("marched"))
    found = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, rtol=1e-6, method="heun", members_per_task=2)
    assert found.end_y.chunks == ((2, 2, 2, 2, 1),)


def test_checked_members() -> None:
    """Assert that every member passes the comparison with its run alone, and that one that differs is named."""
    xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, rtol=1e-6, method="heun", check=1.0).compute()
    from xdynamics.sweeping import members

    plan_made = members.Plan
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(members, "digest_of_end", lambda *_: "other")
        found = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, rtol=1e-6, method="heun", check=1.0, members_per_task=9)
        with pytest.raises(
            xd.InputError, match=r"member vt = .* in the sweep and other alone: this is a fault of xdynamics"
        ):
            found.compute(scheduler="synchronous")
    assert plan_made is members.Plan


def test_members_that_fail_are_rows_with_their_outcome() -> None:
    """Assert outcomes, the refined ones too, and that the others are as they would be without."""
    model = particle("F/where(x > 5*metre, 0, 1)")
    found = xd.sweep(model, {"initial_x": [1.0, 4.9, 2.0]}, method="midpoint", step=0.1, until=0.5).compute()
    word = xd.simulate(model.replace(initial={"x": 4.9}), method="midpoint", step=0.1, until=0.5).attrs["run_outcome"]
    assert found.run_outcome.values.tolist() == ["completed", word, "completed"]
    assert found.end_x.values[0] == float(
        xd.simulate(model.replace(initial={"x": 1.0}), method="midpoint", step=0.1, until=0.5).x[-1]
    )
    assert found.end_time.values[1] < 0.5


def test_what_the_tolerances_did_not_control_is_counted() -> None:
    """Assert that a member whose motion is smaller than its absolute tolerance is marked, and others are not."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    found = xd.sweep(model, {"initial_x": [1e-9, 1.0]}, method="dop853", rtol=1e-6, atol=1e-6, until="3 s").compute()
    assert found.run_uncontrolled.values[0] > 0
    assert found.run_uncontrolled.values[1] == 0
    own = xd.sweep(model, {"initial_x": [1e-9, 1.0]}, method="dop853", rtol=1e-6, until="3 s").compute()
    assert (own.run_uncontrolled == 0).all()  # tolerances that follow are in proportion


def test_what_varies_together_and_what_is_drawn() -> None:
    """Assert zipped values, Sobol points with their seed, and draws from the parameters' uncertainties."""
    model = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
    name, other = list(model.elements.statement.parameters)[:2]
    pair = {name: [1.0, 2.0, 3.0], other: [4.0, 5.0, 6.0]}
    found = xd.sweep(model, {"body": pair}, method="velocity_verlet", step=0.01, until=1.0).compute()
    assert found.sizes == {"body": 3}
    assert found[other].dims == ("body",)
    one = xd.member(found, body=1)
    assert float(one[name]) == 2.0
    assert float(one.x[-1]) == float(found.end_x[1])
    draws = xd.Draws(16, {name: (1.0, 2.0)}, seed=5)
    first, again = (xd.sweep(model, {"draw": draws}, method="velocity_verlet", step=0.01, until=1.0) for _ in range(2))
    assert first[name].values.tolist() == again[name].values.tolist()
    assert (first[name].attrs["design"], int(first[name].attrs["seed"])) == ("sobol", 5)
    assert len(np.unique(np.floor(16 * (first[name].values - 1.0)))) == 16  # one in each sixteenth
    varied = xd.Model(**_with_uncertainty())
    normal = xd.sweep(
        varied,
        {"draw": xd.Draws(4000, ["k"], design="declared", seed=1)},
        method="velocity_verlet",
        step=0.1,
        until=0.2,
    )
    assert float(normal.k.mean()) == pytest.approx(4.0, abs=0.01)
    assert float(normal.k.std()) == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("design", ["sobol", "latin_hypercube"])
def test_designs_are_those_of_scipy(design: str) -> None:
    """Assert the points of both designs: reproducible, one in each stratum, and not those of the other."""
    from scipy.stats import qmc

    maker = {"sobol": qmc.Sobol, "latin_hypercube": qmc.LatinHypercube}[design]
    expected = maker(2, seed=np.random.default_rng(4)).random(16)
    points = xd.Draws(16, {"a": (0, 1), "b": (0, 1)}, design=design, seed=4).points()
    assert points.tolist() == expected.tolist()
    assert sorted(np.floor(16 * points[:, 0])) == list(range(16))


def _with_uncertainty() -> dict[str, Any]:
    return {
        "name": "spring",
        "coordinates": {"x": {"unit": "m"}},
        "mass": {"x": "m"},
        "parameters": {"m": "1 kg", "k": {"value": "4 N m-1", "uncertainty": "10 cN m-1"}},
        "forces": {"spring": {"potential": "k*x**2/2"}},
        "initial": {"x": "1 m", "v_x": "0 m s-1"},
    }


def test_settings_and_starts_as_axes() -> None:
    """Assert steps, tolerances, ends and the initial time as axes, each member alone."""
    model = ball()
    found = xd.sweep(model, {"step": "10, 20 ms", "until": ["0.2 s", "0.4 s"]}, method="midpoint").compute()
    assert found.end_time.values.tolist() == [[0.2, 0.4], [0.2, 0.4]]
    assert found.run_accepted_steps.values.tolist() == [[20, 40], [10, 20]]
    rtols = xd.sweep(model, {"rtol": [1e-3, 1e-8]}, method="dop853").compute()
    one = xd.simulate(model, method="dop853", rtol=1e-8)
    assert float(rtols.end_v_y[1]) == float(one.v_y[-1])
    starts = xd.sweep(model, {"t": [0.0, 0.1]}, method="heun", step=0.01, until=1.0).compute()
    assert starts.run_accepted_steps.values.tolist() == [100, 90]


@pytest.mark.dear
def test_tables_of_a_drive_as_an_axis(tmp_path: Path) -> None:
    """Assert that each column of a wide table is a member, whose text the sweep keeps."""
    model = xd.Model.from_toml(MODELS / "rocket_c6.toml")
    (tmp_path / "motors.csv").write_text("time [s],weak [N],strong [N]\n0,0,0\n0.1,8,12\n1.5,8,12\n1.6,0,0\n")
    found = xd.sweep(
        model, {"thrust": tmp_path / "motors.csv"}, keep=["end", "maximum_y"], method="dop853", rtol=1e-8, until="3 s"
    ).compute()
    assert found.thrust.values.tolist() == ["weak", "strong"]
    assert found.maximum_y.values[1] > found.maximum_y.values[0] > 0
    run = xd.member(found, thrust="strong")
    assert float(run.y[-1]) == float(found.end_y[1])


def test_events_in_a_row_along_their_occurrences() -> None:
    """Assert bounces of a ball against their closed form, and nan behind the last."""
    model = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    found = xd.sweep(
        model, {"e": [0.5, 0.9]}, keep=["event_time_floor"], occurrences=4, method="dop853", rtol=1e-10, until="2 s"
    ).compute()
    first = np.sqrt(2 / 9.81)
    assert found.event_time_floor.dims == ("e", "occurrence")
    assert found.event_time_floor.values[1, :2] == pytest.approx([first, first * (1 + 2 * 0.9)], rel=1e-10)
    assert np.isnan(found.event_time_floor.values[1, 3])
    later = xd.sweep(
        model,
        {"e": [0.5, 0.9]},
        keep=["event_time_floor"],
        occurrences=(1, 3),
        method="dop853",
        rtol=1e-10,
        until="2 s",
    ).compute()
    assert later.event_time_floor.values.tolist() == found.event_time_floor.values[:, 1:3].tolist()
    assert later.occurrence_number.values.tolist() == [2, 3]


@pytest.mark.every(3)
@pytest.mark.parametrize("members", [2, 4, 9, None], ids=str)
def test_a_folder_goes_on_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, members: int | None
) -> None:
    """Assert that a sweep goes on with what is not there, in whatever tasks it would be cut now; nothing twice."""
    from xdynamics.sweeping import catalogue

    marched, made = catalogue.march_block, []

    def breaking(plan: Any, block: Any) -> Any:
        if len(made) == 3:
            raise KeyboardInterrupt
        made.append(block)
        return marched(plan, block)

    import dask

    asked: dict[str, Any] = {"method": "heun", "rtol": 1e-6, "members_per_task": 2, "path": tmp_path / "s"}
    with dask.config.set(scheduler="synchronous"):
        monkeypatch.setattr(catalogue, "march_block", breaking)
        with pytest.raises(KeyboardInterrupt):
            xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, **asked)
        with pytest.raises(xd.InputError, match="is not finished; call the same sweep again"):
            xd.open_sweep(tmp_path / "s")
        monkeypatch.setattr(catalogue, "march_block", lambda plan, block: made.append(block) or marched(plan, block))
        found = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, **asked | {"members_per_task": members})
        assert len(made) == 5
        again = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, **asked)
        assert len(made) == 5
    whole = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, method="heun", rtol=1e-6).compute()
    for one in (found, again):
        assert one.end_v_y.values.tobytes() == whole.end_v_y.values.tobytes()
        assert list(map(str, one.run_digest.values)) == list(map(str, whole.run_digest.values))
    assert [entry.name for entry in (tmp_path / "s").iterdir()] == ["catalogue.nc"]


@pytest.mark.every(3)
@pytest.mark.parametrize("said", ["", "[[3, 3, 3", "[[4, 4, 4]]", "7"], ids=str)
def test_a_damaged_cut_is_made_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str) -> None:
    """Assert that blocks cut in another way, or nobody knows how, are not mixed."""
    from xdynamics.sweeping import catalogue

    asked: dict[str, Any] = {"method": "heun", "rtol": 1e-6, "path": tmp_path / "s"}
    monkeypatch.setattr(catalogue, "_join_blocks", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, **asked, members_per_task=4)
    monkeypatch.undo()
    (cut,) = (tmp_path / "s").glob(".unfinished/*/blocks.json")
    assert cut.read_text() == "[[4, 4, 1]]"
    cut.write_text(said)
    found = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, **asked, members_per_task=3)
    whole = xd.sweep(ball(), {"vt": "20:40:9 m s-1"}, method="heun", rtol=1e-6)
    assert found.end_v_y.values.tobytes() == whole.end_v_y.values.tobytes()


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("file", "is a file; name a folder"),
        ("/dev/null", "is a device; name a folder"),
        (7, "path is 7, needs the name of a folder"),
    ],
)
def test_what_is_no_folder(tmp_path: Path, target: Any, message: str) -> None:
    """Assert that a file, a device and a number are refused as folders, and stay."""
    (tmp_path / "file").write_text("mine")
    path = tmp_path / target if isinstance(target, str) else target
    with pytest.raises(xd.InputError, match=message):
        xd.sweep(ball(), {"vt": [20.0]}, method="heun", rtol=1e-6, path=path)
    assert (tmp_path / "file").read_text() == "mine"


def test_another_sweep_keeps_out_of_a_folder(tmp_path: Path) -> None:
    """Assert that a folder with another sweep is refused, and stays as it is."""
    path = tmp_path / "s"
    xd.sweep(ball(), {"vt": [20.0, 30.0]}, method="heun", rtol=1e-6, path=path)
    before = (path / "catalogue.nc").read_bytes()
    with pytest.raises(xd.InputError, match="holds another sweep"):
        xd.sweep(ball(), {"vt": [20.0, 31.0]}, method="heun", rtol=1e-6, path=path)
    assert (path / "catalogue.nc").read_bytes() == before


@pytest.mark.dear
def test_whole_runs_in_files(tmp_path: Path) -> None:
    """Assert one verified file a run, members from them, damage found, and files used again by another sweep."""
    path = tmp_path / "s"
    found = xd.sweep(ball(), {"vt": "20:40:3 m s-1"}, keep=["end", "log"], method="dop853", rtol=1e-6, path=path)
    run = xd.member(found, vt=30.0)
    whole = xd.simulate(ball().replace(parameters={"vt": 30.0}), method="dop853", rtol=1e-6)
    assert run.attrs["content_digest"] == xd.content_digest(whole) == str(found.run_digest.sel(vt=30.0).values)
    from xdynamics.sweeping.catalogue import verify_sweep

    assert verify_sweep(path)[1] == 3
    run.close()
    file = path / str(found.run_file.values[0])
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    with pytest.raises(xd.ArchiveError, match="seal|digest|bytes"):
        verify_sweep(path)
    with pytest.raises(xd.ArchiveError):
        xd.member(found, vt=20.0)
    found.close()
    (path / "catalogue.nc").unlink()
    times = {entry.name: entry.stat().st_mtime_ns for entry in (path / "runs").iterdir()}
    again = xd.sweep(ball(), {"vt": "20:40:3 m s-1"}, keep=["end", "log"], method="dop853", rtol=1e-6, path=path)
    new = {entry.name: entry.stat().st_mtime_ns for entry in (path / "runs").iterdir()}
    assert sum(times[name] != new[name] for name in times) == 1  # the damaged one alone
    assert verify_sweep(path)[1] == 3
    again.close()
    with xd.open_run(file) as sealed:  # by another program, without a seal
        sealed.load().to_netcdf(file.with_suffix(".new"), engine="netcdf4")
    file.with_suffix(".new").replace(file)
    (path / "catalogue.nc").unlink()
    xd.sweep(ball(), {"vt": "20:40:3 m s-1"}, keep=["end", "log"], method="dop853", rtol=1e-6, path=path).close()
    assert xd.verify(file).verdict == "verified"
    assert verify_sweep(path)[1] == 3


def test_a_member_from_the_catalogue_alone(tmp_path: Path) -> None:
    """Assert that a catalogue that was moved gives every member back, and that one of other numbers is told."""
    xd.sweep(ball(), {"vt": "20:40:3 m s-1"}, method="dop853", rtol=1e-6, path=tmp_path / "s").close()
    shutil.move(tmp_path / "s" / "catalogue.nc", tmp_path / "elsewhere.nc")
    with xd.open_run(tmp_path / "elsewhere.nc") as found:
        run = xd.member(found, vt="30 m s-1")
        assert float(run.v_y[-1]) == float(found.end_v_y[1])
        assert float(xd.member(found.isel(vt=2)).v_y[-1]) == float(found.end_v_y[2])
        edited = found.compute().assign(run_digest=found.run_digest[::-1].variable)
        edited.attrs = found.attrs
        with pytest.raises(xd.ArchiveError, match="computed again, comes to something else: run_digest is"):
            xd.member(edited, vt=20.0)


@pytest.mark.parametrize(
    ("axes", "more", "message"),
    [
        ({}, {}, "axes are {}, need a mapping"),
        ({"vt": []}, {}, "axis 'vt': has no values"),
        ({"vt": ["20 m"]}, {}, "has 20.0 m, needs the unit 'm s-1'"),
        ({"vt": [float("nan")]}, {}, "has nan, needs finite numbers"),
        ({"vt": "20:40 m s-1"}, {}, "needs start:stop:count unit"),
        ({"vt": "20:40:0 m s-1"}, {}, "count from 2 to"),
        ({"vt": ["20 m s-1", "20 m s-1"]}, {}, "has 20.0 more than once"),
        ({"vtt": [1.0]}, {}, "'vtt' is nothing that can vary"),
        ({"method": ["heun", "huen"]}, {}, "member solver_method = huen: method 'huen' is not known"),
        ({"step": [-0.1]}, {}, "has -0.1 s, needs positive values"),
        ({"a": {"vt": [1.0], "m": [1.0, 2.0]}}, {}, "needs as many values each: vt has 1, m has 2"),
        ({"vt": [1.0], "a": {"vt": [1.0]}}, {}, "'vt' varies along both 'vt' and 'a'"),
        (
            {"vt": [20.0]},
            {"keep": "endo"},
            "'endo', which no run, event or diagnosis of the model has; the nearest are end, ",
        ),
        ({"vt": [20.0]}, {"keep": ["y"]}, "keep has 'y', which needs times"),
        ({"vt": [20.0]}, {"keep": ["log"]}, "give path='a folder'"),
        ({"vt": [20.0]}, {"occurrences": 0}, "occurrences is 0, needs a positive whole number"),
        ({"vt": [20.0]}, {"check": 2.0}, "check is 2.0, needs a part of the members from 0 to 1"),
        ({"vt": [20.0]}, {"members_per_task": 0}, "members_per_task is 0"),
        ({"vt": [20.0]}, {"until": "-1 s"}, "until is -1.0 s, needs a time after the start"),
        ({"v_y": [20.0]}, {"keep": ["v_y"], "times": [1.0]}, "call the axis 'initial_v_y'"),
    ],
)
def test_wrong_input_is_named(axes: dict[str, Any], more: dict[str, Any], message: str) -> None:
    """Assert one clear error for everything that cannot be used, before anything is marched."""
    import re

    asked: dict[str, Any] = {"rtol": 1e-6, "method": "heun"} | more
    if "method" in axes:
        del asked["method"]
    with pytest.raises(xd.InputError, match=re.escape(message)):
        xd.sweep(ball(), axes, **asked)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"count": 10, "ranges": {"m": (1.0, 2.0)}}, "Sobol points need a power of two, like 16"),
        ({"count": 0, "ranges": {"m": (1.0, 2.0)}}, "count is 0"),
        ({"count": 8, "ranges": ["m"]}, "needs the lowest and the highest"),
        ({"count": 8, "ranges": {"m": (1.0, 2.0)}, "design": "grid"}, "design is 'grid'; there are sobol"),
        ({"count": 8, "ranges": {"m": (1.0, 2.0)}, "seed": -1}, "seed is -1"),
    ],
)
def test_wrong_draws_are_named(given: dict[str, Any], message: str) -> None:
    """Assert that a design that cannot be drawn says why."""
    with pytest.raises(xd.InputError, match=message):
        xd.Draws(**given)


def test_labels_that_are_not_there() -> None:
    """Assert that a member that does not exist names the nearest."""
    found = xd.sweep(ball(), {"vt": [20.0, 30.0], "method": ["heun", "rk4"]}, step=0.01).compute()
    for labels, message in (
        ({"vt": 21.0, "method": "heun"}, "has no 21.0; the nearest is 20.0 m s-1"),
        ({"vt": 20.0, "method": "dop853"}, "has no 'dop853'; there are heun, rk4"),
        ({"vt": 20.0}, "a member needs a value of every axis, and of 'solver_method' there is none"),
        ({"vt": 20.0, "method": "heun", "m": 1.0}, "the sweep has no axis 'm'"),
    ):
        with pytest.raises(xd.InputError, match=message):
            xd.member(found, **labels)


def test_all_rows_behind_each_other(swept: xr.Dataset) -> None:
    """Assert that a ragged collection holds every member's record, row by row, members as along the axes."""
    found = xd.ragged(swept)
    first = np.concatenate([[0], np.cumsum(found.row_size.values)])
    for i in (0, 7, 19):
        at = tuple(map(int, np.unravel_index(i, (5, 2, 2))))
        _, run = alone(swept, at)
        rows = slice(int(first[i]), int(first[i + 1]))
        for name in ("time", "y", "a_y", "total_energy", "row_kind"):
            assert found[name].values[rows].tobytes() == run[name].values.tobytes(), name
        assert float(found.run_v_y[i]) == float(swept.v_y[at[0]])
        assert str(found.run_solver_method.values[i]) == str(swept["solver_method"].values[at[2]])


def test_an_earlier_sweep_with_something_else_kept(swept: xr.Dataset, tmp_path: Path) -> None:
    """Assert the same members on common times, from a sweep in memory, from a file, and from a part of one."""
    assert xd.sweep(swept, keep=["y"], times=[0.25, 0.5]).y.chunks is not None
    xd.save(swept, tmp_path / "s.nc")
    with xd.open_run(tmp_path / "s.nc") as kept:
        found = xd.sweep(kept.isel(vt=[1]), keep=["y"], times=[0.5]).compute()
    assert found.sizes["vt"] == 1
    assert found.y.values[:, 0, :, 0].tobytes() == swept.y.values[:, 1, :, 0].tobytes()
    with pytest.raises(xd.InputError, match="an earlier sweep has its axes and settings"):
        xd.sweep(swept, keep=["y"], times=[0.5], rtol=1e-3)


@pytest.mark.dear
def test_xarray_opens_a_folder_of_runs(tmp_path: Path) -> None:
    """Assert the documented call of `open_mfdataset`: rows of all runs, in the order of their files."""
    found = xd.sweep(
        ball(), {"vt": "20:40:3 m s-1"}, keep=["end", "log"], method="dop853", rtol=1e-6, path=tmp_path / "s"
    )
    files = sorted((tmp_path / "s" / "runs").glob("*.nc"))
    with xr.open_mfdataset(
        files,
        engine="netcdf4",
        combine="nested",
        concat_dim="step",
        coords="minimal",
        compat="override",
        parallel=False,
        preprocess=lambda run: run[["time", "y", "v_y"]],
        decode_times=False,
    ) as rows:
        each = [xd.open_run(file) for file in files]
        assert rows.y.values.tolist() == np.concatenate([one.y.values for one in each]).tolist()
        for one in each:
            one.close()
    assert found.sizes["vt"] == 3


@pytest.mark.every(3)
@pytest.mark.parametrize(
    "how",
    [
        {"method": "radau_iia", "rtol": 1e-6},
        {"method": "implicit_midpoint", "step": 0.05},
        {"method": "velocity_verlet", "rtol": 1e-4},
        {"method": "rk4", "step": 0.05, "estimator": "step_doubling"},
    ],
)
def test_methods_that_solve_and_halve(how: dict[str, Any]) -> None:
    """Assert members, states at times and extremes of methods whose runs go one by one."""
    model = xd.Model.from_toml(MODELS / "kepler.toml")
    found = xd.sweep(
        model,
        {"initial_x": [0.3, 0.4, 0.5]},
        keep=["end", "x", "maximum_y"],
        times=[0.7, 1.0],
        until=3.0,
        check=1.0,
        **how,
    ).compute()
    run = xd.simulate(model.replace(initial={"x": 0.4}), until=3.0, **how)
    assert float(found.end_x[1]) == float(run.x[-1])
    assert found.x.values[1].tolist() == xd.sample(run, [0.7, 1.0]).x.values.tolist()
    assert float(found.maximum_y[1]) == float(xd.diagnose(run, companion=False).maximum_y)


@pytest.mark.parametrize("name", ["rocket_c6", "cart_spring", "stick_slip_belt"])
def test_everything_that_can_be_observed_at_times(name: str) -> None:
    """Assert states, energies and observables of members at times against those of the runs alone."""
    from xdynamics.evidence.observables import comparable, observe

    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    words, times, parameter = comparable(model), [0.2, 0.9, 1.0], next(iter(model.elements.statement.parameters))
    values = model.parameters[parameter].quantity.value * np.array([0.95, 1.0, 1.1])
    asked = {"method": "dormand_prince", "rtol": 1e-7, "until": 1.5}
    found = xd.sweep(model, {parameter: values}, keep=list(words), times=times, **asked).compute()
    for i, value in enumerate(values.tolist()):
        one = model.replace(parameters={parameter: value})
        alone = observe(xd.simulate(one, **asked), one, words, np.array(times))
        for word in words:
            assert found[word].values[i].tolist() == alone[word][0].tolist(), word


@pytest.mark.every(36)
@pytest.mark.parametrize("name", sorted(entry.stem for entry in MODELS.glob("*.toml")))
@pytest.mark.filterwarnings("ignore::xdynamics.AccuracyWarning")
def test_every_model_of_the_data_folder(name: str, request: pytest.FixtureRequest) -> None:
    """Assert a member's states at times, and the largest of each variable, against its run by `sample` and `diagnose`.

    Over 0.25 s, or with --whole over 2 s.
    """
    until = 2.0 if request.config.getoption("--whole") else 0.25
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    until = max(until, *(2 * part.every.si for part in model.controllers.values()), 0.0)
    parameter, used = next(iter(model.elements.statement.parameters)), list(model.elements.units)
    value = model.parameters[parameter].quantity.value
    asked: dict[str, Any] = {"method": "dormand_prince", "rtol": 1e-7, "until": until}
    keep = [*used, *(f"maximum_{one}" for one in used)]
    found = xd.sweep(
        model, {parameter: [0.97 * value, value]}, keep=keep, times=np.linspace(0.0, until, 5), check=1.0, **asked
    ).compute()
    run = xd.simulate(model, keep_every=1, **asked)
    times = found.at_time.values[found.at_time.values <= float(run.time[-1])]
    found, sampled, told = map(unfold, (found, xd.sample(run, times), xd.diagnose(run, companion=False)))
    for one in used:
        assert found[one].values[1, : times.size].tobytes() == sampled[one].values.tobytes(), one
        if f"maximum_{one}" in told:
            assert float(found[f"maximum_{one}"][1]) == float(told[f"maximum_{one}"]), one


def test_what_is_told_of_failed_members_is_nan() -> None:
    """Assert that a state at which a member failed enters no mean, that its end is known, and that the summary counts it."""
    model = xd.Model(
        name="blow-up",
        states={"x": {"unit": "m", "rate": "k*x**2"}},
        parameters={"k": "1 m-1 s-1"},
        initial={"x": "1 m"},
    )
    ways = ["0.1 m-1 s-1", "10 m-1 s-1"]  # x = 1/(1 - k t)
    found = xd.sweep(
        model, {"k": ways}, keep=["end", "maximum_x"], method="dormand_prince", rtol=1e-8, until=1.0
    ).compute()
    assert found.run_outcome.values[1] not in ("completed", "stopped_by_event")
    for name in ("end_x", "maximum_x", "maximum_x_time"):
        assert np.isnan(found[name].values).tolist() == [False, True], name
    assert float(found.end_x.mean()) == pytest.approx(1 / 0.9, rel=1e-6)
    assert float(found.end_time[1]) == pytest.approx(0.1, rel=1e-3)
    assert "nan of 1 members" in "\n".join(sweep_lines(found))
    assert xd.member(found, k=10.0).attrs["run_outcome"] == str(found.run_outcome.values[1])


def test_events_that_strayed_are_counted() -> None:
    """Assert that members which fall through their floor say so, as runs alone are warned; and that others do not."""
    ball = xd.Model(
        name="a ball by a reset",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        events={"floor": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-0.5*v_y"}}},
        initial={"y": "1 m", "v_y": "0 m s-1"},
    )
    for method, strays in (("heun", [1, 0]), ("dop853", [0, 0])):
        found = xd.sweep(ball, {"y": "1, 400 m"}, keep=["end"], method=method, rtol=4e-6, until=3.0).compute()
        assert found.run_events_strayed.values.tolist() == strays
        assert any("set the motion back" in line for line in sweep_lines(found)) == bool(any(strays))
    with pytest.warns(xd.AccuracyWarning, match="'floor' set the motion back when errors of steps had carried it"):
        alone = xd.simulate(ball, method="heun", rtol=4e-6, until=3.0)
    assert alone.y.values[-1] < -1.0
