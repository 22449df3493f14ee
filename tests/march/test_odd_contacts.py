"""Contacts of many bodies that nobody thinks of first: angles, masses of all sizes, corners, few links, long rests.

A body slides down from another, among enough that their contacts are not written out: which methods keep their order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.faults import InputError

G = 9.81
VERLET: dict[str, Any] = {"method": "velocity_verlet", "step": "10 ms"}


def given(unit: str, values: Any) -> dict[str, Any]:
    """Return starting values, or those of a parameter."""
    return {"unit": unit, "value": np.asarray(values, float).tolist()}


@pytest.mark.parametrize("unit", ["rad", "degree"])
def test_stops_of_angles(unit: str) -> None:
    """Assert that rods fall on stops, bounce and rest by their series, with torques and gaps along them."""
    start = np.linspace(0.1, 0.5, 30)
    model = xd.Model(
        name="rods",
        dimensions={"rod": 30},
        coordinates={"q": {"unit": unit, "dims": ["rod"]}},
        parameters={"I": "2 kg m2", "T": "3 N m"},
        mass={"q": "I/radian**2"},
        forces={"pull": {"q": "-T/radian"}},
        contacts={"stop": {"gap": "q", "restitution": 0.5}},
        initial={"q": given("rad", start)},
    )
    run = xd.simulate(model, until="3 s", log="full", **VERLET)
    rest = run.event_kind.values == run.event_kind.attrs["flag_meanings"].split().index("rest")
    rods = run.event_rod.values[rest]
    series = 3 * np.sqrt(2 * start[rods] / 1.5)
    away = np.abs(run.event_time.values[rest] - series)
    assert sorted(rods.tolist()) == [*range(30)]
    assert (away <= run.event_time_uncertainty.values[rest] * (1 + 1e-6) + 1e-11).all()
    assert run.contact_force_stop.attrs["units"] == "N m"
    assert np.abs(run.contact_force_stop.values[-1] - 3.0).max() < 1e-14
    assert np.abs(run.contact_gap_stop.values[0] - start).max() < 1e-15


@pytest.mark.parametrize("ratio", [1e4, 1e8])
def test_masses_of_all_sizes(ratio: float) -> None:
    """Assert forces in a stack of heavy and light balls in turn, and speeds after heavy ones have struck light ones."""
    mass = np.tile([1.0, ratio], 13)
    shared: dict[str, Any] = {
        "dimensions": {"ball": 26},
        "relations": {"pair": {"of": "ball"}},
        "coordinates": {"x": {"unit": "m", "dims": ["ball"]}},
        "mass": {"x": "m"},
        "parameters": {"m": {"dims": ["ball"], **given("kg", mass)}, "g": f"{G} m s-2"},
    }
    meeting = {"gap": "second(x, pair) - first(x, pair) - 1*metre", "restitution": 1}
    stack = xd.Model(
        name="stack",
        forces={"weight": {"x": "-m*g"}},
        contacts={"floor": {"gap": "x", "restitution": 1}, "balls": meeting},
        initial={"x": given("m", np.arange(26))},
        **shared,
    )
    run = xd.simulate(stack, until="20 ms", log="full", **VERLET)
    last = run.closed_step.values == run.sizes["step"] - 1
    above = G * np.cumsum(mass[::-1])[::-1]
    assert run.closed_force.values[last] == pytest.approx(above, rel=1e-13)
    assert np.abs(run.x.values - np.arange(26)).max() < 1e-13
    places = np.repeat(10.0 * np.arange(13), 2) + np.tile([0.0, 1.5], 13)
    start = {"x": given("m", places), "v_x": given("m s-1", np.tile([0.0, -1.0], 13))}
    struck = xd.simulate(
        xd.Model(name="pairs", contacts={"balls": meeting}, initial=start, **shared), until="1 s", **VERLET
    )
    light = 2 * ratio / (ratio + 1)
    assert struck.v_x.values[-1] == pytest.approx(np.tile([-light, 1 - light * 1.0], 13), rel=1e-13)


@pytest.mark.dear
def test_corners_are_struck_at_one_time() -> None:
    """Assert that points which fly into corners come out on their own paths, and rest in a groove on two links each."""
    speed = np.linspace(0.5, 3.0, 30)
    corner = xd.Model(
        name="corner",
        dimensions={"disc": 30, "axis": ["x", "y"]},
        coordinates={"r": {"unit": "m", "dims": ["disc", "axis"]}},
        mass={"r": "2*kilogram"},
        contacts={"walls": {"gap": "r", "restitution": 0.5}},
        initial={"r": given("m", np.ones((30, 2))), "v_r": given("m s-1", -speed[:, None] * np.ones(2))},
    )
    run = xd.simulate(corner, until="2.5 s", **VERLET)
    assert np.abs(run.v_r.values[-1] - 0.5 * speed[:, None]).max() < 1e-14
    assert run.sizes["event"] == 60
    assert np.unique(run.event_time.values).size == 30
    left, right = ("0.6*x + 0.8*y", "-0.6*x + 0.8*y")
    groove = xd.Model(
        name="groove",
        dimensions={"disc": 20},
        coordinates={name: {"unit": "m", "dims": ["disc"]} for name in "xy"},
        mass={"x": "2*kilogram", "y": "2*kilogram"},
        forces={"weight": {"y": f"-2*{G}*newton"}},
        contacts={"left": {"gap": left, "restitution": 0.5}, "right": {"gap": right, "restitution": 0.5}},
        initial={"x": given("m", np.zeros(20)), "y": given("m", np.zeros(20))},
    )
    rests = xd.simulate(groove, until="0.1 s", log="full", **VERLET)
    assert np.abs(rests.contact_force_left.values - G / 0.8).max() < 1e-14 * G
    assert np.abs(rests.y.values).max() < 1e-15


@pytest.mark.parametrize(
    ("count", "relation", "said"),
    [
        (1, {"of": "ball"}, "relation 'pair': has no link, and needs one or more: 'ball' has one element"),
        (1, {"of": "ball", "neighbours": 1}, "relation 'pair': has no link"),
        (2, {"of": "ball", "neighbours": 1, "ring": True}, "links would be there twice"),
        (2, {"of": "ball"}, ""),
    ],
)
def test_relations_of_no_link_and_of_one(count: int, relation: dict[str, Any], said: str) -> None:
    """Assert one sentence where there is no link, and the closed form of the impact of one."""
    sections: dict[str, Any] = {
        "name": "few",
        "dimensions": {"ball": count},
        "relations": {"pair": relation},
        "coordinates": {"x": {"unit": "m", "dims": ["ball"]}},
        "mass": {"x": "1*kilogram"},
        "contacts": {"balls": {"gap": "second(x, pair) - first(x, pair) - 1*metre", "restitution": 1}},
        "initial": {"x": given("m", 2.0 * np.arange(count)), "v_x": given("m s-1", 2.0 - 2.0 * np.arange(count))},
    }
    if said:
        with pytest.raises(xd.ModelError, match=said):
            xd.Model(**sections)
        return
    run = xd.simulate(xd.Model(**sections), until="1 s", **VERLET)
    assert np.abs(run.v_x.values[-1] - [0.0, 2.0]).max() < 1e-15
    assert np.abs(run.x.values[-1] - [1.0, 3.0]).max() < 1e-11


@pytest.mark.parametrize("steps", [pytest.param(100_000, marks=pytest.mark.dear), 3_000])
def test_a_stack_stands_for_long(steps: int) -> None:
    """Assert that nothing drifts in a stack of 30 balls, however many steps it stands for."""
    model = xd.Model(
        name="stack",
        dimensions={"ball": 30},
        relations={"pair": {"of": "ball"}},
        coordinates={"x": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": {"dims": ["ball"], **given("kg", np.linspace(2.0, 1.0, 30))}},
        mass={"x": "m"},
        forces={"weight": {"x": f"-m*{G}*metre/second**2"}},
        contacts={
            "floor": {"gap": "x - 0.5*metre", "restitution": 0.5},
            "balls": {"gap": "second(x, pair) - first(x, pair) - 1*metre", "restitution": 0.5},
        },
        initial={"x": given("m", np.arange(30) + 0.5)},
    )
    asked: dict[str, Any] = {"method": "velocity_verlet", "step": 1e-3, "until": steps * 1e-3, "log": "states"}
    run = xd.simulate(model, keep_every=1000, force_samples="none", **asked)
    assert int(run.step_number[-1]) == steps
    assert np.abs(run.x.values - run.x.values[0]).max() < 1e-13
    assert np.abs(run.v_x.values).max() < 1e-15


def beads(mass: str) -> xd.Model:
    """Return eight beads on a line, which close in on each other."""
    return xd.Model(
        name="beads",
        dimensions={"ball": 8},
        relations={"pair": {"of": "ball"}},
        coordinates={"x": {"unit": "m", "dims": ["ball"]}},
        parameters={"weights": {"dims": ["ball"], "value": "(1 + mod(3*index(ball), 5))*kilogram"}},
        mass={"x": mass},
        initial={"x": "0.15*index(ball)*metre", "v_x": "-0.1*index(ball)*metre/second"},
        contacts={"balls": {"gap": "second(x, pair) - first(x, pair) - 0.1*metre", "restitution": 1}},
    )


def test_masses_of_many_links_are_not_those_of_the_first() -> None:
    """Assert that masses written with numbers of elements, of which impulses knew the first alone, are refused."""
    with pytest.raises(InputError, match="the mass of 'x' differs from element to element.*make it a parameter"):
        xd.simulate(beads("kilogram*(1 + mod(3*index(ball), 5))"), **VERLET, until=0.7)


@pytest.mark.parametrize(
    ("mass", "weights"), [("weights", [1.0 + 3 * number % 5 for number in range(8)]), ("2*kilogram", [2.0] * 8)]
)
def test_impulses_of_many_links_keep_momentum(mass: str, weights: list[float]) -> None:
    """Assert it with the mass of each bead."""
    run = xd.simulate(beads(mass), **VERLET, until=2.0)
    momentum = (run.v_x.values * weights).sum(axis=1)
    assert run.sizes["event"] >= 7
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-13)


SLIDING = """
name = "A disc slides down from another, others lie apart"

