"""Joints of bodies: motions and reactions against closed forms, and against the same mechanism written otherwise."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.special import ellipj, ellipk

import xdynamics as xd
from cases.problems import MODELS

MASS, GRAVITY, ARM, ASIDE, MOMENT = 2.0, 9.81, 0.5, 0.3, 0.2
# a rod that turns about the x axis of space at a point aside of it
HINGED = """
name = "hinged rod"
[bodies.rod]
mass = "2 kg"
inertia = ["0.2 kg m2", "0.2 kg m2", "0.002 kg m2"]
points = { hole = ["0.3 m", "0 m", "0.5 m"] }
[bodies.rod.initial]
position = ["-0.3 m", "0.5 m", "0 m"]
attitude = { axis = [1, 0, 0], angle = "90 degree" }
[joints.pin]
hinge = ["rod", "space"]
at = ["hole", ["0 m", "0 m", "0 m"]]
axis = [1, 0, 0]
[observables]
angle = "pin_angle"
turning = "v_pin_angle"
[forces.weight]
potential = "2*kilogram*9.81*metre/second**2*rod_r[z]"
"""


def swing(t: Any) -> tuple[Any, Any, Any]:
    """Angle from the vertical of the hinged rod let go at 90 degrees, and its derivatives (Landau, Lifshitz, section 11)."""
    square = MASS * GRAVITY * ARM / (MOMENT + MASS * ARM**2)
    omega, m = math.sqrt(square), 0.5
    sn, cn, _, _ = ellipj(ellipk(m) - omega * np.asarray(t), m)
    angle = 2 * np.arcsin(math.sqrt(m) * sn)
    return angle, -2 * math.sqrt(m) * omega * cn, -square * np.sin(angle)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_hinge_holds_the_rod_aside_of_it(sign: float) -> None:
    """Assert that motion, force and torque in the hinge are those of the pendulum; on space they have the other sign."""
    text = (
        HINGED
        if sign > 0
        else HINGED.replace('["rod", "space"]', '["space", "rod"]').replace(
            'at = ["hole", ["0 m", "0 m", "0 m"]]', 'at = [["0 m", "0 m", "0 m"], "hole"]'
        )
    )
    run = xd.simulate(xd.Model.from_text(text), method="dop853", rtol=1e-11, until="1 s")
    angle, rate, second = swing(run.time)
    along_y = ARM * (second * np.cos(angle) - rate**2 * np.sin(angle))
    along_z = ARM * (second * np.sin(angle) + rate**2 * np.cos(angle))
    force = MASS * along_y, MASS * (along_z + GRAVITY)
    assert abs(run.rod_r.sel(axis="y") - ARM * np.sin(angle)).max() < 1e-9
    assert abs(sign * run.joint_force_pin.sel(axis="x")).max() < 1e-8
    assert abs(sign * run.joint_force_pin.sel(axis="y") - force[0]).max() < 1e-8
    assert abs(sign * run.joint_force_pin.sel(axis="z") - force[1]).max() < 1e-8
    assert abs(run.joint_torque_pin.sel(axis="x")).max() < 1e-9
    assert abs(sign * run.joint_torque_pin.sel(axis="y") - ASIDE * force[1]).max() < 1e-8
    assert abs(sign * run.joint_torque_pin.sel(axis="z") + ASIDE * force[0]).max() < 1e-8
    assert abs(run.angle + sign * angle).max() < 1e-9
    assert abs(run.turning + sign * rate).max() < 1e-9
    assert (run.constraint_rank == 5).all()
    assert (run.joint_torque_pin.units, run.joint_force_pin.units) == ("N m", "N")


@pytest.mark.dear
def test_extremes_of_reactions_are_kept_of_grids() -> None:
    """Assert that lanes end as single runs do, and have the largest reactions that `diagnose` finds."""
    model, asked = xd.Model.from_text(HINGED), {"method": "dop853", "rtol": 1e-9, "until": "0.5 s"}
    keep = ["end_angle", "maximum_joint_force_pin", "minimum_joint_torque_pin"]
    grid = xd.sweep(model, {"rod_mass": [1.0, 2.0, 3.0, 4.0, 5.0]}, keep=keep, **asked).compute()
    alone = xd.simulate(model, **asked)
    found = xd.diagnose(alone, companion=False)
    assert float(grid.end_angle[1]) == float(alone.angle[-1])
    assert grid.maximum_joint_force_pin[1].values.tolist() == found.maximum_joint_force_pin.values.tolist()
    assert grid.minimum_joint_torque_pin[1].values.tolist() == found.minimum_joint_torque_pin.values.tolist()
    assert float(found.maximum_joint_force_pin.sel(axis="z")) > float(alone.joint_force_pin.sel(axis="z").max())


def test_a_block_slides_down() -> None:
    """Assert that a block on a rail is accelerated as on an incline, and what it does to the rail."""
    run = xd.simulate(
        xd.Model.from_text("""
        name = "block on a rail"
        [bodies.block]
        mass = "2 kg"
        inertia = ["0.01 kg m2", "0.02 kg m2", "0.02 kg m2"]
        points = { foot = ["0.1 m", "0 m", "-0.2 m"] }
        forces = { weight = { force = ["0 N", "0 N", "-19.62 N"] } }
        initial = { attitude = { axis = [0, 1, 0], angle = "30 degree" } }
        [joints.rail]
        slider = ["space", "block"]
        at = [["0 m", "0 m", "0 m"], "foot"]
        axis = [0.8660254037844386, 0, -0.5]
        attitude = { axis = [0, 1, 0], angle = "30 degree" }
        [observables]
        way = "rail_travel"
        [initial]
        consistent = true
        """),
        method="dop853",
        rtol=1e-10,
        until="1 s",
    )
    down, up = np.array([math.cos(math.pi / 6), 0.0, -0.5]), np.array([0.5, 0.0, math.cos(math.pi / 6)])
    pressed = -MASS * GRAVITY * math.cos(math.pi / 6) * up
    assert abs(run.way - run.way[0] - GRAVITY / 4 * run.time**2).max() < 1e-11
    assert abs(run.joint_force_rail - pressed).max() < 1e-11
    assert abs(run.joint_torque_rail + np.cross(0.1 * down - 0.2 * up, pressed)).max() < 1e-11
    assert (run.constraint_rank == 5).all()


def test_two_welded_bodies_are_one() -> None:
    """Assert that two boxes turned against each other tumble as the box that they are together."""
    about_x = 'attitude = { axis = [1, 0, 0], angle = "90 degree" }'
    pair = xd.simulate(
        xd.Model.from_text(f"""
        name = "two boxes"
        [bodies.one]
        mass = "1 kg"
        inertia = ["1 kg m2", "2 kg m2", "2.5 kg m2"]
        initial = {{ position = ["-1 m", "0 m", "0 m"], angular_velocity = ["0.3 rad s-1", "0.01 rad s-1", "2 rad s-1"], velocity = ["0 m s-1", "-2 m s-1", "0.01 m s-1"] }}
        [bodies.two]
        mass = "1 kg"
        inertia = ["0.5 kg m2", "1.2 kg m2", "1.5 kg m2"]
        initial = {{ position = ["1 m", "0 m", "0 m"], {about_x}, angular_velocity = ["0.3 rad s-1", "2 rad s-1", "-0.01 rad s-1"], velocity = ["0 m s-1", "2 m s-1", "-0.01 m s-1"] }}
        [joints.weld]
        rigid = ["one", "two"]
        at = [["1 m", "0 m", "0 m"], ["-1 m", "0 m", "0 m"]]
        {about_x}
        """),
        method="dop853",
        rtol=1e-11,
        until="2 s",
    )
    alone = xd.simulate(
        xd.Model.from_text("""
        name = "one box"
        [bodies.box]
        mass = "2 kg"
        inertia = ["1.5 kg m2", "5.5 kg m2", "5.7 kg m2"]
        initial = { angular_velocity = ["0.3 rad s-1", "0.01 rad s-1", "2 rad s-1"] }
        """),
        method="dop853",
        rtol=1e-11,
        until="2 s",
    )
    assert abs(pair.one_q.values[-1] - alone.box_q.values[-1]).max() < 1e-9
    assert abs(pair.v_one_turn.values[-1] - alone.v_box_turn.values[-1]).max() < 1e-9
    assert abs(pair.joint_force_weld - pair.a_one_r).max() < 1e-8
    assert float(abs(pair.joint_torque_weld).max()) > 0.01
    assert abs(torque_balance(pair)).max() < 1e-8
    assert (pair.constraint_rank == 6).all()


def torque_balance(run: xr.Dataset) -> Any:
    """What is missing between the change of the first box's angular momentum and the weld's force and torque on it."""
    inertia = np.array([1.0, 2.0, 2.5])
    omega, alpha = run.v_one_turn.values, run.a_one_turn.values
    inside = inertia * alpha + np.cross(omega, inertia * omega)
    lever = turned(run, np.broadcast_to([1.0, 0.0, 0.0], inside.shape))
    return turned(run, inside) - run.joint_torque_weld.values - np.cross(lever, run.joint_force_weld.values)


def turned(run: xr.Dataset, vectors: Any) -> Any:
    """Vectors in the first box by their components in space."""
    q0, q = run.one_q0.values[:, None], run.one_q.values
    return vectors + 2 * np.cross(q, np.cross(q, vectors) + q0 * vectors)


def test_a_top_on_a_ball_is_one_about_a_pivot() -> None:
    """Assert that a heavy top whose tip is a ball joint moves as that which turns about a fixed point."""
    pivot = xd.simulate(xd.Model.from_toml(MODELS / "heavy_top.toml"), until="0.5 s")
    ball = xd.simulate(
        xd.Model.from_text("""
        name = "top on a ball"
        [bodies.top]
        mass = "1 kg"
        inertia = ["0.01 kg m2", "0.01 kg m2", "0.02 kg m2"]
        [bodies.top.initial]
        position = ["0 m", "-0.3*sin(30*degree)*metre", "0.3*cos(30*degree)*metre"]
        attitude = { axis = [1, 0, 0], angle = "30 degree" }
        angular_velocity = ["0 rad s-1", "0 rad s-1", "80 rad s-1"]
        [joints.tip]
        ball = ["top", "space"]
        at = [["0 m", "0 m", "-0.3 m"], ["0 m", "0 m", "0 m"]]
        [forces.weight]
        potential = "9.81*newton*top_r[z]"
        [observables]
        about_vertical = "top_spin[z] + (top_r[x]*v_top_r[y] - top_r[y]*v_top_r[x])*kilogram"
        """),
        method="dop853",
        rtol=1e-12,
        until="0.5 s",
    )
    assert abs(ball.top_r.values[-1] - pivot.bob.values[-1]).max() < 1e-10
    assert abs(ball.v_top_turn.values[-1] - pivot.v_top_turn.values[-1]).max() < 1e-8
    assert abs(ball.about_vertical - 1.6 * math.cos(math.pi / 6)).max() < 1e-11
    assert abs(ball.joint_force_tip - (ball.a_top_r + np.array([0.0, 0.0, GRAVITY]))).max() < 1e-9
    assert "joint_torque_tip" not in ball


FOUR_BAR = """
name = "four-bar linkage of bodies"
[parameters]
g = "9.81 m s-2"
[bodies.left]
mass = "1 kg"
inertia = ["1/12*kilogram*metre**2", "1/12*kilogram*metre**2", "0.001 kg m2"]
points = { low = ["0 m", "0 m", "-0.5 m"], top = ["0 m", "0 m", "0.5 m"] }
initial = { position = ["0 m", "0 m", "0.5 m"], velocity = ["0.5 m s-1", "0 m s-1", "0 m s-1"], angular_velocity = ["0 rad s-1", "1 rad s-1", "0 rad s-1"] }
[bodies.right]
mass = "1 kg"
inertia = ["1/12*kilogram*metre**2", "1/12*kilogram*metre**2", "0.001 kg m2"]
points = { low = ["0 m", "0 m", "-0.5 m"], top = ["0 m", "0 m", "0.5 m"] }
initial = { position = ["1 m", "0 m", "0.5 m"], velocity = ["0.5 m s-1", "0 m s-1", "0 m s-1"], angular_velocity = ["0 rad s-1", "1 rad s-1", "0 rad s-1"] }
[bodies.coupler]
mass = "1 kg"
inertia = ["0.001 kg m2", "1/12*kilogram*metre**2", "1/12*kilogram*metre**2"]
points = { left = ["-0.5 m", "0 m", "0 m"], right = ["0.5 m", "0 m", "0 m"] }
initial = { position = ["0.5 m", "0 m", "1 m"], velocity = ["1 m s-1", "0 m s-1", "0 m s-1"] }
[forces.weight]
potential = "g*kilogram*(left_r[z] + right_r[z] + coupler_r[z])"
[joints.a]
hinge = ["left", "space"]
at = ["low", ["0 m", "0 m", "0 m"]]
axis = [0, 1, 0]
[joints.b]
hinge = ["left", "coupler"]
at = ["top", "left"]
axis = [0, 1, 0]
[joints.c]
hinge = ["right", "coupler"]
at = ["top", "right"]
axis = [0, 1, 0]
[joints.d]
hinge = ["right", "space"]
at = ["low", ["1 m", "0 m", "0 m"]]
axis = [0, 1, 0]
[observables]
tip = "left_top"
"""


@pytest.mark.dear
def test_a_four_bar_of_bodies_is_that_of_points() -> None:
    """Assert that three rods in four hinges, three conditions too many, move as the plane linkage of rods."""
    run = xd.simulate(xd.Model.from_text(FOUR_BAR), method="dop853", rtol=1e-11, until="0.6 s")
    plane = xd.simulate(xd.Model.from_toml(MODELS / "four_bar.toml"), until="0.6 s")
    assert abs(float(run.tip.sel(axis="x")[-1]) - float(plane.x0[-1])) < 1e-9
    assert abs(float(run.tip.sel(axis="z")[-1]) - float(plane.y0[-1])) < 1e-9
    assert abs(run.tip.sel(axis="y")).max() < 1e-12
    assert (run.constraint_rank == 17).all()
