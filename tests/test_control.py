"""Step control: outcomes of hard cases, the error test, rejected trials, first step, replay."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

import xdynamics as xd
from problems import EPS, oscillator
from xdynamics.march.outcomes import WORDS


@lru_cache
def state(rate: str, start: str = "0 s") -> xd.Model:
    """One first-order state y in m, with a second, a metre and a rate k."""
    states = {"y": {"unit": "m", "rate": rate}}
    return xd.Model(name="state", parameters={"k": "1 s-1"}, states=states, initial={"t": start, "y": "1 m"})


def run_of(model: xd.Model, until: float, **more: object) -> object:
    """March by Dormand-Prince at 1e-8."""
    return xd.simulate(model, **{"method": "dormand_prince", "rtol": 1e-8, "atol": 1e-8, "until": until} | more)


def is_sound(run: object) -> bool:
    """Whether a record never pairs success with a state that is not finite, and says t and h."""
    finite = all(np.isfinite(run[name]).all() for name, one in run.data_vars.items() if one.attrs["role"] in ("coordinate", "velocity", "state"))  # fmt: skip
    text = run.attrs["run_outcome_text"]
    return finite and (WORDS[run.attrs["run_outcome"]].good or ("t = " in text and "h = " in text))


def test_blow_up_of_square() -> None:
    """Assert that y' = y**2 ends at its singularity t = 1, named."""
    run = run_of(state("k*y**2/(1*metre)"), 2.0)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert abs(float(run.time[-1]) - 1) < 1e-6
    assert "singularity" in run.attrs["run_outcome_text"]
    assert is_sound(run)


def test_collision() -> None:
    """Assert that x'' = -1/x**2 from rest at 1 ends at the collision, pi/(2 sqrt 2)."""
    model = xd.Model(
        name="fall", coordinates={"x": "m"}, parameters={"m": "1 kg", "G": "1 m3 s-2"}, mass={"x": "m"},
        forces={"pull": {"x": "-m*G/x**2"}}, initial={"x": "1 m", "v_x": "0 m s-1"},
    )  # fmt: skip
    run = run_of(model, 2.0)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert abs(float(run.time[-1]) - 1.1107207345395915) < 1e-6
    assert is_sound(run)


def test_blow_up_of_exponential() -> None:
    """Assert that y' = exp(y) from 1 ends at 1/e."""
    run = run_of(state("k*(1*metre)*exp(y/(1*metre))"), 1.0)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert abs(float(run.time[-1]) - np.exp(-1)) < 1e-6
    assert is_sound(run)


def test_force_that_becomes_nan() -> None:
    """Assert that a rate that is no number after t = 1 ends there, with its name and the domain as the reason."""
    run = run_of(state("k*y*sqrt(1 - where(t > 1*second, 2, 0))"), 2.0)
    assert run.attrs["run_outcome"] == "nonfinite_force"
    assert abs(float(run.time[-1]) - 1) < 1e-12
    assert "rate_y is nan" in run.attrs["run_outcome_text"]
    assert set(reasons(run)) >= {"domain"}
    assert is_sound(run)


