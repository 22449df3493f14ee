"""Rates of what a record has, and what is computed between rows: by regimes, contacts and friction behind each row.

The audit of a record: contradictions with its model that no second march would see.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from xdynamics.evidence.audit import audit
from xdynamics.evidence.observables import (
    comparable,
    evaluate_at_states,
    modes_behind,
    observables_of,
    observe,
    rate_tree,
    tree_of,
)
from xdynamics.expressions import free_names
from xdynamics.faults import DOT
from xdynamics.model.motion import motion
from xdynamics.schema import BACKWARD, FORWARD, STICKING

SPRING: dict[str, Any] = {
    "name": "spring",
    "coordinates": {"x": "m"},
    "parameters": {"k": "2 N m-1"},
    "mass": {"x": "1*kilogram"},
    "forces": {"spring": {"x": "-k*x"}},
    "observables": {"power": "k*x*v_x", "pull": "a_x*second"},
    "states": {"q": {"unit": "m", "rate": "v_x - q/(4*second)"}},
    "initial": {"x": "1 m", "v_x": "0 m s-1", "q": "0.5 m"},
}
FLOOR = SPRING | {"contacts": {"floor": {"gap": "x + 3*metre", "restitution": "0.5"}}}
RUBBED = SPRING | {
    "frictions": {"belt": {"slip": "v_x - 0.1*metre/second", "kinetic": "1*newton", "static": "2*newton"}}
}


def push(t: float) -> float:
    """A force in Python."""
    return t


def test_rates_are_those_along_the_motion() -> None:
    """Assert in numbers the rate of a place, a speed, a state, a force, an energy and an observable; none where none is known."""
    model = xd.Model(**SPRING)
    run = xd.simulate(model, method="rk4", step=0.1, until=0.4)
    x, v, q = (run[name].values for name in ("x", "v_x", "q"))
    states, rows = {"x": x, "v_x": v, "q": q}, np.arange(5)
    wanted = {
        "x": v,
        "v_x": -2.0 * x,
        "q": v - q / 4.0,
        "force_spring_x": -2.0 * v,
        "kinetic_energy": -2.0 * x * v,
        "power": 2.0 * v**2 - 4.0 * x**2,
    }
    for name, values in wanted.items():
        tree = rate_tree(model, name)
        assert tree is not None, name
        assert evaluate_at_states(run, model, [tree], states, run.time.values, rows)[0] == pytest.approx(
            values, rel=1e-14
        )
    for name in ("pull", "a_x", "none"):
        assert rate_tree(model, name) is None
    for other in (xd.Model(**FLOOR), xd.Model(**SPRING | {"forces": {"spring": {"x": "-k*x"}, "push": {"x": push}}})):
        assert {name: rate_tree(other, name) is None for name in wanted} == {name: name != "x" for name in wanted}


def test_rates_of_many_elements_look_through_the_motion_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that what an element's rate costs does not grow with the number of elements."""
    looked = []

    def counted(model: xd.Model) -> Any:
        looked.append(model)
        return motion(model)

    monkeypatch.setattr("xdynamics.evidence.observables.motion", counted)
    model = xd.Model(
        name="many",
        dimensions={"site": 30},
        coordinates={"u": {"unit": "m", "dims": ["site"]}},
        mass={"u": "1*kilogram"},
        forces={"spring": {"u": "-1*newton*u/(1*metre)"}},
        observables={"square": "u**2"},
        initial={"u": "1*metre*index(site)", "v_u": "0 m s-1"},
    )
    rates = [rate_tree(model, f"square{DOT}{i}") for i in range(30)]
    assert len(looked) == 1
    assert all(rate is not None and f"v_u{DOT}{i}" in free_names(rate) for i, rate in enumerate(rates))


def test_what_contacts_change_is_not_compared() -> None:
    """Assert which observables there are, and that those of accelerations are refused where contacts change these."""
    for table, compared in ((SPRING, True), (FLOOR, False)):
        model = xd.Model(**table)
        assert {"x", "v_x", "q", "kinetic_energy", "power", "pull"} <= {*observables_of(model)}
        assert "floor" not in " ".join(observables_of(model))
        assert ("pull" in comparable(model)) == compared
        assert {"x", "v_x", "q", "kinetic_energy", "power"} <= {*comparable(model)}
    run = xd.simulate(model, method="rk4", step=0.1, until=0.4)
    with pytest.raises(xd.InputError, match="observable 'pull' reads accelerations, which contacts change; ask for"):
        observe(run, model, ["power", "pull"], np.array([0.2]))
    with pytest.raises(xd.InputError, match="observable 'pul' is none of the model's; there are x, v_x"):
        observe(run, model, ["pul"], np.array([0.2]))
    assert observe(run, model, [], np.array([0.2])) == {}


