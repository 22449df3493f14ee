"""Two runs side by side.

Several runs compared with one of them: the same numbers as one by one, a row a run.
Comparisons that are described before runs are marched: the same bits and words as of runs that were.
"""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

import xdynamics as xd
from cases.contacts import ball
from cases.problems import MODELS, ROOT, driven_decay, oscillator
from cases.stages import CIRCUMSTANCES, assert_same_bits, marches, no_march
from cases.verdicts import verified
from xdynamics.cli import main
from xdynamics.documenting.summary import summary
from xdynamics.evidence.comparing.comparison import LATER
from xdynamics.evidence.comparing.comparison_summary import comparison_lines
from xdynamics.evidence.stages import compute_datasets


def made(step: float, **changes: float) -> xr.Dataset:
    """An oscillator run."""
    model = oscillator().model.replace(parameters=changes) if changes else oscillator().model
    return xd.simulate(model, step=step, until=1.0, force_samples="none")


def test_same_runs_are_the_same() -> None:
    """Assert that two marches of one input agree to the bit."""
    table = xd.compare(made(0.01), made(0.01))
    assert table.attrs["identical"] == 1
    assert (table.same == 1).all()
    assert comparison_lines(table) == [f"the same: {table.sizes['variable']} variables and every setting, bit for bit"]


def test_refined_runs_meet_at_common_times() -> None:
    """Assert that all times of both are compared, and the difference is the refinement's, in its units."""
    table = xd.compare(made(0.01), made(0.005))
    assert table.sizes["at"] == 201
    assert (table.interpolation_error_x[::2] == 0).all()
    assert table.difference_x.attrs["units"] == "m"
    assert np.abs(table.difference_x).max() == pytest.approx(0.75 * (0.02**2 / 24) * np.sin(2.0) * 2, rel=0.05)
    assert table.attrs["settings"] == "solver_step: 0.01 | 0.005"
    assert table.attrs["first_difference"].startswith("variable 'time', row 1")


def test_a_parameter_apart_is_named() -> None:
    """Assert that another spring constant shows in the model's digest and in the first row where states part."""
    table = xd.compare(made(0.01), made(0.01, k=4.1))
    assert "model_digest" in table.attrs["settings"]
    assert table.attrs["parameters"] == "k: 4.0 N m-1 | 4.1 N m-1"
    assert table.attrs["cause"] == "parameters: k: 4.0 N m-1 | 4.1 N m-1"
    assert table.attrs["parted"].startswith("t = 0 s: potential_energy by 0.05 J, beyond")
    assert table.attrs["first_difference"].startswith("variable 'a_x', row 0")
    assert any(line.startswith("x ") for line in comparison_lines(table))


def test_what_is_no_run_is_refused() -> None:
    """Assert that compare asks for records."""
    with pytest.raises(xd.InputError, match="the Dataset has no column of times"):
        xd.compare(made(0.01), xr.Dataset())


def test_a_rerun_says_how_far_it_is() -> None:
    """Assert that the largest difference is told of variables that were zero, and of a number against none."""
    from xdynamics.evidence.comparing.bits import compare_reproduction

    kept = made(0.01)
    still = kept.assign(x=kept.x * 0.0)
    for value, words in (
        (5.0, "the largest difference is 5 m in 'x', row 3: inf of its largest value"),
        (float("nan"), "the largest difference is inf m in 'x', row 3"),
    ):
        again = still.copy(deep=True)
        again["x"].values[3] = value
        table = compare_reproduction(still, again)
        assert table.attrs["identical"] == 0
        assert table.attrs["arithmetic"].startswith(words)
    assert compare_reproduction(kept, kept.copy(deep=True)).attrs["arithmetic"] == ""


