"""Refinement: one model over steps or tolerances, what its numbers come to, and how sure they are."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import xdynamics as xd
from contacts import ball
from problems import MODELS
from xdynamics.evidence.convergence import VERDICTS, judge

STEPS = {1: 0.01, 2: 0.02, 3: 0.05, 4: 0.05, 5: 0.1, 6: 0.2, 8: 0.3}
OSCILLATOR = xd.Model.from_toml(MODELS / "harmonic_oscillator.toml")  # cos 2t


def verdict(study: Any, name: str, k: int = 0) -> str:
    """The word of a verdict."""
    return VERDICTS[int(study[f"verdict_{name}"][k])]


@pytest.mark.parametrize("method", [name for name, one in xd.METHODS.items() if not one.stepping])
def test_orders_and_uncertainties_of_every_method(method: str) -> None:
    """Assert that asymptotic numbers have the method's order or a whole one above, and no error is beyond its uncertainty."""
    formal = xd.METHODS[method].order
    steps = [STEPS[formal] / 2**k for k in range(5)]
    study = xd.refine(OSCILLATOR, method=method, steps=steps, at=[2.4], until=2.4, estimator="none")
    assert study.attrs["formal_order"] == formal
    for name, true in (("x", math.cos(4.8)), ("v_x", -2 * math.sin(4.8))):
        order = float(study[f"order_{name}"][-2, 0])
        if verdict(study, name) == "asymptotic":
            assert abs(order - max(formal, round(order))) <= 0.05
        assert abs(float(study[name][-1, 0]) - true) <= float(study[f"uncertainty_{name}"][0]) + 2e-16


def test_the_limit_is_nearer_than_the_finest_level() -> None:
    """Assert Richardson's limit, differences, digests and units."""
    study = xd.refine(OSCILLATOR, method="rk4", steps=["40 ms", "20 ms", "10 ms"], at=["1 s", "1.234 s"], until="2 s")
    true = np.cos(2 * study.at_time.values)
    assert (np.abs(study.limit_x - true) < np.abs(study.x[-1] - true) / 20).all()
    assert np.array_equal(study.difference_x[:-1], np.diff(study.x, axis=0))
    assert np.isnan(study.difference_x[-1]).all()
    assert study.difference_x.attrs["units"] == study.uncertainty_x.attrs["units"] == "m"
    assert len({*study.run_digest.values}) == 3
    assert study.attrs["runs"].split() == list(study.run_digest.values)
    same = xd.simulate(OSCILLATOR, method="rk4", step="10 ms", until="2 s", force_samples="none")
    assert study.run_digest.values[-1] == xd.content_digest(same)
    assert float(study.interpolation_error_x[0, 0]) == 0.0 < float(study.interpolation_error_x[0, 1])
    assert (study.gate_x == 1).all()


def test_event_times_converge_too() -> None:
    """Assert apex and landing of a ball with quadratic drag against their closed form (apex: vt/g atan(v/vt))."""
    model = xd.Model.from_toml(MODELS / "ball_drag.toml")
    study = xd.refine(model, method="midpoint", steps=[0.1 / 2**k for k in range(5)])
    g, vt, v = (one.quantity.si for one in (model.parameters["g"], model.parameters["vt"], model.parameters["vt"]))
    v = model.initial["v_y"].si
    apex = vt / g * math.atan(v / vt)
    assert float(study.limit_event_time_apex[0]) == pytest.approx(apex, abs=1e-7)
    assert abs(float(study.event_time_apex[-1, 0]) - apex) <= float(study.uncertainty_event_time_apex[0])
    assert verdict(study, "event_time_ground") == "asymptotic"
    assert study.event_count_ground.values.tolist() == [1] * 5
    assert study.event_time_apex.dims == ("level", "occurrence")


def test_what_is_exact_is_at_roundoff() -> None:
    """Assert the verdict where a method has no error: free fall by a method of order 2."""
    study = xd.refine(ball(1.0, 1.0), method="velocity_verlet", steps=[0.02, 0.01, 0.005], at=[0.4], until=0.4)
    assert verdict(study, "y") == "roundoff"
    assert float(study.uncertainty_y[0]) < 1e-13


def test_loose_events_limit_what_steps_can_do() -> None:
    """Assert the verdict behind a bounce whose time is known to a tenth of a millisecond only."""
    model = ball(0.8, 1.0, time_tolerance="1e-4 s")
    study = xd.refine(model, method="euler_cromer", steps=[2e-4, 1e-4, 5e-5], at=[0.7], until=0.7)
    assert verdict(study, "y") == "event_limited"


def test_a_kink_that_is_stepped_over_is_not_asymptotic() -> None:
    """Assert that a force with a hidden switch that is declared smooth does not pass for converged at order four."""
    text = OSCILLATOR.to_toml().replace(
        "[initial]", '[forces.stop]\nx = "-8*k*max(x, 0*metre)"\nsmooth = true\n\n[initial]'
    )
    study = xd.refine(
        xd.Model.from_text(text), method="rk4", steps=[0.04 / 2**k for k in range(5)], at=[6.0], until=6.0
    )
    assert verdict(study, "x") != "asymptotic"
    fine = xd.simulate(
        xd.Model.from_text(text.replace("smooth = true\n", "")), method="dop853", rtol=1e-12, atol=1e-13, until=6.0
    )
    assert abs(float(study.x[-1, 0] - fine.x[-1])) <= float(study.uncertainty_x[0])


