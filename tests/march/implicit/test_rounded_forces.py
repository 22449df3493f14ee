"""Implicit steps of what large forces leave when they cancel: it has no digits by which equations could be solved."""

import numpy as np
import pytest

import xdynamics as xd

HUNG = """
name = "A mass between two stiff springs"

[coordinates]
x = "m"
y = "m"

[parameters]
m = "5 kg"
k = "1e6 N/m"
g = "9.81 m s-2"
at_left = "-0.6 m"
at_right = "0.8 m"
length = "0.91 m"

[mass]
x = "m"
y = "m"

[forces.left]
potential = "k*(sqrt((x - at_left)**2 + y**2) - length)**2/2"

[forces.right]
potential = "k*(sqrt((x - at_right)**2 + y**2) - length)**2/2"

[forces.weight]
y = "-m*g"

[initial]
x = "0.1 m"
y = "-0.58 m"
v_x = "0 m/s"
v_y = "0 m/s"
"""
NET = """
name = "A net"

[dimensions]
row = 9
column = 9
axis = ["x", "y", "z"]

[relations.along]
of = "row"
neighbours = 1

[relations.across]
of = "column"
neighbours = 1

[coordinates]
r = { unit = "m", dims = ["row", "column", "axis"] }

[parameters]
m = "0.1 kg"
k = "1e5 N/m"
k_ground = "2e3 N/m"
length = "0.1 m"
g = "9.81 m s-2"
down = { dims = ["axis"], values = { x = "0", y = "0", z = "-1" } }
place_x = { dims = ["row"], value = "index(row)*0.1*metre" }
place_y = { dims = ["column"], value = "index(column)*0.1*metre" }
ex = { dims = ["axis"], values = { x = "1", y = "0", z = "0" } }
ey = { dims = ["axis"], values = { x = "0", y = "1", z = "0" } }

[mass]
r = "m"

[forces.threads]
over = "along"
potential = "k*sum((norm(second(r, along) - first(r, along), axis) - length)**2, column)/2"

[forces.weft]
over = "across"
potential = "k*sum((norm(second(r, across) - first(r, across), axis) - length)**2, row)/2"

[forces.ground]
potential = "k_ground*sum((r - place_x*ex - place_y*ey)**2, axis)/2"

[forces.weight]
potential = "-m*g*sum(r*down, axis)"

[initial]
r = "place_x*ex + place_y*ey"
v_r = "0*metre/second*(1 + 0*index(row))"
"""


STEPS = ("10 us", "0.5 ms", "1 ms")


@pytest.mark.parametrize("text", [HUNG, NET], ids=["hung", "net"])
@pytest.mark.parametrize(("method", "order"), [("radau_iia", 5), ("implicit_midpoint", 2)])
def test_steps_are_solved_as_far_as_the_forces_tell(text: str, method: str, order: int) -> None:
    """Assert that all steps have a solution, and that the error falls as the method's order says, down to rounding."""
    model, asked = xd.Model.from_text(text), {"until": "4 ms", "log": "states", "force_samples": "none"}
    exact = xd.simulate(model, method="dop853", rtol=1e-13, **asked)
    errors = []
    for step in STEPS:
        run = xd.simulate(model, method=method, step=step, **asked)
        assert run.attrs["run_outcome"] == "completed"
        names = [name for name in ("x", "y", "r") if name in run]
        errors.append(max(float(abs(run[name][-1] - exact[name][-1]).max()) for name in names))
    assert errors[2] < 1e-4
    assert np.log2(errors[2] / errors[1]) > order - 0.2
    assert errors[0] <= max(errors[1] / 50.0**order * 1.1, 1e-14)