def test_archives_of_another_schema_are_held_to_what_they_have() -> None:
    """Assert that variables and settings that a record did not have yet do not count, and that numbers do."""
    from xdynamics.evidence.comparing.bits import compare_reproduction

    again = made(0.01)
    kept = again.drop_vars("a_x").assign_attrs(schema_version="1", force_digest="in other words")
    del kept.attrs["solver_summation"]
    table = compare_reproduction(kept, again)
    assert table.attrs["identical"] == 1
    assert "records of schema 1 had the law in other words" in table.attrs["arithmetic"]
    assert (
        compare_reproduction(kept.assign_attrs(schema_version=again.attrs["schema_version"]), again).attrs["identical"]
        == 0
    )
    assert compare_reproduction(kept.assign(x=kept.x * 2.0), again).attrs["identical"] == 0
    for units, same in (("m s-1", 1), ("m/s", 1), ("km s-1", 0), ("N", 0)):
        assert (
            compare_reproduction(kept.assign(v_x=kept.v_x.assign_attrs(units=units)), again).attrs["identical"] == same
        )
    assert compare_reproduction(kept.assign_attrs(solver_step=0.02), again).attrs["identical"] == 0


ODD = {
    "times of whole seconds": lambda run: run.assign_coords(time=run.time.astype("M8[s]", keep_attrs=True)),
    "one time": lambda run: run.drop_vars("time").assign_coords(time=1.0),
    "fewer times": lambda run: run.drop_vars("time").assign_coords(time=("q", np.arange(5.0), run.time.attrs)),
    "kinds along another dimension": lambda run: run.drop_vars("row_kind").assign(
        row_kind=("q", np.zeros(500, "i1"), run.row_kind.attrs)
    ),
    "a text for a state": lambda run: run.assign(x=("step", np.array(["a"] * run.sizes["step"], object), run.x.attrs)),
    "a plane of states": lambda run: run.assign(x=(("step", "bound"), np.zeros((run.sizes["step"], 2)), run.x.attrs)),
    "no units": lambda run: run.assign(x=("step", run.x.values, {"role": "coordinate", "long_name": "x"})),
}


@pytest.mark.parametrize("what", ODD)
def test_an_edited_record_is_one_error(what: str) -> None:
    """Assert that a record which was edited to be none is refused on either side."""
    run = xd.simulate(oscillator().model, step=0.1, until=1.0)
    odd = ODD[what](run)
    for pair in ((run, odd), (odd, run), (odd, odd)):
        with pytest.raises(xd.InputError, match="no run record"):
            xd.compare(*pair)


def test_any_steps_meet_by_dense_output() -> None:
    """Assert two adaptive runs on the union of their times: apart by no more than their errors, in the units of the first."""
    model = oscillator().model
    loose, tight = (xd.simulate(model, method="dop853", rtol=rtol, atol=rtol, until=3.0) for rtol in (1e-7, 1e-11))
    table = xd.compare(loose, tight)
    assert table.sizes["at"] == np.union1d(loose.time, tight.time).size
    assert np.abs(table.difference_x).max() < 1e-6
    off = np.abs(np.cos(2 * table.at_time) - xd.sample(loose, table.at_time).x)
    assert table.difference_x.values == pytest.approx(
        np.cos(2 * table.at_time.values) - xd.sample(loose, table.at_time).x.values, abs=1e-9 + 0 * float(off.max())
    )
    assert table.attrs["cause"].startswith("settings: solver_rtol: 1e-07 | 1e-11")
    assert table.attrs["runs"].split() == [xd.content_digest(one) for one in (loose, tight)]


def test_other_units_are_converted() -> None:
    """Assert the difference of a run in millimetres from the same in metres, and that another quantity is refused."""
    text = (MODELS / "harmonic_oscillator.toml").read_text()
    small = xd.Model.from_text(text.replace('unit = "m"', 'unit = "mm"'))
    runs = [xd.simulate(one, method="rk4", step=0.01, until=1.0) for one in (oscillator().model, small)]
    assert runs[1].x.attrs["units"] == "mm"
    table = xd.compare(*runs)
    assert table.difference_x.attrs["units"] == "m"
    assert np.abs(table.difference_x).max() < 1e-12


