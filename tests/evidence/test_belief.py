"""Until when a run can be believed: by the range of the companion, whatever the run itself does later."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd

pytestmark = pytest.mark.filterwarnings("ignore::xdynamics.faults.StabilityWarning")  # which is the subject

OSCILLATOR = """
name = "oscillator"
coordinates.x = { unit = "m" }
parameters = { m = "1 kg", k = "1 N m-1" }
mass.x = "m"
forces.spring.potential = "k*x**2/2"
initial = { x = "1 m", v_x = "0 m s-1" }
"""


def believed_until(end: str) -> float:
    run = xd.simulate(xd.Model.from_text(OSCILLATOR), method="forward_euler", step="40 ms", until=end)
    return float(xd.diagnose(run, companion=True).believed_until)


def test_an_euler_run_is_believed_until_its_amplitude_is_lost() -> None:
    """Assert the time of forward Euler, whose amplitude grows as exp(h t/2): ten seconds, not two hundred."""
    until = believed_until("314 s")
    amplitude = np.exp(0.04 * until / 2)
    assert 1.05 < amplitude < 1.3


@pytest.mark.parametrize("end", ["20 s", "60 s", "200 s"])
def test_a_longer_bad_run_is_believed_no_longer(end: str) -> None:
    """Assert that the verdict on the first part is the same within a third of a period, however long the run is."""
    assert believed_until(end) == pytest.approx(believed_until("20 s"), abs=2.0)


def test_a_run_from_rest_is_believed_at_its_start() -> None:
    """Assert that a first step of Euler's method, which does not move at all, is not held against a good run."""
    run = xd.simulate(xd.Model.from_text(OSCILLATOR), method="forward_euler", step="0.1 ms", until="5 s")
    assert float(xd.diagnose(run, companion=True).believed_until) == 5.0
