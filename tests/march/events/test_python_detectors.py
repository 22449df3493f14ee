"""Event functions written in Python, of which nothing is known but values."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import words


def level(x: float) -> float:
    """Where the oscillator is nearly at its end."""
    return x - 0.97


def late(t: float) -> float:
    """A jump."""
    return 1.0 if t > 1.234 else -1.0


def away(x: float, v_x: float) -> float:
    """A number that a root makes of two."""
    return math.sqrt(x * x + v_x * v_x / 4.0) - 0.5


def oscillator(function: Any, damping: str = "", **event: Any) -> xd.Model:
    """Cos 2t, with an event."""
    damper = {"damper": {"x": f"-({damping})*v_x"}} if damping else {}
    return xd.Model(
        name="oscillator",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "k": "4 N m-1"},
        mass={"x": "m"},
        forces={"spring": {"potential": "k*x**2/2"}} | damper,
        initial={"x": "1 m", "v_x": "0 m s-1"},
        events={"e": {"function": function} | event},
    )


@pytest.mark.parametrize(
    ("method", "asked"),
    [("dop853", {"rtol": 1e-9}), ("bogacki_shampine", {"rtol": 1e-8}), ("kahan_li8", {"step": 0.1})],
)
def test_crossings_are_found_between_samples(method: str, asked: dict[str, Any]) -> None:
    """Assert every crossing, two of them in one step as well, at the times of the same function as an expression."""
    run, other = (
        xd.simulate(oscillator(one), method=method, until=40 * math.pi, **asked) for one in (level, "x - 0.97*metre")
    )
    assert run.sizes["event"] == other.sizes["event"] == 80
    assert np.abs(run.event_time - other.event_time).max() < 2e-12
    assert np.array_equal(run.event_direction, other.event_direction)


def test_slopes_are_differences() -> None:
    """Assert the uncertainty that a residual leaves, by a slope that differences tell, against that of derivatives."""
    more = {"damping": "0.4*newton*second/metre", "time_tolerance": "1e-6 s"}
    run, other = (
        xd.simulate(oscillator(one, **more), method="rk4", step=0.02, until=4.0)
        for one in (away, "sqrt((x/metre)**2 + (v_x*second/metre)**2/4) - 0.5")
    )
    assert run.sizes["event"] == other.sizes["event"] == 1
    slope, same = (abs(float(one.event_residual[0] / one.event_time_uncertainty_residual[0])) for one in (run, other))
    assert slope == pytest.approx(same, rel=0.05)
    assert 0.0 < float(run.event_time_uncertainty_residual[0]) < 1e-6


def test_a_jump_is_one() -> None:
    """Assert the kind and time of a jump."""
    run = xd.simulate(oscillator(late), method="dop853", rtol=1e-9, until=2.0)
    assert words(run) == [("e", "jump")]
    assert float(run.event_time[0]) == pytest.approx(1.234, abs=1e-12)


def test_the_record_says_how_it_was_looked_for() -> None:
    """Assert that archive and variable tell of samples, differences and units; and that they are SI."""
    run = xd.simulate(oscillator(level, unit="m"), method="dop853", rtol=1e-9, until=2.0)
    assert (
        run.event_detector.attrs["functions"]
        == "e: level(x) in Python, looked at 8 times a step, slopes by differences"
    )
    assert run.event_residual.attrs["units"] == "m"
    assert "return x - 0.97" in run.force_source.item()
    assert xd.simulate(oscillator(level), method="dop853", until=2.0).event_residual.attrs["units"] == "1"


def test_it_is_handed_over_again(tmp_path: Any) -> None:
    """Assert that an archive asks for the function, compares it first, and gives the same bits."""
    xd.save(xd.simulate(oscillator(level, action="stop"), method="dop853", rtol=1e-9, until=2.0), tmp_path / "r.nc")
    with pytest.raises(xd.ModelError, match="the model calls the Python functions level; hand them over"):
        xd.reproduce(tmp_path / "r.nc")
    with pytest.raises(xd.ModelError, match="function 'level' handed over has digest"):
        xd.reproduce(tmp_path / "r.nc", functions={"level": late})
    assert xd.reproduce(tmp_path / "r.nc", functions={"level": level}).attrs["identical"] == 1


@pytest.mark.parametrize(
    ("function", "event", "said"),
    [
        (lambda x: x, {}, "function '<lambda>' needs a plain name"),
        (away, {"unit": "m s"}, None),
        (level, {"unit": "apples"}, "unit 'apples'"),
        ("x", {"unit": "m"}, "key 'unit' is for a function written in Python"),
        (3, {}, "3"),
        (None, {}, "None"),
    ],
)
def test_wrong_functions(function: Any, event: dict[str, Any], said: str | None) -> None:
    """Assert what is said of them."""
    if said is None:
        oscillator(function, **event)
        return
    with pytest.raises(xd.ModelError, match=said):
        oscillator(function, **event)


def test_what_it_asks_for_is_declared() -> None:
    """Assert that the event and the name are told."""

    def height(q: float) -> float:
        return q

    with pytest.raises(xd.ModelError, match="event 'e': function 'height' asks for 'q', which is not declared"):
        oscillator(height)


def test_no_number_is_an_end() -> None:
    """Assert that a function that gives nan ends the run with an outcome that names it."""

    def lost(x: float) -> float:
        return x if x > 0.5 else math.nan

    run = xd.simulate(oscillator(lost), method="dop853", rtol=1e-9, until=2.0)
    assert run.attrs["run_outcome"] == "nonfinite_event"
    assert "'e'" in run.attrs["run_outcome_text"]
    assert float(run.x[-1]) > 0.5


@pytest.mark.parametrize("root_state", ["reintegrate", "interpolant"])
def test_implicit_methods_cross_too(root_state: str) -> None:
    """Assert kinds and times by radau_iia, whose equations leave more than rounding, and whose interpolant has stages."""
    run = xd.simulate(oscillator(level, root_state=root_state), method="radau_iia", rtol=1e-9, until=7.0)
    assert words(run) == [("e", "crossing")] * 5
    true = [(n * math.pi + sign * math.acos(0.97) / 2) for n in range(3) for sign in (-1, 1)][1:6]
    assert np.abs(run.event_time.values - true).max() < (2e-8 if root_state == "reintegrate" else 1e-5)
