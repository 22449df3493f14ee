"""Figures of bodies that turn."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import pytest
import xarray as xr

import xdynamics as xd
from cases.bodies import of_body


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
