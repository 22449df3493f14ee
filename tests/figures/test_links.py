"""What joins bodies of a model with dimensions, in the plane and in films: rods, springs, bars."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS
from xdynamics.figures.boundaries import fastenings_of
from xdynamics.figures.plane import views
from xdynamics.figures.scenes import scene_of
from xdynamics.record import unfold

ROPE = """
name = "bodies in a row"
[dimensions]
ball = {count}
axis = ["x", "y"]
[relations.bond]
of = "ball"
neighbours = 1
[coordinates]
r = {{ unit = "m", dims = ["ball", "axis"] }}
[parameters]
k = "{stiffness} N m-1"
L = "1 m"
[mass]
r = "1*kilogram"
{joined}
[initial]
r = "metre*index(ball)*(1 - index(axis))*{stretched}"
v_r = "index(axis)*(index(ball) - (size(ball) - 1)/2)*metre/second"
[run]
method = "rk4"
step = "1 ms"
until = "0.2 s"
"""
SPRINGS = '[forces.bonds]\nover = "bond"\npotential = "k*(norm(second(r, bond) - first(r, bond), axis) - L)**2/2"'
RODS = '[forces.none]\nr = "0*newton*k*L/(newton)"\n[constraints.rod]\nholds = "norm(second(r, bond) - first(r, bond), axis) - L"'
PLAIN = '[forces.none]\nr = "-k*r"'


def joined_by(joined: str, count: int = 3, stiffness: str = "40", stretched: str = "1.3") -> Any:
    """A run of bodies in a row, and its bodies in the plane."""
    text = ROPE.format(count=count, stiffness=stiffness, joined=joined, stretched=stretched)
    run = unfold(xd.simulate(xd.Model.from_text(text))).copy(deep=False)
    return run, views(run)[0]


@pytest.mark.parametrize(
    ("joined", "settings", "kind"),
    [
        (SPRINGS, {}, "springs"),
        (SPRINGS, {"stiffness": "1e6", "stretched": "1"}, "lines"),
        (SPRINGS, {"count": 45}, "lines"),
        (RODS, {"stretched": "1"}, "links"),
        (PLAIN, {}, "lines"),
    ],
)
def test_links_of_relations_are_what_acts_over_them(joined: str, settings: dict[str, Any], kind: str) -> None:
    """Assert springs for a potential, bars where they are stiff or many, rods for a constraint, and every link once."""
    run, view = joined_by(joined, **settings)
    (found,) = fastenings_of(run, view)
    assert found.kind == kind
    count = settings.get("count", 3)
    assert (found.ends == np.stack([np.arange(count - 1), np.arange(1, count)], axis=-1)).all()


def test_springs_of_relations_go_from_body_to_body() -> None:
    """Assert coils in a film from where each body is to where the next one is, and in the plane from start to start."""
    run, view = joined_by(SPRINGS)
    scene: Any = scene_of(run, None)
    figure = xd.plot(run, only="plane")
    grey = [line for line in figure.axes[0].lines if line.get_color() == "0.6"]
    assert [(line.get_xdata()[0], line.get_xdata()[-1]) for line in grey] == [(0.0, 1.3), (1.3, 2.6)]
    assert all(len(line.get_xdata()) > 10 for line in grey)
    scene.start(figure.axes[0])
    coils = scene.move_to(0.2)[1].get_segments()
    places = np.array([[path.x[-1], path.y[-1]] for path in view])
    assert len(coils) == 2
    for k, coil in enumerate(coils):
        assert np.allclose(coil[[0, -1]], places[[k, k + 1]], rtol=0.0, atol=1e-12)
        assert len(coil) > 10


def test_a_truss_is_of_bars() -> None:
    """Assert straight lines for the six elastic bars of a truss, which stretch by less than can be seen."""
    run = unfold(xd.simulate(xd.Model.from_toml(MODELS / "truss.toml"))).copy(deep=False)
    found, _ = fastenings_of(run, views(run)[0])
    assert (found.kind, found.ends.shape) == ("lines", (6, 2))


HUNG = """
[dimensions]
hook = ["left", "right"]
"""


@pytest.mark.parametrize(("ends", "unit"), [(("ball", "hook"), "m"), (("hook", "ball"), "mm")])
def test_links_to_fixed_places_end_there(tmp_path: Any, ends: tuple[str, str], unit: str) -> None:
    """Assert springs between bodies and places that stand still, in either direction, in units of their own, inside the frame."""
    (tmp_path / "hangers.csv").write_text("first,second\n" + ("0,left\n" if ends[0] == "ball" else "left,0\n"))
    near, far = ("first", "second") if ends[0] == "ball" else ("second", "first")
    hung = f'[relations.hanger]\nfrom = "{ends[0]}"\nto = "{ends[1]}"\ntable = "hangers.csv"\n[coordinates]'
    force = f'[forces.hangers]\nover = "hanger"\npotential = "k*norm({far}(place, hanger) - {near}(r, hanger), axis)**2/2"\n[initial]'
    size = 1 if unit == "m" else 1000
    text = ROPE.format(count=3, stiffness="40", joined=SPRINGS, stretched="1.3")
    text = text.replace("[dimensions]", HUNG.strip()).replace("[coordinates]", hung).replace("[initial]", force)
    place = f'place = {{ dims = ["hook", "axis"], value = [[{-1 * size}, {3 * size}], [0, 0]], unit = "{unit}" }}'
    (tmp_path / "hung.toml").write_text(text.replace("[parameters]", f"[parameters]\n{place}"))
    run = unfold(xd.simulate(xd.Model.from_toml(tmp_path / "hung.toml"))).copy(deep=False)
    scene: Any = scene_of(run, None)
    axes = xd.plot(run, only="plane").axes[0]
    assert any(line.get_marker() == "^" and (line.get_xydata()[0] == [-1.0, 3.0]).all() for line in axes.lines)
    scene.start(axes)
    (line,) = scene.move_to(0.2)[2].get_segments()
    assert scene.fastenings[1].kind == "springs"
    body, hook = (line[0], line[-1]) if ends[0] == "ball" else (line[-1], line[0])
    assert np.allclose(hook, [-1.0, 3.0], rtol=0.0, atol=1e-12)
    assert np.allclose(body, [scene.view[0].x[-1], scene.view[0].y[-1]], rtol=0.0, atol=1e-12)
    assert axes.get_ylim()[1] > 3.0
