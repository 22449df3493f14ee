"""Impacts, rest and take-off: against closed forms, and what must not happen whatever the model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import xdynamics as xd
from cases.contacts import (
    FIRST,
    FITTING,
    FORTY_FOURTH,
    LIMIT,
    E,
    G,
    asked,
    ball,
    cradle,
    sliding,
    state_of,
    wave,
    words,
)

TABLE: dict[str, Any] = {
    "name": "table",
    "coordinates": {"y": "m"},
    "parameters": {"m": "1 kg", "g": f"{G} m s-2", "A": "0.1 m", "w": "12 s-1"},
    "mass": {"y": "m"},
    "forces": {"gravity": {"potential": "m*g*y"}},
    "initial": {"y": "0 m", "v_y": "1.2 m s-1"},
    "contacts": {"table": {"gap": "y - A*sin(w*t)", "restitution": 0.5}},
}
BLOCK: dict[str, Any] = {
    "name": "rocking block",
    "coordinates": {"x": "m", "y": "m", "theta": "rad"},
    "parameters": {"m": "1 kg", "b": "0.2 m", "h": "1 m", "g": f"{G} m s-2", "mu": "2"},
    "mass": {"x": "m", "y": "m", "theta": "m*(b**2 + h**2)/3"},
    "definitions": {"s": "sin(theta)", "c": "cos(theta)"},
    "forces": {"gravity": {"potential": "m*g*y"}},
    "initial": {
        "x": "0 m",
        "v_x": "-0.4 m s-1",
        "y": "1 m",
        "v_y": "0.08 m s-1",
        "theta": "0 rad",
        "v_theta": "0.4 rad s-1",
    },
    "contacts": {
        name: {
            "gap": f"y {sign} b*s - h*c",
            "restitution": 0,
            "tangential": "coulomb",
            "slip": f"v_x + ({other}b*s + h*c)*v_theta/radian",
            "friction": "mu",
        }
        for name, sign, other in (("left", "-", ""), ("right", "+", "-"))
    },
}


def table_of(model: xd.Model) -> dict[str, Any]:
    """A model as a table, to change something in it."""
    import tomllib

    return tomllib.loads(model.to_toml())


@pytest.mark.every(3)
@pytest.mark.parametrize("method", FITTING)
def test_a_bouncing_ball_comes_to_rest(method: str) -> None:
    """Assert impacts, the limit that they run to, and the weight behind it, with every method."""
    run = xd.simulate(ball(), until=10.0, **asked(method, step=0.05))
    found, times = words(run), run.event_time.values
    assert found == [("floor", "impact")] * (len(times) - 1) + [("floor", "rest")]
    assert 95 <= len(times) <= 101
    assert times[[0, 43, -1]] == pytest.approx([FIRST, FORTY_FOURTH, LIMIT], abs=2e-12)
    assert float(run.event_time_uncertainty[-1]) < 3e-12
    assert float(run.contact_force_floor[-1]) == pytest.approx(2 * G, rel=1e-15)
    assert (abs(run.contact_gap_floor.values[run.time.values > LIMIT + 1e-9]) < 1e-16).all()
    assert float(run.contact_gap_floor.min()) > -1e-12
    assert float(run.event_energy_lost.sum()) == pytest.approx(2 * G, rel=1e-12)
    assert state_of(run, "contact_state_floor") == "closed"


def test_impacts_are_exact_where_numbers_are() -> None:
    """Assert impacts at 3 - 2**(2 - n) s and rest at 3 s, and that both sides of each are in the record."""
    run = xd.simulate(ball(0.5, 4.0, 8.0), method="velocity_verlet", step=0.25, until=5.0)
    times = run.event_time.values
    assert times[:-1] == pytest.approx(3 - 2.0 ** (2 - np.arange(1, len(times))), abs=1e-13)
    assert times[-1] == pytest.approx(3.0, abs=1e-13)
    before, after = (run.v_y.values[run[f"event_row_{side}"].values[:-1]] for side in ("before", "after"))
    assert after == pytest.approx(-before / 2, rel=1e-15)
    assert run.event_impulse_y.values[:-1] == pytest.approx(2 * (after - before), rel=1e-15)
    assert (run.event_offset_y.values == 0.0).all()


def test_no_energy_is_lost_in_a_thousand_elastic_impacts() -> None:
    """Assert impact n at 2 n - 1 s and the energy kept."""
    run = xd.simulate(ball(1, 4.0, 8.0), method="velocity_verlet", step=0.37, until=2000.5)
    assert words(run) == [("floor", "impact")] * 1000
    assert run.event_time.values == pytest.approx(2 * np.arange(1, 1001) - 1.0, abs=1e-9)
    assert run.total_energy.values == pytest.approx(64.0, rel=1e-11)


def test_a_plastic_impact_stays() -> None:
    """Assert one impact and rest at the same time, with the energy that went."""
    run = xd.simulate(ball(0, 4.0, 8.0), method="rk4", step=0.3, until=2.0)
    assert words(run) == [("floor", "impact"), ("floor", "rest")]
    assert run.event_time.values == pytest.approx([1.0, 1.0], abs=1e-15)
    assert run.event_energy_lost.values == pytest.approx([64.0, 0.0])
    assert run.y.values[-3:] == pytest.approx([0, 0, 0], abs=1e-16)


def test_restitution_may_depend_on_the_speed_of_approach() -> None:
    """Assert each bounce's own coefficient: e = v/(v + 2 m/s)."""
    run = xd.simulate(ball("approach_speed/(approach_speed + 2*metre/second)"), method="rk4", step=0.1, until=1.5)
    rows = run.event_row_before.values
    v = -run.v_y.values[rows]
    assert run.v_y.values[run.event_row_after.values] == pytest.approx(v * v / (v + 2), rel=1e-14)


