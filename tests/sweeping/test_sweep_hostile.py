"""What a hostile reading of sweeps found: members that knew their neighbours, units that were lost, files that lied."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.stats import sobol_indices

import xdynamics as xd
from cases.problems import MODELS, particle
from cases.verdicts import verified
from xdynamics.sweeping.catalogue import UNFINISHED
from xdynamics.sweeping.indices import _variance_shares

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
BOUNCING = xd.Model.from_toml(MODELS / "bouncing_ball.toml")


def walled(unit: str = "m") -> xd.Model:
    """A mass on a spring that is thrown back at a wall."""
    return xd.Model(
        name="walled",
        coordinates={"x": unit},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": f"0.7 {unit}", "v_x": f"0.7 {unit} s-1"},
        events={
            "wall": {
                "function": "x - 0.77*metre" if unit == "m" else "x - 0.77e-6*metre",
                "direction": "rising",
                "action": "reset",
                "set": {"v_x": "-0.8*v_x"},
            }
        },
    )


@pytest.mark.dear
@pytest.mark.parametrize(("unit", "rtol", "atol"), [("m", 0.5, 1.0), ("m", 0.1, 0.1), ("um", 1e-6, None)])
def test_no_member_knows_the_one_before(unit: str, rtol: float, atol: float | None) -> None:
    """Assert ends of members one a task, many a task and alone, where motions are small beside the tolerances."""
    starts = np.random.default_rng(3).uniform(0.05, 0.75, 40)
    settings: dict[str, Any] = {
        "method": "dormand_prince",
        "until": "6 s",
        "rtol": rtol,
        "atol": atol,
        "max_steps": 300,
    }
    one, many = (
        xd.sweep(walled(unit), {"initial_x": starts}, keep=["end", "event_count_wall"], members_per_task=n, **settings)
        for n in (1, 40)
    )
    assert one.end_x.values.tolist() == many.end_x.values.tolist()
    assert one.event_count_wall.values.tolist() == many.event_count_wall.values.tolist()
    for k in (0, 17, 39):
        xd.member(many, initial_x=float(starts[k]))


@pytest.mark.parametrize(
    ("axis", "values", "same"),
    [
        ("until", ["100 ms", "200 ms"], [0.1, 0.2]),
        ("until", "100, 200 ms", [0.1, 0.2]),
        ("max_step", ["10 ms", "20 ms"], [0.01, 0.02]),
        ("step", ["10 ms", "20 ms"], [0.01, 0.02]),
        ("time_tolerance", ["1 us", "1 ms"], [1e-6, 1e-3]),
    ],
)
def test_times_along_an_axis_have_their_units(axis: str, values: Any, same: list[float]) -> None:
    """Assert that members in milliseconds are those in seconds, and that each is found again and marched alone."""
    settings = {"rtol": 1e-6} if axis == "max_step" else {} if axis == "step" else {"step": "5 ms"}
    settings |= {} if axis == "until" else {"until": "2.5 s"}
    told, bare = (
        xd.sweep(BALL, {axis: given}, keep=["end", "event_time_apex"], method="dormand_prince", check=1.0, **settings)
        for given in (values, same)
    )
    assert told.end_y.values.tolist() == bare.end_y.values.tolist()
    np.testing.assert_array_equal(told.event_time_apex.values, bare.event_time_apex.values)
    if axis != "time_tolerance":  # which may both be met by the same place
        assert len({*told.run_digest.values.tolist()}) == 2
    assert xd.member(told, **{axis: values[0] if isinstance(values, list) else "100 ms"}).attrs["run_outcome"]


def test_a_range_takes_the_units_of_its_ends() -> None:
    """Assert units at the ends of a range, behind it, and that two kinds are refused."""
    assert xd.sweep(BALL, {"vt": "1km/s:2km/s:3"}, method="heun", step=0.1).vt.values.tolist() == [1.0, 1.5, 2.0]
    assert xd.sweep(BALL, {"vt": "1km/s:2km/s:3"}, method="heun", step=0.1).vt.attrs["units"] == "km s-1"
    for text, said in [
        ("1km:2km:3", "needs the unit"),
        ("1km:2s:3", "one kind of unit"),
        ("1km/s:2km/s:3 m s-1", "write one"),
        ("10:30:1 m s-1", "count from 2"),
        ("10:30:2.5 m s-1", "whole number"),
        ("0:1:99999999999 m s-1", "10000000"),
    ]:
        with pytest.raises(xd.InputError, match=said):
            xd.sweep(BALL, {"vt": text}, method="heun", step=0.1)


def test_a_member_without_a_number_has_no_maximum() -> None:
    """Assert nan of the member whose observable is none, wherever it stands, and the others' own."""
    model = particle(
        name="o",
        parameters={"m": "1 kg", "p": "1 m"},
        forces={"f": {"x": "-m*x/second**2"}},
        initial={"x": "0.5 m", "v_x": "0 m s-1"},
        observables={"r": "sqrt(x+p)*sqrt(x+p)"},
    )
    for values in ([1.0, -1.0, 2.0], [-1.0, 1.0, 2.0], [1.0, 2.0, -1.0]):
        found = xd.sweep(model, {"p": values}, keep=["maximum_r"], until="2 s", method="rk4", step=0.1)
        right = [np.nan if p < 0 else 0.5 + p for p in values]
        assert found.maximum_r.values == pytest.approx(right, nan_ok=True)


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("axes", "more", "said"),
    [
        ({"vt": [20.0]}, {"rtoll": 1e-6}, "no setting 'rtoll'; did you mean 'rtol'?"),
        ({"vt": [20.0]}, {"resume": True}, "no setting 'resume'"),
        ({"step": ["1 ms", "2 ms"]}, {"step": "10 ms"}, "'step' varies along an axis"),
        ({"method": ["heun", "rk4"]}, {"method": "rk4"}, "'method' varies along an axis"),
        ({"g": {"v_y": [1.0, 2.0]}}, {}, "name of something else"),
        ({"at": {"v_y": [1.0, 2.0]}}, {}, "name of something else"),
        ({"model_toml": {"v_y": [1.0, 2.0]}}, {}, "name of something else"),
        ({"vt": [20.0]}, {"keep": 3}, "keep is 3"),
        ({"vt": [20.0]}, {"keep": ["y"], "times": [-1.0]}, "times has -1.0 s"),
        ({"vt": "1:2:9000000 m s-1", "g": "1:2:9000000 m s-2"}, {}, "members, and 200000000 are the most"),
    ],
)
def test_what_cannot_be_meant_is_refused(axes: Any, more: dict[str, Any], said: str) -> None:
    """Assert that settings, names, words and sizes are checked before anything is marched."""
    with pytest.raises(xd.InputError, match=said):
        xd.sweep(BALL, axes, **{"until": "1 s"} | more)