def test_energies_and_observables_are_compared() -> None:
    """Assert values of what is derived from the state, between rows too, against the run's own at a row."""
    model = xd.Model.from_toml(MODELS / "pendulum.toml")
    study = xd.refine(
        model, method="pefrl", steps=[0.1, 0.05], at=[1.0, 1.02], observables=["theta", "total_energy"], until=2.0
    )
    run = xd.simulate(model, method="pefrl", step=0.05, until=2.0)
    assert float(study.total_energy[-1, 0]) == pytest.approx(float(run.total_energy[20]), rel=1e-14)
    assert float(study.interpolation_error_total_energy[-1, 1]) > 0.0
    assert study.total_energy.attrs["units"] == run.total_energy.attrs["units"]
    assert "v_theta" not in study


def test_tolerances_are_refined() -> None:
    """Assert levels by relative tolerance: the finest is within its uncertainty of the truth."""
    study = xd.refine(OSCILLATOR, method="dop853", rtols=[1e-4, 1e-6, 1e-8, 1e-10], at="3 s", until="3 s")
    assert study.rtol.values.tolist() == [1e-4, 1e-6, 1e-8, 1e-10]
    assert abs(float(study.x[-1, 0]) - math.cos(6.0)) <= float(study.uncertainty_x[0])
    assert study.attrs["formal_order"] == 1.0


H = 0.1 / 2.0 ** np.arange(5)


@pytest.mark.parametrize(
    ("values", "rounding", "interpolation", "events", "said"),
    [
        (1 + 3 * H**4, 1e-16, 0.0, 0.0, "asymptotic"),
        (1 + 3 * H**5, 1e-16, 0.0, 0.0, "asymptotic"),  # more than the method promises
        (1 + 3 * H**2, 1e-16, 0.0, 0.0, "pre_asymptotic"),
        (1 + 3 * H**4, 1e-3, 0.0, 0.0, "roundoff"),
        (1 + 3 * H**4, 1e-16, 1e-3, 0.0, "interpolation_limited"),
        (1 + 3 * H**4, 1e-16, 0.0, 1e-3, "event_limited"),
        (1 + 1e-3 / H, 1e-16, 0.0, 0.0, "not_converging"),
        (np.array([1.0, 0.2, 0.9, -0.3, 0.6]), 1e-16, 0.0, 0.0, "not_converging"),  # a chaotic run, too late
        (np.array([1.0, 1.0, 1.0, 1.0, np.nan]), 1e-16, 0.0, 0.0, "not_converging"),
    ],
)
def test_verdicts_on_planted_cases(values: np.ndarray, rounding: float, interpolation: float, events: float, said: str) -> None:  # fmt: skip
    """Assert the verdict of each, and that what converges has its limit within the uncertainty."""
    found = judge(values, H, 4.0, rounding, interpolation, events)
    assert VERDICTS[found.verdict] == said
    if said != "not_converging":
        assert abs(values[-1] - 1.0) <= found.uncertainty


def test_the_uncertainty_is_near_the_error() -> None:
    """Assert for 1,000 random smooth cases that at least 95 in 100 are held, and the median is within a factor of three."""
    rng, factors = np.random.default_rng(7), []
    for _ in range(1000):
        formal, terms = int(rng.integers(1, 9)), rng.normal(size=3)
        h = 0.5 * 2.0 ** -np.arange(5) * rng.uniform(0.5, 1.0)
        error = terms[0] * h**formal * (1 + terms[1] * h / 2 + terms[2] * h**2 / 2)
        found = judge(0.3 + error, h, formal, 4e-16, 0.0, 0.0)
        factors.append(found.uncertainty / max(abs(error[-1]), 1e-16))
    assert np.mean(np.array(factors) >= 1.0) >= 0.95
    assert 1.0 <= np.median(factors) <= 3.0


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({}, "refine needs steps=… or rtols=…".replace("…", r"\[…\]")),
        ({"steps": [0.1, 0.05], "rtols": [1e-3, 1e-4]}, "one of them"),
        ({"steps": "10 ms"}, "steps is '10 ms', needs a row of them"),
        ({"steps": [0.1]}, "need 2 or more that get smaller"),
        ({"steps": [0.05, 0.1]}, "need 2 or more that get smaller"),
        ({"steps": [0.1, -0.1]}, "all positive"),
        ({"steps": [0.1, 0.05], "at": [9.0]}, "at has 9.0 s, needs times in every run, from 0.0 s to 2.0 s"),
        ({"steps": [0.1, 0.05], "observables": ["q"]}, "observable 'q' is none of the model's; there are x, v_x"),
        ({"steps": [0.1, 0.05], "method": "rk5"}, "rk5"),
        ({"steps": ["1 m", "0.5 m"]}, "step"),
    ],
)
def test_wrong_studies(asked: dict[str, Any], said: str) -> None:
    """Assert what is said of each."""
    with pytest.raises(xd.InputError, match=said):
        xd.refine(OSCILLATOR, **{"method": "rk4", "until": 2.0} | asked)
