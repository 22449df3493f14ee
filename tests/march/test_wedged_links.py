"""Links that slide and wedge, so that no forces exist: slow slips are stopped by an impulse, fast ones end the run.

A bounce that is low, and would wedge were it skipped, is not: the link lands, and that impact stops the slip.

A rod whose lower end slides on a rough floor (P. Painlevé, C. R. Acad. Sci. 121, 1895, 112): with friction above
(1 + 3 cos² theta)/(3 sin theta cos theta) the floor would have to press ever more.
"""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.plain import made_by_hand, plain
from xdynamics.march.assembly.broad_phase import NEEDED, OUTSIDE, OUTSIDE_LINK, OUTSIDE_OF, TALLIES
from xdynamics.march.assembly.impact import DRAGS, FORCE, HALTED, NUMBERS, SLIP_ENDED, STATIC
from xdynamics.march.assembly.link_forces import check_cone
from xdynamics.schema import IMPACT

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


def test_a_low_bounce_that_would_wedge_is_not_skipped() -> None:
    """Assert that ends that leave at 0.1 mm/s, which would wedge on the floor, land 2 v/g later, and stick by that impact."""
    text = RODS.format(mu=1.8, slip=1.0)
    text = text.replace("v_x =", 'v_y = "1e-4*metre/second"\nv_x =')
    run = xd.simulate(xd.Model.from_text(text))
    assert run.run_outcome == "completed"
    strikes = run.event_kind.values == IMPACT
    assert np.count_nonzero(strikes) == 30
    assert run.event_time.values[strikes] == pytest.approx(np.full(30, 2e-4 / 9.80665), rel=1e-9)
    pressing, rubbing = np.linalg.solve([[1.6, -1.2], [-1.2, 3.4]], [1e-4, 1.0])
    assert rubbing < 1.8 * pressing  # so that ends stick
    turned = 6.0 * (np.sin(ANGLE) * rubbing - np.cos(ANGLE) * pressing)
    after = run.isel(step=run.event_row_after.values[strikes])
    assert after.v_theta.values == pytest.approx(np.full((30, 30), turned), rel=1e-9)


def test_links_beside_one_that_wedges_slide_on() -> None:
    """Assert that where one rod wedges, those beside it that no impulse within their cone stops slide on, as forces have it."""
    text = RODS.format(mu=1.8, slip=1e-3).replace('mu = "1.8"', 'mu = "where(index(rod) > 0.5, 1.2, 1.8)"')
    text = text.replace('mu = "', 'mu = { dims = ["rod"], value = "').replace('1.8)"', '1.8)" }')
    run = xd.simulate(xd.Model.from_text(text))
    assert run.run_outcome == "completed"
    assert run.a_theta.values[0, 0] == pytest.approx(-1.5 * 9.80665 * np.cos(ANGLE), rel=1e-12)
    pressed = 9.80665 / (1.6 - 1.2 * 1.2)
    assert run.a_x.values[0, 1:] == pytest.approx(np.full(29, 1.2 * pressed), rel=1e-9)


def test_impulses_outside_a_cone_are_counted() -> None:
    """Assert of three impulses that stopped slips, with a coefficient of 0.5, that one in the cone is not, and the worst is kept."""
    arrays = {"touching": np.zeros((1, NUMBERS)), "candidates": np.array([[3, 7, 0, 0, 1]])}
    run = made_by_hand(n=1, **arrays, counters=np.zeros(TALLIES, np.int64), spans=np.zeros(16))
    run.touching[0, STATIC], run.touching[0, HALTED] = 0.5, SLIP_ENDED
    run.touching[0, FORCE], run.touching[0, DRAGS] = 10.0, 2.0
    for rubbing, lasting in ((0.9, 0.2), (2.0, 0.2), (1.0, 0.0)):  # over 0.5*(pressing + 10*0.2) with 2*0.2 more
        plain(check_cone)(run, 0, 1.0, rubbing, lasting)
    assert run.counters[OUTSIDE] == 2
    assert run.spans[NEEDED] == pytest.approx(2.0, rel=1e-15)  # the last, of which no force helps
    assert run.counters[OUTSIDE_OF] == 3
    assert run.counters[OUTSIDE_LINK] == 7
