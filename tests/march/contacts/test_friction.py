"""Dry friction with true stick: against closed forms.

Contacts and friction under forces that jump: what holds is judged by the force behind the jump.
"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.contacts import FITTING, G, asked, dry, sliding, state_of, words
from cases.plain import made_by_hand, plain
from xdynamics.march.contacts import balance
from xdynamics.march.outcomes import CONTACT_VIOLATED, RUNNING
from xdynamics.march.run import DETECTOR, WATCH
from xdynamics.model.detectors import PULL

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


REST = {"y": "0 m", "v_y": "0 m s-1"}
FLOOR = {"floor": {"gap": "y", "restitution": 0.0}}
MARCHES = (
    ("dormand_prince", {"rtol": 1e-8, "atol": 1e-9}),
    ("dop853", {"rtol": 1e-8, "atol": 1e-9}),
    ("taylor", {"rtol": 1e-8, "atol": 1e-9}),
    ("dprkn6", {"rtol": 1e-8, "atol": 1e-9}),
    ("rk4", {"step": "10 ms"}),
    ("velocity_verlet", {"step": "10 ms"}),
)
# each a force on a body of 1 kg that jumps from 0 to 20 N after a second
JUMPS = {
    "where": "where(t < second, 0*newton, 20*newton)",
    "sign": "10*newton*(1 + sign(t - second))",
    "floor": "20*newton*min(floor(t/second), 1)",
    "mod": "20*newton*where(mod(t/(4*second), 1) < 0.25, 0, 1)",
}


def box(lift: str, **more: Any) -> xd.Model:
    """A box of 1 kg that rests on a floor, under its weight and a force upwards."""
    statement = {
        "name": "box",
        "coordinates": {"y": "m"},
        "parameters": {"m": "1 kg", "g": "9.81 m s-2"},
        "mass": {"y": "m"},
        "forces": {"weight": {"potential": "m*g*y"}, "lift": {"y": lift}},
        "contacts": FLOOR,
        "initial": REST,
    }
    return xd.Model(**statement | more)


def slider(push: str, load: str = "10*newton", static: float = 0.5) -> xd.Model:
    """A block of 1 kg on dry friction, under a push."""
    return box(
        push,
        forces={"push": {"y": push}},
        contacts={},
        frictions={"table": {"slip": "v_y", "kinetic": f"0.5*{load}", "static": f"{static}*{load}"}},
    )


def marched(model: xd.Model, method: str = "dormand_prince", until: str = "3 s", **how: Any) -> xr.Dataset:
    """March a model by a method."""
    return xd.simulate(model, method=method, until=until, **(how or dict(MARCHES)[method]))


@pytest.mark.every(5)
@pytest.mark.parametrize(("method", "how"), MARCHES)
@pytest.mark.parametrize("lift", JUMPS.values(), ids=JUMPS)
def test_a_box_takes_off_where_a_force_lifts_it_by_a_jump(lift: str, method: str, how: dict[str, Any]) -> None:
    """Assert the height of 20.38 m, two seconds behind the jump, and that the floor never pulls."""
    run = marched(box(lift), method, **how)
    assert float(run.y[-1]) == pytest.approx(0.5 * (20 - 9.81) * 4, rel=1e-9)
    assert float(run.contact_force_floor.min()) >= 0.0


def test_the_row_behind_a_jump_has_the_forces_of_its_own_side() -> None:
    """Assert the floor's force on both sides of the jump, and the take-off beside the switch."""
    run = marched(box(JUMPS["where"]))
    row = int(run.event_row_before[0])
    assert run.contact_force_floor.values[[row, row + 1]] == pytest.approx([9.81, 0.0], abs=1e-12)
    assert run.a_y.values[[row, row + 1]] == pytest.approx([0.0, 10.19], abs=1e-12)


@pytest.mark.parametrize("push", JUMPS.values(), ids=JUMPS)
def test_a_block_slips_where_a_push_jumps_beyond_its_friction(push: str) -> None:
    """Assert 0.5 (20 - 5) 2**2 m against 5 N."""
    assert float(marched(slider(push)).y[-1]) == pytest.approx(30.0, rel=1e-9)


def test_a_block_slips_where_its_load_falls_by_a_jump() -> None:
    """Assert that 4 N move a block once its friction falls from 5 to 1 N."""
    run = marched(slider("4*newton", load="where(t < second, 10*newton, 2*newton)"))
    assert float(run.y[-1]) == pytest.approx(0.5 * 3 * 4, rel=1e-9)


