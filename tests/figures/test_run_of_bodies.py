"""Figures of bodies that turn."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import pytest

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
