"""Pictures of bodies that are joined: rods and springs in the plane, forces of constraints, names in films."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.figures.scenes import scene_of

PENDULUM = xd.Model(
    name="pendulum on a rod",
    coordinates={"x": "m", "y": "m"},
    parameters={"m": "2 kg", "l": "0.5 m", "g": "9.81 m s-2"},
    mass={"x": "m", "y": "m"},
    forces={"weight": {"potential": "m*g*y"}},
    constraints={"rod": {"holds": "(x**2 + y**2 - l**2)/(2*l)"}},
    initial={"x": "0.5 m", "y": "0 m"},
    figure={"plane": [["x", "y"], ["0*metre", "0.6*metre"]], "bodies": ["bob", "hook"], "links": [["origin", "bob"]]},
)


def test_multipliers_bend_between_rows() -> None:
    """Assert -3 m g y/l of a pendulum let go level, at all points of a line with several to a step."""
    run = xd.simulate(PENDULUM, method="dop853", rtol=1e-10, until="1 s")
    (axes,) = (one for one in xd.plot(run, only=["constraint"]).axes if one.get_visible())
    times, drawn = (np.asarray(values) for values in axes.lines[-1].get_data())
    assert axes.get_title(loc="left") == "multipliers of constraints"
    assert times.size > 5 * run.sizes["step"]
    expected = 3.0 * 2.0 * 9.81 * xd.sample(run, times).y.values / 0.5
    assert np.abs(drawn - expected).max() < 1e-7 * np.abs(expected).max()


def test_joints_are_drawn_where_the_motion_starts() -> None:
    """Assert the rod of a pendulum and the six bars of a truss as lines between the dots of the start."""
    axes = xd.plot(xd.simulate(PENDULUM, method="dop853", rtol=1e-8, until="0.1 s"), only=["plane"]).axes[0]
    assert axes.get_title(loc="left").startswith("the plane (dots and grey lines: start")
    assert np.array_equal(axes.lines[0].get_xydata(), [[0.0, 0.0], [0.5, 0.0]])
    run = xd.simulate(xd.Model.from_toml(MODELS / "truss.toml"), until="0.2 s")
    bars = [line.get_xydata() for line in xd.plot(run, only=["plane"]).axes[0].lines[: run.sizes["bar"]]]
    ends = run.r.values[0][np.stack([run.bar_first.values, run.bar_second.values], axis=1)]
    assert np.array_equal(bars, ends)


def test_positions_that_hardly_change_are_drawn_less_their_start() -> None:
    """Assert that a truss's map has the millimetres by which it sags, and not the metres between its joints."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "truss.toml"), until="0.2 s")
    axes = xd.plot(run, only=["trajectory"]).axes[0]
    assert axes.get_title(loc="left") == "trajectory less its start, 8 rows, one per joint and axis"
    assert axes.child_axes[0].get_ylabel() == "r - r(0) (m)"
    moved = np.abs(run.r.values - run.r.values[0]).max()
    assert axes.collections[0].get_clim() == pytest.approx((-moved, moved), rel=1e-2)


def test_films_name_their_bodies() -> None:
    """Assert a legend with each body in its colour, and none of a single one."""
    run = xd.simulate(PENDULUM, method="dop853", rtol=1e-8, until="0.1 s")
    scene, axes = scene_of(run, None), Figure().subplots()
    assert scene is not None
    scene.start(axes)
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["bob", "hook"]
    alone = scene_of(xd.simulate(xd.Model.from_toml(MODELS / "kepler.toml"), until="1 s"), None)
    assert alone is not None
    alone.start(axes := Figure().subplots())
    assert axes.get_legend() is None
