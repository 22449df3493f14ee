"""A panel on axes of a figure that is somebody else's."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

import xdynamics as xd
from cases.problems import MODELS

BALL = xd.Model.from_toml(MODELS / "ball_drag.toml")


def test_panels_of_runs_and_evidence_are_drawn_on_axes() -> None:
    """Assert the panel that is named, with its labels, beside that of a refinement, in the one figure."""
    figure = Figure()
    left, right = figure.subplots(1, 2)
    run = xd.simulate(BALL, rtol=1e-6)
    assert xd.plot(run, ax=left, only="energy") is figure
    assert left.get_title(loc="left").startswith("energy")
    assert left.get_xlabel() == "time (s)"
    study = xd.refine(BALL, method="midpoint", steps=["40 ms", "20 ms", "10 ms"], until="1 s")
    run.dynamics.plot(ax=left, only="y")
    assert xd.plot(study, ax=right) is figure
    assert right.get_xscale() == "log"
    assert len(figure.axes) == 2


def test_what_is_of_a_new_figure_is_refused(tmp_path: Path) -> None:
    """Assert an error for a path, a size, and what is no axes."""
    run = xd.simulate(BALL, rtol=1e-6)
    axes = Figure().subplots()
    cases: list[tuple[dict[str, Any], str]] = [
        ({"ax": axes, "path": tmp_path / "a.png"}, "path and size are of a figure that is made here"),
        ({"ax": axes, "size": (8, 5)}, "path and size are of a figure"),
        ({"ax": 3}, "ax is 3, needs axes of matplotlib"),
    ]
    for asked, words in cases:
        with pytest.raises(xd.InputError, match=words):
            xd.plot(run, **asked)
    assert not [*tmp_path.iterdir()]
