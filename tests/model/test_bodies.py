"""Bodies as a section of a model: what they stand for, how they are written again, what is refused.

Joints as they are read: what they stand for, where they hold, what is refused.
"""

from __future__ import annotations

import re
from ast import literal_eval
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import xdynamics as xd
from cases.bodies import FRAME, of_body
from xdynamics.expressions import Name
from xdynamics.expressions.calculus import ZERO
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.constraints import conditions
from xdynamics.model.motion import constants, evaluate_motion


def test_a_body_is_coordinates_states_and_a_parameter_for_each_quantity() -> None:
    """Assert what a body makes, and that its numbers are parameters."""
    model = of_body()
    assert [*model.statement.coordinates] == ["frame_r", "frame_turn"]
    assert [*model.statement.states] == ["frame_q0", "frame_q"]
    assert [*model.statement.parameters] == ["frame_mass", "frame_inertia_x", "frame_inertia_y", "frame_inertia_z"]
    assert model.shapes.dims["frame_q"] == model.shapes.dims["frame_tip"] == ("axis",)
    assert model.parameters["frame_inertia_y"].quantity.si == 2.0


@pytest.mark.parametrize(
    "more",
    [
        {},
        {"dims": ["link"], "initial": {"position": ["index(link)*metre", "0 m", "0 m"]}},
        {
            "inertia": [
                ["1 kg m2", "0.1 kg m2", "0 kg m2"],
                ["0.1 kg m2", "2 kg m2", "0 kg m2"],
                ["0 kg m2", "0 kg m2", "2 kg m2"],
            ]
        },
        {"mass": None, "pivot": ["0 m", "1 m", "0 m"]},
        {"forces": {"pull": {"force": ["0 N", "1 N", "k*frame_tip[z]"], "at": "tip", "axes": "body"}}},
        {"torques": {"motor": {"torque": ["0 N m", "1 N m", "0 N m"], "axes": "space"}}},
        {
            "initial": {
                "attitude": {"axis": [1, 1, 0], "angle": "30 degree"},
                "velocity": ["1 m s-1", "2 km h-1", "0 m s-1"],
            }
        },
    ],
)
def test_a_body_is_written_again(more: dict[str, Any]) -> None:
    """Assert that a model with a body reads back as itself, and has no word of what the body stands for."""
    sections: dict[str, Any] = {"parameters": {"k": "1 N m-1"}, "coordinates": {"s": "m"}, "mass": {"s": "frame_mass"}}
    if more.get("pivot"):
        sections["mass"] = {"s": "1*kilogram"}
    model = of_body(more, dimensions={"link": 2}, initial={"s": "0 m"}, **sections)
    text = model.to_toml()
    assert xd.Model.from_text(text).to_toml() == text
    assert xd.Model.from_text(text).elements.statement == model.elements.statement
    assert "states." not in text and "gyroscopic" not in text and "frame_turn =" not in text.split("[initial]")[0]  # noqa: PT018


def test_forces_of_bodies_act_in_regimes_that_name_them_or_in_all() -> None:
    """Assert that a force that a regime names acts there alone, and what no author writes in every one."""
    pull = {"forces": {"pull": {"force": ["0 N", "0 N", "1 N"]}}}
    model = of_body(pull, regimes={"on": {"forces": ["frame_pull"]}, "off": {"forces": []}})
    assert [regime.forces for regime in model.regimes.values()] == [
        ("frame_pull", "frame_gyroscopic"),
        ("frame_gyroscopic",),
    ]


def at_start(model: xd.Model) -> dict[str, float]:
    """Forces and accelerations at the start, by name."""
    state = {name: quantity.si for name, quantity in model.elements.statement.initial.items()}
    return evaluate_motion(model, state, constants(model), ())


QUARTER = {"axis": [0, 0, 1], "angle": "90 degree"}  # x of the body is y in space


