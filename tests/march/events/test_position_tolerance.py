"""How near to the zero of its function the state of an event is, where that is asked for."""

from __future__ import annotations

import math
import tomllib
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import ball, words
from xdynamics.schema import EVENT_POSITIONS


def swing(events: dict[str, Any]) -> xd.Model:
    """A mass on a spring, x = sin(t), whose events are looked for no better than to 1 ms, or as they say."""
    return xd.Model(
        name="swing",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "1 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}},
        initial={"x": "0 m", "v_x": "1 m s-1"},
        events={name: {"time_tolerance": "1 ms"} | event for name, event in events.items()},
    )


@pytest.mark.cases(300)
def test_events_are_as_near_as_is_asked(case: int) -> None:
    """Assert |x - level| in the rows themselves, whatever the time tolerance, also of levels passed within it of each other."""
    random = np.random.default_rng(case)
    level, asked = random.uniform(-0.9, 0.9), float(10.0 ** random.uniform(-12, -2))
    beside = level + float(10.0 ** random.uniform(-9, -3))
    within = {"position_tolerance": f"{asked!r} m", "root_state": ("reintegrate", "interpolant")[case % 2]}
    model = swing(
        {
            "one": {"function": f"x - ({level!r}*metre)"} | within,
            "other": {"function": f"x - ({beside!r}*metre)"} | within,
            "free": {"function": "x + 0.95*metre"},
        }
    )
    method = ("rk4", "dop853", "velocity_verlet", "dormand_prince")[case // 2 % 4]
    run = xd.simulate(model, method=method, step=float(random.uniform(0.05, 0.4)), until=7.0)
    names = [name for name, _ in words(run)]
    levels = {"one": level, "other": beside, "free": -0.95}
    off = np.abs(run.x.values[run.event_row_before.values] - [levels[name] for name in names])
    mine = np.array([name != "free" for name in names])
    assert mine.sum() >= 4
    assert (off[mine] <= asked + 1e-15).all()
    assert np.abs(run.event_residual.values) == pytest.approx(off, abs=1e-15)
    met = run.event_position.attrs["flag_meanings"].split()
    assert [met[one] for one in run.event_position.values] == ["met" if one else "not_asked" for one in mine]
    width = (run.event_time_bounds[:, 1] - run.event_time_bounds[:, 0]).values
    assert (width <= 2e-3).all()  # one that follows within the time tolerance is waited for


@pytest.mark.cases(100)
def test_impacts_are_as_near_as_is_asked(case: int) -> None:
    """Assert the gap at every impact of a ball, located to 1 ms or to micrometres and less, and what the ball then does."""
    random = np.random.default_rng(case)
    asked, e = float(10.0 ** random.uniform(-13, -4)), float(random.uniform(0.3, 0.9))
    tolerances = {"time_tolerance": "1 ms", "position_tolerance": f"{asked!r} m"}
    run = xd.simulate(ball(e, **tolerances), method="rk4", step=float(random.uniform(0.01, 0.2)), until=1.2)
    impacts = np.array([kind == "impact" for _, kind in words(run)])
    gaps = run.contact_gap_floor.values[run.event_row_before.values[impacts]]
    assert impacts.sum() >= 1
    assert (np.abs(gaps) <= asked).all()
    fall = math.sqrt(2 * 9.81)
    assert float(run.v_y[int(run.event_row_after[0])]) == pytest.approx(e * fall, abs=2 * asked * 9.81 / fall + 1e-12)


def test_what_rounding_forbids_is_said() -> None:
    """Assert that the best state is taken, with a warning, the outcome and a flag that say so; to be extended too."""
    model = ball(0.5, position_tolerance="1e-40 m")
    asked = {"method": "rk4", "step": 0.05, "time_tolerance": 1e-12}
    with pytest.warns(xd.AccuracyWarning, match="the position tolerance of 'floor' was not met by every event"):
        run = xd.simulate(model, until=2.0, nodes=[1.0], **asked)
    assert "event_position says where" in run.attrs["run_outcome_text"]
    assert np.abs(run.event_residual.values).max() < 1e-14
    assert EVENT_POSITIONS.index("not_met") in run.event_position.values
    with pytest.warns(xd.AccuracyWarning, match="position tolerance"):
        longer = xd.extend(xd.simulate(model, until=1.0, **asked), until=2.0)
    assert xd.content_digest(longer) == xd.content_digest(run)


def test_where_it_is_not_asked_for_nothing_changes() -> None:
    """Assert the same numbers with a tolerance that is met anyway, and no variable of it without one."""
    run, same = (
        xd.simulate(one, method="rk4", step=0.05, until=2.0) for one in (ball(), ball(position_tolerance="1 m"))
    )
    assert run.y.values.tolist() == same.y.values.tolist()
    assert run.event_time.values.tolist() == same.event_time.values.tolist()
    assert "event_position" not in run
    assert "event_position" in same


def test_runs_side_by_side_are_located_alike() -> None:
    """Assert that members of a sweep have the events that they have alone."""
    model = ball(0.5, time_tolerance="1 ms", position_tolerance="1 nm")
    grid = xd.sweep(
        model,
        {"y": ["0.5 m", "1 m", "2 m", "3 m"]},
        keep=["event_time_floor"],
        method="dop853",
        rtol=1e-8,
        until="1.5 s",
    )
    for height in (0.5, 1.0, 2.0, 3.0):
        alone = xd.simulate(
            ball(0.5, height, time_tolerance="1 ms", position_tolerance="1 nm"),
            method="dop853",
            rtol=1e-8,
            until="1.5 s",
        )
        assert float(grid.event_time_floor.sel(y=height)) == float(alone.event_time[0])


def test_it_stands_in_model_and_record() -> None:
    """Assert the round trip through a file, and what the record says of events and contacts, defaults included."""
    events = {"apex": {"function": "v_y", "position_tolerance": "1 mm s-1"}, "half": {"function": "y - 0.5*metre"}}
    model = xd.Model(**tomllib.loads(ball(0.5, position_tolerance="1 nm").to_toml()) | {"events": events})
    assert xd.Model.from_text(model.to_toml()) == model
    run = xd.simulate(model, method="rk4", step=0.05, until=1.0)
    about = run.event_detector.attrs
    assert about["position_tolerances"] == "apex: 1.0 mm s-1; half: none, what the time tolerance leaves"
    assert about["contact_position_tolerances"] == "floor: 1.0 nm"
    assert run.contact_force_floor.attrs["position_tolerance"] == "1.0 nm"
    assert np.abs(run.event_residual.values[[name == "apex" for name, _ in words(run)]]).max() <= 1e-3


@pytest.mark.parametrize(
    ("owner", "given", "said"),
    [
        ("events", "1 s", "event 'low': position_tolerance is '1.0 s', needs the unit of the function, 'm'"),
        ("contacts", "1 s", "contact 'floor': position_tolerance is '1.0 s', needs the unit of the gap, 'm'"),
        ("contacts", "0 m", "position_tolerance is '0.0 m', needs a positive quantity"),
        ("events", "-1 um", "needs a positive quantity"),
        ("events", 1e-6, "needs the unit of the function, 'm'"),
        ("contacts", "near", "does not start with a finite number"),
        ("frictions", "1 um", "key 'position_tolerance' is not known"),
    ],
)
def test_wrong_tolerances_are_named(owner: str, given: Any, said: str) -> None:
    """Assert one clear fault for each, with its value and what is needed."""
    table = tomllib.loads(ball(0.5).to_toml())
    table["events"] = {"low": {"function": "y"}}
    table["frictions"] = {"air": {"slip": "v_y", "kinetic": "1*newton"}}
    (table[owner][next(iter(table[owner]))])["position_tolerance"] = given
    with pytest.raises(xd.ModelError, match=said):
        xd.Model(**table)


def test_rules_of_contacts_stand_where_those_of_detectors_do() -> None:
    """Assert gap, law, restitution, tangential rule and tolerances of contacts, and the rule of dry friction."""
    table = tomllib.loads(ball(0.5, law="poisson", rest_height="1 nm", time_tolerance="1 ps").to_toml())
    table["contacts"]["floor"] |= {"tangential": "coulomb", "slip": "v_x", "friction": 0.3, "static": 0.4}
    table["contacts"]["roof"] = {"gap": "9*metre - y", "restitution": "0.1", "law": "poisson"}
    table["frictions"] = {"rail": {"slip": "v_x", "kinetic": "1*newton"}}
    table["coordinates"]["x"], table["mass"]["x"] = {"unit": "m"}, "m"
    table["initial"] |= {"x": "0 m", "v_x": "1 m s-1"}
    about = xd.simulate(xd.Model(**table), method="rk4", step=0.1, until=0.2).event_detector.attrs
    assert {key: value for key, value in about.items() if key.startswith(("contact", "friction"))} == {
        "contact_gaps": "floor: y; roof: 9*metre - y",
        "contact_laws": "floor: poisson; roof: poisson",
        "contact_restitutions": "floor: 0.5; roof: 0.1",
        "contact_tangential_rules": "floor: coulomb, slip v_x, friction 0.3, static 0.4; roof: frictionless",
        "contact_rest_heights": "floor: 1.0 nm; roof: 1e-9 of the largest gap so far",
        "contact_time_tolerances": "floor: 1.0 ps; roof: solver_time_tolerance",
        "contact_position_tolerances": "floor: none, what the time tolerance leaves; roof: none, what the time tolerance leaves",
        "friction_rules": "rail: slip v_x, kinetic 1*newton, static 1*newton",
        "friction_time_tolerances": "rail: solver_time_tolerance",
    }
