"""What people type first where they know another name: each is met by one line with what to write."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.cli import main
from xdynamics.documenting.manual import manual_text

BALL = str(MODELS / "ball_drag.toml")
SPRING: dict[str, Any] = {
    "name": "spring",
    "coordinates": {"x": "m"},
    "mass": {"x": "kilogram"},
    "initial": {"x": "1 m", "v_x": "0 m/s"},
}


@pytest.mark.parametrize("verb", ["show", "diagnose", "table", "reproduce"])
def test_a_model_in_the_place_of_a_run_is_told_how_to_run(verb: str) -> None:
    """Assert that it is not called damaged, and that the line to type is there."""
    done = CliRunner().invoke(main, [verb, BALL])
    assert done.exit_code == 2
    assert f"'{BALL}' is a model, and a run of it is needed: xdynamics run {BALL} -o" in done.output
    with pytest.raises(xd.InputError, match="is a model, and a run of it is needed"):
        xd.open_run(BALL)


@pytest.mark.parametrize(
    ("word", "meant"),
    [("open", "open_run"), ("load", "open_run"), ("solve_ivp", "solve"), ("integrate", "simulate"), ("scan", "sweep")],
)
def test_names_of_other_libraries(word: str, meant: str) -> None:
    """Assert that the error of a name that is none says which one is."""
    with pytest.raises(AttributeError, match=f"no attribute '{word}'; did you mean '{meant}'"):
        getattr(xd, word)


def test_an_argument_without_its_name() -> None:
    """Assert that the message says how it is written, and nothing is simulated; errors of other kinds stay as they are."""
    model = xd.Model.from_toml(BALL)
    with pytest.raises(
        xd.InputError, match="simulate takes 1 of its arguments by place, .* as in method=.*'rk4' has no"
    ):
        xd.simulate(model, "rk4")  # type: ignore[call-arg]
    with pytest.raises(xd.InputError, match="refine takes 1 of its arguments by place.*'y' has no name"):
        xd.refine(model, "y", rtols=[1e-6, 1e-7])  # type: ignore[call-arg]
    with pytest.raises(TypeError, match="missing 1 required positional argument"):
        xd.simulate()  # type: ignore[call-arg]


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"parameters": {"k": 3}, "forces": {"s": {"x": "-k*x"}}}, r"needs 'kg m s-2 \(N\)' .*; 'k' has no unit"),
        ({"forces": {"spring": "-k*x"}}, "a component per coordinate, like { x = '-k\\*x' } along x"),
        ({"forces": {"s": {"x": "-newton*|x|/metre"}}}, "character '|' at column 9; an absolute value is written abs"),
        ({"forces": {"s": {"x": "-kilogram/second*x_dot"}}}, "'x_dot' .* is not declared; did you mean 'v_x'"),
        ({"forces": {"s": {"x": "-kilogram/second*xdot"}}}, "'xdot' .* is not declared; did you mean 'v_x'"),
        ({"forces": {"s": {"x": "-kilogram/second*dx"}}}, "'dx' .* is not declared; did you mean 'v_x'"),
        ({"mass": {"x": "1 kg"}}, "write '1\\*kilogram'"),
    ],
)
def test_expressions_as_textbooks_write_them(sections: dict[str, Any], said: str) -> None:
    """Assert the remedy in the message."""
    with pytest.raises(xd.ModelError, match=said):
        xd.Model(**SPRING | sections)


@pytest.mark.parametrize(
    ("word", "page"),
    [
        ("restitution", "help contacts"),
        ("spring", "help shapes"),
        ("rejected", "help record"),
        ("netcdf", "help running"),
        ("dask", "help cluster"),
        ("phase", "help events"),
        ("quickstart", "First steps"),
        ("tutorial", "First steps"),
    ],
)
def test_help_finds_words_of_textbooks(word: str, page: str) -> None:
    """Assert that a word that is no page leads to those that say it, the ones that explain it first."""
    done = CliRunner().invoke(main, ["help", word])
    assert (done.exit_code, page in done.output) == (0, True)
    assert max(map(len, done.output.splitlines())) <= 110
    if word == "restitution":
        assert done.output.splitlines()[1] == "xdynamics help contacts"


def test_first_steps_run_as_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that each command of the page, and its lines of Python, do what they say in an empty folder."""
    monkeypatch.chdir(tmp_path)
    shell, python = re.findall(r"```(?:sh|python)\n(.*?)```", manual_text("first.md"), re.DOTALL)
    commands = [line.partition("#")[0].split() for line in shell.splitlines()]
    verbs = "new check run show plot refine diagnose table reproduce"
    assert " ".join(command[1] for command in commands) == verbs
    for command in commands:
        done = CliRunner().invoke(main, command[1:])
        assert done.exit_code == 0, (command, done.output)
    scope: dict[str, Any] = {}
    exec("\n".join(line for line in python.splitlines() if ".plot(" not in line), scope)
    assert scope["run"].sizes["step"] > 10


def test_the_version_by_any_name() -> None:
    """Assert that three options print it, and that the word leads to one of them."""
    said = {CliRunner().invoke(main, [option], prog_name="xdynamics").output for option in ("-v", "-V", "--version")}
    assert len(said) == 1
    assert said.pop().startswith("xdynamics ")
    assert "did you mean `xdynamics --version`" in CliRunner().invoke(main, ["version"]).output
