"""Walls, floors and discs of films, as the gaps of contacts have them, and bodies that share one line."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import EllipseCollection
from matplotlib.figure import Figure

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.figures.bodies_scene import BodiesScene
from xdynamics.figures.scenes import scene_of
from xdynamics.record import unfold


def filmed(name: str, **asked: Any) -> BodiesScene:
    """The scene of a model of data/models."""
    scene = scene_of(unfold(xd.simulate(xd.Model.from_toml(MODELS / f"{name}.toml"), **asked)), None)
    assert isinstance(scene, BodiesScene)
    return scene


def lines_of(scene: BodiesScene) -> list[np.ndarray]:
    """The corners of what a scene draws where gaps close."""
    axes = Figure(figsize=scene.size).subplots()
    scene.start(axes)
    contours = [item for item in axes.collections if type(item).__name__ == "QuadContourSet" and not item.filled]
    return [path.vertices for item in contours for path in item.get_paths() if len(path.vertices)]


def test_discs_have_their_radii_and_the_box_its_walls() -> None:
    """Assert that pairs of gaps tell three radii, and that discs of two sizes meet the same four walls, from 0 to 1 by 0.8 m."""
    scene = filmed("balls_in_box", until="20 ms")
    assert scene.radii == pytest.approx([0.1, 0.15, 0.1], rel=1e-12)
    walls = []
    for wall in scene.boundaries:
        at_corner, across, up = wall.gap.values_at(np.array([[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]]), 0.0) + wall.radius
        walls.append((across - at_corner, up - at_corner, at_corner))
    assert np.array(sorted(walls)) == pytest.approx(
        np.array([(-1.0, 0.0, 1.0), (0.0, -1.0, 0.8), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)]), abs=1e-12
    )


def test_two_corners_meet_one_floor() -> None:
    """Assert that the gaps of a block's corners, which its figure shows as heights, are one floor at 0; and its four edges."""
    scene = filmed("rocking_block", until="10 ms")
    (floor,) = lines_of(scene)
    assert floor[:, 1] == pytest.approx(np.zeros(len(floor)), abs=1e-12)
    assert [len(part.ends) for part in scene.fastenings] == [4]


def test_two_masses_move_on_one_line() -> None:
    """Assert four bodies of which the walls stand, three springs, no plane among the panels; and that x1, x2 are not a plane."""
    model = xd.Model.from_toml(MODELS / "coupled_masses.toml")
    run = xd.simulate(model, until="1 s")
    scene = scene_of(run, None)
    assert isinstance(scene, BodiesScene)
    assert [body.is_fixed for body in scene.view] == [True, False, False, True]
    assert [len(part.ends) for part in scene.fastenings] == [3]
    assert not any("plane" in axes.get_title(loc="left") for axes in xd.plot(run).axes)
    text = (MODELS / "coupled_masses.toml").read_text()
    bare = xd.Model.from_text(text[: text.index("[figure]")] + text[text.index("[run]") :])
    plain = scene_of(xd.simulate(bare, until="1 s"), None)
    assert isinstance(plain, BodiesScene)
    assert [(body.across, body.body, float(np.ptp(body.y))) for body in plain.view] == [("x", "x1", 0), ("x", "x2", 0)]


def pair_of_balls(gap: str) -> xr.Dataset:
    """Two balls with coordinates of their own, under a floor each that is one."""
    names = ("x_a", "y_a", "x_b", "y_b")
    return xd.simulate(
        xd.Model(
            name="pair",
            coordinates=dict.fromkeys(names, "cm"),
            parameters={"r": "2 cm", "w": "1 m"},
            mass=dict.fromkeys(names, "1*kilogram"),
            initial=dict(zip(names, ("0 cm", "30 cm", "10 cm", "50 cm"), strict=True)) | {"v_x_a": "5 cm s-1"},
            contacts={
                "floor_a": {"gap": "y_a - r", "restitution": 1.0},
                "floor_b": {"gap": "y_b - r", "restitution": 1.0},
                "drum": {"gap": "w - r - hypot(x_a, y_a)", "restitution": 1.0},
                "balls": {"gap": gap, "restitution": 1.0},
            },
            figure={"plane": [["x_a", "y_a"], ["x_b", "y_b"]]},
        ),
        method="rk4",
        step="10 ms",
        until="0.1 s",
    )