def test_force_that_becomes_infinite() -> None:
    """Assert that a rate that is infinite after t = 1 ends there, with its name and reason."""
    run = run_of(state("k*y/where(t > 1*second, 0, 1)"), 2.0)
    assert run.attrs["run_outcome"] == "nonfinite_force"
    assert abs(float(run.time[-1]) - 1) < 1e-12
    assert set(reasons(run)) >= {"nonfinite_force"}
    assert is_sound(run)


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"rtol": 9 * EPS}, r"rtol is 1.99\d*e-15, needs at least 10 eps"),
        ({"rtol": float("nan")}, "rtol is nan, needs a finite non-negative number"),
        ({"rtol": -1e-6}, "rtol is -1e-06, needs a finite non-negative number"),
        ({"atol": float("nan")}, "atol is nan, needs a finite non-negative number"),
        ({"atol": -1.0}, "atol is -1.0, needs a finite non-negative number"),
        ({"atol": {"x": "1 s"}}, "atol of 'x' is '1 s', needs the unit 'm'"),
        ({"atol": {"z": 1.0}}, "atol names 'z'; there are x, v_x"),
        ({"atol": 0.0}, "atol of 'v_x' is 0 and v_x starts at 0"),
        ({"rtol": "fine"}, "rtol is 'fine', needs a number"),
        ({"min_step": "2 s", "max_step": "1 s"}, "min_step is 2.0 s, needs to be at most max_step = 1.0 s"),
        ({"safety": 1.5}, "safety is 1.5, needs a number between 0 and 1"),
        ({"growth_limits": (0.5, 0.9)}, "growth_limits are .*, need 0 < least < 1 < greatest"),
        ({"max_steps": 0}, "max_steps is 0, needs a positive number"),
        ({"estimator": "guess"}, "estimator is 'guess'; there are none, embedded, step_doubling"),
        ({"method": "rk4", "estimator": "embedded"}, "method 'rk4' has no embedded formula; take estimator = 'step_doubling'"),
        ({"estimator": "none"}, "tolerances need an error estimate"),
        ({"rtol": float("nan"), "safety": 2.0}, r"cannot be set up:\n  1. safety is 2.0.*\n  2. rtol is nan"),
    ],
)  # fmt: skip
def test_wrong_tolerances_are_named(asked: dict[str, object], message: str) -> None:
    """Assert that each fault of the settings is named before anything is computed."""
    with pytest.raises(xd.InputError, match=message):
        run_of(oscillator().model, 1.0, **asked)


def test_zero_absolute_tolerance_through_zero() -> None:
    """Assert that a purely relative tolerance survives y = 0 without a division by zero."""
    run = run_of(state("-k*(1*metre)"), 2.0, atol=0.0)
    assert run.attrs["run_outcome"] in ("completed", "step_below_spacing")
    assert is_sound(run)


def test_late_start_near_the_spacing() -> None:
    """Assert that at t0 = 1e9 s a solution faster than the spacing of t is refused by name."""
    late = state("-k*y", "1e9 s").replace(parameters={"k": 1e8})
    run = run_of(late, 1e9 + 1e-3)
    assert run.attrs["run_outcome"] == "step_below_spacing"
    assert is_sound(run)


def test_stiff_decay_by_an_explicit_method() -> None:
    """Assert that lambda = 1e6 with an explicit method completes, and that its text suspects stiffness."""
    run = run_of(state("-k*y").replace(parameters={"k": 1e6}), 1e-2)
    assert run.attrs["run_outcome"] == "completed"
    assert "stiff" in run.attrs["run_outcome_text"]
    assert is_sound(run)


def test_step_limit_ends_an_endless_run() -> None:
    """Assert that a march that would take 1e12 steps ends as step_limit."""
    run = run_of(state("-k*y").replace(parameters={"k": 1e12}), 1.0, max_steps=5000)
    assert run.attrs["run_outcome"] == "step_limit"
    assert "5000 accepted and rejected steps" in run.attrs["run_outcome_text"]
    assert is_sound(run)


def test_root_that_reaches_zero() -> None:
    """Assert that y' = -sqrt(y), which reaches 0 at t = 2, ends there by name with the domain as a reason."""
    run = run_of(state("-k*sqrt(y*(1*metre))"), 3.0)
    assert run.attrs["run_outcome"] in ("nonfinite_force", "step_below_spacing")
    assert abs(float(run.time[-1]) - 2) < 1e-3
    assert "domain" in reasons(run)
    assert is_sound(run)


def test_every_trial_rejected_at_the_minimum() -> None:
    """Assert that a minimum step that is too long is its own outcome, and no such trial is accepted."""
    run = run_of(oscillator().model, 10.0, min_step="0.5 s", step="1 s", rtol=1e-12, atol=1e-12)
    assert run.attrs["run_outcome"] == "error_test_at_minimum_step"
    assert run.sizes["step"] == 1
    assert run.trial_step_size.values[-1] == 0.5
    assert set(reasons(run)) == {"error_test"}
    assert is_sound(run)


def reasons(run: object) -> list[str]:
    """Return the reason of every rejected trial."""
    words = run.trial_reason.attrs["flag_meanings"].split()
    return [words[int(one)] for one in run.trial_reason.values]
