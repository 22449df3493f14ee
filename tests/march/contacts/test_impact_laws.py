"""Laws of impact with friction: the energetic coefficient against integration over the impulse, and energy that is created."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import ball, cradle, words
from cases.impacts import Rod, integrated, random_rod, speeds_behind
from xdynamics.model.parts import IMPACT_LAWS

PARADOX = Rod(1.0, 1 / 12, 0.5, math.pi / 4, 0.5, 1.0, (0.5, -1.0, 0.0))  # a uniform rod that sticks as it rebounds


@pytest.mark.cases(400)
def test_the_energetic_law_is_its_definition(case: int) -> None:
    """Assert velocities to 1e-9 of an integration over the impulse, energy recorded as lost, and never created."""
    rod = random_rod(case)
    run = rod.struck("energetic")
    assert words(run)[0] == ("floor", "impact")
    before, after = np.array(rod.speeds), speeds_behind(run)
    exact = integrated(rod.rows, rod.mass, before, rod.mu, rod.e)
    assert np.abs(after - exact).max() <= 1e-9 * (np.abs(before).max() + np.abs(exact).max())
    whole, lost = rod.kinetic(before), float(run.event_energy_lost[0])
    assert lost == pytest.approx(whole - rod.kinetic(after), abs=1e-11 * whole)
    assert lost >= -1e-13 * whole


@pytest.mark.cases(100)
def test_laws_agree_where_there_is_no_friction(case: int) -> None:
    """Assert the velocities of one frictionless contact: Newton's, by each law."""
    rod = random_rod(case)
    before, row = np.array(rod.speeds), rod.rows[0]
    reach = np.linalg.solve(rod.mass, row)
    exact = before - (1.0 + rod.e) * (row @ before) / (row @ reach) * reach
    for law in IMPACT_LAWS:
        run = rod.struck(law, tangential="frictionless", slip=None, friction=None)
        assert speeds_behind(run) == pytest.approx(exact, rel=1e-12, abs=1e-12 * np.abs(before).max())


@pytest.mark.parametrize("law", IMPACT_LAWS)
@pytest.mark.parametrize("e", [0.0, 0.35, 1.0])
def test_laws_agree_where_an_impact_is_central(law: str, e: float) -> None:
    """Assert a ball that strikes head on, with a floor that would hold it: -e times its speed by each law, no slip."""
    model = xd.Model(
        name="head on",
        coordinates={"x": "m", "y": "m"},
        parameters={"m": "2 kg"},
        mass={"x": "m", "y": "m"},
        forces={},
        initial={"x": "0 m", "y": "0.1 m", "v_x": "0 m s-1", "v_y": "-3 m s-1"},
        contacts={
            "floor": {"gap": "y", "restitution": e, "law": law, "tangential": "coulomb", "slip": "v_x", "friction": 0.7}
        },
    )
    run = xd.simulate(model, method="rk4", step=0.01, until=0.1)
    assert speeds_behind(run, ("x", "y")) == pytest.approx([0.0, 3.0 * e], abs=1e-14)


@pytest.mark.cases(400)
def test_poisson_creates_no_energy_either(case: int) -> None:
    """Assert that no rod gains energy by Poisson's law."""
    rod = random_rod(case)
    run = rod.struck("poisson")
    assert float(run.event_energy_lost[0]) >= -1e-12 * rod.kinetic(np.array(rod.speeds))


@pytest.mark.parametrize("law", ["newton", "sequential"])
def test_energy_that_is_created_is_spoken_against(law: str) -> None:
    """Assert Kane's paradox of one rod: 17.5 % by Newton's law, said in warning and outcome with the event that did it.

    It sticks as it rebounds, so that rates of gap and slip go from (-1, 1/2) to (1, 0) m/s: the energy changes by half of
    the impulses times the sums of the rates before and after, which is 7/64 J of 5/8.
    """
    with pytest.warns(
        xd.AccuracyWarning,
        match=r"energy was created in an impact at event 0 \('floor', t = 5e-05 s, event_energy_lost = -0\.109 J\).*law = 'poisson' and law = 'energetic' do not",
    ):
        run = PARADOX.struck(law)
    assert float(run.event_energy_lost[0]) == pytest.approx(-7 / 64, rel=1e-12)
    assert float(run.kinetic_energy[-1] / run.kinetic_energy[0]) == pytest.approx(1.175, rel=1e-12)
    assert "energy was created in an impact at event 0 ('floor'" in run.attrs["run_outcome_text"]
    assert run.attrs["run_outcome"] == "completed"