def test_events_are_matched_though_their_number_differs() -> None:
    """Assert times of bounces that both met, and that the rest is said."""
    low, high = (xd.simulate(ball(e, 1.0), method="dop853", rtol=1e-10, until=1.4) for e in (0.5, 0.8))
    table = xd.compare(low, high)
    first = (1 + 0.5) - (1 + 0.8)
    fall = float(low.event_time[0])
    assert table.difference_event_time_floor.values[:2] == pytest.approx([0.0, -2 * fall * (0.5 - 0.8)], abs=1e-9)
    assert (table.interpolation_error_event_time_floor[:2] < 1e-9).all()
    counts = [int(one.sizes["event"]) for one in (low, high)]
    assert table.attrs["events"] == f"floor: {counts[0]} | {counts[1]}"
    assert first < 0.0


def bench(tmp_path: Path) -> Path:
    """A bench record in milliseconds and millimetres, 0.5 mm off with an uncertainty of 1 mm."""
    times = np.array([100.0, 333.0, 500.0, 900.0])
    rows = "".join(f"{t:g},{1e3 * np.cos(2e-3 * t) + 0.5:.9g},1\n" for t in times)
    (tmp_path / "bench.csv").write_text("# from the bench\ntime [ms],x [mm],u(x) [mm]\n" + rows)
    return tmp_path / "bench.csv"


def test_a_run_beside_measured_data(tmp_path: Path) -> None:
    """Assert residuals in the run's units, their root mean square and chi-square, from a file, a table and a Dataset."""
    run = xd.simulate(oscillator().model, method="dop853", rtol=1e-10, until=1.0)
    table = xd.compare(run, bench(tmp_path))
    assert table.difference_x.values == pytest.approx(5e-4, abs=2e-9)
    assert float(table.rms_difference_x) == pytest.approx(5e-4, abs=2e-9)
    assert float(table.reduced_chi_square_x) == pytest.approx(0.25, rel=1e-4)
    assert table.difference_x.attrs["units"] == table.rms_difference_x.attrs["units"] == "m"
    assert comparison_lines(table)[-1].startswith("reduced_chi_square_x = 0.25")
    frame = pd.read_csv(bench(tmp_path), comment="#")
    assert np.array_equal(xd.compare(run, frame).difference_x, table.difference_x)
    columns = {
        "x": ("row", frame["x [mm]"].to_numpy(), {"units": "mm"}),
        "u_x": ("row", frame["u(x) [mm]"].to_numpy(), {"units": "mm"}),
    }
    data = xr.Dataset(columns | {"time": ("row", frame["time [ms]"].to_numpy(), {"units": "ms"})})
    assert np.array_equal(xd.compare(run, data).reduced_chi_square_x, table.reduced_chi_square_x)
    xd.save(table, tmp_path / "c.nc")
    assert xd.open_run(tmp_path / "c.nc").attrs["evidence"] == "comparison"
    assert len(xd.plot(table).axes) == 2


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ({"t": [0.1], "x [m]": [1]}, "column 't': it has no unit; write it like"),
        ({"x [m]": [1]}, "has no column of times, like 'time .s.'; there are x"),
        ({"time [m]": [0.1], "x [m]": [1]}, "the column of times is in 'm', needs a time"),
        ({"time [s]": [0.1, np.nan], "x [m]": [1, 2]}, "row 2 is nan, needs a number; leave out rows with gaps"),
        ({"time [s]": [0.1], "x [m]": ["high"]}, "row 1 is 'high', needs a number"),
        ({"time [s]": [0.1], "x [kg]": [1]}, "column 'x' is in 'kg', needs 'm' or a unit like it"),
        ({"time [s]": [0.1], "q [m]": [1]}, "column 'q .m.' is no quantity of the model, which has x, v_x"),
        ({"time [s]": [0.1], "x [m]": [1], "u(x) [m]": [0.0]}, r"u\(x\) is 0.0 in row 1, needs a positive number"),
        (
            {"time [s]": [0.1], "x [m]": [1], "u(v) [m]": [1]},
            r"u\(v\) is the uncertainty of a column that is missing",
        ),
        ({"time [s]": [9.0], "x [m]": [1]}, "9.0 s is outside the run"),
        ({"time [s]": [], "x [m]": []}, "has no rows"),
        ({"time [s]": [0.1]}, "has no column beside the times"),
        ({"time [s]": [0.0, 5.0], "x [m]": pd.to_timedelta([0, 5], unit="s")}, "column 'x' is in 's', needs 'm'"),
        ({"time [s]": [0.1], "x [m]": [0.54], "x [mm]": [99.0]}, "'x' is given twice"),
        ({"time [s]": [0.1], "x [m]": [1 + 1j]}, "holds complex numbers"),
    ],
)
def test_wrong_data(columns: dict[str, Any], said: str) -> None:
    """Assert what is said of each."""
    with pytest.raises(xd.InputError, match=said):
        xd.compare(made(0.01), pd.DataFrame(columns))


