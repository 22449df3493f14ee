"""The README: every command in it runs, its example prints what it says, its table is the registry."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

import xdynamics as xd
from cases.problems import ROOT

README = (ROOT / "README.md").read_text()
BLOCKS = {kind: "".join(re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL)) for kind in ("python", "sh", "toml")}
RUN = next(line.strip() for line in README.splitlines() if "pip install -q -e . &&" in line)


def commands() -> list[str]:
    """The shell block's lines, the compare of the text below it, and the main job without its set-up."""
    main_job = [part.replace(".venv/bin/", "") for part in RUN.split(" && ")[2:]]
    compare = re.search(r"`(xdynamics compare [^`]+)`", README)
    assert compare
    return [*main_job, *BLOCKS["sh"].strip().splitlines(), compare[1]]


def test_every_command_runs(tmp_path: Path) -> None:
    """Assert exit code 0 of every command, in order, from one folder; 1 for the compare of unlike runs."""
    for name in ("data", "pipelines"):
        (tmp_path / name).symlink_to(ROOT / name)
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for command in commands():
        done = subprocess.run(
            shlex.split(command),
            cwd=tmp_path,
            env=os.environ | {"PATH": path},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == (1 if " compare " in command else 0), f"{command}\n{done.stdout}{done.stderr}"
    made = {one.name for one in tmp_path.iterdir()}
    assert {"rocket.nc", "rocket.png", "ball.nc", "ball.svg", "results"} <= made


def test_example_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Assert that the comments behind the example's prints are what it prints."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS["python"], "README", "exec"), {})
    said = re.findall(r"print\(.*\)  # (.*)", BLOCKS["python"])
    assert capsys.readouterr().out.splitlines() == said


def test_the_whole_model_is_one() -> None:
    """Assert that the README's model runs, breaks loose, and is stopped by its edge or rests."""
    text = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)[0]
    run = xd.simulate(xd.Model.from_text(text))
    kinds = run.event_kind.attrs["flag_meanings"].split()
    assert {"impact", "rest", "slip", "stick"} <= {kinds[one] for one in run.event_kind.values}
    assert run.attrs["run_outcome"] in ("completed", "stopped_by_event")


def test_methods_table_is_the_registry() -> None:
    """Assert that name, order, symplecticity and evaluations in the table are the methods' own."""
    rows = re.findall(r"^\| `(\w+)` \| (\d) \| (yes|no) \| (\d+) \|", README, re.MULTILINE)
    assert rows == [
        (one.name, str(one.order), "yes" if one.symplectic else "no", str(one.evaluations))
        for one in xd.METHODS.values()
    ]
    assert len(README.splitlines()) < 300
