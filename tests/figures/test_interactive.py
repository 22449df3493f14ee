"""Interactive figures: the same panels, lines and names as the picture, in one page that asks nothing of a network."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.figures.sheet import Picture


@pytest.fixture(scope="module")
def ball() -> Any:
    """A ball that bounces for a second."""
    return xd.simulate(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), until="1 s")


def traces_of(shown: Any, axis: str) -> list[Any]:
    """The traces of a panel."""
    return [trace for trace in shown.figure.data if getattr(trace, "xaxis", None) == axis]


@pytest.mark.dear
def test_lines_have_the_values_of_the_record(ball: Any) -> None:
    """Assert values, units, titles, marks and names of events in the panels of a run."""
    shown = xd.plot(ball, only=["y", "v_y"]).interactive()
    line, *marks = traces_of(shown, "x")
    assert (line.x.min(), line.x.max(), line.y.max()) == (0.0, 1.0, float(ball.y.max()))
    assert np.isin(line.y, ball.y.values).all()
    assert shown.figure.layout.yaxis2.title.text == "v_y (m s⁻¹)"
    impact = next(mark for mark in marks if mark.mode == "markers")
    assert impact.marker.symbol == "triangle-down"
    assert impact.x[0] == pytest.approx(np.sqrt(2 / 9.81), rel=1e-3)
    assert {"floor impact", "y", "v_y"} & {note.text for note in shown.figure.layout.annotations}


@pytest.mark.dear
def test_scales_words_maps_and_lines_in_space_are_kept() -> None:
    """Assert logarithmic and inverted axes, words at ticks, bands and bars, cells of a map, and lines in space."""
    drawn = Picture(figsize=(8, 8))
    logarithmic, words, cells = (drawn.add_subplot(2, 2, place) for place in (1, 2, 3))
    logarithmic.loglog([1.0, 100.0], [1e-3, 1e-1], "--", label="error")
    logarithmic.axhline(1e-2)
    words.barh([0, 1], [2.0, 3.0])
    words.set_yticks([0, 1], ["vt", "g"])
    words.invert_yaxis()
    cells.pcolormesh([1.0, 2.0, 4.0], [0.0, 1.0], [[5.0, 6.0, 7.0], [8.0, 9.0, np.nan]], shading="nearest")
    drawn.add_subplot(2, 2, 4, projection="3d").plot([0.0, 1.0], [0.0, 2.0], [0.0, 3.0])
    figure = drawn.interactive().figure
    layout, (line, rule) = figure.layout, traces_of(drawn.interactive(), "x")
    assert (layout.xaxis.type, line.name, line.line.dash) == ("log", "error", "dash")
    assert layout.xaxis.range[0] < 0.0 < 2.0 < layout.xaxis.range[1] < 3.0
    assert rule.y == pytest.approx([1e-2, 1e-2])
    assert (layout.yaxis2.ticktext, layout.yaxis2.range[0] > layout.yaxis2.range[1]) == (("vt", "g"), True)
    bars = traces_of(drawn.interactive(), "x2")
    assert [np.nanmax(bar.x) for bar in bars] == pytest.approx([2.0, 3.0])
    (heat,) = traces_of(drawn.interactive(), "x3")
    assert np.array_equal(heat.z, [[5.0, 6.0, 7.0], [8.0, 9.0, np.nan]], equal_nan=True)
    (space,) = (trace for trace in figure.data if trace.type == "scatter3d")
    assert space.z[-1] == 3.0


@pytest.mark.dear
def test_what_was_changed_by_hand_is_laid_out_anew(ball: Any) -> None:
    """Assert that a figure that was drawn and then changed is drawn once more, and one that was not stays as it is."""
    drawn = xd.plot(ball, only=["y"])
    drawn._repr_png_()
    before = drawn.interactive().figure.layout.yaxis.domain
    assert drawn.interactive().figure.layout.yaxis.domain == pytest.approx(before, abs=1e-9)
    drawn.axes[0].set_title("dropped\nby hand\nfrom a metre")
    after = drawn.interactive().figure.layout.yaxis.domain
    assert after[1] < before[1] - 0.05
    drawn.draw_without_rendering()
    assert after[1] == pytest.approx(drawn.axes[0].get_position().y1, abs=1e-12)


@pytest.mark.dear
def test_a_map_keeps_its_colours_scale_and_its_contours() -> None:
    """Assert the scale beside the map as a panel of its own, with its label and the map's colours, and lines of equal value."""
    drawn = Picture(figsize=(6, 4))
    axes = drawn.add_subplot()
    x, y = np.linspace(0.0, 2.0, 7), np.linspace(0.0, 1.0, 6)
    mesh = axes.pcolormesh(x, y, np.add.outer(y, x), shading="nearest")
    bar = drawn.colorbar(mesh, cax=axes.inset_axes((1.02, 0.0, 0.03, 1.0)))
    bar.set_label("sum (m)")
    axes.contour(x, y, np.add.outer(y, x), levels=[1.0])
    figure = drawn.interactive().figure
    (cells, level), (scale, *_) = (traces_of(drawn.interactive(), axis) for axis in ("x", "x2"))
    assert (level.mode, np.nanmax(np.abs(level.x + level.y - 1.0)) < 1e-12) == ("lines", True)
    assert (scale.type, figure.layout.yaxis2.title.text, figure.layout.yaxis2.side) == ("heatmap", "sum (m)", "right")
    assert figure.layout.xaxis2.domain[0] > figure.layout.xaxis.domain[1]
    assert (scale.zmin, scale.zmax, scale.colorscale) == (cells.zmin, cells.zmax, cells.colorscale)
    assert [scale.z.min(), scale.z.max()] == pytest.approx([0.0, 3.0], abs=0.02)


@pytest.mark.dear
def test_a_page_asks_nothing_of_a_network(ball: Any, tmp_path: Path) -> None:
    """Assert one file with plotly.js in it, no source elsewhere, hostile titles as text, and a part of it for a notebook."""
    hostile = xd.plot(ball.assign_attrs(title="<script>alert(1)</script> $x$"), tmp_path / "ball.html")
    page = (tmp_path / "ball.html").read_text()
    assert page.startswith("<!doctype html>")
    assert not re.search(r"<(script|link)[^>]+(src|href)=", page)
    assert "plotly.js v" in page
    assert "<script>alert" not in page
    part = hostile.interactive()._repr_html_()
    assert part.startswith("<div")
    assert 4e6 < len(part) < 6e6


def test_without_plotly_the_extra_is_named(ball: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Assert the remedy, and no file."""
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    with pytest.raises(xd.InputError, match=r"needs the package plotly: pip install 'xdynamics\[interactive\]'"):
        xd.plot(ball, tmp_path / "ball.html")
    assert not [*tmp_path.iterdir()]