def test_runs_without_a_common_time_or_quantity() -> None:
    """Assert that these are refused."""
    late = xd.simulate(oscillator().model.replace(initial={"t": "7 s"}), step=0.01, until=8.0)
    with pytest.raises(xd.InputError, match="the runs have no time in common: one goes from 0.0 s to 1.0 s"):
        xd.compare(made(0.01), late)
    with pytest.raises(xd.InputError, match="outside the run"):
        xd.compare(made(0.01), made(0.02), times=[2.0])
    with pytest.raises(xd.InputError, match="'x' is in 'm' in one run and 'kg' in the other"):
        xd.compare(made(0.01), xd.simulate(driven_decay().model, method="rk4", step=0.1, until=1.0))
    with pytest.raises(xd.InputError, match="no coordinate, velocity, state or observable in common"):
        xd.compare(
            made(0.01),
            made(0.01).drop_vars(["x", "v_x", "kinetic_energy", "potential_energy", "total_energy", "phase"]),
        )


def test_a_part_is_matched_by_its_times() -> None:
    """Assert that bounces of a selection are those of the run, and that the last bit of an impact parts nothing."""
    run = xd.simulate(ball(0.8, 1.0), method="dop853", rtol=1e-9, until=1.9)
    table = xd.compare(run, run.isel(event=slice(1, 3)))
    assert (table.difference_event_time_floor[:2] == 0.0).all()
    coarse, fine = (
        xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), step=step, until=2.0) for step in (0.01, 0.003)
    )
    parted = xd.compare(coarse, fine).attrs["parted"]
    assert "v_y by -7" not in parted


def test_datasets_with_two_dimensions() -> None:
    """Assert that measured variables of unlike length are one error, and evidence is no data."""
    data = xr.Dataset({"x": ("a", [1.0, 1.0], {"units": "m"}), "time": ("b", [0.1], {"units": "s"})})
    with pytest.raises(xd.InputError, match="need one dimension for all"):
        xd.compare(made(0.01), data)
    with pytest.raises(xd.InputError, match="is evidence, no run"):
        xd.compare(made(0.01), xd.compare(made(0.01), made(0.02)))
    with pytest.raises(xd.InputError, match="'model_toml' was left out"):
        xd.compare(made(0.01), made(0.01).drop_vars("model_toml"))


