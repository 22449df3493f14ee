"""Adaptive marches along a switch, of which there are too many to be located, end soon and say so."""

from __future__ import annotations

import pytest

import xdynamics as xd
from xdynamics.faults import AccuracyWarning

RELAYS = """
name = "relays"
[dimensions]
relay = 41
[states.y]
unit = "1"
dims = ["relay"]
rate = "{rate}"
[initial]
y = "0.1 + index(relay)"
"""


def relays(rate: str) -> xd.Model:
    """Forty-one states, one more switch than is located."""
    return xd.Model.from_text(RELAYS.format(rate=rate))


def test_sliding_ends_soon() -> None:
    """Assert that a state driven to its switch from both sides ends the run there within a few hundred rows."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(relays("where(y > 0, -1, 1)/second"), method="dormand_prince", rtol=1e-6, until="2 s")
    assert run.attrs["run_outcome"] == "sliding_mode"
    assert "the last 64 steps went to and fro across it" in run.attrs["run_outcome_text"]
    assert "- 0 = 0" not in run.attrs["run_outcome_text"]
    assert run.sizes["step"] < 2000
    assert 0.1 <= run.time.values[-1] < 0.12
    assert abs(run.y.values[-1, 0]) < 1e-4


def test_motion_through_switches_goes_on() -> None:
    """Assert that states which oscillate across their switches reach the end."""
    with pytest.warns(AccuracyWarning, match="41 switches"):
        run = xd.simulate(
            relays("where(y > 0, 2, 1)*cos(40*t/second)/second"), method="dormand_prince", rtol=1e-6, until="2 s"
        )
    assert run.attrs["run_outcome"] == "completed"
