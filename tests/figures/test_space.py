"""Figures in three dimensions and of fields over two: what is drawn are the numbers of the record."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.figures.plane import spaces, views
from xdynamics.figures.run import panels_of
from xdynamics.figures.scenes import scene_of
from xdynamics.figures.sheet import sheet
from xdynamics.record import unfold

SPRINGS = """
name = "two bodies on springs"
[dimensions]
body = ["a", "b"]
axis = ["x", "y", "z"]
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
m = "1 kg"
k = { dims = ["axis"], value = [1, 4, 9], unit = "N m-1" }
[mass]
r = "m"
[forces.springs]
r = "-k*r"
[initial]
r = { unit = "m", value = [[1, 0.5, 0.2], [-1, 0.7, 0.3]] }
v_r = { unit = "m s-1", value = [[0, 1, 0], [0.5, 0, 1]] }
[run]
method = "rk4"
step = "0.05 s"
until = "6 s"
"""
PLATE = """
name = "cooling plate"
[dimensions]
across = 7
up = 8
[parameters]
D = "0.1 s-1"
[states.T]
unit = "K"
dims = ["across", "up"]
rate = "D*(shift(T, across, 1, 0*kelvin) + shift(T, across, -1, 0*kelvin) - 2*T)"
[initial]
T = "(8*index(across) + index(up))*kelvin"
[run]
method = "heun"
step = "0.1 s"
until = "0.2 s"
"""


def drawn(run: Any, kind: str) -> Any:
    """The sheet of the panels of one kind."""
    return sheet(panels_of(unfold(run), [kind]), "title", "foot")


def test_orbits_are_drawn_in_space() -> None:
    """Assert that each body has its path in three dimensions, its name in a legend, and one scale on all axes."""
    run = xd.simulate(xd.Model.from_text(SPRINGS))
    (bodies,) = spaces(views(unfold(run)))
    for path, body in zip(bodies, "ab", strict=True):
        assert path.body == body
        ends = path.points[:, [0, -1]].T
        assert (ends == run.r.sel(body=body).values[[0, -1]]).all()
    (axes,) = [each for each in drawn(run, "space").axes if each.get_visible()]
    assert axes.name == "3d"
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["a", "b"]
    assert (axes.get_xlabel(), axes.get_zlabel()) == ("r[x]", "r[z]")
    assert "in m" in axes.get_title(loc="left")
    paths = [np.array(line.get_data_3d()) for line in axes.lines if line.get_linestyle() == "-"]
    assert [path.shape[0] for path in paths] == [3, 3]
    assert (paths[1][:, -1] == run.r.sel(body="b").values[-1]).all()


def test_a_field_over_two_dimensions_is_maps_at_three_times() -> None:
    """Assert the states at the start, halfway and at the end, the first dimension across, one scale with its unit."""
    run = xd.simulate(xd.Model.from_text(PLATE))
    figure = xd.plot(run)
    first, middle, last = maps = [axes for axes in figure.axes if axes.get_visible()]
    for axes, row, moment in zip(maps, (0, 1, 2), ("0 s", "0.1 s", "0.2 s"), strict=True):
        assert (np.asarray(axes.collections[0].get_array()) == run["T"].values[row].T).all()
        assert axes.collections[0].get_clim() == (run["T"].min(), run["T"].max())
        assert axes.get_title().strip() == f"t = {moment}"
    figure.canvas.draw()
    lefts = [axes.get_position().x0 for axes in maps]
    assert lefts[1] - lefts[0] == pytest.approx(lefts[2] - lefts[1], rel=0.05)
    assert [text.get_text() for text in first.texts] == ["T over across and up, at recorded states"]
    assert (middle.get_xlabel(), first.get_ylabel()) == ("across, counted from 0", "up, counted from 0")
    assert last.child_axes[0].get_ylabel() == "T (K)"
    by_kind = xd.plot(run, only="state")
    assert len([axes for axes in by_kind.axes if axes.get_visible()]) == 3
    assert len(xd.plot(run, only="T[3, 4]").axes) == 1


def test_a_field_of_both_signs_has_colours_that_part_at_zero() -> None:
    """Assert one scale with zero in its middle for all times of a field that is not positive."""
    figure = xd.plot(xd.simulate(xd.Model.from_text(PLATE.replace("8*index(across)", "8*index(across) - 20"))))
    (limits,) = {axes.collections[0].get_clim() for axes in figure.axes}
    assert limits[0] == -limits[1] < 0.0


@pytest.mark.dear
def test_colours_part_at_zero_for_values_of_both_signs_alone() -> None:
    """Assert two colours of equal reach for a chain that swings, and one scale from least to greatest for heat."""
    chain = xd.plot(xd.simulate(xd.Model.from_toml(MODELS / "toda_chain.toml"), until="2")).axes[0].collections[0]
    assert chain.get_clim()[0] == -chain.get_clim()[1] < 0.0
    rod = xd.plot(xd.simulate(xd.Model.from_toml(MODELS / "heat.toml"), until="500 s"), only="T").axes[0].collections[0]
    assert rod.get_clim() == (rod.get_array().min(), rod.get_array().max())
    assert rod.get_cmap().name != chain.get_cmap().name


def test_a_field_over_two_dimensions_is_a_film_of_maps() -> None:
    """Assert what a film draws of a field between two rows: straight in time, on one scale with its unit."""
    run = xd.simulate(xd.Model.from_text(PLATE))
    scene = scene_of(unfold(run).copy(deep=False), None)
    assert scene is not None
    (axes,) = xd.plot(run, only="T[3, 4]").axes
    axes.clear()
    assert scene.start(axes) == ", T over across and up"
    (mesh,) = scene.move_to(0.05)
    expected = (run["T"].values[0] + run["T"].values[1]).T / 2.0
    assert np.allclose(np.asarray(mesh.get_array()), expected, rtol=1e-14, atol=0.0)
    assert mesh.get_clim() == (run["T"].min(), run["T"].max())
    assert axes.child_axes[0].get_ylabel() == "T (K)"
