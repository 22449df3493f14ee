"""Panels that one looks at first; legends and names of events where nothing is drawn."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

import xdynamics as xd
from cases.command_line import call
from cases.problems import MODELS
from xdynamics.figures.event_marks import IN_LEGEND
from xdynamics.figures.sheet import EVENT, dense, place_legends_and_names, sheet, write_figure

SHORT = {"rocket_c6": {}, "moving_table": {"until": "1 s"}, "ball_in_box": {}, "block_on_incline": {}}


@pytest.fixture(scope="module")
def figures() -> dict[str, Any]:
    """Figures of short runs with many events, few, and several lines."""
    return {
        name: xd.plot(xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), **more)) for name, more in SHORT.items()
    }


def visible(figure: Any) -> list[Any]:
    return [axes for axes in figure.axes if axes.get_visible()]


@pytest.mark.dear
def test_a_figure_has_four_panels_and_all_if_asked(tmp_path: Path, figures: dict[str, Any]) -> None:
    """Assert motion, drives, fuel of a rocket; motion, contact and energy of a ball on a table; and the rest on request."""
    begins = [[axes.get_title(loc="left").split(",")[0] for axes in visible(figure)] for figure in figures.values()]
    assert begins[0] == ["trajectory", "velocity", "first-order state", "measured drives along the run"]
    assert begins[1] == ["trajectory", "velocity", "contact and friction", "energy"]
    run = xd.simulate(xd.Model.from_toml(MODELS / "rocket_c6.toml"))
    assert len(visible(xd.plot(run, panels="all"))) == 6
    xd.save(run, tmp_path / "run.nc")
    assert call("plot", tmp_path / "run.nc", "--panels", "all").exit_code == 0
    assert (tmp_path / "run.png").stat().st_size > 10_000
    with pytest.raises(xd.InputError, match="panels is 'most'; there are few, all"):
        xd.plot(run, panels="most")


def test_a_figure_is_written_as_it_was_laid_out(
    tmp_path: Path, figures: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Assert that writing makes no other layout, for which names were not placed, and leaves the figure its own."""
    figure = figures["rocket_c6"]
    engine = figure.get_layout_engine()
    with monkeypatch.context() as patched:
        patched.setattr(engine, "execute", lambda _: pytest.fail("laid out anew"))
        write_figure(figure, tmp_path / "a.png")
    assert figure.get_layout_engine() is engine
    assert (tmp_path / "a.png").stat().st_size > 10_000


def test_a_figure_that_a_notebook_shows_is_laid_out_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert one layout for the figure and its picture, one more after a change, and that the picture has the change."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "harmonic_oscillator.toml"), until="1 s")
    counted: list[int] = []
    execute = ConstrainedLayoutEngine.execute
    monkeypatch.setattr(
        ConstrainedLayoutEngine, "execute", lambda engine, figure: counted.append(1) or execute(engine, figure)
    )
    figure = xd.plot(run, only="x")
    shown = figure._repr_png_()
    assert len(counted) == 1
    assert figure._repr_png_() == shown
    figure.axes[0].set_ylabel("a\nlong\nname")
    assert figure._repr_png_() != shown
    assert len(counted) == 2


@pytest.mark.dear
def test_legends_lie_on_no_line(figures: dict[str, Any]) -> None:
    """Assert that no point of a line or needle is under a legend, in the layout that is written."""
    legends = 0
    for figure in figures.values():
        figure.canvas.draw()
        for axes in visible(figure):
            if axes.get_legend() is None:
                continue
            legends += 1
            box = axes.get_legend().get_window_extent()
            for line in axes.lines:
                points = line.get_transform().transform(line.get_xydata())
                points = dense(points) if line.get_linestyle() not in ("None", "") else points
                assert not box.count_contains(points[np.isfinite(points).all(axis=1)])
    assert legends >= 5


@pytest.mark.dear
def test_names_of_events_lie_on_no_other(figures: dict[str, Any]) -> None:
    """Assert that names are inside their axes and near their marks, and that many events are counted in a legend."""
    names = 0
    for figure in figures.values():
        figure.canvas.draw()
        for axes in visible(figure):
            texts = [text for text in axes.texts if text.get_visible() and text.get_gid() == EVENT]
            boxes = [text.get_window_extent() for text in texts]
            names += len(boxes)
            assert not any(a.overlaps(b) for a, b in combinations(boxes, 2))
            for box in boxes:
                assert axes.bbox.x0 - 1 <= box.x0 <= box.x1 <= axes.bbox.x1 + 5
    assert names > 12


