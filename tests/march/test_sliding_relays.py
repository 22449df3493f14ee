"""Random relays that slide, pass and leave: against an event-driven solution that knows nothing of this package."""

from __future__ import annotations

import numpy as np
import pytest

import xdynamics as xd
from cases.sliding_relays import Relays
from xdynamics.evidence.audit import audit


def check(case: int) -> None:
    """Assert the end, the times of all events, and how many of them leave a switch."""
    relays = Relays(case)
    exact = relays.solve()
    assert exact.unique
    run = xd.simulate(relays.model(), method="dormand_prince", rtol=1e-11, until=f"{relays.until} s")
    assert run.attrs["run_outcome"] == "completed"
    end = np.array([run[f"x{i}"].values[-1] for i in range(relays.n)])
    assert end == pytest.approx(exact.end, abs=2e-9)
    words = run.event_kind.attrs["flag_meanings"].split()
    assert [words[kind] for kind in run.event_kind.values].count("leave") == exact.leaves
    # a state has a switch of its own: each instant has as many events as states
    assert np.unique(np.round(run.event_time.values, 9)) == pytest.approx(exact.times, abs=2e-8)
    assert [gate.verdict for gate in audit(run)] == ["passed"]


@pytest.mark.parametrize("case", [0, 5, 11, 14, 23, 35])
def test_relays_slide_as_an_event_driven_solution_says(case: int) -> None:
    """Assert the motion of one relay or two; in case 35 the function is beyond zero for 3 ms by 50 um before it slides."""
    check(case)


@pytest.mark.dear
@pytest.mark.parametrize("case", range(200))
def test_more_relays(case: int) -> None:
    """Assert the motion of two hundred."""
    check(case)
