"""Bodies as a section of a model: what they stand for, how they are written again, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.bodies import FRAME, of_body
from xdynamics.expressions import Name
from xdynamics.expressions.evaluation import evaluate
from xdynamics.model.motion import constants, evaluate_motion


def test_a_body_is_coordinates_states_and_a_parameter_for_each_quantity() -> None:
    """Assert what a body makes, and that its numbers are parameters."""
    model = of_body()
    assert [*model.shaped.coordinates] == ["frame_r", "frame_turn"]
    assert [*model.shaped.states] == ["frame_q0", "frame_q"]
    assert [*model.shaped.parameters] == ["frame_mass", "frame_inertia_x", "frame_inertia_y", "frame_inertia_z"]
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
    assert xd.Model.from_text(text).statement == model.statement
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
    state = {name: quantity.si for name, quantity in model.statement.initial.items()}
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
    assert model.shaped.definitions["named"] == Name("frame_tip")
    assert model.shaped.definitions["centre_is"] == Name("frame_r")
    assert evaluate(model.expanded(model.observables["found"]), at_start(model)) == pytest.approx(-2.0, abs=4e-15)


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