def test_many_events_are_counted_in_one_legend(figures: dict[str, Any]) -> None:
    """Assert that the first panel's legend names them, with markers that all panels share, and no other does."""
    first, second = visible(figures["ball_in_box"])[:2]
    labels = [[text.get_text() for text in axes.get_legend().get_texts()] for axes in (first, second)]
    assert labels == [["ceiling impact ×30", "right impact ×10", "floor impact ×30", "left impact ×10"], ["x", "y"]]
    assert [
        sum(line.get_xdata().size for line in axes.lines if line.get_marker() == "v") for axes in (first, second)
    ] == [80, 80]


def test_very_many_events_are_counted_and_not_marked() -> None:
    """Assert that of more than 120 events only those of kinds with 20 at most have marks, and all have their number."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "rocking_block.toml"), until="10 s")
    first, second = visible(xd.plot(run, only=["x", "v_x"]))
    labels = [text.get_text() for text in first.get_legend().get_texts()]
    assert labels[1:3] == ["right impact ×23, not marked", "left takeoff ×23, not marked"]
    assert run.sizes["event"] == 135
    assert second.get_legend() is None
    assert not any(line.get_xdata().size for line in first.lines if line.get_gid() == IN_LEGEND)


@pytest.mark.dear
def test_events_are_marked_on_the_body_that_they_concern() -> None:
    """Assert that marks of a disc that meets a wall lie on its own path, and those of two that meet on one of theirs."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "balls_in_box.toml"), until="1 s")
    walls = run.event_axis.values >= 0
    axes = xd.plot(run, only="r").axes[0]
    kinds = [line for line in axes.lines if line.get_marker() == "v"]
    marks = {(float(t), float(r)) for line in kinds for t, r in zip(line.get_xdata(), line.get_ydata(), strict=True)}
    for n in np.flatnonzero(walls):
        position = run.r.values[run.event_row_before[n], run.event_disc[n], run.event_axis[n]]
        assert (float(run.event_time[n]), float(position)) in marks
    assert walls.any()
    assert len(marks) == walls.size


@pytest.mark.dear
def test_a_legend_without_room_stands_beside_its_axes() -> None:
    """Assert a legend inside where a corner is free, else in the title's line if it has room, else beside the axes."""
    figure = Figure(figsize=(11, 8), layout="constrained")
    full, half, titled, many = figure.subplots(2, 2).flat
    x = np.linspace(0.0, 1.0, 4000)
    full.plot(x, np.sin(1e3 * x), label="everywhere")
    titled.plot(x, np.sin(1e3 * x), label="everywhere")
    titled.set_title("a title that leaves its line no room for more words than it has itself", loc="left")
    for k in range(6):
        many.plot(x, np.sin(1e3 * x + k), label=f"number {k}")
    half.plot(x, x, label="along the diagonal")
    for axes in figure.axes:
        axes.legend()
    place_legends_and_names(figure)
    figure.canvas.draw()
    above = full.get_legend().get_window_extent()
    assert above.y0 >= full.bbox.y1
    assert above.x1 <= full.bbox.x1 + 1
    for axes in (titled, many):
        assert axes.get_legend().get_window_extent().x0 >= axes.bbox.x1
    assert half.get_legend().get_window_extent().x1 <= half.bbox.x1


def test_many_kinds_are_counted() -> None:
    """Assert that of nine kinds of events six have names, and the others a number."""
    model = xd.Model(
        name="marks",
        coordinates={"x": "m"},
        mass={"x": "1*kilogram"},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={f"mark{k}": {"function": f"x - {k}*metre", "action": "record"} for k in range(1, 10)},
    )
    run: xr.Dataset = xd.simulate(model, method="rk4", step="0.1 s", until="10 s")
    texts = [text.get_text() for text in xd.plot(run, only="x").axes[0].texts]
    assert texts == [*(f"mark{k}" for k in range(1, 7)), "and 3 more kinds"]


def test_long_titles_are_broken_into_lines() -> None:
    """Assert that of four panels those with long titles have two lines or more, within their half of the sheet."""
    long = "angular_momentum_of_the_nucleus, second run minus first; scale 1.5e-08 astronomical_unit2 Julian_year-1"
    titles = ["short", long, long, f"{long}; and {long}"]

    def panel(title: str) -> Any:
        def draw(axes: Any) -> None:
            axes.plot([0, 1], [0, 1])
            axes.set_title(title, loc="left", fontsize=10)

        return draw

    figure = sheet([panel(title) for title in titles], "sheet", "foot")
    shown = [axes._left_title for axes in figure.axes]
    assert [text.get_text().replace("\n", " ") for text in shown] == titles
    assert shown[0].get_text() == "short"
    width = figure.bbox.width
    ends = [text.get_window_extent().x1 for text in shown]
    assert all("\n" in text.get_text() for text in shown[1:])
    assert all(end <= part * width for end, part in zip(ends, (0.5, 1.0, 0.5, 1.0), strict=True))