def test_too_many_axes_and_names_that_are_taken() -> None:
    """Assert that 30 axes are refused, and an observable by the name of what every sweep has."""
    parameters = {f"p{k}": "1 m" for k in range(30)}
    model = particle(
        name="many",
        parameters={"m": "1 kg", **parameters},
        forces={"f": {"x": "-m*x/second**2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        observables={"run_outcome": "x"},
    )
    with pytest.raises(xd.InputError, match="30 axes, 24 at most"):
        xd.sweep(model, {name: [1.0] for name in parameters}, step=0.1, until=1.0, method="rk4")
    with pytest.raises(xd.InputError, match="rename the observable"):
        xd.sweep(model, {"p0": [1.0]}, keep=["run_outcome"], times=[0.5], step=0.1, until=1.0, method="rk4")


LONG = {"method": "rk4", "step": "50 ms", "until": "2 s", "members_per_task": 3}


def begun(folder: Path, **settings: Any) -> Path:
    """March a sweep up to its last step, where its parts are still there; return the folder of the parts."""
    from unittest import mock

    with (
        mock.patch("xdynamics.sweeping.catalogue._join_blocks", side_effect=KeyboardInterrupt),
        pytest.raises(KeyboardInterrupt),
    ):
        xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, path=folder, **LONG, **settings)
    return next((folder / UNFINISHED).iterdir())


@pytest.mark.dear
def test_a_part_is_what_it_holds_and_not_its_name(tmp_path: Path) -> None:
    """Assert that parts copied over each other, other archives and damaged cuts are marched again."""
    right = xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, **LONG).compute()
    for k, spoil in enumerate(["copy", "archive", "[[0,12]]", "[[12,0]]", "[[1e400]]", "[" * 100_000]):
        folder = tmp_path / str(k)
        work = begun(folder)
        if spoil == "copy":
            shutil.copy(work / "0-3.nc", work / "3-6.nc")
        elif spoil == "archive":
            xd.simulate(BALL, path=work / "3-6.nc", method="rk4", step="50 ms", until="1 s")
        else:
            (work / "blocks.json").write_text(spoil)
        found = xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, path=folder, **LONG)
        assert found.end_y.values.tolist() == right.end_y.values.tolist()
        assert not (folder / UNFINISHED).exists()


