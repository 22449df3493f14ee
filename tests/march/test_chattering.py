"""Which last passages of a switch are a motion that rests on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from xdynamics.march.unlocated_switches import CLOSE, NOWHERE, PASSAGES, SMALL, chattering
from xdynamics.model.detectors import SWITCH

DETECTORS = np.array([(SWITCH + 1, 1.0), (SWITCH, 1.0)], dtype=[("role", int), ("tolerance", float)])


def passages(count: int = PASSAGES, pause: float = CLOSE, slope: float = 1.0) -> Any:
    """Passages of the switch, with a pause between two of them, and an uncertainty of 1 of its function."""
    events = np.zeros(count, dtype=[(name, float) for name in ("time", "slope", "uncertainty")] + [("detector", int)])
    events["time"], events["slope"], events["uncertainty"] = pause * np.arange(count), slope, 1.0
    events["detector"] = 1
    return events


@pytest.mark.parametrize(("pause", "slope"), [(CLOSE, 1e9), (1e6, -4.0 * SMALL / 1e6), (0.0, 1e9)])
def test_passages_within_what_is_resolved_rest_on_the_switch(pause: float, slope: float) -> None:
    """Assert the borders: pauses of so many tolerances, and values of so many uncertainties."""
    assert chattering(DETECTORS, passages(pause=pause, slope=slope)) == 1


def test_other_passages_do_not() -> None:
    """Assert that few, those with one long pause, those of two switches, and those of no switch are none."""
    long, mixed, other = passages(slope=1e9), passages(), passages()
    long["time"][-1] += 1.0
    mixed["detector"][3] = other["detector"] = 0
    for events in (passages(PASSAGES - 1), long, mixed, other, passages(0)):
        assert chattering(DETECTORS, events) == NOWHERE
