"""Slopes of motions that constraints keep, by variational equations, against differences of runs."""

from __future__ import annotations

import re

import pytest

import xdynamics as xd
from xdynamics.budgeting.measurand import Target
from xdynamics.budgeting.physical import variational_slopes
from xdynamics.dynamics.variational import NotVariedError

ROD = """
name = "rod with drag"
[coordinates]
x = "m"
y = "m"
[parameters]
m = "2 ± 0.01 kg"
L = "1.5 ± 0.001 m"
g = "9.81 ± 0.01 m s-2"
c = "0.3 ± 0.01 kg s-1"
[mass]
x = "m"
y = "m"
[forces.weight]
potential = "m*g*y"
[forces.drag]
x = "-c*v_x"
y = "-c*v_y"
[constraints.rod]
holds = "sqrt(x**2 + y**2) - L"
[events.low]
function = "v_y"
direction = "rising"
[initial]
x = "1.5 ± 0.002 m"
y = "0 m"
v_x = "0 m s-1"
v_y = "-1 ± 0.01 m s-1"
consistent = true
"""
TWICE = '[constraints.again]\nholds = "(x**2 + y**2 - L**2)/(1*metre)"\n[events'
VALUES = {"m": 2.0, "L": 1.5, "g": 9.81, "c": 0.3, "x": 1.5, "v_y": -1.0}
SETTINGS = {"method": "dop853", "rtol": 1e-12, "until": 1.3}


def differences(text: str, name: str, quantity: str) -> float:
    """The slope of a quantity at the end, by runs on both sides."""
    h, ends = 1e-5, []
    for value in (VALUES[name] + h, VALUES[name] - h):
        moved = re.sub(rf'^{name} = "\S+', f'{name} = "{value!r}', text, flags=re.MULTILINE)
        assert moved != text
        ends.append(float(xd.simulate(xd.Model.from_text(moved), **SETTINGS)[quantity][-1]))
    return (ends[0] - ends[1]) / (2 * h)


@pytest.mark.parametrize("text", [ROD, ROD.replace("[events", TWICE)], ids=["rod", "held twice"])
def test_slopes_of_a_rod_are_those_of_differences(text: str) -> None:
    """Assert that lengths, loads and starts, which follow the rod, have the slopes that runs beside it show."""
    model = xd.Model.from_text(text)
    run = xd.simulate(model, **SETTINGS)
    for quantity in ("x", "v_y"):
        slopes = variational_slopes(run, model, Target(quantity, at=1.3), list(VALUES))
        assert slopes["x"] == pytest.approx(0.0, abs=1e-12)  # the rod takes it back
        for name in ("m", "L", "g", "c", "v_y"):
            assert slopes[name] == pytest.approx(differences(text, name, quantity), rel=1e-7), name


def test_a_start_that_may_not_follow_is_varied_by_what_the_rod_allows() -> None:
    """Assert that without consistent = true a length has no slope, as it would leave the start, and a load has."""
    text = ROD.replace("consistent = true\n", "")
    model = xd.Model.from_text(text)
    run = xd.simulate(model, **SETTINGS)
    with pytest.raises(NotVariedError, match="moves the start from where constraints hold"):
        variational_slopes(run, model, Target("x", at=1.3), ["L"])
    slopes = variational_slopes(run, model, Target("x", at=1.3), ["g", "v_y"])
    assert slopes["g"] == pytest.approx(differences(text, "g", "x"), rel=1e-7)


def test_the_time_of_an_event_has_slopes_on_a_rod() -> None:
    """Assert that the lowest point's time moves with gravity and length as in closed form without drag."""
    still = ROD.replace('c = "0.3 ± 0.01', 'c = "0 ± 0.01').replace('v_y = "-1 ± 0.01', 'v_y = "0 ± 0.01')
    model = xd.Model.from_text(still)
    run = xd.simulate(model, **SETTINGS | {"until": 2.0})
    time = float(run.event_time[0])
    slopes = variational_slopes(run, model, Target("t", event="low", occurrence=1), ["g", "L"])
    assert slopes["g"] == pytest.approx(-time / (2 * 9.81), rel=1e-8)  # t ~ sqrt(L/g)
    assert slopes["L"] == pytest.approx(time / (2 * 1.5), rel=1e-8)


def test_exponents_of_a_rod_with_drag_are_those_of_its_angle() -> None:
    """Assert that a constrained motion has two exponents per freedom, both -c/(2 m) about rest, and none of the rod."""
    resting = ROD.replace('x = "1.5 ± 0.002 m"\ny = "0 m"', 'x = "0 m"\ny = "-1.5 m"').replace("v_y = ", "v_z = ")
    resting = resting.replace('v_x = "0 m s-1"\nv_z = "-1 ± 0.01 m s-1"', 'v_x = "0 m s-1"\nv_y = "0 m s-1"')
    run = xd.simulate(xd.Model.from_text(resting), method="dop853", rtol=1e-10, until="60 s")
    found = xd.diagnose(run, lyapunov=True)
    assert found.lyapunov_exponents.values == pytest.approx([-0.075, -0.075], abs=1e-3)
    assert float(found.lyapunov_exponents.sum()) == pytest.approx(-0.15, abs=1e-4)
    lazily = xd.diagnose(run, lyapunov=True, compute=False, occurrences=3)
    assert lazily.lyapunov_exponents.shape == (2,)
