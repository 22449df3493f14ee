"""Every command that a page of help or the foot of a verb's help prints: its options are there, and it runs."""

from __future__ import annotations

import math
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import ROOT
from xdynamics.cli import main
from xdynamics.cli.examples import EXAMPLES
from xdynamics.documenting.guide import STARTER, topics
from xdynamics.documenting.markdown import WIDTH, terminal_lines

LONGEST_PAGE = 12_000  # characters
PAGES = {name: "\n".join(terminal_lines(page())) for name, page in topics().items()}
PRINTED = [
    re.split(r"\s{2,}#", found.group(0))[0].strip()
    for text in (re.sub(r" \\\n\s+", " ", page) for page in PAGES.values())
    for found in re.finditer(r"(?:(?<=^  )|(?<=`))xdynamics [a-z]+[^`\n]*", text, re.MULTILINE)
]
CHEAP = ("check", "run", "show", "methods", "help", "new", "verify")
DEAR = {  # in orders in which each finds the files that it names
    "runs": ("run", "sample", "reproduce", "compare", "extend", "complete", "animate", "plot", "sign", "diagnose"),
    "studies": ("refine", "budget", "sweep", "validate"),
    "certificates": ("certify", "bundle", "recheck", "report"),
}
ELSEWHERE = (
    "folder/*.nc",
    "s3://",
    "tcp://",
    "…",
    " | ",
    "MODEL.toml --axis",
)  # stores, machines and files of somebody else
SPRING = """
name = "spring"
coordinates = { x = "m" }
parameters = { m = "1 kg", k = "4 N m-1" }
mass = { x = "m" }
forces.spring.x = "-k*x"
initial = { x = "0.1 m", v_x = "0 m s-1" }
run = { method = "dop853", rtol = 1e-9, until = "10 s" }
"""
BALL = """
name = "ball"
coordinates = { y = "m" }
parameters = { m = "1 kg", g = "9.81 m s-2", e = "0.8" }
mass = { y = "m" }
forces.gravity.potential = "m*g*y"
contacts.floor = { gap = "y", restitution = "e" }
initial = { y = "1 m", v_y = "0 m s-1" }
run = { method = "velocity_verlet", step = "1 ms", until = "5 s" }
"""


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the models that the commands name."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def marched() -> None:
    """March the runs that the examples take for granted."""
    orbit = xd.Model.from_toml(ROOT / "data" / "models" / "kepler.toml")
    xd.save(xd.simulate(orbit, step="10 ms", until="12 s"), "orbit.nc")
    ball = xd.Model.from_toml(ROOT / "data" / "models" / "ball_drag.toml")
    xd.save(xd.simulate(ball, step="0.5 ms"), "fine.nc")


def succeeds(command: str) -> bool:
    """Whether a command ends with 0; a comparison of unlike runs with 1."""
    done = call(*shlex.split(command)[1:])
    assert done.exit_code == (" compare " in command), f"{command}\n{done.output}"
    return True


@pytest.mark.parametrize("name", [*PAGES, *main.commands])
def test_pages_are_short(name: str) -> None:
    """Assert that no page is longer than a person reads at once, and none wider than a window."""
    text = PAGES.get(name) or call("help", name).output
    assert 100 < len(text) < LONGEST_PAGE
    assert max(map(len, text.splitlines())) <= WIDTH


def test_printed_commands_have_their_options() -> None:
    """Assert that every printed command names a verb, and options that it has."""
    commands = [*PRINTED, *(part for example in EXAMPLES.values() for part in example.split("; "))]
    assert len(commands) > 40
    for command in commands:
        verb, *words = re.split(r"\s{3,}", command.partition(" | ")[0])[0].split()[1:]
        known = {option for parameter in main.commands[verb].params for option in parameter.opts} | {"--help"}
        assert {word for word in words if re.fullmatch(r"--[a-z-]+", word)} <= known, command


def test_cheap_examples_run(folder: Path) -> None:
    """Assert that the examples of verbs that march one run, or none, end well, in their order."""
    assert all(succeeds(part) for verb in CHEAP for part in EXAMPLES[verb].split("; "))
    assert (folder / "ball.nc").exists()


@pytest.mark.dear
@pytest.mark.parametrize("kind", DEAR)
def test_dear_examples_run(kind: str, folder: Path) -> None:
    """Assert that the examples of evidence, films and figures end well, in their order."""
    marched()
    assert all(succeeds(part) for verb in DEAR[kind] for part in EXAMPLES[verb].split("; "))
    assert any(folder.glob("*.nc"))


@pytest.mark.dear
def test_the_example_of_a_fit_runs(folder: Path) -> None:
    """Assert that it finds what the record was made with."""
    bench = xd.Model.from_toml(ROOT / "data" / "models" / "bench_pendulum.toml")
    times = np.linspace(0.0, 20.0, 41)
    angles = xd.sample(xd.simulate(bench), times).theta.values
    rows = "".join(f"{t!r},{a!r},0.001\n" for t, a in zip(times.tolist(), angles.tolist(), strict=True))
    (folder / "bench.csv").write_text(f"time [s],theta [rad],u(theta) [rad]\n{rows}")
    assert succeeds(EXAMPLES["fit"])


@pytest.mark.dear
def test_commands_of_pages_run(folder: Path) -> None:
    """Assert that commands in pages, but for those of other machines and stores, end well with files such as they name."""
    (folder / "pendulum.toml").write_text(STARTER)
    (folder / "spring.toml").write_text(SPRING)
    (folder / "ball.toml").write_text(BALL)
    xd.simulate(xd.Model.from_text(BALL), path="run.nc")
    times = np.linspace(0.0, 8.0, 33)
    for name in ("bench", "monday", "tuesday"):
        rows = "".join(f"{t!r},{0.1 * math.cos(2.0 * t)!r},0.001\n" for t in times.tolist())
        (folder / f"{name}.csv").write_text(f"time [s],x [m],u(x) [m]\n{rows}")
    fall = np.sqrt(2.0 / 9.81)
    heard = fall * np.concatenate([[1.0], 1.0 + 2.0 * np.cumsum(0.8 ** np.arange(1, 6))])
    rows = "".join(f"{t!r},0.0002\n" for t in heard.tolist())
    (folder / "clicks.csv").write_text(f"event_time_floor [s],u(event_time_floor) [s]\n{rows}")
    run = [line for line in PRINTED if " -" in line and not any(mark in line for mark in ELSEWHERE)]
    assert len(run) >= 6
    assert all(succeeds(line) for line in run)
