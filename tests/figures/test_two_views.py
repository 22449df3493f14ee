"""Films of motion in three dimensions: two views of one scale that share an axis."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import xdynamics as xd
from xdynamics.figures.bodies_scene import TwoViews
from xdynamics.figures.scenes import scene_of
from xdynamics.record import unfold


def filmed(model: xd.Model) -> TwoViews:
    """The scene of a short run."""
    scene = scene_of(unfold(xd.simulate(model, method="rk4", step="20 ms", until="0.4 s")), None)
    assert isinstance(scene, TwoViews)
    return scene


def balls(stiffness: float = 9.0, **more: Any) -> xd.Model:
    """Two balls in a round bowl over a floor, tied by a spring."""
    start = {"r": [["-0.3 m", "0 m", "0.4 m"], ["0.3 m", "0 m", "0.4 m"]]}
    return xd.Model(
        name="two balls",
        dimensions={"ball": 2, "axis": ["x", "y", "z"]},
        relations={"pair": {"of": "ball", "neighbours": 1}},
        coordinates={"r": {"unit": "m", "dims": ["ball", "axis"]}},
        parameters={
            "R": {"dims": ["ball"], "value": [0.15, 0.15], "unit": "m"},
            "up": {"dims": ["axis"], "value": [0, 0, 1]},
        },
        mass={"r": "1*kilogram"},
        forces={
            "spring": {
                "over": "pair",
                "potential": f"{stiffness}*(norm(second(r, pair) - first(r, pair), axis) - 0.5*metre)**2*newton/metre",
            }
        },
        contacts={
            "floor": {"gap": "sum(r*up, axis) - R", "restitution": 1.0},
            "bowl": {"gap": "2*metre - R - norm(r, axis)", "restitution": 1.0},
            "balls": {
                "gap": "norm(second(r, pair) - first(r, pair), axis) - first(R, pair) - second(R, pair)",
                "restitution": 1.0,
            },
        },
        initial=start | {"v_r": [["0 m s-1", "-0.6 m s-1", "0.1 m s-1"], ["0 m s-1", "0.6 m s-1", "0.1 m s-1"]]} | more,
    )


def test_both_views_show_each_body_where_it_is_at_one_scale() -> None:
    """Assert places in x, z above and x, y below at any time, the axis across in common, and equal scales."""
    run = xd.simulate(balls(), method="rk4", step="20 ms", until="0.4 s")
    scene = scene_of(unfold(run), None)
    assert isinstance(scene, TwoViews)
    assert scene.is_stacked
    figure = Figure(figsize=scene.size)
    scene.start(figure.subplots())
    scene.move_to(float(run.time[-1]))
    front, plan = figure.axes
    for view, pair, axes in zip(scene.views, (("x", "z"), ("x", "y")), (front, plan), strict=True):
        discs = next(item for item in axes.collections if type(item).__name__ == "EllipseCollection")
        wanted = run.r.sel(axis=list(pair)).isel(step=-1).values
        assert discs.get_offsets() == pytest.approx(wanted, abs=1e-9)
        assert view.radii == pytest.approx([0.15, 0.15], rel=1e-9)
        assert axes.get_aspect() == 1.0
    assert front.get_xlim() == plan.get_xlim()
    assert (front.get_ylabel(), plan.get_ylabel(), plan.get_xlabel()) == ("r[z] (m)", "r[y] (m)", "r[x] (m)")
    assert front.get_xlabel() == ""


def test_walls_are_in_the_view_that_can_show_them_and_others_are_named() -> None:
    """Assert that a floor is in the view with z, that a bowl is in none, and that the title says so."""
    scene = filmed(balls())
    assert [[wall.contact for wall in view.boundaries] for view in scene.views] == [["floor"], []]
    assert scene.start(Figure(figsize=scene.size).subplots()) == "; not drawn: bowl"


def test_a_link_that_only_turns_is_a_bar() -> None:
    """Assert that lengths in space, not those seen, tell bars from springs: here one turns about the vertical, and one swells."""
    turning = {"r": [["-0.25 m", "0 m", "0.4 m"], ["0.25 m", "0 m", "0.4 m"]]}
    kinds = [[view.fastenings[0].kind for view in filmed(model).views] for model in (balls(900.0, **turning), balls())]
    assert kinds == [["lines"] * 2, ["springs"] * 2]


@pytest.mark.parametrize(
    ("along", "wanted", "stacked"),
    [
        ("x", [("x", "z"), ("x", "y")], True),
        ("y", [("x", "y"), ("z", "y")], False),
        ("z", [("x", "z"), ("y", "z")], False),
    ],
)
def test_views_share_the_longest_side(along: str, wanted: list[tuple[str, str]], stacked: bool) -> None:
    """Assert which two views there are, and that the fixed scale of their common axis is the same."""
    speed = {"v_x": "1 m s-1", "v_y": "1.1 m s-1", "v_z": "0.9 m s-1"} | {f"v_{along}": "5 m s-1"}
    thrown = xd.Model(
        name="thrown",
        coordinates=dict.fromkeys("xyz", "m"),
        mass=dict.fromkeys("xyz", "1*kilogram"),
        forces={"weight": {"z": "-1*newton"}},
        initial=dict.fromkeys("xyz", "0 m") | speed,
    )
    scene = filmed(thrown)
    assert [(view.view[0].across, view.view[0].up) for view in scene.views] == wanted
    assert scene.is_stacked is stacked
    shared = 0 if stacked else 1
    assert np.array_equal(scene.views[0].limits[shared], scene.views[1].limits[shared])
