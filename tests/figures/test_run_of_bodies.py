"""Figures of bodies that turn."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import pytest
import xarray as xr

import xdynamics as xd
from cases.bodies import of_body
from xdynamics.figures.marks import legible


def titles(run: Any, **settings: Any) -> list[str]:
    """Titles of the panels of a figure."""
    figure = xd.plot(run, **settings)
    found = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    plt.close(figure)
    return found


def test_bodies_are_drawn_by_attitude_and_angular_velocity() -> None:
    """Assert the panels of a body that rests where it turns; integrals of angular velocities are drawn if asked for."""
    spin = {"initial": {"angular_velocity": ["0.3 rad s-1", "5 rad s-1", "0.2 rad s-1"]}}
    run = xd.simulate(of_body(spin), method="rk4", step="20 ms", until="1 s")
    assert titles(run) == ["angular velocity in the body", "attitude, a quaternion"]
    assert titles(run, only=["attitude"]) == ["attitude, a quaternion"]
    assert titles(run, only=["frame_turn"]) == ["trajectory"]
    assert titles(run, only=["frame_q"]) == ["first-order state"]
    with pytest.raises(xd.InputError, match="only has 'frame_p'"):
        xd.plot(run, only=["frame_p"])


CLUSTER = """
name = "cluster"
[dimensions]
body = 12
axis = ["x", "y"]
[relations.pair]
of = "body"
[coordinates]
r = { unit = "m", dims = ["body", "axis"] }
[parameters]
m = "1 kg"
k = "1 N m-1"
[mass]
r = "m"
[forces.springs]
over = "pair"
potential = "k*norm(second(r, pair) - first(r, pair), axis)**2/2"
[initial]
r = "metre*(1 + index(body) + 2*index(axis))"
v_r = "(1 + index(axis))*metre/second"
"""


def test_a_picture_takes_no_element_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that a picture of 24 elements makes few DataArrays of them: each costs as much as there are elements."""
    made, count = xr.Dataset._construct_dataarray, 0

    def counted(dataset: xr.Dataset, name: Any) -> xr.DataArray:
        nonlocal count
        count += 1
        return made(dataset, name)

    run = xd.simulate(xd.Model.from_text(CLUSTER), method="rk4", step="50 ms", until="0.5 s")
    monkeypatch.setattr(xr.Dataset, "_construct_dataarray", counted)
    assert len(titles(run)) == 4
    assert 0 < count < 20


def test_each_axis_of_many_bodies_has_a_map() -> None:
    """Assert a map of x and one of y with the labels of all bodies that are 30 letters long, cut in their middle."""
    labels = [f"a_body_with_a_long_label_no_{number:03d}" for number in range(9)]
    text = CLUSTER.replace("body = 12", f"body = {labels}")
    run = xd.simulate(xd.Model.from_text(text), method="rk4", step="50 ms", until="0.5 s")
    across, up = xd.plot(run, only="trajectory").axes
    for axes, axis in ((across, "x"), (up, "y")):
        assert axes.get_title(loc="left").startswith(f"trajectory r[{axis}], 9 rows, one per body")
        assert [text.get_text() for text in axes.get_yticklabels()] == [f"a_body_w…l_no_{k:03d}" for k in range(9)]
        drawn = axes.collections[0].get_array()
        assert (drawn[:, 0] == run["r"].values[0, :, "xy".index(axis)]).all()
        assert axes.child_axes[0].get_ylabel() == f"r[{axis}] (m)"


def test_paths_of_many_bodies_differ_in_colour_and_have_names_at_their_ends() -> None:
    """Assert no colour twice among twelve bodies, and their numbers at the ends of their paths."""
    run = xd.simulate(xd.Model.from_text(CLUSTER), method="rk4", step="50 ms", until="0.5 s")
    (axes,) = xd.plot(run, only="plane").axes
    colours = [line.get_color() for line in axes.lines if line.get_linestyle() == "-"]
    assert len({*colours}) == len(colours) == 12
    ends = {text.get_text(): text.xy for text in axes.texts}
    assert [*ends] == [*map(str, range(12))]
    assert [text.get_color() for text in axes.texts] == [legible(colour, 4.5) for colour in colours]
    assert ends["7"] == tuple(run["r"].values[-1, 7])
    assert "body numbers at the ends, left out where crowded" in axes.get_title(loc="left").replace("\n", " ")