def test_what_two_falls_differ_in_is_said() -> None:
    """Assert counts of variables, the likely cause with how many more, and where which difference is largest, in lines."""

    def fall(g: float, m: float) -> xr.Dataset:
        model = xd.Model(
            name="fall",
            coordinates={"y": "m"},
            parameters={"m": f"{m!r} kg", "g": f"{g!r} m s-2"},
            mass={"y": "m"},
            forces={"gravity": {"y": "-m*g"}},
            initial={"y": "0 m", "v_y": "4 m s-1"},
            events={"mark": {"function": "y + 1*metre"}, "level": {"function": "y - 0.5*metre"}},
        )
        return xd.simulate(model, method="rk4", step=0.1, until=1.5)

    first, second = fall(10.0, 1.0), fall(9.0, 1.0)
    table = xd.compare(first, second)
    assert table.attrs["cause"] == "parameters: g: 10.0 m s-2 | 9.0 m s-2"
    assert xd.compare(first, fall(9.0, 2.0)).attrs["cause"].endswith(", and 1 more")
    said = comparison_lines(table)
    assert said[0].startswith(f"{int((table.same == 0).sum())} of {table.sizes['variable']} variables differ; first: ")
    times = table.difference_event_time_level
    worst = int(np.abs(times.values).argmax())
    assert worst == 1  # the way down
    (line,) = [one for one in said if one.startswith("event_time_level ")]
    told = re.search(r" (\S+) ± (\S+) s +occurrence 2 ", line)
    assert told is not None
    assert 0.0 < float(told[2]) < 1e-9
    assert float(told[1]) == pytest.approx(float(times[1]), abs=float(told[2]))
    place = table.difference_y
    (line,) = [one for one in said if one.startswith("y ")]
    k = int(np.abs(place.values).argmax())
    assert f" {float(place[k]):.6g} m " in line
    assert f" t = {float(table.at_time[k]):.9g} s " in line
    with pytest.raises(xd.InputError, match=r"'run\.nc' is a path; open it first, with open_run"):
        xd.compare("run.nc", first)


BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")
ASKED: dict[str, Any] = {"step": "20 ms", "until": "2 s"}


@pytest.fixture(scope="module")
def runs() -> dict[str, xr.Dataset]:
    """The same ball by three methods and steps, and one that meets no apex."""
    late = BALL.replace(initial={"v_y": "30 m s-1"})
    return {
        "heun": xd.simulate(BALL, method="heun", **ASKED),
        "rk4": xd.simulate(BALL, method="rk4", **ASKED),
        "fine": xd.simulate(BALL, method="heun", step="7 ms", until="2 s"),
        "thrown": xd.simulate(late, method="heun", **ASKED),
    }


def test_each_is_compared_as_it_would_be_alone(runs: dict[str, xr.Dataset]) -> None:
    """Assert differences, uncertainties, causes and events, bit for bit, at times that all have."""
    first, *others = runs.values()
    found = xd.compare(first, dict(list(runs.items())[1:]))
    assert found.run_name.values.tolist() == ["rk4", "fine", "thrown"]
    times = found.at_time.values
    assert times.tolist() == np.unique(np.concatenate([run.time for run in runs.values()])).tolist()
    for k, other in enumerate(others):
        alone = xd.compare(first, other, times=times)
        for name in ("difference_y", "interpolation_error_y", "difference_total_energy", "difference_scale_y"):
            np.testing.assert_array_equal(found[name].isel(run=k), alone[name])
        for word in ("cause", "parted", "settings", "parameters", "initial"):
            assert str(found[word].values[k]) == alone.attrs[word]
        assert float(found.largest_difference_y[k]) == float(abs(alone.difference_y).max())
    back = xd.compare(others[0], [first], times=times)
    assert float(back.largest_difference_y[0]) == float(found.largest_difference_y[0]) > 0.0
    assert found.cause.values[2] == "initial: v_y: 20.0 m s-1 | 30.0 m s-1"
    assert found.attrs["identical"] == 0


def test_a_list_is_named_by_files_or_numbers(runs: dict[str, xr.Dataset], tmp_path: Path) -> None:
    """Assert names of runs in memory, of archives, and of archives with one name."""
    first = runs["heun"]
    here = xd.compare(first, [first, runs["rk4"]])
    assert here.run_name.values.tolist() == ["run 2", "run 3"]
    assert here["identical"].values.tolist() == [1, 0]
    (tmp_path / "b").mkdir()
    paths = [xd.save(runs[name], tmp_path / where) for name, where in (("rk4", "a.nc"), ("fine", "b/a.nc"))]
    opened = [xd.open_run(path) for path in paths]
    assert xd.compare(first, opened[:1]).run_name.values.tolist() == ["a.nc"]
    assert xd.compare(first, opened).run_name.values.tolist() == ["2 a.nc", "3 a.nc"]
    saved = xd.open_run(xd.save(here, tmp_path / "c.nc"))
    assert saved.dynamics.table().columns[0] == "run_name"
    np.testing.assert_array_equal(saved.difference_y, here.difference_y)