@pytest.mark.parametrize("method", ["velocity_verlet", "rk4", "dormand_prince", "dop853"])
def test_a_ball_leaves_a_table(method: str) -> None:
    """Assert take-off where the table falls faster than the ball would, and the first impact behind it."""
    run = xd.simulate(xd.Model(**TABLE), until=2.0, **asked(method, step=0.002, rtol=1e-10))
    off = math.asin(G / (0.1 * 144)) / 12
    y, v = 0.1 * math.sin(12 * off), 1.2 * math.cos(12 * off)
    again = brentq(lambda t: y + v * (t - off) - G * (t - off) ** 2 / 2 - 0.1 * math.sin(12 * t), 0.2, 0.5, xtol=1e-15)
    assert words(run)[:2] == [("table", "takeoff"), ("table", "impact")]
    assert run.event_time.values[:2] == pytest.approx([off, again], abs=2e-14)
    impulse = 1.5 * (1.2 * math.cos(12 * again) - v + G * (again - off))
    assert run.event_impulse_y.values[:2] == pytest.approx([0.0, impulse], rel=1e-12)
    assert float(run.contact_gap_table.min()) > -1e-13
    closed = run.contact_state_table.values > 0
    assert (run.contact_force_table.values[~closed] == 0.0).all()
    assert (run.contact_force_table.values[closed] > -1e-9).all()
    assert (
        55 <= len(words(run)) <= 75
    )  # bounces below 1e-9 of the largest gap are skipped, the last of them rounding's choice


def shaken(amplitude: str, **balls: tuple[float, float]) -> xd.Model:
    """Balls side by side on a table that is shaken 200 radians a second: restitution and speed of each."""
    table = "a*sin(200*t/second)"
    return xd.Model(
        name="shaken",
        coordinates=dict.fromkeys(balls, "m"),
        parameters={"m": "1 kg", "g": f"{G} m s-2", "a": amplitude},
        mass=dict.fromkeys(balls, "m"),
        forces={f"weight_{one}": {one: "-m*g"} for one in balls},
        initial={
            key: value
            for name, (_, v) in balls.items()
            for key, value in ((name, "0 m"), (f"v_{name}", f"{v!r} m s-1"))
        },
        contacts={f"on_{name}": {"gap": f"{name} - {table}", "restitution": e} for name, (e, _) in balls.items()},
    )


@pytest.mark.every(2)
@pytest.mark.parametrize("two", [{"y": (0.0, 0.2), "z": (0.3, 0.5)}, {"y": (0.0, 0.2), "z": (0.2, 0.66)}])
def test_what_a_ball_does_is_not_the_business_of_another_one(two: dict[str, tuple[float, float]]) -> None:
    """Assert impacts, rests and take-offs of two balls: those that each of them has alone, none stepped over."""
    both = xd.simulate(shaken("1 mm", **two), method="dop853", rtol=1e-9, until=0.6)
    assert both.attrs["run_outcome"] == "completed"
    for name, value in two.items():
        alone = xd.simulate(shaken("1 mm", **{name: value}), method="dop853", rtol=1e-9, until=0.6)
        mine = both.event_detector.values == both.event_detector.attrs["flag_meanings"].split().index(f"on_{name}")
        assert [two for two in words(both) if two[0] == f"on_{name}"] == words(alone)
        assert both.event_time.values[mine] == pytest.approx(alone.event_time.values, abs=1e-10)


def test_rest_is_as_certain_as_it_says() -> None:
    """Assert the rests of a ball on a table after seconds, against what bounces that are left out would take until there."""
    run = xd.simulate(shaken("1 mm", y=(0.2, 0.2)), method="dop853", rtol=1e-9, until=4.0)
    fine = xd.simulate(shaken("1 mm", y=(0.2, 0.2)), method="rk4", step=1e-4, until=4.0)
    times, sure = (
        [one.event_time.values[[kind == "rest" for _, kind in words(one)]] for one in (run, fine)],
        run.event_time_uncertainty,
    )
    rests = [kind == "rest" for _, kind in words(run)]
    assert times[0].size == times[1].size > 20
    assert (np.abs(times[0] - times[1]) <= 4 * sure.values[rests] + 1e-10).all()
    assert (run.contact_gap_on_y.values > -1e-12).all()