@pytest.mark.parametrize(
    ("gap", "radii", "floor"),
    [("hypot(x_b - x_a, y_b - y_a) - 2*r", [0.02, 0.02], 0.0), ("hypot(x_b - x_a, y_b - y_a)**2/w - r", [], 0.02)],
)
def test_two_balls_of_a_model_in_centimetres(gap: str, radii: list[float], floor: float) -> None:
    """Assert discs of 2 cm on a floor at 0 within a drum of 1 m; and dots where a gap is no distance less radii."""
    scene = scene_of(pair_of_balls(gap), None)
    assert isinstance(scene, BodiesScene)
    assert scene.radii == pytest.approx(radii, rel=1e-9)
    round_radius = scene.boundaries[-1].radius + float(scene.boundaries[-1].gap.values_at(np.zeros((1, 2, 1)), 0.0)[0])
    assert round_radius == pytest.approx(1.0 if radii else 0.98, rel=1e-12)
    level = [line[:, 1] for line in lines_of(scene) if np.ptp(line[:, 1]) < 1e-9]
    assert len(level) <= 1
    assert all(line == pytest.approx(np.full(len(line), floor), abs=1e-9) for line in level)
    assert len(scene.boundaries) == 2


def test_pictures_have_discs_as_large_as_they_are() -> None:
    """Assert rings where three discs start and discs where they end, of their radii, no dots, and limits that hold both."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "balls_in_box.toml"), until="0.1 s")
    axes = xd.plot(run, only="plane").axes[0]
    rings, discs = (part for part in axes.collections if isinstance(part, EllipseCollection))
    for part, row in ((rings, 0), (discs, -1)):
        assert part.get_widths() == pytest.approx([0.2, 0.3, 0.2], rel=1e-12)
        assert part.get_offsets() == pytest.approx(run.r.values[row], abs=1e-12)
    assert axes.get_title(loc="left").startswith("the plane (rings: start, discs: end)")
    assert not any(line.get_marker() == "o" for line in axes.lines)
    low, high = axes.get_ylim()
    heights = run.r.sel(axis="y").values[[0, -1]]
    assert low <= (heights - run.radius.values).min()
    assert high >= (heights + run.radius.values).max()


APART = """
name = "discs between walls, and a chain of balls"
[dimensions]
disc = 3
[relations.pair]
of = "disc"
[relations.next]
of = "disc"
neighbours = 1
[coordinates]
x = { unit = "m", dims = ["disc"] }
y = { unit = "m", dims = ["disc"] }
[parameters]
radius = { dims = ["disc"], value = [0.1, 0.15, 0.12], unit = "m" }
[mass]
x = "1*kilogram"
y = "1*kilogram"
[contacts.floor]
gap = "y - radius"
restitution = 1
[contacts.discs]
gap = "hypot(second(x, pair) - first(x, pair), second(y, pair) - first(y, pair)) - first(radius, pair) - second(radius, pair)"
restitution = 1
[initial]
x = { unit = "m", value = [0.2, 0.5, 0.8] }
y = { unit = "m", value = [0.2, 0.5, 0.2] }
v_x = { unit = "m s-1", value = [0.9, -0.2, -0.6] }
v_y = { unit = "m s-1", value = [0.3, 0.1, 0.5] }
"""


def test_coordinates_called_as_axes_are_positions_of_bodies() -> None:
    """Assert that x and y of discs are drawn as one vector is: discs of their radii in the plane, a floor, and their links."""
    run = xd.simulate(xd.Model.from_text(APART), method="rk4", step="10 ms", until="0.1 s")
    axes = xd.plot(run, only="plane").axes[0]
    _, discs = (part for part in axes.collections if isinstance(part, EllipseCollection))
    assert discs.get_widths() == pytest.approx([0.2, 0.3, 0.24], rel=1e-12)
    assert discs.get_offsets() == pytest.approx(np.stack([run.x.values[-1], run.y.values[-1]], axis=-1), abs=1e-12)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")
    scene = scene_of(unfold(run), None)
    assert isinstance(scene, BodiesScene)
    assert [path.label for path in scene.view] == ["disc 0", "disc 1", "disc 2"]
    assert [part.ends.tolist() for part in scene.fastenings] == [[[0, 1], [1, 2]]]
    (floor,) = lines_of(scene)
    assert floor[:, 1] == pytest.approx(np.zeros(len(floor)), abs=1e-12)


def test_discs_that_fall_straight_are_seen_in_the_plane() -> None:
    """Assert that the picture of a box of discs, none of which moves across yet, shows the plane, and says what it leaves out."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "granular_box.toml"), until="20 ms")
    figure = xd.plot(run)
    assert figure.axes[0].get_title(loc="left").startswith("the plane")
    assert '4 of 6 panels; with --panels all (panels="all") also 2 of velocity' in figure.get_supxlabel()
    staged = xd.simulate(xd.Model.from_toml(MODELS / "staged_rocket.toml"), until="1 s")
    drawn, every = xd.plot(staged), xd.plot(staged, panels="all")
    shown, all_of_them = (len([axes for axes in part.axes if axes.get_visible()]) for part in (drawn, every))
    assert f'{shown} of {all_of_them} panels; with --panels all (panels="all") also' in drawn.get_supxlabel()
    assert "panels" not in every.get_supxlabel()


