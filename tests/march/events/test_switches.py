"""Switches hidden in forces: located, stepped to, and each step on one side of them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from cases.contacts import FITTING, asked, words
from cases.problems import MODELS
from xdynamics.model.switches import switches


def pushed(force: str, x: str = "1 m", v: str = "0 m s-1", **more: Any) -> xd.Model:
    """A mass on a line."""
    return xd.Model(
        name="pushed",
        coordinates={"x": "m"},
        parameters={"m": "1 kg", "f": "1 N", "k": "4 N m-1", "a": "0.5 m"},
        mass={"x": "m"},
        forces={"relay": {"x": force} | more},
        initial={"x": x, "v_x": v},
    )


@pytest.mark.every(3)
@pytest.mark.parametrize("method", FITTING)
def test_a_relay_is_exact_for_every_method(method: str) -> None:
    """Assert the times at which x'' = -sign(x) switches, and the energy: parabolas are exact, but across a switch none is."""
    run = xd.simulate(xd.Model.from_toml(MODELS / "relay_oscillator.toml"), until=30.0, **asked(method, step=0.31))
    assert words(run) == [("relay.sign", "regime_switch")] * 11
    assert run.event_time.values == pytest.approx(math.sqrt(2) * (1 + 2 * np.arange(11)), abs=5e-11)
    assert run.total_energy.values == pytest.approx(1.0, abs=1e-11)
    before, after = (run.a_x.values[run[f"event_row_{side}"].values] for side in ("before", "after"))
    assert np.array_equal(before, -after)
    assert run.attrs["solver_switches"] == "located"


def test_stepped_over_they_cost_the_order() -> None:
    """Assert what a run is without: no event, and an energy that is lost."""
    model = xd.Model.from_toml(MODELS / "relay_oscillator.toml")
    run = xd.simulate(model, method="rk4", step=0.31, until=30.0, switches="stepped over")
    assert run.sizes["event"] == 0
    assert np.ptp(run.total_energy.values) > 1e-2
    assert run.attrs["solver_switches"] == "stepped over"
    smooth = pushed("-f*sign(x)", smooth=True)
    assert xd.Model.from_text(smooth.to_toml()) == smooth
    run = xd.simulate(smooth, method="rk4", step=0.31, until=30.0)
    assert run.sizes["event"] == 0
    assert "solver_switches" not in run.attrs


@pytest.mark.parametrize(
    ("force", "x"), [("-f*sign(x - a)", "0.5 m"), ("-f*sign(x) - f/10", "0 m"), ("where(x > a, -f, 2*f)", "0.5 m")]
)
def test_rest_on_a_jump_is_told_from_a_motion_that_is_long(force: str, x: str) -> None:
    """Assert that passages made by rounding alone are named with their remedy, and those of a millimetre are not."""
    run = xd.simulate(pushed(force, x), method="dop853", rtol=1e-8, until=100.0, max_steps=200)
    assert run.attrs["run_outcome"] == "step_limit"
    assert "are used up; 'relay' switches where " in run.attrs["run_outcome_text"]
    assert "either side drives the motion back: it rests there" in run.attrs["run_outcome_text"]
    assert "write dry friction as [frictions]" in run.attrs["run_outcome_text"]
    run = xd.simulate(pushed("-f*sign(x)", "1 mm"), method="dop853", rtol=1e-8, until=100.0, max_steps=200)
    assert "raise max_steps" in run.attrs["run_outcome_text"]
    assert "rests" not in run.attrs["run_outcome_text"]


@pytest.mark.parametrize(
    ("force", "names"),
    [
        ("-k*x - k*min(x + a, 0*metre)", ["relay.min"]),
        ("-k*x + k*max(0*metre, -x - a)", ["relay.max"]),
        ("-k*x - where(x < -a, k*(x + a), 0*newton)", ["relay.where"]),
        ("-k*x - k/2*(x + a - abs(x + a))", ["relay.abs"]),
    ],
)
def test_a_spring_with_a_stop_is_two_springs(force: str, names: list[str]) -> None:
    """Assert the period of an oscillator that is twice as stiff on one side, however that is written, at the method's order."""
    model = pushed(force)
    assert [switche.name for switche in switches(model)] == names
    # k = 4 on the right of -a; 8 about -a/2 on the left of it
    inner = math.pi - math.acos(0.5)  # of the phase, from x = 1 to -a
    speed = 2 * math.sqrt(1 - 0.25)
    swing = math.atan2(speed / math.sqrt(8), 0.25)
    period = 2 * ((math.pi - math.acos(0.5)) / 2 + swing / math.sqrt(8))
    assert inner / 2 < period
    model = xd.Model(**table_of(model), events={"turn": {"function": "v_x", "direction": "falling"}})
    run = xd.simulate(model, method="dop853", rtol=1e-11, atol=1e-11, until=2.05 * period)
    found = [t for t, (name, _) in zip(run.event_time.values, words(run), strict=True) if name == "turn"]
    assert found == pytest.approx([period, 2 * period], abs=1e-9)
    assert words(run).count((names[0], "regime_switch")) == 4