def test_bounces_that_nobody_sees_are_in_the_uncertainty() -> None:
    """Assert that a rest at an impact itself is uncertain by all the flights that are left, a geometric series of them."""
    run = xd.simulate(shaken("2 mm", y=(0.2, 0.4)), method="dop853", rtol=1e-9, atol=1e-9, until=4.0)
    kinds, times = [kind for _, kind in words(run)], run.event_time.values
    unseen = [i for i, kind in enumerate(kinds) if kind == "rest" and i and times[i - 1] == times[i]]
    assert len(unseen) > 5
    for i in unseen:
        t, row = times[i], int(run.event_row_before[i])
        approach = 0.4 * math.cos(200 * t) - float(run.v_y[row])
        fall = G - 0.002 * 200**2 * math.sin(200 * t)
        left = 2 * 0.2 * approach / fall / 0.8
        assert left * 0.99 <= float(run.event_time_uncertainty[i]) <= left * 1.5 + 1e-11


@pytest.mark.parametrize("step", [0.3, 5.0])
def test_a_ball_in_a_box(step: float) -> None:
    """Assert a hundred seconds between four walls, however many of them one step would pass."""
    run = xd.simulate(box(0.2, 0.5, 7.3, 1.9), method="rk4", step=step, until=100.0)
    t = run.time.values
    assert run.x.values == pytest.approx(wave(0.2 + 7.3 * t), abs=5e-11)
    assert run.y.values == pytest.approx(wave(0.5 + 1.9 * t), abs=5e-11)
    assert len(words(run)) == 730 + 190


def box(x: float, y: float, u: float, v: float) -> xd.Model:
    """A ball in a box with elastic walls, without gravity."""
    gaps = {"left": "x", "right": "a - x", "floor": "y", "ceiling": "a - y"}
    return xd.Model(
        name="box",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "a": "1 m"},
        mass={"x": "m", "y": "m"},
        forces={},
        initial={"x": f"{x} m", "y": f"{y} m", "v_x": f"{u} m s-1", "v_y": f"{v} m s-1"},
        contacts={name: {"gap": gap, "restitution": 1} for name, gap in gaps.items()},
    )


def test_two_walls_are_hit_at_once_in_a_corner() -> None:
    """Assert that the ball comes back out of the corner, with an event for either wall."""
    run = xd.simulate(box(0.5, 0.5, 1.0, 1.0), method="rk4", step=0.3, until=1.2)
    assert words(run) == [("right", "impact"), ("ceiling", "impact")]
    assert run.event_time.values == pytest.approx([0.5, 0.5], abs=2e-16)
    assert float(run.x[-1]) == pytest.approx(0.3, abs=1e-15)
    assert float(run.y[-1]) == pytest.approx(0.3, abs=1e-15)


@pytest.mark.parametrize(
    ("law", "e", "speeds"),
    [
        ("newton", 1.0, (-1 / 3, 2 / 3, 2 / 3)),
        ("poisson", 1.0, (-1 / 3, 2 / 3, 2 / 3)),
        ("sequential", 1.0, (0, 0, 1)),
        ("newton", 0.5, (0, 0.5, 0.5)),
        ("newton", 0.0, (1 / 3, 1 / 3, 1 / 3)),
        ("sequential", 0.0, (1 / 3, 1 / 3, 1 / 3)),
    ],
)
def test_the_law_tells_what_three_balls_do(law: str, e: float, speeds: tuple[float, ...]) -> None:
    """Assert speeds, impulses and energies by each law, and that the record has it with the order."""
    run = xd.simulate(cradle(law, e), method="rk4", step=0.3, until=2.0)
    assert [float(run[f"v_{name}"][-1]) for name in ("x1", "x2", "x3")] == pytest.approx(speeds, abs=1e-10)
    assert run.event_time.values == pytest.approx([0.9] * len(words(run)))
    for i, name in enumerate(("x1", "x2", "x3")):
        assert float(run[f"event_impulse_{name}"].sum()) == pytest.approx(speeds[i] - (i == 0), abs=1e-10)
    assert float(run.event_energy_lost.sum()) == pytest.approx(0.5 - 0.5 * sum(v * v for v in speeds), abs=1e-10)
    assert (run.event_energy_lost.values > -1e-12).all()
    about = run.event_impulse_x1.attrs
    assert (about["impact_law"], about["impact_order"]) == (law, "first second")


@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_a_block_rocks_as_housner_says(method: str) -> None:
    """Assert the loss of speed at each impact, 1 - 3/2 sin(alpha)**2, and that it comes to rest on both corners.

    G. W. Housner, The behavior of inverted pendulum structures during earthquakes, BSSA 53 (1963) 403.
    """
    run = xd.simulate(xd.Model(**BLOCK), until=12.0, **asked(method, step=0.01, rtol=1e-10))
    hits = [i for i, (_, kind) in enumerate(words(run)) if kind == "impact"][:20]
    after, before = (run.v_theta.values[run[f"event_row_{side}"].values[hits]] for side in ("after", "before"))
    assert after / before == pytest.approx(1 - 1.5 * 0.04 / 1.04, rel=1e-9)
    assert run.attrs["run_outcome"] == "completed"
    assert words(run)[-1][1] == "rest"
    assert float(run.contact_force_left[-1] + run.contact_force_right[-1]) == pytest.approx(G, rel=1e-12)
    assert abs(float(run.theta[-1])) < 1e-12
    assert len(words(run)) < 1500


