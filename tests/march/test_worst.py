"""Which component a test that failed speaks of: every bad outcome names one."""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd


def blow() -> xd.Model:
    """A state that grows beyond all bounds at t = 1 s, between two that stay at rest or decay."""
    states = {
        "still": {"unit": "1", "rate": "0*k"},
        "y": {"unit": "1", "rate": "k*y**2"},
        "quiet": {"unit": "1", "rate": "-k*quiet"},
    }
    return xd.Model(
        name="blow", states=states, parameters={"k": "1 s-1"}, initial={"still": "1", "y": "1", "quiet": "1"}
    )


@pytest.mark.parametrize(
    ("asked", "outcome", "said"),
    [
        ({"method": "dop853", "rtol": 1e-8}, "step_below_spacing", "most of all in y, at the shortest step"),
        ({"method": "dop853", "rtol": 1e-8, "min_step": "1 ms"}, "error_test_at_minimum_step", "most of all in y; the"),
        ({"method": "dop853", "rtol": 1e-8, "max_steps": 10}, "step_limit", "where y has the largest error"),
        ({"method": "radau_iia", "rtol": 1e-8, "max_steps": 10}, "step_limit", "where y has the largest error"),
        ({"method": "radau_iia", "step": 0.5}, "equations_unsolved", "that of y least of all; take a shorter step"),
        (
            {"method": "implicit_midpoint", "step": 0.5},
            "equations_unsolved",
            "that of y least of all; take a shorter step",
        ),
    ],
)
def test_the_component_is_named(asked: dict[str, Any], outcome: str, said: str) -> None:
    """Assert that where no step or no solution is found, the sentence says for which state."""
    run = xd.simulate(blow(), until=2.0, **asked)
    assert run.attrs["run_outcome"] == outcome
    assert said in run.attrs["run_outcome_text"]
