"""What a checked model says of itself in lines of text."""

from __future__ import annotations

import re

import pytest

import xdynamics as xd
from xdynamics.documenting.plain_text import model_lines
from xdynamics.march.configuration import settings_for
from xdynamics.methods import METHODS

ROAD = """name = "Wheel on a road"
coordinates = {{ x = {{ unit = "m" }}, z = {{ unit = "m" }} }}
parameters = {{ m = "45 kg", k = "200 kN m-1" }}
mass = {{ x = "m", z = "m" }}
forces.tyre.z = "k*(road - z)"
drives.road = {{ table = "road.csv", argument = "x", outside = "hold", csv = '''x [m],road [m]
{rows}''' }}
initial = {{ x = "0 m", v_x = "15 m s-1", z = "0 m" }}
"""
LINKS = """name = "Two links"
[bodies.upper]
mass = "1 kg"
inertia = ["1 g m2", "80 g m2", "80 g m2"]
points = { end = ["0.5 m", "0 m", "0 m"] }
initial.position = ["0.5 m", "0 m", "0.1 m"]
[bodies.lower]
mass = "1 kg"
inertia = ["1 g m2", "80 g m2", "80 g m2"]
initial.position = ["1.5 m", "0 m", "0 m"]
[joints.hip]
hinge = ["space", "upper"]
at = [["0 m", "0 m", "0 m"], ["-0.5 m", "0 m", "0 m"]]
axis = [0, 0, 1]
[joints.knee]
ball = ["upper", "lower"]
at = ["end", ["-0.5 m", "0 m", "0 m"]]
[constraints.plane]
holds = "lower_r[z]"
[initial]
consistent = true
"""
LATE = """name = "Late spring"
coordinates.x.unit = "m"
parameters = { m = "1 kg", k = "4 N m-1" }
mass.x = "m"
forces.spring.x = "-k*delayed(x, '0.2 s')"
initial.x = "1 m"
"""

ROW = """name = "Row of springs"
dimensions.site = 3
coordinates.x = {{ unit = "cm", dims = ["site"] }}
coordinates.z = {{ unit = "m", dims = ["site"] }}
coordinates.y.unit = "m"
states.s = {{ unit = "1", rate = "1/second" }}
parameters = {{ m = "1 kg", k = "4 N m-1", l = "0.1 m" }}
mass = {{ x = "m", y = "m", z = "m" }}
forces.spring.x = "-k*x"
[initial]
x = "{x}"
y = "{y}"
v_y = "0.30000000000000004 m s-1"
s = "l/metre*3"
z = {{ unit = "m", value = [1, 2, 0.30000000000000004] }}
"""


@pytest.mark.parametrize(("points", "fate"), [(20, "located"), (150, "landed on")])
def test_fate_of_switches_is_that_of_a_run(points: int, fate: str) -> None:
    """Assert that kinks of short tables are said to be located, and those of long ones landed on, as a run does by default."""
    rows = "".join(f"{0.1 * row!r},{0.01 * (row % 3)!r}\n" for row in range(points))
    model = xd.Model.from_text(ROAD.format(rows=rows))
    said = [line for line in model_lines(model) if line.startswith("switches")]
    assert len(said) == 1
    assert f"tyre.road: kinks and jumps inside forces, which are {fate}" in said[0]
    assert settings_for(model, method="dop853", until="1 s").switches == fate


def test_methods_that_take_delays_are_those_that_march_them() -> None:
    """Assert that a method is offered for delayed values just where settings with it are accepted."""
    model = xd.Model.from_text(LATE)
    offered = {line.split()[1].rstrip(":") for line in model_lines(model) if line.startswith("method ")}
    accepted = set()
    for name in METHODS:
        try:
            settings_for(model, method=name, step="10 ms", until="1 s").check(model)
        except xd.InputError:
            continue
        accepted.add(name)
    assert offered == accepted
    assert {"dop853", "rk4", "velocity_verlet"} <= accepted
    assert not {"taylor", "radau_iia", "yoshida6"} & accepted


KINDS = {
    "contacts of many links": "granular_box",
    "another law of impacts": "newtons_cradle_sequential",
    "Poisson's law with friction": "woodpecker",
    "dry friction": "stick_slip_belt",
    "a controller": "cart_pid",
    "states alone": "heat",
    "constraints": "four_bar",
    "links in a row": "links_pendulum",
    "forces alone": "kepler",
}