def test_impulses_are_what_velocities_change_by() -> None:
    """Assert M dv = the sum of impulses and the loss of kinetic energy, for full masses and oblique walls."""
    for seed in range(8):
        random = np.random.default_rng(seed)
        root = random.normal(size=(2, 2)) + 2 * np.eye(2)
        mass, normals = root @ root.T, random.normal(size=(2, 2))
        v = -np.linalg.solve(normals, random.uniform(0.5, 2.0, 2))
        model = xd.Model(
            name="oblique",
            coordinates={"x": "m", "y": "m"},
            parameters={"u": "1 kg"},
            mass={"matrix": [[f"{float(one)!r}*u" for one in row] for row in (mass + mass.T) / 2]},
            forces={},
            initial={"x": "0 m", "y": "0 m", "v_x": f"{float(v[0])!r} m s-1", "v_y": f"{float(v[1])!r} m s-1"},
            contacts={
                f"c{i}": {"gap": f"({float(a)!r})*x + ({float(b)!r})*y + 1*metre", "restitution": 0.4 + 0.3 * i}
                for i, (a, b) in enumerate(normals)
            },
        )
        run = xd.simulate(model, method="rk4", step=0.1, until=3.0)
        both = (mass + mass.T) / 2
        for rows in {*zip(run.event_row_before.values.tolist(), run.event_row_after.values.tolist(), strict=True)}:
            change = [[float(run[f"v_{letter}"][row]) for letter in "xy"] for row in rows]
            events = run.event_row_before.values == rows[0]
            impulses = [float(run[f"event_impulse_{letter}"].values[events].sum()) for letter in "xy"]
            assert both @ (np.array(change[1]) - change[0]) == pytest.approx(impulses, abs=1e-12)
            lost = sum((0.5, -0.5)[i] * np.array(one) @ both @ np.array(one) for i, one in enumerate(change))
            assert float(run.event_energy_lost.values[events].sum()) == pytest.approx(lost, abs=1e-12)


def test_an_event_at_the_floor_does_not_wait_for_rest() -> None:
    """Assert that an event of the model at every impact stands beside it, and that rest ends the crossings."""
    model = xd.Model(
        **table_of(ball(0.5, 4.0, 8.0)),
        events={
            "apex": {"function": "v_y", "direction": "falling"},
            "floor_too": {"function": "y", "direction": "falling"},
        },
    )
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=5.0)
    found = words(run)
    assert found[:3] == [("floor_too", "crossing"), ("floor", "impact"), ("apex", "crossing")]
    assert found.count(("floor_too", "crossing")) == found.count(("floor", "impact")) == 15
    assert found[-1] == ("floor", "rest")


def test_it_stops_at_rest_height() -> None:
    """Assert that no bounce that is skipped would have risen above the height that the model allows."""
    run = xd.simulate(ball(0.5, 4.0, 8.0, rest_height="1 mm"), method="rk4", step=0.1, until=5.0)
    last = float(run.v_y[int(run.event_row_after[-2])])
    assert last**2 / 16 <= 1e-3 < (2 * last) ** 2 / 16
    assert run.event_time.values[-1] == pytest.approx(3.0, abs=1e-12)


@pytest.mark.parametrize(
    ("model", "outcome", "said"),
    [
        (
            xd.Model(
                **table_of(ball())
                | {"events": {"push": {"function": "t - 0.2*second", "action": "reset", "set": {"y": "-0.1*metre"}}}}
            ),
            "contact_penetrated",
            r"the gap of contact 'floor' is -0.1 m",
        ),
        (
            xd.Model(**table_of(ball()) | {"contacts": {"floor": {"gap": "y**2/metre", "restitution": 0.5}}}),
            "contact_undetermined",
            r"the gap of contact 'floor' closes where its gradient vanishes",
        ),
        (
            xd.Model(
                **table_of(ball())
                | {"contacts": {"floor": {"gap": "y + metre/cosh(1000*(y + metre)/metre)", "restitution": 0.5}}}
            ),
            "contact_undetermined",
            r"the gap of contact 'floor', or a derivative of it, is not finite there",
        ),
        (ball("2 - 0*approach_speed*second/metre"), "contact_undetermined", r"restitution of contact 'floor' is 2"),
        (
            xd.Model(
                **BLOCK
                | {
                    "name": "rod",
                    "parameters": {"m": "1 kg", "l": "1 m", "g": f"{G} m s-2", "mu": "1.8"},
                    "mass": {"x": "m", "y": "m", "theta": "m*l**2/3"},
                    "definitions": {},
                    "initial": {
                        "x": "0 m",
                        "v_x": "-10 m s-1",
                        "y": f"{math.sin(1.0)!r} m",
                        "v_y": "0 m s-1",
                        "theta": "1 rad",
                        "v_theta": "0 rad s-1",
                    },
                    "contacts": {
                        "tip": {
                            "gap": "y - l*sin(theta)",
                            "restitution": 0,
                            "tangential": "coulomb",
                            "slip": "v_x + l*sin(theta)*v_theta/radian",
                            "friction": "mu",
                        }
                    },
                }
            ),
            "contact_undetermined",
            r"friction of contact 'tip', with the coefficient 1.8: .*Painleve's paradox",
        ),
    ],
)
def test_what_has_no_answer_is_an_outcome(model: xd.Model, outcome: str, said: str) -> None:
    """Assert an outcome of its own, with the contact named, and no guess."""
    import re

    run = xd.simulate(model, method="rk4", step=0.01, until=1.0)
    assert run.attrs["run_outcome"] == outcome
    assert re.search(said, run.attrs["run_outcome_text"])