def test_the_verb_takes_several_files(runs: dict[str, xr.Dataset], tmp_path: Path) -> None:
    """Assert a row a run, the cause of each below, and a figure of the archive."""
    names = [str(xd.save(run, tmp_path / f"{name}.nc")) for name, run in runs.items()]
    done = CliRunner().invoke(main, ["compare", *names, "-o", str(tmp_path / "c.nc")])
    assert done.exit_code == 1
    for name, cause in (("rk4", "solver_method: 'heun' | 'rk4'"), ("thrown", "v_y: 20.0 m s-1 | 30.0 m s-1")):
        assert any(line.startswith(f"{name}.nc: ") and cause in line for line in done.output.splitlines())
    assert max(map(len, done.output.split("times ")[0].splitlines()[1:])) <= 80
    figure = xd.plot(xd.open_run(tmp_path / "c.nc"))
    assert len(figure.axes[0].lines) == 3
    same = CliRunner().invoke(main, ["compare", names[0], names[0], names[0]])
    assert same.exit_code == 0


def test_wrong_runs_are_named(runs: dict[str, xr.Dataset]) -> None:
    """Assert an error for none, for evidence, for times that none has, for what is of two runs alone."""
    first, second = runs["heun"], runs["rk4"]
    late = xd.simulate(BALL.replace(initial={"t": "5 s"}), method="heun", step="20 ms", until="6 s")
    for given in ((first,), (first, second, late), ([first, second], late)):
        with pytest.raises(xd.InputError, match=r"as in compare\(a, \[b, c\]\)"):
            xd.compare(*given)
    for others, words, more in (
        ([], "second has no run; give one at least", {}),
        ([second, xd.diagnose(first)], "compare needs runs", {}),
        ([second, late], "the runs have no time in common", {}),
        ([second, 3], "compare needs two run records", {}),
        ([second, first], "compute, sizes and occurrences are for a single second run", {"compute": False}),
        ([second, first], "times", {"times": [3.0]}),
    ):
        with pytest.raises(xd.InputError, match=words):
            xd.compare(first, others, **more)


BOUNCING_BALL = xd.Model.from_toml(MODELS / "bouncing_ball.toml")
OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")
BY_EULER: dict[str, Any] = {"method": "euler_cromer", "until": "1 s"}
SIZES = {"step": 300, "event": 10}


def pair(*, compute: bool) -> list[xr.Dataset]:
    """Two runs of a bouncing ball by different steps, marched or not."""
    sizes = {} if compute else {"sizes": SIZES}
    return [xd.simulate(BOUNCING_BALL, step=step, compute=compute, **sizes, **BY_EULER) for step in ("20 ms", "10 ms")]


def assert_told(stage: xr.Dataset, eager: xr.Dataset) -> None:
    """Assert what a stage that is computed variable by variable says of runs, and that it is summed up as the eager one."""
    for name in LATER:
        assert stage[name].values.item() == eager.attrs[name], name
    lines = [[line for line in summary(found) if not line.startswith("kind")] for found in (stage, eager)]
    assert lines[0] == lines[1]


@pytest.mark.parametrize("times", [None, [0.25, 0.5, 0.75]], ids=["rows", "times"])
def test_a_comparison_of_runs_to_be_marched_has_the_bits_of_the_eager_one(times: Any) -> None:
    """Assert names, units and words while every march fails, one march of each run, and all values and attributes."""
    eager = xd.compare(*pair(compute=True), times)
    sizes = {"sizes": {"at": eager.sizes["at"]}} if times is None else {}
    with no_march():
        stage = xd.compare(*pair(compute=False), times, compute=False, occurrences=eager.sizes["occurrence"], **sizes)
        assert [*stage.variables] == [*eager.variables, *LATER]
        assert dict(stage.sizes) == dict(eager.sizes)
        assert all(repr(stage[name].attrs) == repr(eager[name].attrs) for name in eager.variables)
        assert {*eager.attrs} - {*stage.attrs} == {"runs", *LATER}
        assert stage["name"].values.tolist() == eager["name"].values.tolist()
        assert (stage.at_time.chunks is None) == (times is not None)
    with marches() as begun:
        assert_same_bits(stage, eager)
        assert_told(stage.compute(), eager)
        (whole,) = compute_datasets(stage)
    assert len(begun) == 2
    assert {name for name in eager.attrs if repr(whole.attrs[name]) != repr(eager.attrs[name])} <= CIRCUMSTANCES
    assert xd.content_digest(whole) == xd.content_digest(eager)


