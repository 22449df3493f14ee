"""Times at which functions pass zero, and values of functions, against closed forms.

Functions that jump: of which bounds hold on both sides, and zeros are not told where they may be jumped over.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import mpmath as mp
import numpy as np
import pytest

import xdynamics as xd
from cases.smooth_models import oscillator
from xdynamics import Model
from xdynamics.evidence.enclosing import tube as tube_module
from xdynamics.evidence.enclosing.tube import join_tubes
from xdynamics.tubes import Flow, Proof
from xdynamics.tubes.acting import ActingEvent
from xdynamics.tubes.crossings import Crossing, Crossings, Passage


def watched(model: Model, **functions: str) -> Model:
    """Return a model with events that record, in either direction."""
    events = "".join(f'[events.{name}]\nfunction = "{text}"\naction = "record"\n' for name, text in functions.items())
    return Model.from_text(f"{model.to_toml()}\n{events}")


def test_times_of_a_certain_motion() -> None:
    """Assert that the zeros of a cosine are proven to 1e-13 s, with the states there, in order and with their directions."""
    tube = xd.enclose(watched(oscillator(), middle="x", top="v_x"), until="1.7 s")
    with mp.workdps(30):
        quarters = [mp.pi * k / 4 for k in range(1, 3)]
        for k, exact in enumerate(quarters):
            assert float(tube.lower_event_time[k]) <= exact <= float(tube.upper_event_time[k])
            state = mp.cos(2 * exact), -2 * mp.sin(2 * exact)
            for name, number in zip(("x", "v_x"), state, strict=True):
                assert float(tube[f"lower_event_{name}"][k]) <= number <= float(tube[f"upper_event_{name}"][k])
    assert float((tube.upper_event_time - tube.lower_event_time).max()) < 1e-12
    assert tube.event_detector.values.tolist() == [0, 1]
    assert tube.event_direction.values.tolist() == [-1, 1]
    assert "'top' 1 times in its direction; it may be zero at the start" in tube.attrs["events_text"]


def test_times_of_an_uncertain_motion() -> None:
    """Assert that the times at which masses on springs of any stiffness pass the middle are bounded, hardly wider than needed."""
    model = watched(oscillator({"value": "4 N m-1", "half_width": "0.01 N m-1"}), middle="x")
    tube = xd.enclose(model, until="1 s")
    low, high = float(tube.lower_event_time[0]), float(tube.upper_event_time[0])
    first, last = (np.pi / 2 / np.sqrt(k) for k in (4.01, 3.99))
    assert low <= first < last <= high
    assert high - low < 1.05 * (last - first)


@pytest.mark.parametrize("touch", ["x + 1*metre", "(x + 1*metre)*(x + 1*metre)/metre"])
def test_a_touch_is_not_told(touch: str) -> None:
    """Assert that a function that turns where it is zero has no proven zero, that this is said, and the bounds go on."""
    tube = xd.enclose(watched(oscillator(), lowest=touch), until="1.7 s")
    assert tube.sizes["event"] == 0
    text = tube.attrs["events_text"]
    assert "0 times in its direction before t = 1.5" in text
    assert "after which a zero could not be told from none" in text
    assert (tube.attrs["outcome"], tube.attrs["proven_until"]) == ("completed", 1.7)


def test_zeros_next_to_both_ends() -> None:
    """Assert that zeros just after the start and just before the end are told, 20 ms from them."""
    model = watched(oscillator(), early="x - cos(0.04)*metre", late="x - cos(1.96)*metre")
    tube = xd.enclose(model, until="1 s")
    for k, exact in enumerate((0.02, 0.98)):
        assert float(tube.lower_event_time[k]) - 1e-15 <= exact <= float(tube.upper_event_time[k]) + 1e-15
    assert tube.event_detector.values.tolist() == [0, 1]


def test_directions_and_what_is_not_reached() -> None:
    """Assert that zeros in the other direction do not count, and that a function without zeros has none."""
    model = watched(oscillator(), middle="x", far="x - 1.01*metre")
    model = model.replace(events={"middle": {"function": "x", "direction": "rising", "action": "record"}})
    tube = xd.enclose(model, until="2.6 s")
    assert tube.event_detector.values.tolist() == [0]
    assert float(tube.lower_event_time[0]) <= 0.75 * np.pi <= float(tube.upper_event_time[0])


def test_energies_and_observables() -> None:
    """Assert that the energy is bounded to rounding, and an observable that reads the acceleration holds its closed form."""
    model = oscillator(x={"value": "1 m", "half_width": "0.01 m"})
    model = Model.from_text(f'{model.to_toml()}\n[observables]\nload = "m*a_x + 3*newton"\n')
    tube = xd.enclose(model, at=["0.3 s", "0.9 s"])
    for x in (0.99, 1.0, 1.01):
        load = 3.0 - 4.0 * x * np.cos(2.0 * tube.at_time.values)
        assert (tube.lower_load.values <= load).all()
        assert (load <= tube.upper_load.values).all()
        assert ((tube.lower_total_energy <= 2.0 * x * x) & (2.0 * x * x <= tube.upper_total_energy)).all()
    assert (tube.upper_load - tube.lower_load).max() < 0.081
    # two bounds of 1/2 k x**2 + 1/2 m v**2, each by its derivatives: as wide as the energies of the starts, to second order
    assert (tube.upper_total_energy - tube.lower_total_energy).max() < 0.0805
    assert tube.lower_load.attrs["units"] == "N"


@pytest.mark.parametrize("rate", [(5.0, np.inf), (-np.inf, -5.0), (-np.inf, np.inf)])
def test_a_rate_without_a_bound_bounds_no_value(rate: tuple[float, float]) -> None:
    """Assert that a function that is positive in the middle of a step, and may change as fast as it likes, may be zero in it."""

    def bounds(_proof: Any, time: np.ndarray) -> np.ndarray:
        value = (1.0, 1.0) if time[0] == time[1] else (-1e300, 1e300)
        return np.array([value, rate]).T

    functions: Any = SimpleNamespace(bounds_in_step=bounds)
    proof: Any = None
    parts = [*Crossings(functions)._pieces_of_step(proof, np.array([0.0, 1.0]), 0)]
    assert [sign for _, sign in parts] == [0]


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
