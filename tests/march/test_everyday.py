"""Models that people write first: right by every method, or refused in words.

Which component a test that failed speaks of: every bad outcome names one.
"""

from __future__ import annotations

from typing import Any

import pytest

import xdynamics as xd
from cases.everyday import EVERYDAY, MODES, Everyday, alone, as_an_element, in_a_sweep

CASES = list(EVERYDAY.values())


def test_there_are_a_hundred() -> None:
    """Assert that none has the name of another."""
    assert len(CASES) == 100


@pytest.mark.parametrize("case", CASES, ids=str)
def test_chosen_steps_are_right(case: Everyday) -> None:
    """Assert that what a model comes to is its closed form, by steps for a tolerance."""
    finding = alone(case, "dormand_prince")
    assert finding.verdict == "right", str(finding)


@pytest.mark.every(2)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_given_steps_are_right(case: Everyday) -> None:
    """Assert the same by given steps, halved until they agree."""
    finding = alone(case, "rk4", "fixed")
    assert finding.verdict in ("right", "warned"), str(finding)


@pytest.mark.every(8)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_member_of_a_sweep_is_right(case: Everyday) -> None:
    """Assert that beside another value of a parameter it comes to the same."""
    finding = in_a_sweep(case, "dormand_prince")
    assert finding.verdict == "right", str(finding)


@pytest.mark.every(8)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_an_element_is_right(case: Everyday) -> None:
    """Assert that as one of two bodies along a dimension it comes to the same."""
    finding = as_an_element(case, "dormand_prince")
    assert finding.is_sound, str(finding)


@pytest.mark.dear
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("method", xd.METHODS)
def test_every_method_is_right_or_refuses(method: str, mode: str) -> None:
    """Assert that no method ends otherwise than expected, in any way to march."""
    unsound = [finding for case in CASES if not (finding := MODES[mode](case, method)).is_sound]
    assert not unsound, "\n".join(map(str, unsound))


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
