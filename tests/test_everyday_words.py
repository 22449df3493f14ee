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


@pytest.mark.parametrize(
    ("sections", "said"),
    [
        ({"forces": {"s": {"x": "where(x>0*metre and x<1*metre, -k*x, 0*newton)"}}}, "where(a, where(b, yes, no), no)"),
        ({"forces": {"s": {"x": "where(x>0*metre or x<1*metre, -k*x, 0*newton)"}}}, "where(a, yes, where(b, yes, no))"),
        ({"forces": {"s": {"x": "-k*x if x>0*metre else 0*newton"}}}, "a choice is where(condition, yes, no)"),
        ({"forces": {"s": {"x": "-k*x*heaviside(x)"}}}, "'heaviside' is not known; write where(u > 0, 1, 0)"),
        ({"forces": {"s": {"x": "-k*x*ln(2)"}}}, "'ln' is not known; write log(u)"),
        ({"forces": {"s": {"x": "-k*x*clip(x, 0, 1)"}}}, "'clip' is not known; write min(max(u, low), high)"),
        ({"forces": {"s": {"x": "-k*x*sin(3*t)"}}}, "a frequency times it is one, like w*(3*t) with w in rad s-1"),
        (
            {"initial": {"x": "1 m", "vx": "1 m/s"}},
            "initial value of 'vx', which is no coordinate, velocity or state; did you mean 'v_x'?",
        ),
        ({"initial": {"x": "1 m", "v": "1 m/s"}}, "did you mean 'v_x'?"),
        ({"initial": {"x": "1 m", "v0": "1 m/s"}}, "did you mean 'v_x'?"),
        ({"initial": {"x": "1 m", "x_dot": "1 m/s"}}, "did you mean 'v_x'?"),
        ({"events": {"e": {"function": "x", "action": "terminal"}}}, "action 'terminal' is not known; write 'stop'"),
        (
            {"events": {"e": {"function": "x", "terminal": True}}},
            "key 'terminal' is not known; write action = \"stop\"",
        ),
        ({"parameters": {"k": "100,5 N/m"}}, "has a comma; write a decimal point, '100.5 N/m'"),
        ({"mass": {"x": 1}}, "needs 'm s-2' (column 1: -k*x); its mass, 1, has no unit"),
        (
            {"parameters": {"k": "100", "c": "1 kg/s"}, "forces": {"s": {"x": "-k*x - c*v_x"}}},
            "'c*v_x' in 'kg m s-2 (N)' (column 8); 'k' has no unit",
        ),
    ],
)
def test_words_of_other_languages_in_a_model(sections: dict[str, Any], said: str) -> None:
    """Assert the line to write for what Python, scipy and textbooks call something else."""
    known = {"forces": {"s": {"x": "-k*x"}}, "parameters": {"k": "1 N/m"}}
    with pytest.raises(xd.ModelError, match=re.escape(said)):
        xd.Model(**(SPRING | known | sections))


def test_keys_that_are_not_known_are_listed_once() -> None:
    """Assert that four wrong keys do not repeat the list of right ones four times."""
    drives = {"w": {"file": "w.csv", "x": "t", "y": "F", "over": "t"}}
    with pytest.raises(xd.ModelError, match="key 'file' is not known; write table;") as caught:
        xd.Model(**SPRING, drives=drives)
    assert str(caught.value).count("interpolation, outside") == 1
