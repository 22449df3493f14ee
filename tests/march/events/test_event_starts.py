"""Acting events on whose surface the motion stands: at the start, and where another event has acted."""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from xdynamics.record.arguments import recorded_arguments

G = 9.81
FREE = {"coordinates": {"y": "m"}, "parameters": {"m": "1 kg", "g": "9.81 m s-2", "e": "0.8"}, "mass": {"y": "m"}}
MARCHES = (
    ("dormand_prince", {"rtol": 1e-9}),
    ("dop853", {"rtol": 1e-9}),
    ("taylor", {"rtol": 1e-9}),
    ("radau_iia", {"rtol": 1e-9}),
    ("rk4", {"step": "10 ms"}),
    ("velocity_verlet", {"step": "10 ms"}),
)


WEIGHT = {"weight": {"potential": "m*g*y"}}
NOTHING = {"none": {"y": "0*newton"}}


def body(events: dict[str, Any], y: str = "0 m", v: str = "0 m s-1", **more: Any) -> xd.Model:
    """A body on a line, under its weight unless it has other forces, with events."""
    return xd.Model(**FREE | {"name": "body", "forces": WEIGHT} | more, events=events, initial={"y": y, "v_y": v})


def falling(y: str = "0 m", v: str = "0 m s-1", **ground: Any) -> xd.Model:
    """A body under its weight that stops at the ground."""
    return body({"ground": {"function": "y", "direction": "falling", "action": "stop"} | ground}, y, v)


def bouncing(e: float) -> xd.Model:
    """A ball that an event throws back."""
    return falling("1 m", action="reset", set={"v_y": "-e*v_y"}).replace(parameters={"e": str(e)})


def braked() -> xd.Model:
    """A block of which either regime's force drives it back to where they are switched: dry friction by regimes."""
    switch = {"function": "v_y", "action": "switch"}
    return body(
        {
            "stops": {**switch, "direction": "falling", "to": "off"},
            "starts": {**switch, "direction": "rising", "to": "on"},
        },
        v="1 m s-1",
        forces={"forward": {"y": "-2*newton"}, "backward": {"y": "2*newton"}},
        regimes={"on": {"forces": ["forward"]}, "off": {"forces": ["backward"]}},
    )


def thermostat() -> xd.Model:
    """A heater that is switched at one temperature, without hysteresis."""
    reset = {"function": "T - 295*kelvin", "action": "reset"}
    return xd.Model(
        name="thermostat",
        states={
            "T": {"unit": "K", "rate": "-(T - 280*kelvin)/(100*second) + h*0.5*kelvin/second"},
            "h": {"unit": "1", "rate": "0/second"},
        },
        events={
            "on": {**reset, "direction": "falling", "set": {"h": "1"}},
            "off": {**reset, "direction": "rising", "set": {"h": "0"}},
        },
        initial={"T": "290 K", "h": "1"},
    )


def kicked(at: float = 0.0, direction: str = "rising") -> xd.Model:
    """A body at rest that gets a velocity of 1 m/s at a time."""
    kick = {"function": "t - later", "direction": direction, "action": "reset", "set": {"v_y": "v_y + metre/second"}}
    return body({"kick": kick}, forces=NOTHING, parameters={"m": "1 kg", "later": f"{at} s"})


def marched(model: xd.Model, until: str = "3 s", **how: Any) -> xr.Dataset:
    """March a model, by Dormand and Prince's method unless asked otherwise."""
    return xd.simulate(model, until=until, **({"method": "dormand_prince", "rtol": 1e-9} | how))


@pytest.mark.parametrize(("method", "how"), MARCHES)
def test_regimes_that_push_back_to_their_border_slide(method: str, how: dict[str, Any]) -> None:
    """Assert that the block stays where it is at rest, after 0.25 m, and that its event says so."""
    run = xd.simulate(braked(), method=method, until="3 s", **how)
    assert run.attrs["run_outcome"] == "completed"
    assert float(run.y[-1]) == pytest.approx(0.25, abs=1e-9)
    assert run.event_time.values == pytest.approx([0.5], abs=1e-9)
    assert run.switch_share_stops.values[-1] == pytest.approx(0.5)


def test_regimes_that_may_not_slide_end_there() -> None:
    """Assert the former rule, and that both events and the remedy are named."""
    run = marched(braked(), sliding="ends")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert run.event_time.values == pytest.approx([0.5, 0.5], abs=1e-9)
    for word in ("'stops'", "'starts'", "[frictions]", "hysteresis"):
        assert word in run.attrs["run_outcome_text"]


