"""Dry friction with true stick: against closed forms."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import FITTING, G, asked, dry, sliding, state_of, words

STOPS = 0.43240777557053784 + math.pi * np.arange(8)
STUCK, THERE = 22.42355635069909, 0.68217893672364685
BELT: dict[str, Any] = {
    "name": "belt",
    "coordinates": {"x": "m"},
    "parameters": {"m": "1 kg", "k": "10 N m-1", "load": "10 N", "mu_k": "0.2", "mu_s": "0.4", "v": "0.1 m s-1"},
    "mass": {"x": "m"},
    "forces": {"spring": {"potential": "k*x**2/2"}},
    "initial": {"x": "0 m", "v_x": "0.1 m s-1"},
    "frictions": {"belt": {"slip": "v_x - v", "kinetic": "mu_k*load", "static": "mu_s*load"}},
}


@pytest.mark.every(3)
@pytest.mark.parametrize("method", FITTING)
def test_an_oscillator_turns_and_sticks(method: str) -> None:
    """Assert turning points that fall by 2 each, and where and when it sticks."""
    fine = asked(method, step=2e-4 if xd.METHODS[method].order < 4 else 0.01, rtol=1e-12)
    run = xd.simulate(dry(), until=30.0, **fine | ({"atol": 1e-12} if "rtol" in fine else {}))
    slack = 3e-6 if xd.METHODS[method].order < 4 else 3e-8
    assert words(run) == [("plane", "slip")] * 7 + [("plane", "stick")]
    assert run.event_time.values == pytest.approx(STOPS, abs=slack)
    turned = run.x.values[run.event_row_before.values]
    assert -np.diff(np.abs(turned[:-1])) == pytest.approx(2.0, abs=slack)
    assert float(run.x[-1]) == pytest.approx(THERE, abs=2 * slack)
    assert (run.v_x.values[run.time.values > STUCK + 1e-3] == 0.0).all()
    assert float(run.friction_force_plane[-1]) == pytest.approx(THERE, abs=2 * slack)
    assert state_of(run, "friction_state_plane") == "sticking"


def test_a_block_slides_to_a_stop() -> None:
    """Assert time and place of the stop, the force on either side, and that it stays there."""
    run = xd.simulate(sliding(), method="rk4", step=0.1, until=2.0)
    assert words(run) == [("floor", "stick")]
    assert float(run.event_time[0]) == pytest.approx(3 / (0.3 * G), abs=1e-15)
    assert float(run.x[-1]) == pytest.approx(9 / (0.6 * G), abs=1e-15)
    before, after = int(run.event_row_before[0]), int(run.event_row_after[0])
    assert run.friction_force_floor.values[[before, after]] == pytest.approx([-0.6 * G, 0.0], abs=1e-14)
    assert run.contact_force_floor.values == pytest.approx(2 * G, rel=1e-15)


@pytest.mark.parametrize(("alpha", "static", "ends"), [(0.3, 0.5, "stick"), (0.5, 0.5, "slip"), (0.3, 0.301, "slip")])
def test_a_block_pushed_up_an_incline(alpha: float, static: float, ends: str) -> None:
    """Assert that it turns or stays where it stops, as tan(alpha) is over the static coefficient or not."""
    model = sliding(
        parameters={"m": "2 kg", "g": f"{G} m s-2", "mu": "0.3", "alpha": f"{alpha} rad", "pull": "0 N"},
        initial={"x": "0 m", "v_x": "-2 m s-1", "y": "0 m", "v_y": "0 m s-1"},
        contacts={
            "floor": {
                "gap": "y",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": "mu",
                "static": static,
            }
        },
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=2.0)
    up, down = (G * (math.sin(alpha) + one * 0.3 * math.cos(alpha)) for one in (1, -1))
    assert words(run) == [("floor", ends)]
    assert float(run.event_time[0]) == pytest.approx(2 / up, abs=1e-15)
    rest = 2.0 - 2 / up
    assert float(run.v_x[-1]) == pytest.approx(0.0 if ends == "stick" else down * rest, abs=1e-13)
    held = -2 * G * math.sin(alpha) if ends == "stick" else -0.6 * G * math.cos(alpha)
    assert float(run.friction_force_floor[-1]) == pytest.approx(held, rel=1e-13)


@pytest.mark.parametrize("method", ["velocity_verlet", "rk4", "dop853"])
def test_a_mass_on_a_belt_sticks_and_slips(method: str) -> None:
    """Assert that it is carried until the spring is as strong as static friction, and caught again."""
    run = xd.simulate(xd.Model(**BELT), until=20.0, **asked(method, step=0.001, rtol=1e-10))
    assert words(run) == [("belt", "slip"), ("belt", "stick")] * 3 + [("belt", "slip")]
    w = math.sqrt(10.0)
    # it swings about 0.2 m from 0.4 m on, with the belt's speed, until it has that again
    slips = (math.pi + 2 * math.atan2(0.1, 0.2 * w)) / w
    assert np.diff(run.event_time.values)[0] == pytest.approx(slips, abs=1e-6)
    assert float(run.event_time[0]) == pytest.approx(4.0, abs=1e-12)
    stuck = run.friction_state_belt.values == 1
    assert run.v_x.values[stuck] == pytest.approx(0.1, abs=1e-15)
    assert np.abs(run.friction_force_belt.values[stuck]).max() <= 4.0 + 1e-9


def test_a_force_that_grows_breaks_a_block_loose() -> None:
    """Assert the time at which a pull is as strong as static friction, and the acceleration behind it."""
    model = sliding(
        forces={"gravity": {"potential": "m*g*y"}, "pull": {"x": "5*newton*t/second"}},
        initial={"x": "0 m", "v_x": "0 m s-1", "y": "0 m", "v_y": "0 m s-1"},
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=3.0)
    loose = 0.6 * G / 5
    assert words(run) == [("floor", "slip")]
    assert float(run.event_time[0]) == pytest.approx(loose, abs=1e-14)
    late = 3.0 - loose
    assert float(run.v_x[-1]) == pytest.approx(5 * late**2 / 4, rel=1e-12)


def test_a_load_that_jumps_breaks_it_loose_at_once() -> None:
    """Assert a slip right behind a node of a measured load, and that the friction is the new one."""
    from io import StringIO

    model = sliding(
        drives={
            "pull": {
                "table": "pull.csv",
                "csv": StringIO("t [s],pull [N]\n0,0\n1,20\n9,20\n").getvalue(),
                "interpolation": "previous",
            }
        },
        parameters={"m": "2 kg", "g": f"{G} m s-2", "mu": "0.3"},
        forces={"gravity": {"potential": "m*g*y"}, "pull": {"x": "pull"}},
        initial={"x": "0 m", "v_x": "0 m s-1", "y": "0 m", "v_y": "0 m s-1"},
    )
    run = xd.simulate(model, method="rk4", step=0.3, until=2.0)
    assert words(run) == [("floor", "slip")]
    assert float(run.event_time[0]) == pytest.approx(1.0, abs=2e-12)
    assert float(run.v_x[-1]) == pytest.approx((20 - 0.6 * G) / 2, rel=1e-11)


def test_friction_never_gives_energy() -> None:
    """Assert that the energy of a sliding oscillator never rises from row to row."""
    run = xd.simulate(dry(), method="dop853", rtol=1e-11, atol=1e-11, until=30.0)
    assert (np.diff(run.total_energy.values) < 1e-9).all()


def test_friction_that_pushes_is_an_outcome() -> None:
    """Assert that a negative friction that no reader could see ends the run, with its value."""
    import tomllib

    statement = tomllib.loads(dry().to_toml()) | {"frictions": {"plane": {"slip": "v_x", "kinetic": "f - f*t/second"}}}
    run = xd.simulate(xd.Model(**statement), method="rk4", step=0.1, until=5.0)
    assert run.attrs["run_outcome"] == "contact_undetermined"
    assert re.search(r"the friction of 'plane' is -2\.\d+ while it slips", run.attrs["run_outcome_text"])


@pytest.mark.parametrize(
    ("friction", "said"),
    [
        ({"slip": "v_x"}, "key 'kinetic' is missing"),
        ({"slip": "v_x", "kinetic": "k"}, "kinetic has units 'kg s-2'"),
        ({"slip": "x", "kinetic": "f"}, "slip depends on no velocity"),
        ({"slip": "v_x", "kinetic": "f", "law": "newton"}, "key 'law' is not known"),
        ({"slip": "v_y", "kinetic": "f"}, "v_y"),
    ],
)
def test_wrong_frictions_are_named(friction: dict[str, Any], said: str) -> None:
    """Assert one clear fault."""
    import tomllib

    with pytest.raises(xd.ModelError, match=f"friction 'plane': .*{said}"):
        xd.Model(**tomllib.loads(dry().to_toml()) | {"frictions": {"plane": friction}})


ROLLING = """
name = "ball on a lane"
[coordinates]
x = "m"
theta = "rad"
[parameters]
m = "6 kg"
R = "0.1 m"
g = "9.81 m s-2"
mu = 0.2
[mass]
x = "m"
theta = "2/5*m*R**2/radian**2"
[frictions.lane]
slip = "v_x - R*v_theta/radian"
kinetic = "mu*m*g"
[initial]
x = "0 m"
theta = "0 rad"
v_x = "7 m s-1"
v_theta = "-10 rad s-1"
"""


def test_a_ball_with_backspin_slides_and_then_rolls() -> None:
    """Assert when it begins to roll and how fast: 5/7 of its speed and 2/7 of that of its turning, without a force then."""
    run = xd.simulate(xd.Model.from_text(ROLLING), method="dop853", rtol=1e-10, until="3 s")
    first, turning, gravity = 7.0, -10.0 * 0.1, 9.81
    assert run.event_time.values == pytest.approx([2 / 7 * (first - turning) / (0.2 * gravity)], rel=1e-12)
    assert run.v_x.values[-1] == pytest.approx(5 / 7 * first + 2 / 7 * turning, rel=1e-12)
    assert run.friction_force_lane.values[[0, -1]] == pytest.approx([-0.2 * 6 * gravity, 0.0], abs=1e-12)


def test_a_driven_ball_slips_where_rolling_needs_too_much_and_grips_again() -> None:
    """Assert that the torque at which rolling ends is Coulomb's, and that it rolls again where slip has come back to zero."""
    rolling = ROLLING.replace('v_x = "7 m', 'v_x = "0 m').replace('"-10 rad', '"0 rad')
    driven = rolling + '[forces.motor]\ntheta = "3*newton*metre/second*t - newton*metre/second**2*t**2"\n'
    run = xd.simulate(xd.Model.from_text(driven), method="dop853", rtol=1e-11, until="3.4 s")
    limit = 1.4 * 0.1 * 0.2 * 6 * 9.81  # N m: (1 + 2/5) R mu m g
    slipping = np.roots([-1.0, 3.0, -limit])
    start = float(slipping.min())
    # m R ds/dt = (1 + 5/2) mu m g R - 5/2 torque, so with the torque's integral 5/2 (limit t - 3/2 t**2 + t**3/3) is level
    level = np.array([1 / 3, -1.5, limit, 0.0])
    level[-1] = -np.polyval(level, start)
    ends = np.roots(level)
    grip = float(ends[(abs(ends.imag) < 1e-9) & (ends.real > start + 1e-3)].real.min())
    assert run.event_time.values == pytest.approx([start, grip], rel=1e-9)
    sticking = (run.time < start) | (run.time > grip)
    assert abs((run.v_x - 0.1 * run.v_theta).where(sticking, 0.0)).max() < 1e-9
    assert float(abs(run.v_x - 0.1 * run.v_theta).max()) > 0.01
