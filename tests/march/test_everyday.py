"""Models that people write first: right by every method, or refused in words."""

from __future__ import annotations

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