def test_the_first_occurrences_are_compared() -> None:
    """Assert that of more events than are asked for the first ones are compared, with the numbers of all."""
    runs = [xd.simulate(BOUNCING_BALL, method="euler_cromer", step=step, until="3 s") for step in ("20 ms", "10 ms")]
    times = xd.compare(*runs).difference_event_time_floor.values
    assert len(times) > 1
    first = xd.compare(*runs, compute=False, occurrences=1)
    assert first.difference_event_time_floor.values.tolist() == times[:1].tolist()


@pytest.mark.dear
def test_what_is_not_there_has_no_value(tmp_path: Path) -> None:
    """Assert nan behind the last time and event and where an event is never met, and the archive of the eager one."""
    eager = xd.compare(*pair(compute=True))
    stage = xd.compare(*pair(compute=False), compute=False, sizes={"at": 400}, occurrences=9)
    assert int(stage.at_time.count()) == eager.sizes["at"]
    assert int(stage.difference_event_time_floor.count()) == eager.sizes["occurrence"]
    late = '[events.late]\nfunction = "t - 9*second"\naction = "record"\n'
    longer = [
        xd.simulate(xd.Model.from_text(OSCILLATOR.to_toml() + late), **asked)
        for asked in ({"step": h, "until": "1 s", "compute": False, "sizes": {"step": 200}} for h in ("20 ms", "10 ms"))
    ]
    never = xd.compare(*longer, [0.5], compute=False, occurrences=2).compute()
    assert np.isnan(never.difference_event_time_late.values).tolist() == [True, True]
    assert np.isnan(float(never.difference_scale_event_time_late))
    assert "occurrence" not in xd.compare(*longer, [0.5], compute=False, occurrences=0).dims
    xd.report(tmp_path, comparison=stage)
    assert verified(tmp_path / "comparison.nc") == xd.content_digest(eager)


def test_a_comparison_shares_its_runs_and_travels() -> None:
    """Assert that runs are marched once for two stages, in another process too, and that marched ones are not again."""
    first, second = pair(compute=False)
    shown: dict[str, Any] = {"sizes": {"at": 200}, "occurrences": 5}
    stages = [
        xd.compare(first, second, compute=False, **shown),
        xd.compare(second, first, compute=False, **shown),
    ]
    with marches() as begun:
        sent = pickle.loads(pickle.dumps(stages))
        found = compute_datasets(*sent)
    assert len(begun) == 2
    assert xd.content_digest(found[1]) == xd.content_digest(xd.compare(*pair(compute=True)[::-1]))
    runs = pair(compute=True)
    with marches() as begun:
        stage = xd.compare(*runs, compute=False)
        assert_same_bits(stage, eager := xd.compare(*runs))
        assert not begun
        half = xd.compare(runs[0], second, [0.5], compute=False, occurrences=3)
        assert float(half.difference_y[0]) == float(xd.compare(*runs, [0.5]).difference_y[0])
        assert len(begun) == 1
    assert stage.sizes["occurrence"] == eager.sizes["occurrence"]