def test_a_sliding_rod_that_comes_into_painleves_region_ends_there() -> None:
    """Assert that a run whose surface turns too rough keeps its last state with an answer, and says why."""
    model = xd.Model(
        name="rod",
        coordinates={"x": "m", "y": "m", "theta": "rad"},
        parameters={"m": "1 kg", "l": "1 m", "g": f"{G} m s-2"},
        mass={"x": "m", "y": "m", "theta": "m*l**2/3"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={
            "x": "0 m",
            "v_x": "-10 m s-1",
            "y": f"{math.sin(1.0)!r} m",
            "v_y": "0 m s-1",
            "theta": "1 rad",
            "v_theta": "0 rad s-1",
        },
        contacts={
            "tip": {
                "gap": "y - l*sin(theta)",
                "restitution": 0,
                "tangential": "coulomb",
                "slip": "v_x + l*sin(theta)*v_theta/radian",
                "friction": "where(x < -3*metre, 4, 0.3)",
            }
        },
    )
    run = xd.simulate(model, method="rk4", step=0.001, until=1.0)
    assert run.attrs["run_outcome"] == "contact_undetermined"
    assert "friction of contact 'tip', with the coefficient 4: pressing harder" in run.attrs["run_outcome_text"]
    assert float(run.x[-1]) == pytest.approx(-3.0, abs=1e-9)  # where its friction jumps, which is located
    assert np.isfinite(run.contact_force_tip.values).all()


def test_a_block_is_held_by_both_of_its_corners() -> None:
    """Assert weight and friction of a block on an incline: what holds the same motion twice is no fault."""
    model = xd.Model(
        **BLOCK
        | {
            "forces": {"gravity": {"x": "m*g*sin(0.1)", "y": "-m*g*cos(0.1)"}},
            "initial": BLOCK["initial"] | {"v_x": "0 m s-1", "v_y": "0 m s-1", "v_theta": "0 rad s-1"},
        }
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=1.0)
    assert words(run) == []
    assert float(run.contact_force_left[-1] + run.contact_force_right[-1]) == pytest.approx(G * math.cos(0.1))
    assert float(run.friction_force_left[-1] + run.friction_force_right[-1]) == pytest.approx(-G * math.sin(0.1))
    # about the middle: N_right - N_left, times b, holds the friction, times h
    moment = 0.2 * float(run.contact_force_right[-1] - run.contact_force_left[-1])
    assert moment == pytest.approx(G * math.sin(0.1) * 1.0)


def wedge(e: float, law: str) -> xd.Model:
    """A ball between two oblique walls."""
    walls = {"right": "y*cos(0.6) - x*sin(0.6)", "left": "y*cos(0.4) + x*sin(0.4)"}
    return xd.Model(
        name="wedge",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "1 kg", "g": f"{G} m s-2"},
        mass={"x": "m", "y": "m"},
        forces={"gravity": {"potential": "m*g*y"}},
        initial={"x": "0.3 m", "y": "1 m", "v_x": "0 m s-1", "v_y": "0 m s-1"},
        contacts={name: {"gap": gap, "restitution": e, "law": law} for name, gap in walls.items()},
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("law", ["newton", "poisson", "sequential"])
@pytest.mark.parametrize("method", ["rk4", "dop853"])
def test_bounces_end_in_a_corner(law: str, method: str) -> None:
    """Assert that a ball comes to rest at the bottom of a wedge, held by both walls, after finitely many events."""
    run = xd.simulate(wedge(0.5, law), until=4.0, **asked(method, step=0.05))
    assert (run.attrs["run_outcome"], words(run)[-1][1]) == ("completed", "rest")
    assert len(words(run)) < 400
    # as with a rest_height of 1e-15 m, where nothing is skipped that rounding resolves
    assert float(run.event_time[-1]) == pytest.approx(2.852638342, abs=1e-4)
    assert abs(float(run.y[-1])) < 1e-9
    lift = float(run.contact_force_right[-1]) * math.cos(0.6) + float(run.contact_force_left[-1]) * math.cos(0.4)
    assert lift == pytest.approx(G, rel=1e-12)


@pytest.mark.parametrize("start", [1e5, 1e6, -1e6])
def test_rest_comes_at_any_time(start: float) -> None:
    """Assert rest where t is so large that it tells the last bounces no longer."""
    model = xd.Model(**table_of(ball(0.5)) | {"initial": {"t": f"{start} s", "y": "1 m", "v_y": "0 m s-1"}})
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=start + 3)
    assert words(run)[-1] == ("floor", "rest")
    assert float(run.event_time[-1]) - start == pytest.approx(3 * FIRST, abs=2e-6)