@pytest.mark.dear
def test_a_run_is_what_it_holds_and_not_its_name(tmp_path: Path) -> None:
    """Assert that the file of one run under the name of another is not taken for it."""
    work = begun(tmp_path / "s", keep=["log", "end"])
    for part in work.glob("*-*.nc"):
        part.unlink()
    one, other, *_ = sorted((tmp_path / "s" / "runs").glob("*.nc"))
    shutil.copy(one, other)
    found = xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, path=tmp_path / "s", keep=["log", "end"], **LONG)
    for k in range(6):
        assert float(xd.member(found, v_y=float(found.v_y[k])).y[-1]) == float(found.end_y[k])


def test_a_member_is_the_run_that_the_catalogue_tells(tmp_path: Path) -> None:
    """Assert that a run in the place of another is no member."""
    found = xd.sweep(BALL, {"v_y": [10.0, 11.0]}, path=tmp_path / "s", keep=["log"], **LONG)
    one, other = (tmp_path / "s" / str(name) for name in found.run_file.values)
    shutil.copy(one, other)
    with pytest.raises(xd.ArchiveError, match="in the catalogue"):
        xd.member(found, v_y=11.0)


def test_a_refused_sweep_leaves_nothing_in_the_folder(tmp_path: Path) -> None:
    """Assert that a sweep that is begun goes on after another one was refused there."""
    begun(tmp_path / "s")
    with pytest.raises(xd.InputError, match="a part of another sweep"):
        xd.sweep(BALL, {"v_y": [1.0, 2.0]}, path=tmp_path / "s", **LONG)
    assert xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, path=tmp_path / "s", **LONG).sizes["v_y"] == 6


def test_two_processes_keep_out_of_each_others_way(tmp_path: Path) -> None:
    """Assert that a folder that is marched into is refused by name."""
    import fcntl

    work = begun(tmp_path / "s")
    handle = os.open(work, os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(xd.InputError, match="another process writes into"):
        xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, path=tmp_path / "s", **LONG)
    with pytest.raises(xd.InputError, match="another process writes into"):  # no advice to remove what is being written
        xd.sweep(BALL, {"v_y": [1.0, 2.0]}, path=tmp_path / "s", **LONG)
    os.close(handle)
    with pytest.raises(xd.InputError, match="or give it up by removing '.*s' whole"):
        xd.sweep(BALL, {"v_y": [1.0, 2.0]}, path=tmp_path / "s", **LONG)
    assert xd.sweep(BALL, {"v_y": np.linspace(10.0, 20.0, 6)}, path=tmp_path / "s", **LONG).sizes["v_y"] == 6


