"""Several runs compared with one of them: the same numbers as one by one, a row a run."""

from __future__ import annotations

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