@pytest.mark.parametrize("asked", [{"method": "rk4", "step": 0.01}, {"method": "dop853", "rtol": 1e-9}])
def test_nanoseconds_are_as_good_as_seconds(asked: dict[str, Any]) -> None:
    """Assert the same events of a block that is thrown, bounces and slides, in m and s and in nm and ns, by what is default."""

    def thrown(length: str, time: str) -> xd.Model:
        return xd.Model(
            name="block",
            coordinates={"x": length, "y": length},
            parameters={"m": "2 kg", "g": f"9.81 {length} {time}-2"},
            mass={"x": "m", "y": "m"},
            forces={"gravity": {"potential": "m*g*y"}},
            initial={
                "x": f"0 {length}",
                "v_x": f"3 {length} {time}-1",
                "y": f"0.5 {length}",
                "v_y": f"0 {length} {time}-1",
            },
            contacts={
                "floor": {"gap": "y", "restitution": 0.4, "tangential": "coulomb", "slip": "v_x", "friction": 0.3}
            },
        )

    whole = xd.simulate(thrown("m", "s"), until="6 s", **asked)
    if "step" in asked:
        asked = asked | {"step": "0.01 ns"}
    small = xd.simulate(thrown("nm", "ns"), until="6 ns", **asked)
    assert words(small) == words(whole)
    assert 1e9 * small.event_time.values == pytest.approx(whole.event_time.values, rel=1e-12)
    assert float(small.x[-1]) == pytest.approx(float(whole.x[-1]), rel=1e-11)
    assert small.attrs["solver_time_tolerance"] == pytest.approx(6e-21)


def test_a_ball_of_a_picometre_rests_too() -> None:
    """Assert impacts and rest in their own time."""
    run = xd.simulate(ball(0.5, 1e-12), method="rk4", step=0.1, until=1.0)
    assert float(run.event_time[-1]) == pytest.approx(3e-6 * FIRST, rel=1e-4)


def test_the_same_floor_twice_is_one_floor() -> None:
    """Assert that a contact that has no share in an impulse is not glued to it."""
    model = xd.Model(**table_of(ball(1)) | {"contacts": {name: {"gap": "y", "restitution": 1} for name in ("a", "b")}})
    run = xd.simulate(model, method="dop853", rtol=1e-9, until=4.0)
    assert run.total_energy.values == pytest.approx(2 * G, rel=1e-9)
    assert np.unique(run.event_time.values.round(9)) == pytest.approx(FIRST * np.array([1, 3, 5, 7]), abs=1e-9)


def test_a_reset_lifts_a_body_off_its_floor() -> None:
    """Assert that it falls from where it was put."""
    lift = {"function": "t - 1*second", "direction": "rising", "action": "reset", "set": {"y": "0.5*metre"}}
    model = xd.Model(**table_of(ball(0.5, 0.0)), events={"lift": lift})
    run = xd.simulate(model, method="rk4", step=0.1, until=2.0)
    assert float(run.y[int(run.event_row_after[0])]) == 0.5
    assert float(run.event_time[[what == "impact" for _, what in words(run)].index(True)]) == pytest.approx(
        1 + math.sqrt(1 / G), abs=1e-12
    )


def test_a_second_scheme_agrees_at_its_order() -> None:
    """Assert that Moreau's steps come to the same motion as located events, to first order, and to the same rest."""
    located = xd.simulate(ball(0.5, 4.0, 8.0), method="dop853", rtol=1e-9, until=2.4)
    errors = []
    for step in (4e-3, 1e-3, 2.5e-4):
        run = xd.simulate(ball(0.5, 4.0, 8.0), method="moreau_jean", step=step, until=2.4)
        errors.append(np.abs(run.y.values - xd.sample(located, run.time.values).y.values).max())
        assert run.sizes["event"] == 0
    assert errors[0] < 0.03
    assert 2.5 < errors[0] / errors[1] < 6
    assert 2.5 < errors[1] / errors[2] < 6
    rest = xd.simulate(ball(0.5, 4.0, 8.0), method="moreau_jean", step=1e-3, until=4.0)
    assert float(rest.contact_force_floor[-1]) == pytest.approx(16.0, rel=1e-12)
    assert state_of(rest, "contact_state_floor") == "closed"
    slid = xd.simulate(sliding(), method="moreau_jean", step=1e-3, until=2.0)
    assert float(slid.x[-1]) == pytest.approx(9 / (0.6 * G), abs=1e-5)
    assert state_of(slid, "friction_state_floor") == "sticking"
    with pytest.raises(xd.InputError, match="no error estimate that knows of impacts"):
        xd.simulate(ball(), method="moreau_jean", rtol=1e-6, until=1.0)


# --------------------------------------------------------------------------------------- same bits, same evidence


def test_the_state_between_steps_is_that_of_its_contacts() -> None:
    """Assert samples in flight, while bounces are skipped, at rest, and while it sticks."""
    run = xd.simulate(ball(0.5, 4.0, 8.0), method="rk4", step=0.4, until=5.0)
    times = np.array([0.3, 1.3, 1.9, 2.9999, 3.5])
    flight = np.where(times < 1, 4 - 4 * times**2, np.where(times < 2, (times - 1) * (4 - 4 * (times - 1)), 0.0))
    found = xd.sample(run, times)
    assert found.y.values[[0, 1, 2, 4]] == pytest.approx(flight[[0, 1, 2, 4]], abs=1e-13)
    assert 0 <= float(found.y[3]) < 1e-8
    stuck = xd.sample(xd.simulate(sliding(), method="rk4", step=0.3, until=2.0), [0.25, 1.9])
    assert stuck.x.values == pytest.approx([0.75 - 0.5 * 0.3 * G * 0.0625, 9 / (0.6 * G)], abs=1e-14)