@pytest.mark.dear
def test_a_damaged_folder_is_told_and_mended(tmp_path: Path) -> None:
    """Assert that missing, damaged and added runs are named with the remedy, and that it helps."""
    settings: dict[str, Any] = {"keep": ["log"], "path": tmp_path / "s", **LONG}
    axes = {"v_y": np.linspace(10.0, 20.0, 6)}
    right = xd.sweep(BALL, axes, **settings).run_digest.values.tolist()
    one, other, *_ = sorted((tmp_path / "s" / "runs").glob("*.nc"))
    one.unlink()
    other.write_bytes(other.read_bytes()[:-9])
    (tmp_path / "s" / "runs" / "foo.nc").write_text("foo")
    for call in (lambda: xd.sweep(BALL, axes, **settings), lambda: xd.verify(tmp_path / "s")):
        with pytest.raises(xd.ArchiveError, match=r"catalogue\.nc") as told:
            call()
        assert [
            one.name in fault or other.name in fault or "foo.nc is no run" in fault for fault in told.value.faults
        ] == [True] * 3
    for path in (other, tmp_path / "s" / "runs" / "foo.nc", tmp_path / "s" / "catalogue.nc"):
        path.unlink()
    assert xd.sweep(BALL, axes, **settings).run_digest.values.tolist() == right
    assert len(verified(tmp_path / "s")) == 64


def test_members_that_simulate_refuses_are_rows(tmp_path: Path) -> None:
    """Assert a row with its outcome and no file of a restitution over 1 and a start inside the floor."""
    axes = {"body": {"e": [0.5, 1.5, 0.5], "y": [1.0, 1.0, -1.0]}}
    found = xd.sweep(BOUNCING, axes, until="1 s", keep=["log", "end"], check=1.0, path=tmp_path / "s")
    assert [str(one) for one in found.run_file.values[1:]] == ["", ""]
    assert {*map(str, found.run_outcome.values[1:])} <= {"contact_undetermined", "contact_penetrated"}
    assert float(xd.member(found, body=0).y[-1]) == float(found.end_y[0])
    assert len(verified(tmp_path / "s")) == 64


def test_the_event_that_ended_a_run_is_kept() -> None:
    """Assert names of the events that stopped runs, and that surveys and lines tell them apart."""
    from xdynamics.documenting.summary import summary

    model = particle(
        name="two walls",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={
            name: {"function": f"x {sign} 1*metre", "action": action, "direction": "either"}
            for name, sign, action in (("east", "-", "stop"), ("west", "+", "stop"), ("seen", "-", "record"))
        },
    )
    found = xd.sweep(model, {"v_x": [-2.0, 0.1, 2.0, 4.0]}, until="2 s", step=0.1, method="rk4").compute()
    assert found.run_stopped_by.values.tolist() == ["west", "", "east", "east"]
    assert xd.influences(found).outcome_changes.values.tolist() == [2 / 3]
    assert xd.contrast(found, "v_x").outcome_differs.values.tolist() == [1, 1, 0, 0]
    assert any("2 stopped_by_event east" in line for line in summary(found))