@pytest.mark.parametrize("law", ["poisson", "energetic"])
def test_energy_that_is_not_created_is_not_spoken_of(law: str) -> None:
    """Assert that the same rod loses energy by the laws that are named instead."""
    run = PARADOX.struck(law)
    assert float(run.event_energy_lost[0]) > 0.04
    assert "energy" not in run.attrs["run_outcome_text"]


def pendulum(law: str, e: float = 0.7, mu: float = 0.5) -> xd.Model:
    """Two rods on a pivot, whose end strikes a floor: 20 and 30 degrees, -0.1 and -0.2 rad/s.

    T. R. Kane, D. A. Levinson, Dynamics: Theory and Applications, 1985, section 5.9; the rods are of 1 kg and 1 m.
    """
    q1, q2 = math.radians(20), math.radians(30)
    before = 1e-4
    reach = math.cos(q1) + math.cos(q2)
    return xd.Model(
        name="double pendulum",
        coordinates={"q1": "rad", "q2": "rad"},
        parameters={"m": "1 kg", "l": "1 m", "reach": f"{reach!r} m"},
        mass={
            "matrix": [
                ["4/3*m*l**2/radian**2", "m*l**2*cos(q1 - q2)/(2*radian**2)"],
                ["m*l**2*cos(q1 - q2)/(2*radian**2)", "m*l**2/(3*radian**2)"],
            ]
        },
        forces={},
        initial={
            "q1": f"{q1 + 0.1 * before!r} rad",
            "q2": f"{q2 + 0.2 * before!r} rad",
            "v_q1": "-0.1 rad s-1",
            "v_q2": "-0.2 rad s-1",
        },
        contacts={
            "floor": {
                "gap": "reach - l*(cos(q1) + cos(q2))",
                "restitution": e,
                "law": law,
                "tangential": "coulomb",
                "slip": "l*(cos(q1)*v_q1 + cos(q2)*v_q2)/radian",
                "friction": mu,
            }
        },
    )


@pytest.mark.dear
def test_kane_and_levinsons_pendulum_is_no_paradox() -> None:
    """Assert that their double pendulum nearly triples its energy by Newton's law, and by the energetic one loses some."""
    with pytest.warns(xd.AccuracyWarning, match="energy was created"):
        newton = xd.simulate(pendulum("newton"), method="rk4", step=1e-5, until=2e-4)
    energies = newton.kinetic_energy.values
    assert energies[-1] / energies[0] == pytest.approx(2.7576, abs=1e-3)
    run = xd.simulate(pendulum("energetic"), method="rk4", step=1e-5, until=2e-4)
    q1, q2 = math.radians(20), math.radians(30)
    rows = np.array([[math.sin(q1), math.sin(q2)], [math.cos(q1), math.cos(q2)]])
    mass = np.array([[4 / 3, math.cos(q1 - q2) / 2], [math.cos(q1 - q2) / 2, 1 / 3]])
    exact = integrated(rows, mass, np.array([-0.1, -0.2]), 0.5, 0.7)
    assert speeds_behind(run, ("q1", "q2")) == pytest.approx(exact, abs=1e-7)
    assert 0.5 < float(run.kinetic_energy[-1] / run.kinetic_energy[0]) < 1.0