def test_resets_that_undo_each_other_accumulate() -> None:
    """Assert that a thermostat without hysteresis ends at its temperature, with the time in the record."""
    run = marched(thermostat(), "600 s")
    assert run.attrs["run_outcome"] == "event_accumulation"
    assert float(run["T"][-1]) == pytest.approx(295.0, abs=1e-6)
    assert float(run.attrs["accumulation_time"]) == pytest.approx(100 * np.log(40 / 35), abs=1e-5)
    assert run.attrs["accumulation_time_units"] == "s"


@pytest.mark.parametrize(("method", "how"), MARCHES)
@pytest.mark.parametrize("e", [0.5, 0.8])
def test_a_ball_by_reset_does_not_fall_through_the_ground(e: float, method: str, how: dict[str, Any]) -> None:
    """Assert that it ends where its bounces do, at sqrt(2/g) (1 + e)/(1 - e), within the stated uncertainty."""
    run = xd.simulate(bouncing(e), method=method, until="10 s", **how)
    assert run.attrs["run_outcome"] == "event_accumulation"
    end, off = (float(run.attrs[name]) for name in ("accumulation_time", "accumulation_time_uncertainty"))
    exact = sqrt(2 / G) * (1 + e) / (1 - e)
    numerical = 1e-5 if method == "radau_iia" else 1e-9
    assert end == pytest.approx(exact, abs=off + numerical)
    assert float(run.y.min()) > -1e-9


def test_two_tanks_end_when_both_are_empty() -> None:
    """Assert Zeno's tanks: 0.75 m/s flow in, 1 m/s out of 2 m in all, so that both are empty after 8 s."""
    low = {"direction": "falling", "action": "reset"}
    tanks = xd.Model(
        name="two tanks",
        states={
            "a": {"unit": "m", "rate": "inflow*w - metre/second/2"},
            "b": {"unit": "m", "rate": "inflow*(1 - w) - metre/second/2"},
            "w": {"unit": "1", "rate": "0/second"},
        },
        parameters={"inflow": "0.75 m s-1"},
        events={
            "a_low": {**low, "function": "a", "set": {"w": "1"}},
            "b_low": {**low, "function": "b", "set": {"w": "0"}},
        },
        initial={"a": "1 m", "b": "1 m", "w": "1"},
    )
    run = marched(tanks, "10 s")
    assert run.attrs["run_outcome"] == "event_accumulation"
    assert float(run.time[-1]) == pytest.approx(8.0, abs=1e-9)
    assert min(float(run.a.min()), float(run.b.min())) > -1e-9


@pytest.mark.parametrize("later", [0, 1, 2])
def test_a_reset_at_a_time_acts_at_the_start_too(later: float) -> None:
    """Assert where a body is after 3 s that is kicked at 0, 1 or 2 s, with both states at the kick."""
    run = marched(kicked(later))
    assert float(run.y[-1]) == pytest.approx(3 - later, abs=1e-12)
    before, after = int(run.event_row_before[0]), int(run.event_row_after[0])
    assert run.v_y.values[[before, after]].tolist() == [0.0, 1.0]
    assert run.time.values[[before, after]] == pytest.approx([later, later], abs=1e-12)


def test_members_of_a_sweep_are_judged_at_the_start() -> None:
    """Assert the same in a sweep over the time of the kick, and of a ball over its restitution."""
    grid = xd.sweep(kicked(), {"later": "0:2:3 s"}, keep=["end"], method="dormand_prince", rtol=1e-9, until="3 s")
    assert grid.end_y.values == pytest.approx([3.0, 2.0, 1.0], abs=1e-12)
    balls = xd.sweep(bouncing(0.5), {"e": [0.5, 0.8]}, keep=["end"], method="dop853", rtol=1e-9, until="9 s")
    assert balls.run_outcome.values.tolist() == ["event_accumulation"] * 2


def test_a_body_let_go_at_the_ground_stops_at_once() -> None:
    """Assert that its second rate decides where the first is zero, that it has both rows, and that one thrown up flies."""
    run = marched(falling())
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert run.time.values.tolist() == [0.0, 0.0, 0.0]
    thrown = marched(falling(v="5 m s-1"))
    assert float(thrown.time[-1]) == pytest.approx(10 / G, abs=1e-9)


