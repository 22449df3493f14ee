"""The audit of a record: contradictions with its model that no second march would see."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import xdynamics as xd
from cases.command_line import call
from xdynamics.evidence.audit import audit

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