@pytest.mark.dear
def test_a_run_that_is_extended_remembers_what_was_created() -> None:
    """Assert that behind its end, too, the outcome speaks of the energy."""
    asked = {"method": "dop853", "rtol": 1e-10, "time_tolerance": 1e-15}
    with pytest.warns(xd.AccuracyWarning, match="energy was created"):
        whole = xd.simulate(PARADOX.model("newton"), until=2e-4, nodes=["1e-4 s"], **asked)
    with pytest.warns(xd.AccuracyWarning, match="energy was created"):
        longer = xd.extend(xd.simulate(PARADOX.model("newton"), until=1e-4, **asked), until=2e-4)
    assert longer.attrs["run_outcome_text"] == whole.attrs["run_outcome_text"]
    assert xd.content_digest(longer) == xd.content_digest(whole)


# ------------------------------------------------------------------------------------------------ several contacts


def test_contacts_that_do_not_act_on_each_other_are_struck_each_alone() -> None:
    """Assert a ball in a corner with friction on either wall: each wall as if it were alone."""

    def corner(**walls: dict[str, Any]) -> Any:
        model = xd.Model(
            name="corner",
            coordinates={"x": "m", "y": "m", "u": "m", "w": "m"},
            parameters={"m": "1 kg"},
            mass=dict.fromkeys("xyuw", "m"),
            forces={},
            initial={
                "x": "0.1 m",
                "y": "0.1 m",
                "u": "0 m",
                "w": "0 m",
                "v_x": "-1 m s-1",
                "v_y": "-1 m s-1",
                "v_u": "0.3 m s-1",
                "v_w": "-2 m s-1",
            },
            contacts=walls,
        )
        return xd.simulate(model, method="rk4", step=0.01, until=0.15)

    common = {"law": "energetic", "tangential": "coulomb"}
    left = common | {"gap": "x", "restitution": 0.5, "slip": "v_u", "friction": 0.4}
    floor = common | {"gap": "y", "restitution": 0.8, "slip": "v_w", "friction": 0.2}
    both, first, second = corner(left=left, floor=floor), corner(left=left), corner(floor=floor)
    assert [what for what, _ in words(both)] == ["left", "floor"]
    assert [float(both[name][-1]) for name in ("v_x", "v_u")] == [float(first[name][-1]) for name in ("v_x", "v_u")]
    assert [float(both[name][-1]) for name in ("v_y", "v_w")] == [float(second[name][-1]) for name in ("v_y", "v_w")]


def test_contacts_that_act_on_each_other_are_refused() -> None:
    """Assert one clear line for a ball that strikes two that touch: their stiffnesses would decide."""
    run = xd.simulate(cradle("energetic", 0.5), method="rk4", step=0.3, until=2.0)
    assert run.attrs["run_outcome"] == "contact_undetermined"
    assert (
        "contacts 'first', 'second' touch at once and act on each other, and law = 'energetic' is for one contact at a time: how"
        " several share an impulse depends on their stiffnesses; choose law = 'poisson' or 'sequential'"
    ) in run.attrs["run_outcome_text"]


@pytest.mark.parametrize(("inertia", "outcome"), [("2*m*b**2", "completed"), ("m*b**2/3", "contact_undetermined")])
def test_a_contact_that_only_parts_is_no_obstacle(inertia: str, outcome: str) -> None:
    """Assert a plank that rests on one end, whose other end comes down: the first is let go, or pressed and refused."""

    def plank(*ends: str) -> Any:
        gaps = {"left": "y - b*theta/radian", "right": "y + b*theta/radian"}
        model = xd.Model(
            name="plank",
            coordinates={"y": "m", "theta": "rad"},
            parameters={"m": "3 kg", "b": "1 m"},
            mass={"y": "m", "theta": f"{inertia}/radian**2"},
            forces={},
            initial={"y": "0.1 m", "theta": "0.1 rad", "v_y": "-1 m s-1", "v_theta": "-1 rad s-1"},
            contacts={end: {"gap": gaps[end], "restitution": 0.5, "law": "energetic"} for end in ends},
        )
        return xd.simulate(model, method="rk4", step=0.01, until=0.15)

    alone, both = plank("right"), plank("left", "right")
    assert both.attrs["run_outcome"] == outcome
    if outcome == "completed":
        assert words(both) == [("right", "impact"), ("left", "takeoff")]
        assert all(float(both[name][-1]) == float(alone[name][-1]) for name in ("v_y", "v_theta"))


