"""The verbs that judge: refine, diagnose, compare, validate, and what is shown and drawn of what they keep."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from click.testing import CliRunner, Result

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main

BALL, SWING = str(MODELS / "ball_drag.toml"), str(MODELS / "harmonic_oscillator.toml")


def call(*arguments: object) -> Result:
    """Run a command in this process."""
    return CliRunner().invoke(main, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An archived oscillation."""
    path = tmp_path_factory.mktemp("judging") / "swing.nc"
    assert call("run", SWING, "-o", path, "--step", "20 ms").exit_code == 0
    return path


@pytest.mark.dear
def test_refine_keeps_shows_and_draws(tmp_path: Path) -> None:
    """Assert levels, orders with verdicts, the archive, and that show, verify and plot know it."""
    path = tmp_path / "r.nc"
    done = call(
        "refine",
        BALL,
        "--method",
        "midpoint",
        "--step",
        "40 ms",
        "--levels",
        4,
        "--at",
        "1 s",
        "--at",
        "2 s",
        "-o",
        path,
    )
    assert done.exit_code == 0, done.output
    assert "levels    step_size 0.04, 0.02, 0.01, 0.005 s" in done.output
    assert "order 2" in done.output
    assert ", asymptotic" in done.output
    with xr.open_dataset(path) as kept:
        assert kept.sizes["level"] == 4
        assert kept.at_time.values.tolist() == [1.0, 2.0]
        assert kept.run_digest.shape == (4,)
    shown = call("show", path)
    assert "event_time_ground [1] = 3.711" in shown.output
    assert call("verify", path).output.startswith("verified")
    assert call("plot", path, "-o", tmp_path / "r.png").exit_code == 0
    assert call("reproduce", path).exit_code == 2


def test_refine_by_precisions(tmp_path: Path) -> None:
    """Assert two levels by the same step, whose difference is that of the two runs, and what else has levels refused."""
    asked = ("--method", "rk4", "--step", "50 ms", "--until", "1 s")
    found = call("refine", BALL, "--precisions", *asked, "-o", tmp_path / "r.nc")
    assert found.exit_code == 0, found.output
    assert "levels    precision float64, double_double" in found.output
    runs = [
        xd.simulate(xd.Model.from_toml(BALL), method="rk4", step="50 ms", until="1 s", precision=precision)
        for precision in ("float64", "double_double")
    ]
    with xd.open_run(tmp_path / "r.nc") as study:
        np.testing.assert_array_equal(study.y.values[:, 0], [float(run.y[-1]) for run in runs])
    for more, said in (
        (("--levels", "2"), "--levels and --precisions are both given"),
        (("--time-tolerance", "1 ms"), "--time-tolerance and --precisions are both given"),
        (("--precision", "float64"), "--precision and --precisions are both given"),
        (("--method", "radau_iia"), "method 'radau_iia', whose equations are solved in float64"),
    ):
        refused = call("refine", BALL, "--precisions", *asked, *more)
        assert (refused.exit_code, said in refused.output) == (2, True), refused.output


@pytest.mark.dear
def test_refine_by_tolerances_and_by_location(tmp_path: Path) -> None:
    """Assert the other things that are varied, a ratio, and levels that are added."""
    rtols = call(
        "refine",
        SWING,
        "--method",
        "dop853",
        "--rtol",
        "1e-4",
        "--levels",
        3,
        "--until",
        "2 s",
        "-o",
        tmp_path / "a.nc",
    )
    assert "levels    rtol 0.0001, 1e-05, 1e-06" in rtols.output
    located = call("refine", BALL, "--step", "50 ms", "--time-tolerance", "1 ms", "--levels", 3, "--ratio", 100)
    assert "levels    time_tolerance 0.001, 1e-05, 1e-07 s" in located.output
    more = call(
        "refine",
        BALL,
        "--step",
        "100 ms",
        "--levels",
        1,
        "--until-change",
        "event_time_ground=1 ms",
        "--observable",
        "y",
    )
    assert "stopped   every change under its tolerance" in more.output