def test_friction_holds_or_has_a_way() -> None:
    """Assert 1 and 0 where it sticks, else 0 and the sign of the slip, by the rows from which steps go."""
    model = xd.Model(**RUBBED)
    columns = {
        "friction_state_belt": np.array([STICKING, FORWARD, BACKWARD]),
        "friction_force_belt": np.array([1.0, 1.0, 1.0]),
    }
    rows = np.array([0, 2, 1, 0])
    holds, way = modes_behind(model, columns, rows, np.minimum(rows + 1, 2)).values()
    assert (holds.tolist(), way.tolist()) == ([1.0, 0.0, 0.0, 1.0], [0.0, -1.0, 1.0, 0.0])
    columns["friction_force_belt"] = np.array([0.0, 1.0, 0.0])
    holds, _ = modes_behind(model, columns, np.array([0, 0]), np.array([1, 2])).values()
    assert holds.tolist() == [1.0, 0.0]  # a force of 0 at both ends of a step holds nothing


def test_forces_between_rows_are_those_behind_their_row() -> None:
    """Assert the push of the regime, and the friction of the side, that hold behind each row, and what is needed for that."""
    model = xd.Model(
        **SPRING | {"forces": {"spring": {"x": "-k*x"}, "push": {"x": "3*newton"}}},
        regimes={"pushed": {"forces": ["spring", "push"]}, "free": {"forces": ["spring"]}},
        events={"off": {"function": "t - 0.25*second", "action": "switch", "to": "free"}},
    )
    run = xd.simulate(model, method="rk4", step=0.1, until=0.5)
    rows = np.arange(run.sizes["step"] - 1)
    states = {name: run[name].values[rows] for name in ("x", "v_x", "q")}
    found = evaluate_at_states(run, model, [tree_of(model, "a_x")], states, run.time.values[rows], rows)[0]
    pushed = (run.time.values[rows] < 0.25) | (rows == int(run.event_row_before[0]))
    assert found == pytest.approx(3.0 * pushed - 2.0 * run.x.values[rows])
    rubbed = xd.Model(**RUBBED)
    slid = xd.simulate(rubbed, method="rk4", step=0.1, until=0.5)
    assert (slid.friction_state_belt.values[1:] == BACKWARD).all()
    states = {name: slid[name].values[1:5] for name in ("x", "v_x", "q")}
    found = evaluate_at_states(
        slid, rubbed, [tree_of(rubbed, "friction_force_belt")], states, slid.time.values[1:5], np.arange(1, 5)
    )[0]
    assert found == pytest.approx(slid.friction_force_belt.values[1:5])
    assert found == pytest.approx(1.0)
    with pytest.raises(xd.InputError, match="needs friction_state_belt; take the whole record"):
        evaluate_at_states(
            slid.drop_vars("friction_state_belt"),
            rubbed,
            [tree_of(rubbed, "a_x")],
            states,
            slid.time.values[1:5],
            np.arange(1, 5),
        )


GROUND = {"function": "y", "direction": "falling"}


def ball(y: str, ground: dict[str, object], v: str = "0 m s-1") -> xd.Model:
    """A ball over a ground, with an event there."""
    return xd.Model(
        name="ball",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"weight": {"potential": "m*g*y"}},
        events={"ground": ground},
        initial={"y": y, "v_y": v},
    )


RESET = GROUND | {"action": "reset", "set": {"v_y": "-0.8*v_y"}}
STOP = GROUND | {"action": "stop"}
WRONG = {  # models that the former rule certified
    "dropped at the ground": ball("0 m", STOP),
    "through the ground at its last bounce": ball("1 m", RESET),
}
RIGHT = {"falls on the ground": ball("1 m", STOP), "thrown from it": ball("0 m", STOP, "5 m s-1")}


