"""A run marched again with something changed: its model and its settings, from the record alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")  # its own [run]: midpoint, 1 ms, until 5 s

SETTINGS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "steps": (
        {"method": "rk4", "step": "10 ms", "until": "1 s"},
        {"method": "rk4", "until": "1.0 s", "step": "0.01 s"},
    ),
    "tolerance": (
        {"method": "dop853", "rtol": 1e-8, "atol": {"y": "1 mm"}, "until": 1.0},
        {"method": "dop853", "until": "1.0 s", "rtol": 1e-8, "atol": {"y": "0.001 m"}},
    ),
    "control": (
        {"method": "dop853", "rtol": 1e-6, "max_step": "0.1 s", "growth_limits": (0.3, 5.0), "until": 1.0},
        {"method": "dop853", "until": "1.0 s", "rtol": 1e-6, "max_step": "0.1 s", "growth_limits": [0.3, 5.0]},
    ),
    "arithmetic": (
        {"method": "velocity_verlet", "step": 0.01, "until": 1.0, "summation": "plain"},
        {"method": "velocity_verlet", "until": "1.0 s", "step": "0.01 s", "summation": "plain"},
    ),
}


@pytest.mark.parametrize("kind", SETTINGS)
def test_a_model_of_a_record_has_the_settings_of_its_run(kind: str, tmp_path: Path) -> None:
    """Assert those that were asked for, and no other, in an archive as in memory, and the same numbers when it is marched."""
    asked, section = SETTINGS[kind]
    model = BALL if kind != "arithmetic" else xd.Model.from_toml(MODELS / "bouncing_ball.toml")
    run = xd.simulate(model, **asked)
    xd.save(run, tmp_path / "run.nc")
    assert xd.Model.from_record(run).run == section
    opened = xd.open_run(tmp_path / "run.nc")
    assert xd.Model.from_record(opened).run == section
    again = xd.simulate(opened)
    assert again.y.values.tolist() == run.y.values.tolist()
    assert again.time.values.tolist() == run.time.values.tolist()


def test_what_is_given_counts_before_what_the_run_had() -> None:
    """Assert a parameter, a start, a method, an end and a step in the place of a tolerance; the rest stays."""
    run = xd.simulate(BALL, method="dop853", rtol=1e-8, until="1 s")
    faster = xd.simulate(run, parameters={"vt": "35 m s-1"}, initial={"y": 2.0})
    assert float(faster.vt) == 35.0
    assert float(faster.y[0]) == 2.0
    assert (faster.attrs["solver_method"], faster.attrs["solver_rtol"], faster.attrs["solver_until"]) == (
        "dop853",
        1e-8,
        1.0,
    )
    stepped = xd.simulate(run, method="rk4", step="10 ms", until="0.5 s")
    assert (stepped.attrs["solver_method"], stepped.attrs["solver_step"]) == ("rk4", 0.01)
    assert "solver_rtol" not in stepped.attrs
    assert xd.simulate(BALL, parameters={"vt": 35.0}, until="0.1 s").vt == 35.0


def test_the_command_takes_an_archive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that `run` and `refine` of an archive keep its method, step and end, and change a parameter."""
    monkeypatch.chdir(tmp_path)
    xd.simulate(BALL, method="rk4", step="10 ms", until="1 s", path="old.nc")
    done = CliRunner().invoke(main, ["run", "old.nc", "--set", "vt=35 m s-1", "-o", "new.nc"])
    assert done.exit_code == 0, done.output
    new = xd.open_run("new.nc")
    assert (float(new.vt), new.attrs["solver_method"], new.attrs["solver_step"]) == (35.0, "rk4", 0.01)
    assert float(new.time[-1]) == 1.0
    done = CliRunner().invoke(main, ["refine", "old.nc", "--levels", "3"])
    assert done.exit_code == 0, done.output
    assert "by rk4" in done.output


WRONG: dict[str, tuple[Any, str]] = {
    "number": (lambda _: xd.Model.from_record(3), "a record is '3', needs a run"),
    "evidence": (lambda run: xd.simulate(xd.diagnose(run)), "has no model_toml"),
    "variables": (lambda run: xd.simulate(run[["y"]]), "has no model_toml, from which its model is read"),
    "unknown parameter": (lambda run: xd.simulate(run, parameters={"foo": 1}), "has no entry 'foo'"),
    "unit": (lambda run: xd.simulate(run, initial={"y": "3 s"}), "has units 's', needs 'm'"),
    "text": (lambda run: xd.simulate(run, parameters="vt"), "has no entries to replace"),
    "name of a file": (lambda _: xd.simulate("ball.toml"), "needs a Model; read a file with Model.from_toml"),
    "step": (lambda run: xd.simulate(run, step="-1 ms"), "step"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_is_wrong_is_one_line(case: str) -> None:
    """Assert one clear error."""
    made, words = WRONG[case]
    with pytest.raises(xd.InputError, match=words):
        made(xd.simulate(BALL, method="rk4", step="10 ms", until="0.1 s"))


def test_given_steps_are_said_to_have_no_place_in_a_run_section() -> None:
    """Assert the way on."""
    run = xd.simulate(BALL, method="rk4", step=[0.1, 0.2], until=0.3)
    with pytest.raises(xd.InputError, match="given one by one, and a .run. has one step; .* step=run.given_step_size"):
        xd.simulate(run, parameters={"vt": 35.0})


def test_a_value_that_keeps_an_uncertainty_says_so(tmp_path: Path) -> None:
    """Assert one line for a value without an uncertainty of its own, and none for one that has it."""
    given = ["run", str(MODELS / "ball_drag.toml"), "-o", str(tmp_path / "r.nc"), "--until", "0.1 s", "--set"]
    said = "vt = 35 m s-1 keeps the uncertainty of the model, 1 m s-1; write '35 ± 0 m s-1' for none"
    for text, expected in (("vt=35 m s-1", 1.0), ("vt=35", 1.0), ("vt=35 ± 0 m s-1", 0.0), ("vt=35(2) m s-1", 2.0)):
        done = CliRunner().invoke(main, [*given, text])
        assert done.exit_code == 0, done.output
        assert (said in done.output) is (expected == 1.0)
        with xd.open_run(tmp_path / "r.nc") as run:
            assert xd.Model.from_record(run).elements.statement.parameters["vt"].uncertainty == expected