def test_a_body_of_one_coordinate_that_is_held_stays() -> None:
    """Assert a pendulum whose tip friction holds: gap and slip are one motion, and nothing rebounds."""
    model = xd.Model(
        name="pendulum",
        coordinates={"q": "rad"},
        parameters={"j": "1 kg m2"},
        mass={"q": "j/radian**2"},
        forces={},
        initial={"q": "0.1 rad", "v_q": "-1 rad s-1"},
        contacts={
            "floor": {
                "gap": "q*metre/radian",
                "restitution": 0.5,
                "law": "energetic",
                "tangential": "coulomb",
                "slip": "-0.5*v_q*metre/radian",
                "friction": 2.5,
            }
        },
    )
    run = xd.simulate(model, method="rk4", step=0.01, until=0.3)
    assert float(run.v_q[-1]) == pytest.approx(0.0, abs=1e-14)


def test_the_law_stands_in_the_model_and_the_record() -> None:
    """Assert that the file, the record and a bouncing ball to its rest know the law."""
    model = ball(law="energetic")
    assert xd.Model.from_text(model.to_toml()) == model
    run, same = (xd.simulate(one, method="rk4", step=0.05, until=10.0) for one in (model, ball()))
    assert run.event_impulse_y.attrs["impact_law"] == "energetic"
    assert run.event_time.values == pytest.approx(same.event_time.values, abs=1e-11)
    assert words(run)[-1] == ("floor", "rest")


def test_steps_that_locate_no_impact_refuse_the_law() -> None:
    """Assert that Moreau's steps, which have Newton's law, are not recorded as another one."""
    with pytest.raises(
        xd.InputError,
        match="'moreau_jean' refuses .*: it has Newton's law of restitution over whole steps, and law = 'energetic'",
    ):
        xd.simulate(ball(law="energetic"), method="moreau_jean", step="1 ms", until="1 s")


@pytest.mark.parametrize("name", ["floor", "belt"])
def test_steps_that_locate_no_slip_refuse_static_friction(name: str) -> None:
    """Assert that Moreau's steps march what sticks by the friction it slips by, and refuse what sticks by more."""
    friction = {"floor": {"friction": 0.2}, "belt": {"kinetic": "2*newton"}}[name]
    static = {"floor": {"static": 0.35}, "belt": {"static": "3.5*newton"}}[name]
    run = xd.simulate(dragged(name, friction), method="moreau_jean", step=1 / 64, until=3.0)
    assert float(run.x[-1]) == pytest.approx((3.0 - 1.0) ** 3 / 3, abs=1e-3)  # from t = mu*m*g/(2 N/s) on
    with pytest.raises(xd.InputError, match=f"'{name}' sticks up to another, its `static`.*leave static out"):
        xd.simulate(dragged(name, friction | static), method="moreau_jean", step=1 / 64, until=3.0)


def dragged(name: str, friction: dict[str, Any]) -> xd.Model:
    """A block of 1 kg on a floor or a belt, which a force drags that grows by 2 N/s."""
    floor = {"gap": "y", "restitution": 0}
    if name == "floor":
        floor |= {"tangential": "coulomb", "slip": "v_x"} | friction
    return xd.Model(
        name="block",
        coordinates={"x": {"unit": "m"}, "y": {"unit": "m"}},
        mass={"x": "1*kilogram", "y": "1*kilogram"},
        forces={"drag": {"x": "2*newton/second*t"}, "weight": {"y": "-10*newton"}},
        initial={"x": "0 m", "v_x": "0 m s-1", "y": "0 m", "v_y": "0 m s-1"},
        contacts={"floor": floor},
        frictions={} if name == "floor" else {"belt": {"slip": "v_x"} | friction},
    )
