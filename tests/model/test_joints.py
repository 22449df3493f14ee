"""Joints as they are read: what they stand for, where they hold, what is refused."""

from __future__ import annotations

import re
from ast import literal_eval

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import xdynamics as xd
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.constraints import conditions

TWO = """
name = "two rods"
[bodies.arm]
mass = "2 kg"
inertia = ["0.2 kg m2", "0.2 kg m2", "0.02 kg m2"]
points = { low = ["0 m", "0 m", "-0.5 m"] }
[bodies.rod]
mass = "1 kg"
inertia = ["0.2 kg m2", "0.2 kg m2", "0.02 kg m2"]
points = { top = ["0 m", "0 m", "0.5 m"] }
initial = { position = ["0 m", "0 m", "-1 m"] }
[joints.elbow]
"""
HINGE = 'hinge = ["arm", "rod"]\nat = ["low", "top"]\naxis = [0, 1, 0]'
BALL = 'ball = ["arm", "rod"]\nat = ["low", "top"]'
RIGID = 'rigid = ["arm", "rod"]\nat = ["low", "top"]'
WRONG = {
    HINGE.replace("rod", "leg"): "joint 'elbow': hinge: there is no body 'leg'",
    HINGE.replace("1, 0]", "0, 0]"): "axis is [0.0, 0.0, 0.0], of length 0.0",
    HINGE.replace("rod", "arm"): "hinge joins arm to itself",
    HINGE.replace("at =", "description ="): "key 'at' is missing",
    HINGE.replace('["low", "top"]', '"low"'): "needs two points, one in each",
    HINGE.replace("low", "lower"): "body 'arm' has no point 'lower'; did you mean 'low'?",
    HINGE.replace('"low"', '["0 N", "0 m", "0 m"]'): "at in arm, x has units 'kg m s-2 (N)', needs 'm'",
    HINGE.replace('"low"', '["t*metre/second", "0 m", "0 m"]'): "at in arm, x reads 't'; a point of a body is of",
    HINGE[: HINGE.index("\naxis")]: "key 'axis' is missing",
    HINGE.replace("hinge", "pivot"): "key 'pivot' is not known; there are ball, hinge, slider, rigid",
    HINGE + '\nball = ["arm", "rod"]': "ball and hinge are given",
    'at = ["low", "top"]': "none is given",
    HINGE + "\nattitude = [1, 0, 0, 0]": "attitude is of a slider or rigid",
    HINGE.replace("hinge", "slider").replace("[0, 1, 0]", "[[0, 1, 0], [0, 1, 0]]"): "one direction, in arm",
    BALL + "\naxis = [0, 1, 0]": "axis is of a hinge or slider",
    BALL.replace('"arm"', '"space"'): "'low' is a point of 'space'",
    BALL + '\n[constraints]\nelbow_point = "arm_r[x]"': "makes a constraint 'elbow_point', and there is one",
    BALL + '\n[parameters]\njoint_force_elbow = "1 m"': "both claim the name 'joint_force_elbow'",
    BALL + '\n[joints."2x"]\n' + BALL: "a joint's name is a letter",
    RIGID + "\nattitude = [1, 1, 0, 0]": "a unit quaternion is needed",
    RIGID + '\nattitude = { axis = [0, 0, 1], angle = "3 m" }': "needs an angle",
    BALL.replace('"top"', '"centre"'): "'elbow_point[z]' is 0.5 m at the start, and needs 0",
}


@pytest.mark.parametrize(("joint", "said"), [*WRONG.items()])
def test_wrong_joints_are_refused(joint: str, said: str) -> None:
    """Assert that each is refused in words that name the joint, what is wrong and what was needed."""
    with pytest.raises(xd.ModelError, match=re.escape(said)):
        xd.Model.from_text(TWO + joint)


def test_joints_need_bodies() -> None:
    """Assert that joints without bodies are refused."""
    with pytest.raises(xd.ModelError, match="without \\[bodies\\]"):
        xd.Model.from_text(f'name = "none"\n[joints.elbow]\n{BALL}')


@pytest.mark.parametrize(("joint", "count"), [(BALL, 3), (HINGE, 5), (HINGE.replace("hinge", "slider"), 5), (RIGID, 6)])
def test_joints_are_written_as_they_were_read(joint: str, count: int) -> None:
    """Assert how many conditions each kind is, and that the text of a model has the joint and none of them."""
    model = xd.Model.from_text(TWO + joint)
    assert len(model.constraints) == count
    assert xd.Model.from_text(model.to_toml()) == model
    assert "[joints.elbow]" in model.to_toml()
    assert "[constraints" not in model.to_toml()
    assert "elbow_angle" not in model.to_toml()


AXES = {  # of a hinge in either body, and the attitude of the second that lays one on the other
    "[[0, 1, 0], [0, 1, 0]]": [0.0, 0.0, 0.0],
    "[[0, 1, 0], [0, 0, 1]]": [-90.0, 0.0, 0.0],
    "[[0, 1, 0], [0, -1, 0]]": [180.0, 0.0, 0.0],
    "[[3, 0, 4], [3, 0, 4]]": [0.0, 0.0, 0.0],
}


def hinged(axes: str, attitude: Rotation) -> xd.Model:
    """The two rods with their centres in one point, hinged there, and the second turned."""
    rod = TWO.replace(
        'initial = { position = ["0 m", "0 m", "-1 m"] }', f"initial = {{ attitude = {quaternion(attitude)} }}"
    )
    return xd.Model.from_text(f'{rod}hinge = ["arm", "rod"]\nat = ["centre", "centre"]\naxis = {axes}')


def quaternion(attitude: Rotation) -> list[float]:
    """The four parts of a rotation, scalar first."""
    x, y, z, w = attitude.as_quat()
    return [float(part) for part in (w, x, y, z)]


@pytest.mark.parametrize("degrees", [0, 100, 200, 300])
@pytest.mark.parametrize("axes", [*AXES])
def test_a_hinge_holds_at_every_angle(axes: str, degrees: int) -> None:
    """Assert that a body turned about the axis is where the hinge holds, with gradients of 1 across each other."""
    axis = np.array(literal_eval(axes)[0], float)
    about = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis))
    attitude = about * Rotation.from_euler("xyz", AXES[axes], degrees=True)
    model = hinged(axes, attitude)
    values = {name: part.si for name, part in model.statement.initial.items()}
    for body in ("arm", "rod"):
        rows = [
            [evaluate(condition.row.get(f"{body}_turn·{axis}", ZERO), values) for axis in "xyz"]
            for condition in conditions(model)
            if "turn" in condition.name
        ]
        assert np.array(rows) @ np.transpose(rows) == pytest.approx(np.eye(2), abs=1e-14)
        assert np.array(rows) @ literal_eval(axes)[body == "rod"] == pytest.approx(np.zeros(2), abs=1e-14)
    off = Rotation.from_rotvec(1e-3 * np.cross(axis, [0.1, 0.7, 0.2]))
    with pytest.raises(xd.ModelError, match=r"'elbow_turn_.' is \S+ at the start, .* is arm_q0 = .*, rod_q\[z\] = "):
        hinged(axes, off * attitude)
