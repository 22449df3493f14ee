"""Functions that jump: of which bounds hold on both sides, and zeros are not told where they may be jumped over."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import xdynamics as xd
from xdynamics.evidence.enclosing import tube as tube_module
from xdynamics.evidence.enclosing.tube import join_tubes
from xdynamics.tubes import Flow, Proof
from xdynamics.tubes.acting import ActingEvent
from xdynamics.tubes.crossings import Crossing, Crossings, Passage


def drifting(observable: str = "0", event: str = "", action: str = "record", half_width: float = 0.5) -> xd.Model:
    """Return points that drift with 1 m/s from anywhere near 0.1 m."""
    met = f'[events.met]\nfunction = "{event}"\naction = "{action}"\n' if event else ""
    return xd.Model.from_text(
        f"""name = "drifting"
[states.x]
unit = "m"
rate = "1*metre/second"
[observables]
seen = "{observable}"
[initial]
t = "0 s"
x = {{ value = "0.1 m", half_width = {half_width} }}
{met}"""
    )


@pytest.mark.parametrize(
    ("function", "least", "most"),
    [
        ("sign(x)", -1.0, 1.0),
        ("floor(x/metre)", -1.0, 0.0),
        ("round(2*x/metre)", -1.0, 1.0),
        ("where(x < 0*metre, 1, 2)", 1.0, 2.0),
        ("mod(x/metre, 0.25)", 0.0, 0.2499),
    ],
)
def test_observables_that_jump(function: str, least: float, most: float) -> None:
    """Assert that bounds hold on both sides of a jump, on which the function may be level, at the start and later."""
    tube = xd.enclose(drifting(function), at=["0 s", "0.125 s"])
    for k in range(2):
        assert float(tube.lower_seen[k]) <= least < most <= float(tube.upper_seen[k])


@pytest.mark.parametrize("action", ["record", "stop"])
@pytest.mark.parametrize(
    "function",
    ["x/metre - 1 + where(x < 0.65*metre, 0, 1)", "where(x < 0.65*metre, 0, 1) - 0.5", "sign(x - 0.65*metre)"],
)
def test_zeros_that_are_jumped_over(function: str, action: str) -> None:
    """Assert that no zero is told where a function jumps from below to above, at x = 0.65 m, t from 0.05 s to 1.05 s."""
    tube = xd.enclose(drifting(event=function, action=action), until="3 s")
    assert tube.sizes["event"] == 0
    assert action == "record" or tube.attrs["proven_until"] <= 0.05
    assert action == "stop" or "after which a zero could not be told from none" in tube.attrs["events_text"]


def test_stop_where_a_step_begins(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that no bounds are told beyond where a step begins if the first motion may stop there."""
    known = tube_module.first_passage

    def wider(acting: Sequence[ActingEvent], flow: Flow, proof: Proof) -> tuple[Proof, Passage | None]:
        part, passed = known(acting, flow, proof)
        if passed:
            crossing = passed.crossing
            time = np.array([proof.begin[0], crossing.time[1]])
            passed = replace(passed, crossing=replace(crossing, time=time))
        return part, passed

    monkeypatch.setattr(tube_module, "first_passage", wider)
    tube = xd.enclose(drifting(event="x - 1*metre", action="stop", half_width=0.0625), until="3 s")
    assert tube.attrs["outcome"] == "completed"
    assert tube.attrs["proven_until"] == float(tube.time[-1]) <= 0.8375


def test_zero_that_is_told_apart_in_a_shorter_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Assert that an event acts which is found only where a step is cut short before another may be passed."""
    known, cut = ActingEvent.trial_step, []

    def later(event: ActingEvent, proof: Proof) -> tuple[Crossings, Crossing | None, float]:
        trial, first, until = known(event, proof)
        if event.name == "met" and first is not None and not cut:
            cut.append(first)
            return trial, None, float(first.time[1]) + 0.02  # as if another were not told apart from here on
        return trial, first, until

    monkeypatch.setattr(ActingEvent, "trial_step", later)
    tube = xd.enclose(drifting(event="x - 1*metre", action="stop", half_width=0.0625), until="3 s")
    assert cut
    assert tube.attrs["outcome"] == "completed"
    assert tube.attrs["proven_until"] <= 0.8375


def test_zeros_that_some_pass_at_once() -> None:
    """Assert that it is said until when zeros are not counted of a set that starts on both sides, and up to when of a proof."""
    tube = xd.enclose(drifting(event="x - 0.1*metre"), until="3 s")
    assert tube.sizes["event"] == 0
    words = re.search("or pass zero before t = ([0-9.]+) s, which is not counted", tube.attrs["events_text"])
    assert words is not None
    assert 0.5 <= float(words[1]) <= 1.0
    ended = xd.enclose(drifting(event="x - 1.1*metre", action="stop"), until="3 s", at=["1 s", "3 s"])
    until = ended.attrs["proven_until"]
    assert f"passes 'met' 0 times in its direction up to t = {until!r} s" in ended.attrs["events_text"]


def test_changes_of_parts() -> None:
    """Assert that no number of changes is told where parts of a set end with different ones."""
    tube = tube_module.unproven(drifting(), [1.0])
    assert join_tubes([replace(tube, changes=1), tube]).changes == 0
    assert join_tubes([replace(tube, changes=2)] * 2).changes == 2