def test_a_jump_by_another_coordinate_lifts() -> None:
    """Assert that a magnet that a second body reaches after a second lifts the box."""
    still = {"x": "0 m", "v_x": "1 m s-1"} | REST
    model = box(
        "where(x < metre, 0*newton, 20*newton)",
        coordinates={"x": "m", "y": "m"},
        mass={"x": "m", "y": "m"},
        initial=still,
    )
    assert float(marched(model).y[-1]) == pytest.approx(20.38, rel=1e-9)


def test_a_coulomb_contact_lets_go_and_slips() -> None:
    """Assert a push of 10 N against 5 N of friction, a load that falls, and a lift, each by a jump."""
    slip = {"floor": FLOOR["floor"] | {"tangential": "coulomb", "slip": "v_x", "friction": "0.5"}}
    plane = {"coordinates": {"x": "m", "y": "m"}, "mass": {"x": "m", "y": "m"}, "contacts": slip}
    start = {"initial": {"x": "0 m", "v_x": "0 m s-1"} | REST}
    weight = {"y": "-10*newton"}
    pushed = box("", **plane, **start, forces={"weight": weight, "push": {"x": f"{JUMPS['where']}/2"}})
    assert float(marched(pushed).x[-1]) == pytest.approx(10.0, rel=1e-9)
    lighter = {"weight": {"y": "-where(t < second, 10*newton, 2*newton)"}, "push": {"x": "4*newton"}}
    assert float(marched(box("", **plane, **start, forces=lighter)).x[-1]) == pytest.approx(6.0, rel=1e-9)
    lifted = box("", **plane, **start, forces={"weight": weight, "lift": {"y": JUMPS["where"]}})
    assert float(marched(lifted).y[-1]) == pytest.approx(20.0, rel=1e-9)


@pytest.mark.parametrize(
    "push", ["max(0, sign(sin(pi*t/second)))", "where(sign(t) > 0, 1, 0)", "where(t > 0*second, 1, 0)"]
)
def test_a_switch_that_is_zero_at_the_start_holds_from_there(push: str) -> None:
    """Assert that 10 N push a block from the start on that 8 N would hold and 7 N slow: 1.5 m in a second."""
    block = slider(f"10*newton*{push}", load="14*newton", static=8 / 14)
    assert float(marched(block, until="1 s").y[-1]) == pytest.approx(1.5, rel=1e-9)


def test_an_impact_turns_the_sign_that_a_force_has() -> None:
    """Assert a ball thrown down on a floor under drag by the sign of its velocity: up with the reversed drag, and down."""
    drag = {"weight": {"y": "-10*newton"}, "drag": {"y": "-2*newton*sign(v_y)"}}
    ball = box(
        "", forces=drag, contacts={"floor": {"gap": "y", "restitution": 1.0}}, initial={"y": "1 m", "v_y": "0 m s-1"}
    )
    run = marched(ball, until="1.0 s")
    fall = np.sqrt(2 / 8)  # under 8 N down to the floor, with 4 m/s; then up under 12 N
    assert float(run.event_time[0]) == pytest.approx(fall, abs=1e-9)
    assert float(run.event_time[1]) == pytest.approx(fall + 4 / 12, abs=1e-9)
    t = 1.0 - fall - 1 / 3
    assert float(run.y[-1]) == pytest.approx(16 / 24 - 4 * t * t, abs=1e-9)


@pytest.mark.parametrize(("value", "status"), [(-1.0, CONTACT_VIOLATED), (-1e-12, RUNNING), (1.0, RUNNING)])
def test_a_row_in_which_a_contact_pulls_ends_the_run(
    monkeypatch: pytest.MonkeyPatch, value: float, status: int
) -> None:
    """Assert that a force beyond its rounding ends the run, and one within it does not."""
    detectors, watches = np.zeros(1, DETECTOR), np.zeros(1, WATCH)
    detectors["role"], watches["guard"] = PULL, 1
    run = made_by_hand(detectors=detectors, watches=watches, balance=np.zeros(9), g1=np.array([value]))
    check = plain(balance.check_contact_law)
    monkeypatch.setitem(check.__globals__, "allowed_residue", lambda *_: 1e-12)
    monkeypatch.setitem(check.__globals__, "call_law", lambda *_: None)
    check(run, 0.0)
    assert int(run.now[0].status) == status
