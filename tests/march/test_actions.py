"""What is done at events: a regime is switched, a state is set anew, a run is stopped after some."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.problems import MODELS, particle
from xdynamics.documenting.summary import summary

G, E = 9.81, 0.9
BALL: dict[str, Any] = {
    "name": "ball",
    "coordinates": {"y": "m"},
    "parameters": {"m": "1 kg", "g": f"{G} m s-2", "e": f"{E}"},
    "mass": {"y": "m"},
    "forces": {"gravity": {"potential": "m*g*y"}},
    "initial": {"y": "1 m", "v_y": "0 m s-1"},
    "events": {"floor": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-e*v_y"}}},
    "observables": {"speed": "abs(v_y)"},
}
THRUST, OUT = 30.0, 2.0
ROCKET: dict[str, Any] = {
    "name": "rocket",
    "coordinates": {"y": "m"},
    "parameters": {"m": "1 kg", "g": f"{G} m s-2", "f": f"{THRUST} N", "out": f"{OUT} s"},
    "mass": {"y": "m"},
    "forces": {"gravity": {"potential": "m*g*y"}, "thrust": {"y": "f"}},
    "initial": {"y": "0 m", "v_y": "0 m s-1"},
    "regimes": {
        "boost": {"forces": ["gravity", "thrust"]},
        "coast": {"forces": ["gravity"], "description": "burnt out"},
    },
    "events": {
        "burnout": {"function": "t - out", "direction": "rising", "action": "switch", "to": "coast"},
        "ground": {"function": "y", "direction": "falling", "action": "stop"},
    },
}
MARCHING = [name for name, one in xd.METHODS.items() if one.order > 1]


def asked(method: str) -> dict[str, Any]:
    """Settings that suit a method."""
    return {"method": method} | ({"step": 0.31} if xd.METHODS[method].order < 5 else {"rtol": 1e-9})


def bounces(count: int) -> tuple[list[float], list[float]]:
    """When a ball that falls from 1 m meets the floor, and how fast."""
    t, v = math.sqrt(2 / G), math.sqrt(2 * G)
    times, speeds = [t], [v]
    for _ in range(count - 1):
        v *= E
        t += 2 * v / G
        times.append(t)
        speeds.append(v)
    return times, speeds


@pytest.mark.every(3)
@pytest.mark.parametrize("method", MARCHING)
def test_a_ball_bounces_as_its_closed_form_does(method: str) -> None:
    """Assert times and speeds of impacts, with every method: each is exact where the force is constant."""
    run = xd.simulate(xd.Model(**BALL), until=4.0, **asked(method))
    times, speeds = bounces(run.sizes["event"])
    assert len(times) == 6
    assert run.event_time.values == pytest.approx(times, abs=5e-12)
    assert run.event_speed.values == pytest.approx(speeds, abs=5e-11)
    before, after = run.v_y.values[run.event_row_before.values], run.v_y.values[run.event_row_after.values]
    assert np.array_equal(after, -E * before)
    assert (run.y.values > -1e-10).all()
    assert run.event_kind.attrs["flag_meanings"].split()[run.event_kind.values[0]] == "reset"


@pytest.mark.every(3)
@pytest.mark.parametrize("method", MARCHING)
def test_a_rocket_is_switched_off(method: str) -> None:
    """Assert burnout and landing, that the force is there and gone on either side, and both regimes by name."""
    run = xd.simulate(xd.Model(**ROCKET), until=50.0, **asked(method))
    a = THRUST - G
    v, h = OUT * a, a * OUT**2 / 2
    assert run.event_time.values == pytest.approx([OUT, OUT + (v + math.sqrt(v * v + 2 * G * h)) / G], abs=2e-11)
    before, after = int(run.event_row_before[0]), int(run.event_row_after[0])
    assert (float(run.force_thrust_y[before]), float(run.force_thrust_y[after])) == (THRUST, 0.0)
    assert (float(run.a_y[before]), float(run.a_y[after])) == pytest.approx((a, -G))
    assert run.y[before] == run.y[after]
    assert run.regime.attrs["flag_meanings"] == "boost coast"
    assert run.regime.attrs["forces"] == "boost: gravity thrust; coast: gravity"
    assert run.regime.values[[before, after, -1]].tolist() == [0, 1, 1]


def test_a_run_begins_in_the_regime_that_is_said() -> None:
    """Assert that no thrust is there where the motion begins coasting, in the file as well."""
    model = xd.Model(**ROCKET | {"initial": ROCKET["initial"] | {"v_y": "5 m s-1", "regime": "coast"}})
    assert xd.Model.from_text(model.to_toml()) == model
    run = xd.simulate(model, method="rk4", step=0.1, until=0.5)
    assert (run.force_thrust_y.values == 0.0).all()
    assert (run.regime.values == 1).all()


def test_energy_counts_the_potentials_that_act() -> None:
    """Assert that a spring that is let go has no energy any more."""
    model = particle(
        name="shot",
        parameters={"m": "1 kg", "k": "4 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}, "push": {"x": "0*newton"}},
        initial={"x": "-1 m", "v_x": "0 m s-1"},
        regimes={"held": {"forces": ["spring", "push"]}, "free": {"forces": ["push"]}},
        events={"loose": {"function": "x", "direction": "rising", "action": "switch", "to": "free"}},
    )
    run = xd.simulate(model, method="dop853", rtol=1e-11, until=2.0)
    assert run.event_time.values == pytest.approx([math.pi / 4], abs=1e-9)
    assert run.total_energy.values == pytest.approx(2.0, rel=1e-9)
    assert float(run.potential_energy[-1]) == 0.0
    assert float(run.v_x[-1]) == pytest.approx(2.0, rel=1e-9)


@pytest.mark.parametrize(("count", "crossing"), [(1, 0), (3, 2)])
def test_a_run_is_stopped_after_some(count: int, crossing: int) -> None:
    """Assert that the n-th crossing stops a run, and those before are recorded."""
    model = particle(
        name="oscillator",
        parameters={"m": "1 kg", "k": "1 N m-1"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={"middle": {"function": "x", "action": "stop", "count": count}},
    )
    assert xd.Model.from_text(model.to_toml()) == model
    run = xd.simulate(model, method="dop853", rtol=1e-10, until=50.0)
    assert run.event_time.values == pytest.approx([math.pi * (k + 0.5) for k in range(crossing + 1)], abs=1e-8)
    assert run.attrs["run_outcome"] == "stopped_by_event"


def test_everything_is_set_from_the_state_before() -> None:
    """Assert that two coordinates can be exchanged, that first-order states are set too, and in the order declared."""
    model = xd.Model(
        name="exchange",
        coordinates={"x": "m", "y": "m", "z": "m"},
        parameters={"m": "1 kg"},
        mass=dict.fromkeys("xyz", "m"),
        forces={},
        states={"count": {"unit": "1", "rate": "0/second"}},
        initial={
            "x": "1 m",
            "v_x": "1 m s-1",
            "y": "5 m",
            "v_y": "0 m s-1",
            "z": "1 m",
            "v_z": "0 m s-1",
            "count": "0",
        },
        events={
            "swap": {
                "function": "x - 2*metre",
                "direction": "rising",
                "action": "reset",
                "set": {"x": "y", "y": "x", "z": "x + y", "v_x": "v_y", "v_y": "v_x", "count": "2*count + 1"},
            },
            "tie": {
                "function": "t - 1*second",
                "direction": "rising",
                "action": "reset",
                "set": {"count": "2*count + 1", "z": "z + y"},
            },
        },
    )
    run = xd.simulate(model, method="rk4", step=0.3, until=1.5)
    assert run.event_detector.values.tolist() == [0, 1]
    assert len(set(run.event_row_before.values.tolist())) == 1
    end = [float(run[name][-1]) for name in ("x", "v_x", "y", "v_y", "count")]
    assert end == pytest.approx([5.0, 0.0, 2.5, 1.0, 3.0], abs=1e-11)
    offsets = [run[f"event_offset_{name}"].values.tolist() for name in ("x", "y", "z")]
    assert offsets == [pytest.approx(shifts, abs=1e-11) for shifts in ([3.0, 0.0], [-3.0, 0.0], [6.0, 2.0])]


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"action": "switch"}, "action 'switch' needs the key 'to'"),
    ({"action": "switch", "to": "x"}, "event 'e' switches to 'x', which is no regime; there are: boost, coast"),
    ({"action": "switch", "to": 3}, "to is 3, needs the name of a regime"),
    ({"action": "record", "to": "coast"}, "key 'to' is for action 'switch': 'record' does not take it"),
    ({"action": "reset"}, "action 'reset' needs the key 'set'"),
    ({"action": "reset", "set": {"z": "1"}}, "event 'e' sets 'z', which is no coordinate, velocity or state"),
    ({"action": "reset", "set": {"v_y": "y"}}, "event 'e' sets 'v_y' has units 'm', needs 'm s-1'"),
    ({"action": "reset", "set": {"v_y": "q"}}, "name 'q'"),
    ({"action": "reset", "set": {"v_y": "-"}}, "set 'v_y'"),
    ({"action": "reset", "set": "v"}, "set is 'v', needs a table like"),
    ({"action": "stop", "count": 0}, "count is 0, needs a whole number from 1 on"),
    ({"action": "stop", "count": True}, "count is True, needs a whole number"),
    ({"action": "record", "count": 2}, "count is 2, and action 'record' does nothing that could wait for it"),
    ({"action": "impact"}, "event 'e': key 'restitution' is missing"),
    (
        {"action": "impact", "restitution": 0.5, "direction": "either"},
        "direction 'either' is not known; there are rising, falling",
    ),
    ({"action": "impact", "restitution": 0.5, "count": 2}, "key 'count' is not known"),
    ({"action": "bounce"}, "action 'bounce' is not known; there are record, stop, switch, reset, impact"),
]


@pytest.mark.parametrize(("given", "said"), WRONG)
def test_wrong_actions(given: dict[str, Any], said: str) -> None:
    """Assert what is said of an event that cannot be done."""
    with pytest.raises(xd.ModelError) as error:
        xd.Model(**ROCKET | {"events": {"e": {"function": "y"} | given}})
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("regimes", "said"),
    [
        ("up", "initial regime 'up' is none; there are: boost, coast"),
        (
            {"boost": {"forces": ["gravity", "thrust", "x"]}},
            "regime 'boost' has 'x', which is no force; there are: gravity, thrust",
        ),
        ({"boost": {"forces": "gravity"}}, "forces is 'gravity', needs a list of the forces that act in it"),
        ({"boost": {"forces": ["gravity", "gravity"]}}, "forces lists one of gravity, gravity twice"),
        ({"boost": {"forces": ["gravity"]}}, "force 'thrust' acts in no regime; put it into one, or leave it out"),
        ({"boost": {}}, "force 'gravity' acts in no regime; put it into one, or leave it out"),
        ({"boost": 1}, "1 must be a table of keys, such as forces, terms"),
        ({"two words": {"forces": ["gravity", "thrust"]}}, "a name is a letter"),
    ],
)
def test_wrong_regimes(regimes: dict[str, Any] | str, said: str) -> None:
    """Assert what is said of regimes that no motion can be in, or begin in."""
    first = {"initial": ROCKET["initial"] | {"regime": regimes}}
    with pytest.raises(xd.ModelError) as error:
        xd.Model(**ROCKET | (first if isinstance(regimes, str) else {"regimes": regimes, "events": {}}))
    assert said in str(error.value)


@pytest.mark.parametrize("statement", [BALL, ROCKET], ids=["reset", "switch"])
def test_the_rest_of_the_run_goes_on_with_the_new_rule(statement: dict[str, Any]) -> None:
    """Assert that states between rows, another march from the file and its longer end know regime and reset."""
    model = xd.Model(**statement)
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=3.0)
    at = np.linspace(0.0, 3.0, 301)
    fine = xd.simulate(model, method="rk4", step=0.01, until=3.0)
    rows = np.searchsorted(fine.time.values, at + 1e-9, side="right") - 1
    assert np.abs(xd.sample(run, at).y.values - fine.y.values[rows]).max() < 1e-7
    longer = xd.extend(xd.simulate(model, method="rk4", step=0.1, until=2.5), until=5.0)
    whole = xd.simulate(model, method="rk4", step=0.1, until=5.0, nodes=[2.5])
    assert xd.content_digest(longer) == xd.content_digest(whole)


@pytest.mark.parametrize(
    "asked",
    [{"method": "dop853", "rtol": 1e-11}, {"method": "rk4", "step": 0.02}, {"method": "radau_iia", "rtol": 1e-10}],
)
def test_a_rocket_with_two_stages_is_tsiolkovsky_s(asked: dict[str, Any]) -> None:
    """Assert speed and mass behind both groups of two events at one instant, each done in the order of the file."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "staged_rocket.toml"), **asked)
    assert run.event_time.values == pytest.approx([10.0, 10.0, 30.0, 30.0], abs=1e-10)
    assert run.event_detector.values.tolist() == [0, 1, 2, 3]
    assert len(set(run.event_row_after.values.tolist())) == 2
    first = 2500 * math.log(100 / 40) - 9.80665 * 10
    second = first + 3000 * math.log(30 / 10) - 9.80665 * 20
    after = run.isel(step=run.event_row_after.values[[0, 2]])
    assert after.v_y.values == pytest.approx([first, second], rel=1e-8)
    assert after.m.values == pytest.approx([30.0, 10.0], rel=1e-12)
    assert after.flow.values.tolist() == [1.0, 0.0]
    assert after.regime.values.tolist() == [1, 2]
    told = [line.split(" at t =")[0] for line in summary(run) if line.startswith("event ")]
    assert told == [
        f"event     {name}"
        for name in ("separation (reset)", "ignition (regime_switch)", "burnout (reset)", "coasting (regime_switch)")
    ]