def test_a_run_goes_on_in_the_middle_of_a_contact(tmp_path: Any) -> None:
    """Assert equal digests of a run that was extended at rest, while settling, and in flight; and from its archive."""
    whole = xd.simulate(ball(0.5, 4.0, 8.0), method="rk4", step=0.1, until=5.0, nodes=["2.4 s", "2.99995 s", "4.05 s"])
    part = xd.simulate(ball(0.5, 4.0, 8.0), method="rk4", step=0.1, until=2.4)
    for until in (2.99995, 4.05, 5.0):
        part = xd.extend(part, until=until)
    assert xd.content_digest(part) == xd.content_digest(whole)
    xd.save(whole, tmp_path / "ball.nc")
    assert xd.reproduce(tmp_path / "ball.nc").attrs["identical"] == 1


def test_masses_and_bounces_of_many_runs_are_their_own() -> None:
    """Assert that runs through one place forget the contacts of the run before."""
    from xdynamics.march import Settings, march_many
    from xdynamics.march.configuration import settings_for

    model = ball(0.5, 4.0, 8.0)
    settings: Settings = settings_for(model, method="rk4", step=0.1, until=5.0)
    heights = np.array([4.0, 0.0, 1.0, 4.0])
    found = march_many(model, settings, initial={"y": heights}, logs=True)
    for i, height in enumerate(heights):
        alone = xd.simulate(ball(0.5, float(height), 8.0), method="rk4", step=0.1, until=5.0)
        assert found.log_of(i)[0].tolist() == alone.time.values.tolist()
        assert found.log_of(i)[2].tolist() == alone.y.values.tolist()


@pytest.mark.parametrize(
    ("contact", "said"),
    [
        ({"gap": "y"}, "key 'restitution' is missing"),
        ({"gap": "y", "restitution": 1.5}, "restitution is 1.5, needs to be from 0 to 1"),
        ({"gap": "y", "restitution": "-1/2"}, "restitution is -0.5, needs to be from 0 to 1"),
        ({"gap": "abs(y)", "restitution": 1}, "gap has a kink or a jump, abs"),
        (
            {"gap": "y", "restitution": 1, "tangential": "coulomb", "slip": "v_y", "friction": -0.3},
            "friction is -0.3, needs to be non-negative",
        ),
        (
            {"gap": "y", "restitution": 1, "tangential": "coulomb", "slip": "0*v_y", "friction": 0.3},
            "slip depends on no velocity",
        ),
        (
            {"gap": "y", "restitution": 1, "tangential": "coulomb", "slip": "v_y", "friction": 0.3, "static": 0.1},
            "static is 0.1, needs to be at least friction",
        ),
        ({"gap": "y", "restitution": "m"}, "restitution has units 'kg', needs '1'"),
        ({"gap": "y + v_y*second", "restitution": 1}, "gap reads the velocity 'v_y'"),
        ({"gap": "t*metre/second", "restitution": 1}, "gap depends on no coordinate"),
        ({"gap": "y + m", "restitution": 1}, "joins 'y' in 'm' with 'm' in 'kg'"),
        (
            {"gap": "y", "restitution": 1, "law": "hertz"},
            "law 'hertz' is not known; there are newton, poisson, sequential, energetic",
        ),
        ({"gap": "y", "restitution": 1, "friction": 0.3}, "friction is for tangential = 'coulomb'"),
        ({"gap": "y", "restitution": 1, "tangential": "coulomb"}, "tangential 'coulomb' needs slip and friction"),
        (
            {"gap": "y", "restitution": 1, "tangential": "coulomb", "slip": "y/second", "friction": 0.3},
            "slip depends on no velocity",
        ),
        (
            {
                "gap": "y",
                "restitution": 1,
                "tangential": "coulomb",
                "slip": "v_y*v_y/(1*metre/second)",
                "friction": 0.3,
            },
            "slip is not linear in v_y",
        ),
        ({"gap": "y", "restitution": 1, "tangential": "coulomb", "slip": "v_y", "friction": "g"}, "friction has units"),
        (
            {"gap": "y", "restitution": 1, "rest_height": "1 s"},
            "rest_height is '1.0 s', needs the unit of the gap, 'm'",
        ),
        ({"gap": "y", "restitution": 1, "rest_height": "-1 m"}, "needs to be non-negative"),
        ({"gap": "y", "restitution": 1, "time_tolerance": "0 s"}, "needs a positive time"),
        ({"gap": "y", "restitution": 1, "stiffness": "1 N m-1"}, "key 'stiffness' is not known"),
    ],
)
def test_wrong_contacts_are_named(contact: dict[str, Any], said: str) -> None:
    """Assert one clear fault for each wrong key, unit or expression."""
    with pytest.raises(xd.ModelError, match=f"contact 'floor': .*{said.replace('(', '[(]')}"):
        xd.Model(**table_of(ball()) | {"contacts": {"floor": contact}})