@pytest.mark.parametrize("axes", ["space", "body"])
def test_forces_act_at_points_in_either_axes(axes: str) -> None:
    """Assert force and torque of a push at a point of a body that is turned by a quarter, by hand."""
    force = ["3 N", "5 N", "7 N"]
    more = {
        "forces": {"pull": {"force": force, "at": ["1 m", "2 m", "4 m"], "axes": axes}},
        "initial": {"attitude": QUARTER},
    }
    found = at_start(of_body(more))
    own = np.array([5, -3, 7]) if axes == "space" else np.array([3, 5, 7])
    outer = np.array([3, 5, 7]) if axes == "space" else np.array([-5, 3, 7])
    pulled = [found[f"force_frame_pull_frame_r·{axis}"] for axis in "xyz"]
    turned = [found[f"force_frame_pull_frame_turn·{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(pulled, outer, rtol=0, atol=4e-15)
    np.testing.assert_allclose(turned, np.cross([1, 2, 4], own), rtol=0, atol=2e-14)


@pytest.mark.parametrize("axes", ["space", "body"])
def test_torques_act_in_either_axes(axes: str) -> None:
    """Assert the torque on a body that is turned by a quarter."""
    more = {
        "torques": {"motor": {"torque": ["3 N m", "5 N m", "7 N m"], "axes": axes}},
        "initial": {"attitude": QUARTER},
    }
    found = at_start(of_body(more))
    turned = [found[f"force_frame_motor_frame_turn·{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(turned, [5, -3, 7] if axes == "space" else [3, 5, 7], rtol=0, atol=4e-15)


def test_a_potential_of_a_point_is_its_force_there() -> None:
    """Assert that a spring to a point has the force and the torque of the force that is written out."""
    start = {"initial": {"attitude": [0.5, -0.5, 0.1, 0.7], "position": ["0.1 m", "0.2 m", "-0.4 m"]}}
    spring = {"spring": {"potential": "(2*newton/metre)*sum(point(frame, tip)**2, axis)/2"}}
    pull = {"force": [f"-2*newton/metre*frame_tip[{axis}]" for axis in "xyz"], "at": "tip"}
    one = at_start(of_body(start, forces=spring))
    other = at_start(of_body(start | {"forces": {"spring": pull}}))
    for name in ("a_frame_r·x", "a_frame_r·z", "a_frame_turn·x", "a_frame_turn·y", "a_frame_turn·z"):
        assert one[name] == pytest.approx(other[name], abs=1e-15)
        assert name == "a_frame_turn·z" or abs(one[name]) > 0.01


def test_functions_of_bodies_are_expressions() -> None:
    """Assert what point, velocity and direction stand for, of names and of lists, and the velocity of a point."""
    start = {"initial": {"attitude": QUARTER, "angular_velocity": ["0 rad s-1", "0 rad s-1", "2 rad s-1"]}}
    definitions = {
        "place": "point(frame, [1*metre, 0*metre, 0*metre])",
        "named": "point(frame, tip)",
        "fast": "velocity(frame, [1*metre, 0*metre, 0*metre])",
        "centre_is": "point(frame, centre)",
        "way": "direction(frame, [1, 0, 0])",
    }
    model = of_body(start, definitions=definitions, observables={"found": "place[y] + fast[x]*second - way[y]*metre"})
    assert model.statement.definitions["named"] == Name("frame_tip")
    assert model.statement.definitions["centre_is"] == Name("frame_r")
    assert evaluate(model.elements.expanded(model.elements.observables["found"]), at_start(model)) == pytest.approx(
        -2.0, abs=4e-15
    )


REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    r"attitude is \[0.0, 0.0, 0.0, 0.0\], of length 0.0": ({"initial": {"attitude": [0, 0, 0, 0]}}, {}),
    r"of length 1.414\d+; a unit quaternion is needed: write \[0.70": ({"initial": {"attitude": [1, 1, 0, 0]}}, {}),
    r"attitude is \[1, 1, 0\], needs numbers \[w, x, y, z\]": ({"initial": {"attitude": [1, 1, 0]}}, {}),
    r"attitude is .* at the start, of length 0; without": ({}, {"initial": {"frame_q0": "0", "frame_q": [0, 0, 0]}}),
    r"at the start, of length 2.0, needs length 1": ({}, {"initial": {"frame_q0": "2", "frame_q": [0, 0, 0]}}),
    "moments 1, 2, 3.5 kg m2, and none is larger": ({"inertia": ["1 kg m2", "2 kg m2", "3.5 kg m2"]}, {}),
    "moments -1, 2, 2.5 kg m2, needs positive": ({"inertia": ["-1 kg m2", "2 kg m2", "2.5 kg m2"]}, {}),
    "mass is -2.0 kg, needs to be positive": ({"mass": "-2 kg"}, {}),
    "mass of body 'frame' has units 's', needs 'kg'": ({"mass": "2 s"}, {}),
    "inertia of body 'frame', y has units 'kg', needs": ({"inertia": ["1 kg m2", "2 kg", "2.5 kg m2"]}, {}),
    "inertia is .*; it needs three principal moments": ({"inertia": ["1 kg m2", "2 kg m2"]}, {}),
    "inertia is not symmetric: xy is '0 kg m2', yx is '1 g m2'": (
        {"inertia": [["1 kg m2", "0 kg m2", "0"], ["1 g m2", "1 kg m2", "0"], ["0", "0", "1 kg m2"]]},
        {},
    ),
    "key 'mass' is missing; a body needs it unless": ({"mass": None}, {}),
    "has a mass and a pivot": ({"pivot": ["0 m", "0 m", "0 m"]}, {}),
    "point 'tip' of body 'frame', z has units 's', needs 'm'": ({"points": {"tip": ["0 m", "0 m", "1 s"]}}, {}),
    "point 'tip' of body 'frame', z reads 't'": ({"points": {"tip": ["0 m", "0 m", "t*metre/second"]}}, {}),
    "point 'spin' has the name of something": ({"points": {"spin": ["0 m", "0 m", "1 m"]}}, {}),
    "force 'f' acts at 'tpi', no point of it; did you mean 'tip'": (
        {"forces": {"f": {"force": ["0 N", "0 N", "1 N"], "at": "tpi"}}},
        {},
    ),
    "force 'f': force is .* 2 components; it needs three": ({"forces": {"f": {"force": ["0 N", "0 N"]}}}, {}),
    "force 'f' of body 'frame', z has units 'kg'": ({"forces": {"f": {"force": ["0 N", "0 N", "1 kg"]}}}, {}),
    "torque 'f' of body 'frame', x has units .*N": ({"torques": {"f": {"torque": ["1 N", "0 N m", "0 N m"]}}}, {}),
    "torque 'gyroscopic' has the name of something": (
        {"torques": {"gyroscopic": {"torque": ["0 N m", "0 N m", "0 N m"]}}},
        {},
    ),
    "has a force and a torque 'f'": (
        {"torques": {"f": {"torque": ["0 N m", "0 N m", "0 N m"]}}, "forces": {"f": {"force": ["0 N", "0 N", "0 N"]}}},
        {},
    ),
    "body 'frame' and coordinate 'frame' both claim": (
        {},
        {"coordinates": {"frame": "m"}, "mass": {"frame": "1*kilogram"}, "initial": {"frame": "0 m"}},
    ),
    "body 'frame' makes a definition 'frame_tip', and there is one": ({}, {"definitions": {"frame_tip": "1"}}),
    "makes a parameter 'frame_mass', and there is one": ({}, {"parameters": {"frame_mass": "1 kg"}}),
    "dimension 'axis' is 2; of bodies it is": ({}, {"dimensions": {"axis": 2}}),
    r"\[lagrangian\] stands beside \[bodies\]": ({}, {"lagrangian": {"kinetic": "1"}}),
    "body 'frame' has no point tpi; did you mean 'tip'": ({}, {"observables": {"a": "point(frame, tpi)"}}),
    "there is no body 'frme'; did you mean 'frame'": ({}, {"observables": {"a": "point(frme, tip)"}}),
    r"'point' is written point\(body, point\)": ({}, {"observables": {"a": "point(frame)"}}),
    r"point\(frame, \[…\]\) has 2 components": ({}, {"observables": {"a": "point(frame, [0*metre, 0*metre])"}}),
    r"column 5: a list in brackets stands in point": ({}, {"observables": {"a": "sin([1, 2]) + point(frame, tip)"}}),
    "initial has what .* has as 'frame_r'": (
        {"initial": {"position": ["0 m", "0 m", "0 m"]}},
        {"initial": {"frame_r": "0 m"}},
    ),
    "needs a list of dimensions": ({"dims": "link"}, {}),
    "acts at the pivot, and moves nothing": (
        {"mass": None, "pivot": ["0 m", "0 m", "0 m"], "forces": {"f": {"force": ["0 N", "0 N", "1 N"]}}},
        {},
    ),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_no_body_can_be_is_said(message: str) -> None:
    """Assert one message for each wrong entry, which names it, its value and what is needed."""
    more, sections = REFUSED[message]
    with pytest.raises(xd.ModelError, match=message):
        of_body(more, **sections)


@pytest.mark.parametrize("name", ["1x", "_x", "", "a" * 21, "ä"])
def test_names_of_bodies_begin_those_of_coordinates(name: str) -> None:
    """Assert that a body has a short plain name, since others begin with it."""
    with pytest.raises(xd.ModelError, match="a body's name is a letter"):
        xd.Model(name="x", bodies={name: FRAME})


def test_three_bodies_whose_names_meet() -> None:
    """Assert that a point of one body is not what another stands for."""
    point = {"points": {"b_r": ["0 m", "0 m", "0 m"]}}
    with pytest.raises(xd.ModelError, match="both claim the name 'a_b_r'; rename one"):
        xd.Model(name="x", bodies={"a": FRAME | point, "a_b": FRAME})


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
    assert len(model.elements.constraints) == count
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
    values = {name: part.si for name, part in model.elements.statement.initial.items()}
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