def test_a_departure_without_direction_is_no_passage_and_said() -> None:
    """Assert that a body thrown from an undirected ground stops when it comes back, and that the departure is named."""
    run = marched(falling(v="5 m s-1", direction="either"))
    assert float(run.time[-1]) == pytest.approx(10 / G, abs=1e-9)
    assert "'ground' is zero at the start and leaves it, which is no passage" in run.attrs["run_outcome_text"]


@pytest.mark.parametrize(("e", "y"), [(0.0, "1 m"), (0.5, "0 m")])
def test_a_reset_to_rest_that_does_not_bear_is_said(e: float, y: str) -> None:
    """Assert a remark where a ball is reset to rest at the ground, or lies there, and falls on through it."""
    ball = falling(y, action="reset", set={"v_y": "-e*v_y"}).replace(parameters={"e": str(e)})
    text = marched(ball).attrs["run_outcome_text"]
    assert "event 'ground' brings the motion to rest where its function is zero" in text
    assert "[contacts]" in text


def test_records_at_the_start_are_no_events() -> None:
    """Assert that a body let go at rest has no event of the kind `record` at the start."""
    top = {"top": {"function": "v_y", "direction": "falling"}}
    assert marched(body(top, "9 m"), "1 s").sizes["event"] == 0


def test_a_function_that_is_zero_for_a_while_is_judged_when_it_leaves() -> None:
    """Assert that a stop acts where a force sets in after a second of rest, and not at all where none does."""
    stop = {"moves": {"function": "y", "direction": "rising", "action": "stop"}}
    run = marched(body(stop, forces={"push": {"y": "where(t < second, 0*newton, newton)"}}))
    assert run.attrs["run_outcome"] == "stopped_by_event"
    assert float(run.time[-1]) == pytest.approx(1.0, abs=1e-4)
    assert marched(body(stop, forces=NOTHING)).attrs["run_outcome"] == "event_at_zero"


def test_a_periodic_event_rings_at_a_phase_of_zero() -> None:
    """Assert kicks at 0, 1, 2 and 3 s, and at a phase of half a second."""
    tick = {"every": "1 s", "action": "reset", "set": {"v_y": "v_y + metre/second"}}
    for phase, end, times in (("0 s", 6.0, [0.0, 1.0, 2.0, 3.0]), ("0.5 s", 4.5, [0.5, 1.5, 2.5])):
        run = marched(body({"tick": tick | {"phase": phase}}, forces=NOTHING))
        assert run.event_time.values.tolist() == times
        assert float(run.y[-1]) == pytest.approx(end, abs=1e-12)


def test_an_event_in_passing_acts_once() -> None:
    """Assert that a parachute opens once where a body falls through a height, and the motion goes on."""
    opens = {"function": "y - 5*metre", "direction": "falling", "action": "switch", "to": "slow"}
    drag = {"weight": {"potential": "m*g*y"}, "drag": {"y": "-4*newton*second/metre*v_y"}}
    regimes = {"free": {"forces": ["weight"]}, "slow": {"forces": ["weight", "drag"]}}
    run = marched(body({"opens": opens}, "9 m", forces=drag, regimes=regimes), "2 s")
    assert run.attrs["run_outcome"] == "completed"
    assert run.event_time.values == pytest.approx([sqrt(8 / G)], abs=1e-9)


@pytest.mark.parametrize("model", [braked(), bouncing(0.8), kicked()], ids=["regimes", "ball", "kick"])
def test_the_former_rule_is_that_of_archives_without_the_attribute(model: xd.Model, tmp_path: Any) -> None:
    """Assert that a record names its rule, and that one without it is made again by the former one."""
    judged, former = marched(model, "6 s"), marched(model, "6 s", event_start="waiting")
    assert judged.attrs["solver_event_start"] == "judged"
    assert former.attrs["run_outcome"] == "completed"
    for name, run in (("judged", judged), ("former", former)):
        xd.save(run, tmp_path / f"{name}.nc")
        assert xd.reproduce(tmp_path / f"{name}.nc").attrs["identical"]
    del former.attrs["solver_event_start"]
    assert recorded_arguments(former)["event_start"] == "waiting"


def test_a_march_that_goes_on_is_no_start(tmp_path: Any) -> None:
    """Assert that a ball extended from between two bounces has the bits of the one marched at once."""
    xd.save(marched(bouncing(0.8), "1 s"), tmp_path / "ball.nc")
    longer = xd.extend(tmp_path / "ball.nc", until="2 s")
    once = marched(bouncing(0.8), "2 s", nodes=["1 s"])
    assert longer.y.values.tolist() == once.y.values.tolist()