[dimensions]
disc = 12
axis = ["x", "y"]

[relations.pair]
of = "disc"

[coordinates]
r = { unit = "m", dims = ["disc", "axis"] }

[parameters]
m = "1 kg"
g = "9.81 m s-2"
radius = "0.5 m"
up = { dims = ["axis"], values = { x = "0", y = "1" } }

[mass]
r = "m"

[forces.weight]
r = "-m*g*up"

[contacts.floor]
gap = "sum(r*up, axis) - radius"
restitution = 0

[contacts.discs]
gap = "norm(second(r, pair) - first(r, pair), axis) - 2*radius"
restitution = 0

[initial]
r = { unit = "m", value = PLACES }
v_r = { unit = "m/s", value = RESTS }
"""
PLACES = [[0, 0.5], [0.6, 1.3]] + [[10 * (k + 1), 0.5] for k in range(10)]
REFUSED = ["euler_cromer", "ruth3", "forest_ruth", "pefrl", "yoshida6", "kahan_li6", "yoshida8", "kahan_li8", "dprkn6"]
END = 0.2  # s; the disc lifts off at 0.277 s


def sliding(restitution: str = "0") -> xd.Model:
    """Return the discs, with a coefficient of restitution."""
    return xd.Model.from_text(filled(SLIDING).replace("restitution = 0", f"restitution = {restitution}"))


def filled(text: str) -> str:
    """Fill in where the discs begin, at rest."""
    return text.replace("PLACES", str(PLACES)).replace("RESTS", str([[0, 0]] * 12))


@pytest.mark.parametrize("method", REFUSED)
def test_methods_that_would_lose_their_order_are_refused(method: str) -> None:
    """Assert that the message names the contact, that a floor alone is none, nor balls that always bounce."""
    assert xd.METHODS[method].refusals(sliding()) == [
        "it is not defined for contacts of many links along curved gaps, whose forces depend on velocities (discs)"
    ]
    assert not xd.METHODS[method].refusals(sliding("1"))
    floor = SLIDING[: SLIDING.index("[contacts.discs]")] + SLIDING[SLIDING.index("[initial]") :]
    assert not xd.METHODS[method].refusals(xd.Model.from_text(filled(floor)))


@pytest.mark.parametrize(
    ("method", "order"), [("averaged_velocity", 1), ("velocity_verlet", 2), ("rk4", 4), ("radau_iia", 5)]
)
def test_methods_that_are_taken_keep_their_order(method: str, order: int) -> None:
    """Assert the order of the state, held all the time, by three steps beside an eighth-order method."""
    model, asked = sliding(), {"until": END, "log": "states", "force_samples": "none"}
    exact = xd.simulate(model, method="dop853", rtol=1e-13, **asked)
    errors = []
    for step in (0.02, 0.01):
        run = xd.simulate(model, method=method, step=step, **asked)
        assert run.sizes["event"] == 0
        errors.append(float(abs(run.r[-1] - exact.r[-1]).max() + END * abs(run.v_r[-1] - exact.v_r[-1]).max()))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


def test_bodies_that_bounce_for_ever_but_begin_in_touch_are_doubted() -> None:
    """Assert that the outcome says that the order was lost, of a method that loses it, and of no other."""
    asked = {"step": "10 ms", "until": END}
    with pytest.warns(
        xd.AccuracyWarning, match=r"curved gaps \(discs\), .*'yoshida6' is not of order 6, but of 2 or less"
    ):
        run = xd.simulate(sliding("1"), method="yoshida6", **asked)
    assert "held by contacts along curved gaps" in run.attrs["run_outcome_text"]
    run = xd.simulate(sliding("1"), method="rk4", **asked)
    assert "held by" not in run.attrs["run_outcome_text"]