def test_a_run_to_be_marched_beside_measured_data() -> None:
    """Assert the description and the bits beside a record of a bench, and that a time beyond the run fails when computed."""
    model, data = (
        xd.Model.from_toml(MODELS / "bench_pendulum.toml"),
        ROOT / "pipelines" / "pendulum_period" / "bench.csv",
    )
    sizes = {"step": 20_000}
    with no_march():
        stage = xd.compare(xd.simulate(model, compute=False, sizes=sizes), data, compute=False)
        assert stage.measured_theta.chunks is None
    eager = xd.compare(xd.simulate(model), data)
    assert [*stage.variables] == [*eager.variables]
    assert all(repr(stage[name].attrs) == repr(eager[name].attrs) for name in eager.variables)
    with marches() as begun:
        assert_same_bits(stage, eager)
        assert xd.content_digest(compute_datasets(stage)[0]) == xd.content_digest(eager)
    assert len(begun) == 1
    short = xd.compare(xd.simulate(model, until="1 s", compute=False, sizes=sizes), data, compute=False)
    with pytest.raises(xd.InputError, match="is outside the run, from"):
        short.difference_theta.compute()


@pytest.mark.dear
@pytest.mark.parametrize(
    "name", ["truss", "heat", "coupled_masses", "stick_slip_belt", "relay_oscillator", "woodpecker"]
)
def test_every_variable_of_a_record_is_foreseen(name: str) -> None:
    """Assert the table of variables of models with dimensions, contacts, frictions and events, in order."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    runs = [xd.simulate(model, until=until, compute=False, sizes={"step": 4}) for until in ("1 ms", "2 ms")]
    eager = xd.compare(*(xd.simulate(model, until=until) for until in ("1 ms", "2 ms")), times=["0.5 ms"])
    with no_march():
        count = eager.sizes.get("occurrence", 0)
        stage = xd.compare(*runs, times=["0.5 ms"], compute=False, occurrences=count)
    assert stage["name"].values.tolist() == eager["name"].values.tolist()
    assert [key for key in stage.variables if "_event_time_" not in key and key not in LATER] == [
        key for key in eager.variables if "_event_time_" not in key
    ]
    assert_same_bits(stage, eager)


@pytest.mark.parametrize(
    ("asked", "times", "message"),
    [
        ({"occurrences": 3}, None, r"known only once they are computed; give times=…, a number, sizes=\{'at': 5000\}"),
        (
            {"sizes": {"at": 5}},
            None,
            r"how often floor will be met is known only once the runs are computed; .* occurrences=10",
        ),
        ({"sizes": {"at": 5}}, [0.5], "sizes have 5 for 'at', and the times are known already; leave it out"),
        ({"sizes": {"at": 0}}, None, "sizes have 0 for 'at', need a positive whole number"),
        ({"occurrences": -1}, [0.5], "occurrences is -1, needs a non-negative whole number"),
        ({"sizes": {"step": 5}}, None, "sizes name 'step'; there is at"),
        ({"sizes": {"occurrence": 5}}, None, "how many events are compared is said by occurrences=10"),
        ({"sizes": 5}, None, "sizes are 5, need numbers by dimension"),
    ],
)
def test_sizes_that_only_marching_tells_have_to_be_stated(asked: Any, times: Any, message: str) -> None:
    """Assert one line each, before anything is marched."""
    runs = pair(compute=False)
    with no_march(), pytest.raises(xd.InputError, match=message):
        xd.compare(*runs, times, compute=False, **asked)


def test_sizes_are_for_what_is_lazy() -> None:
    """Assert that a comparison at once has none."""
    with pytest.raises(xd.InputError, match="for compute=False: what is compared at once has its own"):
        xd.compare(*pair(compute=True), sizes={"at": 5})


def test_diagnoses_of_dask_arrays_are_told_apart() -> None:
    """Assert that runs in chunks of which no digest is known are no one task, whose result would be remembered."""
    runs = [
        xd.simulate(OSCILLATOR.replace(initial={"x": x}), method="rk4", step="20 ms", until="1 s")
        for x in ("1 m", "2 m")
    ]
    found = [xd.diagnose(run.chunk(), occurrences=1, companion=False, compute=False) for run in runs]
    assert [float(diagnosis.maximum_x) for diagnosis in found] == [1.0, 2.0]