def table_of(model: xd.Model) -> dict[str, Any]:
    """The sections of a model."""
    import tomllib

    return tomllib.loads(model.to_toml())


def test_sliding_on_a_switch_is_an_outcome() -> None:
    """Assert the time at which x' = -sign(x) comes to zero, and friction written as a sign stops, with the remedy."""
    relay = xd.Model(name="relay", states={"x": {"unit": "m", "rate": "-sign(x)*metre/second"}}, initial={"x": "1.5 m"})
    run = xd.simulate(relay, method="rk4", step=0.4, until=5.0)
    assert (run.attrs["run_outcome"], float(run.event_time[0])) == ("sliding_mode", pytest.approx(1.5, abs=1e-12))
    assert abs(float(run.x[-1])) < 1e-11
    braked = pushed("-f*sign(v_x)", v="2 m s-1")
    run = xd.simulate(braked, method="rk4", step=0.3, until=5.0)
    assert float(run.time[-1]) == pytest.approx(2.0, abs=1e-12)
    assert "'relay' switches where v_x = 0" in run.attrs["run_outcome_text"]
    assert "[frictions]" in run.attrs["run_outcome_text"]


def test_a_start_at_a_switch_is_on_the_side_it_moves_to() -> None:
    """Assert the first half swing from x = 0, either way, without an event at the start."""
    for v in (1.0, -1.0):
        run = xd.simulate(pushed("-f*sign(x)", x="0 m", v=f"{v} m s-1"), method="rk4", step=0.3, until=3.0)
        assert run.event_time.values == pytest.approx([2.0], abs=1e-12)
        assert float(run.a_x[0]) == -v


def test_switches_and_contacts_keep_apart() -> None:
    """Assert a ball under a relay that bounces on a floor: both kinds of event, each at its time."""
    model = xd.Model(
        name="both",
        coordinates={"y": "m"},
        parameters={"m": "1 kg", "f": "2 N"},
        mass={"y": "m"},
        forces={"relay": {"y": "-f*sign(y - 0.5*metre)"}},
        initial={"y": "1.5 m", "v_y": "0 m s-1"},
        contacts={"floor": {"gap": "y", "restitution": 1}},
    )
    run = xd.simulate(model, method="rk4", step=0.3, until=2.0)
    # down 1 m at 2 m s-2, half a metre at -2 m s-2 to the floor with sqrt(2) m s-1, and back the same way
    crossed, hit = 1.0, 1.0 + (2 - math.sqrt(2)) / 2
    assert words(run) == [("relay.sign", "regime_switch"), ("floor", "impact"), ("relay.sign", "regime_switch")]
    assert run.event_time.values == pytest.approx([crossed, hit, 2 * hit - crossed], abs=1e-11)


def test_sides_are_those_of_the_run_everywhere(tmp_path: Any) -> None:
    """Assert samples between steps, an extension, and the archive marched again."""
    model = xd.Model.from_toml(MODELS / "relay_oscillator.toml")
    run = xd.simulate(model, method="rk4", step=0.7, until=12.0, nodes=["5 s"])
    times = np.linspace(0.05, 11.9, 60)
    u = (times + math.sqrt(2)) % (4 * math.sqrt(2)) - math.sqrt(2)  # from the start of a positive half swing
    exact = np.where(u < math.sqrt(2), 1 - u**2 / 2, -1 + (u - 2 * math.sqrt(2)) ** 2 / 2)
    assert xd.sample(run, times).x.values == pytest.approx(exact, abs=1e-10)
    part = xd.extend(xd.simulate(model, method="rk4", step=0.7, until=5.0), until=12.0)
    assert xd.content_digest(part) == xd.content_digest(run)
    xd.save(run, tmp_path / "relay.nc")
    assert xd.reproduce(tmp_path / "relay.nc").attrs["identical"] == 1


def test_wrong_settings_are_named() -> None:
    """Assert errors for what is neither a truth nor a word."""
    with pytest.raises(xd.ModelError, match="force 'relay': smooth is 'yes', needs true or false"):
        pushed("-f*sign(x)", smooth="yes")
    with pytest.raises(xd.InputError, match="switches is 'some'; there are 'located', 'landed on', 'stepped over'"):
        xd.simulate(pushed("-f*sign(x)"), method="rk4", step=0.1, until=1.0, switches="some")


def test_too_many_are_stepped_over() -> None:
    """Assert that a model with more than forty marches without them, and says so with the force and how many."""
    force = " - ".join(f"k*abs(x - {i}*metre)" for i in range(41))
    with pytest.warns(xd.AccuracyWarning, match=r"41 switches are hidden in 'relay' \(abs"):
        run = xd.simulate(pushed(f"-({force})"), method="rk4", step=0.1, until=1.0)
    assert "40 at most are located: all were stepped over" in run.attrs["run_outcome_text"]
    assert "solver_switches" not in run.attrs