@pytest.mark.parametrize("name", KINDS.values(), ids=KINDS)
def test_methods_that_take_a_model_are_those_that_begin(name: str) -> None:
    """Assert that a method is listed where a march by it begins, and refused with the same reason where none does."""
    model = xd.Model.from_toml(f"data/models/{name}.toml")
    told = [line.split(maxsplit=1) for line in model_lines(model) if line.startswith(("method ", "not by "))]
    listed = {line.partition(":")[0] for key, line in told if key == "method"}
    reasons = {
        one: reason
        for key, line in told
        if key == "not"
        for names, _, reason in [line.removeprefix("by").strip().partition(": ")]
        for one in names.split(", ")
    }
    assert listed | reasons.keys() == METHODS.keys()
    for method in METHODS:
        settings = {"method": method, "step": model.run.get("step", "1 ms"), "until": model.run["until"]}
        if method in listed:
            assert settings_for(model, **settings).method.name == method
        else:
            with pytest.raises(xd.InputError, match=re.escape(reasons[method])):
                settings_for(model, **settings)


def test_joints_are_named_in_the_motion() -> None:
    """Assert that what joints and bodies stand for is named, not written out, what a user wrote is, and that starts move."""
    lines = list(model_lines(xd.Model.from_text(LINKS)))
    assert "motion    upper_mass*a_upper_r[x] = joint hip + joint knee" in lines
    assert "motion    lower_mass*a_lower_r[z] = (1)*constraint_force_plane + joint knee" in lines
    assert "constraint plane holds: lower_r[z] = 0" in lines
    assert "joint     hip: hinge of space and upper, about [0, 0, 1] in space; has hip_angle, v_hip_angle" in lines
    assert "body      upper: turns, with the attitude upper_q0, upper_q; points upper_end" in lines
    assert not [line for line in lines if line.startswith(("with ", "rate "))]
    assert next(line for line in lines if line.startswith("start ")).endswith(
        "; moved from there to where constraints hold"
    )


ROUGH = """
name = "rough balls"
[dimensions]
ball = 50
[relations.pair]
of = "ball"
neighbours = 1
[coordinates]
x = { unit = "m", dims = ["ball"] }
y = { unit = "m", dims = ["ball"] }
[parameters]
m = "1 kg"
[mass]
x = "m"
y = "m"
[contacts.balls]
gap = "second(y, pair) - first(y, pair)"
restitution = 0
tangential = "coulomb"
slip = "second(v_x, pair) - first(v_x, pair)"
friction = 0.3
[initial]
x = "0*metre"
y = "index(ball)*metre"
"""


@pytest.mark.parametrize(
    ("old", "new", "count"),
    [
        ("", "", 1),
        ("ball = 50", "ball = 49", 0),
        ('tangential = "coulomb"', 'tangential = "coulomb"\nlaw = "poisson"', 0),
    ],
)
def test_heaps_are_advised_to_step_over_impacts(old: str, new: str, count: int) -> None:
    """Assert that of fifty bodies that rub, and no fewer, Moreau's method is named before the march, if it takes them."""
    lines = [one for one in model_lines(xd.Model.from_text(ROUGH.replace(old, new))) if one.startswith("heap ")]
    assert len(lines) == count
    assert all("50 bodies may rub against each other by contact 'balls'" in one for one in lines)
    assert all(one.endswith("method = moreau_jean steps over them") for one in lines)


@pytest.mark.parametrize(
    ("y", "said"),
    [
        ("3*l", "0.3 m"),
        ("l/3", "0.0333333333333 m"),
        ("3e-20*l", "3e-21 m"),
        ("0.30000000000000004 m", "0.30000000000000004 m"),
        ("0.12345678901234567890123 m", "0.12345678901234567890123 m"),
    ],
)
def test_starts_are_as_written_or_without_what_rounding_leaves(y: str, said: str) -> None:
    """Assert all digits of starts that are written, and 12 of those that expressions give, also to each element."""
    model = xd.Model.from_text(ROW.format(x="l*(1 + index(site))", y=y))
    assert repr(model.initial["x·2"].value) == "30.000000000000004"
    (start,) = [line for line in model_lines(model) if line.startswith("start")]
    parts = dict(part.split(" = ") for part in start.removeprefix("start").strip().split(", "))
    assert [parts[f"x[{i}]"] for i in range(3)] == ["10.0 cm", "20.0 cm", "30.0 cm"]
    assert parts["y"] == said
    assert parts["s"] == "0.3"
    assert (parts["v_y"], parts["z[2]"]) == ("0.30000000000000004 m s-1", "0.30000000000000004 m")
