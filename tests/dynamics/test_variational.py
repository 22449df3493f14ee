"""Slopes by variational equations: closed forms, every kind of event, and runs that they do not tell."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr

import xdynamics as xd
from cases.problems import MODELS, particle
from cases.uncertain_models import doubtful, slope
from xdynamics.budgeting.measurand import Measurand, Target
from xdynamics.budgeting.physical import (
    _check_open,
    _variational_equations,
    difference_slopes,
    shifted_copies,
    variational_slopes,
)
from xdynamics.dynamics.variational import NotVariedError, gauss

TIGHT: dict[str, Any] = {"method": "dop853", "rtol": 1e-12}


def slopes(model: xd.Model, quantity: str, **where: Any) -> tuple[dict[str, float], dict[str, float]]:
    """Slopes of a number by variational equations, and by differences."""
    asked = {key: where.pop(key) for key in list(where) if key not in ("at", "event", "occurrence", "side")}
    place = {"at": None, "event": None, "occurrence": 1, "side": "before"} | where
    target, settings = Target.from_arguments(model, quantity, **place), TIGHT | {"time_tolerance": "1e-13 s"} | asked
    names, measurand = [*model.uncertain], Measurand(model, target, settings)
    by_equations = variational_slopes(xd.simulate(model, **settings), model, target, names)
    return by_equations, {
        name: one
        for name, (one, *_) in difference_slopes(measurand, names, 0.0, shifted_copies(measurand, names).values).items()
    }


def agree(model: xd.Model, quantity: str, close: float = 1e-9, **where: Any) -> dict[str, float]:
    """Compare both ways; return the slopes."""
    found, known = slopes(model, quantity, **where)
    assert found == pytest.approx(known, rel=close)
    assert all(abs(one) > 1e-9 for one in found.values())
    return found


def falling(**more: Any) -> xd.Model:
    """A ball with an uncertain start and gravity that meets what is added."""
    made = {
        "name": "ball",
        "coordinates": {"y": "m"},
        "mass": {"y": "1*kilogram"},
        "forces": {"gravity": {"y": "-g*1*kilogram"}},
        "parameters": {"g": {"value": "9.81 m s-2", "uncertainty": 1e-3}, "e": {"value": "0.8", "uncertainty": 1e-3}},
        "initial": {"y": {"value": "1 m", "uncertainty": 1e-3}, "v_y": {"value": "0.5 m s-1", "uncertainty": 1e-3}},
        "run": {"method": "dop853", "until": "2 s"},
    }
    return xd.Model(**made | more)


@pytest.mark.parametrize("stages", range(1, 9))
def test_collocation_is_gauss(stages: int) -> None:
    """Assert that nodes and weights integrate polynomials of degree 2 s - 1, and stages those of s - 1."""
    nodes, inner, ends = gauss(stages)
    for k in range(2 * stages):
        assert float(np.sum(ends * nodes**k)) == pytest.approx(1.0 / (k + 1), rel=1e-14)
    for k in range(stages):
        assert (inner * nodes**k).sum(axis=1) == pytest.approx(nodes ** (k + 1) / (k + 1), abs=1e-15)


@pytest.mark.dear
def test_the_tenth_impact_to_rounding() -> None:
    """Assert dt/de and dt/dh of the tenth impact to 1e-14, where differences come to 1e-12."""
    model = doubtful(xd.Model.from_toml(MODELS / "bouncing_ball.toml"), e="uncertainty = 0.001", y="half_width = 0.001")
    found, _ = slopes(model, "t", event="floor", occurrence=10)
    e, fall = 0.9, math.sqrt(2.0 / 9.81)
    assert found["e"] == pytest.approx(fall * 2 * sum(k * e ** (k - 1) for k in range(1, 10)), rel=3e-14)
    assert found["y"] == pytest.approx(fall * (1 + 2 * sum(e**k for k in range(1, 10))) / 2, rel=3e-14)


def bounced(y: complex, v_y: complex, g: complex, e: complex) -> dict[tuple[Any, ...], complex]:
    """What a ball of 2 kg that a floor at 0 turns by e comes to, SI: by quantity, time, occurrence and side of the bounce."""
    speed: complex = (v_y**2 + 2 * g * y) ** 0.5
    met, late = (v_y + speed) / g, 0.95
    return {
        ("y", 0.3): y + v_y * 0.3 - g * 0.045,
        ("v_y", 0.25): v_y - g * 0.25,
        ("kinetic_energy", 0.25): (v_y - g * 0.25) ** 2,
        ("t", None, 1, "before"): met,
        ("t", None, 2, "after"): met + 2 * e * speed / g,
        ("v_y", None, 1, "before"): -speed,
        ("v_y", None, 1, "after"): e * speed,
        ("v_y", None, 2, "before"): -e * speed,
        ("y", late): e * speed * (late - met) - g * (late - met) ** 2 / 2,
        ("v_y", late): e * speed - g * (late - met),
    }


def test_slopes_of_a_bounce_are_closed_forms_in_their_own_units() -> None:
    """Assert values before, at and behind a bounce: of mm, mm s-1, s and J by cm, km h-1 and m s-2."""
    model = xd.Model(
        name="ball",
        coordinates={"y": "mm"},
        mass={"y": "2*kilogram"},
        forces={"gravity": {"potential": "2*kilogram*g*y"}},
        parameters={"g": {"value": "10 m s-2", "uncertainty": 1e-3}, "e": {"value": "0.8", "uncertainty": 1e-3}},
        initial={"y": {"value": "100 cm", "uncertainty": 0.1}, "v_y": {"value": "1.8 km h-1", "uncertainty": 1e-3}},
        events={"ground": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-e*v_y"}}},
    )
    run = xd.simulate(model, method="rk4", step="0.125 s", until="1.75 s", time_tolerance="1e-13 s")
    own, tiny = {"y": 1.0, "v_y": 0.5, "g": 10.0, "e": 0.8}, 1e-30
    factors = {"y": 0.01, "v_y": 1 / 3.6, "g": 1.0, "e": 1.0}
    slopes_of = {by: bounced(**own | {by: own[by] + tiny * 1j}) for by in own}
    for place in bounced(**own):
        quantity, at, *which = place
        target = Target(quantity, at, "ground" if which else "", *which)
        found, unit = (
            variational_slopes(run, model, target, [*model.uncertain]),
            1e3 if quantity in ("y", "v_y") else 1.0,
        )
        wanted = {by: slopes_of[by][place].imag / tiny * unit * factors[by] for by in own}
        assert found == pytest.approx(wanted, rel=1e-8, abs=1e-9), target.description
    with pytest.raises(NotVariedError, match="an extreme is where"):
        variational_slopes(run, model, Target("maximum_y"), [*model.uncertain])


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("quantity", "where"),
    [
        ("y", {"at": "1.6 s"}),
        ("v_y", {"event": "floor", "occurrence": 2, "side": "after"}),
        ("t", {"event": "floor", "occurrence": 3}),
    ],
)
def test_impacts_on_a_moving_floor_by_a_changing_restitution(quantity: str, where: dict[str, Any]) -> None:
    """Assert slopes through impacts whose gap moves and whose restitution knows how fast it closes."""
    floor = {"gap": "y - 0.05*metre*sin(9*t/second)", "restitution": "e*exp(-approach_speed/(60*metre/second))"}
    agree(falling(contacts={"floor": floor}), quantity, **where)


@pytest.mark.dear
def test_an_impact_whose_normal_and_masses_change() -> None:
    """Assert slopes through bounces on a curved floor, of a body with two inertias that depend on uncertain numbers."""
    model = xd.Model(
        name="bowl",
        coordinates={"x": "m", "y": "m"},
        mass={"x": "m", "y": "2*m + k"},
        parameters={
            "m": {"value": "1 kg", "uncertainty": 1e-3},
            "k": {"value": "0.3 kg", "uncertainty": 1e-3},
            "b": {"value": "0.4 m-1", "uncertainty": 1e-4},
        },
        forces={"weight": {"y": "-9.81*newton"}},
        contacts={"bowl": {"gap": "y - b*x**2", "restitution": 0.9}},
        initial={
            "x": {"value": "0.4 m", "uncertainty": 1e-4},
            "y": {"value": "1 m", "uncertainty": 1e-4},
            "v_x": "0.3 m s-1",
        },
        run={"method": "dop853", "until": "2 s"},
    )
    agree(model, "x", close=1e-8, at="1.9 s")
    agree(model, "v_y", close=1e-8, event="bowl", occurrence=2, side="after")


def test_resets_and_switches() -> None:
    """Assert slopes through a reset that turns the motion, and through a regime that begins where it is met."""
    model = falling(
        forces={"gravity": {"y": "-g*1*kilogram"}, "brake": {"y": "-v_y*2*kilogram/second"}},
        regimes={"free": {"forces": ["gravity"]}, "braked": {"forces": ["gravity", "brake"]}},
        events={
            "low": {"function": "y - 0.3*metre", "direction": "falling", "action": "switch", "to": "braked"},
            "ground": {"function": "y", "direction": "falling", "action": "reset", "set": {"v_y": "-e*v_y"}},
        },
    )
    agree(model, "y", at="1.2 s")
    assert agree(model, "t", event="ground", occurrence=2)["e"] > 0.0


def test_a_force_that_jumps() -> None:
    """Assert slopes through the zero of a sign that a force reads."""
    model = doubtful(xd.Model.from_toml(MODELS / "relay_oscillator.toml"), f="uncertainty = 0.001")
    agree(model, "x", at="9 s")


@pytest.mark.dear
def test_a_mass_matrix_that_depends_on_coordinates_and_parameters() -> None:
    """Assert slopes of a double pendulum by masses, lengths and starts."""
    spreads = dict.fromkeys(("m1", "m2", "l1", "l2"), "uncertainty = 1e-5")
    model = doubtful(xd.Model.from_toml(MODELS / "double_pendulum.toml"), **spreads, th1="uncertainty = 1e-5")
    agree(model, "th2", at="1.5 s", close=1e-6)
    agree(model, "kinetic_energy", at="1 s", close=1e-6)


@pytest.mark.dear
def test_first_order_states_and_drives() -> None:
    """Assert slopes of a state whose rate reads a table of time and one of the motion."""
    model = falling(
        states={"q": {"unit": "J", "rate": "pull*v_y*e + 0.1*abs(v_y)*pull"}},
        drives={
            "pull": {"csv": "t [s],pull [N]\n0,0\n1,3\n5,0\n", "table": "a.csv"},
            "soft": {
                "csv": "y [m],soft [N]\n-30,2\n0,0\n30,-2\n",
                "table": "b.csv",
                "argument": "y",
                "interpolation": "cubic",
            },
        },
        forces={"gravity": {"y": "-g*1*kilogram"}, "pull": {"y": "pull + e*soft"}},
        initial={
            "y": {"value": "1 m", "uncertainty": 1e-3},
            "v_y": {"value": "0.5 m s-1", "uncertainty": 1e-3},
            "q": "0 J",
        },
    )
    agree(model, "q", at="1.7 s")


@pytest.mark.every(3)
@pytest.mark.parametrize(
    ("name", "first", "where", "said"),
    [
        ("block_on_incline", "alpha", {"at": "0.5 s"}, "contact_state_incline is not open all the time"),
        ("stick_slip_belt", "k", {"at": "2 s"}, "friction elements slip or stick"),
        ("ball_in_box", "m", {"at": "6 s"}, "right and floor are met at once"),
    ],
)
def test_what_is_not_told(name: str, first: str, where: dict[str, Any], said: str) -> None:
    """Assert that held contacts, dry friction and corners are left to differences, and that it is said why."""
    model = xd.Model.from_toml(MODELS / f"{name}.toml")
    model = doubtful(model, **{first: f"uncertainty = {1e-6 * model.parameters[first].quantity.value!r}"})
    target = Target.from_arguments(model, "x", where["at"], None, 1, "before")
    with pytest.raises(NotVariedError) as told:
        variational_slopes(xd.simulate(model), model, target, [*model.uncertain])
    assert str(told.value).replace("'", "").startswith(said)
    budget = xd.error_budget(model, "x", **where)
    rule = str(budget.term_rule.values[budget.term_name.values.tolist().index(first)])
    assert (f"no variational equations: {said}" in rule.replace("'", "")) is (slope(budget, first)[0] != 0.0)


def test_a_number_at_the_very_time_of_an_event_is_behind_it() -> None:
    """Assert the speed -e*v and place of a body that a clock turns at 0.5 s, at that time, and just before it."""
    turn = {"function": "t - 0.5*second", "direction": "rising", "action": "reset", "set": {"v_y": "-e*v_y"}}
    model = falling(events={"turn": turn})
    run = xd.simulate(model, method="rk4", step="0.125 s", until="1 s")
    assert 0.5 in run.event_time.values
    behind = {"y": 0.0, "v_y": -0.8, "g": 0.4, "e": 9.81 * 0.5 - 0.5}
    assert variational_slopes(run, model, Target("v_y", 0.5), [*model.uncertain]) == pytest.approx(behind, abs=1e-12)
    assert variational_slopes(run, model, Target("y", 0.5), [*model.uncertain]) == pytest.approx(
        {"y": 1.0, "v_y": 0.5, "g": -0.125, "e": 0.0}, abs=1e-12
    )
    before = variational_slopes(run, model, Target("v_y", 0.5 - 1e-9), [*model.uncertain])
    assert before == pytest.approx({"y": 0.0, "v_y": 1.0, "g": -0.5, "e": 0.0}, abs=1e-8)


@pytest.mark.parametrize(("method", "most"), [("rk4", 24), ("dop853", 16), ("forward_euler", 48)])
def test_as_many_variables_as_collocation_bears(method: str, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert the largest model of each method: variables times stages of a collocation of its order are 96 at most."""
    model, run = falling(), xr.Dataset(attrs={"solver_order": xd.METHODS[method].order})
    for size, fits in ((most, True), (most + 1, False)):
        monkeypatch.setattr("xdynamics.budgeting.physical.Equations", lambda *_, size=size: SimpleNamespace(size=size))
        if fits:
            assert _variational_equations(run, model, ()).size == size
            continue
        with pytest.raises(NotVariedError, match=f"{size} variables are too many"):
            _variational_equations(run, model, ())


