"""Jumps and kinks in the expressions of friction, located like those of forces."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd

METHODS = (
    ("dormand_prince", {"rtol": 1e-9}),
    ("dop853", {"rtol": 1e-9}),
    ("rk4", {"step": "70 ms"}),
    ("position_verlet", {"step": "70 ms"}),
)


def wheel(kinetic: str, **more: Any) -> xd.Model:
    """A flywheel of 2 kg m2 that turns with 10 rad/s, and a brake."""
    return xd.Model(
        name="flywheel",
        coordinates={"q": "rad"},
        parameters={"J": "2 kg m2"},
        mass={"q": "J/radian**2"},
        forces={"none": {"q": "0*newton*metre/radian"}},
        frictions={"brake": {"slip": "v_q", "kinetic": kinetic}},
        initial={"q": "0 rad", "v_q": "10 rad s-1"},
        **more,
    )


@pytest.mark.parametrize(("method", "how"), METHODS)
def test_a_brake_that_is_applied_by_a_jump_stops_in_time(method: str, how: dict[str, Any]) -> None:
    """Assert 8 N m from 1 s on: at rest after 3.5 s, and 22.5 rad; the jump is an event of the brake."""
    run = xd.simulate(wheel("where(t < second, 0, 8)*newton*metre/radian"), method=method, until="5 s", **how)
    assert float(run.q[-1]) == pytest.approx(22.5, abs=1e-9)
    assert run.event_time.values == pytest.approx([1.0, 3.5], abs=1e-9)


def test_friction_of_its_own_slip_has_no_switch() -> None:
    """Assert that `abs` of the slip is no event beside the stop of the slip itself."""
    stribeck = "(4 + 4*exp(-abs(v_q)/(radian/second)))*newton*metre/radian"
    run = xd.simulate(wheel(stribeck), method="dop853", rtol=1e-9, until="5 s")
    assert run.event_detector.attrs["flag_meanings"].split() == ["brake"]


def test_friction_of_a_contact_has_its_switches_located() -> None:
    """Assert a block that slides with 2 m/s on a floor whose friction begins at 1 m: 0.2 s2 m-1 of way beyond it."""
    block = xd.Model(
        name="block",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg"},
        mass={"x": "m", "y": "m"},
        forces={"weight": {"y": "-10*newton"}},
        contacts={
            "floor": {
                "gap": "y",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "v_x",
                "friction": "where(x < metre, 0, 0.5)",
            }
        },
        initial={"x": "0 m", "y": "0 m", "v_x": "2 m s-1", "v_y": "0 m s-1"},
    )
    run = xd.simulate(block, method="rk4", step="70 ms", until="2 s")
    assert float(run.x[-1]) == pytest.approx(1.0 + 4.0 / (2 * 5.0), abs=1e-9)
