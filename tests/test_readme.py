"""The README: every command in it runs, its example prints what it says, its table is the registry."""

from __future__ import annotations

import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from cases.problems import ROOT
from xdynamics.documenting import guide

README = (ROOT / "README.md").read_text()
BLOCKS = {kind: "".join(re.findall(rf"```{kind}\n(.*?)```", README, re.DOTALL)) for kind in ("python", "sh", "toml")}
RUN = next(line.strip() for line in README.splitlines() if "pip install -q -e . &&" in line)


def commands() -> list[str]:
    """The shell block's lines, the compare of the text below it, and the main job without its set-up."""
    main_job = [part.replace(".venv/bin/", "") for part in RUN.split(" && ")[2:]]
    compare = re.search(r"`(xdynamics compare [^`]+)`", README)
    assert compare
    return [*main_job, *BLOCKS["sh"].strip().splitlines(), compare[1]]


def test_every_command_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """Assert exit code 0 of every command, in order, from one folder; 1 for the compare of unlike runs.

    The main job is run in processes of its own, what follows in this one; but for --whole a certificate with fewer draws,
    and no pipeline, which `test_pipelines` runs.
    """
    (tmp_path / "data").symlink_to(ROOT / "data")
    shutil.copytree(ROOT / "pipelines", tmp_path / "pipelines")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.chdir(tmp_path)
    lines = [shlex.split(command) for command in commands()]
    if not request.config.getoption("--whole"):
        lines = [["2048" if word == "4096" else word for word in line] for line in lines]
    for line in lines[:2]:
        subprocess.run(line, capture_output=True, check=True)
    for line in lines[2:]:
        if line[0] == "python":
            if not request.config.getoption("--whole"):
                continue
            monkeypatch.setattr(sys, "argv", line[1:])
            runpy.run_path(line[1], run_name="__main__")
            continue
        done = call(*line[1:])
        assert done.exit_code == (line[1] == "compare"), f"{line}\n{done.output}"
    made = {entry.name for entry in tmp_path.iterdir()}
    assert {"rocket.nc", "rocket.png", "ball.nc", "ball.svg", "apogee.nc", "study.nc", "balls", "fit.nc"} <= made


def test_example_prints_what_it_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Assert that the comments behind the example's prints are what it prints."""
    (tmp_path / "data").symlink_to(ROOT / "data")
    monkeypatch.chdir(tmp_path)
    exec(compile(BLOCKS["python"], "README", "exec"), {})
    said = re.findall(r"print\(.*\)  # (.*)", BLOCKS["python"])
    assert capsys.readouterr().out.splitlines() == said


def test_the_model_of_ten_lines_bounces_and_rests(tmp_path: Path) -> None:
    """Assert that it has ten lines, that its commands run, impacts, rest and event, and that its picture is there."""
    text = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)[0]
    assert len(text.splitlines()) == 10
    (tmp_path / "first.toml").write_text(text)
    verbs = re.findall(r"`xdynamics (run|plot) (first\.\w+)(.*?)`", README)
    assert [verb for verb, *_ in verbs] == ["run", "plot"]
    for verb, file, options in verbs:
        done = call(verb, tmp_path / file, *(tmp_path / one if one.endswith(".nc") else one for one in options.split()))
        assert done.exit_code == 0, done.output
    run = xd.open_run(tmp_path / "first.nc")
    kinds = run.event_kind.attrs["flag_meanings"].split()
    assert {"impact", "rest", "crossing"} <= {kinds[one] for one in run.event_kind.values}
    assert run.attrs["run_outcome"] == "completed"
    assert (tmp_path / "first.png").stat().st_size > 5_000
    assert (ROOT / "data" / "figures" / "first_model.png").stat().st_size > 5_000
    figure = xd.plot(run, only=["trajectory", "energy"])
    figure.set_layout_engine("none")
    figure.set_dpi(130)  # as it is written; letters are wider there than at 100
    figure.canvas.draw()
    axes = figure.axes[0]
    legend = axes.get_legend()
    assert legend is not None
    assert "floor impact ×36" in [text.get_text() for text in legend.get_texts()]
    boxes = [legend.get_window_extent(), *(text.get_window_extent() for text in axes.texts if text.get_visible())]
    drawn = [axes.transData.transform(line.get_xydata()) for line in axes.lines]
    marks, beside = np.concatenate(drawn[2:]), np.array([5.0, 0.0])  # after the rows and the curve
    for box in boxes:
        assert not any(box.count_contains(points) for points in (*drawn, marks - beside, marks + beside))


def test_methods_are_the_registry() -> None:
    """Assert that every method stands in the table with its order, and no other."""
    table = README.split("## Methods")[1].split("##")[0]
    named = re.findall(r"`(\w+)` (\d)[, ]", table)
    assert sorted(named) == sorted((method.name, str(method.order)) for method in xd.METHODS.values())
    assert len(README.splitlines()) < 200


def test_pages_that_are_named_are_there() -> None:
    """Assert every page of the manual, every link and every picture of the README and of the index of studies."""
    topics = {*re.findall(r"`xdynamics help (\w+)`", README)}
    assert topics <= {*guide.topics()}
    assert len(topics) > 6
    for folder in (ROOT, ROOT / "pipelines"):
        for link in re.findall(r"\]\((?!http)([^)]+)\)", (folder / "README.md").read_text()):
            assert (folder / link).exists(), link
    studies = {path.parent.name for path in (ROOT / "pipelines").glob("*/study.toml")}
    index = (ROOT / "pipelines" / "README.md").read_text()
    assert studies | {"lessons"} == {*re.findall(r"\((\w+)/README.md\)", index)}


def test_the_model_with_dimensions_is_one() -> None:
    """Assert that the README's second model marches, and is selected from by its labels."""
    text = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)[1]
    run = xd.simulate(xd.Model.from_text(text))
    assert run.attrs["run_outcome"] == "completed"
    assert run.r.dims == ("step", "body", "axis")
    far = run.r.sel(body="Jupiter") - run.r.sel(body="Sun")
    assert 5.0 < float((far**2).sum("axis").min()) ** 0.5 < 5.3
    energy = run.total_energy.values
    assert abs(energy[-1] / energy[0] - 1) < 1e-11


def test_prose_is_short_and_has_the_words_of_the_field() -> None:
    """Assert that no sentence has over 30 words, nor one of them the program's own name for its loop."""
    text = re.sub(r"```.*?```|`[^`]*`|^\|.*$|^    .*$|^!\[.*$", "x", README, flags=re.DOTALL | re.MULTILINE)
    sentences = [one for part in text.split("\n\n") for one in re.split(r"(?<=[.:;?])\s", " ".join(part.split()))]
    assert max(len(sentence.split()) for sentence in sentences) <= 30
    assert not re.search(r"\bmarch(es|ed)?\b", text)