@pytest.mark.parametrize(("function", "direction"), [("y", "falling"), ("-y", "rising")])
def test_an_impact_as_an_events_action_is_a_contact(function: str, direction: str) -> None:
    """Assert that an event that acts by an impact is the contact of that name."""
    contact = table_of(ball())
    event = {"function": function, "direction": direction, "action": "impact"}
    given = {key: value for key, value in contact["contacts"].pop("floor").items() if key != "gap"}
    model = xd.Model(**contact | {"events": {"floor": event | given}})
    run, same = (xd.simulate(one, method="dop853", rtol=1e-9, until="2 s") for one in (model, ball()))
    assert np.array_equal(run.event_time, same.event_time)
    assert np.array_equal(run.v_y, same.v_y)
    assert xd.Model.from_text(run.model_toml.item()) == model


def test_what_parameters_decide_is_known_before_the_start() -> None:
    """Assert that restitution, friction and gaps are refused by their values, and nothing is marched."""
    table = table_of(sliding())
    floor = table["contacts"]["floor"]
    for changed, said in (
        ({"restitution": "2*e"}, r"contact 'floor': restitution, 2\*e, is 1.5 \(SI units\), needs to be from 0 to 1"),
        ({"friction": "-e"}, r"contact 'floor': friction, -e, is -0.75 \(SI units\), needs to be non-negative"),
        (
            {"friction": "e", "static": 0.5},
            r"contact 'floor': static is 0.5, needs to be at least friction, e, is 0.75",
        ),
        ({"gap": "y - metre"}, r"contact 'floor': gap is -1 \(SI units\) at the start: one body is inside the other"),
    ):
        with pytest.raises(xd.ModelError, match=said):
            xd.Model(
                **table | {"parameters": table["parameters"] | {"e": "0.75"}, "contacts": {"floor": floor | changed}}
            )
    with pytest.raises(xd.ModelError, match="gap is -0.1"):
        ball(0.5, -0.1)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"gap": "2*y"}, "the gap of contact 'floor' grows 2 times as fast as a distance"),
        ({"slip": "v_x + v_y"}, "the slip of contact 'floor' is not along its surface"),
        ({"gap": "2*y", "slip": "2*v_x"}, ""),
    ],
)
def test_a_gap_that_is_no_distance_is_doubted(changed: dict[str, str], said: str) -> None:
    """Assert what is said of friction by a gap, or a slip, that does not measure lengths."""
    table = table_of(sliding())
    model = xd.Model(**table | {"contacts": {"floor": table["contacts"]["floor"] | changed}})
    if not said:
        assert "distance" not in xd.simulate(model, method="rk4", step=0.01, until=0.1).attrs["run_outcome_text"]
        return
    with pytest.warns(xd.AccuracyWarning, match=said):
        xd.simulate(model, method="rk4", step=0.01, until=0.1)


def test_the_record_tells_what_a_contact_is() -> None:
    """Assert that gap, slip, coefficients and tolerances stand at the forces, with the sense in which they are positive."""
    run = xd.simulate(sliding(), method="rk4", step=0.01, until=0.1)
    normal, friction = run.contact_force_floor.attrs, run.friction_force_floor.attrs
    assert normal["long_name"] == "normal force of contact floor, positive where it pushes; 0 where it is open"
    assert (normal["gap"], normal["restitution"]) == ("y", "0")
    assert (friction["slip"], friction["friction"], friction["static"]) == ("v_x", "mu", "mu")
    assert "along positive slip" in friction["long_name"]
    assert (run.friction_force_floor.values[run.v_x.values > 0] < 0.0).all()


def test_an_impact_is_no_contact_twice() -> None:
    """Assert that a contact and an event that is one may not bear the same name."""
    table = table_of(ball())
    with pytest.raises(xd.ModelError, match="event 'floor' and contact 'floor' are both impacts; rename one"):
        xd.Model(**table | {"events": {"floor": {"function": "y", "action": "impact", "restitution": 0.5}}})


def test_faults_of_several_contacts_are_named_together() -> None:
    """Assert that laws are one, names are no events', and forces in Python are refused."""
    statement = table_of(ball())
    statement["contacts"]["roof"] = {"gap": "2*metre - y", "restitution": 1, "law": "poisson"}
    statement["events"] = {"floor": {"function": "y"}}
    with pytest.raises(xd.ModelError, match="contact 'floor' and event 'floor' both claim the name 'detector floor'"):
        xd.Model(**statement)
    del statement["events"]
    with pytest.raises(xd.ModelError, match="contacts have several laws .'floor': newton, 'roof': poisson."):
        xd.Model(**statement)


def test_implicit_methods_say_that_they_have_no_derivatives() -> None:
    """Assert the refusal, with the methods that fit, and that differences do."""
    with pytest.raises(
        xd.InputError, match="implicit_midpoint' refuses the model 'ball': it is not defined for contacts"
    ):
        xd.simulate(ball(), method="implicit_midpoint", step=0.1, until=1.0)
    run = xd.simulate(ball(), method="radau_iia", jacobian="differences", rtol=1e-9, until=1.0)
    assert run.event_time.values == pytest.approx([FIRST], abs=1e-12)
    assert float(run.v_y[int(run.event_row_after[0])]) == pytest.approx(E * math.sqrt(2 * G))