@pytest.mark.parametrize("model", WRONG.values(), ids=WRONG)
def test_a_record_with_an_unmet_event_fails(model: xd.Model) -> None:
    """Assert that the event, its time and direction are named, in the audit and in a diagnosis."""
    run = xd.simulate(model, method="dop853", rtol=1e-9, until="5 s", event_start="waiting")
    (gate,) = audit(run)
    assert (gate.name, gate.verdict) == ("events_met", "failed")
    assert "event 'ground' is at zero at t = " in gate.reason
    found = xd.diagnose(run, companion=False)
    words = found.gate_verdict.attrs["flag_meanings"].split()
    assert [words[k] for k in found.gate_verdict.values] == ["failed"]


@pytest.mark.parametrize("model", RIGHT.values(), ids=RIGHT)
def test_a_right_record_passes(model: xd.Model) -> None:
    """Assert that events met in passing, and left in the other direction, are no contradiction."""
    (gate,) = audit(xd.simulate(model, method="dop853", rtol=1e-9, until="5 s"))
    assert gate.verdict == "passed"


def test_events_that_crowd_together_fail() -> None:
    """Assert that a ball's last bounces, 100 time tolerances apart, are named."""
    (gate,) = audit(xd.simulate(ball("1 m", RESET), method="dop853", rtol=1e-9, until="5 s"))
    assert "acts twice within 100 time tolerances" in gate.reason


def test_a_floor_that_pulls_fails() -> None:
    """Assert that a negative force of a contact is named, and a force within its rounding is not."""
    box = xd.Model.from_toml("data/models/bouncing_ball.toml")
    run = xd.simulate(box)
    assert [gate.verdict for gate in audit(run)] == ["passed"]
    for share, verdict in ((-1e-12, "passed"), (-0.5, "failed")):
        force = run.contact_force_floor
        pulled = force.copy(data=np.where(np.arange(force.size) == 5, share * float(force.max()), force.values))
        (gate,) = audit(run.assign(contact_force_floor=pulled))
        assert gate.verdict == verdict
    assert gate.reason.startswith("contact 'floor' pulls at t = ")


def test_friction_beyond_its_bound_fails() -> None:
    """Assert that a force of dry friction beyond what sticks is named."""
    run = xd.simulate(xd.Model.from_toml("data/models/stick_slip_belt.toml"))
    assert [gate.verdict for gate in audit(run)] == ["passed"]
    (gate,) = audit(run.assign(friction_force_belt=1.01 * run.friction_force_belt))
    assert "holds more than friction can" in gate.reason


def test_verify_audits_and_fails(tmp_path: Path) -> None:
    """Assert the words and the exit codes of `xdynamics verify --audit`."""
    for name, model, code in (("wrong", WRONG["dropped at the ground"], 1), ("right", RIGHT["falls on the ground"], 0)):
        run = xd.simulate(model, method="dop853", rtol=1e-9, until="2 s", event_start="waiting")
        xd.save(run, tmp_path / f"{name}.nc")
        done = call("verify", "--audit", tmp_path / f"{name}.nc")
        assert done.exit_code == code
        assert "events_met" in done.output


def test_a_certificate_has_the_gate_of_the_record() -> None:
    """Assert that a number of a run that fell through its ground is not certified."""
    how = {"method": "dop853", "rtol": 1e-9, "until": "5 s", "event_start": "waiting"}
    found = xd.certify(WRONG["dropped at the ground"], quantity="y", at="1 s", **how)
    verdicts = dict(zip(found.gate_name.values.tolist(), found.gate_verdict.values.tolist(), strict=True))
    assert found.gate_verdict.attrs["flag_meanings"].split()[verdicts["record"]] == "failed"


def test_the_event_of_one_element_does_not_excuse_another() -> None:
    """Assert that a ball which falls through its ground is named, though the other meets its own right after the start."""
    two = xd.Model(
        name="two balls",
        dimensions={"ball": 2},
        coordinates={"y": {"unit": "m", "dims": ["ball"]}},
        parameters={"m": "1 kg", "g": "9.81 m s-2"},
        mass={"y": "m"},
        forces={"weight": {"y": "-m*g"}},
        events={"ground": RESET},
        initial={"y": {"unit": "m", "value": [0, 1e-9]}, "v_y": {"unit": "m s-1", "value": [0, -1]}},
    )
    run = xd.simulate(two, method="dop853", rtol=1e-9, until="0.1 s", event_start="waiting")
    (gate,) = audit(run)
    assert gate.verdict == "failed"
    assert "event 'ground[0]' is at zero at t = 0 s" in gate.reason
    assert "ground[1]" not in gate.reason