@pytest.mark.dear
def test_a_slope_below_the_rounding_of_its_number_is_that_of_the_equations() -> None:
    """Assert the closed form of a push that moves an oscillator by less than rounding does, without a warning."""
    model = particle(
        name="pushed",
        parameters={"k": "1 N m-1", "m": "1 kg", "push": {"value": 0.0, "unit": "N", "uncertainty": 1e-14}},
        forces={"spring": {"x": "-k*x"}, "push": {"x": "push"}},
        initial={"x": "1 m", "v_x": "0 m s-1"},
    )
    budget = xd.error_budget(model, "x", at="300 s", method="rk4", step="10 ms", until="300 s")
    found = float(budget.sensitivity[4])
    assert budget.standard_uncertainty[4] < budget.bound[1]
    assert found == pytest.approx(1.0 - math.cos(300.0), rel=1e-6)


def test_a_touch_counts_from_its_very_row() -> None:
    """Assert that a contact that closes at a row is told there, and not in the row before."""
    _check_open({"contact_state_floor": 3}, 2)
    with pytest.raises(NotVariedError, match="'contact_state_floor' is not open"):
        _check_open({"contact_state_floor": 3}, 3)


@pytest.mark.dear
def test_the_rule_says_both_ways() -> None:
    """Assert that a slope says how it was found and how far differences are from it."""
    budget = xd.error_budget(falling(), "y", at="0.3 s")
    rule = str(budget.term_rule.values[budget.term_name.values.tolist().index("g")])
    assert rule.startswith("slope by variational equations on the run's steps; central differences")
    assert float(budget.sensitivity[4]) == pytest.approx(-0.045, rel=1e-13)


@pytest.mark.dear
def test_changes_that_are_not_small_are_told_by_differences() -> None:
    """Assert that an uncertainty over which a number bends keeps the slope of differences, with the other one told."""
    model = doubtful(xd.Model.from_toml(MODELS / "impact_oscillator.toml"), w="uncertainty = 0.001")
    with pytest.warns(xd.AccuracyWarning, match="does not change in proportion with 'w'"):
        budget = xd.error_budget(model, "x", at="60 s")
    rule = str(budget.term_rule.values[budget.term_name.values.tolist().index("w")])
    assert "; the variational equations, of the smallest changes, give " in rule