@pytest.mark.parametrize(("depth", "said"), [(0.06, ""), (50.0, "; outside the frame: floor")])
def test_a_picture_holds_walls_nearby_and_names_others(depth: float, said: str) -> None:
    """Assert that film and plane reach down to a floor under the path and say nothing, and name one that is too far off."""
    ball = xd.Model(
        name="ball",
        coordinates={"x": "m", "y": "m"},
        mass=dict.fromkeys("xy", "1*kilogram"),
        initial={"x": "0 m", "y": "0 m", "v_x": "1 m s-1", "v_y": "1 m s-1"},
        forces={"weight": {"y": "-9.81*newton"}},
        contacts={"floor": {"gap": f"y + {depth}*metre", "restitution": 1.0}},
    )
    run = xd.simulate(ball, method="rk4", step=0.02, until=0.2)
    scene = scene_of(run, None)
    assert isinstance(scene, BodiesScene)
    film = Figure(figsize=scene.size).subplots()
    assert scene.start(film) == said
    (orbit,) = xd.plot(run, only="plane").axes
    title = orbit.get_title(loc="left").replace("\n", " ")
    assert title == f"the plane (dot: start){said}"
    for axes in (film, orbit):
        assert -0.08 < axes.get_ylim()[0] < (0.0 if said else -depth)
        walls = [item for item in axes.collections if type(item).__name__ == "QuadContourSet" and not item.filled]
        levels = [path.vertices[:, 1] for item in walls for path in item.get_paths() if len(path.vertices)]
        assert [level == pytest.approx(-depth, abs=1e-12) for level in levels] == [True] * (not said)


def test_walls_that_a_relation_leads_to_are_drawn() -> None:
    """Assert that a box given as three sides along a dimension, met over a relation, has its two walls and its floor."""
    balls = xd.Model(
        name="balls in a box of sides",
        dimensions={"ball": 2, "axis": ["x", "y"], "side": ["left", "right", "floor"]},
        coordinates={"r": {"unit": "m", "dims": ["ball", "axis"]}},
        parameters={
            "normal": {"dims": ["side", "axis"], "value": [[1, 0], [-1, 0], [0, 1]]},
            "place": {"dims": ["side"], "value": ["-0.5 m", "-0.6 m", "-0.2 m"]},
        },
        relations={"meets": {"from": "ball", "to": "side"}},
        mass={"r": "1*kilogram"},
        initial={"r": "0.1*metre*index(ball)", "v_r": "1*metre/second*(1 - index(axis)*index(ball))"},
        contacts={
            "sides": {
                "gap": "sum(first(r, meets)*second(normal, meets), axis) - second(place, meets)",
                "restitution": 1.0,
            }
        },
    )
    scene = scene_of(unfold(xd.simulate(balls, method="rk4", step="0.02 s", until="2 s")), None)
    assert isinstance(scene, BodiesScene)
    across = [float(np.mean(line[:, 0])) for line in lines_of(scene) if np.ptp(line[:, 0]) < 1e-9]
    up = [float(np.mean(line[:, 1])) for line in lines_of(scene) if np.ptp(line[:, 1]) < 1e-9]
    assert sorted(across) == pytest.approx([-0.5, 0.6], abs=1e-12)
    assert up == pytest.approx([-0.2], abs=1e-12)
