"""Contacts and friction under forces that jump: what holds is judged by the force behind the jump."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.plain import made_by_hand, plain
from xdynamics.march.contacts import balance
from xdynamics.march.outcomes import CONTACT_VIOLATED, RUNNING
from xdynamics.march.run import DETECTOR, WATCH
from xdynamics.model.detectors import PULL

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