def test_a_sweep_says_how_it_was_marched_and_what_varies() -> None:
    """Assert settings that the model has itself, and the model's own words for an axis."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    found = xd.sweep(model, {"vt": [20.0, 30.0]}, rtol=1e-5, method="heun")
    assert (found.attrs["solver_method"], found.attrs["solver_rtol"]) == ("heun", 1e-5)
    assert found.attrs["solver_until"] == xd.simulate(model, rtol=1e-5, method="heun").attrs["solver_until"]
    assert found.vt.attrs["long_name"].endswith(model.parameters["vt"].description)


def test_rounding_has_no_influence() -> None:
    """Assert no main effect of a number that is equal everywhere up to rounding, and none of members that are not there."""
    found = xd.sweep(
        BALL, {"vt": "20:60:41 m s-1", "g": "9:10:7 m s-2"}, until="0.7 s", step="0.1 s", method="rk4"
    ).compute()
    assert xd.influences(found).main_effect_end_time.values.tolist() == [0.0, 0.0]
    counted = xd.sweep(
        BALL, {"vt": "20:60:5 m s-1", "g": "9:10:4 m s-2"}, keep=["event_count_apex"], step="0.1 s", method="rk4"
    ).compute()
    some = counted.where((counted.vt < 45) | (counted.g > 9.5))
    some.attrs = counted.attrs
    assert xd.influences(some).event_count_apex_changes.values.tolist() == [0.0, 0.0]


def test_slopes_are_of_second_order_at_the_ends() -> None:
    """Assert the slope of a parabola on an uneven grid, ends included."""
    model = particle(
        name="free",
        parameters={"m": "1 kg"},
        forces={},
        initial={"x": "0 m", "v_x": "0 m s-1"},
    )
    found = xd.sweep(
        model, {"v_x": [0.0, 1.0, 2.0, 4.0]}, keep=["end_kinetic_energy"], until=1.0, step=0.5, method="rk4"
    )
    slopes = xd.sensitivities(found.compute()).slope_end_kinetic_energy_v_x.values
    assert slopes == pytest.approx([0.0, 1.0, 2.0, 4.0], abs=1e-13)


def test_indices_are_those_of_scipy() -> None:
    """Assert Saltelli's estimators against another implementation, and that there may be one parameter."""
    f = np.random.default_rng(5).normal(size=(2, 5, 256))  # of two elements
    for shares, own in zip(np.moveaxis(_variance_shares(f), 1, 0), f, strict=True):
        right = sobol_indices(func={"f_A": own[:1], "f_B": own[1:2], "f_AB": own[2:, None]}, n=256)
        assert shares == pytest.approx(np.stack([right.first_order, right.total_order]), rel=1e-12)
    one = xd.sobol_indices(BALL, {"g": (9.0, 10.0)}, "end_y", draws=64, until="1 s", method="heun", step=0.1)
    assert one.total_order.values == pytest.approx([1.0], abs=0.1)
    assert (one.lowest.values.tolist(), one.highest.values.tolist()) == ([9.0], [10.0])
    assert one.parameter_units.values.tolist() == ["m s-2"]


def test_parts_of_sweeps_that_are_none_are_refused() -> None:
    """Assert that sweeps put together are read, and stacked, pointwise and empty ones named."""
    one, other = (
        xd.sweep(BALL, {"v_y": values}, until="1 s", method="heun", step=0.1).compute()
        for values in ([10.0, 11.0], [12.0])
    )
    both = xr.concat([one, other], "v_y", data_vars="all")
    assert float(xd.member(both, v_y=12.0).y[-1]) == float(other.end_y[0])
    grid = xd.sweep(BALL, {"v_y": [10.0, 11.0], "g": [9.0, 10.0]}, until="1 s", method="heun", step=0.1).compute()
    pointwise = grid.isel(v_y=xr.DataArray([0, 1], dims="p"), g=xr.DataArray([0, 1], dims="p"))
    for bad in (pointwise, grid.isel(v_y=[])):
        with pytest.raises(xd.InputError, match="of the axis 'v_y' of a sweep"):
            xd.ragged(bad)


def test_a_folder_is_found_from_elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that runs of a sweep in a relative folder are found after the working directory has changed."""
    monkeypatch.chdir(tmp_path)
    found = xd.sweep(BALL, {"v_y": [10.0]}, path="s", keep=["log"], until="1 s", method="heun", step=0.1)
    monkeypatch.chdir("/")
    assert xd.member(found, v_y=10.0).attrs["run_outcome"] == "completed"


def test_an_edited_number_is_not_that_of_the_member() -> None:
    """Assert that a member whose end was changed in the sweep is refused."""
    found = xd.sweep(BALL, {"v_y": [10.0]}, until="1 s", method="heun", step=0.1).compute()
    found["end_y"] = found.end_y + 1.0
    with pytest.raises(xd.ArchiveError, match="end_y is"):
        xd.member(found, v_y=10.0)
