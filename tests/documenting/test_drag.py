"""The line of a summary about forces of velocities that drive a motion."""

from __future__ import annotations

import pytest

import xdynamics as xd
from xdynamics.documenting.summary import summary


def lines(drag: str) -> list[str]:
    """What a summary says of the work of drag on a ball thrown up, that falls down again."""
    ball = xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2", "c": "0.05 kg m-1"},
        mass={"y": "m"},
        forces={"weight": {"potential": "m*g*y"}, "drag": {"y": drag}},
        initial={"y": "0 m", "v_y": "20 m s-1"},
    )
    run = xd.simulate(ball, method="dop853", rtol=1e-9, until="3 s")
    return [line for line in summary(run) if line.startswith("work")]


@pytest.mark.parametrize(("drag", "where"), [("-c*v_y**2", " where v_y < 0"), ("c*v_y*metre/second", "")])
def test_drag_with_a_wrong_sign_is_said(drag: str, where: str) -> None:
    """Assert that drag of one sign is said to drive a falling ball, and one of the other sign to drive it always."""
    (line,) = lines(drag)
    assert line.startswith("work      drag did +")
    assert f"J of work on the motion{where}: drag would take it" in line


def test_drag_that_brakes_is_no_remark() -> None:
    """Assert no line for drag against the velocity, in either direction."""
    assert not lines("-c*v_y*abs(v_y)")