@pytest.mark.dear
def test_diagnose_growth(swing: Path) -> None:
    """Assert all Lyapunov exponents of a spring or the largest alone, and that no time follows from 0."""
    every = call("diagnose", swing, "--no-companion", "--lyapunov").output
    line = next(line for line in every.splitlines() if line.startswith("lyapunov_exponents"))
    assert (line.count(" ± "), line[-4:]) == (2, " s-1")
    assert (
        "lyapunov_time = inf: the largest exponent is not above twice its uncertainty, or the run is too short to tell"
        in every
    )
    assert "finite_time_growth = " in every
    one = call("diagnose", swing, "--no-companion", "--exponents", 1).output
    assert next(each for each in one.splitlines() if each.startswith("lyapunov_exponents")).count(" ± ") == 1
    assert call("diagnose", swing, "--exponents", 0).exit_code == 2


def test_diagnose_and_compare(swing: Path, tmp_path: Path) -> None:
    """Assert the lines of a diagnosis, a comparison of two runs, and of one with measured data."""
    done = call("diagnose", swing, "--exact", "x=cos(2*t/second)*metre", "-o", tmp_path / "d.nc")
    assert done.exit_code == 0, done.output
    assert "total_energy " in done.output
    assert "to the next: 5, phases beside dop853" in done.output
    other = tmp_path / "other.nc"
    call("run", SWING, "-o", other, "--step", "10 ms")
    compared = call("compare", swing, other, "--at", "1 s", "-o", tmp_path / "c.nc")
    assert compared.exit_code == 1
    assert "cause     settings: solver_step: 0.02 | 0.01" in compared.output
    assert call("show", tmp_path / "c.nc").exit_code == 0
    assert call("compare", swing, swing).exit_code == 0
    (tmp_path / "bench.csv").write_text("time [ms],x [mm],u(x) [mm]\n100,980.1,1\n200,921,1\n")
    measured = call("compare", swing, tmp_path / "bench.csv")
    assert measured.exit_code == 0
    assert "reduced_chi_square_x = " in measured.output


def test_validate_ends_by_its_verdict(tmp_path: Path) -> None:
    """Assert 0 where all pass, 1 where one fails, 2 where there is nothing to hold against, and the kept ledger."""
    done = call("validate", "--method", "rk4", "-o", tmp_path / "l.nc")
    assert (done.exit_code, done.output.splitlines()[-2]) == (
        0,
        "ledger    41 cases of 1 method: 40 passed, 0 failed, 1 refused",
    )
    assert call("plot", tmp_path / "l.nc", "-o", tmp_path / "l.svg").exit_code == 0
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(
        Path(SWING).read_text() + '\n[validation.x]\nexpression = "metre*cos(3*t/second)"\nbound = "1 mm"\n'
    )
    failed = call("validate", wrong)
    assert failed.exit_code == 1
    assert "failed    x by velocity_verlet: x, accepted states up to 20 s: residual 2 m" in failed.output
    assert call("validate", SWING).exit_code == 2


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("refine", BALL, "--step", "10 ms", "--rtol", "1e-3"), "--step and --rtol are both given"),
        (("refine", BALL, "--levels", "0"), "--levels is 0"),
        (("refine", BALL, "--ratio", "1"), "a ratio is above 1"),
        (("refine", BALL, "--step", "1 m"), "--step '1 m' has units 'm', needs 's'"),
        (("refine", BALL, "--rtol", "fine"), "--rtol is 'fine', needs a number"),
        (("refine", BALL, "--until-change", "y"), "--until-change 'y' needs NAME=VALUE"),
        (("refine", BALL, "--at", "99 s"), "needs times in every run"),
        (("refine", BALL, "-o", "/"), "'/' is a directory"),
        (("validate", "--method", "rk5"), "method 'rk5' is not known"),
        (("diagnose", "nothing.nc"), "'nothing.nc' does not exist"),
        (("compare", "nothing.nc", "data.csv"), "'nothing.nc' does not exist"),
    ],
)
def test_wrong_input_is_one_line(arguments: tuple[str, ...], said: str) -> None:
    """Assert exit code 2, one line, no traceback."""
    done = call(*arguments)
    assert done.exit_code == 2
    assert said in done.output
    assert len(done.output.strip().splitlines()) == 1
