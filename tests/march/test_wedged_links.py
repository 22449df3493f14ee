"""Links that slide and wedge, so that no forces exist: slow slips are stopped by an impulse, fast ones end the run.

A rod whose lower end slides on a rough floor (P. Painlevé, C. R. Acad. Sci. 121, 1895, 112): with friction above
(1 + 3 cos² theta)/(3 sin theta cos theta) the floor would have to press ever more.
"""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.faults import AccuracyWarning

RODS = """
name = "rods on a rough floor"
[dimensions]
rod = 30
[coordinates]
x = {{ unit = "m", dims = ["rod"] }}
y = {{ unit = "m", dims = ["rod"] }}
theta = {{ unit = "rad", dims = ["rod"] }}
[parameters]
g = "9.80665 m s-2"
length = "1 m"
mu = "{mu}"
start = "1.1071487177940904 rad"
[mass]
x = "1*kilogram"
y = "1*kilogram"
theta = "kilogram*length**2/12/radian**2"
[forces.weight]
y = "-g*kilogram"
[contacts.floor]
gap = "y - length/2*sin(theta)"
restitution = 0
tangential = "coulomb"
slip = "v_x + length/2*sin(theta)*v_theta/radian"
friction = "mu"
rest_height = "1e-7 m"
[initial]
x = "3*metre*index(rod)"
y = "length/2*sin(start)"
theta = "start"
v_x = "-{slip}*metre/second"
[run]
method = "velocity_verlet"
step = "1 ms"
until = "5 ms"
"""
ANGLE = np.arctan(2.0)


def test_a_slow_slip_that_wedges_stops() -> None:
    """Assert that the end sticks after the first step at the latest, and that the rod then turns about it, as a pendulum upside down does."""
    run = xd.simulate(xd.Model.from_text(RODS.format(mu=1.8, slip=1e-3)))
    assert run.run_outcome == "completed"
    assert run.a_theta.values[0] == pytest.approx(-1.5 * 9.80665 * np.cos(ANGLE), rel=1e-12)
    effects = np.array([[1.6, -1.2], [-1.2, 3.4]])  # of a unit pressing and rubbing at the end on its rates
    pressing, rubbing = np.linalg.solve(effects, [0.0, 1e-3])
    turned = 6.0 * (np.sin(ANGLE) * rubbing - np.cos(ANGLE) * pressing)  # by the impulse that stops the end
    fallen = turned - 1.5 * 9.80665 * np.cos(ANGLE) * 5e-3
    assert run.v_theta.values[-1] == pytest.approx(fallen, rel=2e-4)
    ends = run.x.values[-1] - np.cos(run.theta.values[-1]) / 2
    assert ends == pytest.approx(run.x.values[0] - np.cos(ANGLE) / 2, abs=1.001e-6)  # a step of the slip


def test_a_slow_slip_that_has_forces_goes_on() -> None:
    """Assert that with less friction than wedges the end slides, however slowly, and is braked as forces have it."""
    run = xd.simulate(xd.Model.from_text(RODS.format(mu=1.2, slip=1e-3)))
    pressed = 9.80665 / (1.6 - 1.2 * 1.2)  # m s-2: of the floor, for a mass
    assert run.a_x.values[0] == pytest.approx(1.2 * pressed, rel=1e-9)


def test_a_fast_slip_that_wedges_ends_the_run() -> None:
    """Assert the outcome in words where an impulse would take more than what may be skipped."""
    run = xd.simulate(xd.Model.from_text(RODS.format(mu=1.8, slip=1.0)))
    assert run.run_outcome == "contact_undetermined"
    assert "forces" in run.run_outcome_text


def test_a_slip_that_is_stopped_outside_its_cone_is_told() -> None:
    """Assert that where one rod wedges, those beside it that friction cannot stop at once are told, and by how much."""
    text = RODS.format(mu=1.8, slip=1e-3).replace('mu = "1.8"', 'mu = "where(index(rod) > 0.5, 1.2, 1.8)"')
    with pytest.warns(AccuracyWarning, match="29 of the slow slips"):
        run = xd.simulate(
            xd.Model.from_text(text.replace('mu = "', 'mu = { dims = ["rod"], value = "').replace('1.8)"', '1.8)" }'))
        )
    assert f"{1.6 / 1.2 / 1.2:.3g} times what its friction allows" in run.run_outcome_text
    assert "'floor' of " in run.run_outcome_text
